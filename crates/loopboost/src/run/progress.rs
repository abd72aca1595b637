//! Progress bars.

use indicatif::{ProgressBar, ProgressStyle};

/// A bar on stderr. It is shown on a terminal only.
pub(crate) fn progress_bar(total: u64, message: String, bytes: bool) -> ProgressBar {
    let template = match bytes {
        true => "{msg:<28} {wide_bar} {bytes}/{total_bytes} {eta}",
        false => "{msg:<28} {wide_bar} {pos}/{len} {eta}",
    };
    let style =
        ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(total).with_style(style).with_message(message)
}
