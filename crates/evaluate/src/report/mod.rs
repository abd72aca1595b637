//! `report.html`: one file that opens offline and needs no script.

mod closures;
mod comparison;
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
use dataset::{Keyframe, Losses, Note};
use maud::{DOCTYPE, Markup, PreEscaped, html};

use crate::comparison::{Comparison, MappedRun};
use crate::detection::{Drive, DriveMeasures, SiteMeasures};
use crate::figures::{ClosureSketches, Figure, STYLE, Sketches, compared_maps};
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
    let notes = input.not_evaluated.iter().chain(input.notes);
    let header = headline::headline(input, evaluation);
    let main = html! {
        (closures::section(input.detection, &evaluation.detection, &evaluation.sites, &sketches.closures, figures))
        (spread::section(input, evaluation))
        (cross_validation::section(input, evaluation, figures))
        (retrieval::section(input, figures))
        (label_grid::section(input, figures))
        (features::section(input, evaluation, figures))
        (scans::pairs_section(input, sketches, figures))
        (scans::maps_section(input, figures))
        (data::section(input.keyframes, input.losses, notes, (digests, options)))
    };
    page(name, &header, &main, provenance)
}

/// What [`closure_report`] shows.
#[derive(Debug, Clone, Copy)]
pub struct ClosureReport<'a> {
    /// The keyframes of all logs.
    pub keyframes: &'a [Keyframe],
    /// The drives.
    pub drives: &'a [Drive<'a>],
    /// The measures of each drive.
    pub measures: &'a [DriveMeasures],
    /// The measures of each site with several drives.
    pub sites: &'a [SiteMeasures],
    /// What the figures show of the scans.
    pub sketches: &'a ClosureSketches,
    /// The figures of [`crate::closure_figures`].
    pub figures: &'a [Figure],
    /// What the stages of the run left out.
    pub losses: &'a Losses,
    /// The notes of the stages of the run.
    pub notes: &'a [Note],
}

/// The report of the loop closures of new logs as HTML: the section about closures of [`report`], warnings,
/// and the data.
pub fn closure_report(
    name: &str,
    of: &ClosureReport<'_>,
    (digests, options): (&[Fact], &[Fact]),
    provenance: &Provenance,
) -> String {
    let header = messages::warnings(of.losses, of.notes.iter());
    let main = html! {
        (closures::section(of.drives, of.measures, of.sites, of.sketches, of.figures))
        (data::section(of.keyframes, of.losses, of.notes.iter(), (digests, options)))
    };
    page(name, &header, &main, provenance)
}

/// The differences of two runs as HTML, with their maps laid over each other. `runs` are those that were
/// compared.
pub fn comparison_report(
    comparison: &Comparison,
    runs: [MappedRun<'_>; 2],
    provenance: &Provenance,
) -> String {
    let figures = compared_maps(comparison, runs);
    let (header, main) =
        (comparison::answer(comparison), comparison::section(comparison, &figures));
    page("Comparison of two maps", &header, &main, provenance)
}

/// A page with its style sheet.
fn page(name: &str, header: &Markup, main: &Markup, provenance: &Provenance) -> String {
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
                    (header)
                }
                main { (main) }
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
