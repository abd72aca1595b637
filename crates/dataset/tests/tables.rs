//! Writing and reading of tables: round trips, errors for invalid files, and atomic writes.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]
#![cfg(feature = "parquet")]

use std::fs;
use std::path::Path;

use dataset::tables::scans::{read_scan_headers, read_scans, write_scans};
use dataset::tables::{
    FeatureTable, Provenance, TableError, read_feature_stability, read_feature_usefulness,
    read_features, read_grid, read_keyframes, read_pairs, read_poses, read_provenance,
    read_retrieval, read_rounds, read_scores, write_feature_stability, write_feature_usefulness,
    write_features, write_grid, write_keyframes, write_pairs, write_poses, write_retrieval,
    write_rounds, write_scores,
};
use dataset::{
    BoostingRound, FeatureUsefulness, GridCell, HeldOut, Keyframe, Label, Pair, Pose2, Retrieval,
    RetrievalPoint, Scan, ScanId, Scores, StampedPose, Trajectory,
};

fn provenance() -> Provenance {
    Provenance {
        program_version: "0.1.0".into(),
        seed: Some(2436),
        options: serde_json::json!({"spacing_m": 0.5}),
        inputs: [("a.mcap".to_owned(), "00ff".to_owned())].into(),
        ..Provenance::default()
    }
}

/// Scan `k` has `k % 7` returns.
fn scan(k: u32) -> Scan {
    let values = |offset: f32| (0..k % 7).map(|i| offset + i as f32 * (1 + i) as f32).collect();
    Scan {
        stamp_ns: i64::from(k) * 100,
        x_m: values(0.5),
        y_m: values(-3.0 * k as f32),
        coverage_deg: 359.8,
        hole_deg: 7.25,
    }
}

fn write_n_scans(path: &Path, n: u32, batch: usize) {
    let scans: Vec<Scan> = (0..n).map(scan).collect();
    write_scans(path, &provenance(), "drive", |writer| {
        for batch in scans.chunks(batch) {
            writer.push(batch.iter().cloned())?;
        }
        assert_eq!(writer.n_scans(), n);
        Ok::<_, TableError>(())
    })
    .unwrap();
}

fn keyframes() -> Vec<Keyframe> {
    (0..3)
        .map(|k| Keyframe {
            id: ScanId { log: if k < 2 { "a" } else { "b" }.into(), scan: 7 * k },
            site: "campus".into(),
            stamp_ns: i64::from(k),
            pose: Pose2 { x_m: f64::from(k), y_m: 0.1, heading_rad: -3.0 },
            covariance: (k < 2).then_some([0.25, 0.125, 0.0, 0.5, -0.0625, f64::from(k)]),
            z_m: (k < 1).then_some(2.5),
            segment: 3 * k,
            frame: k,
            map: (k == 1).then_some(4),
            travel_m: 0.5 * f64::from(k),
            coverage_deg: 359.9,
        })
        .collect()
}

#[test]
fn scans_are_read_as_written_and_can_be_selected() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scans/drive.parquet");
    for n in [0, 1, 300, 1000] {
        write_n_scans(&path, n, 97);
        let (headers, found) = read_scan_headers(&path).unwrap();
        assert_eq!(found, provenance());
        assert_eq!(headers.len(), n as usize);
        for (k, header) in headers.iter().enumerate() {
            let expected = scan(k as u32);
            assert_eq!((header.stamp_ns, header.coverage_deg), (expected.stamp_ns, 359.8));
            assert_eq!(header.usable, expected.check_usable().is_ok());
        }
        let picked: Vec<u32> = (0..n).filter(|k| k % 3 == 1 || *k == n - 1).collect();
        let mut read = Vec::new();
        read_scans(&path, &picked, |batch| {
            read.extend(batch);
            Ok::<_, TableError>(())
        })
        .unwrap();
        assert_eq!(read, picked.iter().map(|&k| scan(k)).collect::<Vec<_>>());
    }
    let beyond = read_scans(&path, &[1000], |_| Ok::<_, TableError>(()));
    assert!(matches!(beyond, Err(TableError::Row { row: 1000, .. })));
}

#[test]
fn scan_bytes_do_not_depend_on_batches_or_threads() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = |threads: usize, batch: usize| {
        let path = folder.path().join("scans.parquet");
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| write_n_scans(&path, 777, batch));
        fs::read(&path).unwrap()
    };
    let expected = bytes(1, 777);
    for (threads, batch) in [(1, 10), (2, 333), (8, 129)] {
        assert!(bytes(threads, batch) == expected, "{threads} threads, batches of {batch}");
    }
}

#[test]
fn a_failed_write_does_not_change_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scans.parquet");
    write_n_scans(&path, 5, 5);
    let before = fs::read(&path).unwrap();
    let failed = write_scans(&path, &provenance(), "drive", |writer| {
        writer.push([scan(3)])?;
        Err::<(), _>(TableError::Row { path: path.clone(), row: 0, detail: "stop".into() })
    });
    assert!(failed.is_err());
    assert_eq!(fs::read(&path).unwrap(), before);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "the temporary file is removed");
}

#[test]
fn poses_keyframes_pairs_and_features_are_read_as_written() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);

    let poses = (0..4).map(|k| StampedPose {
        stamp_ns: k,
        pose: Pose2 { x_m: 0.1 * k as f64, y_m: -1.0, heading_rad: 0.2 },
        covariance: (k > 1).then_some([0.1, 0.2, 0.3, 0.4, 0.5, k as f64]),
        z_m: (k > 0).then_some(0.5 * k as f64),
        segment: k as u32,
        frame: k as u32 / 2,
    });
    let (trajectory, _) = Trajectory::new(poses.collect());
    write_poses(&at("poses"), &provenance(), "a", &trajectory).unwrap();
    assert_eq!(read_poses(&at("poses")).unwrap(), (trajectory, provenance()));

    let keyframes = keyframes();
    write_keyframes(&at("keyframes"), &provenance(), &keyframes).unwrap();
    assert_eq!(read_keyframes(&at("keyframes")).unwrap(), (keyframes.clone(), provenance()));

    let pairs = vec![
        Pair {
            query: 1,
            reference: 0,
            label: Label::Positive,
            distance_m: 1.0,
            distance_std_m: Some(0.03),
            heading_difference_rad: Some(0.25),
            travel_gap_m: 0.5,
        },
        Pair {
            query: 2,
            reference: 0,
            label: Label::Negative,
            distance_m: f64::INFINITY,
            distance_std_m: None,
            heading_difference_rad: None,
            travel_gap_m: f64::INFINITY,
        },
    ];
    write_pairs(&at("pairs"), &provenance(), &keyframes, &pairs).unwrap();
    assert_eq!(read_pairs(&at("pairs"), &keyframes).unwrap(), (pairs, provenance()));
    let message = read_pairs(&at("pairs"), &keyframes[..2]).unwrap_err().to_string();
    assert!(message.contains("row 1: scan 14 of log `b` is not a keyframe"), "{message}");

    let table = FeatureTable {
        names: vec!["centroid".into(), "size".into()],
        ids: keyframes.iter().map(|k| k.id.clone()).collect(),
        values: vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
    };
    write_features(&at("features"), &provenance(), &table).unwrap();
    let (read, _) = read_features(&at("features")).unwrap();
    assert_eq!(read, table);
    assert_eq!(read.row(1), [3.0, 4.0]);
}

#[test]
fn scores_are_read_as_written() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let pair = |query, label| Pair {
        query,
        reference: 0,
        label,
        distance_m: 1.0,
        distance_std_m: None,
        heading_difference_rad: None,
        travel_gap_m: 0.5,
    };
    let pairs = [pair(1, Label::Positive), pair(2, Label::Negative)];
    let scores = vec![Scores {
        learner: "discrete".into(),
        grouping: "place".into(),
        n_rounds: 2,
        groups: vec![[3, 4], [3, 5]],
        folds: vec![[0, 1], [0, 0]],
        n_training: vec![7, 9],
        confidences: vec![0.5, 1.5, -0.5, -2.5],
    }];
    write_scores(&at("scores"), &provenance(), &keyframes(), &pairs, &scores).unwrap();
    assert_eq!(read_scores(&at("scores"), &pairs).unwrap(), (scores, provenance()));
}

#[test]
fn rounds_are_read_as_written() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let round = |held_out, node| BoostingRound {
        learner: "discrete".into(),
        held_out,
        round: 1,
        node,
        feature: "size".into(),
        threshold: Some(0.5),
        weighted_error: 0.25,
    };
    let held_out = HeldOut { grouping: "place".into(), folds: [2, 7] };
    let rounds = vec![round(None, None), round(Some(held_out), Some(2))];
    write_rounds(&at("rounds"), &provenance(), &rounds).unwrap();
    assert_eq!(read_rounds(&at("rounds")).unwrap(), (rounds, provenance()));
}

#[test]
fn retrieval_is_read_as_written() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let found = Retrieval {
        learner: "discrete".into(),
        grouping: "place".into(),
        log: None,
        ambiguous_as_negative: true,
        n_positive: 2,
        n_negative: 5_000_000_000,
        n_ambiguous: 3,
        n_unscored: 4,
        query_stride: 1,
        average_precision: Some(0.75),
        recall_at_full_precision: Some(0.5),
        detection_at_1_percent: Some(1.0),
        max_f1: Some(0.8),
        curve: vec![
            RetrievalPoint { threshold: 1.5, true_positive: 1, false_positive: 0 },
            RetrievalPoint { threshold: -0.5, true_positive: 2, false_positive: 9 },
        ],
    };
    let none = Retrieval {
        log: Some("a".into()),
        n_positive: 0,
        average_precision: None,
        recall_at_full_precision: None,
        detection_at_1_percent: None,
        max_f1: None,
        curve: Vec::new(),
        ..found.clone()
    };
    let rows = vec![found, none];
    write_retrieval(&at("retrieval"), &provenance(), &rows).unwrap();
    assert_eq!(read_retrieval(&at("retrieval")).unwrap(), (rows, provenance()));
}

#[test]
fn the_label_grid_is_read_as_written() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let cell = |error| GridCell {
        learner: "knn".into(),
        grouping: "scan".into(),
        positive_radius_m: 1.5,
        negative_min_m: 50.0,
        min_travel_gap_m: 0.0,
        error,
    };
    let cells = vec![cell(Ok(0.125)), cell(Err("3 of 9 positive pairs".into()))];
    write_grid(&at("grid"), &provenance(), &cells).unwrap();
    assert_eq!(read_grid(&at("grid")).unwrap(), (cells, provenance()));
}

#[test]
fn stability_and_usefulness_of_features_are_read_as_written() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let names = ["size", "distance"].map(str::to_owned);
    let stability = vec![0.5, f64::INFINITY];
    write_feature_stability(&at("stability"), &provenance(), &names, &stability).unwrap();
    let found = read_feature_stability(&at("stability"), &names).unwrap();
    assert_eq!(found, (stability, provenance()));
    let error = read_feature_stability(&at("stability"), &names[..1]).unwrap_err().to_string();
    assert!(error.contains("found size, distance"), "{error}");

    let usefulness =
        vec![FeatureUsefulness { name: "size".into(), auc: 0.75, stability: 0.5, chosen: 9 }];
    write_feature_usefulness(&at("usefulness"), &provenance(), &usefulness).unwrap();
    let found = read_feature_usefulness(&at("usefulness")).unwrap();
    assert_eq!(found, (usefulness, provenance()));
}

#[test]
fn a_file_that_is_not_the_expected_table_gives_an_error_that_names_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("keyframes.parquet");
    let message = || read_keyframes(&path).unwrap_err().to_string();
    assert!(message().contains("does not exist"));

    fs::write(&path, b"PAR1 but not a table").unwrap();
    assert!(message().contains("is not a readable Parquet table"), "{}", message());

    write_poses(&path, &provenance(), "a", &Trajectory::default()).unwrap();
    assert!(
        message()
            .contains("is a table of kind `poses`, expected a loopboost table of kind `keyframes`"),
        "{}",
        message()
    );

    write_keyframes(&path, &provenance(), &keyframes()).unwrap();
    let whole = fs::read(&path).unwrap();
    fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    assert!(message().contains("is not a readable Parquet table"), "{}", message());
}

#[test]
fn an_error_about_the_format_version_names_both_versions() {
    use arrow_array::{Int64Array, RecordBatch};
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pairs.parquet");
    let batch =
        RecordBatch::try_from_iter([("x", std::sync::Arc::new(Int64Array::from(vec![1])) as _)])
            .unwrap();
    let metadata =
        [("loopboost.kind", "pairs"), ("loopboost.format_version", "99")].map(|(key, value)| {
            parquet::file::metadata::KeyValue::new(key.to_owned(), value.to_owned())
        });
    let properties = parquet::file::properties::WriterProperties::builder()
        .set_key_value_metadata(Some(metadata.to_vec()))
        .build();
    let file = fs::File::create(&path).unwrap();
    let mut writer =
        parquet::arrow::ArrowWriter::try_new(file, batch.schema(), Some(properties)).unwrap();
    writer.write(&batch).unwrap();
    writer.close().unwrap();
    let of_rows = read_pairs(&path, &[]).unwrap_err();
    // Also where only the provenance is read, whose layout depends on the version.
    let of_provenance = read_provenance(&path).unwrap_err();
    for error in [of_rows, of_provenance] {
        let message = error.to_string();
        assert!(message.contains("format version 99, this program reads version 7"), "{message}");
    }
}
