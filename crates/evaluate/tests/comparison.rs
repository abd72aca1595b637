//! Two runs of loop detection are compared.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::collections::BTreeMap;
use std::sync::Arc;

use dataset::{
    JudgedClosure, Label, MapPose, Pose2, ScanClosure, ScanId, SplitMix64, StampedPose, Trajectory,
};
use evaluate::comparison::{
    ChangeOfClosure, ComparedRun, Comparison, LabelledPair, MappedRun, PlaceRule, Presence,
    Tolerances, compare,
};

const RULE: PlaceRule = PlaceRule { positive_radius_m: 1.5, positive_heading_deg: 180.0 };

fn at(x_m: f64, y_m: f64, heading_deg: f64) -> Pose2 {
    Pose2 { x_m, y_m, heading_rad: heading_deg.to_radians() }
}

fn id(log: &str, scan: u32) -> ScanId {
    ScanId { log: log.into(), scan }
}

/// A keyframe of a log with a scan every 0.1 s, after 5 m of path for each scan.
fn keyframe(log: &str, scan: u32, pose: Pose2) -> MapPose {
    MapPose {
        id: id(log, scan),
        stamp_ns: i64::from(scan) * 100_000_000,
        pose,
        covariance: None,
        is_degenerate: false,
        segment: 0,
        travel_m: 5.0 * f64::from(scan),
        map: 0,
    }
}

/// A closure with standard deviations of 0.04 m and 1 deg.
fn closure(query: ScanId, reference: ScanId, pose: Pose2, rejected: Option<&str>) -> JudgedClosure {
    let (m, rad) = (0.04 * 0.04, 1f64.to_radians() * 1f64.to_radians());
    let closure = ScanClosure {
        query,
        reference,
        reference_from_query: pose,
        covariance: [m, 0.0, 0.0, m, 0.0, rad],
        confidence: 0.9,
        overlap: 0.8,
        known_overlap: 0.9,
        n_known: 500,
        conflict: 0.0,
        margin: 0.2,
        weakness: 0.5,
        classifier: None,
        is_degenerate: false,
    };
    JudgedClosure { closure, rejected: rejected.map(str::to_owned) }
}

/// A run in which every scan is a keyframe.
#[derive(Clone, Default)]
struct Run {
    keyframes: Vec<MapPose>,
    closures: Vec<JudgedClosure>,
    pairs: Option<Vec<LabelledPair>>,
}

impl Run {
    fn new(keyframes: Vec<MapPose>) -> Self {
        Self { keyframes, ..Self::default() }
    }

    /// One log with a scan at each pose.
    fn of_log(log: &str, poses: &[Pose2]) -> Self {
        Self::new((0..).zip(poses).map(|(scan, &pose)| keyframe(log, scan, pose)).collect())
    }

    fn with_closures(self, closures: Vec<JudgedClosure>) -> Self {
        Self { closures, ..self }
    }

    fn trajectories(&self) -> BTreeMap<Arc<str>, Trajectory> {
        let mut poses: BTreeMap<Arc<str>, Vec<StampedPose>> = BTreeMap::new();
        for k in &self.keyframes {
            let pose = StampedPose { segment: k.segment, ..StampedPose::new(k.stamp_ns, k.pose) };
            poses.entry(k.id.log.clone()).or_default().push(pose);
        }
        poses.into_iter().map(|(log, poses)| (log, Trajectory::new(poses).0)).collect()
    }
}

/// The run as it is compared.
fn mapped<'a>(
    run: &'a Run,
    folder: &str,
    trajectories: &'a BTreeMap<Arc<str>, Trajectory>,
) -> (ComparedRun, MappedRun<'a>) {
    let program_version = "1.0.0".to_owned();
    let name = ComparedRun { folder: folder.to_owned(), program_version, seed: 1 };
    let Run { keyframes, closures, pairs } = run;
    (name, MappedRun { keyframes, closures, trajectories, pairs: pairs.as_deref() })
}

fn compared_with(a: &Run, b: &Run, tolerances: Tolerances) -> Comparison {
    let (poses_a, poses_b) = (a.trajectories(), b.trajectories());
    let runs = [mapped(a, "a", &poses_a), mapped(b, "b", &poses_b)];
    compare(runs, Vec::new(), tolerances, RULE)
}

fn compared(a: &Run, b: &Run) -> Comparison {
    compared_with(a, b, Tolerances::default())
}

/// A drive of 8 scans: around a square of 10 m and once more.
fn square() -> Vec<Pose2> {
    let corners =
        [at(0.0, 0.0, 0.0), at(10.0, 0.0, 90.0), at(10.0, 10.0, 180.0), at(0.0, 10.0, -90.0)];
    [corners, corners].concat()
}

/// Closures between the scans of the second and of the first lap.
fn laps() -> Vec<JudgedClosure> {
    (0..4).map(|k| closure(id("monday", k + 4), id("monday", k), at(0.0, 0.0, 0.0), None)).collect()
}

#[test]
fn equal_runs_have_no_differences() {
    let mut run = Run::of_log("monday", &square()).with_closures(laps());
    let scans = [id("monday", 4), id("monday", 0)];
    run.pairs = Some(vec![LabelledPair { scans, label: Label::Positive }]);
    let found = compared(&run, &run);
    assert!(!found.is_changed() && found.notes().is_empty(), "{:?}", found.changes);
    let closures = &found.closures;
    assert_eq!((closures.n_a, closures.n_b, closures.n_kept), (4, 4, 4));
    assert_eq!((closures.n_lost, closures.n_gained, closures.n_moved), (0, 0, 0));
    assert_eq!((closures.n_closed_keyframes_a, closures.n_closed_keyframes_only_a), (8, 0));
    let kept = closures.kept.unwrap();
    assert_eq!((kept.max_m, kept.max_deg, kept.max_std), (0.0, 0.0, Some(0.0)));
    let [trajectory] = &found.trajectories[..] else { panic!("one map") };
    assert_eq!((trajectory.n_scans, trajectory.rmse_m, trajectory.max_m), (8, 0.0, 0.0));
    assert_eq!((trajectory.max_deg, trajectory.a_from_b.heading_rad), (0.0, 0.0));
    let labels = found.labels.unwrap();
    assert_eq!((labels.n_common, labels.n_flips()), (1, 0));
    // Each corner with itself, 20 m of path later.
    assert_eq!((found.places.n_a, found.places.n_b, found.places.n_flips()), (4, 4, 0));
}

#[test]
fn the_frames_of_the_maps_do_not_matter() {
    let frame = at(30.0, -7.0, 123.0);
    let moved: Vec<Pose2> = square().into_iter().map(|pose| frame * pose).collect();
    let (a, b) = (Run::of_log("monday", &square()), Run::of_log("monday", &moved));
    let found = compared(&a, &b);
    assert!(!found.is_changed());
    let trajectory = &found.trajectories[0];
    assert!(trajectory.max_m < 1e-12 && trajectory.max_deg < 1e-10, "{trajectory:?}");
    assert!((trajectory.a_from_b.heading_rad.to_degrees() + 123.0).abs() < 1e-9);
}

/// A shift of (0.03, 0.04) m is 0.05 m, and sqrt(0.75^2 + 1) = 1.25 standard deviations of 0.04 m. A turn of
/// 2 deg is 2 standard deviations.
#[test]
fn a_closure_moves_in_metres_degrees_and_standard_deviations() {
    let run = |shifts: [Pose2; 4]| {
        let mut closures = laps();
        for (closure, shift) in closures.iter_mut().zip(shifts) {
            closure.closure.reference_from_query = shift;
        }
        Run::of_log("monday", &square()).with_closures(closures)
    };
    let still = at(0.0, 0.0, 0.0);
    let a = run([still; 4]);
    let b = run([still, at(0.03, 0.04, 0.0), at(0.0, 0.0, -2.0), still]);
    let limits = |max_shift_m, max_turn_deg| Tolerances {
        max_shift_m,
        max_turn_deg,
        ..Tolerances::default()
    };
    let found = compared_with(&a, &b, limits(0.051, 2.1));
    assert_eq!((found.closures.n_kept, found.closures.n_moved, found.is_changed()), (4, 0, false));
    let kept = found.closures.kept.unwrap();
    let is_near = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-9, "{found}");
    is_near(kept.max_m, 0.05);
    is_near(kept.max_deg, 2.0);
    is_near(kept.max_std.unwrap(), 2.0);
    // Sorted: 0, 0, 1.25, 2.
    is_near(kept.median_std.unwrap(), 0.625);
    assert_eq!((kept.median_m, kept.median_deg), (0.0, 0.0));

    let found = compared_with(&a, &b, limits(0.049, 2.1));
    assert_eq!(
        (found.closures.n_moved, &found.changes[..]),
        (1, &["closures_moved".to_owned()][..])
    );
    let change = &found.closures.changes[0];
    assert_eq!(
        (change.change, change.query_scan, change.reference_scan),
        (ChangeOfClosure::Moved, 5, 1)
    );
    is_near(change.shift_m.unwrap(), 0.05);
    is_near(change.shift_std.unwrap(), 1.25);
    assert_eq!(compared_with(&a, &b, limits(0.049, 1.9)).closures.n_moved, 2);
}

/// If the other scan is the query, the relative pose is the inverse.
#[test]
fn a_closure_is_the_same_whichever_scan_is_the_query() {
    let pose = at(1.0, 2.0, 30.0);
    let (query, reference) = (id("monday", 5), id("monday", 1));
    let run = |closure| Run::of_log("monday", &square()).with_closures(vec![closure]);
    let a = run(closure(query.clone(), reference.clone(), pose, None));
    let b = run(closure(reference, query, pose.inverse(), None));
    let found = compared(&a, &b);
    assert!(!found.is_changed() && found.closures.n_kept == 1);
    assert!(found.closures.kept.unwrap().max_m < 1e-12);
}

#[test]
fn lost_and_gained_closures_are_counted_by_reason() {
    let keyframes = Run::of_log("monday", &square());
    let pair = |query, reference, rejected| {
        closure(id("monday", query), id("monday", reference), at(0.0, 0.0, 0.0), rejected)
    };
    // Lost: 4-0 inconsistent, 5-1 not in the table, 6-2 without the keyframe 6. Kept: 7-3.
    let accepted = [(4, 0), (5, 1), (6, 2), (7, 3)].map(|(q, r)| pair(q, r, None));
    let a = keyframes
        .clone()
        .with_closures([&accepted[..], &[pair(7, 0, Some("unsupported"))]].concat());
    // Gained: 7-0, which was unsupported.
    let of_b = [(4, 0, Some("inconsistent")), (7, 3, None), (7, 0, None)];
    let mut b = keyframes.with_closures(of_b.map(|(q, r, rejected)| pair(q, r, rejected)).into());
    b.keyframes.retain(|keyframe| keyframe.id.scan != 6);
    let found = compared(&a, &b);
    assert_eq!(found.changes, ["closures_lost", "closures_gained"]);
    let closures = &found.closures;
    assert_eq!((closures.n_a, closures.n_b, closures.n_kept), (4, 2, 1));
    assert_eq!((closures.n_lost, closures.n_gained), (3, 1));
    let reasons: Vec<(&str, usize)> = closures.lost.iter().map(|c| (&*c.reason, c.n)).collect();
    assert_eq!(reasons, [("inconsistent", 1), ("no_keyframe", 1), ("not_found", 1)]);
    assert_eq!((&*closures.gained[0].reason, closures.gained.len()), ("unsupported", 1));
    // Without keyframe 6, A closes 0, 1, 2, 3, 4, 5 and 7, and B closes 0, 3 and 7.
    assert_eq!((closures.n_closed_keyframes_a, closures.n_closed_keyframes_b), (7, 3));
    assert_eq!((closures.n_closed_keyframes_only_a, closures.n_closed_keyframes_only_b), (4, 0));
    let tolerances = Tolerances { max_lost: 3, max_gained: 1, ..Tolerances::default() };
    assert!(!compared_with(&a, &b, tolerances).is_changed());
    let tolerances = Tolerances { max_lost: 2, max_gained: 1, ..Tolerances::default() };
    assert_eq!(compared_with(&a, &b, tolerances).changes, ["closures_lost"]);
}

/// A rejected candidate and an accepted closure of the same two scans: the pair is accepted.
#[test]
fn a_pair_with_an_accepted_and_a_rejected_pose_is_accepted() {
    let keyframes = Run::of_log("monday", &square());
    let pair = |pose, rejected| closure(id("monday", 4), id("monday", 0), pose, rejected);
    let far = at(5.0, 0.0, 90.0);
    let a = keyframes.clone().with_closures(vec![pair(at(0.0, 0.0, 0.0), None)]);
    let b = keyframes.with_closures(vec![
        pair(far, Some("inconsistent")),
        pair(at(0.0, 0.0, 0.0), None),
        pair(far, Some("low_confidence")),
    ]);
    assert!(!compared(&a, &b).is_changed() && !compared(&b, &a).is_changed());
}

/// Of four scans 10 m from the centre, those on the x axis move outwards by 0.3 m. By symmetry, the best
/// alignment is none. Sorted distances: 0, 0, 0.3, 0.3.
#[test]
fn the_largest_difference_of_a_trajectory_is_located() {
    let poses =
        |x_m: f64| [at(x_m, 0.0, 0.0), at(0.0, 10.0, 0.0), at(-x_m, 0.0, 0.0), at(0.0, -10.0, 4.0)];
    let a = Run::of_log("monday", &poses(10.0));
    let mut b = Run::of_log("monday", &poses(10.3));
    b.keyframes[3].pose.heading_rad = 0.0;
    let found = compared(&a, &b);
    assert_eq!(found.changes, ["trajectory_changed"]);
    let trajectory = &found.trajectories[0];
    let is_near = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-9, "{found}");
    is_near(trajectory.median_m, 0.15);
    is_near(trajectory.max_m, 0.3);
    is_near(trajectory.rmse_m, (0.09f64 / 2.0).sqrt());
    is_near(trajectory.max_deg, 4.0);
    is_near(trajectory.median_deg, 0.0);
    let farthest = &trajectory.farthest;
    assert!([0, 2].contains(&farthest.keyframe));
    assert_eq!(farthest.travel_m, 5.0 * f64::from(farthest.keyframe));
    is_near(farthest.x_m.abs(), 10.0);
    let limits = |max_shift_m, max_turn_deg| Tolerances {
        max_shift_m,
        max_turn_deg,
        ..Tolerances::default()
    };
    assert!(!compared_with(&a, &b, limits(0.31, 4.1)).is_changed());
    assert!(compared_with(&a, &b, limits(0.29, 4.1)).is_changed());
    assert!(compared_with(&a, &b, limits(0.31, 3.9)).is_changed());
}

/// In B, tuesday lies 1 m higher than monday. Each log alone is unchanged. Together, the best alignment puts
/// the error on both: 0.5 m each.
#[test]
fn a_shift_between_two_logs_of_a_map_is_found() {
    let both = |shift_m: f64| {
        let monday = Run::of_log("monday", &square()).keyframes;
        let up: Vec<Pose2> =
            square().iter().map(|p| Pose2 { y_m: p.y_m + shift_m, ..*p }).collect();
        Run::new([monday, Run::of_log("tuesday", &up).keyframes].concat())
    };
    let found = compared(&both(0.0), &both(1.0));
    let rows: Vec<(usize, f64)> =
        found.trajectories.iter().map(|t| (t.logs.len(), t.max_m)).collect();
    let expected = [(1, 0.0), (1, 0.0), (2, 0.5)];
    for ((n, max_m), (expected_n, expected_m)) in rows.iter().zip(expected) {
        assert!(*n == expected_n && (max_m - expected_m).abs() < 1e-9, "{rows:?}");
    }
    assert_eq!(found.trajectories[2].logs, ["monday", "tuesday"]);
    assert_eq!((rows.len(), found.changes[0].as_str()), (3, "trajectory_changed"));
}

/// Monday and tuesday share a map in A, tuesday and wednesday in B.
#[test]
fn logs_that_share_a_map_in_one_run_only_are_listed() {
    let run = |maps: [u32; 3]| {
        let keyframes =
            ["monday", "tuesday", "wednesday"].iter().zip(maps).flat_map(|(log, map)| {
                let keyframes = Run::of_log(log, &square()).keyframes.into_iter();
                keyframes.map(move |keyframe| MapPose { map, ..keyframe })
            });
        Run::new(keyframes.collect())
    };
    let found = compared(&run([0, 0, 1]), &run([0, 1, 1]));
    assert_eq!(found.maps.joined_only_in_a, [["monday", "tuesday"]]);
    assert_eq!(found.maps.joined_only_in_b, [["tuesday", "wednesday"]]);
    assert_eq!(found.changes[0], "maps_joined_or_split");
    // Neither run aligns logs of two maps together: one entry per log.
    assert_eq!(found.trajectories.len(), 3);
    assert!(found.trajectories.iter().all(|t| t.max_m == 0.0));
    assert_eq!(compared(&run([0, 0, 1]), &run([1, 1, 0])).changes, [""; 0]);
}

/// In B, the second lap is a segment and a map of its own. Its 4 pairs with the first lap are no longer
/// comparable.
#[test]
fn a_log_that_falls_apart_is_reported() {
    let a = Run::of_log("monday", &square());
    let mut b = a.clone();
    for keyframe in &mut b.keyframes[4..] {
        (keyframe.segment, keyframe.map) = (1, 1);
    }
    let found = compared(&a, &b);
    assert_eq!(found.changes, ["maps_of_log_changed", "places_changed"]);
    assert_eq!((found.logs[0].n_maps_a, found.logs[0].n_maps_b), (1, 2));
    assert_eq!((found.places.n_only_a, found.places.n_in_two_maps), (4, 4));
    assert_eq!((found.places.n_only_b, found.places.farthest_m), (0, None));
    // Each lap is aligned on its own.
    assert_eq!(found.trajectories.iter().map(|t| t.n_scans).collect::<Vec<_>>(), [4, 4]);
}

#[test]
fn logs_of_one_run_only_are_not_lost_closures() {
    let with = |log: &str| {
        let monday = Run::of_log("monday", &square()).keyframes;
        let other = Run::of_log(log, &square()).keyframes;
        let between = closure(id(log, 1), id("monday", 1), at(0.0, 0.0, 0.0), None);
        Run::new([monday, other].concat()).with_closures([laps(), vec![between]].concat())
    };
    let (a, b) = (with("tuesday"), with("friday"));
    let found = compared(&a, &b);
    assert_eq!(found.changes, ["logs_removed", "logs_added"]);
    let presence: Vec<_> = found.logs.iter().map(|log| (&*log.log, log.presence)).collect();
    let expected =
        [("friday", Presence::OnlyB), ("monday", Presence::Both), ("tuesday", Presence::OnlyA)];
    assert_eq!(presence, expected);
    let closures = &found.closures;
    assert_eq!((closures.n_kept, closures.n_lost, closures.n_gained), (4, 0, 0));
    assert_eq!((closures.n_with_logs_only_in_a, closures.n_with_logs_only_in_b), (1, 1));
    let allow = Tolerances { allow_new_logs: true, ..Tolerances::default() };
    assert_eq!(compared_with(&a, &b, allow).changes, ["logs_removed"]);
    let alone = Run::of_log("monday", &square()).with_closures(laps());
    assert!(!compared_with(&alone, &b, allow).is_changed());
}

/// Another recording has the same name: scans 4 to 7 have other stamps.
#[test]
fn other_scans_under_the_same_name_are_counted_and_not_compared() {
    let mut a = Run::of_log("monday", &square()).with_closures(laps());
    let pair = |query| LabelledPair {
        scans: [id("monday", query), id("monday", 0)],
        label: Label::Positive,
    };
    a.pairs = Some(vec![pair(4), pair(1)]);
    let mut b = a.clone();
    for keyframe in &mut b.keyframes[4..] {
        keyframe.stamp_ns += 1;
    }
    b.pairs =
        Some([pair(4), pair(1)].map(|pair| LabelledPair { label: Label::Negative, ..pair }).into());
    let found = compared(&a, &b);
    let log = &found.logs[0];
    assert_eq!((log.n_common_keyframes, log.n_other_stamps), (4, 4));
    assert_eq!(
        found.changes,
        ["other_scans", "closures_lost", "closures_gained", "labels_changed"]
    );
    assert_eq!((found.closures.n_kept, found.closures.n_lost, found.closures.n_gained), (0, 4, 4));
    assert!(found.closures.lost.iter().all(|count| count.reason == "other_scan"));
    assert_eq!(found.trajectories[0].n_scans, 4);
    let labels = found.labels.unwrap();
    assert_eq!((labels.n_a, labels.n_common, labels.n_positive_to_negative), (2, 1, 1));
    // No pair of the first lap alone is at the same place.
    assert_eq!(found.places.n_a, 0);
}

#[test]
fn flipped_labels_are_counted_by_direction() {
    let run = |labels: [Option<Label>; 4]| {
        let pairs = (1..).zip(labels).filter_map(|(query, label)| {
            Some(LabelledPair { scans: [id("monday", query), id("monday", 0)], label: label? })
        });
        Run { pairs: Some(pairs.collect()), ..Run::of_log("monday", &square()) }
    };
    let (positive, negative) = (Some(Label::Positive), Some(Label::Negative));
    let a = run([positive, positive, negative, None]);
    let mut b = run([negative, None, positive, positive]);
    // The order of the two scans does not matter.
    b.pairs.as_mut().unwrap()[0].scans.reverse();
    let found = compared(&a, &b);
    assert_eq!(found.changes, ["labels_changed"]);
    let labels = found.labels.as_ref().unwrap();
    assert_eq!((labels.n_a, labels.n_b, labels.n_common), (3, 3, 2));
    assert_eq!((labels.n_positive_to_negative, labels.n_negative_to_positive), (1, 1));
    let flip = &labels.flips[1];
    assert_eq!((flip.query_scan, flip.label_a, flip.label_b), (3, -1, 1));
    let tolerances = Tolerances { max_flips: 2, ..Tolerances::default() };
    assert!(!compared_with(&a, &b, tolerances).is_changed());
    let without = Run { pairs: None, ..b };
    assert_eq!(compared(&a, &without).labels, None);
}

/// Scan 2 comes back to scan 0, at 1.4 m in A and at 1.7 m in B. The neighbours 0 and 1 are 1 m apart, but
/// only 5 m of path.
#[test]
fn pairs_that_leave_a_place_are_counted_with_their_distance() {
    let run = |back_m: f64| {
        Run::of_log(
            "monday",
            &[at(0.0, 0.0, 0.0), at(1.0, 0.0, 0.0), at(0.0, back_m, 90.0), at(50.0, 0.0, 0.0)],
        )
    };
    let found = compared(&run(1.4), &run(1.7)).places;
    assert_eq!((found.n_a, found.n_b, found.n_only_a, found.n_only_b), (1, 0, 1, 0));
    assert!((found.farthest_m.unwrap() - 1.7).abs() < 1e-12);
    let back = compared(&run(1.7), &run(1.4)).places;
    assert_eq!((back.n_a, back.n_only_a, back.n_only_b), (0, 0, 1));
    assert_eq!(back.farthest_m, found.farthest_m);
}

/// The squares find the same pairs as a comparison of each keyframe with each other one.
#[test]
fn places_are_those_of_a_comparison_of_all_pairs() {
    let mut random = SplitMix64::new(7);
    let mut number = |size: f64| random.unit() * size;
    let poses: Vec<Pose2> =
        (0..300).map(|_| at(number(20.0) - 10.0, number(20.0) - 10.0, number(360.0))).collect();
    let run = Run::of_log("monday", &poses);
    let mut expected = 0;
    for (k, a) in poses.iter().enumerate() {
        // Two scans have 10 m of path between them.
        expected += (0..k.saturating_sub(1)).filter(|&l| a.distance_m(&poses[l]) <= 1.5).count();
    }
    assert!(500 < expected, "{expected}");
    assert_eq!(compared(&run, &run).places.n_a, expected);
}

#[test]
fn options_out_of_range_are_named() {
    let message = |tolerances: Tolerances| tolerances.check().unwrap_err().to_string();
    let with = |max_shift_m| Tolerances { max_shift_m, ..Tolerances::default() };
    assert!(message(with(-1.0)).contains("--max-shift-m"), "{}", message(with(-1.0)));
    assert!(message(with(f64::NAN)).contains("--max-shift-m"));
    let rule = PlaceRule { positive_radius_m: 0.0, ..RULE };
    assert!(rule.check().unwrap_err().to_string().contains("--positive-radius-m"));
    assert!(Tolerances::default().check().is_ok() && RULE.check().is_ok());
}
