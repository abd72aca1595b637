//! An occupancy grid map of ROS `map_server` (a YAML file and a PGM image) as a site.
//!
//! Source: `map_server`, "Map format". The keys are `image`, `resolution`, `origin` (of the lower
//! left pixel), `negate`, `occupied_thresh` and `free_thresh`. A darker pixel is more likely to be
//! occupied.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::path::{Path, PathBuf};

use crate::SimulateError;
use crate::plane::{Point, Rect, Segment, Vector};
use crate::random::Random;
use crate::route::Route;

/// Minimum distance of the centre of the robot from everything that is not free \[m\].
pub(crate) const CLEARANCE_M: f64 = 0.45;
/// Routes avoid obstacles nearer than this where possible \[m\].
const PREFERRED_CLEARANCE_M: f64 = 1.2;
/// Routes are shifted to the right by this. A route out and back along the same corridor is then a
/// loop \[m\].
const KEEP_RIGHT_M: f64 = 0.12;
/// Distance between the control points of a route \[m\].
const SPACING_M: f64 = 0.9;
/// Number of waypoints of a route before it returns to its start.
const N_WAYPOINTS: usize = 6;
/// Largest number of lanes for people.
const N_LANES: usize = 40;
/// Minimum length of a lane \[m\].
const MIN_LANE_M: f64 = 4.0;
/// Minimum and maximum width of a doorway, a gap in a wall between two wider spaces \[m\].
const DOORWAY_M: (f64, f64) = (0.7, 1.5);
/// Distance before and behind a doorway at which the space must be wider \[m\].
const BEFORE_DOORWAY_M: f64 = 0.6;
/// How many times wider than the doorway that space must be.
const MIN_WIDENING: f64 = 1.6;
/// Largest number of pixels of a map.
const MAX_PIXELS: usize = 100_000_000;

/// An occupancy grid map, and where a robot can drive on it.
#[derive(Debug, Clone)]
pub struct Map {
    n_x: usize,
    n_y: usize,
    resolution_m: f64,
    /// Lower left corner of the lower left pixel.
    origin: Point,
    /// Row by row, from the bottom.
    occupied: Vec<bool>,
    /// Distance of each pixel to the nearest pixel that is not free; 0 where the robot cannot be
    /// \[m\].
    clearance_m: Vec<f32>,
}

/// Contents of the YAML file.
struct Header {
    image: PathBuf,
    resolution_m: f64,
    origin: Point,
    negate: bool,
    occupied_from: f64,
    free_to: f64,
}

impl Map {
    /// The files of a map: the YAML file and its image.
    pub fn files(yaml: &Path) -> Result<[PathBuf; 2], SimulateError> {
        Ok([yaml.to_owned(), read_header(yaml)?.image])
    }

    /// Reads a map.
    pub fn load(yaml: &Path) -> Result<Self, SimulateError> {
        let header = read_header(yaml)?;
        let bytes = std::fs::read(&header.image)
            .map_err(|source| SimulateError::ReadMap { path: header.image.clone(), source })?;
        let (n_x, n_y, shades) =
            read_pgm(&bytes).map_err(|reason| invalid(&header.image, reason))?;
        // map_server: the darkness of a pixel is its probability of being occupied.
        let occupied_share = |shade: f64| if header.negate { shade } else { 1.0 - shade };
        let rows = || shades.chunks_exact(n_x).rev().flatten();
        let occupied: Vec<bool> =
            rows().map(|&shade| header.occupied_from < occupied_share(shade)).collect();
        let free: Vec<bool> = rows().map(|&shade| occupied_share(shade) < header.free_to).collect();
        let mut map = Self {
            n_x,
            n_y,
            resolution_m: header.resolution_m,
            origin: header.origin,
            occupied,
            clearance_m: Vec::new(),
        };
        map.clearance_m = map.reachable(&map.clearances(&free));
        if map.clearance_m.iter().all(|&clearance_m| clearance_m <= 0.0) {
            let reason = format!(
                "the map has no room for the robot, expected a free pixel at least {CLEARANCE_M} m from every pixel that is not free"
            );
            return Err(invalid(yaml, reason));
        }
        Ok(map)
    }

    /// The extent of the map.
    pub(crate) fn extent(&self) -> Rect {
        let size = Vector::new(self.n_x as f64, self.n_y as f64) * self.resolution_m;
        Rect::new(self.origin, self.origin + size)
    }

    /// The borders between occupied pixels and other pixels.
    pub(crate) fn walls(&self) -> Vec<Segment> {
        let is_occupied = |i: usize, j: usize| {
            // Index -1 wraps to a huge index, which is outside.
            i < self.n_x && j < self.n_y && self.occupied[j * self.n_x + i]
        };
        let corner =
            |i: usize, j: usize| self.origin + Vector::new(i as f64, j as f64) * self.resolution_m;
        let mut walls = Vec::new();
        let mut add = |n: usize, is_wall: &dyn Fn(usize) -> bool, at: &dyn Fn(usize) -> Point| {
            let mut from = None;
            for k in 0..=n {
                match (from, k < n && is_wall(k)) {
                    (None, true) => from = Some(k),
                    (Some(start), false) => {
                        walls.push(Segment { start: at(start), end: at(k) });
                        from = None;
                    }
                    _ => {}
                }
            }
        };
        for i in 0..=self.n_x {
            let is_wall = |j| is_occupied(i.wrapping_sub(1), j) != is_occupied(i, j);
            add(self.n_y, &is_wall, &|j| corner(i, j));
        }
        for j in 0..=self.n_y {
            let is_wall = |i| is_occupied(i, j.wrapping_sub(1)) != is_occupied(i, j);
            add(self.n_x, &is_wall, &|i| corner(i, j));
        }
        walls
    }

    /// Straight lanes in which people walk up and down.
    pub(crate) fn lanes(&self, random: &mut Random) -> Vec<(Point, Point)> {
        let places = self.places();
        let has_room = |k: usize| 2.0 * CLEARANCE_M < f64::from(self.clearance_m[k]);
        let mut lanes = Vec::new();
        for _ in 0..8 * N_LANES {
            let from = places[random.index(places.len())];
            let step = if random.chance(0.5) { 1 } else { self.n_x };
            let end = (from..self.clearance_m.len()).step_by(step).take_while(|&k| has_room(k));
            let Some(to) = end.last() else { continue };
            let lane = (self.centre(from), self.centre(to));
            if MIN_LANE_M < (lane.1 - lane.0).norm() && lanes.len() < N_LANES {
                lanes.push(lane);
            }
        }
        lanes
    }

    /// A closed route through random waypoints.
    pub(crate) fn route(&self, is_reversed: bool, random: &mut Random) -> Route {
        let places = self.places();
        let start = places[random.index(places.len())];
        let mut pixels = Vec::new();
        let mut from = start;
        for k in 0..=N_WAYPOINTS {
            // The farthest of several candidates, to cover more of the map.
            let choices = (0..8).map(|_| places[random.index(places.len())]);
            let distance_m = |&k: &usize| (self.centre(k) - self.centre(from)).norm();
            let to = match k {
                N_WAYPOINTS => start,
                _ => {
                    choices.max_by(|a, b| distance_m(a).total_cmp(&distance_m(b))).unwrap_or(start)
                }
            };
            pixels.extend(self.shortest_path(from, to));
            from = to;
        }
        if is_reversed {
            pixels.reverse();
        }
        let points: Vec<Point> = pixels.into_iter().map(|k| self.centre(k)).collect();
        Route::along(&points, SPACING_M, KEEP_RIGHT_M)
    }

    /// Doorways: gaps in walls between two wider spaces. Each is a segment across the gap, at its
    /// first row of pixels.
    pub(crate) fn doorways(&self) -> Vec<Segment> {
        let mut doorways = Vec::new();
        for is_vertical in [false, true] {
            let (n_u, n_v) = if is_vertical { (self.n_y, self.n_x) } else { (self.n_x, self.n_y) };
            let is_occupied = |u: usize, v: usize| match is_vertical {
                true => self.occupied[u * self.n_x + v],
                false => self.occupied[v * self.n_x + u],
            };
            let point = |u: f64, v: f64| {
                let pixels = if is_vertical { Vector::new(v, u) } else { Vector::new(u, v) };
                self.origin + pixels * self.resolution_m
            };
            let before = (BEFORE_DOORWAY_M / self.resolution_m).ceil() as usize;
            // Width of the gap that a pixel is in, up to about `most` pixels on each side.
            let width = |u: usize, v: usize, most: usize| {
                let right = (u..n_u).take_while(|&u| !is_occupied(u, v)).take(most).count();
                let left = (0..u).rev().take_while(|&u| !is_occupied(u, v)).take(most).count();
                left + right
            };
            let mut of_last_row: Vec<(usize, usize)> = Vec::new();
            for v in before..n_v.saturating_sub(before) {
                let mut of_row = Vec::new();
                let mut from = None;
                for u in 0..n_u {
                    match (from, is_occupied(u, v)) {
                        (Some(start), true) => {
                            let n = u - start;
                            let width_m = n as f64 * self.resolution_m;
                            let wide = (MIN_WIDENING * n as f64).ceil() as usize;
                            let is_wider = |v| wide <= width(usize::midpoint(start, u), v, wide);
                            if DOORWAY_M.0 <= width_m
                                && width_m <= DOORWAY_M.1
                                && is_wider(v - before)
                                && is_wider(v + before)
                            {
                                of_row.push((start, u));
                            }
                            from = None;
                        }
                        // A gap starts after an occupied pixel, not at the border of the map.
                        (None, false) if 0 < u && is_occupied(u - 1, v) => from = Some(u),
                        _ => {}
                    }
                }
                for &(start, end) in &of_row {
                    if !of_last_row.iter().any(|&(a, b)| a < end && start < b) {
                        let across = v as f64 + 0.5;
                        let (start, end) = (point(start as f64, across), point(end as f64, across));
                        doorways.push(Segment { start, end });
                    }
                }
                of_last_row = of_row;
            }
        }
        doorways
    }

    /// Area of the floor that the centre of the robot can reach \[m^2\].
    pub(crate) fn floor_m2(&self) -> f64 {
        let n = self.clearance_m.iter().filter(|&&clearance_m| 0.0 < clearance_m).count();
        n as f64 * self.resolution_m * self.resolution_m
    }

    /// A random place that the robot can reach.
    pub(crate) fn place(&self, random: &mut Random) -> Point {
        loop {
            // `load` rejects maps without such a place.
            let k = random.index(self.clearance_m.len());
            if 0.0 < self.clearance_m[k] {
                return self.centre(k);
            }
        }
    }

    /// Distance of a place to the nearest pixel that is not free; 0 where the robot cannot be \[m\].
    pub(crate) fn clearance_at_m(&self, at: Point) -> f64 {
        let pixels = (at - self.origin) / self.resolution_m;
        let is_on_map =
            0.0 <= pixels.min() && pixels.x < self.n_x as f64 && pixels.y < self.n_y as f64;
        match is_on_map {
            true => f64::from(self.clearance_m[pixels.y as usize * self.n_x + pixels.x as usize]),
            false => 0.0,
        }
    }

    fn places(&self) -> Vec<usize> {
        (0..self.clearance_m.len()).filter(|&k| 0.0 < self.clearance_m[k]).collect()
    }

    fn centre(&self, k: usize) -> Point {
        let (i, j) = ((k % self.n_x) as f64 + 0.5, (k / self.n_x) as f64 + 0.5);
        self.origin + Vector::new(i, j) * self.resolution_m
    }

    /// The neighbours of a pixel, with their distances in pixels.
    fn neighbours(&self, k: usize) -> impl Iterator<Item = (usize, f64)> + use<> {
        let (n_x, n_y) = (self.n_x as i64, self.n_y as i64);
        let (i, j) = (k as i64 % n_x, k as i64 / n_x);
        (-1..=1).flat_map(move |di| (-1..=1).map(move |dj| (di, dj))).filter_map(move |(di, dj)| {
            let (i, j) = (i + di, j + dj);
            let is_inside = 0 <= i && i < n_x && 0 <= j && j < n_y && (di, dj) != (0, 0);
            let distance = if di * dj == 0 { 1.0 } else { std::f64::consts::SQRT_2 };
            is_inside.then_some(((j * n_x + i) as usize, distance))
        })
    }

    /// Distance of every pixel to the nearest pixel that is not free \[m\]. Distances are measured
    /// along 8-connected pixels, which is up to 8 % longer than a straight line; the result is scaled
    /// to a lower bound.
    fn clearances(&self, free: &[bool]) -> Vec<f32> {
        let sources = (0..free.len()).filter(|&k| !free[k] || self.is_at_border(k));
        let distances = self.least_costs(sources, |_| Some(1.0), None);
        let scale = self.resolution_m / 1.083;
        distances.into_iter().map(|distance| (distance * scale) as f32).collect()
    }

    fn is_at_border(&self, k: usize) -> bool {
        let (i, j) = (k % self.n_x, k / self.n_x);
        i == 0 || j == 0 || i + 1 == self.n_x || j + 1 == self.n_y
    }

    /// Keeps the largest connected region of pixels with enough clearance; 0 elsewhere.
    fn reachable(&self, clearance_m: &[f32]) -> Vec<f32> {
        let is_wide = |k: usize| CLEARANCE_M <= f64::from(clearance_m[k]);
        let mut group = vec![0u32; clearance_m.len()];
        let (mut n_groups, mut largest) = (0, (0, 0));
        for seed in 0..clearance_m.len() {
            if !is_wide(seed) || group[seed] != 0 {
                continue;
            }
            n_groups += 1;
            group[seed] = n_groups;
            let (mut stack, mut size) = (vec![seed], 0);
            while let Some(k) = stack.pop() {
                size += 1;
                for (next, _) in self.neighbours(k) {
                    if is_wide(next) && group[next] == 0 {
                        group[next] = n_groups;
                        stack.push(next);
                    }
                }
            }
            largest = largest.max((size, n_groups));
        }
        let kept = |k: usize| 0 < largest.1 && group[k] == largest.1;
        (0..group.len()).map(|k| if kept(k) { clearance_m[k] } else { 0.0 }).collect()
    }

    /// The shortest path between two pixels, where pixels near obstacles cost more.
    fn shortest_path(&self, from: usize, to: usize) -> Vec<usize> {
        let cost = |k: usize| {
            let clearance_m = f64::from(self.clearance_m[k]);
            let crowded = ((PREFERRED_CLEARANCE_M - clearance_m) / PREFERRED_CLEARANCE_M).max(0.0);
            (0.0 < clearance_m).then_some(1.0 + 12.0 * crowded * crowded)
        };
        let distances = self.least_costs(std::iter::once(to), cost, Some(from));
        let mut path = vec![from];
        let mut at = from;
        while at != to {
            let next = self.neighbours(at).min_by(|(a, da), (b, db)| {
                // The length of the step breaks ties.
                let through = |k: usize, step: f64| distances[k] + step * 1e-6;
                through(*a, *da).total_cmp(&through(*b, *db)).then(a.cmp(b))
            });
            match next {
                Some((next, _)) if distances[next] < distances[at] => at = next,
                _ => break,
            }
            path.push(at);
        }
        path
    }

    /// Dijkstra's algorithm: the least cost of every pixel from the sources. Stops when it reaches
    /// `to`. Visits pixels of equal cost in order of their index.
    fn least_costs(
        &self,
        sources: impl Iterator<Item = usize>,
        cost: impl Fn(usize) -> Option<f64>,
        to: Option<usize>,
    ) -> Vec<f64> {
        let mut costs = vec![f64::INFINITY; self.n_x * self.n_y];
        let mut open = BinaryHeap::new();
        for source in sources {
            costs[source] = 0.0;
            open.push(Reverse((0u64, source)));
        }
        while let Some(Reverse((bits, k))) = open.pop() {
            // Positive floats sort in the order of their bits.
            if costs[k] < f64::from_bits(bits) {
                continue;
            }
            if Some(k) == to {
                break;
            }
            for (next, distance) in self.neighbours(k) {
                let Some(cost) = cost(next) else { continue };
                let total = costs[k] + distance * cost;
                if total < costs[next] {
                    costs[next] = total;
                    open.push(Reverse((total.to_bits(), next)));
                }
            }
        }
        costs
    }
}

fn invalid(path: &Path, reason: impl Into<String>) -> SimulateError {
    SimulateError::Map { path: path.to_owned(), reason: reason.into() }
}

/// Reads the keys of the YAML file, one per line.
fn read_header(yaml: &Path) -> Result<Header, SimulateError> {
    let text = std::fs::read_to_string(yaml)
        .map_err(|source| SimulateError::ReadMap { path: yaml.to_owned(), source })?;
    let value = |key: &str| {
        text.lines().find_map(|line| {
            let (name, value) = line.split_once(':')?;
            let value = value.split(" #").next().unwrap_or_default();
            (name.trim() == key).then(|| value.trim().trim_matches(['"', '\'']).to_owned())
        })
    };
    let number = |key: &str, default: Option<f64>| match value(key) {
        Some(text) => text
            .parse::<f64>()
            .ok()
            .filter(|number| number.is_finite())
            .ok_or_else(|| invalid(yaml, format!("`{key}` is `{text}`, expected a number"))),
        None => default.ok_or_else(|| invalid(yaml, format!("`{key}` is missing"))),
    };
    let image = value("image").ok_or_else(|| invalid(yaml, "`image` is missing"))?;
    let origin = value("origin").ok_or_else(|| invalid(yaml, "`origin` is missing"))?;
    let numbers: Vec<f64> = (origin.trim_matches(['[', ']']).split(','))
        .filter_map(|text| text.trim().parse().ok())
        .collect();
    let &[x, y, yaw] = &numbers[..] else {
        return Err(invalid(yaml, format!("`origin` is `{origin}`, expected [x, y, yaw]")));
    };
    if yaw != 0.0 {
        return Err(invalid(yaml, format!("the yaw of `origin` is {yaw}, expected 0")));
    }
    let resolution_m = number("resolution", None)?;
    if !(0.001..=10.0).contains(&resolution_m) {
        return Err(invalid(
            yaml,
            format!("`resolution` is {resolution_m}, expected 0.001 to 10 m per pixel"),
        ));
    }
    Ok(Header {
        image: yaml.parent().unwrap_or(Path::new("")).join(image),
        resolution_m,
        origin: Point::new(x, y),
        negate: number("negate", Some(0.0))? != 0.0,
        occupied_from: number("occupied_thresh", Some(0.65))?,
        free_to: number("free_thresh", Some(0.196))?,
    })
}

/// Reads a PGM image, plain (P2) or raw (P5): width, height, and shades from 0 (black) to 1, row by
/// row from the top (netpbm, "PGM Format Specification").
fn read_pgm(bytes: &[u8]) -> Result<(usize, usize, Vec<f64>), String> {
    let mut at = 2;
    let mut number = |bytes: &[u8]| -> Option<usize> {
        loop {
            match bytes.get(at)? {
                b'#' => at += bytes[at..].iter().position(|&b| b == b'\n')?,
                b if b.is_ascii_whitespace() => at += 1,
                _ => break,
            }
        }
        let digits = bytes[at..].iter().take_while(|b| b.is_ascii_digit()).count();
        let text = std::str::from_utf8(&bytes[at..at + digits]).ok()?;
        at += digits;
        text.parse().ok()
    };
    let is_raw = match bytes.get(..2) {
        Some(b"P5") => true,
        Some(b"P2") => false,
        _ => return Err("is not a PGM image, expected P2 or P5 at the start".to_owned()),
    };
    let mut next = || number(bytes).ok_or_else(|| "is truncated in the header".to_owned());
    let (n_x, n_y, most) = (next()?, next()?, next()?);
    let n = n_x.checked_mul(n_y).filter(|n| (1..=MAX_PIXELS).contains(n));
    let n = n.ok_or_else(|| format!("has {n_x} x {n_y} pixels, expected 1 to {MAX_PIXELS}"))?;
    if !(1..=255).contains(&most) {
        return Err(format!("has a maximum shade of {most}, expected 1 to 255"));
    }
    let shades: Vec<usize> = match is_raw {
        true => bytes.get(at + 1..).unwrap_or_default().iter().map(|&b| b.into()).take(n).collect(),
        false => std::iter::from_fn(|| number(bytes)).take(n).collect(),
    };
    match shades.len() {
        found if found < n => Err(format!("contains {found} pixels, expected {n}")),
        _ => Ok((n_x, n_y, shades.iter().map(|&s| s as f64 / most as f64).collect())),
    }
}
