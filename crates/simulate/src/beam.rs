//! Intersection of beams with surfaces, people, the floor and ceilings.

use nalgebra::Vector3;

use crate::people::{PERSON_HEIGHT_M, PERSON_RADIUS_M};
use crate::plane::{Point, Vector, cross};
use crate::random::Random;
use crate::world::{Entry, Material, World, ceiling_behind, intersect};

/// Maximum range (HDL-32E data sheet 97-0038: "80 m - 100 m") \[m\].
pub(crate) const MAX_RANGE_M: f64 = 100.0;
/// Fraction of the beams that return from glass at oblique incidence. A guess.
const OBLIQUE_GLASS_RETURNS: f64 = 0.06;
/// Fraction of the beams that return from glass at normal incidence, by specular reflection. A guess.
const NORMAL_GLASS_RETURNS: f64 = 0.9;
/// Cosine of the largest angle that counts as normal incidence: 1.5 deg.
const NORMAL_COSINE: f64 = 0.999_66;
/// Fraction of the beams into the crown of a tree that return from inside it. A guess.
const FOLIAGE_RETURNS: f64 = 0.8;
/// Largest depth inside the crown at which they return \[m\]. A guess.
const FOLIAGE_DEPTH_M: f64 = 1.2;
/// Half the divergence of a beam \[rad\]. The full divergence of 3 mrad is a guess from the size of the
/// spot.
const HALF_WIDTH_RAD: f64 = 0.0015;
/// Minimum and maximum distance between two surfaces that a split beam can mix \[m\]. Nearer surfaces
/// count as one. With farther surfaces the sensor times the nearer one only, because the pulse is
/// about 5 ns long.
const MIXED_M: (f64, f64) = (0.05, 1.2);
const FLOOR_REFLECTIVITY: f64 = 0.25;
const CEILING_REFLECTIVITY: f64 = 0.7;
const CLOTH_REFLECTIVITY: f64 = 0.35;

/// A beam from the sensor, in the map frame. Its direction is a unit vector.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ray {
    pub(crate) from: Vector3<f64>,
    pub(crate) direction: Vector3<f64>,
}

/// A return before noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Echo {
    pub(crate) range_m: f64,
    /// Cosine of the angle between the beam and the surface's normal.
    pub(crate) cosine: f64,
    pub(crate) reflectivity: f64,
    /// Whether a surface behind this one can return as well.
    pub(crate) is_partial: bool,
    /// Index of the surface, if it has edges.
    surface: Option<u32>,
}

/// Everything that beams at one moment can hit.
pub(crate) struct Scene<'a> {
    pub(crate) world: &'a World,
    pub(crate) people: &'a [Point],
    /// Height of the ceiling above the sensor; infinite outdoors \[m\].
    pub(crate) ceiling_m: f64,
    /// The columns with bearings just before and just after the beams.
    pub(crate) columns: (&'a [Entry], &'a [Entry]),
}

/// Largest number of surfaces kept per beam.
const MAX_HITS: usize = 32;

struct Hits {
    hits: [(f64, u32); MAX_HITS],
    n: usize,
}

impl Hits {
    /// Inserts a hit in order of range.
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
    /// The first return of a beam, and a second one from behind glass or from past an edge.
    pub(crate) fn echoes(
        &self,
        ray: &Ray,
        mixed_pixels: f64,
        wants_second: bool,
        random: &mut Random,
    ) -> (Option<Echo>, Option<Echo>) {
        let Some(mut first) = self.echo(ray, 0.0, random) else { return (None, None) };
        if let Some(aside) = self.ray_past_edge(ray, &first) {
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

    /// The nearest return that is farther than `after_m`.
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
                    Material::Glass if NORMAL_COSINE < cosine => {
                        (random.chance(NORMAL_GLASS_RETURNS), 0.0)
                    }
                    Material::Glass => (random.chance(OBLIQUE_GLASS_RETURNS), 0.0),
                    // The sides of a crown run counter-clockwise: the left side is inside.
                    Material::Foliage if 0.0 < across => {
                        (random.chance(FOLIAGE_RETURNS), random.uniform(0.0, FOLIAGE_DEPTH_M))
                    }
                    Material::Foliage => (false, 0.0),
                };
                if returns {
                    let is_solid = surface.material == Material::Solid;
                    return Some(Echo {
                        range_m: range_m + depth_m,
                        // Leaves have no common orientation.
                        cosine: if depth_m <= 0.0 { cosine } else { 1.0 },
                        reflectivity: surface.reflectivity,
                        is_partial: !is_solid,
                        surface: is_solid.then_some(index),
                    });
                }
            }
            if let Some(ceilings_m) = surface.ceilings_m {
                ceiling_m = ceiling_behind(&surface.segment, over_ground, ceilings_m);
                under_it_since_m = range_m;
            }
        }
        let ceiling = ceiling_echo(ray, ceiling_m, under_it_since_m, limit_m);
        ceiling.filter(|echo| after_m < echo.range_m).or_else(|| {
            (floor_m <= MAX_RANGE_M && after_m < floor_m)
                .then(|| level_echo(floor_m, rise, FLOOR_REFLECTIVITY))
        })
    }

    /// Intersects a ray with the surfaces of both columns.
    #[inline]
    fn gather(&self, ray: &Ray, over_ground: Vector, limit_m: f64, hits: &mut Hits) {
        let from = Point::new(ray.from.x, ray.from.y);
        let surfaces = self.world.surfaces();
        // The columns were cast from positions a few centimetres away.
        let limit_on_ground_m = limit_m * over_ground.norm() * 1.01 + 0.3;
        let (before, after) = self.columns;
        for entry in before {
            if limit_on_ground_m < entry.distance_m {
                break;
            }
            if let Some(range_m) =
                intersect(&surfaces[entry.surface as usize].segment, from, over_ground)
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
                    intersect(&surfaces[entry.surface as usize].segment, from, over_ground)
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
            let to_person = person - from;
            let aside = cross(over_ground, to_person) / norm;
            let inside = PERSON_RADIUS_M * PERSON_RADIUS_M - aside * aside;
            let range_m = (to_person.dot(&over_ground) / norm - inside.max(0.0).sqrt()) / norm;
            let z_m = ray.from.z + range_m * ray.direction.z;
            let is_hit = 0.0 <= inside && 0.0 < range_m && (0.0..=PERSON_HEIGHT_M).contains(&z_m);
            is_hit.then(|| Echo {
                range_m,
                cosine: inside.max(0.0).sqrt() / PERSON_RADIUS_M * norm,
                reflectivity: CLOTH_REFLECTIVITY,
                is_partial: false,
                surface: None,
            })
        };
        (self.people.iter().filter_map(of_person)).min_by(|a, b| a.range_m.total_cmp(&b.range_m))
    }

    /// The other part of a beam that is split by a vertical edge.
    fn ray_past_edge(&self, ray: &Ray, echo: &Echo) -> Option<Ray> {
        let segment = &self.world.surfaces()[echo.surface? as usize].segment;
        let hit = ray.from + ray.direction * echo.range_m;
        let hit = Point::new(hit.x, hit.y);
        let half_width_m = echo.range_m * HALF_WIDTH_RAD;
        let end = [segment.start, segment.end].into_iter().find(|end| {
            // The cosine projects the distance to the end across the beam.
            let to_end = end - hit;
            to_end.norm_squared() * echo.cosine * echo.cosine < half_width_m * half_width_m
        })?;
        let over_ground = Vector::new(ray.direction.x, ray.direction.y);
        let angle_rad = HALF_WIDTH_RAD * cross(over_ground, end - hit).signum();
        let d = ray.direction;
        // The cosine of this angle is 1 to within 1.2e-6.
        let direction = Vector3::new(d.x - angle_rad * d.y, d.y + angle_rad * d.x, d.z);
        Some(Ray { from: ray.from, direction: direction.normalize() })
    }
}

/// The return from the ceiling, if the beam hits it between two ranges.
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

    /// A room of 10 x 6 m with a ceiling of 2.7 m. The sensor is in the middle, 0.8 m high.
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

    /// The wall ahead is 5 m away and the wall to the side 3 m; at 45 deg the range is 3 / sin =
    /// 4.2426 m. Down by 30 deg: 0.8 / sin = 1.6 m to the floor. Down by 1.3333 deg: 3 / cos =
    /// 3.0008 m to the side wall. Up by 21.3333 deg: 1.9 / sin = 5.2227 m to the ceiling ahead, but
    /// 3 / cos = 3.2207 m to the side wall.
    #[test]
    fn beams_hit_walls_floor_and_ceiling() {
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
        // Incidence: the cosine of 45 deg at the wall, and the sine of 30 deg on the floor.
        check(echo(&room, &[], 45.0, 0.0).cosine, std::f64::consts::FRAC_1_SQRT_2);
        check(echo(&room, &[], 0.0, -30.0).cosine, 0.5);
    }

    /// A table 0.7 m high is 2 m ahead. A beam down by 5 deg is 0.625 m high there and hits it at
    /// 2 / cos = 2.0076 m. The level beam passes over it.
    #[test]
    fn a_level_beam_passes_over_a_table() {
        let table = Rect::new(Point::new(2.0, -1.0), Point::new(3.0, 1.0));
        let room = room(prism(&table.corners(), (0.0, 0.7), 0.5));
        check(echo(&room, &[], 0.0, -5.0).range_m, 2.0076);
        check(echo(&room, &[], 0.0, 0.0).range_m, 5.0);
    }

    /// A beam at 26.565 deg hits a person 2 m ahead and 1 m to the left at sqrt(5) - 0.25 =
    /// 1.9861 m. A beam up by 40 deg is 2.4 m high there.
    #[test]
    fn a_beam_hits_a_person_to_the_left() {
        let (room, person) = (room(Vec::new()), [Point::new(2.0, 1.0)]);
        check(echo(&room, &person, 26.565, 0.0).range_m, 1.9861);
        check(echo(&room, &person, -26.565, 0.0).range_m, 5.5902); // 5 / cos 26.565 deg, the wall
        check(echo(&room, &person, 26.565, 40.0).range_m, 1.9 / 0.642_788); // the ceiling
    }

    /// From a low room through a door into a hall 6 m high. Up by 20 deg the beam is 1.53 m high at
    /// the door 2 m ahead, below its lintel, and 3.35 m high at the end of the hall 7 m ahead, where
    /// the ceiling is higher than 2.7 m. Up by 50 deg it hits the low ceiling at 1.9 / sin =
    /// 2.4803 m.
    #[test]
    fn the_ceiling_changes_behind_a_lintel() {
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

    /// Glass returns a beam at normal incidence. At more than 1.5 deg it rarely does.
    #[test]
    fn glass_returns_beams_at_normal_incidence() {
        let pane = Rect::new(Point::new(3.0, -2.5), Point::new(3.1, 2.5)).corners();
        let panes = prism(&pane, (0.0, 2.7), 0.3).into_iter();
        let room = room(panes.map(|s| Surface { material: Material::Glass, ..s }).collect());
        check(echo(&room, &[], 0.0, 0.0).range_m, 3.0);
        check(echo(&room, &[], 20.0, 0.0).range_m, 5.0 / 0.939_693);
    }
}
