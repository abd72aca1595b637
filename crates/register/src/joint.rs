//! Joint alignment: the poses of many scans at once, so that all pairs of them fit.

use std::collections::BTreeSet;
use std::ops::Range;

use dataset::{Pose2, wrap_angle};
use model::OdometryNoise;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use crate::align::discount_normals;
use crate::kept::Kept;
use crate::map_order::map_order;
use crate::points::{Motion, Points};
use crate::source::ScanSource;
use crate::sparse::BlockSystem;
use crate::target::{AlongScan, Target};

/// How scans are aligned jointly.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointOptions {
    /// Number of iterations.
    pub iterations: u32,
    /// A point and its partner are at most this far apart in the first iteration \[m\].
    pub first_gate_m: f64,
    /// The same in the last iterations \[m\].
    pub last_gate_m: f64,
    /// Residuals far above this value hardly count (Geman and McClure), in the first iteration \[m\].
    pub first_scale_m: f64,
    /// The same in the last iterations \[m\].
    pub last_scale_m: f64,
    /// Standard deviation of the distance of a point from the line of its partner \[m\].
    pub noise_m: f64,
    /// Number of points that count as one independent measurement.
    pub points_per_measurement: f64,
    /// The most poses that are found at once. The factor of their equations needs about 10 kB per pose, so that of a
    /// long drive does not fit into memory.
    pub max_at_once: usize,
}

impl Default for JointOptions {
    fn default() -> Self {
        Self {
            iterations: 5,
            first_gate_m: 0.35,
            last_gate_m: 0.15,
            first_scale_m: 0.1,
            last_scale_m: 0.04,
            noise_m: 0.03,
            points_per_measurement: 20.0,
            max_at_once: 6000,
        }
    }
}

/// Scans that are aligned jointly. All slices have one entry per scan.
#[derive(Clone, Copy)]
pub struct JointScans<'a> {
    /// The scans.
    pub source: &'a dyn ScanSource,
    /// The pose of each scan by odometry.
    pub odometry: &'a [Pose2],
    /// Path length by odometry \[m\].
    pub path_m: &'a [f64],
    /// Error of the odometry of the step that ends at each scan. `None` where a drive begins.
    pub noise: &'a [Option<OdometryNoise>],
    /// Whether the pose of a scan stays.
    pub is_held: &'a [bool],
}

/// One of this many source points takes part before the last iteration. A scan has pairs with many others, so that few
/// points per pair are enough.
const EVERY: usize = 3;
/// Scans with fewer points take no part in pairs.
const MIN_POINTS: usize = 6;
/// One point per square of this size takes part as a source \[m\].
const SOURCE_VOXEL_M: f64 = 0.15;
/// The smallest cosine of the angle between the normals of a point and its partner: 37 deg.
const MIN_NORMAL_COS: f64 = 0.8;
/// In the first iteration, no step moves a pose by more than this in a direction \[m\], \[rad\].
const MAX_FIRST_STEP: f64 = 0.3;
/// Path that counts for the odometry error at least \[m\].
const MIN_STEP_M: f64 = 0.05;
/// Pairs whose scans are in memory at once.
const PAIRS_AT_ONCE: usize = 4096;
/// The most scans that are kept for the next iteration. Each needs about 0.1 MB.
const MAX_KEPT: usize = 2048;
/// Added to the diagonal, so that a pose without any information stays.
const DAMPING: f64 = 1e-6;

/// Aligns scans with each other: point to line, over the given pairs of scans in both directions, with the
/// odometry between consecutive scans as prior. A scan without pairs, and with held neighbours or none,
/// stays. Before the last iteration, every third point of a source takes part and counts for three.
///
/// If more than `options.max_at_once` scans move, each iteration has two steps. First, groups of consecutive scans
/// move, each group rigidly. Then one stretch of them after the other moves while the rest stays. The first step
/// finds what reaches far, the second one what is left (a two-grid method, Briggs, Henson and McCormick 2000, "A
/// Multigrid Tutorial").
///
/// # Panics
/// If no pose may be found at once.
///
/// Lu and Milios 1997, "Globally consistent range scan alignment for environment mapping", with the
/// point-to-line metric and a robust weight.
pub fn align_jointly(
    scans: &JointScans<'_>,
    poses: &[Pose2],
    pairs: &[(usize, usize)],
    options: &JointOptions,
) -> Vec<Pose2> {
    assert!(0 < options.max_at_once, "some poses are found");
    // In this order, consecutive pairs have scans in common.
    let order = map_order(pairs.iter().map(|&(a, b)| poses[a.max(b)]));
    let pairs: Vec<(usize, usize)> = order.into_iter().map(|k| pairs[k]).collect();
    let kept = Kept::new(MAX_KEPT);
    let mut aligner = Aligner { scans, options, pairs, kept, poses: poses.to_vec() };
    let each = groups(scans, 1);
    let size = each.len().div_ceil(options.max_at_once).max(1);
    let mut all = aligner.unknowns(groups(scans, size));
    for iteration in 0..options.iterations {
        // Without a solution, the poses stay.
        if aligner.step(&mut all, iteration).is_none() || size == 1 {
            continue;
        }
        for stretch in stretches(each.len(), options.max_at_once, iteration) {
            let mut unknowns = aligner.unknowns(each[stretch].to_vec());
            let _ = aligner.step(&mut unknowns, iteration);
        }
    }
    aligner.poses
}

/// The scans that move, in groups of at most `size` consecutive scans of a drive.
fn groups(scans: &JointScans<'_>, size: usize) -> Vec<Range<usize>> {
    let mut groups: Vec<Range<usize>> = Vec::new();
    for scan in (0..scans.is_held.len()).filter(|&scan| !scans.is_held[scan]) {
        let continued = groups
            .last_mut()
            .filter(|group| group.end == scan && group.len() < size && scans.noise[scan].is_some());
        match continued {
            Some(group) => group.end += 1,
            None => groups.push(scan..scan + 1),
        }
    }
    groups
}

/// Equal stretches of at most `most` of `n` scans that move. In odd iterations, they are shifted by half of a stretch.
fn stretches(n: usize, most: usize, iteration: u32) -> Vec<Range<usize>> {
    let n_stretches = n.div_ceil(most);
    let border = |k: usize| k * n / n_stretches;
    let mut borders: Vec<usize> = (0..=n_stretches).map(border).collect();
    if iteration % 2 == 1 {
        let middles = borders.windows(2).map(|of| (of[0] + of[1]) / 2);
        borders = [0].into_iter().chain(middles).chain([n]).collect();
    }
    borders.windows(2).map(|of| of[0]..of[1]).collect()
}

/// Groups of scans that move, and their equations.
struct Unknowns {
    /// Ascending. Each moves rigidly, and turns about its first scan.
    groups: Vec<Range<usize>>,
    /// The group of each scan; `None` for one that stays.
    group_of: Vec<Option<usize>>,
    /// Pairs of scans of different groups, or of a group and a scan that stays.
    pairs: Vec<(usize, usize)>,
    system: BlockSystem,
}

impl Unknowns {
    fn new(scans: &JointScans<'_>, groups: Vec<Range<usize>>, pairs: &[(usize, usize)]) -> Self {
        let mut group_of = vec![None; scans.is_held.len()];
        for (k, group) in groups.iter().enumerate() {
            group_of[group.clone()].fill(Some(k));
        }
        let moves = |&(a, b): &(usize, usize)| group_of[a] != group_of[b];
        let pairs: Vec<(usize, usize)> = pairs.iter().copied().filter(moves).collect();
        let steps = (1..group_of.len()).filter(|&k| scans.noise[k].is_some()).map(|k| (k - 1, k));
        let both = |(a, b): (usize, usize)| Some((group_of[a]?, group_of[b]?));
        let mut blocks: Vec<(usize, usize)> =
            pairs.iter().copied().chain(steps).filter_map(both).collect();
        blocks.sort_unstable();
        blocks.dedup();
        let system = BlockSystem::new(groups.len(), blocks.into_iter());
        Self { groups, group_of, pairs, system }
    }

    /// The group of a scan, and the derivative of the pose of the scan with respect to the motion of the group. `None`
    /// for a scan that stays.
    fn of_scan(&self, scan: usize, poses: &[Pose2]) -> Option<(usize, Matrix3<f64>)> {
        let group = self.group_of[scan]?;
        let first = &poses[self.groups[group].start];
        let (x_m, y_m) = (poses[scan].x_m - first.x_m, poses[scan].y_m - first.y_m);
        Some((group, Matrix3::new(1.0, 0.0, -y_m, 0.0, 1.0, x_m, 0.0, 0.0, 1.0)))
    }

    /// Adds the cost of the pose of scan b in the frame of scan a, which is of another group.
    fn add(&mut self, term: &Term, a: usize, b: usize, poses: &[Pose2]) {
        let [da, db] = relative_derivatives(&poses[a], &poses[b]);
        let a = self.of_scan(a, poses).map(|(group, moved)| (group, da * moved));
        let b = self.of_scan(b, poses).map(|(group, moved)| (group, db * moved));
        for (group, derivative) in a.into_iter().chain(b) {
            let to_group = derivative.transpose();
            self.system.add(group, group, &(to_group * term.information * derivative));
            self.system.add_right(group, &-(to_group * term.gradient));
        }
        if let (Some((a, da)), Some((b, db))) = (a, b) {
            self.system.add(a, b, &(da.transpose() * term.information * db));
        }
    }
}

struct Aligner<'a> {
    scans: &'a JointScans<'a>,
    options: &'a JointOptions,
    /// By the place of the later scan.
    pairs: Vec<(usize, usize)>,
    kept: Kept<Prepared>,
    poses: Vec<Pose2>,
}

impl Aligner<'_> {
    fn unknowns(&self, groups: Vec<Range<usize>>) -> Unknowns {
        Unknowns::new(self.scans, groups, &self.pairs)
    }

    /// Moves groups of scans. `None` if that has no solution.
    fn step(&mut self, unknowns: &mut Unknowns, iteration: u32) -> Option<()> {
        unknowns.system.clear();
        self.add_pairs(unknowns, &Gates::of(iteration, self.options));
        let (scans, poses) = (self.scans, &mut self.poses);
        for k in 1..poses.len() {
            if let Some(noise) = &scans.noise[k]
                && unknowns.group_of[k - 1] != unknowns.group_of[k]
            {
                let term = odometry_term(scans, k, noise, poses);
                unknowns.add(&term, k - 1, k, poses);
            }
        }
        for k in 0..unknowns.groups.len() {
            unknowns.system.add(k, k, &Matrix3::from_diagonal_element(DAMPING));
        }
        let steps = unknowns.system.solve_in_place(0.0)?;
        for (group, step) in unknowns.groups.iter().zip(steps) {
            let most = if iteration == 0 { MAX_FIRST_STEP } else { f64::INFINITY };
            move_rigidly(&mut poses[group.clone()], &step, most);
        }
        Some(())
    }

    /// Adds the costs of the pairs of scans.
    fn add_pairs(&self, unknowns: &mut Unknowns, gates: &Gates) {
        let poses = &self.poses;
        let pairs = std::mem::take(&mut unknowns.pairs);
        for pairs in pairs.chunks(PAIRS_AT_ONCE) {
            let wanted: BTreeSet<usize> = pairs.iter().flat_map(|&(a, b)| [a, b]).collect();
            let make = |k: usize| Prepared::new(self.scans.source, k, self.options);
            let scans = self.kept.get(&wanted, make);
            let terms: Vec<[Option<Term>; 2]> = pairs
                .par_iter()
                .map(|&(a, b)| {
                    let term = |a: usize, b: usize| {
                        let target = scans[&a].target.as_ref()?;
                        let a_from_b = poses[a].inverse() * poses[b];
                        Some(pair_term(&scans[&b].source, target, &a_from_b, gates))
                    };
                    [term(a, b), term(b, a)]
                })
                .collect();
            for (&(a, b), [forward, backward]) in pairs.iter().zip(&terms) {
                if let Some(term) = forward {
                    unknowns.add(term, a, b, poses);
                }
                if let Some(term) = backward {
                    unknowns.add(term, b, a, poses);
                }
            }
        }
        unknowns.pairs = pairs;
    }
}

/// Moves poses by a step in x, y and heading, about the first one. No pose moves by more than `most` \[m\], \[rad\] in a
/// direction.
fn move_rigidly(poses: &mut [Pose2], step: &Vector3<f64>, most: f64) {
    let Some((first, rest)) = poses.split_first_mut() else { return };
    let reach_m = rest.iter().map(|pose| pose.distance_m(first)).fold(0.0, f64::max);
    let most_rad = most / reach_m.max(1.0);
    let before = *first;
    first.x_m += step[0].clamp(-most, most);
    first.y_m += step[1].clamp(-most, most);
    first.heading_rad = wrap_angle(first.heading_rad + step[2].clamp(-most_rad, most_rad));
    for pose in rest {
        *pose = *first * (before.inverse() * *pose);
    }
}

/// A scan that takes part in pairs.
struct Prepared {
    /// `None` if it has too few points.
    target: Option<Target>,
    source: Points,
}

impl Prepared {
    fn new(scans: &dyn ScanSource, k: usize, options: &JointOptions) -> Self {
        let scan = scans.scan(k);
        let points = scan.points();
        let is_target = MIN_POINTS <= points.len();
        Self {
            target: is_target.then(|| Target::new(points.clone(), options.first_gate_m)),
            source: points.thin(SOURCE_VOXEL_M),
        }
    }
}

/// Scans are compared with those of the last metres of path \[m\].
const PAIR_PATH_M: f64 = 5.0;
/// After the last few, with one per this distance \[m\].
const PAIR_EVERY_M: f64 = 0.5;
/// With each of this many before it.
const PAIR_LAST: usize = 4;

/// Pairs of scans along the path: each with the last four before it, and then with one per 0.5 m of path,
/// up to 5 m before it.
pub fn pairs_along_path(path_m: &[f64]) -> Vec<(usize, usize)> {
    let mut pairs = Vec::new();
    for later in 0..path_m.len() {
        let mut last = None;
        for (count, earlier) in (0..later).rev().enumerate() {
            if PAIR_PATH_M < path_m[later] - path_m[earlier] || MAX_SCANS_BACK <= count {
                break;
            }
            let is_due =
                last.is_none_or(|last: usize| PAIR_EVERY_M <= path_m[last] - path_m[earlier]);
            if count < PAIR_LAST || is_due {
                pairs.push((earlier, later));
                last = Some(earlier);
            }
        }
    }
    pairs
}

/// A robot that turns in place has many scans within a metre of path. No more than this many before a
/// scan are compared with it.
const MAX_SCANS_BACK: usize = 60;

/// The limits of an iteration.
struct Gates {
    gate_m: f64,
    scale_m: f64,
    /// Information of a point exactly on its line \[1/m^2\].
    information: f64,
    /// One of this many source points takes part.
    every: usize,
}

impl Gates {
    fn of(iteration: u32, options: &JointOptions) -> Self {
        let last = options.iterations.saturating_sub(2).max(1);
        let share = (f64::from(iteration) / f64::from(last)).min(1.0);
        let between = |first: f64, last: f64| first + share * (last - first);
        // Before the last iteration, few points are enough. Each of them counts for several.
        let every = if iteration + 1 < options.iterations { EVERY } else { 1 };
        let points_per_measurement = options.points_per_measurement / every as f64;
        Self {
            every,
            gate_m: between(options.first_gate_m, options.last_gate_m),
            scale_m: between(options.first_scale_m, options.last_scale_m),
            information: 1.0 / (options.noise_m * options.noise_m * points_per_measurement),
        }
    }
}

/// A quadratic cost of the pose of one scan in the frame of another, about the current poses.
struct Term {
    /// Sum of w J^T J.
    information: Matrix3<f64>,
    /// Sum of w r J^T.
    gradient: Vector3<f64>,
}

/// Derivatives of the pose of b in the frame of a, with respect to x, y and heading of a and of b in
/// the map.
pub fn relative_derivatives(a: &Pose2, b: &Pose2) -> [Matrix3<f64>; 2] {
    let (sin, cos) = libm::sincos(a.heading_rad);
    let [dx, dy] = [b.x_m - a.x_m, b.y_m - a.y_m];
    [
        Matrix3::new(
            -cos,
            -sin,
            -sin * dx + cos * dy, //
            sin,
            -cos,
            -cos * dx - sin * dy, //
            0.0,
            0.0,
            -1.0,
        ),
        Matrix3::new(
            cos, sin, 0.0, //
            -sin, cos, 0.0, //
            0.0, 0.0, 1.0,
        ),
    ]
}

/// The distances of the points of one scan from the lines of another one.
fn pair_term(source: &Points, target: &Target, target_from_source: &Pose2, gates: &Gates) -> Term {
    let motion = Motion::new(target_from_source);
    let [mut xx, mut xy, mut xh, mut yy, mut yh, mut hh] = [0.0; 6];
    let [mut gx, mut gy, mut gh] = [0.0; 3];
    let mut searches = AlongScan::new(target);
    for (&q, normal) in source.positions_m.iter().zip(&source.normals).step_by(gates.every) {
        let Some(normal) = *normal else { continue };
        let turned = motion.direction(q);
        let moved = [turned[0] + target_from_source.x_m, turned[1] + target_from_source.y_m];
        let Some(partner) = searches.nearest(moved, gates.gate_m) else { continue };
        let Some(n) = target.points().normals[partner] else { continue };
        let m = motion.direction(normal);
        if m[0] * n[0] + m[1] * n[1] < MIN_NORMAL_COS {
            continue;
        }
        let p = target.points().positions_m[partner];
        let residual_m = (moved[0] - p[0]) * n[0] + (moved[1] - p[1]) * n[1];
        let scaled = residual_m / gates.scale_m;
        let robust = 1.0 / (1.0 + scaled * scaled);
        let w = gates.information * robust * robust;
        let h = n[1] * turned[0] - n[0] * turned[1];
        xx += w * n[0] * n[0];
        xy += w * n[0] * n[1];
        xh += w * n[0] * h;
        yy += w * n[1] * n[1];
        yh += w * n[1] * h;
        hh += w * h * h;
        gx += w * residual_m * n[0];
        gy += w * residual_m * n[1];
        gh += w * residual_m * h;
    }
    let (information, gradient) = discount_normals(
        &Matrix3::new(xx, xy, xh, xy, yy, yh, xh, yh, hh),
        &Vector3::new(gx, gy, gh),
    );
    Term { information, gradient }
}

/// The difference of a step from that of the odometry.
fn odometry_term(scans: &JointScans<'_>, k: usize, noise: &OdometryNoise, poses: &[Pose2]) -> Term {
    let step_m = (scans.path_m[k] - scans.path_m[k - 1]).max(MIN_STEP_M);
    let (std_m, std_rad) = (noise.std_m_over(step_m), noise.std_rad_over(step_m));
    let weights = Vector3::new(std_m, std_m, std_rad).map(|std| 1.0 / (std * std));
    let measured = scans.odometry[k - 1].inverse() * scans.odometry[k];
    let step = poses[k - 1].inverse() * poses[k];
    let error = Vector3::new(
        step.x_m - measured.x_m,
        step.y_m - measured.y_m,
        wrap_angle(step.heading_rad - measured.heading_rad),
    );
    Term { information: Matrix3::from_diagonal(&weights), gradient: weights.component_mul(&error) }
}

#[cfg(test)]
mod tests {
    use dataset::{RangeLimits, Scan};

    use super::*;
    use crate::source::HeldScans;

    #[test]
    fn stretches_cover_all_scans_and_overlap_from_one_iteration_to_the_next() {
        assert_eq!(stretches(10, 4, 0), [0..3, 3..6, 6..10]);
        assert_eq!(stretches(10, 4, 1), [0..1, 1..4, 4..8, 8..10]);
    }

    /// Scans 0 and 4 are held, and a drive begins with scan 7.
    #[test]
    fn groups_have_scans_of_one_drive_that_move() {
        let noise = OdometryNoise::LEAST;
        let noise: Vec<_> = (0..10).map(|k| (k != 7).then_some(noise)).collect();
        let is_held: Vec<bool> = (0..10).map(|k| k == 0 || k == 4).collect();
        let source =
            HeldScans::new(vec![Scan::default(); 10], RangeLimits { min_m: 0.1, max_m: 25.0 });
        let (odometry, path_m) = (vec![Pose2::default(); 10], vec![0.0; 10]);
        let scans = JointScans {
            source: &source,
            odometry: &odometry,
            path_m: &path_m,
            noise: &noise,
            is_held: &is_held,
        };
        assert_eq!(groups(&scans, 2), [1..3, 3..4, 5..7, 7..9, 9..10]);
        assert_eq!(groups(&scans, 1).len(), 8);
    }

    /// The last pose is 10 m ahead of the first one. A turn by 0.1 rad would move it by 1 m.
    #[test]
    fn groups_move_rigidly_and_not_too_far() {
        let start = [0.0, 10.0].map(|x_m| Pose2 { x_m, ..Pose2::default() });
        let step = Vector3::new(0.1, 0.5, 0.1);
        let mut poses = start;
        move_rigidly(&mut poses, &step, f64::INFINITY);
        assert!((poses[0].distance_m(&poses[1]) - 10.0).abs() < 1e-12);
        assert!((poses[1].y_m - 0.5 - 10.0 * 0.1f64.sin()).abs() < 1e-12);
        let mut poses = start;
        move_rigidly(&mut poses, &step, 0.3);
        assert!((poses[0].y_m - 0.3).abs() < 1e-12 && poses[1].y_m < 0.6001, "{poses:?}");
    }
}
