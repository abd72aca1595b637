//! Poses fused from wheels and IMU, the plot of a path, and what docs/poses.md states.

use std::fs;

use dataset::tables::read_poses;

use crate::support::{Workplace, drift, loopboost, root};

const DRIVE: &str = r#"
seed = 7
[simulate]
logs = ["one"]
length_m = 10.0
people = 0
[ingest]
pose.topic = "/ground_truth"
"#;

/// With the first pose aligned, the last one is off by less than 0.5 % of the path.
#[test]
fn poses_fused_from_simulated_wheels_and_imu_stay_near_the_truth() {
    let workplace = Workplace::new(&DRIVE.replace("length_m = 10.0", "length_m = 200.0"));
    workplace.command("simulate", "out", &[]).expect(0);
    let poses = |ingest: &str| {
        let pipeline = format!("[ingest]\nlogs = [\"out/logs/one.mcap\"]\n{ingest}\n");
        fs::write(workplace.path("drive.toml"), pipeline).unwrap();
        workplace.command("ingest", "poses", &[]).expect(0);
        read_poses(&workplace.path("poses/poses/one.parquet")).unwrap().0
    };
    let truth = poses("pose.topic = \"/ground_truth\"");
    let fused = poses("pose = { wheels = \"/wheel_states\", imu = \"/imu/data\", track_m = 0.5 }");
    assert!(fused.poses().iter().all(|pose| pose.covariance.is_some()));
    let (drift_m, path_m) = drift(&truth, &fused);
    assert!(190.0 < path_m && drift_m < 0.005 * path_m, "{drift_m:.2} m of {path_m:.0} m");
}

#[test]
fn inspect_plots_the_path_and_its_uncertainty() {
    let workplace = Workplace::new(DRIVE);
    workplace.command("simulate", "out", &[]).expect(0);
    let log = workplace.path("out/logs/one.mcap");
    let (log, drawn) = (log.to_str().unwrap(), workplace.path("one.svg"));
    let plot = |more: &[&str]| {
        let args = [&["inspect", log, "--plot", drawn.to_str().unwrap()], more].concat();
        let finished = loopboost(&args).expect(0);
        (finished.stderr, fs::read_to_string(&drawn).unwrap())
    };
    // 10 m of true poses without covariances. At 2 m/s and 10 Hz, every third scan is a keyframe (0.6
    // m apart). That gives 16 or 17 keyframes, and some more where the robot is slower.
    let (_, svg) = plot(&[]);
    assert!(svg.contains("class=\"path-line\"") && !svg.contains("class=\"path-sure\""), "{svg}");
    let n_kept = svg.matches(", scan ").count();
    assert!((16..=20).contains(&n_kept), "{n_kept} scans");
    // Poses fused from wheels and IMU have covariances.
    let (printed, svg) = plot(&["--track-m", "0.5"]);
    assert!(printed.contains("poses fused from"), "{printed}");
    assert!(10 < svg.matches("class=\"path-sure\"").count(), "{svg}");
    let other = loopboost(&["inspect", log, "--plot", "one.png"]).expect(1);
    assert!(other.stderr.contains("ends in .svg"), "{}", other.stderr);
}

/// Files and options that docs/poses.md names exist.
#[test]
fn everything_that_the_page_on_poses_names_exists() {
    let page = fs::read_to_string(root().join("docs/poses.md")).unwrap();
    let mut n_files = 0;
    for word in page.split('`').skip(1).step_by(2) {
        for path in word.split_whitespace().filter(|path| {
            ["crates/", "docs/", "tests/"].iter().any(|folder| path.starts_with(folder))
        }) {
            assert!(root().join(path).exists(), "`{path}` does not exist");
            n_files += 1;
        }
    }
    assert!(5 <= n_files, "{n_files} files named");
    let options = page.split("```toml\n").nth(1).unwrap().split("```").next().unwrap();
    let pipeline = format!("[ingest]\nlogs = [\"a.mcap\"]\nlidar.topic = \"/a\"\n{options}");
    let workplace = Workplace::new(&pipeline);
    let finished = workplace.command("run", "out", &["--print-config"]).expect(0);
    // Every key exists and has the value on the page.
    for line in options.lines().filter(|line| line.contains(" = ") && !line.contains('{')) {
        let line = line.split('#').next().unwrap().trim();
        let (key, value) = line.split_once(" = ").unwrap();
        let is_it = |printed: &str| {
            printed.split_once(" = ").is_some_and(|(k, v)| {
                k == key && (v == value || v.parse::<f64>().ok() == value.parse::<f64>().ok())
            })
        };
        assert!(finished.stdout.lines().any(is_it), "`{line}` is not in {}", finished.stdout);
    }
    // The tables have the columns that the page names.
    let workplace = Workplace::new(DRIVE);
    workplace.command("simulate", "out", &[]).expect(0);
    workplace.command("ingest", "out", &[]).expect(0);
    workplace.command("subsample", "out", &[]).expect(0);
    for table in ["poses/one.parquet", "keyframes/one.parquet"] {
        let file = fs::File::open(workplace.path("out").join(table)).unwrap();
        let reader =
            parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder::try_new(file).unwrap();
        let columns: Vec<String> =
            reader.schema().fields().iter().map(|field| field.name().clone()).collect();
        for name in page.split('`').filter(|word| word.starts_with("cov_")) {
            assert!(columns.iter().any(|column| column == name), "no `{name}` in {table}");
        }
    }
}
