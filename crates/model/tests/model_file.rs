//! Models survive the disk, are never overwritten, and a damaged one is refused.

use std::fs;
use std::path::Path;

use model::{
    Classifier, FeatureSpec, Learner, Measured, Model, ModelError, OperatingPoint, ScanSpec,
    Training, WeakLearner, load, next_version, save,
};
use semver::Version;
use serde_json::{Value, json};

const LEARNERS: [Learner; 3] = [Learner::Discrete, Learner::GentleLine, Learner::GentleStump];

fn rounds(learner: Learner) -> Vec<WeakLearner> {
    match learner {
        Learner::Discrete => vec![
            WeakLearner::Vote { feature: 1, threshold: 2.125, polarity: 1.0, alpha: 0.1 + 0.2 },
            WeakLearner::Vote { feature: 0, threshold: -0.5, polarity: -1.0, alpha: 1.0 / 3.0 },
        ],
        Learner::GentleLine => vec![WeakLearner::Line { feature: 2, slope: -0.7, intercept: 0.3 }],
        Learner::GentleStump => {
            vec![WeakLearner::Step { feature: 0, threshold: 4.5, below: 0.9, above: -0.6 }]
        }
    }
}

fn model(learner: Learner) -> Model {
    Model {
        name: "campus".into(),
        version: Version::new(1, 0, 0),
        program_version: "0.1.0".into(),
        seed: u64::MAX,
        features: FeatureSpec {
            set: "paper16".into(),
            version: 1,
            gate_m: 2.5,
            names: ["centroid", "distance", "size"].map(str::to_owned).into(),
        },
        scans: ScanSpec {
            is_ring: true,
            coverage_min_deg: 359.7,
            coverage_max_deg: 360.1,
            range_min_m: 0.9,
            range_max_m: 70.25,
        },
        label_options: json!({"positive_radius_m": 1.5}),
        training: Training {
            n_positive: 1218,
            n_negative: 1219,
            digests: [("pairs".to_owned(), "00ff".to_owned())].into(),
        },
        measured: vec![Measured {
            grouping: "pair".into(),
            folds: 10,
            rounds: 2,
            error: 0.015,
            precision: Some(0.9375),
            recall: 0.96,
        }],
        operating_points: vec![OperatingPoint {
            name: "recall at 100 % precision".into(),
            grouping: "pair".into(),
            threshold: 0.75,
            precision: 1.0,
            recall: 0.85,
            false_alarm: 0.0,
        }],
        classifier: Classifier { learner, rounds: rounds(learner) },
    }
}

/// The text of a saved model.
fn json_of(learner: Learner) -> String {
    let folder = tempfile::tempdir().unwrap();
    fs::read_to_string(save(folder.path(), &model(learner)).unwrap()).unwrap()
}

/// What becomes of a file with these bytes.
fn load_bytes(bytes: &[u8]) -> Result<Model, ModelError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.json");
    fs::write(&path, bytes).unwrap();
    load(&path)
}

/// Edits the JSON of a model, which must then be refused with these words.
#[track_caller]
fn check_refused(learner: Learner, edit: impl FnOnce(&mut Value), words: &str) -> ModelError {
    let mut value: Value = serde_json::from_str(&json_of(learner)).unwrap();
    edit(&mut value);
    let refused = load_bytes(value.to_string().as_bytes()).expect_err(words);
    let message = refused.to_string();
    assert!(message.contains("model.json") && message.contains(words), "{message}");
    refused
}

/// The numbers of a model, in order.
fn numbers(model: &Model) -> Vec<f64> {
    let Model { features, scans, measured, operating_points, classifier, .. } = model;
    let ScanSpec { coverage_min_deg, coverage_max_deg, range_min_m, range_max_m, .. } = *scans;
    let mut numbers = vec![features.gate_m, range_min_m, range_max_m];
    numbers.extend([coverage_min_deg, coverage_max_deg].map(f64::from));
    numbers.extend(measured.iter().flat_map(|m| [m.error, m.recall, m.precision.unwrap_or(0.0)]));
    for point in operating_points {
        numbers.extend([point.threshold, point.precision, point.recall, point.false_alarm]);
    }
    numbers.extend(classifier.rounds.iter().flat_map(|round| match *round {
        WeakLearner::Vote { threshold, polarity, alpha, .. } => vec![threshold, polarity, alpha],
        WeakLearner::Line { slope, intercept, .. } => vec![slope, intercept],
        WeakLearner::Step { threshold, below, above, .. } => vec![threshold, below, above],
    }));
    numbers
}

/// Pseudo-random numbers of a seed: SplitMix64.
fn random(mut state: u64) -> impl FnMut() -> u64 {
    move || {
        state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }
}

#[test]
fn models_of_every_learner_survive() {
    for learner in LEARNERS {
        let folder = tempfile::tempdir().unwrap();
        let path = save(folder.path(), &model(learner)).unwrap();
        assert_eq!(path, folder.path().join("campus/1.0.0/model.json"));
        assert_eq!(load(&path).unwrap(), model(learner));
        assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1, "nothing partial");
    }
}

#[test]
fn numbers_survive_bit_for_bit() {
    let mut next = random(1);
    let any = std::iter::repeat_with(|| f64::from_bits(next())).filter(|v| v.is_finite());
    let seams = [-0.0, 5e-324, f64::MIN_POSITIVE, f64::MAX, f64::MIN, f64::EPSILON, 0.1 + 0.2];
    let values: Vec<f64> = seams.into_iter().chain(any.take(2993)).collect();
    let step =
        |v: &[f64]| WeakLearner::Step { feature: 0, threshold: v[0], below: v[1], above: v[2] };
    let mut saved = model(Learner::GentleStump);
    saved.classifier.rounds = values.chunks(3).map(step).collect();
    saved.scans.coverage_min_deg = 359.7f32.next_up();
    saved.scans.coverage_max_deg = f32::from_bits(1);
    saved.features.gate_m = -0.0;
    let folder = tempfile::tempdir().unwrap();
    let loaded = load(&save(folder.path(), &saved).unwrap()).unwrap();
    let bits = |model| numbers(model).into_iter().map(f64::to_bits).collect::<Vec<_>>();
    assert!(bits(&loaded) == bits(&saved));
}

#[test]
fn a_saved_version_is_never_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let path = save(folder.path(), &model(Learner::Discrete)).unwrap();
    let before = fs::read(&path).unwrap();
    for learner in [Learner::Discrete, Learner::GentleLine] {
        let refused = save(folder.path(), &model(learner)).unwrap_err();
        assert!(matches!(&refused, ModelError::Exists { path: found } if *found == path));
        assert!(refused.to_string().contains("never overwritten"), "{refused}");
        assert_eq!(fs::read(&path).unwrap(), before);
    }
}

/// Checks the version that a model would get among `models`, and whether it is to be saved.
#[track_caller]
fn check_version(models: &Path, edit: impl FnOnce(&mut Model), version: [u64; 3], is_new: bool) {
    // The version in the model does not matter.
    let mut edited = Model { version: Version::new(9, 9, 9), ..model(Learner::Discrete) };
    edit(&mut edited);
    let [major, minor, patch] = version;
    let expected = (Version::new(major, minor, patch), is_new);
    assert_eq!(next_version(models, &edited).unwrap(), expected);
}

fn retrain(model: &mut Model) {
    model.training.digests.insert("pairs".into(), "00fe".into());
}

#[test]
fn what_differs_from_the_newest_version_tells_the_next() {
    let folder = tempfile::tempdir().unwrap();
    let models = folder.path();
    check_version(&models.join("missing"), |_| {}, [1, 0, 0], true);
    check_version(models, |_| {}, [1, 0, 0], true);
    save(models, &model(Learner::Discrete)).unwrap();
    check_version(models, |_| {}, [1, 0, 0], false);
    check_version(models, |m| m.name = "other".into(), [1, 0, 0], true);
    check_version(models, retrain, [1, 1, 0], true);
    check_version(models, |m| m.seed = 1, [1, 1, 0], true);
    check_version(models, |m| m.features.set = "other".into(), [2, 0, 0], true);
    check_version(models, |m| m.features.version = 2, [2, 0, 0], true);
    check_version(models, |m| m.features.gate_m = 3.0, [2, 0, 0], true);
    check_version(models, |m| m.features.names.swap(0, 1), [2, 0, 0], true);
    check_version(models, |m| m.scans.is_ring = false, [2, 0, 0], true);
    check_version(models, |m| *m = model(Learner::GentleLine), [2, 0, 0], true);
}

#[test]
fn the_newest_version_is_the_greatest_that_holds_a_model() {
    let folder = tempfile::tempdir().unwrap();
    let models = folder.path();
    for minor in [0, 9, 10] {
        let version = Version::new(1, minor, 0);
        save(models, &Model { version, ..model(Learner::Discrete) }).unwrap();
    }
    for folder in ["old", "7.0.0", "2"] {
        fs::create_dir(models.join("campus").join(folder)).unwrap();
    }
    check_version(models, |_| {}, [1, 10, 0], false);
    check_version(models, retrain, [1, 11, 0], true);
    fs::write(models.join("campus/1.10.0/model.json"), "{").unwrap();
    check_version(models, |_| {}, [2, 0, 0], true);
    check_version(models, retrain, [2, 0, 0], true);
}

#[test]
fn a_file_that_is_no_model_of_this_format_is_refused() {
    let missing = load(Path::new("no/such/model.json")).unwrap_err();
    assert!(matches!(missing, ModelError::Io { action: "read", .. }));
    assert!(missing.to_string().contains("cannot read no/such/model.json"), "{missing}");
    for text in ["", "{", "model", "[]", "7", "null", "{}", "\u{feff}{}", &"[".repeat(100_000)] {
        let refused = load_bytes(text.as_bytes()).unwrap_err();
        assert!(matches!(refused, ModelError::NotAModel { .. }), "{refused}");
    }
    let large = tempfile::NamedTempFile::new().unwrap();
    large.as_file().set_len(65 << 20).unwrap();
    let refused = load(large.path()).unwrap_err();
    let ModelError::NotAModel { detail, .. } = refused else { panic!("{refused}") };
    assert_eq!(detail, "68157440 bytes, a model has at most 67108864");

    for found in [json!(2), json!(0), json!("1"), json!(null), json!(1.5)] {
        let words = format!("has format version {found}, this program reads version 1");
        let refused = check_refused(Learner::Discrete, |f| f["format_version"] = found, &words);
        assert!(matches!(refused, ModelError::Version { .. }));
        assert!(refused.to_string().contains("loopboost train"), "{refused}");
    }
}

/// The places of the objects whose keys are fixed.
const OBJECTS: [&str; 7] =
    ["", "/features", "/scans", "/training", "/measured/0", "/operating_points/0", "/rounds/0"];

#[test]
fn unknown_and_missing_fields_are_named() {
    for learner in LEARNERS {
        let file: Value = serde_json::from_str(&json_of(learner)).unwrap();
        for place in OBJECTS {
            let add = |file: &mut Value| file.pointer_mut(place).unwrap()["surprise"] = json!(1);
            let refused = check_refused(learner, add, "surprise");
            assert!(matches!(refused, ModelError::NotAModel { .. }));
            let keys = file.pointer(place).unwrap().as_object().unwrap().keys();
            // A precision is optional.
            for key in keys.filter(|key| (place, key.as_str()) != ("/measured/0", "precision")) {
                let remove = |file: &mut Value| {
                    file.pointer_mut(place).unwrap().as_object_mut().unwrap().remove(key);
                };
                let refused = check_refused(learner, remove, key);
                assert!(matches!(refused, ModelError::NotAModel { .. }), "{place} {key}");
            }
        }
    }
}

#[test]
fn values_that_cannot_be_are_named() {
    let check_invalid = |learner, pointer: &str, value: Value, words: &str| {
        let edit = |file: &mut Value| *file.pointer_mut(pointer).unwrap() = value;
        let refused = check_refused(learner, edit, words);
        assert!(matches!(refused, ModelError::Invalid { .. }), "{refused}");
    };
    use Learner::Discrete;
    let unknown = "rounds[1].feature: `colour` is not among features.names";
    check_invalid(Discrete, "/rounds/1/feature", json!("colour"), unknown);
    let twice = "features.names: `size` stands there twice";
    check_invalid(Discrete, "/features/names/0", json!("size"), twice);
    for polarity in [0.5, 0.0, -2.0] {
        let words = format!("rounds[1].polarity: {polarity}, expected 1 or -1");
        check_invalid(Discrete, "/rounds/1/polarity", json!(polarity), &words);
    }
    for learner in LEARNERS {
        check_invalid(learner, "/rounds", json!([]), "rounds: none, expected at least one");
        for other in LEARNERS.into_iter().filter(|other| *other != learner) {
            let foreign: Value = serde_json::from_str(&json_of(other)).unwrap();
            let kind = foreign["rounds"][0]["kind"].as_str().unwrap();
            let words = format!("rounds[0].kind: `{kind}` in a `{}` model", learner.name());
            check_invalid(learner, "/rounds/0", foreign["rounds"][0].clone(), &words);
        }
    }
    check_refused(Discrete, |f| f["rounds"][0]["kind"] = json!("tree"), "variant `tree`");
    check_refused(Discrete, |f| f["learner"] = json!("forest"), "variant `forest`");
}

/// The lines that hold a number, as (line, what stands before it).
fn number_lines(text: &str) -> Vec<(usize, String)> {
    let number = |(k, line): (usize, &str)| {
        let (key, value) = line.split_once(": ")?;
        value.trim_end_matches(',').parse::<f64>().ok().map(|_| (k, format!("{key}: ")))
    };
    text.lines().enumerate().filter_map(number).collect()
}

/// The text with line `k` replaced; a comma at its end stays.
fn with_line(text: &str, k: usize, line: &str) -> String {
    let mut lines: Vec<&str> = text.lines().collect();
    let replaced = format!("{line}{}", if lines[k].ends_with(',') { "," } else { "" });
    lines[k] = &replaced;
    lines.join("\n")
}

#[test]
fn numbers_that_are_not_finite_are_refused() {
    for learner in LEARNERS {
        let text = json_of(learner);
        let lines = number_lines(&text);
        assert!(18 < lines.len(), "{lines:?}");
        for (k, before) in lines {
            for not_finite in ["1e999", "-1e999", "NaN", "Infinity"] {
                let edited = with_line(&text, k, &format!("{before}{not_finite}"));
                let refused = load_bytes(edited.as_bytes()).expect_err(&before);
                assert!(matches!(refused, ModelError::NotAModel { .. }), "{before}: {refused}");
            }
            // Null is no precision (0.9375 here); the options of `label` are not read at all.
            let line = text.lines().nth(k).unwrap();
            let may_be_null = line.contains("positive_radius_m") || line.contains("0.9375");
            let edited = with_line(&text, k, &format!("{before}null"));
            assert_eq!(load_bytes(edited.as_bytes()).is_ok(), may_be_null, "{before}null");
        }
    }
}

/// One of the damages that a disk, a hand or a program may do to a file.
fn damage(text: &str, seed: u64) -> Vec<u8> {
    let mut next = random(seed);
    let mut below = |n: usize| (next() % n as u64) as usize;
    let mut bytes = text.as_bytes().to_vec();
    match below(4) {
        0 => (0..=below(3)).for_each(|_| bytes[below(text.len())] ^= 1 << below(8)),
        1 => bytes.truncate(below(text.len())),
        2 => {
            let mut lines: Vec<&str> = text.lines().collect();
            let k = below(lines.len());
            lines.insert(k, lines[k]);
            bytes = lines.join("\n").into_bytes();
        }
        _ => {
            let values = ["-0.0", "0", "-1", "1e38", "1e-400", "1e999", "null", "\"1\""];
            let lines = number_lines(text);
            let (k, before) = &lines[below(lines.len())];
            let line = format!("{before}{}", values[below(values.len())]);
            bytes = with_line(text, *k, &line).into_bytes();
        }
    }
    bytes
}

#[test]
fn damaged_files_are_refused_or_hold_finite_numbers() {
    let texts = LEARNERS.map(json_of);
    let mut n_loaded = 0;
    for seed in 0..1200 {
        let bytes = damage(&texts[seed % 3], seed as u64);
        match load_bytes(&bytes) {
            Ok(model) => {
                n_loaded += 1;
                assert!(numbers(&model).into_iter().all(f64::is_finite), "{model:?}");
            }
            Err(refused) => assert!(refused.to_string().contains("model.json"), "{refused}"),
        }
    }
    assert!((100..1100).contains(&n_loaded), "{n_loaded} of 1200 loaded");
}

#[test]
#[ignore = "a coverage beyond f32 loads as infinite; `load` does not check scans.coverage_*_deg"]
fn a_coverage_beyond_single_precision_is_refused() {
    for key in ["coverage_min_deg", "coverage_max_deg"] {
        check_refused(Learner::Discrete, |f| f["scans"][key] = json!(1e39), key);
    }
}

#[test]
fn scans_of_another_kind_are_refused_and_both_kinds_named() {
    let rings = model(Learner::Discrete).scans;
    assert!(rings.check(355.0, true).is_ok() && rings.check(360.2, true).is_ok());
    let message = rings.check(180.0, false).unwrap_err().to_string();
    assert!(message.contains("trained on full rings (359.7 deg)"), "{message}");
    assert!(message.contains("a part of the circle (180 deg)"), "{message}");

    let parts = ScanSpec { is_ring: false, coverage_min_deg: 180.0, ..rings };
    assert!(parts.check(180.0, false).is_ok() && parts.check(359.9, true).is_err());
}
