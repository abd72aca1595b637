//! Positions in maps with a known answer.

use dataset::{LocatedState, Pose2, RangeLimits, Scan};
use detect::{Locator, LocatorMap, MapDrive, Position};
use model::Detector;
use register::RegisterOptions;

use crate::world::{World, drive, pose};

const LENGTH_M: f64 = 44.0;
const LIMITS: RangeLimits = RangeLimits { min_m: 0.1, max_m: 25.0 };

/// Poses along a hall.
fn along(from_m: f64, to_m: f64, step_m: f64, y_m: f64) -> Vec<Pose2> {
    let n = ((to_m - from_m) / step_m) as usize;
    (0..=n).map(|k| pose(from_m + step_m * k as f64, y_m, 0.0)).collect()
}

fn map_of(world: &World) -> LocatorMap {
    let poses = along(2.0, LENGTH_M - 2.0, 0.2, 0.1);
    let scans = world.scans(&poses, 360, 1);
    let drive = drive(&scans, &poses);
    LocatorMap::new(&[MapDrive { drive: &drive, poses: &poses, map: 3 }], 2.5, 5.0)
}

fn locator<'a>(map: &'a LocatorMap, detector: &'a Detector) -> Locator<'a> {
    Locator::new(map, detector, &RegisterOptions::default(), LIMITS)
}

/// The positions at scans, with the indices of the scans. The steps are those of the poses, or none.
fn positions(
    locator: &mut Locator<'_>,
    scans: &[Scan],
    steps: Option<&[Pose2]>,
) -> Vec<(usize, Position)> {
    let mut found = Vec::new();
    for (k, scan) in scans.iter().enumerate() {
        let before = steps.zip(k.checked_sub(1)).map(|(poses, before)| poses[before].inverse());
        let step = before.zip(steps).map(|(inverse, poses)| inverse * poses[k]);
        let state = locator.add(scan, step);
        assert_eq!(state, locator.state());
        assert_eq!(state == LocatedState::Located, locator.position().is_some());
        found.extend(locator.position().map(|position| (k, position)));
    }
    found
}

/// A hall that equals itself turned by 180 deg.
fn symmetric() -> World {
    let mut world = World::hall(LENGTH_M / 2.0, 1.2, 5);
    // Without the wall at the far end of the first half.
    world.0.remove(1);
    let turned = |[x, y]: [f64; 2]| [LENGTH_M - x, -y];
    let other: Vec<_> = world.0.iter().map(|wall| wall.map(turned)).collect();
    world.0.extend(other);
    world
}

#[test]
fn a_drive_is_located_with_and_without_odometry() {
    let world = World::hall(LENGTH_M, 1.2, 5);
    let (map, detector) = (map_of(&world), Detector::starting_values());
    let poses = along(10.0, 32.0, 0.1, -0.2);
    let scans = world.scans(&poses, 360, 2);
    for steps in [None, Some(&*poses)] {
        let found = positions(&mut locator(&map, &detector), &scans, steps);
        // 20 m of path are 200 scans.
        assert!(found.first().is_some_and(|(k, _)| *k <= 200), "{:?}", found.first());
        for (k, position) in &found {
            assert_eq!(position.map, 3);
            assert!(position.pose.distance_m(&poses[*k]) < 0.3, "{k}: {position:?}");
            assert!(position.pose.heading_difference_rad(&poses[*k]) < 0.05, "{k}: {position:?}");
            assert!(0.0 <= position.confidence && position.confidence <= 1.0);
            assert!(position.covariance.cholesky().is_some(), "{k}: {position:?}");
        }
        assert_eq!(found.last().map(|(k, _)| *k), Some(scans.len() - 1));
    }
}

#[test]
fn a_symmetric_building_gives_no_position() {
    let world = symmetric();
    let (map, detector) = (map_of(&world), Detector::starting_values());
    let poses = along(3.0, 33.0, 0.1, -0.2);
    let scans = world.scans(&poses, 360, 2);
    assert!(positions(&mut locator(&map, &detector), &scans, None).is_empty());
    // The same drive in the map of a hall with the same first half has a position.
    let mut other = World::hall(LENGTH_M / 2.0, 1.2, 5);
    other.0.remove(1);
    let half = map_of(&other);
    assert!(!positions(&mut locator(&half, &detector), &scans[..150], None).is_empty());
}

#[test]
fn another_building_gives_no_position() {
    let (map, detector) = (map_of(&World::hall(LENGTH_M, 1.2, 5)), Detector::starting_values());
    let poses = along(3.0, 40.0, 0.1, -0.2);
    for seed in [6, 7, 8] {
        let scans = World::hall(LENGTH_M, 1.2, seed).scans(&poses, 360, 2);
        assert!(positions(&mut locator(&map, &detector), &scans, None).is_empty(), "{seed}");
    }
}

/// The states at scans of a drive by odometry. `before` is the pose of the scan before, if there is one.
fn states(
    locator: &mut Locator<'_>,
    scans: &[Scan],
    poses: &[Pose2],
    mut before: Option<Pose2>,
) -> Vec<LocatedState> {
    let mut states = Vec::new();
    for (scan, pose) in scans.iter().zip(poses) {
        let step = before.replace(*pose).map(|before| before.inverse() * *pose);
        states.push(locator.add(scan, step));
    }
    states
}

/// A door to another building: after 6 m of path, no scan fits the map. The odometry goes on, so the path does not
/// begin anew.
#[test]
fn a_position_is_lost_where_the_map_ends_and_found_again() {
    let world = World::hall(LENGTH_M, 1.2, 5);
    let (map, detector) = (map_of(&world), Detector::starting_values());
    let [poses, beyond] = [along(3.0, 20.0, 0.1, -0.2), along(20.1, 42.0, 0.1, -0.2)];
    let mut locator = locator(&map, &detector);
    let scans = world.scans(&poses, 360, 2);
    states(&mut locator, &scans, &poses, None);
    assert_eq!(locator.state(), LocatedState::Located);
    let elsewhere = World::hall(LENGTH_M, 1.2, 9).scans(&beyond, 360, 3);
    let found = states(&mut locator, &elsewhere, &beyond, poses.last().copied());
    // 10 m until the submap has no scan of the hall, and 6 m without a fit. Later, the drift would be too large.
    let lost = found.iter().position(|state| *state == LocatedState::Lost);
    assert!(lost.is_some_and(|lost| (60..=160).contains(&lost)), "{lost:?}");
    states(&mut locator, &scans, &poses, beyond.last().copied());
    assert_eq!(locator.state(), LocatedState::Located);
    let position = locator.position().map(|position| position.pose);
    let last = poses[poses.len() - 1];
    assert!(position.is_some_and(|pose| pose.distance_m(&last) < 0.3), "{position:?}");
}

/// Without odometry, a position ends with the path.
#[test]
fn a_position_is_lost_where_the_path_begins_anew() {
    let world = World::hall(LENGTH_M, 1.2, 5);
    let (map, detector) = (map_of(&world), Detector::starting_values());
    let poses = along(10.0, 30.0, 0.1, -0.2);
    let mut locator = locator(&map, &detector);
    positions(&mut locator, &world.scans(&poses, 360, 2), None);
    assert_eq!(locator.state(), LocatedState::Located);
    // Someone stands before the lidar: too few points to say anything.
    let few = Scan { x_m: vec![0.5; 3], y_m: vec![-0.1, 0.0, 0.1], ..Scan::default() };
    assert_eq!(locator.add(&few, None), LocatedState::Located);
    let mut room = World(Vec::new());
    room.add_rectangle([-15.0, -14.0], [16.0, 17.0]);
    let elsewhere = room.scans(&[pose(0.0, 0.0, 0.0)], 360, 3);
    assert_eq!(locator.add(&elsewhere[0], None), LocatedState::Lost);
}

#[test]
fn an_empty_map_gives_no_position() {
    let (map, detector) = (LocatorMap::new(&[], 2.5, 5.0), Detector::starting_values());
    let poses = along(5.0, 20.0, 0.1, 0.0);
    let scans = World::hall(LENGTH_M, 1.2, 5).scans(&poses, 360, 2);
    assert!(positions(&mut locator(&map, &detector), &scans, None).is_empty());
}
