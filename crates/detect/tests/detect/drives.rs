//! Candidates of whole drives.

use dataset::{Pose2, Scan};
use detect::{Candidate, Places, find_candidates};
use model::Detector;
use register::Drive;

use crate::world::{World, drive, pose};

const LENGTH_M: f64 = 36.0;

/// Along the corridor, a turn on the spot, and back on the other side.
fn there_and_back() -> Vec<Pose2> {
    let n = 160;
    let along = |k: i32| 2.0 + 0.2 * f64::from(k);
    let mut poses: Vec<Pose2> = (0..n).map(|k| pose(along(k), 0.2, 0.0)).collect();
    poses.extend((1..12).map(|k| pose(along(n - 1), 0.2, 15.0 * f64::from(k))));
    poses.extend((0..n).rev().map(|k| pose(along(k), -0.2, 180.0)));
    poses
}

fn candidates(drive: &Drive, n_candidates: u32) -> Vec<Candidate> {
    let places = Places::new(drive, &drive.poses, 2.5, 5.0);
    let detector = Detector { n_candidates, ..Detector::starting_values() };
    find_candidates(drive, &places, &detector, 20.0, None)
}

fn is_right(candidate: &Candidate, poses: &[Pose2]) -> bool {
    let expected = poses[candidate.reference].inverse() * poses[candidate.query];
    candidate.reference_from_query.distance_m(&expected) < 0.1
        && candidate.reference_from_query.heading_difference_rad(&expected) < 0.02
}

#[test]
fn a_place_is_a_keyframe_every_2_m_with_the_scans_around_it() {
    let poses = there_and_back();
    let scans = World::hall(LENGTH_M, 1.2, 5).scans(&poses, 360, 1);
    let mut drive = drive(&scans, &poses);
    for (k, is_keyframe) in drive.is_keyframe.iter_mut().enumerate() {
        *is_keyframe = k % 3 == 1;
    }
    let places = Places::new(&drive, &poses, 2.0, 1.0);
    assert_eq!(places.scans.len(), places.submaps.len());
    assert_eq!(places.scans[0], 1);
    for pair in places.scans.windows(2) {
        let step_m = drive.path_m[pair[1]] - drive.path_m[pair[0]];
        // The steps are 0.6 m between keyframes: four of them. A turn on the spot has no path.
        assert!((1.999..2.601).contains(&step_m), "{step_m}");
        assert!(drive.is_keyframe[pair[1]]);
    }
    // Five scans on either side are within 1 m, and more see more squares.
    let known = |places: &Places<'_>| {
        places.submaps[3].squares().filter(|s| *s != register::Square::Unknown).count()
    };
    assert!(known(&places) < known(&Places::new(&drive, &poses, 2.0, 5.0)));
}

/// A scan with 14 returns behind the wall of the room is left out.
#[test]
fn scans_with_few_returns_take_no_part_in_a_place() {
    let poses: Vec<Pose2> = (0..9).map(|k| pose(-1.0 + 0.2 * f64::from(k), 0.0, 0.0)).collect();
    let mut scans = World::room().scans(&poses, 360, 1);
    let squares = |scans: &[Scan]| {
        let drive = drive(scans, &poses);
        Places::new(&drive, &poses, 5.0, 5.0).submaps[0].clone()
    };
    let few = |n: u32| Scan {
        x_m: (0..n).map(|k| 0.1 * k as f32).collect(),
        y_m: vec![5.0; n as usize],
        ..Scan::default()
    };
    scans[4] = Scan::default();
    let without = squares(&scans);
    scans[4] = few(14);
    assert!(squares(&scans) == without);
    scans[4] = few(15);
    assert!(squares(&scans) != without);
}

/// Of the places on the way back that were passed before, at least 20 m of path ago, the share that is found.
fn share_found(world: &World, coverage_deg: u32) -> f64 {
    let poses = there_and_back();
    let scans = world.scans(&poses, coverage_deg, 1);
    let drive = drive(&scans, &poses);
    let found = candidates(&drive, 5);
    let places = Places::new(&drive, &poses, 2.5, 5.0);
    // The turn is at 31.8 m of path. A place at 45 m was passed at 18.6 m.
    let revisits: Vec<usize> =
        places.scans.into_iter().filter(|&k| 45.0 <= drive.path_m[k]).collect();
    assert!(5 <= revisits.len());
    let is_found = |&&query: &&usize| found.iter().any(|c| c.query == query && is_right(c, &poses));
    revisits.iter().filter(is_found).count() as f64 / revisits.len() as f64
}

#[test]
fn places_are_found_again_in_the_opposite_direction() {
    for (half_width_m, seed) in [(1.2, 5), (1.2, 6), (3.0, 5)] {
        assert_eq!(share_found(&World::hall(LENGTH_M, half_width_m, seed), 360), 1.0, "{seed}");
    }
}

#[test]
fn candidates_are_earlier_places_at_least_that_far_along_the_path_in_the_order_of_places_and_ranks()
{
    let poses = there_and_back();
    let scans = World::hall(LENGTH_M, 1.2, 7).scans(&poses, 360, 1);
    let drive = drive(&scans, &poses);
    let found = candidates(&drive, 3);
    assert!(20 < found.len());
    for candidate in &found {
        assert!(candidate.reference < candidate.query && candidate.rank < 3);
        assert!(20.0 <= drive.path_m[candidate.query] - drive.path_m[candidate.reference]);
    }
    let order: Vec<_> = found.iter().map(|c| (c.query, c.rank)).collect();
    assert!(order.is_sorted());
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let poses = there_and_back();
    let scans = World::hall(LENGTH_M, 1.2, 5).scans(&poses, 180, 1);
    let drive = drive(&scans, &poses);
    let with = |n_threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
        pool.install(|| format!("{:?}", candidates(&drive, 4)))
    };
    let single = with(1);
    assert!(single.len() > 1000);
    assert!(with(2) == single && with(8) == single);
}

/// With a classifier, the places with the smallest sum of two ranks are compared.
#[test]
fn the_classifier_ranks_places_and_is_evidence() {
    let poses = there_and_back();
    let scans = World::hall(LENGTH_M, 1.2, 5).scans(&poses, 360, 1);
    let drive = drive(&scans, &poses);
    let places = Places::new(&drive, &poses, 2.5, 5.0);
    let detector = Detector { n_candidates: 1, ..Detector::starting_values() };
    let by_descriptor = find_candidates(&drive, &places, &detector, 20.0, None);
    // It only knows the distance of the two keyframes.
    let classify = |a: usize, b: usize| -poses[a].distance_m(&poses[b]);
    let ranked = find_candidates(&drive, &places, &detector, 20.0, Some(&classify));
    for candidate in &ranked {
        let distance_m = poses[candidate.query].distance_m(&poses[candidate.reference]);
        assert_eq!(candidate.evidence.classifier, Some(-distance_m));
    }
    let n_right = |found: &[Candidate]| found.iter().filter(|c| is_right(c, &poses)).count();
    assert!(0 < n_right(&ranked) && n_right(&by_descriptor) <= n_right(&ranked));
}

#[test]
fn a_drive_without_scans_has_no_candidates() {
    assert_eq!(candidates(&drive(&[], &[]), 5), []);
}
