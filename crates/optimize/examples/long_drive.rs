//! Memory and time of loop detection on a long drive.
//!
//! `cargo run --release -p optimize --example long_drive -- N_KEYFRAMES [N_BEAMS]`
//!
//! A robot drives through the streets of a town, with a keyframe every 0.5 m and a full circle of beams per scan.
//! At each crossing it takes a street by chance, so that it comes through most streets several times. The scans are
//! computed each time one is asked for, and none is kept: all memory is that of the algorithms. After
//! each step, the example prints the largest memory so far (Linux only).

#![allow(clippy::print_stdout, reason = "an example prints its results")]

use std::error::Error;
use std::f64::consts::{FRAC_PI_2, TAU};
use std::sync::Arc;
use std::time::Instant;

use dataset::{Pose2, RangeLimits, Scan, SplitMix64, wrap_angle};
use detect::{Candidate, Places, find_candidates};
use model::Detector;
use optimize::{Proposal, close_loops};
use register::{Drive, DriveScan, MatcherOptions, Registered, ScanSource, register_drive};

const LIMITS: RangeLimits = RangeLimits { min_m: 0.5, max_m: 25.0 };
const SPACING_M: f64 = 0.5;
/// Distance of two streets, and half of their width \[m\].
const BLOCK_M: f64 = 40.0;
const HALF_WIDTH_M: f64 = 4.0;
/// Number of streets in each direction for 100,000 keyframes: 50 km of driving on 11 km of streets.
const N_STREETS: f64 = 12.0;
/// A facade consists of sections of this length, at different depths \[m\].
const SECTION_M: f64 = 4.0;
/// Radius of the path around a corner \[m\].
const CORNER_M: f64 = 3.0;
const NOISE_M: f64 = 0.01;

type Segment = [[f64; 2]; 2];

/// The streets of a town, seen from the poses of a robot.
struct Town {
    truth: Vec<Pose2>,
    n_beams: usize,
}

impl Town {
    fn new(n_keyframes: usize, n_beams: usize) -> Self {
        let n_streets = (N_STREETS * (n_keyframes as f64 / 100_000.0).sqrt()).ceil().max(2.0);
        Self { truth: path(n_keyframes, n_streets as i64), n_beams }
    }

    /// The walls of the blocks around a position.
    fn walls(position: [f64; 2]) -> Vec<Segment> {
        let [x, y] = position.map(|v| (v / BLOCK_M).floor() as i64);
        let mut walls = Vec::new();
        for block in (x - 1..=x + 1).flat_map(|x| (y - 1..=y + 1).map(move |y| [x, y])) {
            let middle = block.map(|v| (v as f64 + 0.5) * BLOCK_M);
            for side in 0..4 {
                facade(block, middle, side, &mut walls);
            }
        }
        walls
    }
}

/// Adds the walls of one side of a block.
fn facade(block: [i64; 2], [x, y]: [f64; 2], side: u64, walls: &mut Vec<Segment>) {
    let seed = block
        .iter()
        .fold(side, |seed, &v| SplitMix64::new(seed.wrapping_mul(1_000_003) ^ v as u64).next_u64());
    let mut random = SplitMix64::new(seed);
    let half_m = BLOCK_M / 2.0 - HALF_WIDTH_M;
    let (sin, cos) = libm::sincos(side as f64 * FRAC_PI_2);
    let place = |along: f64, out: f64| [x + cos * out - sin * along, y + sin * out + cos * along];
    let mut last: Option<[f64; 2]> = None;
    for section in 0..(2.0 * half_m / SECTION_M) as u32 {
        let start = -half_m + SECTION_M * f64::from(section);
        let out = half_m - 0.5 * random.below(4) as f64;
        let (a, b) = (place(start, out), place(start + SECTION_M, out));
        walls.extend(last.map(|last| [last, a]));
        walls.push([a, b]);
        last = Some(b);
    }
}

/// A keyframe every 0.5 m through the streets.
fn path(n: usize, n_streets: i64) -> Vec<Pose2> {
    let mut random = SplitMix64::new(7);
    let directions: [[i64; 2]; 4] = [[1, 0], [0, 1], [-1, 0], [0, -1]];
    let mut corners = vec![[0, 0], [1, 0]];
    let mut heading = 0;
    let n_corners = (n as f64 * SPACING_M / (BLOCK_M - 2.0 * CORNER_M)) as usize + 3;
    while corners.len() < n_corners {
        let at = corners[corners.len() - 1];
        let ways = [heading, (heading + 1) % 4, (heading + 3) % 4];
        let next = |way: usize| [0, 1].map(|axis| at[axis] + directions[way][axis]);
        let is_open = |way: &usize| next(*way).iter().all(|v| (0..n_streets).contains(v));
        let open: Vec<usize> = ways.into_iter().filter(is_open).collect();
        heading = open[random.below(open.len() as u64)];
        corners.push(next(heading));
    }
    let mut poses = Vec::with_capacity(n);
    let mut rest_m = 0.0;
    for window in corners.windows(3) {
        let [a, b, c] = [window[0], window[1], window[2]].map(|v| v.map(|v| v as f64 * BLOCK_M));
        let way = |from: [f64; 2], to: [f64; 2]| libm::atan2(to[1] - from[1], to[0] - from[0]);
        let (before, after) = (way(a, b), way(b, c));
        let turn = wrap_angle(after - before);
        // From the middle of the street before the corner to that of the street after it.
        let straight_m = BLOCK_M / 2.0 - CORNER_M;
        let arc_m = if turn == 0.0 { 2.0 * CORNER_M } else { CORNER_M * turn.abs() };
        let start =
            Pose2 { x_m: (a[0] + b[0]) / 2.0, y_m: (a[1] + b[1]) / 2.0, heading_rad: before };
        let length_m = 2.0 * straight_m + arc_m;
        while rest_m < length_m {
            let arc = |m: f64| {
                let angle = turn * m / arc_m;
                match turn == 0.0 {
                    true => Pose2 { x_m: straight_m + m, ..Pose2::default() },
                    false => Pose2 {
                        x_m: straight_m + CORNER_M * libm::sin(angle.abs()),
                        y_m: turn.signum() * CORNER_M * (1.0 - libm::cos(angle)),
                        heading_rad: angle,
                    },
                }
            };
            let along = match rest_m {
                m if m < straight_m => Pose2 { x_m: m, ..Pose2::default() },
                m if m < straight_m + arc_m => arc(m - straight_m),
                m => arc(arc_m) * Pose2 { x_m: m - straight_m - arc_m, ..Pose2::default() },
            };
            poses.push(start * along);
            rest_m += SPACING_M;
        }
        rest_m -= length_m;
    }
    poses.truncate(n);
    poses
}

impl ScanSource for Town {
    fn len(&self) -> usize {
        self.truth.len()
    }

    fn scan(&self, index: usize) -> Arc<DriveScan> {
        let pose = &self.truth[index];
        let mut ranges_m = vec![f64::INFINITY; self.n_beams];
        let step_rad = TAU / self.n_beams as f64;
        let scan_from_map = pose.inverse();
        for wall in Self::walls([pose.x_m, pose.y_m]) {
            let [a, b] = wall.map(|[x_m, y_m]| {
                let p = scan_from_map * Pose2 { x_m, y_m, heading_rad: 0.0 };
                [p.x_m, p.y_m]
            });
            let [from, to] = [a, b].map(|[x, y]| libm::atan2(y, x));
            let turn = wrap_angle(to - from);
            let first = if turn < 0.0 { to } else { from };
            let n = (turn.abs() / step_rad) as i64 + 1;
            let first = (first / step_rad).ceil() as i64;
            let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
            for beam in first..first + n {
                let (sin, cos) = libm::sincos(beam as f64 * step_rad);
                let range_m = (a[0] * dy - a[1] * dx) / (cos * dy - sin * dx);
                let range = &mut ranges_m[beam.rem_euclid(self.n_beams as i64) as usize];
                if 0.0 < range_m && range_m < *range {
                    *range = range_m;
                }
            }
        }
        let mut random = SplitMix64::new(index as u64);
        let mut scan = Scan { coverage_deg: 360.0, ..Scan::default() };
        for (beam, range_m) in ranges_m.iter().enumerate() {
            // The sum of three numbers has the standard deviation 0.5.
            let noise: f64 = (0..3).map(|_| random.unit() - 0.5).sum();
            let range_m = range_m + 2.0 * NOISE_M * noise;
            if range_m < LIMITS.max_m {
                let (sin, cos) = libm::sincos(beam as f64 * step_rad);
                scan.x_m.push((range_m * cos) as f32);
                scan.y_m.push((range_m * sin) as f32);
            }
        }
        Arc::new(DriveScan::new(scan, LIMITS))
    }
}

/// The poses of odometry with a scale that is 2 % wrong and a turn of 0.1 deg/m.
fn odometry(truth: &[Pose2]) -> Vec<Pose2> {
    let mut poses: Vec<Pose2> = truth.first().copied().into_iter().collect();
    for pair in truth.windows(2) {
        let step = pair[0].inverse() * pair[1];
        let wrong = Pose2 {
            x_m: 1.02 * step.x_m,
            y_m: 1.02 * step.y_m,
            heading_rad: step.heading_rad + (0.1 * SPACING_M).to_radians(),
        };
        poses.push(poses[poses.len() - 1] * wrong);
    }
    poses
}

/// The largest memory of the process so far \[MB\].
fn peak_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM"))?;
    Some(line.split_whitespace().nth(1)?.parse::<f64>().ok()? / 1024.0)
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let n: usize = arguments.next().ok_or("name the number of keyframes")?.parse()?;
    let n_beams: usize = arguments.next().map_or(Ok(720), |n| n.parse())?;
    let town = Arc::new(Town::new(n, n_beams));
    let odometry = odometry(&town.truth);
    let detector = Detector::starting_values();
    let mut start = Instant::now();
    let mut report = |step: &str, found: String| {
        let per_keyframe_ms = 1e3 * start.elapsed().as_secs_f64() / n as f64;
        let peak = peak_mb().map_or(String::new(), |mb| format!(", at most {mb:.0} MB so far"));
        println!("{step}: {found}, {per_keyframe_ms:.2} ms per keyframe{peak}");
        start = Instant::now();
    };
    let options = MatcherOptions::default();
    let registered = register_drive(&*town, &odometry, &detector.odometry, &options);
    let drive = Drive::new(
        town.clone(),
        odometry,
        registered.iter().map(|scan| scan.pose).collect(),
        vec![true; n],
        registered.iter().map(Registered::is_decided).collect(),
    );
    report("register", format!("{n} keyframes of {n_beams} beams"));
    let candidates = {
        let places = Places::new(&drive, &drive.poses, 2.5, 5.0);
        find_candidates(&drive, &places, &detector, 30.0, None)
    };
    report("detect", format!("{} candidates", candidates.len()));
    let proposal = |found: &Candidate| Proposal {
        query: found.query,
        reference: found.reference,
        reference_from_query: found.reference_from_query,
        covariance: found.covariance,
        evidence: found.evidence,
        confidence: found.confidence,
    };
    let proposals: Vec<Proposal> = candidates.iter().map(proposal).collect();
    let solution = close_loops(&drive, &proposals, &detector, 30.0);
    let accepted = solution.closures.iter().filter(|closure| closure.rejected.is_none());
    let is_false = |proposal: &Proposal| {
        let [query, reference] = [proposal.query, proposal.reference].map(|k| town.truth[k]);
        let truth = reference.inverse() * query;
        1.0 < truth.distance_m(&proposal.reference_from_query)
    };
    let n_false = accepted.clone().filter(|closure| is_false(&closure.proposal)).count();
    let error_m = |(pose, truth): (&Pose2, &Pose2)| pose.distance_m(truth);
    let worst_m = solution.poses.iter().zip(&town.truth).map(error_m).fold(0.0, f64::max);
    let found = format!(
        "{} closures, {n_false} false, poses at most {worst_m:.2} m away from the truth",
        accepted.count()
    );
    report("optimize", found);
    Ok(())
}
