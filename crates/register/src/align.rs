//! Point-to-line alignment of points with a target.

use dataset::{Pose2, wrap_angle};
use nalgebra::{Matrix2, Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use crate::points::{Motion, Points, length};
use crate::target::{Searches, Target};

/// How points are aligned.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct AlignOptions {
    /// The most iterations.
    pub max_iterations: u32,
    /// A point and its partner are at most this far apart in the first iteration \[m\].
    pub first_gate_m: f64,
    /// The same in the sixth iteration and after it \[m\]. The gate shrinks linearly. It is reached earlier if an
    /// iteration hardly changes the pose.
    pub last_gate_m: f64,
    /// Residuals above this value count linearly instead of quadratically (Huber) \[m\].
    pub huber_m: f64,
    /// Standard deviation of the distance of a point from the line of its partner \[m\].
    pub noise_m: f64,
    /// Number of points that count as one independent measurement. Neighbouring returns share the
    /// errors of the range and of the surface.
    pub points_per_measurement: f64,
}

impl Default for AlignOptions {
    fn default() -> Self {
        Self {
            max_iterations: 15,
            first_gate_m: 0.5,
            last_gate_m: 0.2,
            huber_m: 0.04,
            noise_m: 0.03,
            points_per_measurement: 4.0,
        }
    }
}

/// What is known about a pose before the alignment: a mean, and the inverse of the covariance of x, y
/// and heading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    /// The mean.
    pub pose: Pose2,
    /// The inverse covariance, `(3, 3)` \[1/m^2, 1/(m rad), 1/rad^2\].
    pub information: Matrix3<f64>,
}

impl Prior {
    /// A prior with independent errors of these standard deviations.
    pub fn independent(pose: Pose2, std_x_m: f64, std_y_m: f64, std_heading_rad: f64) -> Self {
        let weights = Vector3::new(std_x_m, std_y_m, std_heading_rad).map(|std| 1.0 / (std * std));
        Self { pose, information: Matrix3::from_diagonal(&weights) }
    }

    /// Squared distance of a pose from the mean in standard deviations (Mahalanobis distance).
    pub fn chi2(&self, pose: &Pose2) -> f64 {
        let off = self.off(pose);
        (off.transpose() * self.information * off)[(0, 0)]
    }

    /// The pose minus the mean.
    fn off(&self, pose: &Pose2) -> Vector3<f64> {
        Vector3::new(
            pose.x_m - self.pose.x_m,
            pose.y_m - self.pose.y_m,
            wrap_angle(pose.heading_rad - self.pose.heading_rad),
        )
    }

    /// A prior without information. If the points do not determine a direction, the result stays at `pose` there.
    pub fn none(pose: Pose2) -> Self {
        Self { pose, information: Matrix3::zeros() }
    }
}

/// The result of an alignment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Alignment {
    /// The estimated pose.
    pub target_from_source: Pose2,
    /// Inverse covariance of x, y and heading from the points alone, for `noise_m`, `(3, 3)`. Without
    /// what the errors of the normals seem to say, see [`align`].
    pub information: Matrix3<f64>,
    /// The direction in which the points determine the position worst. `None` without points that
    /// have a partner.
    pub weakness: Option<Weakness>,
    /// Inverse covariance of the prior, `(3, 3)`.
    pub prior_information: Matrix3<f64>,
    /// Number of points with a partner in the last iteration.
    pub n_partners: usize,
    /// Root mean square of the distances from the lines of the partners, each at most `huber_m`
    /// \[m\].
    pub rms_m: f64,
}

/// A point within this distance of the line of a target point is explained \[m\].
pub const NEAR_M: f64 = 0.1;

/// The direction in which the points determine the position worst.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weakness {
    /// Smallest over largest information about the position, 0 to 1. 0 in an empty corridor, 0.5 and
    /// more in a room.
    pub ratio: f64,
    /// Direction with the least information, in the frame of the target \[rad\], 0 to pi.
    pub direction_rad: f64,
}

impl Alignment {
    /// Covariance of x, y and heading from points and prior together. `None` if neither says anything
    /// about a direction.
    ///
    /// The noise of the points is `noise_m`, or larger if their residuals are.
    pub fn covariance(&self, options: &AlignOptions) -> Option<Matrix3<f64>> {
        let information = self.scaled_information(options) + self.prior_information;
        information.cholesky().map(|factor| factor.inverse())
    }

    /// Inverse covariance from the points alone. Their noise is `noise_m`, or larger if their residuals
    /// are.
    pub(crate) fn scaled_information(&self, options: &AlignOptions) -> Matrix3<f64> {
        let excess = (self.rms_m / options.noise_m).max(1.0);
        self.information / (excess * excess)
    }
}

/// The directions of most and least information about the position, with the heading eliminated (Schur
/// complement). `None` without information.
fn weakness_of(information: &Matrix3<f64>) -> Option<Weakness> {
    let heading = information[(2, 2)];
    if heading.is_nan() || heading <= 0.0 {
        return None;
    }
    let mixed = information.fixed_view::<2, 1>(0, 2);
    let position: Matrix2<f64> =
        information.fixed_view::<2, 2>(0, 0) - mixed * mixed.transpose() / heading;
    let (xx, xy, yy) = (position[(0, 0)], position[(0, 1)], position[(1, 1)]);
    let radius = length([(xx - yy) / 2.0, xy]);
    let (most, least) = ((xx + yy) / 2.0 + radius, (xx + yy) / 2.0 - radius);
    let most_rad = libm::atan2(2.0 * xy, xx - yy) / 2.0;
    let direction_rad = (most_rad + std::f64::consts::FRAC_PI_2).rem_euclid(std::f64::consts::PI);
    Some(Weakness { ratio: (least / most).max(0.0), direction_rad })
}

/// The share of the largest information that is not counted in the direction with the least: the mean
/// square of the error of a normal. At 0.06 rad, a bare wall seems to have this much information along
/// itself.
const NORMAL_VARIANCE: f64 = 0.004;

/// Takes away the information that the errors of the normals pretend: in the direction with the least
/// information about the position, [`NORMAL_VARIANCE`] times the information across it.
///
/// Without this, the thousand points of a bare corridor seem to determine the position along it better
/// than the odometry does. Zhang, Kaess and Singh 2016, "On degeneracy of optimization-based state
/// estimation problems", take the whole direction out below a limit; here the limit is soft.
pub(crate) fn discount_normals(
    information: &Matrix3<f64>,
    gradient: &Vector3<f64>,
) -> (Matrix3<f64>, Vector3<f64>) {
    let Some(weakness) = weakness_of(information).filter(|weakness| weakness.ratio.is_finite())
    else {
        return (*information, *gradient);
    };
    let lost = (NORMAL_VARIANCE / weakness.ratio.max(f64::MIN_POSITIVE)).min(1.0);
    let (sin, cos) = libm::sincos(weakness.direction_rad);
    let along = Vector3::new(cos, sin, 0.0);
    // Both with the heading eliminated: the information in the direction, and the pull.
    let heading = information[(2, 2)];
    let mixed = information.column(2).dot(&along) / heading;
    let least = (along.transpose() * information * along)[(0, 0)] - mixed * mixed * heading;
    let pull = gradient.dot(&along) - mixed * gradient[2];
    (information - along * along.transpose() * (lost * least), gradient - along * (lost * pull))
}

/// The gate has its last value after this many steps.
const LAST_GATE: u32 = 5;
/// The smallest cosine of the angle between the normals of a point and its partner: 60 deg.
const MIN_NORMAL_COS: f64 = 0.5;
/// An iteration that changes the pose by less than this sum is the last one \[m + rad\].
const CONVERGED: f64 = 2e-4;
/// After an iteration that changes the pose by less than this sum, the gate has its last value \[m + rad\].
const NEARLY_CONVERGED: f64 = 2e-3;
/// Added to the diagonal of the information, so that directions without any information stay.
const DAMPING: f64 = 1e-6;

/// Until the gate has its last value, every third point of a source takes part ...
const EVERY: usize = 3;
/// ... if that leaves this many.
const MIN_FEW_POINTS: usize = 100;

/// Sums over the pairs of points and partners at one pose.
struct Sums {
    /// Sum of w J^T J.
    information: Matrix3<f64>,
    /// Sum of w r J^T.
    gradient: Vector3<f64>,
    n_partners: usize,
    /// Sum of the squared residuals, each at most `huber_m`.
    squares_m2: f64,
}

impl Sums {
    const NONE: Self = Self {
        information: Matrix3::from_array_storage(nalgebra::ArrayStorage([[0.0; 3]; 3])),
        gradient: Vector3::new(0.0, 0.0, 0.0),
        n_partners: 0,
        squares_m2: 0.0,
    };
}

/// Aligns points with a target by Gauss-Newton on the distances from the lines of their partners
/// (point-to-line, Censi 2008, "An ICP variant using a point-to-line metric"), with Huber weights and
/// a prior.
///
/// The partner of a point is the nearest target point within the gate. A pair counts if the target
/// point has a normal n, and if the normal of the point, if it has one, is within 60 deg of n. The
/// residual is n . (R q + t - p) for the point q and its partner p. In directions without information
/// from the points, the pose stays at the prior. Normals have errors, so that a bare wall seems to say
/// a little about the position along it: 0.4 % of the largest information is not counted in the
/// direction with the least.
///
/// Before the gate has its last value, every third point takes part and counts for three, if there are at least 300. In
/// the last iteration, all points do.
///
/// # Panics
/// If `first_gate_m` is more than the reach of the target (in debug builds).
pub fn align(
    source: &Points,
    target: &Target,
    start: &Pose2,
    prior: &Prior,
    options: &AlignOptions,
) -> Alignment {
    Aligner::new(source, target, prior, options).align(start, false)
}

/// An alignment, and how much the target explains at its result.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Explained {
    /// The alignment.
    pub alignment: Alignment,
    /// Share of the points that the target explains, see [`near_share`].
    pub near_share: f64,
}

/// [`align`], and the share of the points that the target explains. It costs about as much as two iterations.
///
/// # Panics
/// As [`align`].
pub fn align_and_explain(
    source: &Points,
    target: &Target,
    start: &Pose2,
    prior: &Prior,
    options: &AlignOptions,
) -> Explained {
    let mut aligner = Aligner::new(source, target, prior, options);
    let alignment = aligner.align(start, false);
    let pose = &alignment.target_from_source;
    let searches = &mut aligner.searches;
    let near_share = share_of_near(source, target, searches, pose, options.first_gate_m);
    Explained { alignment, near_share }
}

/// The pose of [`align`] by every third point in all iterations, if that leaves enough. It is good enough as a start,
/// and to see which starts lead to the same pose.
///
/// # Panics
/// As [`align`].
pub fn align_roughly(
    source: &Points,
    target: &Target,
    start: &Pose2,
    prior: &Prior,
    options: &AlignOptions,
) -> Pose2 {
    Aligner::new(source, target, prior, options).align(start, true).target_from_source
}

struct Aligner<'a> {
    source: &'a Points,
    target: &'a Target,
    prior: &'a Prior,
    options: &'a AlignOptions,
    searches: Searches<'a>,
}

impl<'a> Aligner<'a> {
    fn new(
        source: &'a Points,
        target: &'a Target,
        prior: &'a Prior,
        options: &'a AlignOptions,
    ) -> Self {
        let searches = Searches::new(target, source.len());
        Self { source, target, prior, options, searches }
    }

    fn align(&mut self, start: &Pose2, is_rough: bool) -> Alignment {
        let is_large = EVERY * MIN_FEW_POINTS <= self.source.len();
        let mut pose = *start;
        let mut sums = Sums::NONE;
        let mut gate = 0;
        let n = self.options.max_iterations.max(1);
        for iteration in 0..n {
            let is_first = gate < LAST_GATE && iteration + 1 < n;
            let every = if is_large && (is_first || is_rough) { EVERY } else { 1 };
            sums = self.sum_pairs(&pose, every, gate_m(gate, self.options));
            if self.options.max_iterations == 0 {
                break;
            }
            let Some(step) = self.step(&sums, &pose) else { break };
            pose.x_m -= step[0];
            pose.y_m -= step[1];
            pose.heading_rad = wrap_angle(pose.heading_rad - step[2]);
            let moved = step.abs().sum();
            if gate == LAST_GATE && moved < CONVERGED {
                break;
            }
            gate = if moved < NEARLY_CONVERGED { LAST_GATE } else { LAST_GATE.min(gate + 1) };
        }
        let n = sums.n_partners;
        Alignment {
            target_from_source: pose,
            information: discount_normals(&sums.information, &sums.gradient).0,
            weakness: weakness_of(&sums.information).filter(|_| 0 < n),
            prior_information: self.prior.information,
            n_partners: n,
            rms_m: (sums.squares_m2 / n.max(1) as f64).sqrt(),
        }
    }

    /// What is subtracted from the pose. The equations have a solution, because the damping makes them positive
    /// definite.
    fn step(&self, sums: &Sums, pose: &Pose2) -> Option<Vector3<f64>> {
        let prior = self.prior;
        let (from_points, gradient) = discount_normals(&sums.information, &sums.gradient);
        let information = from_points + prior.information + Matrix3::from_diagonal_element(DAMPING);
        let gradient = gradient + prior.information * prior.off(pose);
        Some(information.cholesky()?.solve(&gradient))
    }
}

/// The gate after some steps \[m\].
fn gate_m(gate: u32, options: &AlignOptions) -> f64 {
    let share = f64::from(gate) / f64::from(LAST_GATE);
    options.first_gate_m + share * (options.last_gate_m - options.first_gate_m)
}

/// Share of the points that the target explains: a point within [`NEAR_M`] of the line of a target point
/// that is at most `reach_m` away, or of a target point without a normal. 0 without points.
///
/// The distance from the line counts, because the returns on a wall that is seen at a small angle are
/// far apart, and at the same places of each scan in a bare corridor: there, the distances from the
/// points would be smallest if the robot had not moved.
pub fn near_share(source: &Points, target: &Target, pose: &Pose2, reach_m: f64) -> f64 {
    share_of_near(source, target, &mut Searches::new(target, source.len()), pose, reach_m)
}

/// [`near_share`] after other searches.
fn share_of_near(
    source: &Points,
    target: &Target,
    searches: &mut Searches<'_>,
    pose: &Pose2,
    reach_m: f64,
) -> f64 {
    let motion = Motion::new(pose);
    let is_near = |&(k, &q): &(usize, &[f64; 2])| {
        let moved = motion.point(q);
        searches.nearest(k, moved, reach_m).is_some_and(|partner| {
            let p = target.points().positions_m[partner];
            let off = [moved[0] - p[0], moved[1] - p[1]];
            match target.points().normals[partner] {
                Some(n) => (off[0] * n[0] + off[1] * n[1]).abs() < NEAR_M,
                None => length(off) < NEAR_M,
            }
        })
    };
    let n_near = source.positions_m.iter().enumerate().filter(is_near).count();
    n_near as f64 / source.len().max(1) as f64
}

impl Aligner<'_> {
    fn sum_pairs(&mut self, pose: &Pose2, every: usize, gate_m: f64) -> Sums {
        let (target, options) = (self.target, self.options);
        let motion = Motion::new(pose);
        let weight =
            every as f64 / (options.noise_m * options.noise_m * options.points_per_measurement);
        let mut sums = Sums::NONE;
        let [mut xx, mut xy, mut xh, mut yy, mut yh, mut hh] = [0.0; 6];
        let source = self.source.positions_m.iter().zip(&self.source.normals);
        for (k, (&q, normal)) in source.enumerate().step_by(every) {
            let turned = motion.direction(q);
            let moved = [turned[0] + pose.x_m, turned[1] + pose.y_m];
            let Some(partner) = self.searches.nearest(k, moved, gate_m) else { continue };
            let Some(n) = target.points().normals[partner] else { continue };
            if let Some(normal) = *normal {
                let m = motion.direction(normal);
                if m[0] * n[0] + m[1] * n[1] < MIN_NORMAL_COS {
                    continue;
                }
            }
            let p = target.points().positions_m[partner];
            let residual_m = (moved[0] - p[0]) * n[0] + (moved[1] - p[1]) * n[1];
            let w = weight / (residual_m.abs() / options.huber_m).max(1.0);
            // Derivative of the residual with respect to the heading.
            let h = n[1] * turned[0] - n[0] * turned[1];
            xx += w * n[0] * n[0];
            xy += w * n[0] * n[1];
            xh += w * n[0] * h;
            yy += w * n[1] * n[1];
            yh += w * n[1] * h;
            hh += w * h * h;
            sums.gradient += Vector3::new(n[0], n[1], h) * (w * residual_m);
            sums.n_partners += 1;
            sums.squares_m2 += (residual_m * residual_m).min(options.huber_m * options.huber_m);
        }
        sums.information = Matrix3::new(xx, xy, xh, xy, yy, yh, xh, yh, hh);
        sums
    }
}
