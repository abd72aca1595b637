//! Candidates of two places.

use std::f64::consts::PI;

use dataset::{Pose2, Scan};
use detect::{Candidate, Places, find_candidates};
use model::Detector;

use crate::world::{World, drive, pose};

/// Poses around the first one, every 0.3 m.
fn poses_around(centre: Pose2) -> Vec<Pose2> {
    (-3..=3).map(|k| centre * pose(0.3 * f64::from(k), 0.0, 0.0)).collect()
}

/// The candidate of a place of one world and a place of another one.
fn candidate(
    (reference_world, reference): (&World, Pose2),
    (query_world, query): (&World, Pose2),
    coverage_deg: u32,
) -> Option<Candidate> {
    let mut poses = poses_around(reference);
    let mut scans: Vec<Scan> = reference_world.scans(&poses, coverage_deg, 1);
    poses.extend(poses_around(query));
    scans.extend(query_world.scans(&poses[7..], coverage_deg, 2));
    let mut drive = drive(&scans, &poses);
    // A long way between the two places.
    drive.path_m[7..].iter_mut().for_each(|path_m| *path_m += 100.0);
    // Each with the three scans before and after it.
    let places = Places::at(&drive, &poses, vec![3, 10], 1.0);
    let candidates = find_candidates(&drive, &places, &Detector::starting_values(), 30.0, None);
    assert!(candidates.len() <= 1);
    candidates.into_iter().next()
}

fn assert_near(found: &Pose2, expected: &Pose2, max_m: f64, max_deg: f64) {
    let is_near = found.distance_m(expected) < max_m
        && found.heading_difference_rad(expected) < max_deg.to_radians();
    assert!(is_near, "found {found:?}, expected {expected:?}");
}

#[test]
fn the_same_room_is_found_at_any_heading_and_within_3_m() {
    let world = World::room();
    let reference = pose(-1.0, -0.5, 20.0);
    for (x_m, y_m, heading_deg) in
        [(-1.0, -0.5, 20.0), (0.5, 0.5, 110.0), (-2.5, -1.5, -160.0), (1.2, 0.4, -73.0)]
    {
        let query = pose(x_m, y_m, heading_deg);
        let found = candidate((&world, reference), (&world, query), 360).unwrap();
        assert_eq!((found.query, found.reference, found.rank), (10, 3, 0));
        assert_near(&found.reference_from_query, &(reference.inverse() * query), 0.03, 0.5);
        let evidence = found.evidence;
        assert!(evidence.overlap > 0.8 && evidence.known_overlap > 0.8, "{evidence:?}");
        assert!(evidence.conflict < 0.05 && evidence.margin > 0.2, "{evidence:?}");
        assert!(evidence.weakness > 0.2 && evidence.n_known > 100, "{evidence:?}");
        assert!(evidence.classifier.is_none() && found.confidence > 0.99, "{found:?}");
    }
}

/// Half a turn maps the room onto itself, so both poses are right.
#[test]
fn a_room_with_180_deg_symmetry_has_no_margin() {
    let mut world = World(Vec::new());
    world.add_rectangle([-6.0, -2.0], [6.0, 2.0]);
    world.add_rectangle([2.0, 1.0], [3.5, 2.0]);
    world.add_rectangle([-3.5, -2.0], [-2.0, -1.0]);
    let (reference, query) = (pose(0.0, 0.0, 0.0), pose(0.4, -0.3, 30.0));
    let found = candidate((&world, reference), (&world, query), 360).unwrap();
    let turned = pose(-0.4, 0.3, -150.0);
    let is_turned = found.reference_from_query.heading_difference_rad(&turned) < PI / 2.0;
    let expected = if is_turned { turned } else { query };
    assert_near(&found.reference_from_query, &expected, 0.03, 0.5);
    assert!(found.evidence.margin < 0.05, "{:?}", found.evidence);
}

/// The query has a wall across the free space of the reference, from one side of the room to the other.
#[test]
fn a_wall_through_free_space_lowers_the_confidence() {
    let room = World::room();
    let mut divided = room.clone();
    divided.add_rectangle([-1.8, -4.0], [-1.6, 4.0]);
    let (reference, query) = (pose(0.0, 0.0, 0.0), pose(0.3, 0.2, 10.0));
    let same = candidate((&room, reference), (&room, query), 360).unwrap();
    let other = candidate((&room, reference), (&divided, query), 360).unwrap();
    assert!(same.evidence.conflict < 0.05, "{:?}", same.evidence);
    assert!(other.evidence.conflict > 0.2, "{:?}", other.evidence);
    assert!(other.evidence.overlap < same.evidence.overlap - 0.2, "{:?}", other.evidence);
    assert!(other.confidence < same.confidence, "{other:?}");
}

#[test]
fn a_scanner_of_180_deg_finds_the_room_again() {
    let world = World::room();
    let (reference, query) = (pose(-3.0, -1.0, 10.0), pose(-2.6, -0.7, -5.0));
    let found = candidate((&world, reference), (&world, query), 180).unwrap();
    assert_near(&found.reference_from_query, &(reference.inverse() * query), 0.03, 0.5);
}

/// A bare corridor along x: the position along it is unknown, the one across it is not. Its middle is at
/// y = 0.25, so a query at y = 0.3 that is turned by 180 deg fits at y = 0.2.
#[test]
fn the_covariance_of_a_bare_corridor_is_large_along_it() {
    let world = World(vec![[[-90.0, -1.0], [90.0, -1.0]], [[-90.0, 1.5], [90.0, 1.5]]]);
    let found =
        candidate((&world, pose(0.0, 0.0, 0.0)), (&world, pose(0.7, 0.3, 0.0)), 360).unwrap();
    assert!(found.evidence.weakness < 0.1, "{:?}", found.evidence);
    let std_m = [0, 1].map(|k| found.covariance[(k, k)].sqrt());
    assert!(0.5 < std_m[0], "{std_m:?}");
    assert!((std_m[1] - 0.12).abs() < 0.05, "{std_m:?}");
    let is_turned = 1.0 < found.reference_from_query.heading_rad.abs();
    let expected_m = if is_turned { 0.2 } else { 0.3 };
    assert!((found.reference_from_query.y_m - expected_m).abs() < 0.03, "{found:?}");
}

/// In a room, the points determine the pose within millimetres, so nearly all of the covariance is that of
/// the detector: 0.12 m and 2 deg.
#[test]
fn the_covariance_of_a_room_is_little_more_than_that_of_the_detector() {
    let world = World::room();
    let at = pose(0.0, 0.0, 0.0);
    let covariance = candidate((&world, at), (&world, at), 360).unwrap().covariance;
    let std = [0, 1, 2].map(|k| covariance[(k, k)].sqrt());
    assert!((0.12..0.122).contains(&std[0]) && (0.12..0.122).contains(&std[1]), "{std:?}");
    assert!((2f64..2.1).contains(&std[2].to_degrees()), "{std:?}");
    assert!(covariance.cholesky().is_some());
}

#[test]
fn places_without_walls_give_no_candidate() {
    let nothing = World(vec![[[25.0, -20.0], [25.0, 20.0]]]);
    let at = pose(0.0, 0.0, 0.0);
    assert_eq!(candidate((&nothing, at), (&World::room(), at), 360), None);
    assert_eq!(candidate((&nothing, at), (&nothing, at), 360), None);
}
