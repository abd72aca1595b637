//! `score`: confidence and label of a model for pairs of scans.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, anyhow};
use dataset::tables::scans::{read_scan_headers, read_scans};
use dataset::tables::{
    PairScore, Provenance, SCAN_PAIR_COLUMNS, digest_file, read_scan_pairs, write_pair_scores,
};
use dataset::{Loss, LossKind, Note, Scan, ScanId, Subject};
use featurize::Featurizer;
use model::{Model, OperatingPoint};
use rayon::prelude::*;
use serde_json::json;

use crate::config::usage;
use crate::findings::Findings;
use crate::models::file_of;
use crate::scorer::other_ranges;
use crate::stage::Artifact;
use crate::used_model::featurize_options;

/// The arguments of `score`.
#[derive(clap::Args)]
pub(crate) struct ScoreArgs {
    /// A model.json, or a folder with one model
    model: PathBuf,
    /// A run folder with the scans; can be repeated
    #[arg(long = "run", value_name = "DIR", required = true)]
    runs: Vec<PathBuf>,
    /// The pairs, as Parquet or CSV: query_log, query_scan, reference_log, reference_scan
    #[arg(long, value_name = "FILE")]
    pairs: PathBuf,
    /// The table to write, a Parquet file; without it, CSV goes to stdout
    #[arg(long, value_name = "FILE.parquet")]
    out: Option<PathBuf>,
    /// An operating point of the model, by name: its threshold decides the label. Of several groupings,
    /// the one with the highest threshold is used
    #[arg(long, value_name = "NAME", conflicts_with = "threshold")]
    point: Option<String>,
    /// A pair with at least this confidence is labelled positive; the default is 0
    #[arg(long, value_name = "CONFIDENCE", allow_negative_numbers = true)]
    threshold: Option<f64>,
}

impl ScoreArgs {
    /// Scores the pairs.
    pub(crate) fn execute(self) -> Result<Findings> {
        let model_file = file_of(&self.model)?;
        let model = model::load(&model_file)?;
        let threshold = self.threshold(&model)?;
        let pairs = read_pairs(&self.pairs)?;
        let mut findings = Findings::default();
        let mut features = HashMap::new();
        let mut inputs = BTreeMap::new();
        for (log, scans) in scans_by_log(&pairs) {
            let table = self.table_of(&log)?;
            inputs.insert(format!("scans/{log}.parquet"), digest_file(&table)?);
            check_ranges(&model, &log, &table, &mut findings)?;
            features_of(&model, &log, &table, &scans, &mut features)?;
        }
        let n_scans = features.len();
        features.retain(|_, features: &mut Option<Vec<f64>>| features.is_some());
        let n_unusable = (n_scans - features.len()) as u64;
        findings.losses.add(Loss::new(LossKind::UnusableScans, Subject::default()), n_unusable);

        let feature = |id: &ScanId| features.get(id).and_then(Option::as_deref);
        let score = |scans: &[ScanId; 2]| {
            let confidence = feature(&scans[0]).zip(feature(&scans[1])).map(|(a, b)| {
                let difference: Vec<f64> = a.iter().zip(b).map(|(a, b)| (a - b).abs()).collect();
                model.classifier.confidence(&difference)
            });
            let label = confidence.map(|confidence| if threshold <= confidence { 1 } else { -1 });
            PairScore { scans: scans.clone(), confidence, label }
        };
        let scores: Vec<PairScore> = pairs.par_iter().map(score).collect();
        match &self.out {
            None => print_csv(&scores),
            Some(out) => {
                for path in [&model_file, &self.pairs] {
                    let name = path.file_name().unwrap_or_default().to_string_lossy();
                    inputs.insert(name.into_owned(), digest_file(path)?);
                }
                let provenance = Provenance {
                    program_version: env!("CARGO_PKG_VERSION").to_owned(),
                    seed: Some(model.seed),
                    options: json!({
                        "model": model.name, "version": model.version, "threshold": threshold
                    }),
                    inputs,
                    losses: findings.losses.clone(),
                    notes: findings.notes.clone(),
                };
                write_pair_scores(out, &provenance, &scores)?;
                let n_positive = scores.iter().filter(|score| score.label == Some(1)).count();
                out!(
                    "{}: {n_positive} of {} pairs with a confidence of {threshold} or more",
                    out.display(),
                    scores.len()
                );
            }
        }
        Ok(findings)
    }

    /// The least confidence of a positive pair.
    fn threshold(&self, model: &Model) -> Result<f64> {
        if let Some(threshold) = self.threshold.filter(|threshold| !threshold.is_finite()) {
            return Err(usage(format!("--threshold is {threshold}, expected a finite number")));
        }
        let Some(name) = &self.point else { return Ok(self.threshold.unwrap_or(0.0)) };
        let points = model.operating_points.iter().filter(|point| point.name == *name);
        points.map(|point| point.threshold).max_by(f64::total_cmp).ok_or_else(|| {
            let known: BTreeSet<String> = model
                .operating_points
                .iter()
                .map(|OperatingPoint { name, .. }| format!("`{name}`"))
                .collect();
            let known: Vec<String> = known.into_iter().collect();
            usage(format!(
                "--point: the model `{}` has no operating point `{name}`, expected {}",
                model.name,
                match known.is_empty() {
                    true => "none: it was not cross-validated; use --threshold".to_owned(),
                    false => known.join(" or "),
                }
            ))
        })
    }

    /// The table with the scans of a log.
    fn table_of(&self, log: &str) -> Result<PathBuf> {
        let name = Artifact::Scans.name(log);
        let found: Vec<PathBuf> =
            self.runs.iter().map(|run| run.join(&name)).filter(|path| path.is_file()).collect();
        let folders = |paths: &mut dyn Iterator<Item = &Path>| {
            paths.map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ")
        };
        match found.as_slice() {
            [table] => Ok(table.clone()),
            [] => Err(anyhow!(
                "no {name} in {}; name the run folder that has the log `{log}` with --run",
                folders(&mut self.runs.iter().map(PathBuf::as_path))
            )),
            several => Err(anyhow!(
                "{} have scans of a log `{log}`, and the pairs do not say which log is meant; score the runs one by one",
                folders(&mut several.iter().map(PathBuf::as_path))
            )),
        }
    }
}

/// Features of scans with other range limits differ.
fn check_ranges(model: &Model, log: &str, table: &Path, findings: &mut Findings) -> Result<()> {
    let (_, made) = read_scan_headers(table)?;
    let limit = |key: &str| made.options["lidar"][key].as_f64();
    let Some((min_m, max_m)) = limit("range_min_m").zip(limit("range_max_m")) else {
        return Ok(());
    };
    let kind = other_ranges(model, min_m, max_m);
    findings.notes.extend(kind.map(|kind| Note::new(kind, Subject::log(log))));
    Ok(())
}

/// The scans of all pairs, by log, ascending.
fn scans_by_log(pairs: &[[ScanId; 2]]) -> BTreeMap<Arc<str>, BTreeSet<u32>> {
    let mut scans: BTreeMap<Arc<str>, BTreeSet<u32>> = BTreeMap::new();
    for id in pairs.iter().flatten() {
        scans.entry(id.log.clone()).or_default().insert(id.scan);
    }
    scans
}

/// Computes the features of scans; `None` for a scan that has none.
fn features_of(
    model: &Model,
    log: &Arc<str>,
    table: &Path,
    scans: &BTreeSet<u32>,
    features: &mut HashMap<ScanId, Option<Vec<f64>>>,
) -> Result<()> {
    let options = featurize_options(model)?;
    let numbers: Vec<u32> = scans.iter().copied().collect();
    let mut ids = numbers.iter().map(|&scan| ScanId { log: log.clone(), scan });
    let n_features = model.features.names.len();
    read_scans(table, &numbers, |batch| {
        let compute = |featurizer: &mut Featurizer, scan: &Scan| {
            let mut features = vec![0.0; n_features];
            featurizer.features(scan, &mut features).ok().map(|()| features)
        };
        let of_batch: Vec<_> =
            batch.par_iter().map_init(|| Featurizer::new(&options), compute).collect();
        for ((scan, found), id) in batch.iter().zip(of_batch).zip(&mut ids) {
            model
                .scans
                .check(scan.coverage_deg, scan.is_ring())
                .with_context(|| format!("scan {} of log `{log}`", id.scan))?;
            features.insert(id, found);
        }
        anyhow::Ok(())
    })
}

/// The pairs in a Parquet or CSV file.
fn read_pairs(path: &Path) -> Result<Vec<[ScanId; 2]>> {
    let is_csv = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("csv"));
    let pairs = match is_csv {
        true => {
            let text = std::fs::read_to_string(path)
                .with_context(|| format!("cannot read {}", path.display()))?;
            parse_csv(&text).with_context(|| path.display().to_string())?
        }
        false => read_scan_pairs(path)?,
    };
    match pairs.is_empty() {
        true => Err(anyhow!("{} has no pairs, expected one row per pair", path.display())),
        false => Ok(pairs),
    }
}

/// Reads pairs from CSV: a header with the names of the columns, then one line per pair. Other columns
/// are ignored.
fn parse_csv(text: &str) -> Result<Vec<[ScanId; 2]>> {
    let mut lines = (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty());
    let (_, header) = lines.next().ok_or_else(|| anyhow!("the file is empty"))?;
    let header = cells(header);
    let column = |name: &str| {
        header.iter().position(|cell| cell == name).ok_or_else(|| {
            anyhow!(
                "no column `{name}` in the first line, expected {}",
                SCAN_PAIR_COLUMNS.join(", ")
            )
        })
    };
    let [query_log, query_scan, reference_log, reference_scan] = SCAN_PAIR_COLUMNS;
    let columns = [
        (column(query_log)?, column(query_scan)?),
        (column(reference_log)?, column(reference_scan)?),
    ];
    let mut pairs = Vec::new();
    for (number, line) in lines {
        let cells = cells(line);
        let id = |(log, scan): (usize, usize)| -> Result<ScanId> {
            let cell = |k: usize| {
                cells.get(k).ok_or_else(|| {
                    let n = cells.len();
                    anyhow!("line {number} has {n} cells, expected {}", header.len())
                })
            };
            let (log, scan) = (cell(log)?, cell(scan)?);
            let scan = scan.parse().map_err(|_| {
                anyhow!("line {number}: `{scan}` is not the number of a scan, expected 0 or more")
            })?;
            Ok(ScanId { log: log.as_str().into(), scan })
        };
        pairs.push([id(columns[0])?, id(columns[1])?]);
    }
    Ok(pairs)
}

/// The cells of a line of CSV. A cell can be in double quotes, and contains a quote as two (RFC 4180).
fn cells(line: &str) -> Vec<String> {
    let mut cells = vec![String::new()];
    let mut is_quoted = false;
    let mut chars = line.trim_start_matches('\u{feff}').chars().peekable();
    while let Some(c) = chars.next() {
        let last = cells.len() - 1;
        match c {
            '"' if is_quoted && chars.peek() == Some(&'"') => {
                chars.next();
                cells[last].push('"');
            }
            '"' => is_quoted = !is_quoted,
            ',' if !is_quoted => cells.push(String::new()),
            c => cells[last].push(c),
        }
    }
    cells.iter().map(|cell| cell.trim().to_owned()).collect()
}

fn print_csv(scores: &[PairScore]) {
    out!("{},confidence,label", SCAN_PAIR_COLUMNS.join(","));
    let quoted = |name: &str| match name.contains([',', '"']) {
        true => format!("\"{}\"", name.replace('"', "\"\"")),
        false => name.to_owned(),
    };
    for PairScore { scans: [query, reference], confidence, label } in scores {
        let confidence = confidence.map(|confidence| confidence.to_string()).unwrap_or_default();
        let label = label.map(|label| label.to_string()).unwrap_or_default();
        out!(
            "{},{},{},{},{confidence},{label}",
            quoted(&query.log),
            query.scan,
            quoted(&reference.log),
            reference.scan
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_are_read_from_csv_with_columns_in_any_order() {
        let text = "\u{feff}label,reference_scan, query_scan,query_log,reference_log\n1,7,3,\"a, \"\"b\"\"\",c\n\n-1,0,4294967295,c,c\r\n";
        let pairs = parse_csv(text).unwrap();
        let id = |log: &str, scan| ScanId { log: log.into(), scan };
        assert_eq!(pairs, [[id("a, \"b\"", 3), id("c", 7)], [id("c", u32::MAX), id("c", 0)]]);
    }

    #[test]
    fn a_wrong_csv_is_an_error_that_names_line_and_column() {
        let header = "query_log,query_scan,reference_log,reference_scan";
        let error = |text: &str| parse_csv(text).unwrap_err().to_string();
        assert!(error("").contains("empty"));
        assert!(error("query_log,scan\na,1\n").contains("no column `query_scan`"));
        let of_scan = error(&format!("{header}\na,1,b,2\na,-1,b,2\n"));
        assert!(of_scan.contains("line 3: `-1`"), "{of_scan}");
        let short = error(&format!("{header}\na,1,b\n"));
        assert!(short.contains("line 2 has 3 cells, expected 4"), "{short}");
    }
}
