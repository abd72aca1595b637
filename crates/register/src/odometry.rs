//! The systematic and the random error of the odometry of one drive, from its scans.

use dataset::{Pose2, wrap_angle};
use model::OdometryNoise;
use nalgebra::{Matrix2, Vector2, Vector3};
use rayon::prelude::*;

use crate::matcher::{MatcherOptions, ScanMatcher};
use crate::points::length;
use crate::source::ScanSource;

/// How the odometry of a drive differs from the motion that its scans show.
///
/// A step of the odometry is corrected to `scale` times its motion, and to `turn_scale` times its turn
/// plus `turn_rad_per_m` times its motion ahead. These are the errors of wheels of a wrong radius, of a
/// wrong track, and of two wheels that differ (Borenstein and Feng 1996, "Measurement and correction of
/// systematic odometry errors in mobile robots"). `noise` is what remains.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdometryModel {
    /// Motion per motion of the odometry.
    pub scale: f64,
    /// Turn per turn of the odometry.
    pub turn_scale: f64,
    /// Turn to the left per metre ahead that the odometry does not contain \[rad/m\].
    pub turn_rad_per_m: f64,
    /// Error of a corrected step.
    pub noise: OdometryNoise,
    /// Number of steps that the model was fitted to. 0 if there were fewer than 50: then nothing is
    /// corrected.
    pub n_steps: usize,
}

/// A step of the odometry, and the motion that the scans show. Both are in the frame at its start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdometryStep {
    /// Motion by odometry.
    pub odometry: Pose2,
    /// The same by scan matching.
    pub matched: Pose2,
}

/// The least number of steps for a fit.
const MIN_STEPS: usize = 50;
/// What is known about the scales before the fit: 1 with this standard deviation.
const SCALE_STD: f64 = 0.1;
/// The same for the turn per metre: 0 with this standard deviation \[rad/m\].
const TURN_STD_RAD_PER_M: f64 = 0.1;
/// Rounds of the fit.
const ROUNDS: usize = 8;
/// Share of the errors of a normal distribution within one standard deviation.
const WITHIN_STD: f64 = 0.6827;
/// Path of a step that counts at least \[m\].
const MIN_PATH_M: f64 = 0.05;
/// Squared distance of a step from the scans in standard deviations from which on the wheels slipped:
/// four of them.
const SLIP: f64 = 16.0;

/// Number of scans in a piece of a drive, and the most pieces.
const PIECE: usize = 40;
const MAX_PIECES: usize = 40;

impl OdometryModel {
    /// A model that corrects nothing.
    pub fn unchanged(noise: OdometryNoise) -> Self {
        Self { scale: 1.0, turn_scale: 1.0, turn_rad_per_m: 0.0, noise, n_steps: 0 }
    }

    /// Fits the model to steps. `noise` is the error of odometry in general; the fitted one is not larger.
    pub fn fit(steps: &[OdometryStep], noise: &OdometryNoise) -> Self {
        let mut model = Self::unchanged(*noise);
        if steps.len() < MIN_STEPS {
            return model;
        }
        for _ in 0..ROUNDS {
            model.refit(steps);
        }
        let (std_m_per_m, std_rad_per_sqrt_m) = model.spread(steps);
        model.noise = OdometryNoise {
            std_m_per_m: std_m_per_m.min(noise.std_m_per_m),
            std_m: OdometryNoise::LEAST.std_m.min(noise.std_m),
            std_rad_per_sqrt_m: std_rad_per_sqrt_m.min(noise.std_rad_per_sqrt_m),
            std_rad: OdometryNoise::LEAST.std_rad.min(noise.std_rad),
        };
        model.n_steps = steps.len();
        model
    }

    /// Fits the model to registered scans. Only steps between scans that are decided count, see
    /// [`is_decided`](crate::is_decided).
    ///
    /// # Panics
    /// If the slices have different lengths.
    pub fn of_drive(
        odometry: &[Pose2],
        poses: &[Pose2],
        is_decided: &[bool],
        noise: &OdometryNoise,
    ) -> Self {
        Self::fit(&decided_steps(odometry, poses, is_decided), noise)
    }

    /// Fits the model to a drive before it is registered: pieces of it are registered by themselves.
    pub(crate) fn of_pieces(
        scans: &dyn ScanSource,
        odometry: &[Pose2],
        noise: &OdometryNoise,
        options: &MatcherOptions,
    ) -> Self {
        let n_pieces = odometry.len().div_ceil(PIECE).min(MAX_PIECES);
        let of_pieces: Vec<Vec<OdometryStep>> = (0..n_pieces)
            .into_par_iter()
            .map(|piece| {
                let start = piece * odometry.len() / n_pieces;
                let of_piece = start..(start + PIECE).min(odometry.len());
                let mut matcher = ScanMatcher::new(*options, *noise);
                let matched = of_piece
                    .clone()
                    .map(|k| matcher.add(scans.scan(k).points().clone(), &odometry[k]));
                let (poses, is_decided): (Vec<Pose2>, Vec<bool>) =
                    matched.map(|matched| (matched.pose, matched.is_decided())).unzip();
                decided_steps(&odometry[of_piece], &poses, &is_decided)
            })
            .collect();
        let steps: Vec<OdometryStep> = of_pieces.into_iter().flatten().collect();
        Self::fit(&steps, noise)
    }

    /// A step of the odometry without its systematic error.
    pub fn corrected(&self, step: &Pose2) -> Pose2 {
        Pose2 {
            x_m: self.scale * step.x_m,
            y_m: self.scale * step.y_m,
            heading_rad: self.turn_scale * step.heading_rad + self.turn_rad_per_m * step.x_m,
        }
    }

    /// Poses of the odometry without their systematic error. The first one stays.
    pub fn corrected_poses(&self, poses: &[Pose2]) -> Vec<Pose2> {
        let mut corrected: Vec<Pose2> = poses.first().copied().into_iter().collect();
        for (k, pair) in poses.windows(2).enumerate() {
            let step = self.corrected(&(pair[0].inverse() * pair[1]));
            corrected.push(corrected[k] * step);
        }
        corrected
    }

    /// The error of the step that ends at each pose: that of the model, or `slipping` if the scan-matched
    /// poses are more than four standard deviations away from the corrected odometry, and both scans are
    /// decided.
    pub fn noise_of_steps(
        &self,
        corrected: &[Pose2],
        poses: &[Pose2],
        is_decided: &[bool],
        slipping: &OdometryNoise,
    ) -> Vec<OdometryNoise> {
        let of_step = |k: usize| {
            let before = k.saturating_sub(1);
            let step = OdometryStep::between(corrected, poses, before, k);
            match is_decided[before] && is_decided[k] && SLIP < step.chi2(&self.noise) {
                true => *slipping,
                false => self.noise,
            }
        };
        (0..poses.len()).map(of_step).collect()
    }

    /// A step with its odometry corrected.
    fn corrected_step(&self, step: &OdometryStep) -> OdometryStep {
        OdometryStep { odometry: self.corrected(&step.odometry), ..*step }
    }

    /// Standard deviations of the position per metre and of the heading per square root of a metre
    /// \[rad/sqrt(m)\], at least those that are believed.
    fn spread(&self, steps: &[OdometryStep]) -> (f64, f64) {
        let (mut of_position, mut of_heading): (Vec<f64>, Vec<f64>) = steps
            .iter()
            .map(|step| {
                let [x_m, y_m, turn_rad] = self.corrected_step(step).errors();
                let path_m = step.path_m();
                (x_m.abs().max(y_m.abs()) / path_m, turn_rad.abs() / path_m.sqrt())
            })
            .unzip();
        let rank = (WITHIN_STD * (steps.len() - 1) as f64) as usize;
        let at_rank = |of: &mut [f64]| *of.select_nth_unstable_by(rank, f64::total_cmp).1;
        (
            at_rank(&mut of_position).max(OdometryNoise::LEAST.std_m_per_m),
            at_rank(&mut of_heading).max(OdometryNoise::LEAST.std_rad_per_sqrt_m),
        )
    }

    /// One round of reweighted least squares with Cauchy weights.
    fn refit(&mut self, steps: &[OdometryStep]) {
        let (std_m_per_m, std_rad_per_sqrt_m) = self.spread(steps);
        let held = 1.0 / (SCALE_STD * SCALE_STD);
        let held_turn = 1.0 / (TURN_STD_RAD_PER_M * TURN_STD_RAD_PER_M);
        let [mut information, mut sum] = [held; 2];
        let mut turn_information = Matrix2::new(held, 0.0, 0.0, held_turn);
        let mut turn_sum = Vector2::new(held, 0.0);
        for step in steps {
            let [x_m, _, turn_rad] = self.corrected_step(step).errors();
            let std_m = std_m_per_m * step.path_m();
            let weight = 1.0 / (std_m * std_m + x_m * x_m);
            information += weight * step.odometry.x_m * step.odometry.x_m;
            sum += weight * step.odometry.x_m * step.matched.x_m;
            let variance = std_rad_per_sqrt_m * std_rad_per_sqrt_m * step.path_m();
            let weight = 1.0 / (variance + turn_rad * turn_rad);
            let row = Vector2::new(step.odometry.heading_rad, step.odometry.x_m);
            turn_information += weight * row * row.transpose();
            turn_sum += weight * row * step.matched.heading_rad;
        }
        self.scale = sum / information;
        if let Some(factor) = turn_information.cholesky() {
            let turn = factor.solve(&turn_sum);
            (self.turn_scale, self.turn_rad_per_m) = (turn[0], turn[1]);
        }
    }
}

impl OdometryStep {
    /// The step from pose `a` to pose `b`.
    fn between(odometry: &[Pose2], poses: &[Pose2], a: usize, b: usize) -> Self {
        Self {
            odometry: odometry[a].inverse() * odometry[b],
            matched: poses[a].inverse() * poses[b],
        }
    }

    /// What scan matching adds to the odometry: x, y and turn.
    fn errors(&self) -> [f64; 3] {
        let (matched, odometry) = (&self.matched, &self.odometry);
        [
            matched.x_m - odometry.x_m,
            matched.y_m - odometry.y_m,
            wrap_angle(matched.heading_rad - odometry.heading_rad),
        ]
    }

    /// Path by odometry \[m\], not less than [`MIN_PATH_M`].
    fn path_m(&self) -> f64 {
        length([self.odometry.x_m, self.odometry.y_m]).max(MIN_PATH_M)
    }

    /// Squared error in standard deviations.
    fn chi2(&self, noise: &OdometryNoise) -> f64 {
        let path_m = self.path_m();
        let (std_m, std_rad) = (noise.std_m_over(path_m), noise.std_rad_over(path_m));
        let [x_m, y_m, turn_rad] = self.errors();
        Vector3::new(x_m / std_m, y_m / std_m, turn_rad / std_rad).norm_squared()
    }
}

/// The steps between consecutive scans that are both decided.
fn decided_steps(odometry: &[Pose2], poses: &[Pose2], is_decided: &[bool]) -> Vec<OdometryStep> {
    assert!(odometry.len() == poses.len() && is_decided.len() == poses.len());
    (1..poses.len())
        .filter(|&k| is_decided[k - 1] && is_decided[k])
        .map(|k| OdometryStep::between(odometry, poses, k - 1, k))
        .collect()
}
