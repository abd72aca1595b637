//! `lineage` shows the inputs that an artifact was made from, and `verify` checks that they are
//! unchanged.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow};
use dataset::tables::{Provenance, digest_file, read_provenance};

use crate::config::Config;
use crate::logs::file_name;
use crate::run::Manifest;

/// Prints the inputs of an artifact, their inputs, and so on as a tree. Each artifact contains its own
/// provenance. `is_verbose` adds the options.
pub(crate) fn lineage(artifact: &Path, is_verbose: bool) -> Result<()> {
    let (kind, provenance) = provenance_of(artifact)?.ok_or_else(|| {
        anyhow!(
            "{} has no provenance; expected a table, a model.json or a report.html written by loopboost",
            artifact.display()
        )
    })?;
    out!("{}", artifact.display());
    let mut tree = Tree { is_verbose, shown: BTreeSet::new() };
    tree.print(artifact, &kind, &provenance, "");
    Ok(())
}

struct Tree {
    is_verbose: bool,
    /// Inputs whose inputs were printed.
    shown: BTreeSet<String>,
}

impl Tree {
    fn print(&mut self, artifact: &Path, kind: &str, provenance: &Provenance, indent: &str) {
        let seed = provenance.seed.map(|seed| format!(", seed {seed}")).unwrap_or_default();
        out!("{indent}  {kind}, loopboost {}{seed}", provenance.program_version);
        if self.is_verbose {
            out!("{indent}  options {}", provenance.options);
        }
        for (loss, n) in provenance.losses.iter() {
            out!("{indent}  left out: {}", loss.sentence(n));
        }
        for note in &provenance.notes {
            out!("{indent}  note: {note}");
        }
        let last = provenance.inputs.len().saturating_sub(1);
        for (k, (name, digest)) in provenance.inputs.iter().enumerate() {
            let (branch, below) = if k == last { ("└─ ", "   ") } else { ("├─ ", "│  ") };
            let path = find_input(artifact, name);
            let state = match path.as_deref().map(digest_file) {
                Some(Ok(now)) if now == *digest => "",
                Some(Ok(_)) => "  (changed since)",
                Some(Err(_)) => "  (unreadable)",
                None => "  (not in the run folder)",
            };
            out!("{indent}{branch}{name}  {}{state}", short(digest));
            let Some(path) = path else { continue };
            let Ok(Some((kind, provenance))) = provenance_of(&path) else { continue };
            let indent = format!("{indent}{below}");
            if self.shown.insert(name.clone()) {
                self.print(&path, &kind, &provenance, &indent);
            } else {
                out!("{indent}  (inputs shown above)");
            }
        }
    }
}

/// The first names, and how many there are more.
fn named<'a>(names: impl ExactSizeIterator<Item = &'a String>) -> String {
    const MAX_NAMED: usize = 3;
    let more = names.len().saturating_sub(MAX_NAMED);
    let first: Vec<&str> = names.take(MAX_NAMED).map(String::as_str).collect();
    match more {
        0 => first.join(", "),
        n => format!("{} and {n} more files", first.join(", ")),
    }
}

/// The path of an input, from its name in the run folder. The run folder is a parent of the artifact.
fn find_input(artifact: &Path, name: &str) -> Option<PathBuf> {
    artifact.ancestors().skip(1).map(|folder| folder.join(name)).find(|path| path.is_file())
}

/// The first digits of a digest, for display.
fn short(digest: &str) -> &str {
    digest.get(..12).unwrap_or(digest)
}

/// The kind and provenance of an artifact, or `None` for a log or a file of another program.
fn provenance_of(path: &Path) -> Result<Option<(String, Provenance)>> {
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("parquet") => Ok(Some(read_provenance(path)?)),
        Some("json") => {
            let model = model::load(path)?;
            let kind = format!("model {} {}", model.name, model.version);
            let options = serde_json::json!({
                "learner": model.classifier.learner,
                "rounds": model.classifier.rounds.len(),
                "label": model.label_options,
            });
            let provenance = Provenance {
                program_version: model.program_version,
                seed: Some(model.seed),
                options,
                inputs: model.training.digests,
                ..Provenance::default()
            };
            Ok(Some((kind, provenance)))
        }
        Some("html") => {
            let html = fs::read_to_string(path)
                .with_context(|| format!("cannot read {}", path.display()))?;
            Ok(Provenance::from_entries(|key| meta_content(&html, key)))
        }
        _ => match path.exists() {
            true => Ok(None),
            false => Err(anyhow!("{} does not exist", path.display())),
        },
    }
}

/// The content of a `meta` element of a report, without the HTML escapes of `evaluate`.
fn meta_content(html: &str, key: &str) -> Option<String> {
    let (_, rest) = html.split_once(&format!("<meta name=\"{key}\" content=\""))?;
    let (content, _) = rest.split_once('"')?;
    let unescaped = content.replace("&quot;", "\"").replace("&lt;", "<").replace("&gt;", ">");
    Some(unescaped.replace("&amp;", "&"))
}

/// Compares all files of a run folder with the digests that its tasks recorded.
pub(crate) fn verify(folder: &Path, config: Option<&Config>) -> Result<()> {
    let manifest = Manifest::load_existing(folder)?;
    // The key includes the task, because files of two drives may have the same name.
    let mut logs: BTreeMap<(String, String), PathBuf> = BTreeMap::new();
    for log in config.map(Config::log_files).transpose()?.unwrap_or_default() {
        let pose_file = config.map(|config| config.pose_file(&log.name)).transpose()?.flatten();
        let truth_file = config.and_then(|config| config.truth_file(&log.name));
        let of_truth = log.paths.clone().into_iter().chain(truth_file);
        for path in of_truth {
            logs.insert((format!("ingest {} truth", log.name), file_name(&path)), path);
        }
        for path in log.paths.into_iter().chain(pose_file) {
            logs.insert((format!("ingest {}", log.name), file_name(&path)), path);
        }
    }
    let mut digests: BTreeMap<PathBuf, Option<String>> = BTreeMap::new();
    let mut digest_of = |task: &str, name: &str| -> Option<String> {
        let log = logs.get(&(task.to_owned(), name.to_owned())).cloned();
        let path = log.unwrap_or_else(|| folder.join(name));
        digests.entry(path).or_insert_with_key(|path| digest_file(path).ok()).clone()
    };
    let is_made_here: BTreeSet<&String> =
        manifest.tasks.values().flat_map(|task| task.outputs.keys()).collect();
    let (mut n_checked, mut problems, mut unchecked) = (0, Vec::new(), BTreeSet::new());
    for (task, record) in &manifest.tasks {
        for (name, digest) in &record.outputs {
            n_checked += 1;
            match digest_of(task, name) {
                None => problems.push(format!("{name} is missing (written by `{task}`)")),
                Some(now) if now != *digest => {
                    problems.push(format!("{name} changed after `{task}` wrote it"));
                }
                Some(_) => {}
            }
        }
        for (name, digest) in &record.inputs {
            let now = digest_of(task, name);
            if now.is_none() && !is_made_here.contains(name) {
                unchecked.insert(name.clone());
            } else {
                n_checked += 1;
                if now.as_ref() != Some(digest) {
                    problems.push(format!(
                        "{name} changed after `{task}` read it to write {}",
                        named(record.outputs.keys())
                    ));
                }
            }
        }
    }
    out!("{n_checked} digests checked, {} problems", problems.len());
    for name in unchecked {
        match name.ends_with(".json") {
            true => out!("not checked: the model {name} is outside the run folder"),
            false => {
                out!(
                    "not checked: log {name} is outside the run folder; pass the pipeline with --pipeline"
                );
            }
        }
    }
    if problems.is_empty() {
        return Ok(());
    }
    for problem in &problems {
        out!("{problem}");
    }
    Err(anyhow!(
        "{} has {} problems; rebuild it with `loopboost run PIPELINE.toml --out {}`",
        folder.display(),
        problems.len(),
        folder.display()
    ))
}
