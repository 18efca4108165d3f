//! Links and anchors of all pages, and formulas in the text of pages that have no KaTeX.

use super::html::{self, decoded, external, normal};
use super::read;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// What is wrong: links to files or anchors that do not exist, raw TeX in running text.
pub(crate) fn check(site: &Path) -> Result<Vec<String>, String> {
    let mut pages = BTreeMap::new();
    for file in pages_of(site)? {
        let text = read(&site.join(&file))?;
        pages.insert(file, text);
    }
    if pages.len() < 50 {
        return Err(format!("{}: only {} pages", site.display(), pages.len()));
    }
    let anchors: BTreeMap<&PathBuf, BTreeSet<String>> =
        pages.iter().map(|(file, text)| (file, anchors(&site.join(file), text))).collect();
    let (mut faults, mut links) = (BTreeSet::new(), 0);
    for (file, text) in &pages {
        let mut tell = |what: String| {
            faults.insert(format!("{}: {what}", file.display()));
        };
        for tag in html::tags(text) {
            for name in ["href", "src"] {
                let Some(link) = tag.attribute(name).map(|range| &text[range]) else { continue };
                if external(link) || link.is_empty() {
                    continue;
                }
                links += 1;
                if let Err(what) = resolve(site, file, link, &anchors) {
                    tell(what);
                }
            }
        }
        if let Some(raw) = raw_formula(text) {
            tell(format!("raw formula in the text: {raw}"));
        }
    }
    println!("{} pages, {links} links, {} faults", pages.len(), faults.len());
    Ok(faults.into_iter().collect())
}

/// All pages of the site, relative to its top.
pub(crate) fn pages_of(site: &Path) -> Result<Vec<PathBuf>, String> {
    let mut found = Vec::new();
    let mut folders = vec![PathBuf::new()];
    while let Some(folder) = folders.pop() {
        let path = site.join(&folder);
        let entries = std::fs::read_dir(&path).map_err(|e| format!("{}: {e}", path.display()))?;
        for entry in entries {
            let entry = entry.map_err(|e| format!("{}: {e}", path.display()))?;
            let relative = folder.join(entry.file_name());
            if entry.path().is_dir() {
                folders.push(relative);
            } else if relative.extension().is_some_and(|e| e == "html") {
                found.push(relative);
            }
        }
    }
    Ok(found)
}

/// The anchors of a page, or of the page it sends its readers to.
fn anchors(file: &Path, text: &str) -> BTreeSet<String> {
    let tags = html::tags(text);
    let sent = tags.iter().find(|tag| tag.attribute("http-equiv").is_some_and(|r| &text[r] == "refresh"));
    let target =
        sent.and_then(|tag| tag.attribute("content")).and_then(|r| text[r].split_once("URL=").map(|s| s.1));
    if let Some(target) = target {
        let target = normal(&file.parent().unwrap_or(Path::new("")).join(decoded(target)));
        // A page that is missing is told of by the link to it.
        return read(&target).map(|text| anchors(&target, &text)).unwrap_or_default();
    }
    tags.iter().filter_map(|tag| tag.attribute("id")).map(|range| decoded(&text[range])).collect()
}

/// Whether a link of a page leads to a file, and an anchor in it.
fn resolve(
    site: &Path,
    from: &Path,
    link: &str,
    anchors: &BTreeMap<&PathBuf, BTreeSet<String>>,
) -> Result<(), String> {
    let link = decoded(link);
    let (path, fragment) = link.split_once('#').map_or((link.as_str(), ""), |(path, f)| (path, f));
    let path = path.split('?').next().unwrap_or(path);
    let mut file = match path {
        "" => from.to_path_buf(),
        path => normal(&from.parent().unwrap_or(Path::new("")).join(path)),
    };
    if site.join(&file).is_dir() {
        file.push("index.html");
    }
    // A list of implementations in other crates, which rustdoc asks for whether or not there are some.
    if file.starts_with("trait.impl") {
        return Ok(());
    }
    if !site.join(&file).is_file() {
        return Err(format!("no file for the link {link}"));
    }
    // Lines of sources are marked by a script.
    if fragment.is_empty() || file.starts_with("src") {
        return Ok(());
    }
    match anchors.get(&file) {
        Some(ids) if !ids.contains(fragment) => Err(format!("no anchor for the link {link}")),
        _ => Ok(()),
    }
}

/// The first stretch of text outside code, scripts and marked formulas that has `$` or `^{` in it.
fn raw_formula(text: &str) -> Option<String> {
    let mut stretches = html::prose(text).into_iter().map(|range| &text[range]);
    let raw = stretches.find(|stretch| stretch.contains('$') || stretch.contains("^{"))?;
    Some(raw.trim().chars().take(80).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn raw_formulas_are_found_outside_code_only() {
        assert_eq!(raw_formula("<p>a <code>$x</code> <span class=\"formula\">x^{2}</span> b</p>"), None);
        assert_eq!(raw_formula("<p>costs $`x`$</p>").as_deref(), Some("costs $`x`$"));
        assert_eq!(raw_formula("<p>x^{2}</p>").as_deref(), Some("x^{2}"));
    }

    #[test]
    fn links_need_their_file_and_anchor() {
        let site = std::env::temp_dir().join(format!("varda-links-{}", std::process::id()));
        std::fs::create_dir_all(site.join("a")).unwrap();
        std::fs::write(site.join("a/index.html"), "<p id=\"here\">").unwrap();
        let file = PathBuf::from("a/index.html");
        let known = BTreeMap::from([(&file, BTreeSet::from(["here".to_string()]))]);
        let from = Path::new("index.html");
        assert_eq!(resolve(&site, from, "a#here", &known), Ok(()));
        assert!(resolve(&site, from, "a/index.html#there", &known).is_err());
        assert!(resolve(&site, from, "b.html", &known).is_err());
        std::fs::remove_dir_all(&site).unwrap();
    }
}
