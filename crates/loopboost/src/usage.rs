//! Errors of the command line and of the pipeline file, in plain words.

use std::path::Path;

use serde_json::{Map, Value};

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

/// The most keys that are suggested.
const MAX_SUGGESTED: usize = 3;

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
    with_hint(describe(&place.display(), error), similar_name(error.message()))
}

/// The same for `KEY=VALUE` overrides. For an unknown key, the hint has a key of the schema with all of its sections.
pub(crate) fn explain_overrides(
    overrides: &[String],
    schema: &schemars::Schema,
    error: &toml::de::Error,
) -> anyhow::Error {
    let place = format!("--set {}", overrides.join(" --set "));
    let message = error.message();
    let similar = similar_name(message);
    let unknown = message.strip_prefix("unknown field `").and_then(|rest| rest.split('`').next());
    let key = unknown.and_then(|unknown| {
        let keys = keys(schema);
        let key = |text: &String| Some(text.split_once('=')?.0.trim().to_owned());
        let is_wrong =
            |key: &String| key.split('.').any(|part| part == unknown) && !keys.contains(key);
        let typed = overrides.iter().filter_map(key).find(is_wrong)?;
        known_key(&typed, unknown, similar.as_deref(), &keys)
    });
    with_hint(describe(&place, error), key.or(similar))
}

/// The whole key for one with an unknown part. `similar` is a known name in the same section that is like the unknown
/// part.
fn known_key(typed: &str, unknown: &str, similar: Option<&str>, keys: &[String]) -> Option<String> {
    if let Some(similar) = similar {
        let part = |part| if part == unknown { similar } else { part };
        return Some(typed.split('.').map(part).collect::<Vec<_>>().join("."));
    }
    // The first sections are missing. All keys that end like this may be meant.
    let is_end = |key: &&String| key.strip_suffix(typed).is_some_and(|start| start.ends_with('.'));
    let ends: Vec<&str> =
        keys.iter().filter(is_end).map(String::as_str).take(MAX_SUGGESTED).collect();
    (!ends.is_empty()).then(|| ends.join("` or `"))
}

fn describe(place: &dyn std::fmt::Display, error: &toml::de::Error) -> String {
    let described = error.to_string().replace(error.message(), &in_plain_words(error.message()));
    format!("{place}: {}", described.trim_end())
}

fn with_hint(text: String, similar: Option<String>) -> anyhow::Error {
    usage(match similar {
        Some(similar) => format!("{text}\nhint: did you mean `{similar}`?"),
        None => text,
    })
}

/// The name that an error about an unknown one suggests.
fn similar_name(message: &str) -> Option<String> {
    let rest = message.strip_prefix("unknown ")?;
    let known = rest.split("expected one of ").nth(1).or(rest.split("expected ").nth(1))?;
    let unknown = rest.split('`').nth(1).unwrap_or_default();
    let similarity = |name: &&str| strsim::jaro_winkler(unknown, name);
    let nearest = known
        .split('`')
        .skip(1)
        .step_by(2)
        .max_by(|a, b| similarity(a).total_cmp(&similarity(b)))?;
    (MIN_SIMILARITY <= similarity(&nearest)).then(|| nearest.to_owned())
}

/// All keys of a schema with their sections, such as `ingest.pose.topic`.
fn keys(schema: &schemars::Schema) -> Vec<String> {
    let mut keys = Vec::new();
    if let Some(root) = schema.as_object() {
        let definitions = root.get("$defs").and_then(Value::as_object);
        add_keys(&Value::Object(root.clone()), "", definitions, &mut keys);
    }
    keys
}

fn add_keys(
    schema: &Value,
    section: &str,
    definitions: Option<&Map<String, Value>>,
    keys: &mut Vec<String>,
) {
    let Some(schema) = schema.as_object() else { return };
    let referred = schema.get("$ref").and_then(Value::as_str);
    let referred = referred.and_then(|name| definitions?.get(name.rsplit('/').next()?));
    let choices = ["anyOf", "oneOf", "allOf"].into_iter().filter_map(|name| schema.get(name));
    let choices = choices.filter_map(Value::as_array).flatten();
    for part in referred.into_iter().chain(choices) {
        add_keys(part, section, definitions, keys);
    }
    for (name, value) in schema.get("properties").and_then(Value::as_object).into_iter().flatten() {
        let key = format!("{section}{name}");
        keys.push(key.clone());
        add_keys(value, &format!("{key}."), definitions, keys);
    }
}
