//! `save` chooses the version, finds existing equal content, and checks the same values as `load`.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

mod common;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use common::{is_same, model};
use model::{
    FeatureSpec, Learner, Measured, Model, ModelError, Node, Saved, ScanSpec, Tree, WeakLearner,
    card, load, save,
};
use semver::Version;

/// The model with an edit.
fn edited(edit: impl FnOnce(&mut Model)) -> Model {
    // `save` ignores the version of the model.
    let mut model = Model { version: Version::new(9, 9, 9), ..model(Learner::Discrete) };
    edit(&mut model);
    model
}

fn retrain(model: &mut Model) {
    model.training.digests.insert("pairs".into(), "00fe".into());
}

/// The bytes of every file below a folder, by path.
fn tree(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut tree = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            tree.extend(self::tree(&path));
        } else {
            tree.insert(path.clone(), fs::read(&path).unwrap());
        }
    }
    tree
}

/// Saves the model with an edit. Checks that it gets this version, that it loads as saved, that it has
/// its card, and that no other file changes.
#[track_caller]
fn check_saved(models: &Path, edit: impl FnOnce(&mut Model), version: [u64; 3], is_new: bool) {
    let before = tree(models);
    let model = edited(edit);
    let saved = save(models, &model).unwrap();
    let [major, minor, patch] = version;
    let version = Version::new(major, minor, patch);
    let folder = models.join(&model.name).join(version.to_string());
    let files = vec![folder.join("model.json"), folder.join("card.md")];
    assert_eq!(saved, Saved { version: version.clone(), is_new, files: files.clone() });
    let model = Model { version, ..model };
    assert!(is_same(&load(&files[0]).unwrap(), &model));
    assert_eq!(fs::read_to_string(&files[1]).unwrap(), card(&model));
    let mut after = tree(models);
    if is_new {
        assert!(files.iter().all(|file| after.remove(file).is_some()));
    }
    assert!(after == before, "another file was changed");
}

#[test]
fn the_next_version_depends_on_what_differs_from_the_newest_version() {
    fn check(edit: fn(&mut Model), version: [u64; 3], is_new: bool) {
        let folder = tempfile::tempdir().unwrap();
        check_saved(folder.path(), |_| {}, [1, 0, 0], true);
        check_saved(folder.path(), edit, version, is_new);
    }
    check(|_| {}, [1, 0, 0], false);
    check(|m| m.name = "other".into(), [1, 0, 0], true);
    check(retrain, [1, 1, 0], true);
    check(|m| m.seed = 1, [1, 1, 0], true);
    check(|m| m.measured[0].precision = None, [1, 1, 0], true);
    check(|m| m.operating_points[0].false_alarm = -0.0, [1, 1, 0], true);
    check(|m| m.scans.coverage_min_deg = 358.0, [1, 1, 0], true);
    check(|m| m.features.set = "other".into(), [2, 0, 0], true);
    check(|m| m.features.version = 2, [2, 0, 0], true);
    check(|m| m.features.gate_m = 3.0, [2, 0, 0], true);
    check(|m| m.features.names.swap(0, 1), [2, 0, 0], true);
    check(|m| m.scans.range_min_m = 1.0, [2, 0, 0], true);
    check(|m| m.scans.range_max_m = 30.0, [2, 0, 0], true);
    let part = |m: &mut Model| (m.scans.is_ring, m.scans.coverage_min_deg) = (false, 180.0);
    check(part, [2, 0, 0], true);
    check(|m| m.classifier = model(Learner::GentleLine).classifier, [2, 0, 0], true);
}

#[test]
fn equal_content_is_found_in_any_version() {
    let folder = tempfile::tempdir().unwrap();
    let models = folder.path();
    check_saved(models, |_| {}, [1, 0, 0], true);
    check_saved(models, retrain, [1, 1, 0], true);
    check_saved(models, |_| {}, [1, 0, 0], false);
    check_saved(models, |m| m.features.gate_m = 3.0, [2, 0, 0], true);
    check_saved(models, retrain, [1, 1, 0], false);
    // The newest version has another gate.
    check_saved(models, |m| m.seed = 1, [3, 0, 0], true);
    check_saved(models, |_| {}, [1, 0, 0], false);
}

#[test]
fn the_newest_version_is_the_largest_that_contains_a_model() {
    let folder = tempfile::tempdir().unwrap();
    let models = folder.path();
    for minor in 0..=10 {
        check_saved(models, |m| m.seed = minor, [1, minor, 0], true);
    }
    for folder in ["old", "7.0.0", "2"] {
        fs::create_dir(models.join("campus").join(folder)).unwrap();
    }
    check_saved(models, |m| m.seed = 10, [1, 10, 0], false);
    check_saved(models, retrain, [1, 11, 0], true);
    // Damaged versions differ from what was saved. They are not changed.
    fs::write(models.join("campus/1.3.0/model.json"), "{").unwrap();
    check_saved(models, |m| m.seed = 3, [1, 12, 0], true);
    fs::write(models.join("campus/1.12.0/model.json"), "{").unwrap();
    check_saved(models, |m| m.seed = 3, [2, 0, 0], true);
}

#[test]
fn a_missing_card_is_written_again() {
    let folder = tempfile::tempdir().unwrap();
    let models = folder.path();
    check_saved(models, |_| {}, [1, 0, 0], true);
    check_saved(models, retrain, [1, 1, 0], true);
    let before = tree(models);
    fs::remove_file(models.join("campus/1.0.0/card.md")).unwrap();
    assert!(!save(models, &edited(|_| {})).unwrap().is_new);
    assert!(tree(models) == before);
}

#[test]
fn a_card_states_the_training_data_and_the_measured_errors() {
    let folder = tempfile::tempdir().unwrap();
    let saved = save(folder.path(), &model(Learner::Discrete)).unwrap();
    let text = fs::read_to_string(&saved.files[1]).unwrap();
    // Wilson interval of 0.015 for 2437 pairs, computed by hand: denominator 1.0015763, centre
    // 0.0157633, half width 0.0048822.
    for line in [
        "# campus 1.0.0\n",
        "| learner | `discrete`, 2 rounds |\n",
        "| features | `paper16` v1, gate 2.5 m |\n",
        "| scans | closed rings (full revolutions), 359.7 to 360.1 deg, returns from 0.9 to 70.25 m |\n",
        "| trained on | 1218 positive and 1219 negative pairs |\n",
        "| pair | 10 | 2 | 1.5 % (1.1 to 2.1) | 93.8 % (",
        "| recall at 100 % precision | pair | 0.7500 | 100.0 % | 85.0 % | 0.0 % |\n",
        "| pairs | `00ff` |\n",
    ] {
        assert!(text.contains(line), "{line} is not in\n{text}");
    }
    let silent = edited(|m| m.measured[0].precision = None);
    assert!(card(&silent).contains("# campus 9.9.9\n"));
    assert!(card(&silent).contains("| no pair classified as positive |"));
}

/// Saves the model with an edit. Saving must fail with an error that contains `words`, and must not
/// write any file.
#[track_caller]
fn check_error(edit: impl FnOnce(&mut Model), words: &str) {
    let folder = tempfile::tempdir().unwrap();
    let error = save(&folder.path().join("models"), &edited(edit)).expect_err(words);
    assert!(matches!(&error, ModelError::Invalid { what, .. } if what.contains(words)), "{error}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "{words}: a file was written");
}

/// The numbers of a model with their names in the file.
fn numbers(model: &mut Model) -> Vec<(&'static str, &mut f64)> {
    let FeatureSpec { gate_m, .. } = &mut model.features;
    let ScanSpec { range_min_m, range_max_m, .. } = &mut model.scans;
    let Measured { error, precision, recall, .. } = &mut model.measured[0];
    let point = &mut model.operating_points[0];
    let mut numbers = vec![
        ("features.gate_m", gate_m),
        ("scans.range_min_m", range_min_m),
        ("scans.range_max_m", range_max_m),
        ("measured[0].error", error),
        ("measured[0].precision", precision.as_mut().unwrap()),
        ("measured[0].recall", recall),
        ("operating_points[0].precision", &mut point.precision),
        ("operating_points[0].recall", &mut point.recall),
        ("operating_points[0].false_alarm", &mut point.false_alarm),
        ("operating_points[0].threshold", &mut point.threshold),
    ];
    numbers.extend(match &mut model.classifier.rounds[0] {
        WeakLearner::Vote { threshold, polarity, alpha, .. } => vec![
            ("rounds[0].threshold", threshold),
            ("rounds[0].polarity", polarity),
            ("rounds[0].alpha", alpha),
        ],
        WeakLearner::Line { slope, intercept, .. } => {
            vec![("rounds[0].slope", slope), ("rounds[0].intercept", intercept)]
        }
        WeakLearner::Step { threshold, below, above, .. } => vec![
            ("rounds[0].threshold", threshold),
            ("rounds[0].below", below),
            ("rounds[0].above", above),
        ],
        // The numbers of a tree cannot be changed; see
        // `a_tree_with_an_invalid_number_is_not_saved`.
        WeakLearner::Tree(_) => Vec::new(),
    });
    numbers
}

#[test]
fn a_model_with_an_invalid_number_is_not_saved() {
    for learner in [Learner::Discrete, Learner::GentleLine, Learner::GentleStump] {
        let n_numbers = numbers(&mut model(learner)).len();
        for k in 0..n_numbers {
            let (name, _) = numbers(&mut model(learner))[k];
            for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
                let edit = |m: &mut Model| {
                    *m = model(learner);
                    *numbers(m)[k].1 = value;
                };
                check_error(edit, &format!("{name}: {value}, expected"));
            }
        }
    }
    for k in 3..9 {
        let (name, _) = numbers(&mut model(Learner::Discrete))[k];
        for value in [7.0, -0.1, 1f64.next_up()] {
            let words = format!("{name}: {value}, expected 0 to 1");
            check_error(|m| *numbers(m)[k].1 = value, &words);
        }
    }
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let words = format!("deg: {value}, expected a finite number");
        check_error(|m| m.scans.coverage_min_deg = value, &words);
        check_error(|m| m.scans.coverage_max_deg = value, &words);
    }
}

#[test]
fn a_tree_with_an_invalid_number_is_not_saved() {
    let with = |threshold: f64, leaf: f64| {
        let node = Node { feature: 1, threshold };
        move |m: &mut Model| {
            *m = model(Learner::LogitTrees);
            let tree = Tree::new(&[node], &[0.5, leaf]).unwrap();
            m.classifier.rounds[0] = WeakLearner::Tree(tree);
        }
    };
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let words = format!("rounds[0].leaves[1]: {value}, expected a finite number");
        check_error(with(1.0, value), &words);
    }
    for value in [f64::NAN, f64::NEG_INFINITY] {
        let words = format!("rounds[0].nodes[0].threshold: {value}, expected a finite number");
        check_error(with(value, 0.5), &words);
    }
}

#[test]
fn a_model_whose_name_is_a_path_is_not_saved() {
    for name in ["../campus", "..", ".", "", "/campus", "a/b", "a\\b", ".git", "a b", "käfer"] {
        check_error(|m| m.name = name.into(), &format!("name: `{name}`, expected letters"));
    }
}

#[test]
fn an_invalid_model_does_not_change_saved_models() {
    let folder = tempfile::tempdir().unwrap();
    check_saved(folder.path(), |_| {}, [1, 0, 0], true);
    let before = tree(folder.path());
    save(folder.path(), &edited(|m| m.measured[0].error = 7.0)).unwrap_err();
    assert!(tree(folder.path()) == before);
    check_error(|m| m.classifier.rounds.clear(), "rounds: none");
    check_error(|m| m.features.names.push("size".into()), "duplicate name");
    check_error(|m| m.classifier.learner = Learner::GentleLine, "rounds[0].kind: `vote`");
}
