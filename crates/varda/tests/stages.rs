//! Imports between the stages of varda go downwards only, and no crate of the workspace has a circle of
//! files.
//!
//! Read from the sources: `use` declarations and paths that begin with `crate::` or `super::`. A name that a
//! module only re-exports leads on to the file that defines it. Test modules do not count, nor does a
//! folder's `mod.rs` that calls into its own modules by their paths.

#![allow(clippy::print_stdout, clippy::print_stderr)]

mod support {
    pub(crate) mod imports;
}

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use support::imports::{Tree, circles};

/// From below to above: a stage may import from itself and from those before it.
const STAGES: [&str; 13] = [
    "error", "convert", "scene", "state", "outcome", "setup", "preview", "solve", "run", "sweep", "report",
    "cli", "lib",
];

/// The stage of a file: its folder, or its name.
fn stage(file: &str) -> usize {
    let name = file.split('/').next().unwrap_or(file).trim_end_matches(".rs");
    STAGES.iter().position(|s| *s == name).unwrap_or_else(|| panic!("{file} belongs to no stage"))
}

/// Numbers of imports from one stage to another.
fn between(tree: &Tree) -> BTreeMap<(usize, usize), usize> {
    let mut counts = BTreeMap::new();
    for (from, to) in tree.imports() {
        *counts.entry((stage(&from), stage(&to))).or_insert(0) += 1;
    }
    counts
}

/// The imports that go upwards.
fn upward(tree: &Tree) -> Vec<(String, String)> {
    tree.imports().into_iter().filter(|(from, to)| stage(to) > stage(from)).collect()
}

fn table(counts: &BTreeMap<(usize, usize), usize>) -> String {
    let header: String = STAGES.iter().map(|s| format!("{s:>8}")).collect();
    let mut text = format!("{:>14}{header}\n", "imports from:");
    for (i, name) in STAGES.iter().enumerate() {
        let cell = |j: usize| match counts.get(&(i, j)) {
            Some(n) => format!("{n:>8}"),
            None => format!("{:>8}", "."),
        };
        let cells: String = (0..STAGES.len()).map(cell).collect();
        text.push_str(&format!("{name:>14}{cells}\n"));
    }
    text
}

fn crates() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

#[test]
fn stages_import_downwards_only() {
    let tree = Tree::read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"));
    println!("{}", table(&between(&tree)));
    let upward = upward(&tree);
    assert!(upward.is_empty(), "upward imports: {upward:?}");
}

/// In every crate, the packages of tests and xtask included.
#[test]
fn no_crate_has_a_circle_of_files() {
    let root = crates().join("..");
    if !root.join("xtask").is_dir() {
        eprintln!("skipped: the other crates of the workspace are not here");
        return;
    }
    let mut folders = vec![root.join("tests/src"), root.join("xtask/src")];
    folders.extend(["problems", "bench"].map(|name| root.join("tests").join(name).join("src")));
    for entry in std::fs::read_dir(crates()).unwrap() {
        folders.push(entry.unwrap().path().join("src"));
    }
    let mut found = BTreeSet::new();
    for folder in folders.iter().filter(|f| f.is_dir()) {
        let tree = Tree::read(folder);
        let files: BTreeSet<String> = tree.imports().into_iter().map(|(from, _)| from).collect();
        println!("{}: {} files import others", folder.display(), files.len());
        for files in circles(&tree.imports()) {
            found.insert(format!("{}: {}", folder.display(), files.join(" -> ")));
        }
    }
    assert!(found.is_empty(), "circles of files: {found:#?}");
}

/// A made-up crate: its files by name.
fn made_up(files: &[(&str, &str)]) -> Tree {
    Tree::of(files.iter().map(|(name, text)| (name.to_string(), text.to_string())).collect())
}

#[test]
fn an_upward_import_and_a_circle_are_found() {
    let good = [
        ("lib.rs", "pub mod scene;\npub mod setup;\npub use scene::Scene;"),
        ("scene/mod.rs", "mod keys;\npub use keys::Key;\npub struct Scene;"),
        ("scene/keys.rs", "//! `crate::setup::Problem` in a comment is not an import.\npub struct Key;"),
        ("setup/mod.rs", "mod problem;\npub use problem::Problem;"),
        ("setup/problem.rs", "use crate::scene::{self, Key};\npub struct Problem(crate::scene::Scene, Key);"),
    ];
    let tree = made_up(&good);
    let imports = tree.imports();
    let expected = [("setup/problem.rs", "scene/keys.rs"), ("setup/problem.rs", "scene/mod.rs")];
    assert_eq!(imports, expected.map(|(a, b)| (a.to_string(), b.to_string())).into());
    assert!(upward(&tree).is_empty() && circles(&imports).is_empty());

    // The same with a path in the middle of the code that leads upwards, and so in a circle.
    let mut bad = good;
    bad[2].1 = "pub struct Key;\nfn f() { let _: Option<crate::setup::Problem> = None; }";
    let tree = made_up(&bad);
    assert_eq!(upward(&tree), [("scene/keys.rs".to_string(), "setup/problem.rs".to_string())]);
    assert_eq!(circles(&tree.imports()), [["scene/keys.rs", "setup/problem.rs", "scene/keys.rs"]]);

    // A circle inside one stage, by `super` and by a name that a module re-exports.
    let mut bad = good;
    bad[2].1 = "use super::Scene;\npub struct Key(Scene);";
    bad[1].1 = "mod keys;\npub use keys::Key;\npub struct Scene(Option<Box<Key>>);";
    let tree = made_up(&bad);
    assert!(upward(&tree).is_empty());
    assert_eq!(circles(&tree.imports()), [["scene/keys.rs", "scene/mod.rs", "scene/keys.rs"]]);

    // What only tests import does not count.
    let mut tested = good;
    tested[2].1 = "pub struct Key;\n#[cfg(test)]\nmod tests {\n    use crate::setup::Problem;\n}\n";
    assert!(upward(&made_up(&tested)).is_empty());
}
