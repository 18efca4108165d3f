//! Dependencies, offline: every licence is one that deny.toml allows, every source is crates.io, and no crate draws in what it does not need.

use std::collections::BTreeSet;

use crate::{cargo, root};

/// What a crate does without, built alone with its default features.
const WITHOUT: [(&str, &[&str]); 5] = [
    ("varda-covariance", &["nalgebra", "rayon", "serde"]),
    ("varda-implicit", &["nalgebra", "rayon", "rand", "serde"]),
    ("varda-rod", &["nalgebra", "rayon", "rand", "serde"]),
    ("varda-assimilation", &["nalgebra", "ndarray", "argmin", "serde", "varda-rod"]),
    ("varda", &["nalgebra", "ndarray", "argmin"]),
];

const CRATES_IO: &str = "registry+https://github.com/rust-lang/crates.io-index";

pub(crate) fn check() -> Result<(), String> {
    let read = |name: &str| std::fs::read_to_string(root().join(name)).map_err(|e| format!("{name}: {e}"));
    let allowed = allowed(&read("deny.toml")?)?;
    sources(&read("Cargo.lock")?)?;
    for (package, without) in WITHOUT {
        let text = tree(&["-p", package, "-e", "normal", "--format", "{p}"])?;
        if let Some(drawn) = text.lines().filter_map(|l| l.split(' ').next()).find(|p| without.contains(p)) {
            return Err(format!("{package} draws in {drawn}, which it did without"));
        }
    }
    let text = tree(&["--workspace", "--target", "all", "--format", "{l}\t{p}"])?;
    let packages: BTreeSet<&str> =
        text.lines().map(|l| l.trim_end_matches(" (*)")).filter(|l| !l.is_empty()).collect();
    for line in &packages {
        let (license, package) = line.split_once('\t').unwrap_or(("", line));
        if !permits(license, &allowed) {
            return Err(format!("{package}: the licence {license:?} is not among {allowed:?} (deny.toml)"));
        }
    }
    println!("{} packages: licences among {}, sources crates.io", packages.len(), allowed.join(", "));
    Ok(())
}

/// The lines of `cargo tree`.
fn tree(arguments: &[&str]) -> Result<String, String> {
    let tree = ["tree", "--offline", "--locked", "--prefix", "none"];
    let output = cargo().args(tree).args(arguments).current_dir(root()).output();
    let output = output.map_err(|e| format!("cargo tree: {e}"))?;
    if !output.status.success() {
        return Err(format!("cargo tree: {}", String::from_utf8_lossy(&output.stderr)));
    }
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

/// The licences of deny.toml's `allow = ["…"]`.
fn allowed(deny: &str) -> Result<Vec<String>, String> {
    let line =
        deny.lines().find_map(|l| l.strip_prefix("allow = [")).ok_or("deny.toml: no line allow = [")?;
    Ok(line.trim_end_matches(']').split(',').map(|l| l.trim().trim_matches('"').to_string()).collect())
}

/// Every package of Cargo.lock that has a source has that of crates.io, and a checksum.
fn sources(lock: &str) -> Result<(), String> {
    for package in lock.split("[[package]]").skip(1) {
        let value = |key: &str| {
            package
                .lines()
                .find_map(|l| l.strip_prefix(key)?.strip_prefix(" = "))
                .map(|v| v.trim_matches('"'))
        };
        let name = value("name").unwrap_or("a package");
        match value("source") {
            None => {}
            Some(CRATES_IO) if value("checksum").is_some() => {}
            Some(source) => {
                return Err(format!("{name}: its source is {source}, not crates.io with a checksum"));
            }
        }
    }
    Ok(())
}

/// Whether an SPDX expression (A OR B, A AND B, brackets; `/` is an old OR) can be met by the allowed licences. An exception only permits more.
fn permits(expression: &str, allowed: &[String]) -> bool {
    let text = expression.replace('/', " OR ").replace('(', " ( ").replace(')', " ) ");
    let words: Vec<&str> = text.split_whitespace().collect();
    let mut at = 0;
    any(&words, &mut at, allowed) && at == words.len()
}

fn any(words: &[&str], at: &mut usize, allowed: &[String]) -> bool {
    let mut good = all(words, at, allowed);
    while words.get(*at) == Some(&"OR") {
        *at += 1;
        good |= all(words, at, allowed);
    }
    good
}

fn all(words: &[&str], at: &mut usize, allowed: &[String]) -> bool {
    let mut good = one(words, at, allowed);
    while words.get(*at) == Some(&"AND") {
        *at += 1;
        good &= one(words, at, allowed);
    }
    good
}

fn one(words: &[&str], at: &mut usize, allowed: &[String]) -> bool {
    let Some(word) = words.get(*at) else { return false };
    *at += 1;
    if *word == "(" {
        let good = any(words, at, allowed);
        *at += 1;
        return good && words.get(*at - 1) == Some(&")");
    }
    if words.get(*at) == Some(&"WITH") {
        *at += 2;
    }
    allowed.iter().any(|a| a == word)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn licences_are_read_as_expressions() {
        let allowed = allowed("allow = [\"MIT\", \"Apache-2.0\", \"Unicode-3.0\"]").unwrap();
        for good in [
            "MIT",
            "GPL-3.0 OR MIT",
            "Unlicense/MIT",
            "(MIT OR X) AND Unicode-3.0",
            "Apache-2.0 WITH LLVM-exception",
        ] {
            assert!(permits(good, &allowed), "{good}");
        }
        for bad in ["", "GPL-3.0", "MIT AND GPL-3.0", "(MIT OR X) AND Y", "(MIT", "MIT)"] {
            assert!(!permits(bad, &allowed), "{bad}");
        }
    }

    #[test]
    fn another_source_is_refused_by_name() {
        let package =
            |source: &str| format!("[[package]]\nname = \"a\"\nsource = \"{source}\"\nchecksum = \"1\"\n");
        assert_eq!(sources(&package(CRATES_IO)), Ok(()));
        assert!(sources(&package("git+https://example.com/a")).unwrap_err().starts_with("a: "));
    }
}
