//! Which closures and candidates are right.

use dataset::{Pose2, quantile, wrap_angle};
use serde::Serialize;

use super::calibration::{Calibration, normalized_error};
use super::input::{Drive, FoundCandidate, FoundClosure};
use super::truth::TruePose;

/// A closure whose position differs by more from the truth is false \[m\].
pub const FALSE_M: f64 = 1.0;
/// A closure whose heading differs by more from the truth is false \[deg\].
pub const FALSE_DEG: f64 = 8.0;
/// A closure is right if its position differs by less from the truth \[m\], and its heading by less than
/// [`RIGHT_DEG`].
pub const RIGHT_M: f64 = 0.5;
/// See [`RIGHT_M`] \[deg\].
pub const RIGHT_DEG: f64 = 5.0;
/// True distances between the two keyframes beyond which a closure joins different places \[m\].
pub const PLACE_M: [f64; 3] = [1.5, 3.0, 5.0];

/// How a relative pose agrees with the truth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Within [`RIGHT_M`] and [`RIGHT_DEG`].
    Right,
    /// Neither right nor false.
    Inexact,
    /// Beyond [`FALSE_M`] or [`FALSE_DEG`].
    False,
}

impl Verdict {
    /// The name in the tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Right => "right",
            Self::Inexact => "inexact",
            Self::False => "false",
        }
    }
}

/// A relative pose compared with the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Judged {
    /// Error of the position \[m\].
    pub error_m: f64,
    /// Error of the heading \[rad\].
    pub error_rad: f64,
    /// True distance between the two keyframes \[m\].
    pub distance_m: f64,
    /// True angle between the headings of the two keyframes \[rad\].
    pub heading_difference_rad: f64,
    /// The verdict on the errors.
    pub verdict: Verdict,
}

impl Judged {
    /// Compares a relative pose with the true poses of both keyframes.
    pub fn new(reference_from_query: Pose2, query: Pose2, reference: Pose2) -> Self {
        let truth = reference.inverse() * query;
        let error_m = reference_from_query.distance_m(&truth);
        let error_rad = wrap_angle(reference_from_query.heading_rad - truth.heading_rad).abs();
        let error_deg = error_rad.to_degrees();
        let verdict = if FALSE_M < error_m || FALSE_DEG < error_deg {
            Verdict::False
        } else if error_m < RIGHT_M && error_deg < RIGHT_DEG {
            Verdict::Right
        } else {
            Verdict::Inexact
        };
        Self {
            error_m,
            error_rad,
            distance_m: truth.distance_m(&Pose2::default()),
            heading_difference_rad: wrap_angle(truth.heading_rad).abs(),
            verdict,
        }
    }

    /// Compares a relative pose with the truth, if the truth of both keyframes is known.
    pub(crate) fn of(
        truth: &[Option<TruePose>],
        (query, reference): (usize, usize),
        reference_from_query: Pose2,
    ) -> Option<Self> {
        let (query, reference) = (truth[query]?, truth[reference]?);
        Some(Self::new(reference_from_query, query.pose, reference.pose))
    }
}

/// The errors of accepted closures.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ClosureErrors {
    /// Accepted closures between keyframes whose true poses are known.
    pub n_judged: usize,
    /// Accepted closures without a true pose at one of the keyframes.
    pub n_unknown: usize,
    /// Those beyond [`FALSE_M`] or [`FALSE_DEG`].
    pub n_false_by_pose: usize,
    /// Those whose keyframes are farther apart than each of [`PLACE_M`].
    pub n_false_by_place: [usize; 3],
    /// Those within [`RIGHT_M`] and [`RIGHT_DEG`].
    pub n_right: usize,
    /// Median error of the position \[m\]; `None` without a judged closure.
    pub median_m: Option<f64>,
    /// 90 % quantile of the error of the position \[m\].
    pub p90_m: Option<f64>,
    /// Mean error of the position \[m\].
    pub mean_m: Option<f64>,
    /// Median error of the heading \[deg\].
    pub median_deg: Option<f64>,
    /// 90 % quantile of the error of the heading \[deg\].
    pub p90_deg: Option<f64>,
}

impl ClosureErrors {
    /// The errors of accepted closures; an entry is `None` where the truth is not known.
    pub(crate) fn new(accepted: &[Option<Judged>]) -> Self {
        let judged: Vec<Judged> = accepted.iter().copied().flatten().collect();
        let count = |is: &dyn Fn(&Judged) -> bool| judged.iter().filter(|j| is(j)).count();
        let sorted = |of: fn(&Judged) -> f64| {
            let mut values: Vec<f64> = judged.iter().map(of).collect();
            values.sort_by(f64::total_cmp);
            values
        };
        let metres = sorted(|j| j.error_m);
        let degrees = sorted(|j| j.error_rad.to_degrees());
        let if_any = |value: f64| (!judged.is_empty()).then_some(value);
        Self {
            n_judged: judged.len(),
            n_unknown: accepted.len() - judged.len(),
            n_false_by_pose: count(&|j| j.verdict == Verdict::False),
            n_false_by_place: PLACE_M.map(|most| count(&|j| most < j.distance_m)),
            n_right: count(&|j| j.verdict == Verdict::Right),
            median_m: if_any(quantile(&metres, 0.5)),
            p90_m: if_any(quantile(&metres, 0.9)),
            mean_m: if_any(metres.iter().sum::<f64>() / metres.len() as f64),
            median_deg: if_any(quantile(&degrees, 0.5)),
            p90_deg: if_any(quantile(&degrees, 0.9)),
        }
    }
}

/// How many candidates are right.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct CandidateErrors {
    /// Candidates within [`RIGHT_M`] and [`RIGHT_DEG`].
    pub n_right: usize,
    /// Candidates that are neither right nor false.
    pub n_inexact: usize,
    /// Candidates beyond [`FALSE_M`] or [`FALSE_DEG`].
    pub n_false: usize,
    /// Candidates without a true pose at one of the keyframes.
    pub n_unknown: usize,
}

impl CandidateErrors {
    pub(crate) fn new(candidates: &[Option<Judged>]) -> Self {
        let count = |verdict: Option<Verdict>| {
            candidates.iter().filter(|j| j.map(|j| j.verdict) == verdict).count()
        };
        Self {
            n_right: count(Some(Verdict::Right)),
            n_inexact: count(Some(Verdict::Inexact)),
            n_false: count(Some(Verdict::False)),
            n_unknown: count(None),
        }
    }
}

/// Each closure compared with the truth.
pub(crate) fn judge_closures(
    truth: &[Option<TruePose>],
    of: &[FoundClosure<'_>],
) -> Vec<Option<Judged>> {
    let judge =
        |c: &FoundClosure<'_>| Judged::of(truth, (c.query, c.reference), c.reference_from_query);
    of.iter().map(judge).collect()
}

/// Each candidate compared with the truth.
pub(crate) fn judge_candidates(
    truth: &[Option<TruePose>],
    of: &[FoundCandidate],
) -> Vec<Option<Judged>> {
    let judge =
        |c: &FoundCandidate| Judged::of(truth, (c.query, c.reference), c.reference_from_query);
    of.iter().map(judge).collect()
}

/// The calibration of the accepted closures whose true pose is known.
pub(crate) fn calibration(drive: &Drive<'_>, truth: &[Option<TruePose>]) -> Option<Calibration> {
    let accepted = drive.closures.iter().filter(|closure| closure.rejected.is_none());
    let known = accepted.filter_map(|closure| {
        let (query, reference) = (truth[closure.query]?, truth[closure.reference]?);
        let truth = reference.pose.inverse() * query.pose;
        Some(normalized_error(closure.reference_from_query, truth, &closure.covariance))
    });
    Calibration::new(known)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x_m: f64, y_m: f64, heading_deg: f64) -> Pose2 {
        Pose2 { x_m, y_m, heading_rad: heading_deg.to_radians() }
    }

    /// The reference looks along y. The query is 3 m north of it and looks along -x: 3 m ahead, turned
    /// by 90 deg.
    #[test]
    fn a_closure_is_judged_in_the_frame_of_its_reference() {
        let (reference, query) = (at(10.0, 5.0, 90.0), at(10.0, 8.0, 180.0));
        let judged = Judged::new(at(3.0, 0.3, 86.0), query, reference);
        assert!((judged.error_m - 0.3).abs() < 1e-12);
        assert!((judged.error_rad.to_degrees() - 4.0).abs() < 1e-9);
        assert!((judged.distance_m - 3.0).abs() < 1e-12);
        assert!((judged.heading_difference_rad.to_degrees() - 90.0).abs() < 1e-9);
        assert_eq!(judged.verdict, Verdict::Right);
    }

    #[test]
    fn the_limits_of_right_and_false() {
        let verdict =
            |x_m, deg| Judged::new(at(x_m, 0.0, deg), at(0.0, 0.0, 0.0), Pose2::default()).verdict;
        assert_eq!(verdict(0.49, 4.9), Verdict::Right);
        assert_eq!(verdict(0.5, 0.0), Verdict::Inexact);
        assert_eq!(verdict(0.0, 5.1), Verdict::Inexact);
        assert_eq!(verdict(1.0, 7.9), Verdict::Inexact);
        assert_eq!(verdict(1.01, 0.0), Verdict::False);
        assert_eq!(verdict(0.0, -8.1), Verdict::False);
        // Across 180 deg: 179 and -179 differ by 2 deg.
        let judged = Judged::new(at(0.0, 0.0, -179.0), at(0.0, 0.0, 179.0), Pose2::default());
        assert!((judged.error_rad.to_degrees() - 2.0).abs() < 1e-9);
    }

    /// Errors of 0.1, 0.2, 0.3 and 2 m; true distances of 0, 2, 4 and 6 m. The 90 % quantile lies at
    /// rank 2.7: 0.3 + 0.7 * 1.7 = 1.49.
    #[test]
    fn accepted_closures_are_counted_by_pose_and_by_place() {
        let judged = [(0.1, 0.0), (0.2, 2.0), (0.3, 4.0), (2.0, 6.0)].map(|(error, distance)| {
            Some(Judged::new(
                at(distance + error, 0.0, 1.0),
                at(distance, 0.0, 0.0),
                Pose2::default(),
            ))
        });
        let found = ClosureErrors::new(&[&judged[..], &[None]].concat());
        assert_eq!((found.n_judged, found.n_unknown, found.n_right), (4, 1, 3));
        assert_eq!((found.n_false_by_pose, found.n_false_by_place), (1, [3, 2, 1]));
        let is_near = |value: Option<f64>, expected: f64| (value.unwrap() - expected).abs() < 1e-9;
        assert!(is_near(found.median_m, 0.25) && is_near(found.p90_m, 1.49));
        assert!(is_near(found.mean_m, 0.65) && is_near(found.median_deg, 1.0));
        assert_eq!(ClosureErrors::new(&[None]).median_m, None);
    }
}
