//! Scores two pairs of scans with a saved model, as a program on a robot would.
//!
//! `cargo run -p model --example two_scans -- MODEL.json`
//!
//! This example needs neither Arrow nor Parquet nor MCAP. A robot fills `Scan` from its own driver:
//! the returns of one revolution in firing order, x forward and y to the left, and the angle that
//! the revolution covers.

#![allow(clippy::print_stdout, reason = "an example prints its results")]

use std::error::Error;
use std::path::Path;

use dataset::{Label, Scan};
use featurize::{FeatureSet, Featurizer, Options, difference};
use model::{FeatureSpec, Model};

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).ok_or("usage: two_scans MODEL.json")?;
    let model = model::load(Path::new(&path))?;
    let mut featurizer = featurizer(&model.features)?;

    // Two scans of a corridor from places a metre apart, and a scan of a wide hall.
    let here = features(&mut featurizer, &model, &room(20.0, 1.2, 0.0))?;
    let ahead = features(&mut featurizer, &model, &room(20.0, 1.2, 1.0))?;
    let hall = features(&mut featurizer, &model, &room(15.0, 12.0, 0.0))?;

    // Scoring a pair allocates no memory.
    let mut f = vec![0.0; here.len()];
    for (name, reference) in [("a metre ahead", &ahead), ("a wide hall", &hall)] {
        difference(&here, reference, &mut f);
        let confidence = model.classifier.confidence(&f);
        let verdict = match Label::from_confidence(confidence, 0.0) {
            Label::Positive => "same place",
            Label::Negative => "another place",
        };
        println!("{name}: confidence {confidence:.3}, {verdict}");
    }
    Ok(())
}

/// The featurizer for the feature set that the model was trained with.
fn featurizer(spec: &FeatureSpec) -> Result<Featurizer, String> {
    let is_same = |set: &FeatureSet| {
        (set.name(), set.version()) == (&*spec.set, spec.version)
            && set.feature_names() == spec.names
    };
    let set = FeatureSet::ALL.into_iter().find(is_same).ok_or_else(|| {
        let known = FeatureSet::ALL.map(|set| format!("`{}` v{}", set.name(), set.version()));
        let known = known.join(" or ");
        format!("the model needs features `{}` v{}, expected {known}", spec.set, spec.version)
    })?;
    Ok(Featurizer::new(&Options { set, gate_m: spec.gate_m }))
}

/// The features of a scan, if the model was trained on such scans.
fn features(
    featurizer: &mut Featurizer,
    model: &Model,
    scan: &Scan,
) -> Result<Vec<f64>, Box<dyn Error>> {
    model.scans.check(scan.coverage_deg, scan.is_ring())?;
    let mut features = vec![0.0; model.features.names.len()];
    featurizer.features(scan, &mut features)?;
    Ok(features)
}

/// A revolution of 2170 firings in a room of half length `a` and half width `b` \[m\]. The sensor is
/// at `x` on the long axis of the room.
fn room(a: f64, b: f64, x: f64) -> Scan {
    let mut scan = Scan { coverage_deg: 359.83, ..Scan::default() };
    for k in 0..2170 {
        let (sin, cos) = (f64::from(k) * std::f64::consts::TAU / 2170.0).sin_cos();
        let to_end = if cos > 0.0 { (a - x) / cos } else { (-a - x) / cos };
        let to_side = (b / sin).abs();
        let range = to_end.min(to_side);
        scan.x_m.push((range * cos) as f32);
        scan.y_m.push((-range * sin) as f32);
    }
    scan
}
