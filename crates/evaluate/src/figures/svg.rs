use std::fs;
use std::path::{Path, PathBuf};

use dataset::tables::{Result, write_file};
use maud::{Markup, PreEscaped};

/// Number of line styles in the style sheet (`.series-0` ...).
pub(crate) const N_STYLES: usize = 8;

/// The style sheet of the figures, also included in the report.
pub(crate) const STYLE: &str = include_str!("figures.css");

/// A figure of the report.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Figure {
    /// Its `id` in the report and its file name without the extension.
    pub id: String,
    svg: String,
}

impl Figure {
    pub(crate) fn new(id: &str, svg: Markup) -> Self {
        Self { id: id.to_owned(), svg: svg.into_string() }
    }

    /// The figure for inclusion in an HTML page that has [`STYLE`].
    pub(crate) fn inline(&self) -> Markup {
        PreEscaped(self.svg.clone())
    }

    /// The figure as a file, with its namespace and style.
    pub(crate) fn standalone(&self) -> String {
        let with_namespace = "<svg xmlns=\"http://www.w3.org/2000/svg\" ";
        let svg = self.svg.replacen("<svg ", with_namespace, 1);
        svg.replacen('>', &format!("><style>{STYLE}</style>"), 1)
    }
}

/// Writes each figure to `<folder>/<id>.svg` and removes the other SVG files of the folder, which an
/// earlier run left there. Returns the paths of the written files.
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
            // Best effort: a file that remains is not listed among the run's outputs.
            let _ = fs::remove_file(path);
        }
    }
    Ok(written)
}

/// A coordinate in an SVG file, rounded to a tenth of a pixel.
pub(crate) fn px(value: f64) -> String {
    let text = format!("{value:.1}");
    let text = text.strip_suffix(".0").unwrap_or(&text);
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

/// Dots at points, as one path of zero-length lines with round caps.
pub(crate) fn dots(points: impl Iterator<Item = (f64, f64)>) -> String {
    points.map(|(x, y)| format!("M{} {}h0", px(x), px(y))).collect()
}

/// A line through points, without points that equal the previous one after rounding.
pub(crate) fn polyline(points: impl Iterator<Item = (f64, f64)>) -> String {
    let mut path = String::new();
    let mut last = String::new();
    for (x, y) in points {
        let at = format!("{} {}", px(x), px(y));
        if at != last {
            path.push(if path.is_empty() { 'M' } else { 'L' });
            path.push_str(&at);
            last = at;
        }
    }
    path
}

/// A line through points, without points closer than this to the last drawn one \[px\].
pub(crate) fn thin_polyline(points: impl Iterator<Item = (f64, f64)>, min_step: f64) -> String {
    let mut last: Option<(f64, f64)> = None;
    polyline(points.filter(|&(x, y)| {
        let is_near = |(a, b): (f64, f64)| (x - a).abs().max((y - b).abs()) < min_step;
        let is_drawn = !last.is_some_and(is_near);
        if is_drawn {
            last = Some((x, y));
        }
        is_drawn
    }))
}

/// The greatest value not above `target` that is 1, 2 or 5 times a power of ten.
pub(crate) fn round_length(target: f64) -> f64 {
    let decade = libm::pow(10.0, libm::floor(libm::log10(target.max(1e-9))));
    let step = [5.0, 2.0, 1.0].into_iter().find(|s| s * decade <= target).unwrap_or(1.0);
    step * decade
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_rounded_down_to_1_2_or_5_times_a_power_of_ten() {
        for (target, expected) in [(1.0, 1.0), (4.9, 2.0), (5.0, 5.0), (73.0, 50.0), (0.3, 0.2)] {
            assert!((round_length(target) - expected).abs() < 1e-12, "{target}");
        }
    }

    #[test]
    fn a_figure_file_contains_its_style_sheet_once() {
        let svg = maud::html! { svg viewBox="0 0 1 1" { svg { path d="M0 0" {} } } };
        let file = Figure::new("f", svg).standalone();
        assert!(file.starts_with("<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox"), "{file}");
        assert_eq!(file.matches("<style>").count(), 1);
    }
}
