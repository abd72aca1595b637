//! The options that each task depends on, as JSON: they travel with what the task makes, and tell
//! whether it has to be made again.

use std::collections::BTreeMap;

use anyhow::{Result, anyhow};
use serde_json::{Value, json};

use crate::config::{Config, LogOptions};

/// Options of a stage; of one log, for the stages that work log by log. `logs` are the run's.
pub(crate) fn options_of(
    config: &Config,
    stage: &str,
    log: Option<&str>,
    logs: &[&str],
) -> Result<Value> {
    let value = match (stage, log) {
        ("simulate", _) => serde_json::to_value(&config.simulate)?,
        // The site is a matter of `subsample`.
        ("ingest", Some(log)) => {
            serde_json::to_value(LogOptions { site: None, ..config.for_log(log)? })?
        }
        ("subsample", _) => {
            let mut value = serde_json::to_value(&config.subsample)?;
            value["sites"] = serde_json::to_value(sites(config, logs)?)?;
            value
        }
        ("label", _) => serde_json::to_value(&config.label)?,
        ("featurize", _) => serde_json::to_value(&config.featurize)?,
        ("train", _) => {
            let lidars = logs
                .iter()
                .map(|log| Ok((*log, config.for_log(log)?.lidar)))
                .collect::<Result<BTreeMap<_, _>>>()?;
            json!({
                "name": config.name,
                "train": config.train,
                "evaluate": config.evaluate,
                "label": config.label,
                "featurize": config.featurize,
                "lidars": lidars,
            })
        }
        // The report shows them all.
        ("evaluate", _) => serde_json::to_value(config)?,
        _ => return Err(anyhow!("there is no stage `{stage}`")),
    };
    Ok(value)
}

/// The site of each log; a log is its own unless it is given one.
pub(crate) fn sites(config: &Config, logs: &[&str]) -> Result<BTreeMap<String, String>> {
    logs.iter()
        .map(|&log| {
            let site = config.for_log(log)?.site;
            Ok((log.to_owned(), site.unwrap_or_else(|| log.to_owned())))
        })
        .collect()
}

/// The stage that makes a file of the run folder, and the log it is of, by the file's name.
pub(crate) fn maker_of(name: &str) -> Option<(&'static str, Option<&str>)> {
    let log = |prefix, extension| name.strip_prefix(prefix)?.strip_suffix(extension);
    if let Some(log) = log("logs/", ".mcap") {
        return Some(("simulate", Some(log)));
    }
    if let Some(log) = log("scans/", ".parquet").or_else(|| log("poses/", ".parquet")) {
        return Some(("ingest", Some(log)));
    }
    match name {
        "keyframes.parquet" => Some(("subsample", None)),
        "pairs.parquet" => Some(("label", None)),
        "features.parquet" => Some(("featurize", None)),
        "scores.parquet" | "rounds.parquet" | "retrieval.parquet" | "grid.parquet" => {
            Some(("train", None))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::maker_of;

    #[test]
    fn files_know_their_stage() {
        assert_eq!(maker_of("scans/monday.parquet"), Some(("ingest", Some("monday"))));
        assert_eq!(maker_of("poses/a.b.parquet"), Some(("ingest", Some("a.b"))));
        assert_eq!(maker_of("logs/monday.mcap"), Some(("simulate", Some("monday"))));
        assert_eq!(maker_of("pairs.parquet"), Some(("label", None)));
        assert_eq!(maker_of("report.html"), None);
        assert_eq!(maker_of("monday.mcap"), None);
    }
}
