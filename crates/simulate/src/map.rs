//! A floor plan from a map of ROS `map_server`: a YAML file and a PGM image.
//!
//! Source: `map_server`, "Map format": image, resolution, origin (of the lower left pixel), negate,
//! and the shares from which a pixel is occupied and up to which it is free; darker is more
//! occupied.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::path::{Path, PathBuf};

use crate::SimulateError;
use crate::plane::{Point, Rect, Segment, Vector};
use crate::random::Random;
use crate::route::Route;

/// The robot's middle keeps at least this far from whatever is not free \[m\].
pub(crate) const CLEARANCE_M: f64 = 0.45;
/// Ways avoid what is nearer than this, where they can \[m\].
const COMFORT_M: f64 = 1.2;
/// Every way is kept to the right by this, so that ways there and back make a loop \[m\].
const KEEP_RIGHT_M: f64 = 0.12;
/// Distance between control points of a way \[m\].
const SPACING_M: f64 = 0.9;
/// Places that a drive goes to, one after the other, before it comes back.
const N_PLACES: usize = 6;
/// Lanes for people: their number, and how long they are at least \[m\].
const N_LANES: usize = 40;
const LANE_M: f64 = 4.0;
/// A gap in a wall between two wider places is a doorway if it is so wide \[m\].
const DOORWAY_M: (f64, f64) = (0.7, 1.5);
/// How far before and behind a doorway it is wider, by how much \[m, times\].
const BEFORE_DOORWAY_M: f64 = 0.6;
const WIDER: f64 = 1.6;
/// Pixels of a map at most.
const MAX_PIXELS: usize = 100_000_000;

/// A map, and where a robot can drive on it.
#[derive(Debug, Clone)]
pub struct Map {
    n_x: usize,
    n_y: usize,
    resolution_m: f64,
    /// Of the lower left pixel's lower left corner.
    origin: Point,
    /// Row by row from below.
    occupied: Vec<bool>,
    /// Distance to what is not free, of the pixels that a robot can reach; 0 of all others \[m\].
    clearance_m: Vec<f32>,
}

/// What the YAML file says.
struct Header {
    image: PathBuf,
    resolution_m: f64,
    origin: Point,
    negate: bool,
    occupied_from: f64,
    free_to: f64,
}

impl Map {
    /// The files that a map consists of: the YAML file and its image.
    pub fn files(yaml: &Path) -> Result<[PathBuf; 2], SimulateError> {
        Ok([yaml.to_owned(), header(yaml)?.image])
    }

    /// Reads a map.
    pub fn load(yaml: &Path) -> Result<Self, SimulateError> {
        let header = header(yaml)?;
        let bytes = std::fs::read(&header.image)
            .map_err(|e| fail(&header.image, format!("cannot be read: {e}")))?;
        let (n_x, n_y, shades) = read_pgm(&bytes).map_err(|reason| fail(&header.image, reason))?;
        // map_server: the share of darkness is the probability of being occupied.
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
            let reason = format!("has no place that is {CLEARANCE_M} m from all that is not free");
            return Err(fail(yaml, reason));
        }
        Ok(map)
    }

    /// The whole map.
    pub(crate) fn extent(&self) -> Rect {
        let size = Vector::new(self.n_x as f64, self.n_y as f64) * self.resolution_m;
        Rect::new(self.origin, self.origin + size)
    }

    /// The borders between pixels that are occupied and pixels that are not.
    pub(crate) fn walls(&self) -> Vec<Segment> {
        let is_occupied = |i: usize, j: usize| {
            // One below the first wraps to a huge index.
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

    /// Straight stretches for people to walk up and down.
    pub(crate) fn lanes(&self, random: &mut Random) -> Vec<(Point, Point)> {
        let places = self.places();
        let has_room = |k: usize| 2.0 * CLEARANCE_M < f64::from(self.clearance_m[k]);
        let mut lanes = Vec::new();
        for _ in 0..8 * N_LANES {
            let from = places[random.index(places.len())];
            let step = if random.chance(0.5) { 1 } else { self.n_x };
            let end = (from..self.clearance_m.len()).step_by(step).take_while(|&k| has_room(k));
            let Some(to) = end.last() else { continue };
            let lane = (self.middle(from), self.middle(to));
            if LANE_M < (lane.1 - lane.0).norm() && lanes.len() < N_LANES {
                lanes.push(lane);
            }
        }
        lanes
    }

    /// To several places, one after the other, and back to the first, over and over.
    pub(crate) fn route(&self, is_reversed: bool, random: &mut Random) -> Route {
        let places = self.places();
        let start = places[random.index(places.len())];
        let mut way = Vec::new();
        let mut from = start;
        for k in 0..=N_PLACES {
            // The farthest of several, so that drives get about.
            let choices = (0..8).map(|_| places[random.index(places.len())]);
            let distance_m = |&k: &usize| (self.middle(k) - self.middle(from)).norm();
            let to = match k {
                N_PLACES => start,
                _ => {
                    choices.max_by(|a, b| distance_m(a).total_cmp(&distance_m(b))).unwrap_or(start)
                }
            };
            way.extend(self.way(from, to));
            from = to;
        }
        if is_reversed {
            way.reverse();
        }
        let points: Vec<Point> = way.into_iter().map(|k| self.middle(k)).collect();
        Route::along(&points, SPACING_M, KEEP_RIGHT_M)
    }

    /// Gaps in walls between two wider places, each across where it begins.
    pub(crate) fn doorways(&self) -> Vec<Segment> {
        let mut doorways = Vec::new();
        for is_upright in [false, true] {
            let (n_u, n_v) = if is_upright { (self.n_y, self.n_x) } else { (self.n_x, self.n_y) };
            let is_occupied = |u: usize, v: usize| match is_upright {
                true => self.occupied[u * self.n_x + v],
                false => self.occupied[v * self.n_x + u],
            };
            let point = |u: f64, v: f64| {
                let pixels = if is_upright { Vector::new(v, u) } else { Vector::new(u, v) };
                self.origin + pixels * self.resolution_m
            };
            let before = (BEFORE_DOORWAY_M / self.resolution_m).ceil() as usize;
            // The gap that a pixel is in, as far as it is of interest.
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
                            let wide = (WIDER * n as f64).ceil() as usize;
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
                        // A gap begins behind something, not at the border.
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

    /// Floor on which a robot's middle can be \[m^2\].
    pub(crate) fn floor_m2(&self) -> f64 {
        let n = self.clearance_m.iter().filter(|&&clearance_m| 0.0 < clearance_m).count();
        n as f64 * self.resolution_m * self.resolution_m
    }

    /// Any place that a robot can reach.
    pub(crate) fn place(&self, random: &mut Random) -> Point {
        loop {
            // There is one, or the map would have been refused.
            let k = random.index(self.clearance_m.len());
            if 0.0 < self.clearance_m[k] {
                return self.middle(k);
            }
        }
    }

    /// Distance of a place to what is not free; 0 where a robot cannot be \[m\].
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

    fn middle(&self, k: usize) -> Point {
        let (i, j) = ((k % self.n_x) as f64 + 0.5, (k / self.n_x) as f64 + 0.5);
        self.origin + Vector::new(i, j) * self.resolution_m
    }

    /// The pixels around one, with their distances in pixels.
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

    /// Distance of every pixel to the nearest that is not free, over pixels \[m\]; ways over pixels
    /// are up to 8 % longer than straight ones.
    fn clearances(&self, free: &[bool]) -> Vec<f32> {
        let sources = (0..free.len()).filter(|&k| !free[k] || self.is_at_border(k));
        let distances = self.spread(sources, |_| Some(1.0), None);
        let scale = self.resolution_m / 1.083;
        distances.into_iter().map(|distance| (distance * scale) as f32).collect()
    }

    fn is_at_border(&self, k: usize) -> bool {
        let (i, j) = (k % self.n_x, k / self.n_x);
        i == 0 || j == 0 || i + 1 == self.n_x || j + 1 == self.n_y
    }

    /// Of the pixels with enough clearance the largest set that hangs together; 0 elsewhere.
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

    /// The best way from pixel to pixel: short, but rather in the middle.
    fn way(&self, from: usize, to: usize) -> Vec<usize> {
        let cost = |k: usize| {
            let clearance_m = f64::from(self.clearance_m[k]);
            let crowded = ((COMFORT_M - clearance_m) / COMFORT_M).max(0.0);
            (0.0 < clearance_m).then_some(1.0 + 12.0 * crowded * crowded)
        };
        let distances = self.spread(std::iter::once(to), cost, Some(from));
        let mut way = vec![from];
        let mut at = from;
        while at != to {
            let next = self.neighbours(at).min_by(|(a, da), (b, db)| {
                // The step's own length settles which of two is on the way.
                let through = |k: usize, step: f64| distances[k] + step * 1e-6;
                through(*a, *da).total_cmp(&through(*b, *db)).then(a.cmp(b))
            });
            match next {
                Some((next, _)) if distances[next] < distances[at] => at = next,
                _ => break,
            }
            way.push(at);
        }
        way
    }

    /// Dijkstra's algorithm: the least cost of every pixel from the sources, until `to` is reached.
    /// Equal costs are taken in order of the pixels.
    fn spread(
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
            // Positive floats are in the order of their bits.
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

fn fail(path: &Path, reason: impl Into<String>) -> SimulateError {
    SimulateError::Map { path: path.to_owned(), reason: reason.into() }
}

/// Reads the few keys of the YAML file, one a line.
fn header(yaml: &Path) -> Result<Header, SimulateError> {
    let text =
        std::fs::read_to_string(yaml).map_err(|e| fail(yaml, format!("cannot be read: {e}")))?;
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
            .ok_or_else(|| fail(yaml, format!("`{key}` is `{text}`, expected a number"))),
        None => default.ok_or_else(|| fail(yaml, format!("`{key}` is missing"))),
    };
    let image = value("image").ok_or_else(|| fail(yaml, "`image` is missing"))?;
    let origin = value("origin").ok_or_else(|| fail(yaml, "`origin` is missing"))?;
    let numbers: Vec<f64> = (origin.trim_matches(['[', ']']).split(','))
        .filter_map(|text| text.trim().parse().ok())
        .collect();
    let &[x, y, yaw] = &numbers[..] else {
        return Err(fail(yaml, format!("`origin` is `{origin}`, expected [x, y, yaw]")));
    };
    if yaw != 0.0 {
        return Err(fail(yaml, format!("the yaw of `origin` is {yaw}, expected 0")));
    }
    let resolution_m = number("resolution", None)?;
    if !(0.001..=10.0).contains(&resolution_m) {
        return Err(fail(
            yaml,
            format!("`resolution` is {resolution_m}, expected 0.001 to 10 m a pixel"),
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

/// Width, height and shades from 0 (black) to 1, row by row from above, of a PGM image (netpbm,
/// "PGM Format Specification"), plain (P2) or raw (P5).
fn read_pgm(bytes: &[u8]) -> Result<(usize, usize, Vec<f64>), String> {
    let mut at = 2;
    let mut word = |bytes: &[u8]| -> Option<usize> {
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
        _ => return Err("is no PGM image: expected P2 or P5 at its start".to_owned()),
    };
    let mut next = || word(bytes).ok_or_else(|| "ends within its header".to_owned());
    let (n_x, n_y, most) = (next()?, next()?, next()?);
    let n = n_x.checked_mul(n_y).filter(|n| (1..=MAX_PIXELS).contains(n));
    let n = n.ok_or_else(|| format!("is {n_x} x {n_y}, expected 1 to {MAX_PIXELS} pixels"))?;
    if !(1..=255).contains(&most) {
        return Err(format!("has shades up to {most}, expected up to 255"));
    }
    let shades: Vec<usize> = match is_raw {
        true => bytes.get(at + 1..).unwrap_or_default().iter().map(|&b| b.into()).take(n).collect(),
        false => std::iter::from_fn(|| word(bytes)).take(n).collect(),
    };
    match shades.len() {
        found if found < n => Err(format!("holds {found} pixels, expected {n}")),
        _ => Ok((n_x, n_y, shades.iter().map(|&s| s as f64 / most as f64).collect())),
    }
}
