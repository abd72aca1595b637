//! Tables with one file per log, as one table.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow};
use dataset::Keyframe;
use dataset::tables::{FeatureTable, read_features, read_keyframes};

use crate::run::Run;
use crate::stage::Artifact;

/// The keyframes of all logs, in the order of the logs.
pub(crate) fn keyframes(run: &Run) -> Result<Vec<Keyframe>> {
    let mut keyframes = Vec::new();
    for log in run.ingested_logs()? {
        keyframes.extend(read_keyframes(&run.path_of_log(Artifact::Keyframes, &log.name))?.0);
    }
    Ok(keyframes)
}

/// The keyframes in a run folder, in the order of the names of the logs.
pub(crate) fn keyframes_in(run_folder: &Path) -> Result<Vec<Keyframe>> {
    let mut keyframes = Vec::new();
    for path in files(run_folder, Artifact::Keyframes)? {
        keyframes.extend(read_keyframes(&path)?.0);
    }
    Ok(keyframes)
}

/// The features of all keyframes, in the same order.
pub(crate) fn features(run: &Run) -> Result<FeatureTable> {
    let mut all: Option<FeatureTable> = None;
    for log in run.ingested_logs()? {
        let path = run.path_of_log(Artifact::Features, &log.name);
        let (table, _) = read_features(&path)?;
        match &mut all {
            None => all = Some(table),
            Some(all) if all.names == table.names => {
                all.ids.extend(table.ids);
                all.values.extend(table.values);
            }
            Some(all) => {
                return Err(anyhow!(
                    "{} has the columns {}, expected those of the other logs, {}; make the features again with `loopboost featurize PIPELINE.toml --out DIR`",
                    path.display(),
                    table.names.join(", "),
                    all.names.join(", ")
                ));
            }
        }
    }
    Ok(all.unwrap_or_default())
}

/// The files of an artifact with one file per log in a run folder, sorted by name.
pub(crate) fn files(run_folder: &Path, artifact: Artifact) -> Result<Vec<PathBuf>> {
    let pattern = artifact.name("**/*");
    let pattern = format!("{}/{pattern}", glob::Pattern::escape(&run_folder.to_string_lossy()));
    let mut files: Vec<PathBuf> =
        glob::glob(&pattern)?.collect::<Result<_, _>>().context("cannot list the tables")?;
    files.retain(|path| !dataset::tables::is_partial(path));
    files.sort();
    Ok(files)
}

/// Removes the files of logs that are not part of the run any more. Programs read all files of the folder.
pub(crate) fn remove_other_logs(run: &Run, artifact: Artifact) -> Result<()> {
    if run.is_dry() {
        return Ok(());
    }
    let logs = run.ingested_logs()?;
    remove_others(&run.path(""), artifact, logs.iter().map(|log| &*log.name))
}

/// Removes the files of logs that are not among these from a run folder.
pub(crate) fn remove_others<'a>(
    run_folder: &Path,
    artifact: Artifact,
    logs: impl Iterator<Item = &'a str>,
) -> Result<()> {
    let kept: BTreeSet<PathBuf> = logs.map(|log| run_folder.join(artifact.name(log))).collect();
    for path in files(run_folder, artifact)?.iter().filter(|path| !kept.contains(*path)) {
        std::fs::remove_file(path).with_context(|| format!("cannot remove {}", path.display()))?;
    }
    Ok(())
}
