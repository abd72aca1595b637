//! The surfaces of a building on one day: walls, doors, furniture and boxes in corridors.

use std::f64::consts::TAU;

use crate::plan::{Furniture, Pillar, Plan};
use crate::plane::{Point, Rect, Segment, Vector, outline};
use crate::random::Random;
use crate::world::{Material, Surface, prism};

/// Length of corridor per box \[m\].
const CORRIDOR_PER_BOX_M: f64 = 22.0;
/// Fraction of the furniture that is moved to a random position in its room.
const MOVED_SHARE: f64 = 0.25;
/// Number of sides of the polygon that approximates a round pillar or trunk.
const ROUND_SIDES: u32 = 16;
/// Height of doors \[m\].
const DOOR_HEIGHT_M: f64 = 2.1;
/// Height of the entrances in the facades \[m\].
const ENTRANCE_HEIGHT_M: f64 = 2.4;
/// Lower and upper edge of windows \[m\].
const WINDOW_M: (f64, f64) = (0.9, 2.2);
/// Glass reflects little, even at normal incidence.
const GLASS_REFLECTIVITY: f64 = 0.3;
const PILLAR_REFLECTIVITY: f64 = 0.5;

/// All surfaces of a building on one day, in the frame of the building.
pub(crate) fn building_of_day(plan: &Plan, random: &mut Random) -> Vec<Surface> {
    let storey = (0.0, plan.ceiling_m);
    let wall = |segment| Surface::solid(segment, storey, plan.reflectivity);
    let mut open = plan.open.clone();
    let mut surfaces = Vec::new();
    for door in &plan.doors {
        let is_open = random.chance(door.open_share);
        open.push(if is_open { door.passage } else { door.niche });
        if is_open {
            let above = (DOOR_HEIGHT_M, plan.ceiling_m);
            surfaces.push(Surface::solid(door.lintel, above, plan.reflectivity));
        }
    }
    // The facade, with its windows and entrance, is added by `facades`.
    let is_inside = |s: &Segment| !is_on_edge(&plan.building, s);
    surfaces.extend(outline(&open, &plan.solid).into_iter().filter(is_inside).map(wall));
    surfaces.extend(plan.glass.iter().map(|&segment| pane(segment, storey)));
    surfaces.extend(atrium(plan));
    surfaces.extend(plan.pillars.iter().flat_map(|Pillar { centre, radius_m }| {
        prism(
            &circle_polygon(*centre, *radius_m),
            (0.0, plan.atrium_ceiling_m),
            PILLAR_REFLECTIVITY,
        )
    }));
    for furniture in &plan.furniture {
        surfaces.extend(place_furniture(furniture, random));
    }
    for _ in 0..n_boxes(plan) {
        surfaces.extend(corridor_box(plan, random));
    }
    surfaces
}

fn pane(segment: Segment, z: (f64, f64)) -> Surface {
    Surface { material: Material::Glass, ..Surface::solid(segment, z, GLASS_REFLECTIVITY) }
}

/// The walls of the atrium above the surrounding ceilings.
fn atrium(plan: &Plan) -> Vec<Surface> {
    let ceilings_m = Some((plan.atrium_ceiling_m, plan.ceiling_m));
    let above = (plan.ceiling_m, plan.atrium_ceiling_m);
    (prism(&plan.atrium.corners(), above, plan.reflectivity).into_iter())
        .map(|surface| Surface { ceilings_m, ..surface })
        .collect()
}

/// Whether a segment lies on a side of a rectangle.
fn is_on_edge(rect: &Rect, segment: &Segment) -> bool {
    let Segment { start, end } = segment;
    let both = |is: &dyn Fn(&Point) -> bool| is(start) && is(end);
    let same = |a: f64, b: f64| (a - b).abs() < 1e-9;
    both(&|p| same(p.x, rect.x0))
        || both(&|p| same(p.x, rect.x1))
        || both(&|p| same(p.y, rect.y0))
        || both(&|p| same(p.y, rect.y1))
}

/// The four facades, with their windows and entrances.
pub(crate) fn facades(plan: &Plan) -> Vec<Surface> {
    let ceilings_m = Some((plan.ceiling_m, f64::INFINITY));
    let solid = |segment, z| Surface::solid(segment, z, plan.reflectivity);
    let corners = plan.building.corners();
    let mut surfaces = Vec::new();
    for (k, &corner) in corners.iter().enumerate() {
        let side = Segment { start: corner, end: corners[(k + 1) % 4] };
        let along = (side.end - side.start).normalize();
        // Openings in order along the side, counter-clockwise.
        let of_side = |segments: &[Segment], is_entrance: bool| -> Vec<(f64, f64, bool)> {
            let on_side = segments
                .iter()
                .filter(|s| side.distance_m(s.start) + side.distance_m(s.end) < 1e-3);
            let spans = on_side.map(|s| {
                let (a, b) = ((s.start - side.start).dot(&along), (s.end - side.start).dot(&along));
                (a.min(b), a.max(b), is_entrance)
            });
            spans.collect()
        };
        let mut openings = of_side(&plan.windows, false);
        openings.extend(of_side(&plan.entrances, true));
        openings.sort_by(|a, b| a.0.total_cmp(&b.0));
        let part = |from: f64, to: f64| Segment {
            start: side.start + along * from,
            end: side.start + along * to,
        };
        let mut from = 0.0;
        for (a, b, is_entrance) in openings {
            surfaces.push(solid(part(from, a), (0.0, plan.roof_m)));
            let opening = part(a, b);
            if is_entrance {
                let lintel = solid(opening, (ENTRANCE_HEIGHT_M, plan.roof_m));
                surfaces.push(Surface { ceilings_m, ..lintel });
            } else {
                surfaces.push(solid(opening, (0.0, WINDOW_M.0)));
                surfaces.push(Surface { ceilings_m, ..pane(opening, WINDOW_M) });
                surfaces.push(solid(opening, (WINDOW_M.1, plan.roof_m)));
            }
            from = b;
        }
        let length_m = (side.end - side.start).norm();
        surfaces.push(solid(part(from, length_m), (0.0, plan.roof_m)));
    }
    surfaces
}

fn n_boxes(plan: &Plan) -> usize {
    (plan.sections.iter().map(crate::plan::Section::length_m).sum::<f64>() / CORRIDOR_PER_BOX_M)
        as usize
}

/// A box (bin, bench, case) at the wall of a wide corridor. Empty if the drawn position is not
/// suitable.
fn corridor_box(plan: &Plan, random: &mut Random) -> Vec<Surface> {
    let section = &plan.sections[random.index(plan.sections.len())];
    let side = if random.chance(0.5) { -1.0 } else { 1.0 };
    let at = random.uniform(0.0, 1.0);
    let (length, depth) = (random.uniform(0.3, 1.2), random.uniform(0.2, 0.4));
    let (height, reflectivity) = (random.uniform(0.5, 1.8), random.uniform(0.03, 0.7));
    section
        .box_at_wall(at, side, length, depth)
        .filter(|found| !found.overlaps(&plan.atrium))
        .map(|found| prism(&found.corners(), (0.0, height), reflectivity))
        .unwrap_or_default()
}

/// The four sides of a piece of furniture at its position on one day. Empty if the room is too
/// small to rotate it.
fn place_furniture(furniture: &Furniture, random: &mut Random) -> Vec<Surface> {
    let Furniture { room, centre, size_m, height_m, angle_rad, reflectivity } = furniture;
    let reach = 0.5 * (size_m.0 * size_m.0 + size_m.1 * size_m.1).sqrt() + 0.05;
    let shift = Vector::new(0.2 * random.normal(), 0.2 * random.normal());
    let anywhere = Point::new(random.uniform(room.x0, room.x1), random.uniform(room.y0, room.y1));
    let rotation_rad = 0.1 * random.normal();
    let place = if random.chance(MOVED_SHARE) { anywhere } else { centre + shift };

    if room.width() <= 2.0 * reach || room.height() <= 2.0 * reach {
        return Vec::new();
    }
    let centre = Point::new(
        place.x.clamp(room.x0 + reach, room.x1 - reach),
        place.y.clamp(room.y0 + reach, room.y1 - reach),
    );
    prism(&rotated_rect(centre, *size_m, angle_rad + rotation_rad), (0.0, *height_m), *reflectivity)
}

/// The corners of a rectangle rotated about its centre.
pub(crate) fn rotated_rect(centre: Point, size: (f64, f64), angle: f64) -> [Point; 4] {
    let (sin, cos) = libm::sincos(angle);
    let (half_x, half_y) = (size.0 / 2.0, size.1 / 2.0);
    [(-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y)]
        .map(|(x, y)| centre + Vector::new(cos * x - sin * y, sin * x + cos * y))
}

/// A polygon that approximates a circle.
pub(crate) fn circle_polygon(centre: Point, radius: f64) -> Vec<Point> {
    (0..ROUND_SIDES)
        .map(|k| {
            let (sin, cos) = libm::sincos(TAU * f64::from(k) / f64::from(ROUND_SIDES));
            centre + radius * Vector::new(cos, sin)
        })
        .collect()
}
