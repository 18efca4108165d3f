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
                    && names.iter().all(|n| n.split(['–', '-']).all(|n| words.contains(&n)))
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

/// The numbers of the paper's equations.
fn numbered() -> BTreeSet<String> {
    let second = (1..=27).filter(|n| ![3, 4, 11, 14].contains(n)).map(|n| format!("2.{n}"));
    second.chain(["3.1", "3.2", "4.1", "5.1"].map(String::from)).collect()
}

/// Numbers of equations in tags such as "(paper 2.24, 2.25)" and "paper 2.10, 2.19 with …".
fn tags(prose: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for tag in prose.split("paper ").skip(1) {
        let mut rest = tag;
        while let Some(number) = leading_number(rest) {
            rest = &rest[number.len()..];
            found.insert(number.to_string());
            let separator = [", ", " and ", "; "].into_iter().find(|s| rest.starts_with(s));
            let Some(separator) = separator else { break };
            rest = &rest[separator.len()..];
        }
    }
    found
}

/// "2.15" at the start of a text.
fn leading_number(text: &str) -> Option<&str> {
    let length = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
    let number = text[..length].trim_end_matches('.');
    let (section, equation) = number.split_once('.')?;
    (section.len() == 1 && !equation.is_empty() && equation.len() <= 2).then_some(number)
}

/// The rows of the index: equation, item, file and name of the test.
fn index() -> Vec<[String; 4]> {
    let text = read(&root().join("docs/notation.md"));
    let start = text.find("## Index of the paper's equations").expect("the index has its heading");
    let section = text[start..].split("\n## ").next().unwrap_or("");
    let mut rows = Vec::new();
    for line in section.lines().filter(|line| leading_number(line.trim_start_matches("| ")).is_some()) {
        let cells: Vec<&str> = line.trim_matches('|').split(" | ").map(str::trim).collect();
        assert_eq!(cells.len(), 5, "{line}");
        let code = |cell: &str| -> Vec<String> {
            cell.split('`').skip(1).step_by(2).map(|text| text.trim_matches(['[', ']']).to_string()).collect()
        };
        let (item, test) = (code(cells[3]), code(cells[4]));
        assert_eq!((item.len(), test.len()), (1, 2), "{line}");
        rows.push([cells[0].to_string(), item[0].clone(), test[0].clone(), test[1].clone()]);
    }
    rows
}

/// The comments above every definition of an item of this name in a crate's sources.
fn documentation(crate_name: &str, item: &str) -> Vec<String> {
    let folder = crate_name.strip_prefix("varda_").unwrap_or(crate_name);
    let mut sources = Vec::new();
    files(&root().join("crates").join(folder).join("src"), &["rs"], &mut sources);
    let mut found = Vec::new();
    for source in sources {
        let text = read(&source);
        let mut comment = String::new();
        for line in text.lines().map(str::trim) {
            if let Some(words) = line.strip_prefix("///") {
                comment.push_str(words.trim());
                comment.push(' ');
            } else if !line.starts_with("#[") {
                let mut words = line
                    .split(|c: char| !c.is_alphanumeric() && c != '_')
                    .skip_while(|w| !["struct", "enum", "trait", "fn", "type", "const"].contains(w));
                if words.next().is_some() && words.next() == Some(item) {
                    found.push(comment.clone());
                }
                comment.clear();
            }
        }
    }
    found
}

#[test]
fn every_numbered_equation_has_an_item_that_carries_its_tag_and_a_test() {
    let rows = index();
    let listed: Vec<&String> = rows.iter().map(|row| &row[0]).collect();
    assert_eq!(listed.len(), 27, "one row an equation: {listed:?}");
    assert_eq!(listed.into_iter().cloned().collect::<BTreeSet<_>>(), numbered());
    let mut faults = Vec::new();
    for [equation, item, file, test] in &rows {
        let mut path = item.split("::");
        let (first, last) = (path.next().unwrap_or(""), path.last().unwrap_or(""));
        let found = documentation(first, last);
        if found.is_empty() {
            faults.push(format!("{equation}: no definition of {item}"));
        } else if !found.iter().any(|comment| tags(comment).contains(equation)) {
            faults.push(format!("{equation}: {item} is not tagged (paper {equation})"));
        }
        let file = root().join(file);
        if !file.is_file() || !read(&file).contains(&format!("fn {test}(")) {
            faults.push(format!("{equation}: no test {test} in {}", file.display()));
        }
    }
    assert!(faults.is_empty(), "{faults:#?}");
}

#[test]
fn every_tag_in_the_code_is_in_the_index() {
    let known = numbered();
    let mut faults = Vec::new();
    let mut count = 0;
    for (path, text) in texts() {
        if path.extension().is_some_and(|e| e == "rs") && !path.ends_with("tests/documents.rs") {
            for tag in tags(&prose(&path, &text)) {
                count += 1;
                if !known.contains(&tag) {
                    faults.push(format!("{}: {tag}", path.display()));
                }
            }
        }
    }
    assert!(count > 20, "{count} tags");
    assert!(
        faults.is_empty(),
        "no such equation (a section is cited as \"paper, section 2.5\"): {faults:#?}"
    );
}

#[test]
fn tags_are_read_in_all_their_forms() {
    let set = |numbers: &[&str]| numbers.iter().map(|n| n.to_string()).collect::<BTreeSet<_>>();
    assert_eq!(tags("(paper 2.24, 2.25)"), set(&["2.24", "2.25"]));
    assert_eq!(tags("(paper 2.10 and 2.19; Courtier 1997)"), set(&["2.10", "2.19"]));
    assert_eq!(tags("as in the paper, section 3.1, and in a paper 3 pages long"), set(&[]));
}
