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
    let mut files = Vec::new();
    // The paths begin with that of the run folder as it is written, such as `./run`.
    let mut folders = vec![run_folder.join(artifact.folder().unwrap_or_default())];
    while let Some(folder) = folders.pop() {
        let entries = match std::fs::read_dir(&folder) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => continue,
            entries => entries.with_context(|| format!("cannot list {}", folder.display()))?,
        };
        for entry in entries {
            let path = entry.with_context(|| format!("cannot list {}", folder.display()))?.path();
            let is_table = path.extension().is_some_and(|end| end == "parquet");
            if path.is_dir() {
                folders.push(path);
            } else if is_table && !dataset::tables::is_partial(&path) {
                files.push(path);
            }
        }
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The run folder is written with and without `./`.
    #[test]
    fn only_tables_of_other_logs_are_removed() {
        let folder = tempfile::Builder::new().tempdir_in(".").unwrap();
        let name = Path::new(folder.path().file_name().unwrap());
        for run_folder in [name.to_owned(), Path::new(".").join(name), folder.path().to_owned()] {
            for log in ["monday", "north/monday", "friday"] {
                let path = run_folder.join(Artifact::Keyframes.name(log));
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                std::fs::write(path, "").unwrap();
            }
            let logs = ["monday", "north/monday"];
            remove_others(&run_folder, Artifact::Keyframes, logs.into_iter()).unwrap();
            let expected = logs.map(|log| run_folder.join(Artifact::Keyframes.name(log)));
            assert_eq!(files(&run_folder, Artifact::Keyframes).unwrap(), expected);
        }
    }
}
