//! What changes from day to day: doors, furniture, boxes in the corridors, and people.

use std::f64::consts::{PI, TAU};

use crate::plan::{Furniture, Pillar, Plan, corridors};
use crate::random::Random;
use crate::walls::{Point, Rect, Segment, Vector, Walls, outline};

/// Boxes that stand in the corridors of a day.
const CORRIDOR_BOXES: usize = 25;
/// Share of furniture that stands anywhere in its room, and not where it usually does.
const MOVED_SHARE: f64 = 0.25;
/// Radius of a person \[m\].
pub(crate) const PERSON_RADIUS_M: f64 = 0.25;
/// Sides of the polygon that stands for a round pillar.
const PILLAR_SIDES: u32 = 16;

/// All walls of one day.
pub(crate) fn walls_of_day(plan: &Plan, random: &mut Random) -> Walls {
    let mut open = plan.open.clone();
    for door in &plan.doors {
        open.push(if random.chance(door.open_share) { door.passage } else { door.niche });
    }
    let mut solid = plan.solid.clone();
    solid.extend((0..CORRIDOR_BOXES).filter_map(|_| corridor_box(plan, random)));

    let mut segments = outline(&open, &solid);
    for furniture in &plan.furniture {
        segments.extend(stand(furniture, random));
    }
    segments.extend(plan.pillars.iter().flat_map(pillar_sides));
    Walls::new(segments)
}

/// A bin, a bench or a case at the wall of a wide corridor, none if the place drawn does not suit.
fn corridor_box(plan: &Plan, random: &mut Random) -> Option<Rect> {
    let section = &plan.sections[random.index(plan.sections.len())];
    let side = if random.chance(0.5) { -1.0 } else { 1.0 };
    let at = random.uniform(0.0, 1.0);
    let (length, depth) = (random.uniform(0.3, 1.2), random.uniform(0.2, 0.4));
    section.box_at_wall(at, side, length, depth).filter(|found| !found.overlaps(&plan.atrium))
}

/// The four sides of a piece of furniture where it stands on a day; none where its room is too
/// small to turn it around.
fn stand(furniture: &Furniture, random: &mut Random) -> Vec<Segment> {
    let Furniture { room, centre, size, angle } = furniture;
    let reach = 0.5 * (size.0 * size.0 + size.1 * size.1).sqrt() + 0.05;
    let shift = Vector::new(0.2 * random.normal(), 0.2 * random.normal());
    let anywhere = Point::new(random.uniform(room.x0, room.x1), random.uniform(room.y0, room.y1));
    let turn = 0.1 * random.normal();
    let place = if random.chance(MOVED_SHARE) { anywhere } else { centre + shift };

    if room.width() <= 2.0 * reach || room.height() <= 2.0 * reach {
        return Vec::new();
    }
    let centre = Point::new(
        place.x.clamp(room.x0 + reach, room.x1 - reach),
        place.y.clamp(room.y0 + reach, room.y1 - reach),
    );
    let (sin, cos) = libm::sincos(angle + turn);
    let (half_x, half_y) = (size.0 / 2.0, size.1 / 2.0);
    let corners = [(-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y)]
        .map(|(x, y)| centre + Vector::new(cos * x - sin * y, sin * x + cos * y));
    closed(&corners)
}

fn pillar_sides(pillar: &Pillar) -> Vec<Segment> {
    let corners: Vec<Point> = (0..PILLAR_SIDES)
        .map(|k| {
            let (sin, cos) = libm::sincos(TAU * f64::from(k) / f64::from(PILLAR_SIDES));
            pillar.centre + pillar.radius * Vector::new(cos, sin)
        })
        .collect();
    closed(&corners)
}

/// The sides of a polygon.
fn closed(corners: &[Point]) -> Vec<Segment> {
    let next = corners.iter().cycle().skip(1);
    corners.iter().zip(next).map(|(&start, &end)| Segment { start, end }).collect()
}

/// A disc that walks up and down a corridor, keeping right, without end.
///
/// Its way is a stadium: two straights, `lane_m` to either side of the corridor's middle, joined
/// by half circles.
#[derive(Debug, Clone)]
pub(crate) struct Person {
    from: Point,
    /// Unit vector along the corridor.
    along: Vector,
    straight_m: f64,
    lane_m: f64,
    speed_m_s: f64,
    /// Way walked at time 0 \[m\].
    start_m: f64,
}

impl Person {
    /// Where the person is, `time_s` after the drive's start.
    pub(crate) fn position(&self, time_s: f64) -> Point {
        let half_circle_m = PI * self.lane_m;
        let lap_m = 2.0 * (self.straight_m + half_circle_m);
        let way_m = (self.start_m + self.speed_m_s * time_s).rem_euclid(lap_m);
        // The second half of a lap is the first, seen from the other end.
        let is_back = lap_m / 2.0 <= way_m;
        let (origin, along, way_m) = if is_back {
            (self.from + self.along * self.straight_m, -self.along, way_m - lap_m / 2.0)
        } else {
            (self.from, self.along, way_m)
        };
        let right = Vector::new(along.y, -along.x);
        if way_m < self.straight_m {
            origin + along * way_m + right * self.lane_m
        } else {
            let (sin, cos) = libm::sincos((way_m - self.straight_m) / self.lane_m);
            origin + along * (self.straight_m + self.lane_m * sin) + right * (self.lane_m * cos)
        }
    }
}

/// The people of a day, each in a stretch of corridor between two nodes.
pub(crate) fn people_of_day(plan: &Plan, n_people: u32, random: &mut Random) -> Vec<Person> {
    let corridors = corridors(&plan.nodes);
    (0..n_people)
        .map(|_| {
            let (a, b) = corridors[random.index(corridors.len())];
            let along = (b - a).normalize();
            let length_m = (b - a).norm();
            let from_m = random.uniform(1.5, 0.4 * length_m);
            let to_m = random.uniform(0.6 * length_m, length_m - 1.5);
            Person {
                from: a + along * from_m,
                along,
                straight_m: to_m - from_m,
                lane_m: random.uniform(0.5, 0.6),
                speed_m_s: random.uniform(0.7, 1.5),
                start_m: random.uniform(0.0, 2.0 * length_m),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 10 m there, half a circle of radius 0.5 m (1.5708 m), 10 m back, half a circle.
    #[test]
    fn a_person_walks_up_and_down_on_the_right() {
        let person = Person {
            from: Point::new(1.0, 2.0),
            along: Vector::new(1.0, 0.0),
            straight_m: 10.0,
            lane_m: 0.5,
            speed_m_s: 1.0,
            start_m: 0.0,
        };
        let half_circle_s = 0.5 * PI;
        for (time_s, x, y) in [
            (0.0, 1.0, 1.5),
            (4.0, 5.0, 1.5),
            (10.0 + half_circle_s / 2.0, 11.5, 2.0),
            (10.0 + half_circle_s, 11.0, 2.5),
            (10.0 + half_circle_s + 4.0, 7.0, 2.5),
            (2.0 * (10.0 + half_circle_s) - half_circle_s / 2.0, 0.5, 2.0),
            (2.0 * (10.0 + half_circle_s) + 4.0, 5.0, 1.5),
        ] {
            let found = person.position(time_s);
            assert!((found - Point::new(x, y)).norm() < 1e-9, "{time_s}: {found}");
        }
    }
}
