//! People walking around.

use std::f64::consts::PI;

use crate::plane::{Point, Vector};
use crate::random::Random;

/// Radius of a person \[m\].
pub(crate) const PERSON_RADIUS_M: f64 = 0.25;
/// Height of a person \[m\].
pub(crate) const PERSON_HEIGHT_M: f64 = 1.75;

/// A disc that walks up and down a corridor forever and keeps to the right.
///
/// Its path is a stadium: two straight lines, `lane_m` to each side of the middle of the corridor,
/// joined by half circles.
#[derive(Debug, Clone)]
pub(crate) struct Person {
    from: Point,
    /// Unit vector along the corridor.
    along: Vector,
    straight_m: f64,
    lane_m: f64,
    speed_m_s: f64,
    /// Distance walked at time 0 \[m\].
    start_m: f64,
}

impl Person {
    /// The position of the person `time_s` after the start of the drive.
    pub(crate) fn position(&self, time_s: f64) -> Point {
        let half_circle_m = PI * self.lane_m;
        let lap_m = 2.0 * (self.straight_m + half_circle_m);
        let walked_m = (self.start_m + self.speed_m_s * time_s).rem_euclid(lap_m);
        // The second half of a lap mirrors the first, starting at the other end.
        let is_back = lap_m / 2.0 <= walked_m;
        let (origin, along, walked_m) = if is_back {
            (self.from + self.along * self.straight_m, -self.along, walked_m - lap_m / 2.0)
        } else {
            (self.from, self.along, walked_m)
        };
        let right = Vector::new(along.y, -along.x);
        if walked_m < self.straight_m {
            origin + along * walked_m + right * self.lane_m
        } else {
            let (sin, cos) = libm::sincos((walked_m - self.straight_m) / self.lane_m);
            origin + along * (self.straight_m + self.lane_m * sin) + right * (self.lane_m * cos)
        }
    }
}

/// The people of one day, each in a lane between two points.
pub(crate) fn people_of_day(
    lanes: &[(Point, Point)],
    n_people: u32,
    random: &mut Random,
) -> Vec<Person> {
    // Without lanes there are no people.
    let n_people = if lanes.is_empty() { 0 } else { n_people };
    (0..n_people)
        .map(|_| {
            let (a, b) = lanes[random.index(lanes.len())];
            let along = (b - a).normalize();
            let length_m = (b - a).norm();
            let margin_m = f64::min(1.5, 0.2 * length_m);
            let from_m = random.uniform(margin_m, 0.4 * length_m);
            let to_m = random.uniform(0.6 * length_m, length_m - margin_m);
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

    /// 10 m out, a half circle of radius 0.5 m (1.5708 m), 10 m back, a half circle.
    #[test]
    fn a_person_walks_up_and_down_and_keeps_right() {
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
