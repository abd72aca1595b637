//! Names and phrases that were replaced do not come back.

use std::collections::BTreeSet;
use std::fs;

use super::{files, name};

/// Identifiers that have a new name.
const IDENTIFIERS: [&str; 19] = [
    "Dealing",
    "Dropped",
    "FrameGraph",
    "FramesFit",
    "Joiner",
    "NoWay",
    "Sequencer",
    "Straightener",
    "Told",
    "every_pair",
    "maker_of",
    "nouns",
    "recent_m",
    "reckon",
    "straighten",
    "straightened",
    "tells",
    "told",
    "unstraightened",
];

/// Files that have a new name.
const FILES: [&str; 11] = [
    "between.rs",
    "drawn.rs",
    "every_pair.rs",
    "fixes.rs",
    "follow.rs",
    "join.rs",
    "nouns.rs",
    "order.rs",
    "recognise.rs",
    "reckon.rs",
    "turn.rs",
];

/// Phrases that were rewritten, in lower case.
const PHRASES: [&str; 19] = [
    "a third of the errors",
    "as many of either class",
    "at hand",
    "by the log's ends",
    "come upon",
    "goes on where",
    "if need be",
    "is no mcap log",
    "is no run folder",
    "no block of ground on both sides",
    "none would do",
    "on both sides of a fold",
    "packets that are there twice",
    "stands there",
    "there already",
    "turns cut by",
    "what is reached",
    "whichever way",
    "would fit",
];

/// Old option keys, where the program and its tests state the new ones.
const RENAMED_KEYS: [&str; 3] =
    ["evaluate.every_pair", "evaluate.recent_m", "[evaluate]\\nrecent_m"];

/// The retired names and phrases in a text.
fn retired(text: &str) -> BTreeSet<&'static str> {
    let text = RENAMED_KEYS.iter().fold(text.to_owned(), |text, key| text.replace(key, ""));
    let words: BTreeSet<&str> = text.split(|c: char| !c.is_alphanumeric() && c != '_').collect();
    // A phrase may continue in the next line of a comment.
    let lines = text.lines().map(|line| line.trim_start_matches([' ', '/', '!', '#', '>']));
    let sentences = lines.collect::<Vec<_>>().join(" ").to_lowercase();
    let identifiers = IDENTIFIERS.into_iter().filter(|name| words.contains(name));
    identifiers.chain(PHRASES.into_iter().filter(|phrase| sentences.contains(phrase))).collect()
}

#[test]
fn no_retired_name_is_used() {
    let folders = ["crates", "tests", "fuzz", "python", "docs", "pipelines", "fixtures", ".ci"];
    // CONTRIBUTING.md lists some phrases as examples, CHANGELOG.md the old names of options.
    let pages = ["README.md", "ARCHITECTURE.md", "Cargo.toml", "deny.toml"];
    let endings = [".rs", ".md", ".toml", ".py", ".json", "run"];
    let mut faults = Vec::new();
    for path in files(&[&folders[..], &pages].concat(), &endings) {
        let name = name(&path);
        let file = path.file_name().unwrap_or_default().to_string_lossy();
        if FILES.contains(&&*file) {
            faults.push(format!("{name}: the name of the file"));
        }
        if !name.ends_with("sources/retired.rs") {
            let found = retired(&fs::read_to_string(&path).unwrap());
            faults.extend(found.iter().map(|word| format!("{name}: {word}")));
        }
    }
    assert!(faults.is_empty(), "retired names are used:\n{}", faults.join("\n"));
}

#[test]
fn retired_names_and_phrases_are_found() {
    assert_eq!(retired("fn untold(retold: u32)"), BTreeSet::new());
    assert_eq!(retired("let told = 1;"), BTreeSet::from(["told"]));
    assert_eq!(retired("/// It is made if\n/// need be."), BTreeSet::from(["if need be"]));
    assert_eq!(retired("`evaluate.recent_m` was renamed"), BTreeSet::new());
}
