//! How learners, groupings and numbers are written in the report and its figures.

/// The error that the paper reports for AdaBoost on its own campus data is below this value.
pub(crate) const PAPER_ERROR_BELOW: f64 = 0.05;
/// Number of boosting rounds of the paper's AdaBoost.
pub(crate) const PAPER_ROUNDS: u32 = 50;

/// A dash where a value does not exist.
pub(crate) const NO_VALUE: &str = "\u{2013}";

/// The distinct values, in order of first appearance.
pub(crate) fn distinct<'a>(values: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    let mut distinct: Vec<&str> = Vec::new();
    for value in values {
        if !distinct.contains(&value) {
            distinct.push(value);
        }
    }
    distinct
}

/// The display name of a learner.
pub(crate) fn learner_name(learner: &str) -> String {
    match learner {
        "discrete" => "Discrete AdaBoost",
        "gentle_line" => "Gentle AdaBoost (lines)",
        "gentle_stump" => "Gentle AdaBoost (stumps)",
        "logit_trees" => "LogitBoost (trees)",
        "knn" => "k-NN (k\u{a0}=\u{a0}5)",
        "svm" => "linear SVM",
        other => other,
    }
    .to_owned()
}

/// A shorter name of a learner, for legends.
pub(crate) fn short_learner_name(learner: &str) -> String {
    learner_name(learner).replace("Gentle AdaBoost", "Gentle")
}

/// What the folds of a grouping consist of.
pub(crate) fn grouping_unit(grouping: &str) -> &'static str {
    match grouping {
        "pair" => "pairs",
        "scan" => "scans",
        "place" => "blocks of ground",
        "log" => "logs",
        _ => "groups",
    }
}

/// How a grouping separates test pairs from training pairs.
pub(crate) fn grouping_meaning(grouping: &str) -> &'static str {
    match grouping {
        "pair" => "tested on pairs not seen in training",
        "scan" => "tested on scans not seen in training",
        "place" => "tested on ground not seen in training",
        "log" => "tested on logs not seen in training",
        _ => "",
    }
}

/// A share of one as a percentage with one decimal.
pub(crate) fn percent(share: f64) -> String {
    format!("{:.1}\u{a0}%", share * 100.0)
}

/// A percentage, or a dash.
pub(crate) fn optional_percent(share: Option<f64>) -> String {
    share.map_or_else(|| NO_VALUE.to_owned(), percent)
}

/// A number with commas between thousands.
pub(crate) fn thousands(n: u64) -> String {
    let digits = n.to_string();
    let mut text = String::new();
    for (k, digit) in digits.chars().enumerate() {
        if k > 0 && (digits.len() - k).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thousands_are_separated_by_commas() {
        assert_eq!([0, 999, 1000, 1_234_567].map(thousands), ["0", "999", "1,000", "1,234,567"]);
    }

    #[test]
    fn percentages_have_one_decimal() {
        assert_eq!(percent(0.158_04), "15.8\u{a0}%");
        assert_eq!(optional_percent(None), "\u{2013}");
    }
}
