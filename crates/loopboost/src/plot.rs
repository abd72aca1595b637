//! `inspect --plot`: draws the path of a log from its suggested pipeline.

use std::path::Path;

use anyhow::{Result, anyhow};
use dataset::tables::write_file;

use crate::trial::Trial;

/// Draws poses, their uncertainty, and the keyframes.
pub(crate) fn plot(file: &Path, name: &str, trial: &Trial) -> Result<()> {
    if file.extension().is_none_or(|extension| extension != "svg") {
        return Err(anyhow!(
            "--plot is {}, expected a file name that ends in .svg",
            file.display()
        ));
    }
    write_file(file, evaluate::path_svg(name, &trial.poses, &trial.keyframes).as_bytes())?;
    Ok(())
}
