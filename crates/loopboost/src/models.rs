//! `model list | show | diff | verify | export`

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow};
use dataset::tables::write_file;

use crate::run::changes;

/// A line for each model below a folder.
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
            Err(error) => out!("{error}"),
        }
    }
    Ok(())
}

/// The model card.
pub(crate) fn show(path: &Path) -> Result<()> {
    out!("{}", model::card(&model::load(path)?).trim_end());
    Ok(())
}

/// What differs between two models, value by value.
pub(crate) fn diff(a: &Path, b: &Path) -> Result<()> {
    let value = |path: &Path| -> Result<serde_json::Value> {
        model::load(path)?;
        let text =
            std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        Ok(serde_json::from_slice(&text)?)
    };
    let (a, b) = (value(a)?, value(b)?);
    let differences = changes(&a, &b);
    match differences.is_empty() {
        true => out!("no difference"),
        false => differences.iter().for_each(|line| out!("{line}")),
    }
    Ok(())
}

/// Loads one model, or all below a folder, which checks every value and the digest.
pub(crate) fn verify(path: &Path) -> Result<()> {
    let files = if path.is_dir() { model_files(path)? } else { vec![path.to_owned()] };
    let mut n_bad = 0;
    for file in &files {
        match model::load(file) {
            Ok(model) => out!("good: {} {} ({})", model.name, model.version, file.display()),
            Err(error) => {
                n_bad += 1;
                out!("bad: {error}");
            }
        }
    }
    match n_bad {
        0 => Ok(()),
        n => Err(anyhow!("{n} of {} models cannot be used", files.len())),
    }
}

/// Writes a model as ONNX.
pub(crate) fn export(path: &Path, onnx: &Path, threshold: f64) -> Result<()> {
    let model = model::load(path)?;
    if !threshold.is_finite() {
        return Err(anyhow!("--threshold is {threshold}, expected a finite number"));
    }
    write_file(onnx, &model::to_onnx(&model, threshold))?;
    out!("{} {} -> {}", model.name, model.version, onnx.display());
    Ok(())
}

/// Every `model.json` below a folder, by name.
fn model_files(folder: &Path) -> Result<Vec<PathBuf>> {
    let pattern = folder.join("**/model.json");
    let files: Vec<PathBuf> = glob::glob(&pattern.to_string_lossy())
        .with_context(|| format!("cannot look below {}", folder.display()))?
        .collect::<Result<_, _>>()
        .with_context(|| format!("cannot look below {}", folder.display()))?;
    match files.is_empty() {
        true => Err(anyhow!("there is no model.json below {}", folder.display())),
        false => Ok(files),
    }
}
