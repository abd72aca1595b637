//! What changes on a map from day to day: furniture is moved, doors are shut.

use crate::day::turned;
use crate::map::{CLEARANCE_M, Map};
use crate::plane::{Point, Segment, Vector};
use crate::random::Random;
use crate::world::{Surface, prism};

/// Floor that a robot can reach for each piece of furniture \[m^2\], and pieces at most.
const FLOOR_PER_PIECE_M2: f64 = 12.0;
const MAX_PIECES: usize = 500;
/// Share of furniture that stands anywhere on a day, and not where it usually does.
const MOVED_SHARE: f64 = 0.25;
/// Share of the doors that are shut on a day.
const SHUT_SHARE: f64 = 0.5;
const DOOR_REFLECTIVITY: f64 = 0.4;

/// Furniture and doors of a map, the same on every day but for where they stand.
#[derive(Debug, Clone, Default)]
pub(crate) struct Loose {
    furniture: Vec<Piece>,
    doors: Vec<Segment>,
}

#[derive(Debug, Clone, Copy)]
struct Piece {
    /// Where it usually stands.
    centre: Point,
    size: (f64, f64),
    height_m: f64,
    angle: f64,
    reflectivity: f64,
}

impl Loose {
    pub(crate) fn draw(map: &Map, random: &mut Random) -> Self {
        let n = (map.floor_m2() / FLOOR_PER_PIECE_M2) as usize;
        let piece = |_| Piece {
            centre: map.place(random),
            size: (random.uniform(0.3, 1.4), random.uniform(0.25, 0.6)),
            height_m: random.uniform(0.5, 1.9),
            angle: if random.chance(0.5) { 0.0 } else { std::f64::consts::FRAC_PI_2 },
            reflectivity: random.uniform(0.05, 0.7),
        };
        Self { furniture: (0..n.min(MAX_PIECES)).map(piece).collect(), doors: map.doorways() }
    }

    /// Surfaces of a day on which a robot drives along `way`, up to a ceiling: what would be in its
    /// way, or in a wall, is not there.
    pub(crate) fn day(
        &self,
        map: &Map,
        way: &[Point],
        ceiling_m: f64,
        random: &mut Random,
    ) -> Vec<Surface> {
        let mut surfaces = Vec::new();
        for piece in &self.furniture {
            let shift = Vector::new(0.2 * random.normal(), 0.2 * random.normal());
            let anywhere = map.place(random);
            let turn = 0.1 * random.normal();
            let centre = if random.chance(MOVED_SHARE) { anywhere } else { piece.centre + shift };
            let reach_m = 0.5 * (piece.size.0 * piece.size.0 + piece.size.1 * piece.size.1).sqrt();
            let is_clear = |at: &Point| reach_m + CLEARANCE_M < (at - centre).norm();
            if reach_m < map.clearance_at_m(centre) && way.iter().all(is_clear) {
                let corners = turned(centre, piece.size, piece.angle + turn);
                surfaces.extend(prism(&corners, (0.0, piece.height_m), piece.reflectivity));
            }
        }
        for &door in &self.doors {
            let is_shut = random.chance(SHUT_SHARE);
            if is_shut && way.iter().all(|&at| CLEARANCE_M < door.distance_m(at)) {
                surfaces.push(Surface::solid(door, (0.0, ceiling_m), DOOR_REFLECTIVITY));
            }
        }
        surfaces
    }
}
