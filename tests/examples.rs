//! Every item named in a table on the front page of a library crate has an example that is compiled and run.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

const CRATES: [&str; 5] = ["linalg", "covariance", "implicit", "rod", "assimilation"];

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Sources of a crate, with their path below its folder `src`.
fn sources(folder: &Path, below: &str, found: &mut Vec<(String, String)>) {
    for entry in std::fs::read_dir(folder).expect("a folder of sources") {
        let path: PathBuf = entry.expect("an entry of a folder").path();
        let name = format!("{below}{}", path.file_name().expect("a name").to_string_lossy());
        if path.is_dir() {
            sources(&path, &format!("{name}/"), found);
        } else {
            found.push((name, read(&path)));
        }
    }
}

/// Links of the tables in the comments of a crate: `[`Item`]`, `[`module::Item`]`, `[`function()`]`. Items of
/// other crates are left to those; of `Type::member` the type is taken.
fn named(front_page: &str) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    for row in front_page.lines().filter(|line| line.starts_with("//! |")) {
        for link in row.split("[`").skip(1) {
            let link = link.split_once("`]").expect("a link that ends in its line").0;
            let path = link.trim_start_matches("mod@").trim_end_matches("()");
            if path.starts_with("varda_") {
                continue;
            }
            let (first, rest) = path.split_once("::").unwrap_or((path, ""));
            let a_type = first.starts_with(char::is_uppercase);
            names.insert(if a_type || rest.is_empty() { first } else { path }.to_string());
        }
    }
    names
}

/// Whether the lines of a comment have a block of code that rustdoc runs.
fn runs<'a>(comment: impl Iterator<Item = &'a str>) -> bool {
    let mut fences = comment
        .filter_map(|line| line.trim_start().trim_start_matches(['/', '!']).trim().strip_prefix("```"));
    // every second fence is the end of a block
    std::iter::from_fn(|| {
        let start = fences.next();
        fences.next();
        start
    })
    .any(|language| language.is_empty() || language.starts_with("should_panic"))
}

/// Where an item is defined in a crate, and whether its comment has an example; of a module, any comment in
/// it.
fn examples(sources: &[(String, String)], name: &str) -> Vec<(String, bool)> {
    let (module, item) = name.split_once("::").unwrap_or(("", name));
    let mut found = Vec::new();
    for (file, text) in sources {
        let lines: Vec<&str> = text.lines().collect();
        let line = format!("pub mod {item};");
        let public = sources.iter().any(|(file, text)| file == "lib.rs" && text.contains(&line));
        if public && [format!("{item}.rs"), format!("{item}/mod.rs")].contains(file) && module.is_empty() {
            let below = |other: &str| other == file || other.starts_with(&format!("{item}/"));
            let any = sources.iter().filter(|(other, _)| below(other)).any(|(_, text)| runs(text.lines()));
            found.push((file.clone(), any));
        }
        if !file.starts_with(module) {
            continue;
        }
        for (i, line) in lines.iter().enumerate() {
            let defines = ["struct", "enum", "trait", "fn"].iter().any(|kind| {
                // a type may stand indented in a macro, an indented function is a method
                let line = if *kind == "fn" { line } else { line.trim_start() };
                let rest = line.strip_prefix(&format!("pub {kind} {item}"));
                rest.is_some_and(|rest| !rest.starts_with(|c: char| c.is_alphanumeric() || c == '_'))
            });
            if defines {
                let is_comment =
                    |line: &&&str| ["///", "#["].iter().any(|s| line.trim_start().starts_with(s));
                let first = i - lines[..i].iter().rev().take_while(is_comment).count();
                found.push((format!("{file}:{}", i + 1), runs(lines[first..i].iter().copied())));
            }
        }
    }
    found
}

#[test]
fn every_item_of_the_front_pages_has_an_example() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the package lies in the workspace");
    let (mut without, mut items, mut elsewhere) = (Vec::new(), 0, Vec::new());
    for name in CRATES {
        let folder = root.join("crates").join(name).join("src");
        let mut texts = Vec::new();
        sources(&folder, "", &mut texts);
        for item in named(&read(&folder.join("lib.rs"))) {
            items += 1;
            let found = examples(&texts, &item);
            if found.is_empty() {
                elsewhere.push(item);
            } else if !found.iter().any(|(_, example)| *example) {
                without.push(format!("{name}: {item} ({})", found[0].0));
            }
        }
    }
    assert!(without.is_empty(), "{} of {items} without an example:\n{}", without.len(), without.join("\n"));
    // defined in another of these crates, on whose page they are
    assert_eq!(elsewhere, ["Structure", "ObservationOperator"]);
}

#[test]
fn text_is_no_example() {
    let runs = |text: &str| runs(text.lines());
    assert!(!runs("/// ```text\n/// x\n/// ```") && !runs("/// words") && !runs("/// ```toml\n/// ```"));
    assert!(runs("/// ```\n/// f();\n/// ```") && runs("/// ```text\n/// ```\n/// ```\n/// f();\n/// ```"));
    let table = "//! | [`a::b`], [`mod@c`], [`d()`] | [`E::f`] | [`varda_x::G`] |\n//! [`H`]";
    assert_eq!(named(table), ["a::b", "c", "d", "E"].map(String::from).into());
}
