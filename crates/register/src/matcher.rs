//! Scan matching along a drive: each scan against the scans of the last metres.

use std::collections::VecDeque;

use dataset::Pose2;
use model::OdometryNoise;
use nalgebra::Matrix3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::align::{
    AlignOptions, Alignment, Explained, Prior, Weakness, align_and_explain, align_roughly,
    near_share,
};
use crate::correlate::{BlurredMap, Preference, Window, search};
use crate::points::{Points, length};
use crate::target::Target;

/// How the scans of a drive are matched.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct MatcherOptions {
    /// The target consists of the keyframes of the last metres of the path \[m\].
    pub target_path_m: f64,
    /// The most keyframes in the target.
    pub max_keyframes: u32,
    /// Squares of this size keep one point of the target each \[m\].
    pub target_voxel_m: f64,
    /// Target points farther from the expected position than this, along x or y, are left out \[m\].
    pub target_half_width_m: f64,
    /// The search for a start covers at most this distance on either side of the odometry \[m\].
    pub search_m: f64,
    /// The search for a start covers this angle on either side of the odometry \[deg\].
    pub search_deg: f64,
    /// If less than this share of the points is near the target after the alignment, more starts are
    /// tried.
    pub enough_near_share: f64,
    /// The alignment.
    pub align: AlignOptions,
}

impl Default for MatcherOptions {
    fn default() -> Self {
        Self {
            target_path_m: 8.0,
            max_keyframes: 60,
            target_voxel_m: 0.05,
            target_half_width_m: 20.0,
            search_m: 0.3,
            search_deg: 20.0,
            enough_near_share: 0.9,
            align: AlignOptions::default(),
        }
    }
}

/// The pose of a keyframe from scan matching.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Matched {
    /// Pose of the lidar in the frame of the first odometry pose.
    pub pose: Pose2,
    /// Covariance of x, y and heading relative to the keyframes of the target, in the frame of `pose`'s
    /// map, `(3, 3)`. `None` for the first keyframe, which has no error by definition.
    pub covariance: Option<Matrix3<f64>>,
    /// Share of the points that are near a point of the target. 1 for the first keyframe.
    pub near_share: f64,
    /// The direction in which the points determine the position worst. `None` without a target.
    pub weakness: Option<Weakness>,
    /// Whether the scan was used. Not if it contradicts the odometry and has walls in one direction
    /// only: a single line is the ground in front of a scanner that tilts, or something that moves. The
    /// pose is that of the odometry.
    pub is_used: bool,
}

/// Scans with less information about their position in one direction than this share of that in the
/// other say nothing about the odometry.
const MIN_WEAKNESS: f64 = 0.1;
/// Scans with a smaller share of points near those of the last metres say nothing about the odometry.
const MIN_NEAR_SHARE: f64 = 0.8;

/// Whether a scan determined its position, from the share of its points that are near those of the last
/// metres, and the ratio of its [`Weakness`].
pub fn is_decided(near_share: f64, weakness: Option<f64>) -> bool {
    MIN_NEAR_SHARE < near_share && weakness.is_some_and(|ratio| MIN_WEAKNESS < ratio)
}

impl Matched {
    /// Whether the scan determined its position, see [`is_decided`].
    pub(crate) fn is_decided(&self) -> bool {
        let is_first = self.covariance.is_none();
        is_first || is_decided(self.near_share, self.weakness.map(|weakness| weakness.ratio))
    }
}

struct MatchedKeyframe {
    pose: Pose2,
    points: Points,
    path_m: f64,
}

/// Matches the keyframes of a drive one after the other.
pub struct ScanMatcher {
    options: MatcherOptions,
    /// Usual error of the odometry.
    noise: OdometryNoise,
    /// Error of the odometry where the scans contradict the usual one: wheels slip.
    largest_noise: OdometryNoise,
    /// The keyframes of the target, oldest first.
    recent: VecDeque<MatchedKeyframe>,
    last_odometry: Pose2,
    path_m: f64,
}

/// An alignment this close to the odometry needs no search for another start.
const CERTAIN_M: f64 = 0.1;
const CERTAIN_DEG: f64 = 2.0;
/// Below this ratio of the least to the largest information, the points have walls in one direction only.
const ONE_DIRECTION: f64 = 0.02;
/// Squared distance from the odometry in standard deviations that contradicts it: four of them.
const CONTRADICTION: f64 = 16.0;

/// Whether the points lie along one direction and the odometry disagrees.
fn contradicts(aligned: &Alignment, prior: &Prior) -> bool {
    aligned.weakness.is_none_or(|weakness| weakness.ratio < ONE_DIRECTION)
        && CONTRADICTION < prior.chi2(&aligned.target_from_source)
}

/// Squares of the blurred map \[m\], and its standard deviation \[m\].
const MAP_SQUARE_M: f64 = 0.05;
const MAP_BLUR_M: f64 = 0.1;
/// One point per square of this size takes part in the search for a start \[m\].
const SEARCH_VOXEL_M: f64 = 0.1;
/// The search for a start needs this many points.
const MIN_SEARCH_POINTS: usize = 10;
/// Reductions of the score per squared metre and squared radian away from the odometry: an offset of
/// 0.3 m costs as much as 1.4 % of the points.
const PREFERENCE: f64 = 0.15;
/// The path that counts for the odometry error at least \[m\]: a robot that turns in place has one, too.
const MIN_STEP_M: f64 = 0.02;
/// The same for the error of the heading \[m\].
const MIN_TURN_STEP_M: f64 = 0.05;

impl ScanMatcher {
    /// A matcher without keyframes, for odometry that little is known about: `noise` should be large.
    pub fn new(options: MatcherOptions, noise: OdometryNoise) -> Self {
        Self {
            options,
            noise,
            largest_noise: noise,
            recent: VecDeque::new(),
            last_odometry: Pose2::default(),
            path_m: 0.0,
        }
    }

    /// The same matcher for odometry whose usual error is known, see [`OdometryModel`](crate::OdometryModel).
    pub fn with_usual_noise(self, noise: OdometryNoise) -> Self {
        Self { noise, ..self }
    }

    /// Sets the usual error of the odometry from the next keyframe on.
    pub fn set_usual_noise(&mut self, noise: OdometryNoise) {
        self.noise = noise;
    }

    /// Matches the next keyframe: its points in the lidar frame and the pose of the lidar by odometry.
    ///
    /// Only the motion since the last keyframe is used from the odometry.
    pub fn add(&mut self, points: Points, odometry: &Pose2) -> Matched {
        let Some(last) = self.recent.back() else {
            self.last_odometry = *odometry;
            let matched = Matched {
                pose: *odometry,
                covariance: None,
                near_share: 1.0,
                weakness: None,
                is_used: true,
            };
            self.recent.push_back(MatchedKeyframe { pose: *odometry, points, path_m: 0.0 });
            return matched;
        };
        let step = self.last_odometry.inverse() * *odometry;
        let step_m = length([step.x_m, step.y_m]);
        let expected = last.pose * step;
        let prior = prior(&self.noise, expected, step_m);
        let reach_m = self.options.align.first_gate_m;
        let target = Target::new(self.target_points(&expected), reach_m);
        let direct = align_and_explain(&points, &target, &expected, &prior, &self.options.align);
        let Explained { alignment, near_share } = match self.is_certain(&direct, &expected) {
            true => direct,
            false => {
                let start = self.start(&points, target.points(), &expected, step_m);
                let priors = [prior, self::prior(&self.largest_noise, expected, step_m)];
                self.best_alignment(&points, &target, &start, &priors)
            }
        };
        self.last_odometry = *odometry;
        self.path_m += step_m;
        if contradicts(&alignment, &prior) {
            return self.without_scan(&prior);
        }
        let pose = alignment.target_from_source;
        self.recent.push_back(MatchedKeyframe { pose, points, path_m: self.path_m });
        self.forget();
        Matched {
            pose,
            covariance: alignment.covariance(&self.options.align),
            near_share,
            weakness: alignment.weakness,
            is_used: true,
        }
    }

    /// Leaves out the keyframe before the last one if it is close to the one before it. So scans that are
    /// close together can all be matched, and the target still covers the last metres of the path.
    pub fn leave_out_close(&mut self, spacing_m: f64, turn_rad: f64) {
        let Some(n) = self.recent.len().checked_sub(3) else { return };
        let [before, keyframe] = [&self.recent[n].pose, &self.recent[n + 1].pose];
        let is_close = before.distance_m(keyframe) < spacing_m
            && before.heading_difference_rad(keyframe) < turn_rad;
        if is_close {
            self.recent.remove(n + 1);
        }
    }

    /// A keyframe whose scan is not used.
    fn without_scan(&mut self, prior: &Prior) -> Matched {
        let pose = prior.pose;
        self.recent.push_back(MatchedKeyframe {
            pose,
            points: Points::default(),
            path_m: self.path_m,
        });
        self.forget();
        Matched {
            pose,
            covariance: prior.information.cholesky().map(|factor| factor.inverse()),
            near_share: 0.0,
            weakness: None,
            is_used: false,
        }
    }

    /// Whether an alignment that started at the odometry needs no search for another start: it explains
    /// enough of the points and stayed close to the odometry.
    fn is_certain(&self, aligned: &Explained, expected: &Pose2) -> bool {
        let moved = expected.inverse() * aligned.alignment.target_from_source;
        self.options.enough_near_share <= aligned.near_share
            && length([moved.x_m, moved.y_m]) < CERTAIN_M
            && moved.heading_rad.abs() < CERTAIN_DEG.to_radians()
    }

    /// The points of the recent keyframes around the expected position. Of the points in a square, the
    /// newest one with a normal is kept.
    fn target_points(&self, expected: &Pose2) -> Points {
        let half_m = self.options.target_half_width_m;
        let mut target = Points::default();
        for keyframe in self.recent.iter().rev() {
            target.extend_from(&keyframe.pose, &keyframe.points);
        }
        target.retain(|[x, y]| {
            (x - expected.x_m).abs() < half_m && (y - expected.y_m).abs() < half_m
        });
        target.thin(self.options.target_voxel_m)
    }

    /// A start for the alignment: the best pose around the odometry, first in coarse and then in fine
    /// steps.
    fn start(&self, points: &Points, target: &Points, expected: &Pose2, step_m: f64) -> Pose2 {
        let sample = points.thin(SEARCH_VOXEL_M);
        if sample.len() < MIN_SEARCH_POINTS {
            return *expected;
        }
        let map = BlurredMap::new(target, MAP_SQUARE_M, MAP_BLUR_M);
        let preference = Preference { pose: *expected, per_m2: PREFERENCE, per_rad2: PREFERENCE };
        let half_width_m = self.options.search_m.min(0.1 + 0.5 * step_m);
        let coarse = Window {
            centre: *expected,
            half_width_m,
            step_m: 0.1,
            half_turn_rad: self.options.search_deg.to_radians(),
            step_rad: 1.5f64.to_radians(),
        };
        let found = search(&map, &sample, &coarse, &preference);
        let fine = Window {
            centre: found.pose,
            half_width_m: 0.08,
            step_m: 0.04,
            half_turn_rad: 1.5f64.to_radians(),
            step_rad: 0.5f64.to_radians(),
        };
        search(&map, &sample, &fine, &preference).pose
    }

    /// Aligns from the start, and from more starts if that explains too few points. The alignment that
    /// explains most points is the result. The odometry counts with its usual error at first, and with
    /// its largest one from the other starts. Of starts that lead to the same pose, only the first one counts.
    fn best_alignment(
        &self,
        points: &Points,
        target: &Target,
        start: &Pose2,
        [prior, loose]: &[Prior; 2],
    ) -> Explained {
        let options = &self.options.align;
        let mut best = align_and_explain(points, target, start, prior, options);
        // The share at the result of the first alignment decides, so that good drives cost no more.
        if self.options.enough_near_share <= best.near_share {
            return best;
        }
        let share_before = near_share(points, target, &prior.pose, options.first_gate_m);
        let others =
            MORE_STARTS.map(|[x_m, y_m, heading_rad]| prior.pose * Pose2 { x_m, y_m, heading_rad });
        let starts: Vec<&Pose2> = [start].into_iter().chain(&others).collect();
        let rough = |start: &&Pose2| align_roughly(points, target, start, loose, options);
        let ends = different(&starts.par_iter().map(rough).collect::<Vec<_>>());
        let from = |start: &Pose2| align_and_explain(points, target, start, loose, options);
        let all: Vec<Explained> = ends.par_iter().map(from).collect();
        for aligned in all {
            let gain = aligned.near_share - best.near_share;
            let pose = &aligned.alignment.target_from_source;
            let needed = MIN_GAIN * (1.0 + libm::log1p(prior.chi2(pose)));
            if needed < gain && share_before < aligned.near_share {
                best = aligned;
            }
        }
        best
    }

    /// Forgets keyframes that are no longer part of the target. The last one is kept.
    fn forget(&mut self) {
        let from_m = self.path_m - self.options.target_path_m;
        let is_old = |k: &MatchedKeyframe| k.path_m < from_m;
        while self.recent.len() > 1
            && (self.recent.front().is_some_and(is_old)
                || self.recent.len() > self.options.max_keyframes.max(1) as usize)
        {
            self.recent.pop_front();
        }
    }
}

/// Two starts lead to the same pose if the rough results are closer than this.
const SAME_M: f64 = 0.03;
const SAME_DEG: f64 = 0.3;

/// The poses without those that are near an earlier one.
fn different(poses: &[Pose2]) -> Vec<Pose2> {
    let mut different: Vec<Pose2> = Vec::new();
    for pose in poses {
        let is_same = |other: &Pose2| {
            pose.distance_m(other) < SAME_M
                && pose.heading_difference_rad(other) < SAME_DEG.to_radians()
        };
        if !different.iter().any(is_same) {
            different.push(*pose);
        }
    }
    different
}

/// The odometry after a step as a prior.
fn prior(noise: &OdometryNoise, expected: Pose2, step_m: f64) -> Prior {
    let std_m = noise.std_m_over(step_m.max(MIN_STEP_M));
    let std_rad = noise.std_rad_over(step_m.max(MIN_TURN_STEP_M));
    Prior::independent(expected, std_m, std_m, std_rad)
}

/// Another start must explain this much more of the points, and more the less the odometry agrees: ten
/// of its standard deviations away, five times as much. Along a corridor, many positions explain nearly
/// the same, and the ground in front of a scanner that tilts seems to stand still.
const MIN_GAIN: f64 = 0.04;
/// More starts, relative to the odometry: x forward \[m\], y left \[m\], heading \[rad\].
const MORE_STARTS: [[f64; 3]; 11] = [
    [0.5, 0.0, 0.0],
    [-0.5, 0.0, 0.0],
    [-1.0, 0.0, 0.0],
    [0.0, 0.35, 0.0],
    [0.0, -0.35, 0.0],
    [0.0, 0.0, 0.1],
    [0.0, 0.0, -0.1],
    [0.0, 0.0, 0.2],
    [0.0, 0.0, -0.2],
    [0.0, 0.0, 0.35],
    [0.0, 0.0, -0.35],
];

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn only_poses_near_an_earlier_one_are_left_out() {
        let pose = |x_m: f64, heading_deg: f64| Pose2 {
            x_m,
            y_m: 0.0,
            heading_rad: heading_deg.to_radians(),
        };
        let first = pose(1.0, 179.9);
        for (other, n) in [
            (pose(1.029, 179.9), 1),
            (pose(1.031, 179.9), 2),
            (pose(1.0, 179.9 + 0.29), 1),
            (pose(1.0, 179.9 - 0.31), 2),
            // On the other side of 180 deg.
            (Pose2 { heading_rad: -PI + 0.1f64.to_radians(), ..first }, 1),
        ] {
            assert_eq!(different(&[first, other, first]).len(), n, "{other:?}");
        }
    }
}
