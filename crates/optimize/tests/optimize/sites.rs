use dataset::Pose2;
use model::Detector;
use optimize::{JoinOutcome, Known, Proposal, Reason, Site, Solution, close_loops, join_drives};
use register::{Drive, ScanSource};

use crate::drives::{MIN_PATH_M, Simulated, proposal};
use crate::world::{World, lap};

/// A drive that starts at a share of a lap, in a frame of its own.
fn one_lap(world: &World, from: f64, frame: Pose2, bias_deg_per_m: f64) -> Simulated {
    let lap = lap();
    let first = (from * lap.len() as f64) as usize;
    let truth = (0..lap.len()).map(|k| lap[(first + k) % lap.len()]).collect();
    let mut drive = Simulated::new(world, truth, bias_deg_per_m);
    let to_frame = frame * drive.odometry[0].inverse();
    drive.odometry.iter_mut().for_each(|pose| *pose = to_frame * *pose);
    drive
}

/// Registered drives, one after the other, with what was found in each by itself.
struct Drives {
    drive: Drive,
    solutions: Vec<Solution>,
    /// The true pose of each scan.
    truth: Vec<Pose2>,
}

fn drives(simulated: &[Simulated]) -> Drives {
    let (mut all, mut solutions, mut truth) = (Vec::new(), Vec::new(), Vec::new());
    for of_drive in simulated {
        let (drive, at) = of_drive.registered();
        solutions.push(close_loops(&drive, &[], &Detector::starting_values(), MIN_PATH_M));
        truth.extend(at.iter().map(|&k| of_drive.truth[k]));
        all.push(drive);
    }
    Drives { drive: Drive::joined(all), solutions, truth }
}

impl Drives {
    fn join(&self, known: &Known, proposals: &[Proposal]) -> Site {
        let detector = Detector::starting_values();
        join_drives(&self.drive, &self.solutions, known, proposals, &detector)
    }

    /// A proposal at every fourth keyframe of drive `b` with the keyframe of drive `a` that is nearest
    /// to it if the truth of `b` is moved by `b_to`.
    fn proposals(&self, a: usize, b: usize, b_to: Pose2) -> Vec<Proposal> {
        let parts = self.drive.parts();
        let keyframes = |part: usize| {
            parts[part].clone().filter(|&scan| self.drive.is_keyframe[scan]).collect::<Vec<_>>()
        };
        let references = keyframes(a);
        let of_query = |&query: &usize| {
            let at = b_to * self.truth[query];
            let distance_m = |scan: usize| self.truth[scan].distance_m(&at);
            let nearest = |x: &&usize, y: &&usize| distance_m(**x).total_cmp(&distance_m(**y));
            let reference = *references.iter().min_by(nearest)?;
            let pose = self.truth[reference].inverse() * at;
            (distance_m(reference) < 1.5).then(|| proposal(query, reference, pose))
        };
        keyframes(b).iter().step_by(4).filter_map(of_query).collect()
    }

    /// The largest error of the poses of some drives \[m\], after the first pose was put onto its true
    /// one.
    fn worst_m(&self, poses: &[Pose2], of: &[usize]) -> f64 {
        let parts = self.drive.parts();
        let scans: Vec<usize> = of.iter().flat_map(|&part| parts[part].clone()).collect();
        let to_truth = self.truth[scans[0]] * poses[scans[0]].inverse();
        let error_m = |&scan: &usize| (to_truth * poses[scan]).distance_m(&self.truth[scan]);
        scans.iter().map(error_m).fold(0.0, f64::max)
    }
}

/// A corridor around the block of [`lap`], with these widths on the left, below, on the right and above, and
/// columns along the outer wall.
fn building([left, below, right, above]: [f64; 4]) -> World {
    let mut world = World(Vec::new());
    world.add_rectangle([0.0, 0.0], [12.0, 8.0]);
    world.add_rectangle([-left, -below], [12.0 + right, 8.0 + above]);
    for x in [0.7, 2.2, 5.1, 9.8] {
        world.add_rectangle([x, -below], [x + 0.3, 0.3 - below]);
        world.add_rectangle([x + 0.9, 7.7 + above], [x + 1.2, 8.0 + above]);
    }
    for y in [1.1, 4.2, 6.0] {
        world.add_rectangle([11.7 + right, y], [12.0 + right, y + 0.4]);
        world.add_rectangle([-left, y + 0.6], [0.4 - left, y + 1.0]);
    }
    world
}

fn this_building() -> World {
    building([2.5, 2.5, 4.0, 6.0])
}

fn other_building() -> World {
    building([3.0, 4.0, 7.0, 3.0])
}

const FRAME: Pose2 = Pose2 { x_m: 40.0, y_m: -7.0, heading_rad: 2.0 };

/// Joined drives are the same after they are split again.
#[test]
fn joined_drives_can_be_split() {
    let building = this_building();
    let simulated =
        [one_lap(&building, 0.0, Pose2::default(), 1.0), one_lap(&building, 0.4, FRAME, -1.0)];
    let split = drives(&simulated).drive.split();
    assert_eq!(split.len(), 2);
    for (split, simulated) in split.iter().zip(&simulated) {
        let (alone, _) = simulated.registered();
        assert_eq!((&split.poses, &split.odometry), (&alone.poses, &alone.odometry));
        assert_eq!((split.n_scans(), &split.is_keyframe), (alone.n_scans(), &alone.is_keyframe));
        for k in 0..alone.n_scans() {
            assert_eq!(split.scan(k).scan(), alone.scan(k).scan());
        }
        assert_eq!((&split.starts, &split.is_decided), (&alone.starts, &alone.is_decided));
        for (a, b) in split.path_m.iter().zip(&alone.path_m) {
            assert!((a - b).abs() < 1e-9, "{a} {b}");
        }
    }
}

/// The poses of both drives are in one frame, and right closures join them. Wrong proposals that agree
/// with each other are rejected. A drive of another building is a map of its own.
#[test]
fn drives_of_one_building_share_a_map() {
    let building = this_building();
    let simulated = [
        one_lap(&building, 0.0, Pose2::default(), 2.0),
        one_lap(&building, 0.4, FRAME, -1.0),
        one_lap(&other_building(), 0.1, FRAME, 1.0),
    ];
    let drives = drives(&simulated);
    let right = drives.proposals(0, 1, Pose2::default());
    // The building turned by 180 deg about its centre.
    let turned = Pose2 { x_m: 12.0, y_m: 8.0, heading_rad: std::f64::consts::PI };
    let mut wrong = drives.proposals(0, 1, turned);
    wrong.extend(drives.proposals(0, 2, Pose2::default()));
    wrong.extend(drives.proposals(1, 2, turned));
    assert!(right.len() * 2 < wrong.len(), "{} {}", right.len(), wrong.len());
    let proposals: Vec<Proposal> = right.iter().chain(&wrong).copied().collect();
    let site = drives.join(&Known::default(), &proposals);
    assert_eq!(site.maps, [vec![0, 1], vec![2]]);
    let mut n_accepted = 0;
    for closure in site.solution.closures.iter().filter(|closure| closure.rejected.is_none()) {
        let Proposal { query, reference, reference_from_query, .. } = closure.proposal;
        let expected = drives.truth[reference].inverse() * drives.truth[query];
        let error_m = expected.distance_m(&reference_from_query);
        assert!(error_m < 0.1, "{query} {reference}: {error_m}");
        assert!(drives.drive.part_of(reference) < drives.drive.part_of(query));
        n_accepted += 1;
    }
    assert!(50 <= n_accepted, "{n_accepted}");
    let worst = drives.worst_m(&site.solution.poses, &[0, 1]);
    assert!(worst < 0.12, "{worst} m");
    // The third drive keeps its poses.
    let third = drives.drive.parts()[2].clone();
    assert_eq!(site.solution.poses[third], drives.solutions[2].poses[..]);
    let outcome = |drive: usize| {
        let of_drive = site.joins.iter().filter(|join| join.drives.contains(&drive));
        of_drive.map(|join| join.outcome).collect::<Vec<_>>()
    };
    assert!(matches!(outcome(1)[..], [JoinOutcome::Joined { .. }]), "{:?}", site.joins);
    for outcome in outcome(2) {
        assert!(matches!(outcome, JoinOutcome::Unsupported { .. }), "{:?}", site.joins);
    }
    for (k, closure) in site.solution.closures.iter().enumerate() {
        let drive = drives.drive.part_of(closure.proposal.query);
        if drive == 2 {
            assert_eq!(closure.rejected, Some(Reason::Unsupported), "{k}");
        }
    }
}

/// The same building without columns looks the same after a turn by 180 deg. Candidates for both say
/// nothing about which one is right.
#[test]
fn a_symmetric_building_is_ambiguous() {
    let mut building = World(Vec::new());
    building.add_rectangle([0.0, 0.0], [12.0, 8.0]);
    building.add_rectangle([-2.5, -2.5], [14.5, 10.5]);
    // Columns in pairs that the turn maps onto each other.
    for [x, y] in [[2.0, -2.5], [7.0, -2.5], [11.0, -2.5]] {
        building.add_rectangle([x, y], [x + 0.4, y + 0.4]);
        building.add_rectangle([12.0 - x - 0.4, 8.0 - y - 0.4], [12.0 - x, 8.0 - y]);
    }
    for y in [1.0, 5.5] {
        building.add_rectangle([14.1, y], [14.5, y + 0.4]);
        building.add_rectangle([-2.5, 8.0 - y - 0.4], [-2.1, 8.0 - y]);
    }
    let simulated =
        [one_lap(&building, 0.0, Pose2::default(), 0.5), one_lap(&building, 0.4, FRAME, -0.5)];
    let drives = drives(&simulated);
    let turned = Pose2 { x_m: 12.0, y_m: 8.0, heading_rad: std::f64::consts::PI };
    let mut proposals = drives.proposals(0, 1, Pose2::default());
    proposals.extend(drives.proposals(0, 1, turned));
    let site = drives.join(&Known::default(), &proposals);
    assert_eq!(site.maps, [vec![0], vec![1]], "{:?}", site.joins);
    assert!(matches!(site.joins[..], [optimize::Join { outcome: JoinOutcome::Ambiguous, .. }]));
    assert!(site.solution.closures.iter().all(|closure| closure.rejected.is_some()));
}

/// A drive that is added to a finished map moves onto it. The map stays, and the result is that of all
/// drives at once within 3 cm.
#[test]
fn a_known_map_stays_and_the_result_is_that_of_all_drives_together() {
    let building = this_building();
    let simulated = [
        one_lap(&building, 0.0, Pose2::default(), 1.0),
        one_lap(&building, 0.3, FRAME, -1.0),
        one_lap(&building, 0.6, Pose2::default(), 0.5),
    ];
    let all = drives(&simulated);
    let mut proposals = all.proposals(0, 1, Pose2::default());
    let between_first = proposals.len();
    proposals.extend(all.proposals(0, 2, Pose2::default()));
    let together = all.join(&Known::default(), &proposals);
    assert_eq!(together.maps, [vec![0, 1, 2]]);

    let mut first = drives(&simulated[..2]).join(&Known::default(), &proposals[..between_first]);
    assert_eq!(first.maps, [vec![0, 1]]);
    let n_first = first.solution.poses.len();
    let mut added = drives(&simulated);
    for (solution, part) in added.solutions.iter_mut().zip(all.drive.parts()).take(2) {
        solution.poses = first.solution.poses[part].to_vec();
    }
    first.solution.closures.retain(|closure| closure.rejected.is_none());
    let known = Known {
        maps: first.maps.clone(),
        closures: first.solution.closures.iter().map(|closure| closure.proposal).collect(),
    };
    let site = added.join(&known, &proposals[between_first..]);
    assert_eq!(site.maps, [vec![0, 1, 2]]);
    assert_eq!(site.solution.poses[..n_first], first.solution.poses[..]);
    for (a, b) in site.solution.poses.iter().zip(&together.solution.poses) {
        assert!(a.distance_m(b) < 0.03, "{}", a.distance_m(b));
    }
    // Relative to the first pose, the added drive is known as well as the map.
    let largest = |part: usize| {
        let scans = all.drive.parts()[part].clone();
        scans.map(|k| site.solution.covariances[k].trace()).fold(0.0, f64::max)
    };
    assert!(largest(2) < 4.0 * largest(1), "{} {}", largest(2), largest(1));
}

/// Two earlier maps of one building stay apart, and it is reported that a drive fits both.
#[test]
fn a_drive_that_fits_two_known_maps_joins_one_of_them() {
    let building = this_building();
    let simulated = [
        one_lap(&building, 0.0, Pose2::default(), 1.0),
        one_lap(&building, 0.3, FRAME, -1.0),
        one_lap(&building, 0.6, Pose2::default(), 0.5),
    ];
    let drives = drives(&simulated);
    let mut proposals = drives.proposals(0, 2, Pose2::default());
    proposals.extend(drives.proposals(1, 2, Pose2::default()));
    let known = Known { maps: vec![vec![0], vec![1]], closures: Vec::new() };
    let site = drives.join(&known, &proposals);
    assert_eq!(site.maps.len(), 2, "{:?}", site.joins);
    let outcomes: Vec<JoinOutcome> = site.joins.iter().map(|join| join.outcome).collect();
    assert!(
        matches!(outcomes[..], [JoinOutcome::Joined { .. }, JoinOutcome::BothKnown]),
        "{outcomes:?}"
    );
    for part in drives.drive.parts().into_iter().take(2) {
        assert_eq!(site.solution.poses[part.clone()], drives.drive.poses[part]);
    }
}

/// The result does not depend on the number of threads.
#[test]
fn the_result_is_the_same_for_any_number_of_threads() {
    let building = this_building();
    let simulated =
        [one_lap(&building, 0.0, Pose2::default(), 1.0), one_lap(&building, 0.4, FRAME, -1.0)];
    let drives = drives(&simulated);
    let proposals = drives.proposals(0, 1, Pose2::default());
    let with = |n: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        pool.install(|| drives.join(&Known::default(), &proposals)).solution
    };
    let (one, three) = (with(1), with(3));
    assert_eq!(one.poses, three.poses);
    assert_eq!(one.closures, three.closures);
    assert_eq!(one.covariances, three.covariances);
}
