//! Where drives take place: a building that stands alone, a campus, or a map.
//!
//! ```text
//!   +-------+ +---------+ +------+ +--------+      Buildings stand on both sides of a strip with
//!   |       | |         | |      | |        |      trees and parked cars. Two lanes, one to either
//!   +--| |--+ +---| |---+ +-| |--+ +---| |--+      side, pass their entrances and close a ring at
//!   .---o----------o---------o---------o-----.     the ends. The dock `D`, the origin of the map,
//! D-+    T  =  T    =  T  =    T  =   T      |     lies before the western end: from there one
//!   '----------o---------o----------o--------'     drive begins with the northern lane, the next
//!          +--| |--+ +--| |---+ +---| |---+        with the southern one.
//!          |       | |        | |         |
//!          +-------+ +--------+ +---------+
//! ```

use crate::day::{building_of_day, facades, round, turned};
use crate::map::Map;
use crate::map_day::Loose;
use crate::plan::{Plan, Shape, corridors};
use crate::plane::{Point, Rect, Segment, Vector};
use crate::random::Random;
use crate::route::Route;
use crate::world::{Material, Surface, World, prism};

/// Distance of either lane from the middle of the strip \[m\].
const LANE_M: f64 = 5.4;
/// Way from the dock to the western end \[m\]: whole steps of the route, so that it begins exactly
/// there.
const DOCK_M: f64 = 8.1;
/// Share of the parking spaces that are taken on a day.
const PARKED_SHARE: f64 = 0.6;
/// Size of a car, and of what of it is above the belt line \[m\].
const CAR_M: (f64, f64) = (4.3, 1.8);
const CABIN_M: (f64, f64) = (2.3, 1.6);
/// A car from above the ground to the belt line, and from there to the roof \[m\].
const CAR_HEIGHTS_M: (f64, f64, f64) = (0.18, 0.95, 1.45);
/// What a map does not tell.
const MAP_CEILING_M: f64 = 2.7;
const MAP_REFLECTIVITY: f64 = 0.5;
const BARK_REFLECTIVITY: f64 = 0.3;
const LEAF_REFLECTIVITY: f64 = 0.5;

/// A place, the same on every day.
#[derive(Debug, Clone)]
pub(crate) struct Site {
    buildings: Vec<Placed>,
    /// What stands outdoors on every day.
    fixed: Vec<Surface>,
    /// Parking spaces: middle, and direction of a car \[rad\].
    parking: Vec<(Point, f64)>,
    /// Where people walk, from and to.
    lanes: Vec<(Point, Point)>,
    /// Node by node around the lanes, from the western end, the northern lane first; none for a
    /// building that stands alone.
    ring: Vec<Stop>,
    map: Option<(Map, Loose)>,
}

/// A node of the ring.
#[derive(Debug, Clone, Copy)]
struct Stop {
    at: Point,
    /// The building whose entrance is here.
    building: Option<usize>,
}

/// A building where it stands.
#[derive(Debug, Clone)]
struct Placed {
    plan: Plan,
    /// Where its own origin is.
    origin: Point,
    /// Whether it is turned by half a circle about that.
    is_turned: bool,
}

impl Placed {
    fn point(&self, own: Point) -> Point {
        let sign = if self.is_turned { -1.0 } else { 1.0 };
        self.origin + own.coords * sign
    }

    fn segment(&self, own: Segment) -> Segment {
        Segment { start: self.point(own.start), end: self.point(own.end) }
    }

    fn rect(&self, own: &Rect) -> Rect {
        Rect::new(self.point(Point::new(own.x0, own.y0)), self.point(Point::new(own.x1, own.y1)))
    }

    fn surfaces(&self, own: Vec<Surface>) -> impl Iterator<Item = Surface> + '_ {
        own.into_iter().map(|surface| Surface { segment: self.segment(surface.segment), ..surface })
    }
}

impl Site {
    /// A building of 120 m x 80 m without a world around it.
    pub(crate) fn building(random: &mut Random) -> Self {
        let plan = Plan::new(&Shape::alone(), random);
        Self {
            lanes: corridors(&plan.nodes),
            buildings: vec![Placed { plan, origin: Point::origin(), is_turned: false }],
            fixed: Vec::new(),
            parking: Vec::new(),
            ring: Vec::new(),
            map: None,
        }
    }

    /// A map's walls, below one ceiling, with doors in its doorways and furniture.
    pub(crate) fn on_map(map: Map, random: &mut Random) -> Self {
        let wall = |segment| Surface::solid(segment, (0.0, MAP_CEILING_M), MAP_REFLECTIVITY);
        let lanes = map.lanes(random);
        let loose = Loose::draw(&map, random);
        Self {
            buildings: Vec::new(),
            fixed: map.walls().into_iter().map(wall).collect(),
            parking: Vec::new(),
            lanes,
            ring: Vec::new(),
            map: Some((map, loose)),
        }
    }

    /// A campus.
    pub(crate) fn campus(n_buildings: u32, random: &mut Random) -> Self {
        let n_north = n_buildings.div_ceil(2) as usize;
        let mut site = Self {
            buildings: Vec::new(),
            fixed: Vec::new(),
            parking: Vec::new(),
            lanes: Vec::new(),
            ring: Vec::new(),
            map: None,
        };
        let mut rows = [(Vec::new(), DOCK_M + 6.0), (Vec::new(), DOCK_M + 6.0)];
        for building in 0..n_buildings as usize {
            let plan = Plan::new(&Shape::on_campus(random), random);
            let is_turned = n_north <= building;
            let (stops, x) = &mut rows[usize::from(is_turned)];
            let facade_m = LANE_M + random.uniform(5.0, 9.0);
            let width = plan.building.width();
            let origin = match is_turned {
                false => Point::new(*x, facade_m),
                true => Point::new(*x + width, -facade_m),
            };
            let placed = Placed { plan, origin, is_turned };
            let at = Point::new(placed.door().x, if is_turned { -LANE_M } else { LANE_M });
            stops.push(Stop { at, building: Some(building) });
            let gap_m = random.uniform(9.0, 16.0);
            site.add_car_park(*x + width + gap_m / 2.0, facade_m, is_turned, random);
            *x += width + gap_m;
            site.buildings.push(placed);
        }
        let [(north, north_m), (south, south_m)] = rows;
        let east_m = north_m.max(south_m) + 4.0;
        let corner = |x, y| Stop { at: Point::new(x, y), building: None };
        site.ring.push(corner(DOCK_M, LANE_M));
        site.ring.extend(north);
        site.ring.push(corner(east_m, LANE_M));
        site.ring.push(corner(east_m, -LANE_M));
        site.ring.extend(south.into_iter().rev());
        site.ring.push(corner(DOCK_M, -LANE_M));
        site.add_strip(east_m, random);
        for placed in &site.buildings {
            site.fixed.extend(placed.surfaces(facades(&placed.plan)));
            let inside = corridors(&placed.plan.nodes);
            site.lanes.extend(inside.into_iter().map(|(a, b)| (placed.point(a), placed.point(b))));
        }
        let next = site.ring.iter().cycle().skip(1);
        let outside = site.ring.iter().zip(next).map(|(a, b)| (a.at, b.at));
        site.lanes.extend(outside.filter(|(a, b)| 4.0 < (b - a).norm()).collect::<Vec<_>>());
        site
    }

    /// Trees and parking spaces in the middle, and trees before the buildings.
    fn add_strip(&mut self, east_m: f64, random: &mut Random) {
        let mut x = DOCK_M + 5.0;
        while x < east_m - 4.0 {
            if random.chance(0.5) {
                self.add_tree(Point::new(x, random.uniform(-0.8, 0.8)), random);
                x += random.uniform(4.0, 9.0);
            } else {
                self.parking.push((Point::new(x + 2.2, 0.0), 0.0));
                x += 6.0 + random.uniform(0.0, 3.0);
            }
        }
        for side in [-1.0, 1.0] {
            let mut x = DOCK_M - 2.0;
            while x < east_m + 5.0 {
                let at = Point::new(x, side * (LANE_M + random.uniform(2.2, 3.2)));
                let is_in_way = |stop: &Stop| {
                    stop.building.is_some() && (stop.at - at).norm() < 4.5 && stop.at.y * side > 0.0
                };
                if !self.ring.iter().any(is_in_way) {
                    self.add_tree(at, random);
                }
                x += random.uniform(7.0, 18.0);
            }
        }
    }

    /// A trunk, and leaves above.
    fn add_tree(&mut self, at: Point, random: &mut Random) {
        let (trunk_m, crown_m) = (random.uniform(0.1, 0.28), random.uniform(1.1, 2.0));
        let (from_m, to_m) = (random.uniform(1.9, 2.6), random.uniform(4.0, 9.0));
        self.fixed.extend(prism(&round(at, trunk_m), (0.0, from_m), BARK_REFLECTIVITY));
        let crown = prism(&round(at, crown_m), (from_m, to_m), LEAF_REFLECTIVITY);
        let leaves = |surface| Surface { material: Material::Foliage, ..surface };
        self.fixed.extend(crown.into_iter().map(leaves));
    }

    /// Parking spaces in the gap between two buildings.
    fn add_car_park(&mut self, x: f64, facade_m: f64, is_south: bool, random: &mut Random) {
        let side = if is_south { -1.0 } else { 1.0 };
        for row in 0..3 {
            let y = side * (facade_m + 4.0 + 6.0 * f64::from(row));
            let angle = std::f64::consts::FRAC_PI_2 + 0.05 * random.normal();
            self.parking.push((Point::new(x + 0.5 * random.normal(), y), angle));
        }
    }

    /// Everything that stands there on one day, on which the robot drives along `way`.
    pub(crate) fn day(&self, way: &[Point], random: &mut Random) -> World {
        let mut surfaces = self.fixed.clone();
        let mut ceilings = Vec::new();
        for placed in &self.buildings {
            let plan = &placed.plan;
            surfaces.extend(placed.surfaces(building_of_day(plan, random)));
            ceilings.push((placed.rect(&plan.building), plan.ceiling_m));
            ceilings.push((placed.rect(&plan.atrium), plan.atrium_ceiling_m));
        }
        if let Some((map, loose)) = &self.map {
            ceilings.push((map.extent(), MAP_CEILING_M));
            surfaces.extend(loose.day(map, way, MAP_CEILING_M, random));
        }
        for &(at, angle) in &self.parking {
            let is_taken = random.chance(PARKED_SHARE);
            let shift = Vector::new(0.3 * random.normal(), 0.1 * random.normal());
            let (scale, paint) = (random.uniform(0.85, 1.1), random.uniform(0.05, 0.8));
            if is_taken {
                surfaces.extend(car(at + shift, angle + 0.03 * random.normal(), scale, paint));
            }
        }
        World::new(surfaces, ceilings)
    }

    /// Corners of every building.
    pub(crate) fn outlines(&self) -> Vec<(Point, Point)> {
        let rects = self.buildings.iter().map(|placed| placed.rect(&placed.plan.building));
        rects.map(|r| (Point::new(r.x0, r.y0), Point::new(r.x1, r.y1))).collect()
    }

    /// Where people walk.
    pub(crate) fn lanes(&self) -> &[(Point, Point)] {
        &self.lanes
    }

    /// The way of log number `log`.
    pub(crate) fn route(&self, log: usize, random: &mut Random) -> Route {
        let is_clockwise = log % 2 == 1;
        if let Some((map, _)) = &self.map {
            return map.route(is_clockwise, random);
        }
        match self.ring.is_empty() {
            true => Route::in_building(&self.buildings[0].plan.nodes, is_clockwise, random),
            false => self.campus_route(log, is_clockwise, random),
        }
    }

    /// From the dock around the ring, in and out of every building: around the corridors of one to
    /// the left, of the next to the right. Two drives one after the other, which go around the ring
    /// in opposite directions, take each building the same way; the next two the other way.
    fn campus_route(&self, log: usize, is_clockwise: bool, random: &mut Random) -> Route {
        let mut ring = self.ring.clone();
        if !is_clockwise {
            ring.reverse();
        }
        let mut lap = Vec::new();
        for stop in &ring {
            lap.push(stop.at);
            if let Some(building) = stop.building {
                lap.extend(self.buildings[building].tour((building + log / 2) % 2 == 1));
                lap.push(stop.at);
            }
        }
        // The dock lies on the way from the last node to the first.
        Route::from_dock(DOCK_M, &lap, random)
    }
}

impl Placed {
    /// Where the entrance's corridor meets the facade.
    fn door(&self) -> Point {
        let column = self.plan.entrance.unwrap_or(0);
        self.point(Point::new(self.plan.nodes[column][0].x, 0.0))
    }

    /// Around the corridors, from the node behind the entrance back to it.
    fn tour(&self, is_reversed: bool) -> Vec<Point> {
        let nodes = &self.plan.nodes;
        let (entrance, last) = (self.plan.entrance.unwrap_or(0), nodes.len() - 1);
        // Along row 0 from the entrance to the right, back along the last row, and to the entrance.
        let top = nodes[0].len() - 1;
        let mut tour: Vec<Point> = (entrance..=last).map(|column| nodes[column][0]).collect();
        tour.extend((0..=last).rev().map(|column| nodes[column][top]));
        tour.extend((0..=entrance).map(|column| nodes[column][0]));
        if is_reversed {
            tour.reverse();
        }
        tour.into_iter().map(|node| self.point(node)).collect()
    }
}

/// A car: painted sheet, and panes above.
fn car(at: Point, angle: f64, scale: f64, paint: f64) -> Vec<Surface> {
    let scaled = |size: (f64, f64)| (size.0 * scale, size.1 * scale);
    let (ground_m, belt_m, roof_m) = CAR_HEIGHTS_M;
    let mut surfaces = prism(&turned(at, scaled(CAR_M), angle), (ground_m, belt_m * scale), paint);
    let cabin = prism(&turned(at, scaled(CABIN_M), angle), (belt_m * scale, roof_m * scale), 0.3);
    surfaces.extend(cabin.into_iter().map(|s| Surface { material: Material::Glass, ..s }));
    surfaces
}
