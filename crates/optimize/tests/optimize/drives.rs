use std::f64::consts::PI;
use std::sync::Arc;

use dataset::{Pose2, RangeLimits, Scan, SplitMix64};
use model::{Detector, Evidence};
use nalgebra::Matrix3;
use optimize::{Proposal, Reason, Solution, align_every_scan, close_loops};
use register::{
    Drive, HeldScans, OdometryScan, RegisterOptions, Registered, ScanSource, register_drive,
    scans_to_register,
};

use crate::world::{World, lap};

pub(crate) const LIMITS: RangeLimits = RangeLimits { min_m: 0.1, max_m: 25.0 };
pub(crate) const MIN_PATH_M: f64 = 30.0;

/// A drive with all its scans, and where the robot really was.
pub(crate) struct Simulated {
    pub(crate) truth: Vec<Pose2>,
    pub(crate) odometry: Vec<Pose2>,
    scans: Vec<Scan>,
}

impl Simulated {
    /// The heading of the odometry drifts by `bias_deg_per_m`.
    pub(crate) fn new(world: &World, truth: Vec<Pose2>, bias_deg_per_m: f64) -> Self {
        let mut random = SplitMix64::new(5);
        let mut odometry = vec![truth[0]];
        for pair in truth.windows(2) {
            let mut step = pair[0].inverse() * pair[1];
            step.heading_rad += (bias_deg_per_m * 0.2).to_radians();
            odometry.push(odometry[odometry.len() - 1] * step);
        }
        let scans = truth.iter().map(|pose| world.scan(pose, 360, 0.01, &mut random)).collect();
        Self { truth, odometry, scans }
    }

    /// Some of the scans.
    fn held(&self, at: impl Iterator<Item = usize>) -> HeldScans {
        let limits = RegisterOptions::default().limits(LIMITS);
        HeldScans::new(at.map(|k| self.scans[k].clone()), limits)
    }

    /// The poses of all scans, aligned with the map. `at` are those of the registered drive.
    fn every_scan(&self, registered: &Drive, poses: &[Pose2], at: &[usize]) -> Vec<Pose2> {
        let scans = HeldScans::new(self.scans.iter().cloned(), LIMITS);
        align_every_scan(registered, poses, at, &scans, &self.odometry)
    }

    /// The registered drive, and the index of each of its scans. Every third scan is a keyframe.
    pub(crate) fn registered(&self) -> (Drive, Vec<usize>) {
        let options = RegisterOptions::default();
        let scans = self.scans.iter().zip(&self.odometry).enumerate();
        let scans: Vec<OdometryScan> = scans
            .map(|(k, (scan, &odometry))| OdometryScan {
                odometry,
                coverage_deg: scan.coverage_deg,
                is_keyframe: k % 3 == 0,
            })
            .collect();
        let at = scans_to_register(&scans, &options);
        let odometry: Vec<Pose2> = at.iter().map(|&k| self.odometry[k]).collect();
        let scans: Arc<dyn ScanSource> = Arc::new(self.held(at.iter().copied()));
        let noise = Detector::starting_values().odometry;
        let registered = register_drive(&*scans, &odometry, &noise, &options.matcher);
        let drive = Drive::new(
            scans,
            odometry,
            registered.iter().map(|scan| scan.pose).collect(),
            at.iter().map(|&k| k % 3 == 0).collect(),
            registered.iter().map(Registered::is_decided).collect(),
        );
        (drive, at)
    }
}

pub(crate) fn proposal(query: usize, reference: usize, reference_from_query: Pose2) -> Proposal {
    let evidence = Evidence {
        overlap: 0.8,
        known_overlap: 0.9,
        n_known: 200,
        conflict: 0.0,
        margin: 0.3,
        weakness: 0.5,
        classifier: None,
    };
    Proposal {
        query,
        reference,
        reference_from_query,
        covariance: Matrix3::identity() * 1e-3,
        evidence,
        confidence: 0.9,
    }
}

/// Right proposals between keyframes of the second and the first lap.
fn right(drive: &Drive, at: &[usize], truth: &[Pose2]) -> Vec<Proposal> {
    let keyframes: Vec<usize> = (0..at.len()).filter(|&k| drive.is_keyframe[k]).collect();
    let mut proposals = Vec::new();
    for &query in keyframes.iter().step_by(4) {
        let near = keyframes.iter().find(|&&reference| {
            MIN_PATH_M < drive.path_m[query] - drive.path_m[reference]
                && truth[at[query]].distance_m(&truth[at[reference]]) < 1.5
        });
        if let Some(&reference) = near {
            let relative = truth[at[reference]].inverse() * truth[at[query]];
            proposals.push(proposal(query, reference, relative));
        }
    }
    proposals
}

/// Wrong proposals: the robot at the opposite side of the building, as if it were the same place.
fn wrong(drive: &Drive, at: &[usize], truth: &[Pose2]) -> Vec<Proposal> {
    let keyframes: Vec<usize> = (0..at.len()).filter(|&k| drive.is_keyframe[k]).collect();
    let mut proposals = Vec::new();
    for &query in keyframes.iter().step_by(3) {
        let far = keyframes.iter().find(|&&reference| {
            let turn_rad = truth[at[query]].heading_difference_rad(&truth[at[reference]]);
            20.0 < drive.path_m[query] - drive.path_m[reference]
                && 8.0 < truth[at[query]].distance_m(&truth[at[reference]])
                && (turn_rad - PI).abs() < 0.2
        });
        if let Some(&reference) = far {
            proposals.push(proposal(query, reference, Pose2::default()));
        }
    }
    proposals
}

fn n_accepted(solution: &Solution) -> usize {
    solution.closures.iter().filter(|closure| closure.rejected.is_none()).count()
}

/// The largest distance from the truth after the first poses were put on top of each other \[m\].
fn worst_m(poses: &[Pose2], truth: &[Pose2], at: &[usize]) -> f64 {
    let map = truth[at[0]] * poses[0].inverse();
    let errors = poses.iter().zip(at).map(|(&pose, &k)| (map * pose).distance_m(&truth[k]));
    errors.fold(0.0, f64::max)
}

fn two_laps() -> Vec<Pose2> {
    let mut truth = lap();
    truth.extend(lap().into_iter().skip(1));
    truth
}

/// A loop is closed among twice as many wrong proposals, and every scan gets a pose.
#[test]
fn a_second_lap_is_closed_and_wrong_proposals_are_rejected() {
    let drive = Simulated::new(&World::ring_corridor(), two_laps(), 2.0);
    let (registered, at) = drive.registered();
    let right = right(&registered, &at, &drive.truth);
    let wrong = wrong(&registered, &at, &drive.truth);
    assert!(8 <= right.len() && 20 <= wrong.len(), "{} {}", right.len(), wrong.len());
    let proposals: Vec<Proposal> = right.iter().chain(&wrong).copied().collect();
    let detector = Detector::starting_values();
    let solution = close_loops(&registered, &proposals, &detector, MIN_PATH_M);
    let mut closed = Vec::new();
    for closure in solution.closures.iter().filter(|closure| closure.rejected.is_none()) {
        let Proposal { query, reference, reference_from_query, .. } = closure.proposal;
        let expected = drive.truth[at[reference]].inverse() * drive.truth[at[query]];
        let error_m = expected.distance_m(&reference_from_query);
        assert!(error_m < 0.1, "{query} {reference}: {error_m}");
        closed.push(query);
    }
    closed.dedup();
    assert!(40 <= closed.len(), "{} keyframes, {:?}", closed.len(), solution.rounds);
    for wrong in &wrong {
        let found = solution.closures.iter().find(|c| c.proposal == *wrong).unwrap();
        assert!(found.rejected.is_some(), "{wrong:?}");
    }
    let worst = worst_m(&solution.poses, &drive.truth, &at);
    assert!(worst < 0.1, "{worst} m");

    let every = drive.every_scan(&registered, &solution.poses, &at);
    let all: Vec<usize> = (0..every.len()).collect();
    let worst = worst_m(&every, &drive.truth, &all);
    assert!(every.len() == drive.truth.len() && worst < 0.1, "{worst} m");
}

/// Wrong by a factor of 4 either way, the noise of scan matching lets nothing false in.
#[test]
fn a_drive_without_revisits_is_not_closed_whatever_the_drift() {
    let mut truth = lap();
    truth.truncate(3 * truth.len() / 4);
    let drive = Simulated::new(&World::ring_corridor(), truth, 2.0);
    let (registered, at) = drive.registered();
    let wrong = wrong(&registered, &at, &drive.truth);
    assert!(3 <= wrong.len(), "{}", wrong.len());
    for factor in [0.25, 1.0, 4.0] {
        let mut detector = Detector::starting_values();
        detector.drift.std_m_per_sqrt_m *= factor;
        detector.drift.std_rad_per_sqrt_m *= factor;
        let solution = close_loops(&registered, &wrong, &detector, 20.0);
        assert_eq!(n_accepted(&solution), 0, "{factor}");
        assert_eq!(solution.poses, registered.poses, "{factor}");
        let is_explained = |reason| matches!(reason, Reason::Inconsistent | Reason::Unsupported);
        assert!(solution.closures.iter().all(|c| c.rejected.is_some_and(is_explained)));
    }
}

/// A hall with some boxes. The lap of the ring corridor fits into it.
fn hall() -> World {
    let mut world = World(Vec::new());
    world.add_rectangle([-7.0, -8.0], [20.0, 17.0]);
    for [x_m, y_m] in [[2.0, 1.0], [8.5, 2.5], [5.0, 5.5], [10.5, 6.0], [17.0, -4.0], [-5.0, 12.0]]
    {
        world.add_rectangle([x_m, y_m], [x_m + 0.8, y_m + 0.6]);
    }
    world
}

/// A lap in one building, 60 m without a return, then three laps in another one, as one drive. By the odometry, the
/// buildings lie on each other, but with this drift, the graph cannot be certain of it after 60 m of path. So it
/// does not count that the scans of the one do not fit those of the other.
#[test]
fn a_building_that_seems_to_lie_on_another_one_keeps_its_closures() {
    let mut joined = Simulated::new(&hall(), lap(), 0.0);
    let end = *joined.odometry.last().unwrap();
    let mut laps = two_laps();
    laps.extend(lap().into_iter().skip(1));
    let second = Simulated::new(&World::ring_corridor(), laps, 0.0);
    // Out and back, in an open space.
    let out: Vec<Pose2> =
        (1..=150).map(|k| end * Pose2 { x_m: 0.2 * f64::from(k), ..Pose2::default() }).collect();
    let back: Vec<Pose2> = out.iter().rev().copied().collect();
    let away = Pose2 { x_m: 100.0, ..Pose2::default() };
    joined.truth = joined.truth.iter().chain(&out).map(|&pose| away * pose).collect();
    joined.truth.extend(&back);
    let nothing = Scan { coverage_deg: joined.scans[0].coverage_deg, ..Scan::default() };
    joined.scans.extend(vec![nothing; out.len() + back.len()]);
    joined.odometry.extend(out.iter().chain(&back));
    // The first lap ends where the others start.
    joined.truth.extend(&second.truth[1..]);
    joined.odometry.extend(&second.odometry[1..]);
    joined.scans.extend(second.scans.into_iter().skip(1));
    let (registered, at) = joined.registered();
    let right = right(&registered, &at, &joined.truth);
    assert!(8 <= right.len(), "{}", right.len());
    let mut detector = Detector::starting_values();
    detector.drift.std_rad_per_sqrt_m *= 10.0;
    let solution = close_loops(&registered, &right, &detector, MIN_PATH_M);
    let mut closed = Vec::new();
    for closure in solution.closures.iter().filter(|closure| closure.rejected.is_none()) {
        let Proposal { query, reference, reference_from_query, .. } = closure.proposal;
        let expected = joined.truth[at[reference]].inverse() * joined.truth[at[query]];
        let error_m = expected.distance_m(&reference_from_query);
        assert!(error_m < 0.1, "{query} {reference}: {error_m}");
        closed.push(query);
    }
    closed.dedup();
    assert!(40 <= closed.len(), "{} keyframes, {:?}", closed.len(), solution.rounds);
}

#[test]
fn proposals_with_little_confidence_are_not_used() {
    let drive = Simulated::new(&World::ring_corridor(), two_laps(), 0.0);
    let (registered, at) = drive.registered();
    let mut proposals = right(&registered, &at, &drive.truth);
    for proposal in &mut proposals {
        proposal.confidence = 0.1;
        proposal.evidence.overlap = 0.2;
    }
    let detector = Detector::starting_values();
    let solution = close_loops(&registered, &proposals, &detector, MIN_PATH_M);
    assert!(solution.closures.iter().all(|c| c.rejected == Some(Reason::LowConfidence)));
    assert_eq!(solution.poses, registered.poses);
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let drive = Simulated::new(&World::ring_corridor(), two_laps(), 2.0);
    let run = |n_threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
        pool.install(|| {
            let (registered, at) = drive.registered();
            let proposals = right(&registered, &at, &drive.truth);
            let detector = Detector::starting_values();
            let solution = close_loops(&registered, &proposals, &detector, MIN_PATH_M);
            let every = drive.every_scan(&registered, &solution.poses, &at);
            (solution.closures, solution.poses, solution.covariances, every)
        })
    };
    let one = run(1);
    for n_threads in [2, 8] {
        assert!(run(n_threads) == one, "{n_threads} threads");
    }
}

#[test]
fn a_drive_with_one_scan_or_none_has_no_closures() {
    for n in [0, 1] {
        let drive = Simulated::new(&World::ring_corridor(), lap()[..n.max(1)].to_vec(), 0.0);
        let (mut registered, _) = drive.registered();
        if n == 0 {
            registered =
                Drive::of_scans(Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new(), LIMITS);
        }
        let solution = close_loops(&registered, &[], &Detector::starting_values(), MIN_PATH_M);
        assert!(solution.closures.is_empty() && solution.poses.len() == n);
    }
}
