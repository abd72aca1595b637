use dataset::{Pose2, RangeLimits, Scan, SplitMix64};
use model::Detector;
use nalgebra::Matrix3;
use optimize::{
    Cause, Contradiction, Edge, Placed, Placement, Reference, ReferencedMap, n_correlated,
    place_by_references,
};
use register::Drive;

use crate::world::gaussian;

const STEP_M: f64 = 0.5;
const SPEED_M_S: f64 = 1.0;

fn pose(x_m: f64, y_m: f64, heading_rad: f64) -> Pose2 {
    Pose2 { x_m, y_m, heading_rad }
}

/// The frame of the references, seen from the first pose.
const FRAME: Pose2 = Pose2 { x_m: 300.0, y_m: -80.0, heading_rad: 2.2 };

/// A drive of 300 m: straight, then a curve to the left, straight, and a curve to the right.
fn truth() -> Vec<Pose2> {
    let mut poses = vec![FRAME];
    for k in 1..600 {
        let turn_rad = match k {
            100..160 => 0.04,
            350..420 => -0.025,
            _ => 0.0,
        };
        poses.push(poses[k - 1] * pose(STEP_M, 0.0, turn_rad));
    }
    poses
}

/// Without the poses.
fn described(placement: &Placement) -> String {
    match placement {
        Placement::Placed(placed) => format!("placed, scatter {}", placed.scatter),
        other => format!("{other:?}"),
    }
}

/// A drive with an odometry that turns by a constant error, in a frame of its own.
struct Made {
    scans: Vec<Scan>,
    truth: Vec<Pose2>,
    odometry: Vec<Pose2>,
    stamps_ns: Vec<i64>,
}

impl Made {
    fn new(bias_deg_per_m: f64) -> Self {
        let truth = truth();
        let error = pose(0.0, 0.0, (bias_deg_per_m * STEP_M).to_radians());
        let mut odometry = vec![Pose2::default()];
        for k in 1..truth.len() {
            odometry.push(odometry[k - 1] * (truth[k - 1].inverse() * truth[k]) * error);
        }
        let step_ns = (STEP_M / SPEED_M_S * 1e9) as i64;
        let stamps_ns = (0..truth.len() as i64).map(|k| k * step_ns).collect();
        Self { scans: vec![Scan::default(); truth.len()], truth, odometry, stamps_ns }
    }

    fn drive(&self) -> Drive {
        let (n, limits) = (self.scans.len(), RangeLimits { min_m: 0.5, max_m: 30.0 });
        let (odometry, poses) = (self.odometry.clone(), self.odometry.clone());
        let scans = self.scans.iter().collect();
        Drive::of_scans(scans, odometry, poses, vec![true; n], vec![true; n], limits)
    }

    /// A fix every 2 s, with independent errors of `std_m` in each direction, of a point on the robot.
    fn fixes(&self, std_m: f64, point: Pose2) -> Vec<Reference> {
        let mut random = SplitMix64::new(3);
        let fix = |scan: usize| {
            let at = self.truth[scan] * point;
            let mut error = || std_m * gaussian(&mut random);
            let measured = pose(at.x_m + error(), at.y_m + error(), 0.0);
            let covariance = Matrix3::from_diagonal_element(std_m * std_m);
            Reference {
                stamp_ns: self.stamps_ns[scan],
                scan,
                scan_from_point: point,
                measured,
                has_heading: false,
                covariance,
                n_correlated: 1.0,
            }
        };
        (0..self.truth.len()).step_by(4).map(fix).collect()
    }

    fn place(&self, references: &[Reference]) -> Placement {
        let drive = self.drive();
        place_by_references(&self.map(&drive), references, &Detector::starting_values())
    }

    fn map<'a>(&'a self, drive: &'a Drive) -> ReferencedMap<'a> {
        let (stamps_ns, poses) = (&self.stamps_ns[..], &self.odometry[..]);
        ReferencedMap { drive, parts: &[0], first_new: 0, stamps_ns, poses, closures: &[] }
    }

    fn placed(&self, references: &[Reference]) -> Placed {
        match self.place(references) {
            Placement::Placed(placed) => placed,
            other => panic!("{}", described(&other)),
        }
    }

    fn contradiction(&self, references: &[Reference]) -> Contradiction {
        match self.place(references) {
            Placement::Contradicted(contradiction) => contradiction,
            other => panic!("{}", described(&other)),
        }
    }

    fn worst_m(&self, poses: &[Pose2]) -> f64 {
        let errors = poses.iter().zip(&self.truth).map(|(a, b)| a.distance_m(b));
        errors.fold(0.0, f64::max)
    }
}

/// A heading error of 0.05 deg/m moves the end of 300 m by 300 * 300 / 2 * 0.05 deg = 39 m or so. With a
/// fix of 1 m every 2 m, at most a metre of it is left.
#[test]
fn references_remove_drift() {
    let made = Made::new(0.05);
    let from_first = FRAME * made.odometry[0].inverse();
    let drifted: Vec<Pose2> = made.odometry.iter().map(|pose| from_first * *pose).collect();
    assert!(15.0 < made.worst_m(&drifted), "{}", made.worst_m(&drifted));
    let placed = made.placed(&made.fixes(1.0, Pose2::default()));
    let worst_m = made.worst_m(&placed.poses);
    assert!(worst_m < 1.0, "{worst_m}");
    assert!(placed.residuals.iter().filter(|r| !r.is_kept).count() < 6, "1 % of 150 expected");
    // The errors have the stated size: their root mean square is near 1.
    let n = placed.residuals.len() as f64;
    let rms = (placed.residuals.iter().map(|r| r.n_stds * r.n_stds).sum::<f64>() / n).sqrt();
    assert!((0.85..1.15).contains(&rms) && placed.scatter < 1.3, "{rms} {}", placed.scatter);
}

/// The errors of the poses agree with their covariances.
#[test]
fn more_references_reduce_the_covariance() {
    let made = Made::new(0.0);
    let fixes = made.fixes(1.0, Pose2::default());
    let few: Vec<Reference> = fixes.iter().step_by(15).copied().collect();
    let (few, many) = (made.placed(&few), made.placed(&fixes));
    let std_m = |placed: &Placed, scan: usize| placed.covariances[scan][(0, 0)].sqrt();
    for scan in [0, 300, 599] {
        let (few_m, many_m) = (std_m(&few, scan), std_m(&many, scan));
        assert!(many_m < 0.7 * few_m && few_m < 1.5, "{scan}: {few_m} {many_m}");
        let error_m = many.poses[scan].distance_m(&made.truth[scan]);
        assert!(error_m < 3.5 * many_m, "{scan}: {error_m} {many_m}");
    }
    // The same fixes, if 30 of them count as one: the covariance of 5 fixes.
    let correlated: Vec<Reference> =
        fixes.iter().map(|fix| Reference { n_correlated: 30.0, ..*fix }).collect();
    let correlated = made.placed(&correlated);
    assert!(2.0 * std_m(&many, 300) < std_m(&correlated, 300));
}

/// 130 fixes agree with the map, and 20 with nothing. If the errors of the 130 are those of 13, most of what is known
/// contradicts the map.
#[test]
fn references_with_common_errors_count_as_fewer() {
    let made = Made::new(0.0);
    let mut fixes = made.fixes(0.5, Pose2::default());
    let mut random = SplitMix64::new(12);
    let wrong = |k: usize| k % 7 == 3 && k / 7 < 20;
    for (k, fix) in fixes.iter_mut().enumerate() {
        if wrong(k) {
            fix.measured.x_m += 40.0 * random.unit() - 60.0;
            fix.measured.y_m += 40.0 * random.unit() + 30.0;
        }
    }
    let placed = made.placed(&fixes);
    let n_rejected = placed.residuals.iter().filter(|residual| !residual.is_kept).count();
    assert!((20..25).contains(&n_rejected), "{n_rejected}");
    for (k, fix) in fixes.iter_mut().enumerate() {
        fix.n_correlated = if wrong(k) { 1.0 } else { 10.0 };
    }
    made.contradiction(&fixes);
}

/// Every fix of a third of the drive jumps to a wrong place, as under a reflection.
#[test]
fn outliers_are_found_and_do_not_bend_the_map() {
    let made = Made::new(0.02);
    let mut fixes = made.fixes(0.5, Pose2::default());
    let clean = made.placed(&fixes);
    let mut random = SplitMix64::new(8);
    for fix in &mut fixes[60..110] {
        fix.measured.x_m += 20.0 + 30.0 * random.unit();
        fix.measured.y_m -= 15.0;
    }
    let placed = made.placed(&fixes);
    assert!(placed.residuals[60..110].iter().all(|r| !r.is_kept && 10.0 < r.distance_m));
    assert!(placed.residuals[..60].iter().filter(|r| !r.is_kept).count() < 5);
    let worst_m = made.worst_m(&placed.poses);
    assert!(worst_m < made.worst_m(&clean.poses) + 1.0, "{worst_m}");
}

/// An antenna 2 m behind the lidar and 1 m to the right: without its place, curves would be off.
#[test]
fn the_place_of_the_antenna_is_used() {
    let made = Made::new(0.0);
    let antenna = pose(-2.0, -1.0, 0.0);
    let placed = made.placed(&made.fixes(0.02, antenna));
    assert!(made.worst_m(&placed.poses) < 0.1, "{}", made.worst_m(&placed.poses));
    let forgotten = |fix: Reference| Reference { scan_from_point: Pose2::default(), ..fix };
    let fixes: Vec<Reference> = made.fixes(0.5, antenna).into_iter().map(forgotten).collect();
    let placed = made.placed(&fixes);
    assert!(1.0 < made.worst_m(&placed.poses), "{}", made.worst_m(&placed.poses));
}

/// Errors that are three times as large as stated are measured.
#[test]
fn understated_errors_are_measured() {
    let made = Made::new(0.0);
    let stated = |fix: &Reference| Reference { covariance: fix.covariance / 9.0, ..*fix };
    let fixes: Vec<Reference> = made.fixes(1.5, Pose2::default()).iter().map(stated).collect();
    let placed = made.placed(&fixes);
    assert!((2.4..3.6).contains(&placed.scatter), "{}", placed.scatter);
    // Fifty times is too much to be believed.
    let stated = |fix: &Reference| Reference { covariance: fix.covariance / 2500.0, ..*fix };
    let fixes: Vec<Reference> = made.fixes(1.5, Pose2::default()).iter().map(stated).collect();
    let contradiction = made.contradiction(&fixes);
    assert_eq!(contradiction.cause, Cause::Understated, "{contradiction:?}");
    assert!((contradiction.stated_std_m - 0.03).abs() < 1e-12);
}

#[test]
fn references_that_contradict_the_map_are_explained() {
    let made = Made::new(0.01);
    let fixes = made.fixes(0.5, Pose2::default());
    let changed = |change: &dyn Fn(&mut Reference)| {
        let mut fixes = fixes.clone();
        fixes.iter_mut().for_each(change);
        made.contradiction(&fixes)
    };
    // x north and y east.
    let swapped = changed(&|fix| std::mem::swap(&mut fix.measured.x_m, &mut fix.measured.y_m));
    assert_eq!(swapped.cause, Cause::Mirrored, "{swapped:?}");
    assert_eq!(swapped.n_references, 150);
    // Feet.
    let feet = changed(&|fix| {
        fix.measured.x_m /= 0.3048;
        fix.measured.y_m /= 0.3048;
    });
    let Cause::Scaled(factor) = feet.cause else { panic!("{feet:?}") };
    assert!((factor * 0.3048 - 1.0).abs() < 0.05, "{factor}");
    // A clock that is 20 s late: those of the last 20 s are left out.
    let late_ns = 20_000_000_000;
    let late: Vec<Reference> = fixes[..140]
        .iter()
        .map(|fix| {
            let stamp_ns = fix.stamp_ns + late_ns;
            let scan = made.stamps_ns.partition_point(|&other| other <= stamp_ns) - 1;
            Reference { stamp_ns, scan, ..*fix }
        })
        .collect();
    let late = made.contradiction(&late);
    assert_eq!(late.cause, Cause::Delayed(-20.0), "{late:?}");
    // Another log: three circles.
    let mut other = fixes.clone();
    for (k, fix) in other.iter_mut().enumerate() {
        let (sin, cos) = (k as f64 / 8.0).sin_cos();
        fix.measured = pose(16.0 * cos, 16.0 * sin, 0.0);
    }
    let other = made.contradiction(&other);
    assert_eq!(other.cause, Cause::Unknown, "{other:?}");
    assert!(10.0 < other.median_m, "{other:?}");
}

#[test]
fn two_positions_or_one_pose_decide() {
    let made = Made::new(0.0);
    let fixes = made.fixes(0.05, Pose2::default());
    assert!(matches!(made.place(&[]), Placement::Undecided { .. }));
    assert!(matches!(made.place(&fixes[..1]), Placement::Undecided { .. }));
    // 2 m apart with 0.5 m each: the direction is known to 0.5 * sqrt(2) / 2 = 0.35 rad = 20 deg.
    let near: Vec<Reference> = made.fixes(0.5, Pose2::default())[..2].to_vec();
    let Placement::Undecided { heading_std_rad } = made.place(&near) else { panic!() };
    assert!((0.2..0.6).contains(&heading_std_rad), "{heading_std_rad}");
    let two = made.placed(&[fixes[0], fixes[140]]);
    assert!(made.worst_m(&two.poses) < 0.3, "{}", made.worst_m(&two.poses));
    let known = made.truth[200];
    let covariance = Matrix3::from_diagonal(&nalgebra::Vector3::new(0.01, 0.01, 1e-4));
    let surveyed =
        Reference { scan: 200, measured: known, has_heading: true, covariance, ..fixes[0] };
    let one = made.placed(&[surveyed]);
    assert!(one.poses[200].distance_m(&known) < 1e-6);
    assert!((one.covariances[200] - covariance).amax() < 1e-6, "{}", one.covariances[200]);
    assert!((one.heading_std_rad - 0.01).abs() < 1e-9);
    // Two surveyed positions whose distance is not that of the drive.
    let moved = Reference { measured: fixes[100].measured, ..fixes[140] };
    assert!(matches!(made.place(&[fixes[0], moved]), Placement::Contradicted(_)));
}

/// Two drives, of which the first one stays. A closure at every tenth scan joins them. Fixes of another origin are
/// an error.
#[test]
fn a_map_that_stays_is_not_moved() {
    let (first, second) = (Made::new(0.0), Made::new(0.03));
    let n = first.truth.len();
    let drive = Drive::joined(vec![first.drive(), second.drive()]);
    let stamps_ns = [&first.stamps_ns[..], &second.stamps_ns[..]].concat();
    let from_first = FRAME * second.odometry[0].inverse();
    let mut poses = first.truth.clone();
    poses.extend(second.odometry.iter().map(|pose| from_first * *pose));
    let closures: Vec<Edge> = (0..40)
        .step_by(10)
        .map(|k| Edge::independent(k, n + k, Pose2::default(), 0.05, 0.01))
        .collect();
    let map = ReferencedMap {
        drive: &drive,
        parts: &[0, 1],
        first_new: 1,
        stamps_ns: &stamps_ns,
        poses: &poses,
        closures: &closures,
    };
    let mut fixes = second.fixes(0.5, Pose2::default());
    fixes.iter_mut().for_each(|fix| fix.scan += n);
    let detector = Detector::starting_values();
    let placed = match place_by_references(&map, &fixes, &detector) {
        Placement::Placed(placed) => placed,
        other => panic!("{}", described(&other)),
    };
    assert_eq!(placed.poses[..n], first.truth[..]);
    assert!(second.worst_m(&placed.poses[n..]) < 1.0, "{}", second.worst_m(&placed.poses[n..]));
    fixes.iter_mut().for_each(|fix| fix.measured.x_m += 40.0);
    let Placement::Contradicted(found) = place_by_references(&map, &fixes, &detector) else {
        panic!()
    };
    let Cause::Moved { .. } = found.cause else { panic!("{found:?}") };
    assert!((30.0..50.0).contains(&found.median_m), "{found:?}");
}

/// At a constant interval dt = T ln 2, the correlations are 1, 1/2, 1/4, ...: their sum is 3 in the middle, and
/// 1 + 1/2 + 1/4 + 1/8 at the end of four.
#[test]
fn the_weight_of_a_fix_is_one_over_the_sum_of_its_correlations() {
    let interval_ns = (60.0 * std::f64::consts::LN_2 * 1e9) as i64;
    let stamps_ns: Vec<i64> = (0..41).map(|k| k * interval_ns).collect();
    let sums = n_correlated(&stamps_ns, 60.0);
    assert!((sums[20] - 3.0).abs() < 1e-4 && (sums[0] - 2.0).abs() < 1e-4, "{sums:?}");
    assert!((n_correlated(&stamps_ns[..4], 60.0)[3] - 1.875).abs() < 1e-6);
    assert_eq!(n_correlated(&stamps_ns[..3], 0.0), [1.0; 3]);
    assert!(n_correlated(&[], 60.0).is_empty());
}

/// A robot that stands still for longer than it drives.
#[test]
fn a_drive_with_a_long_stop_is_placed() {
    let mut made = Made::new(0.05);
    let [stop, n] = [300, 1500];
    let (truth, odometry) = (made.truth[stop], made.odometry[stop]);
    made.truth.splice(stop..stop, vec![truth; n]);
    made.odometry.splice(stop..stop, vec![odometry; n]);
    made.scans = vec![Scan::default(); made.truth.len()];
    made.stamps_ns = (0..made.truth.len() as i64).map(|k| k * 500_000_000).collect();
    let placed = made.placed(&made.fixes(0.3, Pose2::default()));
    let last = made.truth.len() - 1;
    let error_m = placed.poses[last].distance_m(&made.truth[last]);
    assert!(error_m < 1.0, "{error_m}");
}
