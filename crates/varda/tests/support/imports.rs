//! Imports between the files of a crate, read from its sources.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::Path;

/// The files of a crate.
pub(crate) struct Tree {
    /// Their code by name, relative to `src`; comments, strings and test modules left out.
    files: BTreeMap<String, String>,
    /// The module of each file.
    modules: BTreeMap<Vec<String>, String>,
}

impl Tree {
    /// Reads the files of a `src` folder.
    pub(crate) fn read(src: &Path) -> Tree {
        let mut files = BTreeMap::new();
        let mut open = vec![src.to_path_buf()];
        while let Some(folder) = open.pop() {
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    open.push(path);
                } else if path.extension().is_some_and(|e| e == "rs") {
                    let name = path.strip_prefix(src).unwrap().to_string_lossy().replace('\\', "/");
                    files.insert(name, std::fs::read_to_string(&path).unwrap());
                }
            }
        }
        Tree::of(files)
    }

    /// A crate of these files.
    pub(crate) fn of(files: BTreeMap<String, String>) -> Tree {
        // A library's program is a crate of its own, which imports the library by its name.
        let is_program = |name: &str| name == "main.rs" && files.contains_key("lib.rs");
        let files: BTreeMap<String, String> =
            files.clone().into_iter().filter(|(name, _)| !is_program(name)).collect();
        // A module that exists for tests alone, in a file of its own, does not count either.
        let for_tests: BTreeSet<Vec<String>> = files
            .iter()
            .flat_map(|(name, text)| {
                let at = module(name);
                test_modules(text).into_iter().map(move |m| [at.clone(), vec![m]].concat())
            })
            .collect();
        let files: BTreeMap<String, String> = files
            .into_iter()
            .filter(|(name, _)| {
                let at = module(name);
                !for_tests.iter().any(|t| at.starts_with(t))
            })
            .map(|(name, text)| (name, code(&text)))
            .collect();
        let modules = files.keys().map(|name| (module(name), name.clone())).collect();
        Tree { files, modules }
    }

    /// Every pair (file, another file that it imports from).
    pub(crate) fn imports(&self) -> BTreeSet<(String, String)> {
        let mut all = BTreeSet::new();
        for (name, text) in &self.files {
            let here = module(name);
            let (uses, rest) = declarations(text);
            for path in uses.iter().filter(|u| !u.is_public || names_word(&rest, &u.name)) {
                self.add(name, &here, &path.path, &mut all);
            }
            // A call into a module below by its path, `child::f()`, is how a folder's front dispatches: not
            // an import.
            let starts = ["crate::", "super::"].into_iter();
            for path in starts.flat_map(|start| paths(&rest, start)) {
                self.add(name, &here, &path, &mut all);
            }
        }
        all
    }

    fn add(&self, from: &str, here: &[String], path: &[String], all: &mut BTreeSet<(String, String)>) {
        if let Some(to) = self.file_of(here, path, 0)
            && to != from
        {
            all.insert((from.to_string(), to));
        }
    }

    /// The file in which a path, written in a module, ends.
    fn file_of(&self, here: &[String], path: &[String], depth: usize) -> Option<String> {
        let mut at = here.to_vec();
        let mut parts = path.iter();
        let mut rest: Vec<String> = Vec::new();
        match parts.next().map(String::as_str) {
            Some("crate") => at.clear(),
            Some("self") => {}
            Some("super") => {
                at.pop();
            }
            // A child of this module, or another crate.
            Some(first) if self.modules.contains_key(&[here, &[first.to_string()]].concat()) => {
                at.push(first.to_string());
            }
            _ => return None,
        }
        for part in parts {
            let below = [at.as_slice(), std::slice::from_ref(part)].concat();
            if part == "super" && rest.is_empty() {
                at.pop();
            } else if part == "self" && rest.is_empty() {
            } else if rest.is_empty() && self.modules.contains_key(&below) {
                at = below;
            } else {
                rest.push(part.clone());
            }
        }
        let file = self.modules.get(&at)?;
        let Some(name) = rest.first() else { return Some(file.clone()) };
        // A name that this module only hands on is defined elsewhere.
        if depth < 8 {
            let (uses, _) = declarations(&self.files[file]);
            for handed_on in uses.iter().filter(|u| u.is_public && (u.name == *name || u.name == "*")) {
                if let Some(to) = self.file_of(&at, &handed_on.path, depth + 1) {
                    return Some(to);
                }
            }
        }
        Some(file.clone())
    }
}

/// Circles of files, each from its first file back to it: the shortest one through every file that is in one.
pub(crate) fn circles(imports: &BTreeSet<(String, String)>) -> Vec<Vec<String>> {
    let starts: BTreeSet<&String> = imports.iter().map(|(from, _)| from).collect();
    let mut found: BTreeMap<BTreeSet<String>, Vec<String>> = BTreeMap::new();
    for files in starts.into_iter().filter_map(|start| circle_through(start, imports)) {
        found.entry(files.iter().cloned().collect()).or_insert(files);
    }
    found.into_values().collect()
}

/// The shortest circle through a file, found breadth first.
fn circle_through(start: &String, imports: &BTreeSet<(String, String)>) -> Option<Vec<String>> {
    let mut before: BTreeMap<&String, &String> = BTreeMap::new();
    let mut open = VecDeque::from([start]);
    while let Some(file) = open.pop_front() {
        for (_, to) in imports.iter().filter(|(from, _)| from == file) {
            if to == start {
                let mut files = vec![start.clone()];
                let mut at = file;
                while at != start {
                    files.push(at.clone());
                    at = before[at];
                }
                files.push(start.clone());
                files.reverse();
                return Some(files);
            }
            if !before.contains_key(to) {
                before.insert(to, file);
                open.push_back(to);
            }
        }
    }
    None
}

/// The module of a file: `run/cycles.rs` is run::cycles, `run/mod.rs` is run, `lib.rs` the crate itself.
fn module(file: &str) -> Vec<String> {
    let mut parts: Vec<String> = file.trim_end_matches(".rs").split('/').map(String::from).collect();
    if parts.last().is_some_and(|p| p == "mod") || matches!(&parts[..], [p] if p == "lib" || p == "main") {
        parts.pop();
    }
    parts
}

/// One name of a `use` declaration.
struct Use {
    is_public: bool,
    /// The name it brings, `*` for all.
    name: String,
    path: Vec<String>,
}

/// The `use` declarations of a file, and its other code.
fn declarations(text: &str) -> (Vec<Use>, String) {
    let (mut uses, mut rest) = (Vec::new(), String::new());
    let mut left = text;
    while let Some(at) = find_use(left) {
        let (before, tail) = left.split_at(at);
        let end = tail.find(';').map_or(tail.len(), |i| i + 1);
        let last_line = before.rsplit('\n').next().unwrap_or("");
        let is_public = last_line.trim_start().starts_with("pub");
        let body = tail["use ".len()..end].trim_end_matches(';');
        flatten(&[], &body.split_whitespace().collect::<Vec<_>>().join(" "), is_public, &mut uses);
        rest.push_str(before);
        left = &tail[end..];
    }
    rest.push_str(left);
    (uses, rest)
}

/// Where a `use` declaration begins: at the start of a line, or after `pub` or `pub(…)`.
fn find_use(text: &str) -> Option<usize> {
    text.match_indices("use ").map(|(i, _)| i).find(|i| {
        let before = text[..*i].rsplit('\n').next().unwrap_or("").trim();
        before.is_empty() || before.starts_with("pub") && !before.contains(['{', ';'])
    })
}

/// `a::{b, c as d}` as the paths a::b and a::c.
fn flatten(prefix: &[String], text: &str, is_public: bool, uses: &mut Vec<Use>) {
    let text = text.trim();
    if let Some(open) = text.find('{') {
        let head = text[..open].trim().trim_end_matches("::");
        let mut prefix = prefix.to_vec();
        prefix.extend(head.split("::").map(str::trim).filter(|p| !p.is_empty()).map(String::from));
        let inner = &text[open + 1..text.rfind('}').unwrap_or(text.len())];
        let (mut depth, mut from) = (0, 0);
        for (i, c) in inner.char_indices().chain([(inner.len(), ',')]) {
            match c {
                '{' => depth += 1,
                '}' => depth -= 1,
                ',' if depth == 0 => {
                    if !inner[from..i].trim().is_empty() {
                        flatten(&prefix, &inner[from..i], is_public, uses);
                    }
                    from = i + 1;
                }
                _ => {}
            }
        }
        return;
    }
    let (path, name) = text.split_once(" as ").map_or((text, None), |(p, n)| (p, Some(n.trim())));
    let mut all = prefix.to_vec();
    all.extend(path.split("::").map(|p| p.trim().to_string()).filter(|p| !p.is_empty()));
    if all.last().is_some_and(|p| p == "self") {
        all.pop();
    }
    let Some(last) = all.last().cloned() else { return };
    let name = name.map_or(last, String::from);
    if all.last().is_some_and(|p| p == "*") {
        all.pop();
    }
    uses.push(Use { is_public, name, path: all });
}

/// Paths in code that begin with `start`.
fn paths(text: &str, start: &str) -> Vec<Vec<String>> {
    let is_word = |c: char| c.is_alphanumeric() || c == '_' || c == ':' || c == '$';
    let is_part = |c: char| c.is_alphanumeric() || c == '_' || c == ':';
    text.match_indices(start)
        .filter(|(i, _)| !text[..*i].chars().next_back().is_some_and(is_word))
        .map(|(i, _)| {
            let path: String = text[i..].chars().take_while(|c| is_part(*c)).collect();
            path.split("::").filter(|p| !p.is_empty()).map(String::from).collect()
        })
        .collect()
}

/// Whether a word stands in code.
fn names_word(text: &str, word: &str) -> bool {
    let is_part = |c: char| c.is_alphanumeric() || c == '_';
    text.match_indices(word).any(|(i, _)| {
        let before = text[..i].chars().next_back();
        let after = text[i + word.len()..].chars().next();
        !before.is_some_and(is_part) && !after.is_some_and(is_part)
    })
}

/// Names of the modules that are declared for tests alone, in files of their own.
fn test_modules(text: &str) -> Vec<String> {
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    let pairs = lines.windows(2).filter(|w| w[0].starts_with("#[cfg(test)]"));
    pairs.filter_map(|w| Some(w[1].strip_prefix("mod ")?.strip_suffix(';')?.to_string())).collect()
}

/// The code of a file without comments, without the contents of strings, and without its test modules.
fn code(text: &str) -> String {
    let mut out = String::new();
    let mut skipping: Option<i64> = None;
    let mut depth = 0;
    let mut is_test = false;
    for line in without_comments(text).lines() {
        let open = line.matches('{').count() as i64 - line.matches('}').count() as i64;
        if let Some(until) = skipping {
            depth += open;
            if depth <= until {
                skipping = None;
            }
            continue;
        }
        if line.trim().starts_with("#[cfg(test)]") {
            is_test = true;
            continue;
        }
        if is_test && !line.trim().starts_with('#') {
            is_test = false;
            if open > 0 {
                skipping = Some(depth);
                depth += open;
            }
            continue;
        }
        depth += open;
        out.push_str(line);
        out.push('\n');
    }
    out
}

fn without_comments(text: &str) -> String {
    let mut out = String::new();
    let bytes: Vec<char> = text.chars().collect();
    let mut i = 0;
    let at = |i: usize| bytes.get(i).copied().unwrap_or('\0');
    while i < bytes.len() {
        match (at(i), at(i + 1)) {
            ('/', '/') => {
                while i < bytes.len() && at(i) != '\n' {
                    i += 1;
                }
            }
            ('/', '*') => {
                while i < bytes.len() && !(at(i) == '*' && at(i + 1) == '/') {
                    i += 1;
                }
                i += 2;
            }
            ('r', '"') | ('r', '#') if !(i > 0 && (at(i - 1).is_alphanumeric() || at(i - 1) == '_')) => {
                let mut hashes = 0;
                while at(i + 1 + hashes) == '#' {
                    hashes += 1;
                }
                if at(i + 1 + hashes) != '"' {
                    out.push('r');
                    i += 1;
                    continue;
                }
                i += 2 + hashes;
                while i < bytes.len() && !(at(i) == '"' && (0..hashes).all(|h| at(i + 1 + h) == '#')) {
                    i += 1;
                }
                i += 1 + hashes;
                out.push_str("\"\"");
            }
            ('"', _) => {
                i += 1;
                while i < bytes.len() && at(i) != '"' {
                    i += if at(i) == '\\' { 2 } else { 1 };
                }
                i += 1;
                out.push_str("\"\"");
            }
            // A quote, a brace or a slash as a character.
            ('\'', '\\') => {
                i += 3;
                while i < bytes.len() && at(i) != '\'' {
                    i += 1;
                }
                i += 1;
            }
            ('\'', _) if at(i + 2) == '\'' => i += 3,
            (c, _) => {
                out.push(c);
                i += 1;
            }
        }
    }
    out
}
