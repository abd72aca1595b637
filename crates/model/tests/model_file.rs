//! Saved models load with the same bits. Damaged and altered files are errors.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

mod common;

use std::error::Error;
use std::fs;
use std::path::Path;

use common::{is_same, model};
use dataset::SplitMix64;
use model::{Learner, Model, ModelError, ScanSpec, WeakLearner, load, save};
use serde_json::{Value, json};

const LEARNERS: [Learner; 4] =
    [Learner::Discrete, Learner::GentleLine, Learner::GentleStump, Learner::LogitTrees];

/// The text of a saved model.
fn json_of(learner: Learner) -> String {
    let folder = tempfile::tempdir().unwrap();
    let saved = save(folder.path(), &model(learner)).unwrap();
    fs::read_to_string(&saved.files[0]).unwrap()
}

/// Loads a file with these bytes.
fn load_bytes(bytes: &[u8]) -> Result<Model, ModelError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.json");
    fs::write(&path, bytes).unwrap();
    load(&path)
}

/// An error and its causes, separated by colons, as the program prints them.
fn chain(error: &dyn Error) -> String {
    match error.source() {
        Some(source) => format!("{error}: {}", chain(source)),
        None => error.to_string(),
    }
}

/// Edits the JSON of a model. Loading it must fail with an error that contains `words`.
#[track_caller]
fn check_error(learner: Learner, edit: impl FnOnce(&mut Value), words: &str) -> ModelError {
    let mut value: Value = serde_json::from_str(&json_of(learner)).unwrap();
    edit(&mut value);
    let error = load_bytes(value.to_string().as_bytes()).expect_err(words);
    let message = chain(&error);
    assert!(message.contains("model.json") && message.contains(words), "{message}");
    error
}

/// The text of a model with a valid digest: the BLAKE3 digest of the text with an empty `digest`.
fn signed(mut text: String) -> Option<String> {
    let start = text.find(DIGEST)? + DIGEST.len();
    let end = start + text[start..].find('"')?;
    text.replace_range(start..end, "");
    let digest = blake3::hash(text.as_bytes()).to_hex();
    text.insert_str(start, &digest);
    Some(text)
}

const DIGEST: &str = "\n  \"digest\": \"";

/// The digest in the text of a model.
fn digest_in(text: &str) -> &str {
    &text[text.find(DIGEST).unwrap() + DIGEST.len()..][..64]
}

/// The text of a model with a part replaced and a valid digest.
#[track_caller]
fn altered(text: &str, from: &str, to: &str) -> String {
    assert!(text.contains(from), "{from} is not in\n{text}");
    signed(text.replacen(from, to, 1)).unwrap()
}

/// Replaces a part of a model and gives it a valid digest. Loading it must fail with an error that
/// contains `words`.
#[track_caller]
fn check_invalid(learner: Learner, from: &str, to: &str, words: &str) {
    let error = load_bytes(altered(&json_of(learner), from, to).as_bytes()).expect_err(words);
    let ModelError::Invalid { what, .. } = &error else { panic!("{error}") };
    assert!(what.contains(words) && error.to_string().contains("model.json"), "{error}");
}

#[test]
fn models_of_every_learner_load_as_saved() {
    for learner in LEARNERS {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("campus/1.0.0/model.json");
        assert_eq!(save(folder.path(), &model(learner)).unwrap().files[0], path);
        assert_eq!(load(&path).unwrap(), model(learner));
        assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 2, "no temporary files");
    }
}

#[test]
fn numbers_keep_their_bits() {
    let mut random = SplitMix64::new(1);
    let any =
        std::iter::repeat_with(|| f64::from_bits(random.next_u64())).filter(|v| v.is_finite());
    let edge_cases = [-0.0, 5e-324, f64::MIN_POSITIVE, f64::MAX, f64::MIN, f64::EPSILON, 0.1 + 0.2];
    let values: Vec<f64> = edge_cases.into_iter().chain(any.take(2993)).collect();
    let step =
        |v: &[f64]| WeakLearner::Step { feature: 0, threshold: v[0], below: v[1], above: v[2] };
    let mut saved = model(Learner::GentleStump);
    saved.classifier.rounds = values.chunks(3).map(step).collect();
    saved.scans = ScanSpec {
        is_ring: false,
        coverage_min_deg: f32::from_bits(1),
        coverage_max_deg: 359.7f32.next_up(),
        range_min_m: -0.0,
        range_max_m: f64::MAX,
    };
    saved.features.gate_m = 5e-324;
    saved.measured[0].error = 1f64.next_down();
    let folder = tempfile::tempdir().unwrap();
    let loaded = load(&save(folder.path(), &saved).unwrap().files[0]).unwrap();
    assert!(is_same(&loaded, &saved));
    assert!(!is_same(&loaded, &model(Learner::GentleStump)));
}

#[test]
fn the_error_for_altered_content_states_both_digests() {
    let text = json_of(Learner::Discrete);
    let stated = digest_in(&text);
    assert_eq!(signed(text.clone()).unwrap(), text);
    for (from, to) in [
        ("\"threshold\": 2.125", "\"threshold\": 2.25"),
        ("\"threshold\": 0.75", "\"threshold\": 0.5"),
        ("\"false_alarm\": 0.0", "\"false_alarm\": -0.0"),
        ("\"positive_radius_m\": 1.5", "\"positive_radius_m\": 1.25"),
        ("\"version\": \"1.0.0\"", "\"version\": \"1.0.1\""),
        ("00ff", "00fe"),
    ] {
        let signed = altered(&text, from, to);
        let edited = text.replacen(from, to, 1);
        let error = load_bytes(edited.as_bytes()).expect_err(to);
        let ModelError::Digest { found, expected, .. } = &error else { panic!("{error}") };
        assert_eq!((found.as_str(), expected.as_str()), (stated, digest_in(&signed)));
        let message = error.to_string();
        assert!(message.contains(found) && message.contains(expected), "{message}");
        // With a valid digest it is another model.
        let other = load_bytes(signed.as_bytes()).expect(to);
        assert!(!is_same(&other, &model(Learner::Discrete)), "{to}");
    }
    for digest in ["", "00ff", &"0".repeat(64), &stated.to_uppercase()] {
        let error = load_bytes(text.replace(stated, digest).as_bytes()).expect_err(digest);
        let ModelError::Digest { found, expected, .. } = &error else { panic!("{error}") };
        assert_eq!((found.as_str(), expected.as_str()), (digest, stated));
    }
}

#[test]
fn equal_content_in_other_json_is_the_same_model() {
    let text = json_of(Learner::Discrete);
    let sorted: Value = serde_json::from_str(&text).unwrap();
    for other in [
        text.trim_end().to_owned(),
        text.replace('\n', "\r\n"),
        text.replace("  ", "\t"),
        sorted.to_string(),
        text.replace("\"false_alarm\": 0.0", "\"false_alarm\": 0"),
        text.replace("0.9375", "9375e-4"),
        text.replace("campus", "\\u0063ampus"),
    ] {
        assert_ne!(other, text);
        assert!(is_same(&load_bytes(other.as_bytes()).unwrap(), &model(Learner::Discrete)));
    }
}

#[test]
fn files_that_are_not_models_are_errors() {
    let missing = load(Path::new("no/such/model.json")).unwrap_err();
    assert!(matches!(missing, ModelError::Io { action: "read", .. }));
    assert!(missing.to_string().contains("cannot read no/such/model.json"), "{missing}");
    for text in ["", "{", "model", "\u{feff}{}", &"[".repeat(100_000)] {
        let error = load_bytes(text.as_bytes()).unwrap_err();
        assert!(matches!(error, ModelError::NotAModel { .. }), "{error}");
    }
    for text in ["[]", "7", "null", "{}"] {
        let error = load_bytes(text.as_bytes()).unwrap_err();
        assert!(matches!(error, ModelError::NoVersion { .. }), "{error}");
    }
    let large = tempfile::NamedTempFile::new().unwrap();
    large.as_file().set_len(65 << 20).unwrap();
    let error = load(large.path()).unwrap_err();
    assert!(matches!(error, ModelError::TooLarge { n_bytes: 68_157_440, .. }), "{error}");
    assert!(error.to_string().contains("it has 68157440 bytes, expected 67108864 or less"));

    for found in [json!(2), json!(0), json!("1"), json!(null), json!(1.5)] {
        let words = format!("has format version {found}, expected 1");
        let error = check_error(Learner::Discrete, |f| f["format_version"] = found, &words);
        assert!(matches!(error, ModelError::Version { .. }));
        assert!(error.to_string().contains("loopboost train"), "{error}");
    }
}

/// The objects whose keys are fixed, as JSON pointers.
const OBJECTS: [&str; 7] =
    ["", "/features", "/scans", "/training", "/measured/0", "/operating_points/0", "/rounds/0"];

#[test]
fn unknown_and_missing_fields_are_reported_by_name() {
    for learner in LEARNERS {
        let file: Value = serde_json::from_str(&json_of(learner)).unwrap();
        for place in OBJECTS {
            let add = |file: &mut Value| file.pointer_mut(place).unwrap()["surprise"] = json!(1);
            let error = check_error(learner, add, "surprise");
            assert!(matches!(error, ModelError::NotAModel { .. }));
            let keys = file.pointer(place).unwrap().as_object().unwrap().keys();
            for key in keys {
                let remove = |file: &mut Value| {
                    file.pointer_mut(place).unwrap().as_object_mut().unwrap().remove(key);
                };
                let words = if key == "warnings" { "was altered" } else { key.as_str() };
                let error = check_error(learner, remove, words);
                let is_expected = match (place, key.as_str()) {
                    ("", "format_version") => matches!(error, ModelError::NoVersion { .. }),
                    // A model without warnings does not have this field.
                    ("/training", "warnings") => matches!(error, ModelError::Digest { .. }),
                    _ => matches!(error, ModelError::NotAModel { .. }),
                };
                assert!(is_expected, "{place} {key}");
            }
        }
    }
}

#[test]
fn duplicate_fields_are_errors() {
    for learner in LEARNERS {
        let text = json_of(learner);
        let mut n_fields = 0;
        for line in text.lines().filter(|line| line.contains("\": ") && !line.ends_with(['{', '[']))
        {
            // The keys of these three are not fixed.
            let (key, _) = line.trim().split_once(": ").unwrap();
            if ["\"positive_radius_m\"", "\"pairs\"", "\"duplicate_packets\""].contains(&key) {
                continue;
            }
            let twice = format!("{},\n{line}", line.trim_end_matches(','));
            let twice = text.replacen(line, &twice, 1);
            let error = load_bytes(twice.as_bytes()).expect_err(line);
            let words = format!("duplicate field `{}`", key.trim_matches('"'));
            assert!(matches!(error, ModelError::NotAModel { .. }), "{error}");
            assert!(chain(&error).contains(&words), "{}", chain(&error));
            n_fields += 1;
        }
        assert!(31 < n_fields, "{n_fields}");
    }
}

#[test]
fn invalid_values_are_reported_by_name() {
    use Learner::Discrete;
    let unknown = "rounds[0].feature: `colour` is not among features.names";
    check_invalid(Discrete, "\"feature\": \"distance\"", "\"feature\": \"colour\"", unknown);
    let twice = "features.names: duplicate name";
    check_invalid(Discrete, "\"centroid\"", "\"size\"", twice);
    for name in ["", "../campus", ".campus", "a/b", "a b", "a\u{e4}"] {
        let words = format!("name: `{name}`, expected letters");
        check_invalid(Discrete, "\"campus\"", &format!("\"{name}\""), &words);
    }
    for (key, from, to, words) in [
        ("polarity", "1.0", "0.5", "rounds[0].polarity: 0.5, expected 1 or -1"),
        ("polarity", "-1.0", "0.0", "rounds[1].polarity: 0, expected 1 or -1"),
        ("polarity", "-1.0", "-2.0", "rounds[1].polarity: -2, expected 1 or -1"),
        ("gate_m", "2.5", "0.0", "features.gate_m: 0, expected more than 0"),
        ("gate_m", "2.5", "-0.0", "features.gate_m: -0, expected more than 0"),
        ("gate_m", "2.5", "-2.5", "features.gate_m: -2.5, expected more than 0"),
        ("is_ring", "true", "false", "scans.is_ring: false with a coverage of 359.7"),
        ("coverage_min_deg", "359.7", "354.5", "scans.is_ring: true with a coverage of 354.5 deg"),
        ("coverage_min_deg", "359.7", "360.5", "scans: coverage from 360.5 to 360.1"),
        ("coverage_min_deg", "359.7", "-1.0", "scans: coverage from -1 to 360.1"),
        ("range_min_m", "0.9", "-0.5", "scans: ranges from -0.5 to 70.25 m"),
        ("range_min_m", "0.9", "70.25", "scans: ranges from 70.25 to 70.25 m"),
        (
            "duplicate_packets",
            "3",
            "0",
            "training.warnings.duplicate_packets: 0, expected 1 or more",
        ),
        ("error", "0.015", "7.0", "measured[0].error: 7, expected 0 to 1"),
        ("precision", "0.9375", "1.5", "measured[0].precision: 1.5, expected 0 to 1"),
        ("recall", "0.96", "-0.5", "measured[0].recall: -0.5, expected 0 to 1"),
        ("precision", "1.0", "7.0", "operating_points[0].precision: 7, expected 0 to 1"),
        ("recall", "0.85", "85.0", "operating_points[0].recall: 85, expected 0 to 1"),
        ("false_alarm", "0.0", "-1.0", "operating_points[0].false_alarm: -1, expected 0 to 1"),
    ] {
        let [from, to] = [from, to].map(|value| format!("\"{key}\": {value}"));
        check_invalid(Discrete, &from, &to, words);
    }
    let words = "training.warnings: `a b`, expected a snake_case code";
    check_invalid(Discrete, "\"duplicate_packets\"", "\"a b\"", words);
    for learner in LEARNERS {
        let text = json_of(learner);
        let rounds = &text[text.find("\"rounds\": [\n").unwrap()..];
        let none = "\"rounds\": []\n}\n";
        check_invalid(learner, rounds, none, "rounds: none, expected at least one");
        let of = |learner: Learner| format!("\"learner\": \"{}\"", learner.name());
        let kind = &text[text.find("\"kind\": ").unwrap() + 8..][..6];
        for other in LEARNERS.into_iter().filter(|other| *other != learner) {
            let kind = kind.replace('"', "`");
            let words = format!("rounds[0].kind: {kind} in a `{}` model, expected", other.name());
            check_invalid(learner, &of(learner), &of(other), &words);
        }
    }
    check_error(Discrete, |f| f["rounds"][0]["kind"] = json!("bush"), "variant `bush`");
    let check_tree = |edit: fn(&mut Value), words: &str| {
        check_error(Learner::LogitTrees, |f| edit(&mut f["rounds"]), words);
    };
    let words = "rounds[0].feature: `colour` is not among features.names";
    check_tree(|r| r[0]["nodes"][2]["feature"] = json!("colour"), words);
    let words = "rounds[0]: 3 nodes and 3 leaves, expected 2^d - 1 and 2^d, d = 1 to 3";
    check_tree(|r| r[0]["leaves"] = json!([1.0, 2.0, 3.0]), words);
    check_tree(|r| r[1]["nodes"] = json!([null, null]), "rounds[1]: 2 nodes and 2 leaves");
    let words = "rounds[1]: 0 nodes and 1 leaves";
    check_tree(|r| r[1] = json!({"kind": "tree", "nodes": [], "leaves": [1.0]}), words);
    let deep = |r: &mut Value| {
        r[1] = json!({"kind": "tree", "nodes": vec![(); 15], "leaves": vec![1.0; 16]});
    };
    check_tree(deep, "rounds[1]: 15 nodes and 16 leaves");
    check_tree(|r| r[0]["nodes"][0]["colour"] = json!(1), "unknown field `colour`");
    check_error(Discrete, |f| f["learner"] = json!("forest"), "variant `forest`");
}

/// The lines with a number, as (line number, text before the number).
fn number_lines(text: &str) -> Vec<(usize, String)> {
    let number = |(k, line): (usize, &str)| {
        let (key, value) = line.split_once(": ")?;
        value.trim_end_matches(',').parse::<f64>().ok().map(|_| (k, format!("{key}: ")))
    };
    text.lines().enumerate().filter_map(number).collect()
}

/// The text with line `k` replaced. A comma at the end of the line stays.
fn with_line(text: &str, k: usize, line: &str) -> String {
    let mut lines: Vec<&str> = text.lines().collect();
    let replaced = format!("{line}{}", if lines[k].ends_with(',') { "," } else { "" });
    lines[k] = &replaced;
    lines.join("\n") + "\n"
}

#[test]
fn numbers_that_are_not_finite_are_errors() {
    for learner in LEARNERS {
        let text = json_of(learner);
        let lines = number_lines(&text);
        assert!(18 < lines.len(), "{lines:?}");
        for (k, before) in lines {
            for not_finite in ["1e999", "-1e999", "NaN", "Infinity"] {
                let edited = with_line(&text, k, &format!("{before}{not_finite}"));
                let error = load_bytes(edited.as_bytes()).expect_err(&before);
                assert!(matches!(error, ModelError::NotAModel { .. }), "{before}: {error}");
            }
            // Null is valid only for a precision (0.9375 here) and in the options of `label`, which may
            // be any JSON.
            let line = text.lines().nth(k).unwrap();
            let may_be_null = line.contains("positive_radius_m") || line.contains("0.9375");
            let edited = signed(with_line(&text, k, &format!("{before}null"))).unwrap();
            assert_eq!(load_bytes(edited.as_bytes()).is_ok(), may_be_null, "{before}null");
        }
    }
}

/// A file with one kind of damage: flipped bits, a truncation, a duplicate line or another number.
fn damage(text: &str, seed: u64) -> Vec<u8> {
    let mut random = SplitMix64::new(seed);
    let mut below = |n: usize| (random.next_u64() % n as u64) as usize;
    let mut bytes = text.as_bytes().to_vec();
    match below(4) {
        0 => (0..=below(3)).for_each(|_| bytes[below(text.len())] ^= 1 << below(8)),
        1 => bytes.truncate(below(text.len())),
        2 => {
            let mut lines: Vec<&str> = text.lines().collect();
            let k = below(lines.len());
            lines.insert(k, lines[k]);
            bytes = (lines.join("\n") + "\n").into_bytes();
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
fn damaged_files_are_errors_or_give_the_same_model() {
    let texts = LEARNERS.map(json_of);
    let (mut n_digest, mut n_signed) = (0, 0);
    for seed in 0..1200 {
        let bytes = damage(&texts[seed % 3], seed as u64);
        match load_bytes(&bytes) {
            Ok(loaded) => assert!(is_same(&loaded, &model(LEARNERS[seed % 3])), "{loaded:?}"),
            Err(error) => {
                n_digest += usize::from(matches!(error, ModelError::Digest { .. }));
                assert!(error.to_string().contains("model.json"), "{error}");
            }
        }
        // With a valid digest, the other checks decide. If the model loads, it can be saved.
        let Some(signed) = String::from_utf8(bytes).ok().and_then(signed) else { continue };
        if let Ok(loaded) = load_bytes(signed.as_bytes()) {
            n_signed += 1;
            let folder = tempfile::tempdir().unwrap();
            let saved = save(folder.path(), &loaded).unwrap();
            let again = Model { version: loaded.version.clone(), ..load(&saved.files[0]).unwrap() };
            assert!(is_same(&again, &loaded), "{again:?}");
        }
    }
    assert!(50 < n_digest && 30 < n_signed, "{n_digest} altered, {n_signed} loaded when signed");
}

#[test]
fn a_coverage_beyond_single_precision_is_an_error() {
    for value in ["359.7", "360.1"] {
        let text = json_of(Learner::Discrete).replace(value, "1e39");
        let error = load_bytes(text.as_bytes()).unwrap_err();
        assert!(matches!(error, ModelError::NotAModel { .. }), "{error}");
        let message = chain(&error);
        assert!(message.contains("number out of range at line"), "{message}");
    }
}

#[test]
fn the_error_for_scans_of_another_kind_states_both_kinds() {
    let rings = model(Learner::Discrete).scans;
    assert!(rings.check(355.0, true).is_ok() && rings.check(360.2, true).is_ok());
    let message = rings.check(180.0, false).unwrap_err().to_string();
    assert!(message.contains("the scan covers part of the circle (180 deg)"), "{message}");
    assert!(message.contains("scans that cover the full circle (359.7 deg)"), "{message}");

    let parts = ScanSpec { is_ring: false, coverage_min_deg: 180.0, ..rings };
    assert!(parts.check(180.0, false).is_ok() && parts.check(359.9, true).is_err());
}
