//! No two files of a crate import each other.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;

use super::{code_only, files, name};
use crate::support::root;

/// The modules of a crate: path (empty for the root) and code without tests.
type Modules = BTreeMap<Vec<String>, String>;

fn modules(krate: &str) -> Modules {
    let src = format!("crates/{krate}/src");
    files(&[&src], &[".rs"])
        .into_iter()
        .filter_map(|path| {
            let name = name(&path);
            let within = name.strip_prefix(&format!("{src}/"))?.strip_suffix(".rs")?.to_owned();
            let mut module: Vec<String> = within.split('/').map(str::to_owned).collect();
            if ["mod", "lib", "main"].contains(&module.last()?.as_str()) {
                module.pop();
            }
            let is_test = module.last().is_some_and(|last| last == "tests");
            let code = code_only(&fs::read_to_string(&path).unwrap());
            let (code, _) = code.split_once("#[cfg(test)]\nmod tests {").unwrap_or((&code, ""));
            (!is_test).then(|| (module, code.to_owned()))
        })
        .collect()
}

/// The paths that a `use` tree names: `a::{b, c::{d, e as f}}` gives a::b, a::c::d and a::c::e.
fn paths_of_tree(tree: &str) -> Vec<Vec<String>> {
    let tree = tree.trim();
    let segments = |path: &str| -> Vec<String> {
        let path = path.split(" as ").next().unwrap_or_default();
        path.split("::")
            .map(|segment| segment.trim().to_owned())
            .filter(|s| !s.is_empty())
            .collect()
    };
    let Some((before, group)) = tree.split_once('{') else { return vec![segments(tree)] };
    let group = group.strip_suffix('}').unwrap_or(group);
    let (mut members, mut depth) = (vec![String::new()], 0);
    for c in group.chars() {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            _ => {}
        }
        if c == ',' && depth == 0 {
            members.push(String::new());
        } else {
            members.last_mut().unwrap().push(c);
        }
    }
    members
        .iter()
        .filter(|member| !member.trim().is_empty())
        .flat_map(|member| paths_of_tree(member))
        .map(|path| [segments(before), path].concat())
        .collect()
}

/// A `use` declaration: its paths, from the root of the crate, and whether it is public.
struct Use {
    path: Vec<String>,
    is_public: bool,
}

/// The paths inside the crate that the `use` declarations of a module name.
fn uses(module: &[String], code: &str, modules: &Modules) -> Vec<Use> {
    let mut found = Vec::new();
    for (start, _) in code.match_indices("use ") {
        let line_start = code[..start].rfind('\n').map_or(0, |at| at + 1);
        let visibility = code[line_start..start].trim();
        if !visibility.is_empty() && !visibility.starts_with("pub") {
            continue;
        }
        let (tree, _) = code[start + "use ".len()..].split_once(';').unwrap();
        for path in paths_of_tree(tree) {
            let Some(path) = absolute(module, &path, modules) else { continue };
            found.push(Use { path, is_public: !visibility.is_empty() });
        }
    }
    found
}

/// A path from the root of the crate; none if it leads to another crate.
fn absolute(module: &[String], path: &[String], modules: &Modules) -> Option<Vec<String>> {
    let first = path.first()?.as_str();
    let child = [module, &path[..1]].concat();
    Some(match first {
        "crate" => path[1..].to_vec(),
        "self" => [module, &path[1..]].concat(),
        "super" => {
            let n = path.iter().take_while(|segment| *segment == "super").count();
            [&module[..module.len().saturating_sub(n)], &path[n..]].concat()
        }
        _ if modules.contains_key(&child) => [module, path].concat(),
        _ => return None,
    })
}

/// The module that defines what a path names: re-exports are followed.
fn definition(path: &[String], modules: &Modules) -> Vec<String> {
    let mut path = path.to_vec();
    for _ in 0..8 {
        let n = (0..=path.len()).rev().find(|n| modules.contains_key(&path[..*n])).unwrap_or(0);
        let module = path[..n].to_vec();
        let Some(item) = path.get(n) else { return module };
        let exported = uses(&module, &modules[&module], modules)
            .into_iter()
            .find(|of| of.is_public && of.path.last() == Some(item));
        match exported {
            Some(of) if of.path != path => path = of.path,
            _ => return module,
        }
    }
    path
}

/// Pairs of modules that import each other.
fn mutual_imports(modules: &Modules) -> BTreeSet<[String; 2]> {
    let shown = |module: &[String]| {
        format!("crate{}", module.iter().map(|m| format!("::{m}")).collect::<String>())
    };
    let mut imports: BTreeSet<(Vec<String>, Vec<String>)> = BTreeSet::new();
    for (module, code) in modules {
        for of in uses(module, code, modules) {
            // What a module exports for its children it does not use itself.
            let is_export = of.is_public && of.path.starts_with(module);
            let target = definition(&of.path, modules);
            if !is_export && target != *module {
                imports.insert((module.clone(), target));
            }
        }
    }
    imports
        .iter()
        .filter(|(from, to)| from < to && imports.contains(&(to.clone(), from.clone())))
        .map(|(from, to)| [shown(from), shown(to)])
        .collect()
}

#[test]
fn no_two_files_of_a_crate_import_each_other() {
    let mut faults = Vec::new();
    for entry in fs::read_dir(root().join("crates")).unwrap() {
        let krate = entry.unwrap().file_name().into_string().unwrap();
        for [a, b] in mutual_imports(&modules(&krate)) {
            faults.push(format!("{krate}: {a} and {b}"));
        }
    }
    assert!(faults.is_empty(), "these files import each other:\n{}", faults.join("\n"));
}

#[test]
fn two_files_that_import_each_other_are_found() {
    let modules = |b: &str| -> Modules {
        let code = [
            ("", "mod a;\nmod b;\npub use a::A;\npub use b::c::{C, D as E};\n"),
            ("a", "use std::fs;\n\nuse crate::{C, b::B};\n\nfn f() {\n    use_it();\n}\n"),
            ("b", b),
            ("b::c", "use super::super::b::B;\npub struct C;\n"),
        ];
        let path =
            |name: &str| name.split("::").filter(|s| !s.is_empty()).map(str::to_owned).collect();
        code.into_iter().map(|(name, code)| (path(name), code.to_owned())).collect()
    };
    let without = modules("pub mod c;\npub struct B;\n");
    assert_eq!(mutual_imports(&without), BTreeSet::new());
    let mutual = modules("pub mod c;\n#[derive(Debug)]\npub struct B;\nuse crate::A;\n");
    let expected = ["crate::a", "crate::b"].map(str::to_owned);
    assert_eq!(mutual_imports(&mutual), BTreeSet::from([expected]));
    let expected = ["crate::b", "crate::b::c"].map(str::to_owned);
    let parent = modules("mod c;\nuse c::C;\n");
    assert_eq!(mutual_imports(&parent), BTreeSet::from([expected]));
}
