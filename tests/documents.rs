//! Pages and comments agree: every citation has an entry in docs/references.md, and every numbered equation
//! of the paper an item in docs/notation.md that carries its tag.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the package lies in the workspace").to_path_buf()
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Files below a folder with one of these endings; build folders left out.
fn files(folder: &Path, endings: &[&str], found: &mut Vec<PathBuf>) {
    let entries = std::fs::read_dir(folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    for entry in entries {
        let path = entry.expect("an entry of a folder").path();
        if path.is_dir() {
            if path.file_name().is_none_or(|name| name != "target" && name != "out") {
                files(&path, endings, found);
            }
        } else if path.extension().and_then(|e| e.to_str()).is_some_and(|e| endings.contains(&e)) {
            found.push(path);
        }
    }
}

/// All sources, scenes and pages of the workspace, with their text.
fn texts() -> Vec<(PathBuf, String)> {
    let root = root();
    let mut found = vec![root.join("README.md")];
    for folder in ["crates", "tests", "xtask", "docs"] {
        files(&root.join(folder), &["rs", "md", "toml"], &mut found);
    }
    found.sort();
    found.into_iter().map(|path| (path.clone(), read(&path))).collect()
}

/// The running text of a file: whole for pages, else each block of comments in one line, code line by line.
fn prose(path: &Path, text: &str) -> String {
    let marker = match path.extension().and_then(|e| e.to_str()) {
        Some("rs") => "//",
        Some("toml") => "#",
        _ => return text.replace('\n', " "),
    };
    let mut prose = String::new();
    for line in text.lines() {
        match line.find(marker) {
            Some(at) => {
                prose.push_str(line[at..].trim_start_matches(['/', '!', '#']).trim());
                prose.push(' ');
            }
            // Code may hold citations in its texts.
            None => prose.push_str(&format!("\n{}\n", line.replace(['"', '\\'], " "))),
        }
    }
    prose
}

/// Surnames and year of every citation "A, B and C 1999", "A et al. (1999)", "A and B, 1999".
fn citations(prose: &str) -> BTreeSet<(Vec<String>, String)> {
    let mut found = BTreeSet::new();
    for line in prose.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        for (i, word) in words.iter().enumerate() {
            let digits = word.trim_start_matches('(');
            let year: String = digits.chars().take_while(char::is_ascii_digit).collect();
            let after = digits[year.len()..].chars().next();
            let plausible = year.len() == 4 && is_year(&year);
            if !plausible || after.is_some_and(|c| !",.;:)]*".contains(c)) {
                continue;
            }
            let names = names_before(&words[..i]);
            if !names.is_empty() {
                found.insert((names, year));
            }
        }
    }
    found
}

fn is_year(year: &str) -> bool {
    ["18", "19", "20"].iter().any(|century| year.starts_with(century))
}

/// The surnames that end just before a year.
fn names_before(words: &[&str]) -> Vec<String> {
    let mut names = Vec::new();
    let mut rest = words.len();
    if rest >= 2 && words[rest - 2] == "et" && words[rest - 1].starts_with("al.") {
        rest -= 2;
        return words[..rest].last().and_then(|w| surname(w)).into_iter().collect();
    }
    while rest > 0 {
        let word = words[rest - 1];
        let last = rest == words.len();
        if word == "and" && !last {
            rest -= 1;
            continue;
        }
        // "A, B and C": within the list a comma must follow, except before "and" and within a double name.
        let Some(name) = surname(word) else { break };
        let listed = last || word.ends_with(',') || words[rest] == "and" || words[rest - 1] == "Van";
        if !listed {
            break;
        }
        names.push(name);
        rest -= 1;
    }
    names.reverse();
    names
}

/// The word without brackets and commas, if it is a capitalised name.
fn surname(word: &str) -> Option<String> {
    let name = word.trim_matches(|c: char| !c.is_alphabetic());
    let name = name.strip_suffix("'s").unwrap_or(name);
    let mut letters = name.chars();
    let capital = letters.next().is_some_and(char::is_uppercase);
    let small = letters.next().is_some_and(char::is_lowercase);
    // Words before a number that is no year of a citation.
    let other =
        ["Adam", "Dundee", "May", "June", "July", "November", "December", "Seminar", "Press", "OOPSLA"];
    (capital && small && !other.contains(&name)).then(|| name.to_string())
}

#[test]
fn every_citation_has_an_entry_and_every_entry_is_cited() {
    let page = root().join("docs/references.md");
    let entries: Vec<String> = read(&page)
        .lines()
        .filter_map(|line| line.strip_prefix("- **")?.split("**").next().map(str::to_string))
        .collect();
    assert!(entries.len() > 50, "{} entries", entries.len());
    let mut cited = BTreeSet::new();
    let mut missing = BTreeMap::new();
    for (path, text) in texts() {
        // The page itself, changes by date, and this file's examples of the form.
        if path == page || path.ends_with("CHANGELOG.md") || path.ends_with("tests/documents.rs") {
            continue;
        }
        for (names, year) in citations(&prose(&path, &text)) {
            let entry = entries.iter().find(|entry| {
                let words: Vec<&str> = entry.split(|c: char| !c.is_alphanumeric()).collect();
                words.contains(&year.as_str())
                    && names.iter().all(|n| n.split('–').all(|n| words.contains(&n)))
            });
            match entry {
                Some(entry) => drop(cited.insert(entry.clone())),
                None => drop(missing.insert(format!("{} {year}", names.join(", ")), path.clone())),
            }
        }
    }
    assert!(missing.is_empty(), "not in docs/references.md: {missing:#?}");
    let unused: Vec<&String> = entries.iter().filter(|entry| !cited.contains(*entry)).collect();
    assert!(unused.is_empty(), "cited nowhere: {unused:#?}");
}

#[test]
fn citations_are_found_in_all_their_forms() {
    let names = |text: &str| -> Vec<(String, String)> {
        citations(text).into_iter().map(|(names, year)| (names.join("+"), year)).collect()
    };
    let one = |a: &str, year: &str| vec![(a.to_string(), year.to_string())];
    assert_eq!(
        names("(Courtier, Thépaut and Hollingsworth 1994; x)"),
        one("Courtier+Thépaut+Hollingsworth", "1994")
    );
    assert_eq!(names("as Gauss–Newton, Lawless et al. (2005): y"), one("Lawless", "2005"));
    assert_eq!(names("(Golub and Van Loan 2013, section 4)"), one("Golub+Van+Loan", "2013"));
    assert_eq!(names("Timoshenko and Goodier, 1970, §107"), one("Timoshenko+Goodier", "1970"));
    assert_eq!(names("in 1000 steps of 2000 members"), vec![]);
}
