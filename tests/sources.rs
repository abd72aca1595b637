//! Rules for the source files: their size, what they import and the names they use.

mod imports;
mod retired;

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::root;

const MAX_FILE_LINES: usize = 600;
const MAX_FUNCTION_LINES: usize = 80;
/// A file with one table of codes does one thing, however many codes there are.
const TABLES: [&str; 1] = ["crates/dataset/src/note_kind.rs"];

/// Files below some folders of the repository whose names end in one of the endings, sorted.
fn files(folders: &[&str], endings: &[&str]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut paths: Vec<PathBuf> = folders.iter().map(|folder| root().join(folder)).collect();
    while let Some(path) = paths.pop() {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if path.is_dir() {
            // Build products and inputs of the fuzzer.
            if !["target", "corpus", "artifacts", "__pycache__"].contains(&name.as_str()) {
                paths.extend(fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path()));
            }
        } else if endings.iter().any(|ending| name.ends_with(ending)) {
            found.push(path);
        }
    }
    found.sort();
    found
}

fn rust_files() -> Vec<PathBuf> {
    files(&["crates", "tests", "fuzz", "python"], &[".rs"])
}

/// The path inside the repository.
fn name(path: &Path) -> String {
    path.strip_prefix(root()).unwrap().display().to_string()
}

/// The text with comments, and what is inside quotes, replaced by spaces. Lines stay where they are.
fn code_only(text: &str) -> String {
    let mut code = String::with_capacity(text.len());
    let mut rest = text;
    let mut is_in_word = false;
    while let Some(first) = rest.chars().next() {
        // An r at the end of a word does not start a raw string.
        let length = if is_in_word && first == 'r' { 0 } else { skipped_length(rest) };
        if length == 0 {
            code.push(first);
            rest = &rest[first.len_utf8()..];
        } else {
            code.extend(rest[..length].chars().map(|c| if c == '\n' { '\n' } else { ' ' }));
            rest = &rest[length..];
        }
        is_in_word = first.is_alphanumeric() || first == '_';
    }
    code
}

/// The bytes of the comment, text or character that starts here; 0 if none does.
fn skipped_length(rest: &str) -> usize {
    let until = |end: &str, from: usize| {
        rest[from..].find(end).map_or(rest.len(), |at| from + at + end.len())
    };
    if rest.starts_with("//") {
        return rest.find('\n').unwrap_or(rest.len());
    }
    if rest.starts_with("/*") {
        return until("*/", 2);
    }
    if rest.starts_with("r\"") || rest.starts_with("r#") {
        let hashes = rest[1..].len() - rest[1..].trim_start_matches('#').len();
        if rest[1 + hashes..].starts_with('"') {
            return until(&format!("\"{}", "#".repeat(hashes)), hashes + 2);
        }
    }
    if let Some(inner) = rest.strip_prefix('"') {
        let mut is_escaped = false;
        let end = inner.find(|c| {
            let is_end = c == '"' && !is_escaped;
            is_escaped = c == '\\' && !is_escaped;
            is_end
        });
        return end.map_or(rest.len(), |at| at + 2);
    }
    if let Some(inner) = rest.strip_prefix('\'') {
        // `'a'` and `'\n'` are characters, `'a` is a lifetime.
        if inner.starts_with('\\') {
            return until("'", 3);
        }
        let length = inner.chars().next().map_or(0, char::len_utf8);
        if inner[length..].starts_with('\'') {
            return length + 2;
        }
    }
    0
}

/// The functions of a file that are too long, with their lines.
fn long_functions(text: &str) -> Vec<String> {
    let code = code_only(text);
    let mut found = Vec::new();
    // Functions whose end is not reached yet: name, first line, depth of the braces around them.
    let mut open: Vec<(String, usize, usize)> = Vec::new();
    let mut declared: Option<(String, usize)> = None;
    let (mut depth, mut n_brackets) = (0, 0);
    for (line, code) in (1..).zip(code.lines()) {
        let mut words = code.split_whitespace().skip_while(|word| *word != "fn").skip(1);
        if let Some(word) = words.next() {
            let end = word.find(['(', '<']).unwrap_or(word.len());
            declared = Some((word[..end].to_owned(), line));
        }
        for c in code.chars() {
            match c {
                '(' | '[' => n_brackets += 1,
                ')' | ']' => n_brackets -= 1,
                // A function without a body.
                ';' if n_brackets == 0 => declared = None,
                '{' => {
                    if let Some((name, start)) = declared.take() {
                        open.push((name, start, depth));
                    }
                    depth += 1;
                }
                '}' => {
                    depth -= 1;
                    if open.last().is_some_and(|(.., of_fn)| *of_fn == depth) {
                        let (name, start, _) = open.pop().unwrap();
                        if MAX_FUNCTION_LINES < line - start + 1 {
                            found.push(format!("{name}: {} lines", line - start + 1));
                        }
                    }
                }
                _ => {}
            }
        }
    }
    found
}

#[test]
fn no_file_and_no_function_is_too_long() {
    let mut faults = Vec::new();
    for path in rust_files() {
        let text = fs::read_to_string(&path).unwrap();
        let n_lines = text.lines().count();
        if MAX_FILE_LINES < n_lines && !TABLES.contains(&name(&path).as_str()) {
            faults.push(format!("{}: {n_lines} lines", name(&path)));
        }
        faults.extend(long_functions(&text).iter().map(|f| format!("{}: {f}", name(&path))));
    }
    assert!(faults.is_empty(), "too long:\n{}", faults.join("\n"));
}

#[test]
fn a_long_function_is_found() {
    let statements =
        "    let a = ['{', '\\'']; // {\n    let b: &'static str = \"}\\\"\";\n".repeat(38);
    let function = |more: &str| {
        format!("impl A {{\nfn short();\nfn f<'a>(b: [u8; 4]\n) {{\n{statements}{more}}}\n}}\n")
    };
    // Two lines of the signature, 76 statements, more lines, and the brace.
    assert_eq!(long_functions(&function("\n")), Vec::<String>::new());
    assert_eq!(long_functions(&function("\n\n")), ["f: 81 lines"]);
}
