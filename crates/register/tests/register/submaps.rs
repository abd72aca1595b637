use dataset::{Pose2, Scan, SplitMix64};
use register::{Member, Square, Submap, SubmapOptions};

use crate::world::World;

/// Scans in a room of 10 m by 6 m, every 0.5 m along x, while a person of 0.4 m walks across.
fn scans() -> Vec<(Pose2, Scan)> {
    let mut random = SplitMix64::new(1);
    (0..10)
        .map(|k| {
            let pose = Pose2 { x_m: 0.5 * f64::from(k) - 2.0, y_m: 0.0, heading_rad: 0.1 };
            let mut world = World(Vec::new());
            world.add_rectangle([-5.0, -3.0], [5.0, 3.0]);
            let y_m = 0.45 * f64::from(k) - 2.4;
            world.add_rectangle([3.0, y_m], [3.4, y_m + 0.4]);
            (pose, world.scan(&pose, 360, 0.01, &mut random))
        })
        .collect()
}

fn submap(scans: &[(Pose2, Scan)]) -> Submap {
    let members: Vec<Member<'_>> =
        scans.iter().map(|(pose, scan)| Member { node_from_scan: *pose, scan }).collect();
    Submap::new(&members, &SubmapOptions::default())
}

#[test]
fn walls_are_occupied_and_a_person_who_walks_by_leaves_no_wall() {
    let submap = submap(&scans());
    for y_m in [-2.0, 0.0, 2.0] {
        assert_eq!(submap.at([-5.0, y_m]), Square::Occupied);
        assert_eq!(submap.at([5.0, y_m]), Square::Occupied);
    }
    for y_m in [-1.8, -0.9, 0.0, 0.9] {
        assert_ne!(submap.at([3.2, y_m]), Square::Occupied, "a person at {y_m} m");
    }
    assert_eq!(submap.at([0.0, 1.0]), Square::Free);
    // Behind the walls, and outside the submap.
    assert_eq!(submap.at([-7.0, 0.0]), Square::Unknown);
    assert_eq!(submap.at([1e9, 0.0]), Square::Unknown);
    assert_eq!(submap.at([f64::NAN, 0.0]), Square::Unknown);
    let n_occupied = submap.centres(Square::Occupied).count();
    assert!((60..140).contains(&n_occupied), "{n_occupied}");
}

#[test]
fn the_order_of_the_scans_does_not_matter() {
    let mut scans = scans();
    let forward = submap(&scans);
    scans.reverse();
    assert_eq!(submap(&scans), forward);
}

/// A scan of a wall in front. There are no returns behind: the space there is unknown, not free.
#[test]
fn beams_without_a_return_say_nothing() {
    let world = World(vec![[[4.0, -20.0], [4.0, 20.0]]]);
    let scan = world.scan(&Pose2::default(), 360, 0.0, &mut SplitMix64::new(1));
    let submap = submap(&[(Pose2::default(), scan)]);
    assert_eq!(submap.at([4.0, 0.0]), Square::Occupied);
    assert_eq!(submap.at([2.0, 0.0]), Square::Free);
    assert_eq!(submap.at([-2.0, 0.0]), Square::Unknown);
}
