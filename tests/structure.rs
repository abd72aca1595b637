//! The crate graph, and what the README, the docs and CI state about the repository.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::process::Command;

use crate::support::root;

/// The crates of the workspace and the other crates that each depends on, without dev-dependencies.
fn graph() -> BTreeMap<String, BTreeSet<String>> {
    let mut graph = BTreeMap::new();
    let mut external = BTreeMap::new();
    for entry in fs::read_dir(root().join("crates")).unwrap() {
        let folder = entry.unwrap().path();
        let manifest: toml::Table =
            fs::read_to_string(folder.join("Cargo.toml")).unwrap().parse().unwrap();
        let name = manifest["package"]["name"].as_str().unwrap().to_owned();
        assert_eq!(name, folder.file_name().unwrap().to_str().unwrap());
        let used: BTreeSet<String> = match &manifest["dependencies"] {
            toml::Value::Table(table) => table.keys().cloned().collect(),
            _ => BTreeSet::new(),
        };
        external.insert(name.clone(), used.clone());
        graph.insert(name, used);
    }
    let names: BTreeSet<String> = graph.keys().cloned().collect();
    graph
        .into_iter()
        .map(|(name, used)| (name, used.intersection(&names).cloned().collect()))
        .collect()
}

/// The stages that a stage may use besides `dataset`, `model` and `messages`.
const EXCEPTIONS: [(&str, &[&str]); 5] = [
    ("detect", &["register"]),
    ("experiment", &["evaluate", "featurize", "label", "train"]),
    ("ingest", &["fuse"]),
    ("optimize", &["register"]),
    ("view", &["register"]),
];

/// The crates that read or write logs.
const KNOW_MCAP: [&str; 4] = ["import", "ingest", "simulate", "view"];

#[test]
fn a_stage_depends_on_the_type_crates_and_not_on_other_stages() {
    let graph = graph();
    let types: BTreeSet<&str> = ["dataset", "model", "messages"].into();
    for (name, used) in &graph {
        if name == "loopboost" {
            continue;
        }
        for other in used {
            let is_type = types.contains(other.as_str());
            let is_exception = EXCEPTIONS
                .iter()
                .any(|(stage, may_use)| stage == name && may_use.contains(&&**other));
            assert!(is_type || is_exception, "`{name}` depends on the stage `{other}`");
        }
    }
    for krate in types {
        assert!(graph[krate].is_empty(), "`{krate}` depends on {:?}", graph[krate]);
    }
    assert!(!graph["evaluate"].contains("model"), "evaluate sees scores, never models");
    for (name, used) in &graph {
        let knows_messages = used.contains("messages");
        assert!(!knows_messages || KNOW_MCAP.contains(&name.as_str()), "{name}");
    }
}

#[test]
fn only_the_crates_that_read_or_write_logs_depend_on_mcap() {
    for entry in fs::read_dir(root().join("crates")).unwrap() {
        let folder = entry.unwrap().path();
        let manifest: toml::Table =
            fs::read_to_string(folder.join("Cargo.toml")).unwrap().parse().unwrap();
        let name = folder.file_name().unwrap().to_str().unwrap().to_owned();
        let uses = |other: &str| manifest["dependencies"].get(other).is_some();
        assert_eq!(uses("mcap"), KNOW_MCAP.contains(&name.as_str()), "{name}");
        assert_eq!(uses("clap"), name == "loopboost", "{name}");
    }
}

/// The crates that run on a robot need neither Arrow nor Parquet nor MCAP.
#[test]
fn the_crates_for_robots_have_few_dependencies() {
    for package in ["featurize", "model"] {
        let output = Command::new(env!("CARGO"))
            .args([
                "tree",
                "--offline",
                "--edges",
                "normal",
                "--prefix",
                "none",
                "--package",
                package,
            ])
            .current_dir(root())
            .output()
            .unwrap();
        let tree = String::from_utf8(output.stdout).unwrap();
        assert!(output.status.success() && tree.starts_with(package), "{tree}");
        for heavy in ["arrow", "parquet", "mcap", "zstd", "rayon"] {
            assert!(!tree.contains(heavy), "`{package}` needs `{heavy}`:\n{tree}");
        }
    }
}

#[test]
fn the_readme_lists_every_crate_and_folder() {
    let readme = fs::read_to_string(root().join("README.md")).unwrap();
    for name in graph().keys() {
        assert!(readme.contains(&format!("crates/{name} ")), "README does not list crates/{name}");
    }
    for line in readme.lines().filter(|line| line.starts_with("crates/")) {
        let path = line.split_whitespace().next().unwrap();
        assert!(root().join(path).is_dir(), "README lists {path}, which does not exist");
    }
    for path in ["pipelines/", "tests/", "fixtures/"] {
        assert!(readme.contains(path) && root().join(path).is_dir(), "{path}");
    }
}

/// The pipeline file in the README is valid.
#[test]
fn the_readme_shows_a_valid_pipeline() {
    let readme = fs::read_to_string(root().join("README.md")).unwrap();
    let (_, rest) = readme.split_once("```toml\n").unwrap();
    let (pipeline, _) = rest.split_once("```").unwrap();
    let workplace = crate::support::Workplace::new(pipeline);
    let path = workplace.path("drive.toml");
    crate::support::loopboost(&["run", path.to_str().unwrap(), "--print-config"]).expect(0);
}

#[test]
fn ci_runs_the_commands_of_the_readme() {
    let readme = fs::read_to_string(root().join("README.md")).unwrap();
    let ci = fs::read_to_string(root().join(".ci/run")).unwrap();
    let commands: Vec<&str> = readme
        .lines()
        .filter(|line| line.starts_with("cargo run ") || line.starts_with("cargo test "))
        .collect();
    assert_eq!(commands.len(), 2, "expected the quickstart and the tests: {commands:?}");
    for command in commands {
        assert!(
            ci.lines().any(|line| line.trim() == command),
            "`.ci/run` does not run `{command}`"
        );
    }
}

/// The committed JSON Schemas are generated from the types, and the pipelines are valid by theirs.
#[test]
fn the_schemas_are_generated_from_the_types() {
    for file in ["comparison", "pipeline", "model"] {
        let printed = crate::support::loopboost(&["schema", file]).expect(0).stdout;
        let committed =
            fs::read_to_string(root().join(format!("docs/schema/{file}.json"))).unwrap();
        assert!(printed == committed, "`loopboost schema {file} > docs/schema/{file}.json`");
    }
    let Some(python) = crate::require::python_with(&["jsonschema", "tomllib"]) else { return };
    let script = "import glob, json, jsonschema, sys, tomllib\n\
        schema = json.load(open(sys.argv[1] + '/docs/schema/pipeline.json'))\n\
        for path in glob.glob(sys.argv[1] + '/pipelines/*.toml'):\n\
        \x20   jsonschema.validate(tomllib.load(open(path, 'rb')), schema)\n\
        try:\n\
        \x20   jsonschema.validate({'label': {'radius': 2}}, schema)\n\
        except jsonschema.ValidationError:\n\
        \x20   sys.exit(0)\n\
        sys.exit('an unknown key passed')";
    let output = Command::new(python).args(["-c", script]).arg(root()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// The rows of a Markdown file that start with a code: `code`, and the next cell.
fn coded_rows(markdown: &str) -> BTreeMap<String, String> {
    markdown
        .lines()
        .filter_map(|line| line.strip_prefix("| `")?.split_once("` | "))
        .map(|(code, rest)| {
            let cell = rest.split(" | ").next().unwrap_or_default();
            (code.to_owned(), cell.to_owned())
        })
        .collect()
}

#[test]
fn the_docs_list_every_code_of_a_loss_a_note_and_an_error_of_a_log() {
    let docs = fs::read_to_string(root().join("docs/messages.md")).unwrap();
    let rows = coded_rows(&docs);
    let sources = ["ingest/src/error.rs", "ingest/src/pose/wheel_error.rs", "subsample/src/lib.rs"]
        .map(|file| fs::read_to_string(root().join("crates").join(file)).unwrap());
    let errors: Vec<&str> = sources
        .iter()
        .flat_map(|source| {
            let (_, codes) = source.split_once("pub fn code(&self)").unwrap();
            let (codes, _) = codes.split_once("\n    }\n").unwrap();
            codes.split('"').skip(1).step_by(2)
        })
        .collect();
    assert!(errors.contains(&"not_mcap") && errors.contains(&"dead_gyro"), "{errors:?}");
    let severities: BTreeMap<&str, &str> = dataset::LossKind::SEVERITIES
        .iter()
        .chain(dataset::NoteKind::SEVERITIES)
        .copied()
        .collect();
    for code in severities.keys().chain(&errors) {
        assert!(rows.contains_key(*code), "docs/messages.md does not list `{code}`");
    }
    for (code, severity) in &severities {
        assert_eq!(rows[*code], *severity, "docs/messages.md: severity of `{code}`");
    }
    let known: BTreeSet<&str> = severities.keys().copied().chain(errors).collect();
    // A missing file and the severities themselves have no variant of their own.
    let others = ["log_missing", "info", "warning", "error"];
    for code in rows.keys().filter(|code| !others.contains(&code.as_str())) {
        assert!(known.contains(code.as_str()), "docs/messages.md lists the unknown code `{code}`");
    }
}

/// CI builds with the release of rust-toolchain.toml. It is the oldest release that Cargo.toml
/// claims to support.
#[test]
fn ci_builds_with_the_oldest_supported_release() {
    let table = |file: &str| -> toml::Table {
        fs::read_to_string(root().join(file)).unwrap().parse().unwrap()
    };
    let toolchain = table("rust-toolchain.toml");
    let channel = toolchain["toolchain"]["channel"].as_str().unwrap();
    let cargo = table("Cargo.toml");
    let oldest = cargo["workspace"]["package"]["rust-version"].as_str().unwrap();
    assert_eq!(channel.rsplit_once('.').unwrap().0, oldest);
    for entry in fs::read_dir(root().join("crates")).unwrap() {
        let manifest = table(entry.unwrap().path().join("Cargo.toml").to_str().unwrap());
        assert_eq!(manifest["package"]["rust-version"]["workspace"], toml::Value::Boolean(true));
    }
}
