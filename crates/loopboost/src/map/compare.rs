//! `map compare`: what changed between two run folders.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::Args;
use dataset::tables::{Provenance, write_file};
use evaluate::comparison::{Comparison, PlaceRule, Tolerances, compare};
use serde_json::json;

use super::mapped::{MappedFolder, origins};
use super::table;
use crate::config::usage;
use crate::findings::Findings;

#[derive(Args)]
pub(crate) struct CompareArgs {
    /// The first run folder, such as yesterday's, or that of the released version
    a: PathBuf,
    /// The second run folder
    b: PathBuf,
    /// Print the result as JSON (`loopboost schema comparison` describes it)
    #[arg(long)]
    json: bool,
    /// Write a report with a map of the differences
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Largest tolerated shift of a scan after alignment, and of a closure, in m
    #[arg(long, value_name = "METRES", default_value_t = Tolerances::default().max_shift_m)]
    max_shift_m: f64,
    /// Largest tolerated turn of a scan after alignment, and of a closure, in deg
    #[arg(long, value_name = "DEGREES", default_value_t = Tolerances::default().max_turn_deg)]
    max_turn_deg: f64,
    /// Largest tolerated number of closures that only A accepts
    #[arg(long, value_name = "N", default_value_t = Tolerances::default().max_lost)]
    max_lost: usize,
    /// Largest tolerated number of closures that only B accepts
    #[arg(long, value_name = "N", default_value_t = Tolerances::default().max_gained)]
    max_gained: usize,
    /// Largest tolerated number of pairs with another label, and of pairs at the same place in one run only
    #[arg(long, value_name = "N", default_value_t = Tolerances::default().max_flips)]
    max_flips: usize,
    /// Logs that only B has are not a change
    #[arg(long)]
    allow_new_logs: bool,
    /// Two keyframes at most this far apart are at the same place, in m
    #[arg(long, value_name = "METRES", default_value_t = label::Options::default().positive_radius_m)]
    positive_radius_m: f64,
    /// Largest difference between the headings of two keyframes at the same place, in deg
    #[arg(long, value_name = "DEGREES", default_value_t = label::Options::default().positive_heading_deg)]
    positive_heading_deg: f64,
}

impl CompareArgs {
    pub(crate) fn execute(&self) -> Result<Findings> {
        let tolerances = Tolerances {
            max_shift_m: self.max_shift_m,
            max_turn_deg: self.max_turn_deg,
            max_lost: self.max_lost,
            max_gained: self.max_gained,
            max_flips: self.max_flips,
            allow_new_logs: self.allow_new_logs,
        };
        let rule = PlaceRule {
            positive_radius_m: self.positive_radius_m,
            positive_heading_deg: self.positive_heading_deg,
        };
        tolerances.check().and_then(|()| rule.check()).map_err(usage)?;
        if let Some(file) = &self.report {
            check_is_html(file)?;
        }
        let (a, b) = (MappedFolder::load(&self.a)?, MappedFolder::load(&self.b)?);
        let runs = [(a.name(), a.run()), (b.name(), b.run())];
        let comparison = compare(runs, origins(&a, &b), tolerances, rule);
        if let Some(file) = &self.report {
            write_report(file, &comparison, [&a, &b])?;
            eprintln!("wrote {}", file.display());
        }
        match self.json {
            true => out!("{}", serde_json::to_string_pretty(&comparison)?),
            false => table::print(&comparison),
        }
        Ok(Findings { notes: comparison.notes(), ..Findings::default() })
    }
}

fn check_is_html(file: &Path) -> Result<()> {
    match file.extension().is_some_and(|extension| extension == "html") {
        true => Ok(()),
        false => Err(usage(format!(
            "--report is {}, expected a file name that ends in .html",
            file.display()
        ))),
    }
}

fn write_report(file: &Path, comparison: &Comparison, [a, b]: [&MappedFolder; 2]) -> Result<()> {
    let provenance = Provenance {
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
        seed: Some(comparison.a.seed),
        options: json!({ "tolerances": comparison.tolerances, "place_rule": comparison.place_rule }),
        inputs: a.digests("a").chain(b.digests("b")).collect(),
        notes: comparison.notes(),
        ..Provenance::default()
    };
    let html = evaluate::comparison_report(comparison, [a.run(), b.run()], &provenance);
    Ok(write_file(file, html.as_bytes())?)
}
