//! Figures as SVG: in the report they take its light or dark colours, scale and print, and need no
//! script; the same figures stand as files of their own in `evaluation/figures/`.

mod chart;
mod ground;
mod heat;
mod map;
mod path;
mod scan_pair;
mod scatter;

use std::fs;
use std::path::{Path, PathBuf};

use dataset::tables::{Result, write_file};
use maud::{Markup, PreEscaped};

pub(crate) use chart::{Axis, Chart, Series, ticks};
pub(crate) use ground::Ground;
pub(crate) use heat::Heat;
pub(crate) use map::map;
pub use path::path_svg;
pub(crate) use path::{path, path_caption};
pub(crate) use scan_pair::scan_pair;
pub(crate) use scatter::{Cut, Scatter};

/// Number of line styles that the style sheet has (`.series-0` ...).
pub(crate) const N_STYLES: usize = 8;

/// The style sheet of figures; the report has it too.
pub(crate) const STYLE: &str = include_str!("figures.css");

/// A figure of the report.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Figure {
    /// Its name in the report and its file's stem.
    pub id: String,
    svg: String,
}

impl Figure {
    pub(crate) fn new(id: &str, svg: Markup) -> Self {
        Self { id: id.to_owned(), svg: svg.into_string() }
    }

    pub(crate) fn inline(&self) -> Markup {
        PreEscaped(self.svg.clone())
    }

    /// The figure with name space and style, as a file.
    fn standalone(&self) -> String {
        let name_space = "<svg xmlns=\"http://www.w3.org/2000/svg\" ";
        let svg = self.svg.replacen("<svg ", name_space, 1);
        svg.replacen('>', &format!("><style>{STYLE}</style>"), 1)
    }
}

/// Writes each figure as `<id>.svg`, and removes other SVG files of an earlier run.
pub fn write_figures(folder: &Path, figures: &[Figure]) -> Result<Vec<PathBuf>> {
    let mut written = Vec::new();
    for figure in figures {
        let path = folder.join(format!("{}.svg", figure.id));
        write_file(&path, figure.standalone().as_bytes())?;
        written.push(path);
    }
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.extension().is_some_and(|e| e == "svg") && !written.contains(&path) {
            // Best effort: a file that stays is no part of this run's outputs.
            let _ = fs::remove_file(path);
        }
    }
    Ok(written)
}

/// A coordinate in an SVG, short and always the same.
pub(crate) fn px(value: f64) -> String {
    let text = format!("{value:.1}");
    let text = text.strip_suffix(".0").unwrap_or(&text);
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

/// A dot at each point, as one path: short lines of no length with round ends.
pub(crate) fn dots(points: impl Iterator<Item = (f64, f64)>) -> String {
    points.map(|(x, y)| format!("M{} {}h0", px(x), px(y))).collect()
}

/// 1, 2 or 5 times a power of ten: the greatest that is not more than `target`.
pub(crate) fn round_length(target: f64) -> f64 {
    let decade = libm::pow(10.0, libm::floor(libm::log10(target.max(1e-9))));
    let step = [5.0, 2.0, 1.0].into_iter().find(|s| s * decade <= target).unwrap_or(1.0);
    step * decade
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_round() {
        for (target, expected) in [(1.0, 1.0), (4.9, 2.0), (5.0, 5.0), (73.0, 50.0), (0.3, 0.2)] {
            assert!((round_length(target) - expected).abs() < 1e-12, "{target}");
        }
    }

    #[test]
    fn a_file_carries_its_style_once() {
        let svg = maud::html! { svg viewBox="0 0 1 1" { svg { path d="M0 0" {} } } };
        let file = Figure::new("f", svg).standalone();
        assert!(file.starts_with("<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox"), "{file}");
        assert_eq!(file.matches("<style>").count(), 1);
    }
}
