//! Every claim of docs/sensors.md rests on a test that always runs.

use std::fs;

use crate::support::root;

/// Calls after which a test may end early because a peer or data is missing.
const CAN_SKIP: [&str; 3] = ["shared_data(", "python_with(", "mcap_command("];

/// A test that the page names: `file::function` of `tests/`, or with a crate before it of the
/// crate's tests.
struct NamedTest<'a> {
    file: &'a str,
    function: &'a str,
}

impl NamedTest<'_> {
    /// The text of the function.
    fn source(&self) -> String {
        let path = match self.file.split_once('/') {
            Some((krate, file)) => format!("crates/{krate}/tests/{file}.rs"),
            None => format!("tests/{}.rs", self.file),
        };
        let text = fs::read_to_string(root().join(&path))
            .unwrap_or_else(|_| panic!("docs/sensors.md names {path}, which does not exist"));
        let start = format!("#[test]\nfn {}() {{", self.function);
        let (_, rest) = text
            .split_once(&start)
            .unwrap_or_else(|| panic!("docs/sensors.md names {}, not in {path}", self.function));
        let (body, _) = rest.split_once("\n}\n").unwrap_or((rest, ""));
        body.to_owned()
    }
}

/// The tests that a text names between backquotes.
fn named_tests(text: &str) -> Vec<NamedTest<'_>> {
    text.split('`')
        .skip(1)
        .step_by(2)
        .filter_map(|code| code.split_once("::"))
        .filter(|(_, function)| !function.is_empty())
        .map(|(file, function)| NamedTest { file, function })
        .collect()
}

/// What is wrong with a row of a table.
fn fault(row: &str) -> Option<&'static str> {
    let tests = named_tests(row);
    let always_runs = |test: &NamedTest<'_>| {
        let source = test.source();
        !CAN_SKIP.iter().any(|call| source.contains(call))
    };
    if tests.is_empty() {
        Some("it names no test")
    } else if !tests.iter().any(always_runs) {
        Some("all its tests can be skipped")
    } else {
        None
    }
}

#[test]
fn every_row_of_the_sensors_page_has_a_test_that_always_runs() {
    let page = fs::read_to_string(root().join("docs/sensors.md")).unwrap();
    let rows = page.lines().filter(|line| line.starts_with("| ") && !line.ends_with("| test |"));
    let mut n_rows = 0;
    for row in rows {
        assert_eq!(fault(row), None, "docs/sensors.md: {row}");
        n_rows += 1;
    }
    assert!(60 <= n_rows, "{n_rows} rows");
    for test in named_tests(&page) {
        test.source();
    }
}

#[test]
fn a_row_whose_tests_can_all_be_skipped_is_found() {
    let can_be_skipped = "`real_logs::killian_gives_the_2436_pairs`";
    let always_runs = "`run::pairs_obey_the_label_rules`";
    assert_eq!(fault("| a | b |"), Some("it names no test"));
    assert_eq!(fault(&format!("| a | {can_be_skipped} |")), Some("all its tests can be skipped"));
    assert_eq!(fault(&format!("| a | {can_be_skipped}, {always_runs} |")), None);
}
