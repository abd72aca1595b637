//! Descriptors of places.

use dataset::{Pose2, Scan};
use detect::{DESCRIPTOR_LEN, Describer, Descriptors};
use register::{Member, Submap, SubmapOptions};

use crate::world::{World, pose};

/// The submap of five scans around a pose.
fn submap(world: &World, centre: Pose2, seed: u64) -> Submap {
    let offsets: Vec<Pose2> = (-2..=2).map(|k| pose(0.3 * f64::from(k), 0.0, 0.0)).collect();
    let poses: Vec<Pose2> = offsets.iter().map(|&offset| centre * offset).collect();
    let scans: Vec<Scan> = world.scans(&poses, 360, seed);
    let members: Vec<Member<'_>> = offsets
        .iter()
        .zip(&scans)
        .map(|(&node_from_scan, scan)| Member { node_from_scan, scan })
        .collect();
    Submap::new(&members, &SubmapOptions::default())
}

/// 20 rooms, the first one seen from a second pose.
#[test]
fn a_turn_and_a_shift_of_1_5_m_change_a_descriptor_less_than_another_room_does() {
    let describer = Describer::new(128);
    let check = |second: Pose2| {
        let mut rows = vec![describer.describe(&submap(&World::room(), pose(-0.5, 0.0, 0.0), 1))];
        for seed in 0..20 {
            rows.push(describer.describe(&submap(
                &World::other_room(seed),
                pose(0.0, 0.0, 0.0),
                1,
            )));
        }
        rows.push(describer.describe(&submap(&World::room(), second, 2)));
        assert!(rows.iter().all(|row| row.len() == DESCRIPTOR_LEN));
        let n = rows.len();
        let mut n_references = vec![0; n];
        n_references[n - 1] = n - 1;
        let similar = Descriptors::new(&rows).most_similar(2, &n_references);
        let [own, other] = similar[n - 1][..] else { panic!("two references") };
        assert_eq!(own.reference, 0, "{second:?}");
        assert!(1.2 * own.distance_squared < other.distance_squared, "{own:?} {other:?}");
    };
    check(pose(-0.5, 0.0, 90.0));
    check(pose(-0.5, 0.0, 33.0));
    check(pose(1.0, 0.0, 0.0));
    check(pose(0.2, -1.3, -145.0));
}
