//! Figures as inline SVG: they scale, print, follow the page's light or dark colours, and need
//! no script.

mod chart;
mod map;
mod path;

pub(crate) use chart::{Axis, Chart, Series};
pub(crate) use map::map;
pub use path::path_svg;
pub(crate) use path::paths;

/// Number of line styles that the page's style sheet has (`.series-0` ...).
pub(crate) const N_STYLES: usize = 5;

/// A coordinate in an SVG, short and always the same.
pub(crate) fn px(value: f64) -> String {
    let text = format!("{value:.1}");
    let text = text.strip_suffix(".0").unwrap_or(&text);
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}
