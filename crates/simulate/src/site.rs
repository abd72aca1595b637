//! The site of the drives: a single building, a campus, or a map.
//!
//! ```text
//!   +-------+ +---------+ +------+ +--------+      Buildings on both sides of a strip with trees
//!   |       | |         | |      | |        |      and parked cars. A lane on each side of the
//!   +--| |--+ +---| |---+ +-| |--+ +---| |--+      strip passes the entrances. The two lanes form
//!   .---o----------o---------o---------o-----.     a ring. The dock `D`, the origin of the map
//! D-+    T  =  T    =  T  =    T  =   T      |     frame, is at the western end. From there, drives
//!   '----------o---------o----------o--------'     alternate between starting on the northern
//!          +--| |--+ +--| |---+ +---| |---+        lane and on the southern lane.
//!          |       | |        | |         |
//!          +-------+ +--------+ +---------+
//! ```

use crate::day::{building_of_day, circle_polygon, facades, rotated_rect};
use crate::map::Map;
use crate::map_day::Movables;
use crate::plan::{Plan, Shape, corridors};
use crate::plane::{Point, Rect, Segment, Vector};
use crate::random::Random;
use crate::route::Route;
use crate::world::{Material, Surface, World, prism};

/// Distance of each lane from the middle of the strip \[m\].
const LANE_M: f64 = 5.4;
/// Distance from the dock to the western end of the ring \[m\]: a whole number of control point
/// spacings, so that the route starts exactly at the dock.
const DOCK_M: f64 = 8.1;
/// Fraction of the parking spaces that are occupied on a given day.
const PARKED_SHARE: f64 = 0.6;
/// Length and width of a car \[m\].
const CAR_M: (f64, f64) = (4.3, 1.8);
/// Length and width of the cabin, above the belt line \[m\].
const CABIN_M: (f64, f64) = (2.3, 1.6);
/// Heights of the underside, the belt line and the roof of a car \[m\].
const CAR_HEIGHTS_M: (f64, f64, f64) = (0.18, 0.95, 1.45);
/// Height of the ceiling of a map, which a map does not contain \[m\].
const MAP_CEILING_M: f64 = 2.7;
/// Reflectivity of the walls of a map, which a map does not contain.
const MAP_REFLECTIVITY: f64 = 0.5;
const BARK_REFLECTIVITY: f64 = 0.3;
const LEAF_REFLECTIVITY: f64 = 0.5;

/// The permanent part of a site.
#[derive(Debug, Clone)]
pub(crate) struct Site {
    buildings: Vec<PlacedBuilding>,
    /// Permanent surfaces outdoors.
    fixed: Vec<Surface>,
    /// Parking spaces: centre, and orientation of a car \[rad\].
    parking: Vec<(Point, f64)>,
    /// Start and end of the lanes in which people walk.
    lanes: Vec<(Point, Point)>,
    /// Nodes along the two lanes, from the western end, with the northern lane first. Empty for a
    /// single building and for a map.
    ring: Vec<Stop>,
    map: Option<(Map, Movables)>,
}

/// A node of the ring.
#[derive(Debug, Clone, Copy)]
struct Stop {
    at: Point,
    /// The building whose entrance is here.
    building: Option<usize>,
}

/// A building at its position on the site.
#[derive(Debug, Clone)]
struct PlacedBuilding {
    plan: Plan,
    /// Origin of the building in the map frame.
    origin: Point,
    /// Whether the building is rotated by 180 deg about its origin.
    is_rotated: bool,
}

impl PlacedBuilding {
    fn point(&self, local: Point) -> Point {
        let sign = if self.is_rotated { -1.0 } else { 1.0 };
        self.origin + local.coords * sign
    }

    fn segment(&self, local: Segment) -> Segment {
        Segment { start: self.point(local.start), end: self.point(local.end) }
    }

    fn rect(&self, local: &Rect) -> Rect {
        Rect::new(
            self.point(Point::new(local.x0, local.y0)),
            self.point(Point::new(local.x1, local.y1)),
        )
    }

    fn surfaces(&self, local: Vec<Surface>) -> impl Iterator<Item = Surface> + '_ {
        local
            .into_iter()
            .map(|surface| Surface { segment: self.segment(surface.segment), ..surface })
    }
}

impl Site {
    /// A single building of 120 m x 80 m without surroundings.
    pub(crate) fn building(random: &mut Random) -> Self {
        let plan = Plan::new(&Shape::alone(), random);
        Self {
            lanes: corridors(&plan.nodes),
            buildings: vec![PlacedBuilding { plan, origin: Point::origin(), is_rotated: false }],
            fixed: Vec::new(),
            parking: Vec::new(),
            ring: Vec::new(),
            map: None,
        }
    }

    /// The walls of a map under one ceiling, with doors in its doorways and with furniture.
    pub(crate) fn on_map(map: Map, random: &mut Random) -> Self {
        let wall = |segment| Surface::solid(segment, (0.0, MAP_CEILING_M), MAP_REFLECTIVITY);
        let lanes = map.lanes(random);
        let movables = Movables::draw(&map, random);
        Self {
            buildings: Vec::new(),
            fixed: map.walls().into_iter().map(wall).collect(),
            parking: Vec::new(),
            lanes,
            ring: Vec::new(),
            map: Some((map, movables)),
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
            let is_rotated = n_north <= building;
            let (stops, x) = &mut rows[usize::from(is_rotated)];
            let facade_m = LANE_M + random.uniform(5.0, 9.0);
            let width = plan.building.width();
            let origin = match is_rotated {
                false => Point::new(*x, facade_m),
                true => Point::new(*x + width, -facade_m),
            };
            let placed = PlacedBuilding { plan, origin, is_rotated };
            let at = Point::new(placed.door().x, if is_rotated { -LANE_M } else { LANE_M });
            stops.push(Stop { at, building: Some(building) });
            let gap_m = random.uniform(9.0, 16.0);
            site.add_car_park(*x + width + gap_m / 2.0, facade_m, is_rotated, random);
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

    /// Adds trees and parking spaces in the middle of the strip, and trees in front of the buildings.
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

    /// Adds a tree: a trunk with a crown of leaves above it.
    fn add_tree(&mut self, at: Point, random: &mut Random) {
        let (trunk_m, crown_m) = (random.uniform(0.1, 0.28), random.uniform(1.1, 2.0));
        let (from_m, to_m) = (random.uniform(1.9, 2.6), random.uniform(4.0, 9.0));
        self.fixed.extend(prism(&circle_polygon(at, trunk_m), (0.0, from_m), BARK_REFLECTIVITY));
        let crown = prism(&circle_polygon(at, crown_m), (from_m, to_m), LEAF_REFLECTIVITY);
        let leaves = |surface| Surface { material: Material::Foliage, ..surface };
        self.fixed.extend(crown.into_iter().map(leaves));
    }

    /// Adds parking spaces in the gap between two buildings.
    fn add_car_park(&mut self, x: f64, facade_m: f64, is_south: bool, random: &mut Random) {
        let side = if is_south { -1.0 } else { 1.0 };
        for row in 0..3 {
            let y = side * (facade_m + 4.0 + 6.0 * f64::from(row));
            let angle = std::f64::consts::FRAC_PI_2 + 0.05 * random.normal();
            self.parking.push((Point::new(x + 0.5 * random.normal(), y), angle));
        }
    }

    /// The world on one day. `path` is the path of the robot on that day.
    pub(crate) fn day(&self, path: &[Point], random: &mut Random) -> World {
        let mut surfaces = self.fixed.clone();
        let mut ceilings = Vec::new();
        for placed in &self.buildings {
            let plan = &placed.plan;
            surfaces.extend(placed.surfaces(building_of_day(plan, random)));
            ceilings.push((placed.rect(&plan.building), plan.ceiling_m));
            ceilings.push((placed.rect(&plan.atrium), plan.atrium_ceiling_m));
        }
        if let Some((map, movables)) = &self.map {
            ceilings.push((map.extent(), MAP_CEILING_M));
            surfaces.extend(movables.day(map, path, MAP_CEILING_M, random));
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

    /// Opposite corners of every building.
    pub(crate) fn outlines(&self) -> Vec<(Point, Point)> {
        let rects = self.buildings.iter().map(|placed| placed.rect(&placed.plan.building));
        rects.map(|r| (Point::new(r.x0, r.y0), Point::new(r.x1, r.y1))).collect()
    }

    /// Lanes in which people walk.
    pub(crate) fn lanes(&self) -> &[(Point, Point)] {
        &self.lanes
    }

    /// The route of a log.
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

    /// A route from the dock around the ring, in and out of every building. The direction around the
    /// corridors alternates from building to building. Consecutive drives go around the ring in
    /// opposite directions. The direction inside each building changes every second drive.
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
        // The dock is between the last node and the first.
        Route::from_dock(DOCK_M, &lap, random)
    }
}

impl PlacedBuilding {
    /// Where the corridor of the entrance meets the facade.
    fn door(&self) -> Point {
        let column = self.plan.entrance.unwrap_or(0);
        self.point(Point::new(self.plan.nodes[column][0].x, 0.0))
    }

    /// A loop around the corridors, from the node behind the entrance back to it.
    fn tour(&self, is_reversed: bool) -> Vec<Point> {
        let nodes = &self.plan.nodes;
        let (entrance, last) = (self.plan.entrance.unwrap_or(0), nodes.len() - 1);
        // Along row 0 to the right, back along the last row, and along row 0 to the entrance.
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

/// A car: painted metal, with glass above the belt line.
fn car(at: Point, angle: f64, scale: f64, paint: f64) -> Vec<Surface> {
    let scaled = |size: (f64, f64)| (size.0 * scale, size.1 * scale);
    let (ground_m, belt_m, roof_m) = CAR_HEIGHTS_M;
    let mut surfaces =
        prism(&rotated_rect(at, scaled(CAR_M), angle), (ground_m, belt_m * scale), paint);
    let cabin =
        prism(&rotated_rect(at, scaled(CABIN_M), angle), (belt_m * scale, roof_m * scale), 0.3);
    surfaces.extend(cabin.into_iter().map(|s| Surface { material: Material::Glass, ..s }));
    surfaces
}
