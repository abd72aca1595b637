//! Two scans in, confidence out: what runs on a robot.
//!
//! `cargo run -p model --example two_scans -- MODEL.json`
//!
//! Nothing here needs Arrow, Parquet or MCAP. A real robot fills `Scan` from its own driver: the
//! returns of one turn in firing order, x forward and y left, and the angle that was swept.

use std::error::Error;
use std::path::Path;

use dataset::{Label, Scan};
use featurize::{FeatureSet, Paper16, difference};

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).ok_or("usage: two_scans MODEL.json")?;
    let model = model::load(Path::new(&path))?;

    // The model says which features it wants; another set or version does not fit.
    let set = FeatureSet::Paper16;
    if (model.features.set.as_str(), model.features.version) != (set.name(), set.version()) {
        return Err(
            format!("the model wants {} v{}", model.features.set, model.features.version).into()
        );
    }
    let mut features = Paper16::new(model.features.gate_m);

    // Two scans of a corridor from places a metre apart, and one of a wide hall.
    let here = room(20.0, 1.2, 0.0);
    let ahead = room(20.0, 1.2, 1.0);
    let hall = room(15.0, 12.0, 0.0);
    for scan in [&here, &ahead, &hall] {
        model.scans.check(scan.coverage_deg, scan.is_ring())?;
    }
    let here = features.features(&here)?;
    let ahead = features.features(&ahead)?;
    let hall = features.features(&hall)?;

    // Scoring a pair allocates nothing: candidates can be scored by the million.
    let mut f = [0.0; 16];
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

/// A turn of 2170 firings in a room of half length `a` and half width `b` \[m\], seen from `x` on
/// its long axis.
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
