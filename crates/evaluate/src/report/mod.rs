//! `report.html`: one file that opens offline and needs no script.

mod cross_validation;
mod data;
mod features;
mod headline;
mod label_grid;
mod messages;
mod retrieval;
mod scans;
mod spread;

use dataset::tables::Provenance;
use maud::{DOCTYPE, Markup, PreEscaped, html};

use crate::figures::{Figure, STYLE, Sketches};
use crate::{Evaluation, Input};

/// A row of the table of inputs and options at the end of the report.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fact {
    /// Name of the input or option.
    pub name: String,
    /// Its digest or value.
    pub value: String,
}

/// The report as HTML. Its provenance is in `meta` elements, with the same keys as in tables.
pub fn report(
    name: &str,
    input: &Input<'_>,
    evaluation: &Evaluation,
    (sketches, figures): (&Sketches, &[Figure]),
    (digests, options): (&[Fact], &[Fact]),
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
                    (headline::headline(input, evaluation))
                }
                main {
                    (spread::section(input, evaluation))
                    (cross_validation::section(input, evaluation, figures))
                    (retrieval::section(input, figures))
                    (label_grid::section(input, figures))
                    (features::section(input, evaluation, figures))
                    (scans::pairs_section(input, sketches, figures))
                    (scans::maps_section(input, figures))
                    (data::section(input, digests, options))
                }
                footer {}
            }
        }
    };
    page.into_string()
}

/// The figure with this id and its caption. Nothing if the figure was not drawn.
fn figure(figures: &[Figure], id: &str, caption: &Markup) -> Markup {
    html! {
        @if let Some(found) = figures.iter().find(|figure| figure.id == id) {
            figure { (found.inline()) figcaption { (caption) } }
        }
    }
}
