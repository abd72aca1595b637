//! The model card: what a user must know about a model, in Markdown.

use std::fmt::{self, Write};

use crate::detector_card::write_detector;
use crate::{Measured, Model, OperatingPoint, Training};

/// The card of a model (after Mitchell et al. 2019, "Model cards for model reporting").
pub fn card(model: &Model) -> String {
    let mut card = String::new();
    // Writing to a string does not fail.
    let _ = write_card(&mut card, model);
    card
}

fn write_card(card: &mut String, model: &Model) -> fmt::Result {
    write_description(card, model)?;
    write_warnings(card, &model.training)?;
    write_results(card, &model.measured, &model.training)?;
    write_operating_points(card, &model.operating_points)?;
    if let Some(detector) = &model.detector {
        write_detector(card, detector)?;
    }
    write_limits(card)?;
    write_inputs(card, &model.training)
}

fn write_description(card: &mut String, model: &Model) -> fmt::Result {
    let Model { scans, features, training, .. } = model;
    writeln!(card, "# {} {}\n", model.name, model.version)?;
    writeln!(
        card,
        "Decides whether two planar scans show the same place, from the absolute differences of their features.\n"
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
        if scans.is_ring {
            "closed rings (full revolutions)"
        } else {
            "open scans (partial revolutions)"
        },
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
    writeln!(card, "| program | loopboost {} |\n", model.program_version)
}

fn write_warnings(card: &mut String, training: &Training) -> fmt::Result {
    writeln!(card, "## Warnings\n")?;
    if training.warnings.is_empty() {
        return writeln!(card, "The training data have no warnings.\n");
    }
    writeln!(
        card,
        "The training data need attention. docs/messages.md explains each code.\n\n\
         | code | count |\n|---|---|"
    )?;
    for (code, n) in &training.warnings {
        writeln!(card, "| `{code}` | {n} |")?;
    }
    writeln!(card)
}

fn write_results(card: &mut String, measured: &[Measured], training: &Training) -> fmt::Result {
    writeln!(card, "## Results\n")?;
    writeln!(
        card,
        "Cross-validated at threshold 0: each pair is scored by a classifier that was not trained on it. \
         The ranges are 95 % Wilson score intervals over pairs. \
         Pairs that share a scan or a place are not independent: the true uncertainty is larger.\n"
    )?;
    writeln!(
        card,
        "| grouping | folds | rounds | error | precision | recall |\n|---|---|---|---|---|---|"
    )?;
    let n_pairs = training.n_positive + training.n_negative;
    let is_validated_on_unseen_ground = measured.iter().any(|row| row.grouping == "place");
    for row in measured {
        writeln!(
            card,
            "| {} | {} | {} | {} | {} | {} |",
            row.grouping,
            row.folds,
            row.rounds,
            with_interval(row.error, n_pairs as f64),
            precision(row, training),
            with_interval(row.recall, training.n_positive as f64)
        )?;
    }
    if !is_validated_on_unseen_ground {
        writeln!(
            card,
            "\n**Not validated on unseen ground**: there is no result for the grouping `place`. \
             The errors are expected to be larger at other places."
        )?;
    }
    Ok(())
}

/// The precision with its interval over the pairs classified as positive.
fn precision(row: &Measured, training: &Training) -> String {
    let Some(precision) = row.precision else {
        return "no pair classified as positive".to_owned();
    };
    // precision = n_true_positive / n_called_positive
    let n_true_positive = row.recall * training.n_positive as f64;
    let n_called_positive = if precision > 0.0 { n_true_positive / precision } else { 0.0 };
    with_interval(precision, n_called_positive)
}

fn write_operating_points(card: &mut String, points: &[OperatingPoint]) -> fmt::Result {
    writeln!(card, "\n## Operating points\n")?;
    writeln!(
        card,
        "A pair is classified as positive if its confidence is at least the threshold. The default threshold is 0.\n"
    )?;
    writeln!(
        card,
        "| point | grouping | threshold | precision | recall | false alarm |\n|---|---|---|---|---|---|"
    )?;
    for point in points {
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
    Ok(())
}

fn write_limits(card: &mut String) -> fmt::Result {
    writeln!(card, "\n## Limits\n")?;
    writeln!(
        card,
        "- The model is for scans as described above. Other scans give an error.\n\
         - The results are for equal numbers of both classes, at the places of the training data. \
         Along a drive, nearly all pairs are negative, and other places look different. \
         Measure the model there before you rely on it.\n\
         - Pairs farther apart than the positive radius and closer than the negative distance are neither in the training data nor in the results.\n"
    )
}

fn write_inputs(card: &mut String, training: &Training) -> fmt::Result {
    writeln!(card, "## Training data\n")?;
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

/// The 95 % score interval of a share observed in n trials (Wilson 1927, "Probable inference, the
/// law of succession, and statistical inference").
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

    /// 10 of 100: z^2 = 3.8415, denominator 1.038415, centre 0.119207 / 1.038415 = 0.114797, half
    /// width 1.959964 / 1.038415 x sqrt(0.0009 + 0.000096036) = 0.059567.
    #[test]
    fn wilson_intervals_match_values_computed_by_hand() {
        let (low, high) = wilson_interval(0.1, 100.0);
        assert!((low - 0.05523).abs() < 1e-4 && (high - 0.17437).abs() < 1e-4, "{low} {high}");
        let (low, high) = wilson_interval(0.0, 20.0);
        assert!(low.abs() < 1e-12 && (high - 0.16113).abs() < 1e-4);
        assert_eq!(wilson_interval(0.5, 0.0), (0.0, 1.0));
    }
}
