//! Deskewed scans of drives: consecutive scans lie closer to each other than without deskewing.

use std::fs;

use dataset::tables::read_poses;
use dataset::{Scan, Trajectory};

use crate::real_logs::{DRIVES, scans};
use crate::require::shared_data;
use crate::support::Workplace;

/// Outdoors and indoors, with a robot that turns.
const SIMULATED: &str = r#"
seed = 7
[simulate]
logs = ["drive"]
length_m = 120.0
people = 0
[ingest]
pose.topic = "/ground_truth"
"#;

#[test]
fn consecutive_scans_of_a_simulated_drive_lie_closer_when_deskewed() {
    let workplace = Workplace::new(SIMULATED);
    let [skewed_m, deskewed_m] = [false, true].map(|deskew| {
        let out = format!("deskew-{deskew}");
        let deskew = ["--set", &format!("ingest.lidar.deskew={deskew}")];
        workplace.command("simulate", &out, &deskew).expect(0);
        workplace.command("ingest", &out, &deskew).expect(0);
        mean_nearest_m(&workplace, &out, "drive", 5)
    });
    println!("{skewed_m:.4} m, deskewed {deskewed_m:.4} m");
    assert!(deskewed_m < 0.97 * skewed_m, "{skewed_m} m, deskewed {deskewed_m} m");
}

#[test]
fn consecutive_scans_of_the_real_drives_lie_closer_when_deskewed() {
    let Some(data) = shared_data(&DRIVES) else { return };
    for name in DRIVES {
        let log = fs::canonicalize(data.join(name)).unwrap();
        let pipeline = format!("[ingest]\nlogs = [{log:?}]\npose.topic = \"/ground_truth\"\n");
        let workplace = Workplace::new(&pipeline);
        let [skewed_m, deskewed_m] = [false, true].map(|deskew| {
            let out = format!("deskew-{deskew}");
            let deskew = ["--set", &format!("ingest.lidar.deskew={deskew}")];
            workplace.command("ingest", &out, &deskew).expect(0);
            mean_nearest_m(&workplace, &out, log.file_stem().unwrap().to_str().unwrap(), 20)
        });
        println!("{name}: {skewed_m:.4} m, deskewed {deskewed_m:.4} m");
        assert!(deskewed_m < 0.97 * skewed_m, "{name}: {skewed_m} m, deskewed {deskewed_m} m");
    }
}

/// Takes every so many scans of a run and the scan after each; lays the two over each other by
/// their poses. Returns the mean distance from a point of one to the nearest point of the other
/// \[m\].
fn mean_nearest_m(workplace: &Workplace, out: &str, log: &str, every: usize) -> f64 {
    let scans = scans(&workplace.path(&format!("{out}/scans/{log}.parquet")));
    let poses = read_poses(&workplace.path(&format!("{out}/poses/{log}.parquet"))).unwrap().0;
    let distances: Vec<f64> =
        scans.windows(2).step_by(every).map(|pair| nearest_m(&pair[0], &pair[1], &poses)).collect();
    distances.iter().sum::<f64>() / distances.len() as f64
}

/// Mean distance from the points of one scan to the nearest of another \[m\].
fn nearest_m(a: &Scan, b: &Scan, trajectory: &Trajectory) -> f64 {
    let in_map = |scan: &Scan| -> Vec<[f64; 2]> {
        let pose = trajectory.pose_at(scan.stamp_ns, 200_000_000).unwrap();
        let (sin, cos) = pose.heading_rad.sin_cos();
        let points = scan.points();
        points.map(|[x, y]| [pose.x_m + cos * x - sin * y, pose.y_m + sin * x + cos * y]).collect()
    };
    let mut others = in_map(a);
    others.sort_by(|p, q| p[0].total_cmp(&q[0]));
    let nearest = |[x, y]: [f64; 2]| {
        // Search outwards from the point with the same x, until the difference in x alone is larger
        // than the nearest distance so far.
        let start = others.partition_point(|p| p[0] < x);
        let mut nearest_squared = f64::INFINITY;
        let mut is_closer = |p: &[f64; 2]| {
            nearest_squared = nearest_squared.min((p[0] - x).powi(2) + (p[1] - y).powi(2));
            (p[0] - x).powi(2) < nearest_squared
        };
        let _ = others[start..].iter().all(&mut is_closer);
        let _ = others[..start].iter().rev().all(&mut is_closer);
        nearest_squared.sqrt()
    };
    let points = in_map(b);
    points.iter().map(|&p| nearest(p)).sum::<f64>() / points.len() as f64
}
