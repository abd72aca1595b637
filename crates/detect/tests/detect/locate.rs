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

/// A door to another building: after some metres, no scan fits the map.
#[test]
fn a_position_is_lost_where_the_map_ends_and_found_again() {
    let world = World::hall(LENGTH_M, 1.2, 5);
    let (map, detector) = (map_of(&world), Detector::starting_values());
    let poses = along(5.0, 30.0, 0.1, -0.2);
    let mut locator = locator(&map, &detector);
    let scans = world.scans(&poses, 360, 2);
    assert!(!positions(&mut locator, &scans, Some(&poses)).is_empty());
    let elsewhere = World::hall(LENGTH_M, 1.2, 9).scans(&poses, 360, 3);
    positions(&mut locator, &elsewhere, Some(&poses));
    assert_eq!(locator.state(), LocatedState::Lost);
    let found = positions(&mut locator, &scans, Some(&poses));
    for (k, position) in &found {
        assert!(position.pose.distance_m(&poses[*k]) < 0.3, "{k}: {position:?}");
    }
    assert_eq!(locator.state(), LocatedState::Located);
}

#[test]
fn an_empty_map_gives_no_position() {
    let (map, detector) = (LocatorMap::new(&[], 2.5, 5.0), Detector::starting_values());
    let poses = along(5.0, 20.0, 0.1, 0.0);
    let scans = World::hall(LENGTH_M, 1.2, 5).scans(&poses, 360, 2);
    assert!(positions(&mut locator(&map, &detector), &scans, None).is_empty());
}
