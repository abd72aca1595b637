//! `model list | show | diff | verify | export`

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow};
use dataset::tables::write_file;

use crate::run::changes;

/// Prints one line per model in a folder.
pub(crate) fn list(folder: &Path) -> Result<()> {
    for path in model_files(folder)? {
        match model::load(&path) {
            Ok(model) => {
                let measured = model.measured.first().map_or("not measured".to_owned(), |m| {
                    format!("error {:.1} % by {}", m.error * 100.0, m.grouping)
                });
                out!(
                    "{:<32} {:<8} {:<14} {:<12} {measured}",
                    model.name,
                    model.version.to_string(),
                    model.classifier.learner.name(),
                    format!("{} v{}", model.features.set, model.features.version)
                );
            }
            Err(error) => out!("invalid: {:#}", anyhow::Error::from(error)),
        }
    }
    Ok(())
}

/// Prints the model card.
pub(crate) fn show(path: &Path) -> Result<()> {
    out!("{}", model::card(&model::load(&file_of(path)?)?).trim_end());
    Ok(())
}

/// Prints the values that differ between two models.
pub(crate) fn diff(a: &Path, b: &Path) -> Result<()> {
    let value = |path: &Path| -> Result<serde_json::Value> {
        let path = file_of(path)?;
        model::load(&path)?;
        let text =
            std::fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?;
        Ok(serde_json::from_slice(&text)?)
    };
    let (a, b) = (value(a)?, value(b)?);
    let differences = changes(&a, &b);
    match differences.is_empty() {
        true => out!("no differences"),
        false => differences.iter().for_each(|line| out!("{line}")),
    }
    Ok(())
}

/// Loads one model, or all models in a folder. Loading checks all values and the digest.
pub(crate) fn verify(path: &Path) -> Result<()> {
    let files = if path.is_dir() { model_files(path)? } else { vec![path.to_owned()] };
    let mut n_invalid = 0;
    for file in &files {
        match model::load(file) {
            Ok(model) => out!("valid: {} {} ({})", model.name, model.version, file.display()),
            Err(error) => {
                n_invalid += 1;
                out!("invalid: {:#}", anyhow::Error::from(error));
            }
        }
    }
    match n_invalid {
        0 => Ok(()),
        n => Err(anyhow!("invalid models: {n} of {}", files.len())),
    }
}

/// Writes a model as ONNX.
pub(crate) fn export(path: &Path, onnx: &Path, threshold: f64) -> Result<()> {
    let model = model::load(&file_of(path)?)?;
    if !threshold.is_finite() {
        return Err(anyhow!("--threshold is {threshold}, expected a finite number"));
    }
    let folder = onnx.parent().filter(|folder| !folder.as_os_str().is_empty());
    if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
        return Err(anyhow!(
            "cannot write {}: the folder {} does not exist; create it, or choose another file with --onnx",
            onnx.display(),
            folder.display()
        ));
    }
    write_file(onnx, &model::to_onnx(&model, threshold))?;
    out!("{} {} -> {}", model.name, model.version, onnx.display());
    Ok(())
}

/// The file of a model: the path itself, or the only `model.json` in a folder and its subfolders.
pub fn file_of(path: &Path) -> Result<PathBuf> {
    if !path.is_dir() {
        return Ok(path.to_owned());
    }
    let mut files = model_files(path)?;
    match files.pop() {
        Some(only) if files.is_empty() => Ok(only),
        last => {
            let files: Vec<String> =
                files.iter().chain(&last).map(|file| file.display().to_string()).collect();
            Err(anyhow!(
                "{} has {} models; name one of them: {}",
                path.display(),
                files.len(),
                files.join(", ")
            ))
        }
    }
}

/// All files named `model.json` in a folder and its subfolders, sorted by path.
fn model_files(folder: &Path) -> Result<Vec<PathBuf>> {
    let folder_pattern = glob::Pattern::escape(&folder.to_string_lossy());
    let pattern = Path::new(&folder_pattern).join("**/model.json");
    let files: Vec<PathBuf> = glob::glob(&pattern.to_string_lossy())
        .with_context(|| format!("cannot search {}", folder.display()))?
        .collect::<Result<_, _>>()
        .with_context(|| format!("cannot search {}", folder.display()))?;
    match files.is_empty() {
        true => Err(anyhow!(
            "no model.json in {} or its subfolders; expected a model file or a folder with models",
            folder.display()
        )),
        false => Ok(files),
    }
}
