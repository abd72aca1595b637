//! The model card: what a reader has to know before using a model, in Markdown.

use std::fmt::Write;

use crate::Model;

/// The card of a model (after Mitchell et al. 2019, "Model cards for model reporting").
pub fn card(model: &Model) -> String {
    let mut card = String::new();
    // Writing into a string does not fail.
    let _ = write_card(&mut card, model);
    card
}

fn write_card(card: &mut String, model: &Model) -> std::fmt::Result {
    let Model { scans, features, training, .. } = model;
    writeln!(card, "# {} {}\n", model.name, model.version)?;
    writeln!(
        card,
        "Tells whether two planar scans show one place, from the absolute differences of their features.\n"
    )?;
    writeln!(card, "| | |\n|---|---|")?;
    writeln!(
        card,
        "| learner | `{}`, {} rounds |",
        model.classifier.learner.name(),
        model.classifier.rounds.len()
    )?;
    writeln!(
        card,
        "| features | `{}` v{}, gate {} m |",
        features.set, features.version, features.gate_m
    )?;
    writeln!(
        card,
        "| scans | {}, {} to {} deg, returns from {} to {} m |",
        if scans.is_ring { "closed rings" } else { "parts of the circle" },
        scans.coverage_min_deg,
        scans.coverage_max_deg,
        scans.range_min_m,
        scans.range_max_m
    )?;
    writeln!(
        card,
        "| trained on | {} positive and {} negative pairs |",
        training.n_positive, training.n_negative
    )?;
    writeln!(card, "| labels | `{}` |", model.label_options)?;
    writeln!(card, "| seed | {} |", model.seed)?;
    writeln!(card, "| program | loopboost {} |\n", model.program_version)?;

    writeln!(card, "## Measured\n")?;
    writeln!(
        card,
        "Cross-validated: each pair is scored by a classifier that did not see it. Intervals are 95 % Wilson score intervals over pairs; pairs share scans and neighbours, so that the true uncertainty is larger.\n"
    )?;
    writeln!(
        card,
        "| grouping | folds | T | error | precision | recall |\n|---|---|---|---|---|---|"
    )?;
    let n = training.n_positive + training.n_negative;
    for measured in &model.measured {
        let called = measured.precision.map(|precision| {
            // Of tp positives called so, precision = tp / called.
            let true_positive = measured.recall * training.n_positive as f64;
            if precision > 0.0 { true_positive / precision } else { 0.0 }
        });
        writeln!(
            card,
            "| {} | {} | {} | {} | {} | {} |",
            measured.grouping,
            measured.folds,
            measured.rounds,
            with_interval(measured.error, n as f64),
            match (measured.precision, called) {
                (Some(precision), Some(called)) => with_interval(precision, called),
                _ => "none called positive".to_owned(),
            },
            with_interval(measured.recall, training.n_positive as f64)
        )?;
    }

    writeln!(card, "\n## Operating points\n")?;
    writeln!(
        card,
        "A pair is called positive where its confidence is not less than the threshold; 0 unless chosen.\n"
    )?;
    writeln!(
        card,
        "| point | grouping | threshold | precision | recall | false alarm |\n|---|---|---|---|---|---|"
    )?;
    for point in &model.operating_points {
        writeln!(
            card,
            "| {} | {} | {:.4} | {} | {} | {} |",
            point.name,
            point.grouping,
            point.threshold,
            percent(point.precision),
            percent(point.recall),
            percent(point.false_alarm)
        )?;
    }

    writeln!(card, "\n## Limits\n")?;
    writeln!(
        card,
        "- Made for scans as described above; scans of another kind are refused.\n\
         - Measured on balanced pairs of the places it was trained on. Along a drive nearly all pairs are negatives, and another place may look otherwise: measure there before relying on it.\n\
         - What lies between the positive radius and the negative distance was left out of training and of these figures.\n"
    )?;
    writeln!(card, "## Trained on\n")?;
    writeln!(card, "| input | BLAKE3 |\n|---|---|")?;
    for (name, digest) in &training.digests {
        writeln!(card, "| {name} | `{digest}` |")?;
    }
    Ok(())
}

fn percent(share: f64) -> String {
    format!("{:.1} %", share * 100.0)
}

fn with_interval(share: f64, n: f64) -> String {
    let (low, high) = wilson_interval(share, n);
    format!("{:.1} % ({:.1} to {:.1})", share * 100.0, low * 100.0, high * 100.0)
}

/// The 95 % score interval of a share seen in n trials (Wilson 1927, "Probable inference, the law
/// of succession, and statistical inference").
fn wilson_interval(share: f64, n: f64) -> (f64, f64) {
    /// 97.5 % quantile of the normal distribution.
    const Z: f64 = 1.959_963_984_540_054;
    if n <= 0.0 {
        return (0.0, 1.0);
    }
    let denominator = 1.0 + Z * Z / n;
    let centre = (share + Z * Z / (2.0 * n)) / denominator;
    let half = Z / denominator * (share * (1.0 - share) / n + Z * Z / (4.0 * n * n)).sqrt();
    ((centre - half).max(0.0), (centre + half).min(1.0))
}

#[cfg(test)]
mod tests {
    use super::wilson_interval;

    /// 10 of 100, by hand: z^2 = 3.8415, denominator 1.038415, centre 0.119207 / 1.038415 =
    /// 0.114797, half 1.959964 / 1.038415 x sqrt(0.0009 + 0.000096036) = 0.059567.
    #[test]
    fn an_interval_by_hand() {
        let (low, high) = wilson_interval(0.1, 100.0);
        assert!((low - 0.05523).abs() < 1e-4 && (high - 0.17437).abs() < 1e-4, "{low} {high}");
        let (low, high) = wilson_interval(0.0, 20.0);
        assert!(low.abs() < 1e-12 && (high - 0.16113).abs() < 1e-4);
        assert_eq!(wilson_interval(0.5, 0.0), (0.0, 1.0));
    }
}
