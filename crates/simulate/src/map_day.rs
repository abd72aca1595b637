//! What changes on a map from day to day: furniture moves, doors open and close.

use crate::day::rotated_rect;
use crate::map::{CLEARANCE_M, Map};
use crate::plane::{Point, Segment, Vector};
use crate::random::Random;
use crate::world::{Surface, prism};

/// Reachable floor area per piece of furniture \[m^2\].
const FLOOR_PER_PIECE_M2: f64 = 12.0;
/// Largest number of pieces of furniture.
const MAX_PIECES: usize = 500;
/// Fraction of the furniture that is moved to a random position on a given day.
const MOVED_SHARE: f64 = 0.25;
/// Fraction of the doors that are closed on a given day.
const CLOSED_SHARE: f64 = 0.5;
const DOOR_REFLECTIVITY: f64 = 0.4;

/// Furniture and doors of a map. Only their positions change from day to day.
#[derive(Debug, Clone, Default)]
pub(crate) struct Movables {
    furniture: Vec<Piece>,
    doors: Vec<Segment>,
}

#[derive(Debug, Clone, Copy)]
struct Piece {
    /// Its usual position.
    centre: Point,
    size: (f64, f64),
    height_m: f64,
    angle: f64,
    reflectivity: f64,
}

impl Movables {
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

    /// The surfaces of one day. `route` is the path of the robot on that day: furniture and doors
    /// that would block it, and furniture that would overlap a wall, are left out.
    pub(crate) fn day(
        &self,
        map: &Map,
        route: &[Point],
        ceiling_m: f64,
        random: &mut Random,
    ) -> Vec<Surface> {
        let mut surfaces = Vec::new();
        for piece in &self.furniture {
            let shift = Vector::new(0.2 * random.normal(), 0.2 * random.normal());
            let anywhere = map.place(random);
            let rotation_rad = 0.1 * random.normal();
            let centre = if random.chance(MOVED_SHARE) { anywhere } else { piece.centre + shift };
            let reach_m = 0.5 * (piece.size.0 * piece.size.0 + piece.size.1 * piece.size.1).sqrt();
            let is_clear = |at: &Point| reach_m + CLEARANCE_M < (at - centre).norm();
            if reach_m < map.clearance_at_m(centre) && route.iter().all(is_clear) {
                let corners = rotated_rect(centre, piece.size, piece.angle + rotation_rad);
                surfaces.extend(prism(&corners, (0.0, piece.height_m), piece.reflectivity));
            }
        }
        for &door in &self.doors {
            let is_closed = random.chance(CLOSED_SHARE);
            if is_closed && route.iter().all(|&at| CLEARANCE_M < door.distance_m(at)) {
                surfaces.push(Surface::solid(door, (0.0, ceiling_m), DOOR_REFLECTIVITY));
            }
        }
        surfaces
    }
}
