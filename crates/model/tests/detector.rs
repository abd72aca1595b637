//! The detector in `model.json` and in the model card.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

mod common;

use std::fs;

use common::{is_same, model};
use model::{
    Detector, DetectorLog, DetectorPart, Evidence, Learner, Model, ModelError, VerifierMeasures,
    card, load, save,
};
use serde_json::{Value, json};

fn detector() -> Detector {
    let log = |log: &str| DetectorLog { log: log.into(), n_right: 120, n_wrong: 7 };
    let measures = VerifierMeasures {
        log_loss: 0.0625,
        log_loss_without_classifier: 0.125,
        log_loss_of_share: 0.5,
        n_with_classifier: 254,
    };
    let mut detector = Detector {
        measured: Some(measures),
        not_fitted: vec![DetectorPart::Odometry, DetectorPart::Strong],
        logs: vec![log("monday"), log("tuesday")],
        ..Detector::starting_values()
    };
    detector.verifier.conflict = -4.25;
    detector.verifier.classifier = 0.75;
    detector
}

fn with_detector() -> Model {
    Model { detector: Some(detector()), ..model(Learner::Discrete) }
}

/// The text of a saved model.
fn json_of(model: &Model) -> String {
    let folder = tempfile::tempdir().unwrap();
    fs::read_to_string(&save(folder.path(), model).unwrap().files[0]).unwrap()
}

fn load_text(text: &str) -> Result<Model, ModelError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.json");
    fs::write(&path, text).unwrap();
    load(&path)
}

/// Sets a value of the detector. Loading must fail with an error that contains `words`; saving as
/// well if the value can be in a [`Detector`].
#[track_caller]
fn check_error(pointer: &str, value: &Value, words: &str) {
    let mut file: Value = serde_json::from_str(&json_of(&with_detector())).unwrap();
    *file["detector"].pointer_mut(pointer).expect(pointer) = value.clone();
    let error = load_text(&file.to_string()).expect_err(words);
    let ModelError::Invalid { what, .. } = &error else { panic!("{error}") };
    assert!(what.contains(words), "{what}");
    if let Ok(detector) = serde_json::from_value(file["detector"].clone()) {
        let model = Model { detector: Some(detector), ..model(Learner::Discrete) };
        let folder = tempfile::tempdir().unwrap();
        let error = save(folder.path(), &model).expect_err(words);
        assert!(error.to_string().contains(words), "{error}");
    }
}

#[test]
fn a_detector_loads_as_saved() {
    for detector in [detector(), Detector::starting_values()] {
        let folder = tempfile::tempdir().unwrap();
        let model = Model { detector: Some(detector), ..model(Learner::LogitTrees) };
        let saved = save(folder.path(), &model).unwrap();
        assert!(is_same(&load(&saved.files[0]).unwrap(), &model));
        assert!(!save(folder.path(), &model).unwrap().is_new);
    }
}

#[test]
fn a_model_without_a_detector_has_the_fields_that_it_had_before_detectors() {
    let file: Value = serde_json::from_str(&json_of(&model(Learner::Discrete))).unwrap();
    let mut keys: Vec<&String> = file.as_object().unwrap().keys().collect();
    keys.sort();
    let expected = "digest features format_version label_options learner measured name \
                    operating_points program_version rounds scans seed training version";
    assert_eq!(keys, expected.split_whitespace().collect::<Vec<_>>());
    assert!(!card(&model(Learner::Discrete)).contains("Loop detection"));
}

#[test]
fn a_model_that_gains_a_detector_is_a_new_minor_version() {
    let folder = tempfile::tempdir().unwrap();
    save(folder.path(), &model(Learner::Discrete)).unwrap();
    let saved = save(folder.path(), &with_detector()).unwrap();
    assert_eq!(saved.version.to_string(), "1.1.0");
    assert!(fs::read_to_string(&saved.files[1]).unwrap().contains("## Loop detection"));
}

#[test]
fn every_number_of_a_detector_is_checked() {
    for (pointer, value, words) in [
        (
            "/odometry/std_m",
            json!(0.0),
            "detector.odometry.std_m: 0, expected more than 0 and up to 10",
        ),
        ("/odometry/std_rad", json!(-0.1), "detector.odometry.std_rad: -0.1, expected more than 0"),
        (
            "/odometry/std_m_per_m",
            json!(-0.1),
            "detector.odometry.std_m_per_m: -0.1, expected 0 to 10",
        ),
        ("/odometry/std_rad_per_sqrt_m", json!(4.0), "std_rad_per_sqrt_m: 4, expected 0 to 3.14"),
        (
            "/drift/std_m_per_sqrt_m",
            json!(0.0),
            "detector.drift.std_m_per_sqrt_m: 0, expected more",
        ),
        (
            "/drift/std_rad_per_sqrt_m",
            json!(3.2),
            "detector.drift.std_rad_per_sqrt_m: 3.2, expected",
        ),
        (
            "/closure/std_m",
            json!(11.0),
            "detector.closure.std_m: 11, expected more than 0 and up to 10",
        ),
        ("/closure/std_rad", json!(0), "detector.closure.std_rad: 0, expected more than 0"),
        (
            "/closure/covariance_factor",
            json!(-1.0),
            "detector.closure.covariance_factor: -1, expected",
        ),
        ("/min_confidence", json!(1.5), "detector.min_confidence: 1.5, expected 0 to 1"),
        (
            "/strong/known_overlap",
            json!(50.0),
            "detector.strong.known_overlap: 50, expected 0 to 1",
        ),
        ("/strong/conflict", json!(-0.5), "detector.strong.conflict: -0.5, expected 0 to 1"),
        ("/n_candidates", json!(0), "detector.n_candidates: 0, expected 1 to 1000"),
        ("/n_candidates", json!(1001), "detector.n_candidates: 1001, expected 1 to 1000"),
        ("/verifier/overlap", json!(-1.0), "detector.verifier.overlap: -1, expected 0 or more"),
        ("/verifier/known_overlap", json!(-1.0), "detector.verifier.known_overlap: -1, expected 0"),
        ("/verifier/margin", json!(-1.0), "detector.verifier.margin: -1, expected 0 or more"),
        (
            "/verifier/classifier",
            json!(-1.0),
            "detector.verifier.classifier: -1, expected 0 or more",
        ),
        ("/verifier/conflict", json!(2.5), "detector.verifier.conflict: 2.5, expected 0 or less"),
        (
            "/verifier_without_classifier/conflict",
            json!(2.5),
            "detector.verifier_without_classifier.conflict: 2.5, expected 0 or less",
        ),
        (
            "/verifier_without_classifier/classifier",
            json!(0.5),
            "detector.verifier_without_classifier.classifier: 0.5, expected 0",
        ),
        ("/measured/log_loss", json!(-0.5), "detector.measured.log_loss: -0.5, expected 0 or more"),
        (
            "/not_fitted",
            json!(["strong", "odometry"]),
            "detector.not_fitted: strong, odometry, expected each part once",
        ),
        ("/not_fitted", json!(["drift", "drift"]), "detector.not_fitted: drift, drift, expected"),
        ("/logs/0/log", json!(""), "detector.logs[0].log: empty, expected the name of a log"),
        ("/logs/1/log", json!("monday"), "detector.logs[1].log: `monday` is a duplicate"),
    ] {
        check_error(pointer, &value, words);
    }
}

/// The numbers of a detector.
fn numbers(detector: &mut Detector) -> Vec<&mut f64> {
    let mut numbers = vec![
        &mut detector.odometry.std_m_per_m,
        &mut detector.odometry.std_m,
        &mut detector.odometry.std_rad_per_sqrt_m,
        &mut detector.odometry.std_rad,
        &mut detector.drift.std_m_per_sqrt_m,
        &mut detector.drift.std_rad_per_sqrt_m,
        &mut detector.closure.std_m,
        &mut detector.closure.std_rad,
        &mut detector.closure.covariance_factor,
        &mut detector.closure.consistency_std_m,
        &mut detector.closure.consistency_std_rad,
        &mut detector.min_confidence,
        &mut detector.strong.known_overlap,
        &mut detector.strong.conflict,
    ];
    for verifier in [&mut detector.verifier, &mut detector.verifier_without_classifier] {
        numbers.extend([
            &mut verifier.intercept,
            &mut verifier.overlap,
            &mut verifier.known_overlap,
            &mut verifier.conflict,
            &mut verifier.margin,
            &mut verifier.classifier,
        ]);
    }
    let measures = detector.measured.as_mut().unwrap();
    numbers.extend([
        &mut measures.log_loss,
        &mut measures.log_loss_without_classifier,
        &mut measures.log_loss_of_share,
    ]);
    numbers
}

#[test]
fn a_detector_with_a_number_that_is_not_finite_is_not_saved() {
    let n_numbers = numbers(&mut detector()).len();
    assert_eq!(n_numbers, 29);
    for k in 0..n_numbers {
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let mut detector = detector();
            *numbers(&mut detector)[k] = value;
            let model = Model { detector: Some(detector), ..model(Learner::Discrete) };
            let folder = tempfile::tempdir().unwrap();
            let error = save(folder.path(), &model).expect_err("not finite");
            assert!(error.to_string().contains(&format!(": {value}, expected")), "{k}: {error}");
        }
    }
}

#[test]
fn another_detector_version_is_an_error_that_names_both_versions_and_the_remedy() {
    let mut file: Value = serde_json::from_str(&json_of(&with_detector())).unwrap();
    file["detector"]["version"] = json!(2);
    // A later version may have other fields.
    file["detector"]["curvature"] = json!(0.5);
    let error = load_text(&file.to_string()).unwrap_err().to_string();
    assert!(error.contains("detector.version: 2, expected 1; train the model again"), "{error}");
    assert!(error.contains("model.json"), "{error}");
}

#[test]
fn unknown_and_missing_fields_of_a_detector_are_errors() {
    let file: Value = serde_json::from_str(&json_of(&with_detector())).unwrap();
    for place in
        ["", "/odometry", "/drift", "/closure", "/verifier", "/strong", "/logs/0", "/measured"]
    {
        let place = format!("/detector{place}");
        let mut edited = file.clone();
        edited.pointer_mut(&place).unwrap()["surprise"] = json!(1);
        let error = load_text(&edited.to_string()).unwrap_err();
        assert!(matches!(error, ModelError::NotAModel { .. }), "{place}: {error}");
        for key in file.pointer(&place).unwrap().as_object().unwrap().keys() {
            let mut edited = file.clone();
            edited.pointer_mut(&place).unwrap().as_object_mut().unwrap().remove(key);
            let error = load_text(&edited.to_string()).unwrap_err();
            // A detector without these two has no such field.
            let is_optional = place == "/detector" && ["measured", "not_fitted"].contains(&&**key);
            let is_expected = match error {
                ModelError::NotAModel { .. } => !is_optional,
                ModelError::Digest { .. } => is_optional,
                _ => false,
            };
            assert!(is_expected, "{place}/{key}");
        }
    }
}

#[test]
fn the_digest_covers_every_number_of_a_detector() {
    let text = json_of(&with_detector());
    let start = text.find("\"detector\": {").unwrap();
    let end = start + text[start..].find("\"rounds\"").unwrap();
    let mut n_changed = 0;
    let mut line_start = start;
    for line in text[start..end].split_inclusive('\n') {
        // The first such digit of a number decides its value; the last one may be lost in rounding.
        if let Some(digit) = line.find(|c: char| ('1'..='8').contains(&c)) {
            let mut bytes = text.clone().into_bytes();
            bytes[line_start + digit] += 1;
            assert!(load_text(&String::from_utf8(bytes).unwrap()).is_err(), "{line}");
            n_changed += 1;
        }
        line_start += line.len();
    }
    assert!(20 < n_changed, "{n_changed}");
}

#[test]
fn a_card_states_the_detector_in_words() {
    let text = card(&with_detector());
    // 0.01 rad = 0.573 deg and 5 deg per sqrt(m), see `Detector::starting_values`.
    for line in [
        "| error of the odometry, after d metres | 0.020 m + 0.150 d, 0.57 deg + 5.00 deg sqrt(d) |\n",
        "| error of scan matching, after d metres | 0.0300 m sqrt(d), 0.400 deg sqrt(d) |\n",
        "| error of a closure | at least 0.120 m and 2.00 deg; covariance of the alignment times 1.00 |\n",
        "| tolerance for the choice of consistent closures | standard deviation 0.120 m and 2.00 deg |\n",
        "| places compared with each place | 5 |\n",
        "| evidence that no wrong candidate has | known overlap 0.500 or more, conflict 0.200 or less |\n",
        "| confidence | logistic function of -2.50 + 10.00 overlap - 4.25 conflict + 0.75 classifier |\n",
        "| confidence without the classifier | logistic function of -2.50 + 10.00 overlap |\n",
        "| log loss of the confidence | 0.0625; without the classifier 0.1250; of the share",
        "| candidates with a confidence of the classifier | 254 |\n",
        "| monday | 120 | 7 |\n",
        "**Not fitted**: the error of the odometry, the evidence that no wrong candidate has.",
        "\n## Limits\n",
    ] {
        assert!(text.contains(line), "{line} is not in\n{text}");
    }
    let starting = Model { detector: Some(Detector::starting_values()), ..with_detector() };
    assert!(card(&starting).contains("They were not fitted to any log."));
}

#[test]
fn the_confidence_depends_on_whether_the_classifier_was_used() {
    let mut detector = Detector::starting_values();
    detector.verifier.classifier = 2.0;
    let evidence = Evidence {
        overlap: 0.25,
        known_overlap: 0.5,
        n_known: 100,
        conflict: 0.125,
        margin: 0.0,
        weakness: 1.0,
        classifier: None,
    };
    // -2.5 + 10 x 0.25 = 0, whose logistic function is 1/2.
    assert!((detector.confidence(&evidence) - 0.5).abs() < 1e-15);
    // 0 + 2 x 0.5 = 1: 1 / (1 + exp(-1)) = 0.7310585786.
    let with = Evidence { classifier: Some(0.5), ..evidence };
    assert!((detector.confidence(&with) - 0.731_058_578_6).abs() < 1e-9);
    assert!(detector.strong.accept(&evidence));
    assert!(!detector.strong.accept(&Evidence { known_overlap: 0.499, ..evidence }));
    assert!(!detector.strong.accept(&Evidence { conflict: 0.201, ..evidence }));
}
