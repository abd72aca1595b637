//! What a beam meets: surfaces, people, floor and ceiling.

use nalgebra::Vector3;

use crate::people::{PERSON_HEIGHT_M, PERSON_RADIUS_M};
use crate::plane::{Point, Vector, cross};
use crate::random::Random;
use crate::world::{Entry, Material, World, beyond, meet};

/// Nothing beyond this returns (HDL-32E data sheet 97-0038: "80 m - 100 m") \[m\].
pub(crate) const MAX_RANGE_M: f64 = 100.0;
/// Share of the beams that return from a pane; of those that meet it nearly square, as its own
/// reflection comes back, nearly all do. Guesses.
const GLASS_RETURNS: f64 = 0.06;
const SQUARE_GLASS_RETURNS: f64 = 0.9;
/// Cosine from which a beam meets a pane square: 1.5 deg.
const SQUARE_COSINE: f64 = 0.999_66;
/// Share of the beams into a crown that end there, and how deep at most \[m\]. Guesses.
const FOLIAGE_RETURNS: f64 = 0.8;
const FOLIAGE_DEPTH_M: f64 = 1.2;
/// Half the width of a beam: about 3 mrad wide, a guess from the size of its spot \[rad\].
const HALF_WIDTH_RAD: f64 = 0.0015;
/// Nearer than this two surfaces are one, and farther than that the nearer one alone is timed: the
/// pulse is about 5 ns long \[m\].
const MIXED_M: (f64, f64) = (0.05, 1.2);
const FLOOR_REFLECTIVITY: f64 = 0.25;
const CEILING_REFLECTIVITY: f64 = 0.7;
const CLOTH_REFLECTIVITY: f64 = 0.35;

/// A beam from the sensor, its direction of length 1, in the map frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ray {
    pub(crate) from: Vector3<f64>,
    pub(crate) direction: Vector3<f64>,
}

/// What comes back, before noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Echo {
    pub(crate) range_m: f64,
    /// Cosine of the angle between the beam and the surface's normal.
    pub(crate) cosine: f64,
    pub(crate) reflectivity: f64,
    /// Whether something behind returns too.
    pub(crate) is_partial: bool,
    /// The surface, where it is one with an edge.
    surface: Option<u32>,
}

/// What beams of one moment can meet.
pub(crate) struct Scene<'a> {
    pub(crate) world: &'a World,
    pub(crate) people: &'a [Point],
    /// Height of the ceiling above the sensor, infinite outdoors \[m\].
    pub(crate) ceiling_m: f64,
    /// What lies in the direction of the beams, just before and just after them.
    pub(crate) columns: (&'a [Entry], &'a [Entry]),
}

/// Surfaces met by one beam that are kept.
const MAX_HITS: usize = 32;

struct Hits {
    hits: [(f64, u32); MAX_HITS],
    n: usize,
}

impl Hits {
    /// Keeps them in order of range.
    #[inline]
    fn insert(&mut self, range_m: f64, surface: u32) {
        let mut at = self.n.min(MAX_HITS - 1);
        while 0 < at && range_m < self.hits[at - 1].0 {
            self.hits[at] = self.hits[at - 1];
            at -= 1;
        }
        self.hits[at] = (range_m, surface);
        self.n = (self.n + 1).min(MAX_HITS);
    }
}

impl Scene<'_> {
    /// What returns from a beam, and what else does: behind a pane, or beside an edge.
    pub(crate) fn echoes(
        &self,
        ray: &Ray,
        mixed_pixels: f64,
        wants_second: bool,
        random: &mut Random,
    ) -> (Option<Echo>, Option<Echo>) {
        let Some(mut first) = self.echo(ray, 0.0, random) else { return (None, None) };
        if let Some(aside) = self.beside_edge(ray, &first) {
            let Some(other) = self.echo(&aside, 0.0, random) else { return (Some(first), None) };
            let gap_m = other.range_m - first.range_m;
            if MIXED_M.1 < gap_m.abs() {
                return (Some(first), wants_second.then_some(other));
            }
            if MIXED_M.0 < gap_m.abs() && random.chance(mixed_pixels) {
                first.range_m += random.uniform(0.0, 1.0) * gap_m;
            }
        } else if first.is_partial && wants_second {
            return (Some(first), self.echo(ray, first.range_m + 0.01, random));
        }
        (Some(first), None)
    }

    /// The first thing that returns, farther than `after_m`.
    fn echo(&self, ray: &Ray, after_m: f64, random: &mut Random) -> Option<Echo> {
        let surface = self.surface_echo(ray, after_m, random);
        let limit_m = surface.map_or(MAX_RANGE_M, |echo| echo.range_m);
        let person = self.person_echo(ray).filter(|p| after_m < p.range_m && p.range_m < limit_m);
        person.or(surface)
    }

    fn surface_echo(&self, ray: &Ray, after_m: f64, random: &mut Random) -> Option<Echo> {
        let rise = ray.direction.z;
        let over_ground = Vector::new(ray.direction.x, ray.direction.y);
        let floor_m = if rise < 0.0 { -ray.from.z / rise } else { f64::INFINITY };
        let limit_m = floor_m.min(MAX_RANGE_M);
        let mut hits = Hits { hits: [(0.0, 0); MAX_HITS], n: 0 };
        self.gather(ray, over_ground, limit_m, &mut hits);

        let mut ceiling_m = self.ceiling_m;
        let mut under_it_since_m = 0.0;
        for &(range_m, index) in &hits.hits[..hits.n] {
            if let Some(echo) = ceiling_echo(ray, ceiling_m, under_it_since_m, range_m)
                .filter(|e| after_m < e.range_m)
            {
                return Some(echo);
            }
            let surface = &self.world.surfaces()[index as usize];
            let z_m = ray.from.z + range_m * rise;
            if surface.z_low_m <= z_m && z_m <= surface.z_high_m && after_m < range_m {
                let along = surface.segment.end - surface.segment.start;
                let across = cross(along, over_ground);
                let cosine = across.abs() / along.norm();
                let (returns, depth_m) = match surface.material {
                    Material::Solid => (true, 0.0),
                    Material::Glass if SQUARE_COSINE < cosine => {
                        (random.chance(SQUARE_GLASS_RETURNS), 0.0)
                    }
                    Material::Glass => (random.chance(GLASS_RETURNS), 0.0),
                    // The sides of a crown go around it counter-clockwise: what lies left is within.
                    Material::Foliage if 0.0 < across => {
                        (random.chance(FOLIAGE_RETURNS), random.uniform(0.0, FOLIAGE_DEPTH_M))
                    }
                    Material::Foliage => (false, 0.0),
                };
                if returns {
                    let is_solid = surface.material == Material::Solid;
                    return Some(Echo {
                        range_m: range_m + depth_m,
                        // Leaves have no face.
                        cosine: if depth_m <= 0.0 { cosine } else { 1.0 },
                        reflectivity: surface.reflectivity,
                        is_partial: !is_solid,
                        surface: is_solid.then_some(index),
                    });
                }
            }
            if let Some(ceilings_m) = surface.ceilings_m {
                ceiling_m = beyond(&surface.segment, over_ground, ceilings_m);
                under_it_since_m = range_m;
            }
        }
        let ceiling = ceiling_echo(ray, ceiling_m, under_it_since_m, limit_m);
        ceiling.filter(|echo| after_m < echo.range_m).or_else(|| {
            (floor_m <= MAX_RANGE_M && after_m < floor_m)
                .then(|| level_echo(floor_m, rise, FLOOR_REFLECTIVITY))
        })
    }

    /// Meets the surfaces of both columns exactly.
    #[inline]
    fn gather(&self, ray: &Ray, over_ground: Vector, limit_m: f64, hits: &mut Hits) {
        let from = Point::new(ray.from.x, ray.from.y);
        let surfaces = self.world.surfaces();
        // A column belongs to a place a hand's breadth away, at most.
        let limit_on_ground_m = limit_m * over_ground.norm() * 1.01 + 0.3;
        let (before, after) = self.columns;
        for entry in before {
            if limit_on_ground_m < entry.distance_m {
                break;
            }
            if let Some(range_m) =
                meet(&surfaces[entry.surface as usize].segment, from, over_ground)
                && range_m <= limit_m
            {
                hits.insert(range_m, entry.surface);
            }
        }
        for (k, entry) in after.iter().enumerate() {
            if limit_on_ground_m < entry.distance_m {
                break;
            }
            let is_known = before.get(k).is_some_and(|other| other.surface == entry.surface)
                || before.iter().any(|other| other.surface == entry.surface);
            if !is_known
                && let Some(range_m) =
                    meet(&surfaces[entry.surface as usize].segment, from, over_ground)
                && range_m <= limit_m
            {
                hits.insert(range_m, entry.surface);
            }
        }
    }

    fn person_echo(&self, ray: &Ray) -> Option<Echo> {
        let from = Point::new(ray.from.x, ray.from.y);
        let over_ground = Vector::new(ray.direction.x, ray.direction.y);
        let norm = over_ground.norm();
        let of_person = |&person: &Point| {
            let way = person - from;
            let aside = cross(over_ground, way) / norm;
            let inside = PERSON_RADIUS_M * PERSON_RADIUS_M - aside * aside;
            let range_m = (way.dot(&over_ground) / norm - inside.max(0.0).sqrt()) / norm;
            let z_m = ray.from.z + range_m * ray.direction.z;
            let is_met = 0.0 <= inside && 0.0 < range_m && (0.0..=PERSON_HEIGHT_M).contains(&z_m);
            is_met.then(|| Echo {
                range_m,
                cosine: inside.max(0.0).sqrt() / PERSON_RADIUS_M * norm,
                reflectivity: CLOTH_REFLECTIVITY,
                is_partial: false,
                surface: None,
            })
        };
        (self.people.iter().filter_map(of_person)).min_by(|a, b| a.range_m.total_cmp(&b.range_m))
    }

    /// The other part of a beam that is split by an upright edge.
    fn beside_edge(&self, ray: &Ray, echo: &Echo) -> Option<Ray> {
        let segment = &self.world.surfaces()[echo.surface? as usize].segment;
        let hit = ray.from + ray.direction * echo.range_m;
        let hit = Point::new(hit.x, hit.y);
        let half_width_m = echo.range_m * HALF_WIDTH_RAD;
        let end = [segment.start, segment.end].into_iter().find(|end| {
            // Seen from the sensor an end is no farther aside than it is away.
            let way = end - hit;
            way.norm_squared() * echo.cosine * echo.cosine < half_width_m * half_width_m
        })?;
        let over_ground = Vector::new(ray.direction.x, ray.direction.y);
        let turn = HALF_WIDTH_RAD * cross(over_ground, end - hit).signum();
        let d = ray.direction;
        // The cosine of so small an angle is 1, to a millionth.
        let direction = Vector3::new(d.x - turn * d.y, d.y + turn * d.x, d.z);
        Some(Ray { from: ray.from, direction: direction.normalize() })
    }
}

/// The ceiling, where a beam reaches it between two ranges.
#[inline]
fn ceiling_echo(ray: &Ray, ceiling_m: f64, from_m: f64, to_m: f64) -> Option<Echo> {
    let rise = ray.direction.z;
    let range_m = (ceiling_m - ray.from.z) / rise;
    (0.0 < rise && from_m <= range_m && range_m < to_m)
        .then(|| level_echo(range_m, rise, CEILING_REFLECTIVITY))
}

fn level_echo(range_m: f64, rise: f64, reflectivity: f64) -> Echo {
    Echo { range_m, cosine: rise.abs(), reflectivity, is_partial: false, surface: None }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plane::{Rect, outline};
    use crate::random::Purpose;
    use crate::world::{Surface, prism};

    /// A room of 10 x 6 m below a ceiling of 2.7 m; the sensor in its middle, 0.8 m high.
    fn room(more: Vec<Surface>) -> World {
        let room = Rect::new(Point::new(-5.0, -3.0), Point::new(5.0, 3.0));
        let wall = |segment| Surface::solid(segment, (0.0, 2.7), 0.5);
        let mut surfaces: Vec<Surface> = outline(&[room], &[]).into_iter().map(wall).collect();
        surfaces.extend(more);
        World::new(surfaces, vec![(room, 2.7)])
    }

    fn echo(world: &World, people: &[Point], bearing_deg: f64, elevation_deg: f64) -> Echo {
        let (sin, cos) = libm::sincos(bearing_deg.to_radians());
        let (up, level) = libm::sincos(elevation_deg.to_radians());
        let mut column = Vec::new();
        let place = (Point::origin(), 0.8);
        world.column(place, Vector::new(cos, sin), (MAX_RANGE_M, 1.0), &mut column);
        let scene = Scene { world, people, ceiling_m: 2.7, columns: (&column, &column) };
        let ray = Ray {
            from: Vector3::new(0.0, 0.0, 0.8),
            direction: Vector3::new(level * cos, level * sin, up),
        };
        scene.echo(&ray, 0.0, &mut Random::new(2, Purpose::Noise, 0, 0)).unwrap()
    }

    #[track_caller]
    fn check(found: f64, expected: f64) {
        assert!((found - expected).abs() < 1e-4, "{found}, expected {expected}");
    }

    /// Ahead 5 m, aside 3 m; 3 / sin 45 deg = 4.2426 m. Down by 30 deg: 0.8 / sin = 1.6 m to the
    /// floor. Down by 1.3333 deg: 3 / cos = 3.0008 m to the wall. Up by 21.3333 deg: 1.9 / sin =
    /// 5.2227 m to the ceiling ahead, but 3 / cos = 3.2207 m to a side wall.
    #[test]
    fn walls_floor_and_ceiling() {
        let room = room(Vec::new());
        for (bearing, elevation, expected) in [
            (0.0, 0.0, 5.0),
            (90.0, 0.0, 3.0),
            (45.0, 0.0, 4.2426),
            (0.0, -30.0, 1.6),
            (90.0, -4.0 / 3.0, 3.0008),
            (0.0, 64.0 / 3.0, 5.2227),
            (90.0, 64.0 / 3.0, 3.2207),
        ] {
            check(echo(&room, &[], bearing, elevation).range_m, expected);
        }
        // The cosine of 45 deg at the wall, and the sine of 30 deg on the floor.
        check(echo(&room, &[], 45.0, 0.0).cosine, std::f64::consts::FRAC_1_SQRT_2);
        check(echo(&room, &[], 0.0, -30.0).cosine, 0.5);
    }

    /// A table of 0.7 m stands 2 m ahead: a beam that is down by 5 deg is 0.625 m high there and
    /// meets it at 2 / cos = 2.0076 m; the level one passes over it.
    #[test]
    fn beams_pass_over_a_table() {
        let table = Rect::new(Point::new(2.0, -1.0), Point::new(3.0, 1.0));
        let room = room(prism(&table.corners(), (0.0, 0.7), 0.5));
        check(echo(&room, &[], 0.0, -5.0).range_m, 2.0076);
        check(echo(&room, &[], 0.0, 0.0).range_m, 5.0);
    }

    /// A person 2 m ahead and 1 m to the left is met at 26.565 deg, at sqrt(5) - 0.25 = 1.9861 m;
    /// a beam up by 40 deg is 2.4 m high there.
    #[test]
    fn a_person_to_the_left() {
        let (room, person) = (room(Vec::new()), [Point::new(2.0, 1.0)]);
        check(echo(&room, &person, 26.565, 0.0).range_m, 1.9861);
        check(echo(&room, &person, -26.565, 0.0).range_m, 5.5902); // 5 / cos 26.565 deg, the wall
        check(echo(&room, &person, 26.565, 40.0).range_m, 1.9 / 0.642_788); // the ceiling
    }

    /// Out of a low room through a door into a hall of 6 m: up by 20 deg the beam is 1.53 m high at
    /// the door 2 m ahead, below its lintel, and 3.35 m at the hall's end 7 m ahead: no ceiling of
    /// 2.7 m there. Up by 50 deg it meets the low one at 1.9 / sin = 2.4803 m.
    #[test]
    fn beyond_a_lintel_the_ceiling_is_another() {
        let (room, hall) = (
            Rect::new(Point::new(-5.0, -3.0), Point::new(2.0, 3.0)),
            Rect::new(Point::new(2.0, -3.0), Point::new(7.0, 3.0)),
        );
        let wall = |segment| Surface::solid(segment, (0.0, 6.0), 0.5);
        let mut surfaces: Vec<Surface> =
            outline(&[room, hall], &[]).into_iter().map(wall).collect();
        let lintel = prism(&hall.corners(), (2.7, 6.0), 0.5).into_iter();
        surfaces.extend(lintel.map(|s| Surface { ceilings_m: Some((6.0, 2.7)), ..s }));
        let world = World::new(surfaces, vec![(room, 2.7), (hall, 6.0)]);
        check(echo(&world, &[], 0.0, 20.0).range_m, 7.0 / 0.939_693);
        check(echo(&world, &[], 0.0, 50.0).range_m, 2.480_27);
    }

    /// A pane square to the beam returns, one that is slanted by more than 1.5 deg hardly ever.
    #[test]
    fn glass_returns_where_it_is_square() {
        let pane = Rect::new(Point::new(3.0, -2.5), Point::new(3.1, 2.5)).corners();
        let panes = prism(&pane, (0.0, 2.7), 0.3).into_iter();
        let room = room(panes.map(|s| Surface { material: Material::Glass, ..s }).collect());
        check(echo(&room, &[], 0.0, 0.0).range_m, 3.0);
        check(echo(&room, &[], 20.0, 0.0).range_m, 5.0 / 0.939_693);
    }
}
