//! Errors of the command line and of the pipeline file, in plain words.

use std::path::Path;

/// The command line or the pipeline file is invalid; exit code 2.
#[derive(Debug)]
pub(crate) struct UsageError(String);

impl std::fmt::Display for UsageError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for UsageError {}

pub(crate) fn usage(message: impl std::fmt::Display) -> anyhow::Error {
    UsageError(message.to_string()).into()
}

/// Names that are less similar than this are not suggested. A missing or an exchanged letter, and a
/// missing unit at the end, give 0.9 or more; unrelated names give 0.4 to 0.7.
const MIN_SIMILARITY: f64 = 0.8;

/// What `serde` calls the types of values, and what people call them.
const TYPE_NAMES: [(&str, &str); 22] = [
    ("invalid type: ", "found "),
    ("invalid value: ", "found "),
    ("found string ", "found the text "),
    ("found integer ", "found the number "),
    ("found floating point ", "found the number "),
    ("found boolean ", "found "),
    ("found map", "found a section"),
    ("found sequence", "found a list"),
    ("expected f64", "expected a number"),
    ("expected f32", "expected a number"),
    ("expected usize", "expected a whole number, 0 or more"),
    ("expected u8", "expected a whole number, 0 or more"),
    ("expected u16", "expected a whole number, 0 or more"),
    ("expected u32", "expected a whole number, 0 or more"),
    ("expected u64", "expected a whole number, 0 or more"),
    ("expected i64", "expected a whole number"),
    ("expected a string", "expected text in quotes"),
    ("expected a boolean", "expected true or false"),
    ("expected a sequence", "expected a list"),
    ("expected a map", "expected a section"),
    ("expected struct ", "expected a section: "),
    ("expected path string", "expected text in quotes"),
];

/// The message of a wrong type in plain words.
fn in_plain_words(message: &str) -> String {
    if !message.starts_with("invalid type: ") && !message.starts_with("invalid value: ") {
        return message.to_owned();
    }
    let replace = |text: String, (from, to): &(&str, &str)| text.replace(from, to);
    TYPE_NAMES.iter().fold(message.to_owned(), replace)
}

/// A TOML error with its place and, for an unknown key or name, the most similar known one.
pub(crate) fn explain(place: &Path, error: &toml::de::Error) -> anyhow::Error {
    let described = error.to_string().replace(error.message(), &in_plain_words(error.message()));
    let mut text = format!("{}: {}", place.display(), described.trim_end());
    let message = error.message();
    if let Some(known) =
        message.split("expected one of ").nth(1).or(message.split("expected ").nth(1))
        && message.starts_with("unknown ")
    {
        let unknown = message.split('`').nth(1).unwrap_or_default();
        let nearest = known.split('`').skip(1).step_by(2).max_by(|a, b| {
            strsim::jaro_winkler(unknown, a).total_cmp(&strsim::jaro_winkler(unknown, b))
        });
        if let Some(nearest) = nearest
            && MIN_SIMILARITY <= strsim::jaro_winkler(unknown, nearest)
        {
            text.push_str(&format!("\nhint: did you mean `{nearest}`?"));
        }
    }
    usage(text)
}
