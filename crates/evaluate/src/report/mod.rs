//! `report.html`: one file that opens offline, without script.

mod beyond;
mod features;
mod measures;
mod origins;
mod scans;

use dataset::tables::Provenance;
use maud::{DOCTYPE, Markup, PreEscaped, html};

use crate::figures::{Figure, STYLE};
use crate::sketches::Sketches;
use crate::{Evaluation, Input};

/// A line of the report's last section: where the numbers come from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fact {
    /// What it is.
    pub name: String,
    /// Its value.
    pub value: String,
}

/// The error that the paper reports for AdaBoost on its own campus is below this.
pub(crate) const PAPER_ERROR_BELOW: f64 = 0.05;
/// Its rounds.
pub(crate) const PAPER_ROUNDS: u32 = 50;

/// The report as HTML; its provenance stands in `meta` elements, under the keys that tables have.
pub fn report(
    name: &str,
    input: &Input<'_>,
    evaluation: &Evaluation,
    (sketches, figures): (&Sketches, &[Figure]),
    facts: &[Fact],
    provenance: &Provenance,
) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                @for (key, value) in provenance.entries("report") {
                    meta name=(key) content=(value);
                }
                title { "loopboost: " (name) }
                style { (PreEscaped(STYLE)) (PreEscaped(include_str!("report.css"))) }
            }
            body {
                header {
                    p class="brand" { "loopboost report" }
                    h1 { (name) }
                    (measures::headline(input, evaluation))
                }
                main {
                    (measures::measures(input, evaluation, figures))
                    (beyond::every_pair(input, figures))
                    (beyond::grid(input, figures))
                    (features::features(input, evaluation, figures))
                    (scans::scan_pairs(input, sketches, figures))
                    (scans::maps(input, figures))
                    (origins::origins(input, facts))
                }
                footer {}
            }
        }
    };
    page.into_string()
}

/// A figure by its id, with a caption; nothing where it was not drawn.
fn figure(figures: &[Figure], id: &str, caption: &Markup) -> Markup {
    html! {
        @if let Some(found) = figures.iter().find(|figure| figure.id == id) {
            figure { (found.inline()) figcaption { (caption) } }
        }
    }
}

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

/// What a learner is called in words.
pub(crate) fn name_of(learner: &str) -> String {
    match learner {
        "discrete" => "Discrete AdaBoost",
        "gentle_line" => "Gentle, lines",
        "gentle_stump" => "Gentle, stumps",
        "logit_trees" => "Logit, trees",
        "knn" => "k-NN (k = 5)",
        "svm" => "linear SVM",
        other => other,
    }
    .to_owned()
}

/// What a grouping keeps on one side of a fold.
fn meaning_of(grouping: &str) -> &'static str {
    match grouping {
        "pair" => "pairs dealt at random, the paper\u{2019}s protocol",
        "scan" => "no scan on both sides",
        "place" => "no block of ground on both sides",
        "log" => "no log on both sides",
        _ => "",
    }
}

pub(crate) fn percent(share: f64) -> String {
    format!("{:.1}\u{a0}%", share * 100.0)
}

fn optional(share: Option<f64>) -> String {
    share.map_or_else(|| "none".to_owned(), percent)
}

/// 1,234,567 is easier to read than 1234567.
fn thousands(n: u64) -> String {
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
    fn numbers_are_readable() {
        assert_eq!([0, 999, 1000, 1_234_567].map(thousands), ["0", "999", "1,000", "1,234,567"]);
        assert_eq!(percent(0.158_04), "15.8\u{a0}%");
    }
}
