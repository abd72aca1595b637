//! The section of the model card about loop detection.

use std::fmt::{self, Write};

use crate::{Detector, DetectorPart, Verifier};

/// What the detector has learned, in words and numbers.
pub(crate) fn write_detector(card: &mut String, detector: &Detector) -> fmt::Result {
    writeln!(card, "\n## Loop detection\n")?;
    writeln!(
        card,
        "`loopboost detect` uses these numbers. docs/detection.md explains each of them.\n"
    )?;
    write_noise(card, detector)?;
    write_decisions(card, detector)?;
    write_origin(card, detector)
}

fn write_noise(card: &mut String, detector: &Detector) -> fmt::Result {
    let Detector { odometry, drift, closure, .. } = detector;
    writeln!(card, "| | |\n|---|---|")?;
    writeln!(
        card,
        "| error of the odometry, after d metres | {:.3} m + {:.3} d, {:.2} deg + {:.2} deg sqrt(d) |",
        odometry.std_m,
        odometry.std_m_per_m,
        odometry.std_rad.to_degrees(),
        odometry.std_rad_per_sqrt_m.to_degrees()
    )?;
    writeln!(
        card,
        "| error of scan matching, after d metres | {:.4} m sqrt(d), {:.3} deg sqrt(d) |",
        drift.std_m_per_sqrt_m,
        drift.std_rad_per_sqrt_m.to_degrees()
    )?;
    writeln!(
        card,
        "| error of a closure | at least {:.3} m and {:.2} deg; covariance of the alignment times {:.2} |",
        closure.std_m,
        closure.std_rad.to_degrees(),
        closure.covariance_factor
    )?;
    writeln!(
        card,
        "| tolerance for the choice of consistent closures | standard deviation {:.3} m and {:.2} deg |",
        closure.consistency_std_m,
        closure.consistency_std_rad.to_degrees()
    )
}

fn write_decisions(card: &mut String, detector: &Detector) -> fmt::Result {
    writeln!(card, "| places compared with each place | {} |", detector.n_candidates)?;
    writeln!(card, "| smallest confidence of a candidate | {:.3} |", detector.min_confidence)?;
    writeln!(
        card,
        "| evidence that no wrong candidate has | known overlap {:.3} or more, conflict {:.3} or less |",
        detector.strong.known_overlap, detector.strong.conflict
    )?;
    writeln!(card, "| confidence | logistic function of {} |", formula(&detector.verifier))?;
    writeln!(
        card,
        "| confidence without the classifier | logistic function of {} |",
        formula(&detector.verifier_without_classifier)
    )
}

/// The sum of a verifier, without terms of weight 0.
fn formula(verifier: &Verifier) -> String {
    let terms = [
        ("overlap", verifier.overlap),
        ("known overlap", verifier.known_overlap),
        ("conflict", verifier.conflict),
        ("margin", verifier.margin),
        ("classifier", verifier.classifier),
    ];
    let mut sum = format!("{:.2}", verifier.intercept);
    for (name, weight) in terms.into_iter().filter(|(_, weight)| 0.0 < weight.abs()) {
        let sign = if weight < 0.0 { '-' } else { '+' };
        sum.push_str(&format!(" {sign} {:.2} {name}", weight.abs()));
    }
    sum
}

fn write_origin(card: &mut String, detector: &Detector) -> fmt::Result {
    if let Some(measured) = &detector.measured {
        writeln!(
            card,
            "| log loss of the confidence | {:.4}; without the classifier {:.4}; of the share of right candidates {:.4} |",
            measured.log_loss, measured.log_loss_without_classifier, measured.log_loss_of_share
        )?;
        writeln!(
            card,
            "| candidates with a confidence of the classifier | {} |",
            measured.n_with_classifier
        )?;
    }
    if detector.logs.is_empty() {
        writeln!(card, "\nThese are starting values. They were not fitted to any log.")?;
    } else {
        writeln!(
            card,
            "\n| fitted to the log | right candidates | wrong candidates |\n|---|---|---|"
        )?;
        for log in &detector.logs {
            writeln!(card, "| {} | {} | {} |", log.log, log.n_right, log.n_wrong)?;
        }
    }
    if !detector.not_fitted.is_empty() {
        let names: Vec<&str> = detector.not_fitted.iter().map(|part| in_words(*part)).collect();
        writeln!(
            card,
            "\n**Not fitted**: {}. The logs do not contain enough for a fit, so these are starting values.",
            names.join(", ")
        )?;
    }
    Ok(())
}

fn in_words(part: DetectorPart) -> &'static str {
    match part {
        DetectorPart::Odometry => "the error of the odometry",
        DetectorPart::Drift => "the error of scan matching",
        DetectorPart::Closure => "the error of a closure",
        DetectorPart::Verifier => "the confidence and its smallest value",
        DetectorPart::Strong => "the evidence that no wrong candidate has",
        DetectorPart::NCandidates => "the number of compared places",
    }
}
