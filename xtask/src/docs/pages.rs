//! The pages of the package `guide` after rustdoc: links between .md files, pictures and tables beside the
//! pages, formulas.

use super::html::{self, external, normal, relative};
use super::{copy, read, write};
use crate::root;
use std::path::{Path, PathBuf};

/// A page: the Markdown it is made from, and its place below the top of the site.
pub(crate) struct Page {
    /// Relative to the top of the workspace.
    pub(crate) markdown: PathBuf,
    pub(crate) html: String,
}

const LIBRARY: &str = "docs/guide/src/lib.rs";
const KATEX: &str = "docs/guide/katex";

/// All pages, from the modules of the library.
pub(crate) fn list() -> Result<Vec<Page>, String> {
    let text = read(&root().join(LIBRARY))?;
    let folder = Path::new(LIBRARY).parent().unwrap_or(Path::new(""));
    let (mut found, mut modules, mut next) = (Vec::new(), vec!["guide".to_string()], None);
    let page = |modules: &[String], path: &str| Page {
        markdown: normal(&folder.join(path)),
        html: format!("{}/index.html", modules.join("/")),
    };
    for line in text.lines().map(str::trim) {
        let included = line.split_once("include_str!(\"").and_then(|(_, rest)| rest.split('"').next());
        if let Some(path) = included {
            match line.starts_with("#![") {
                true => found.push(page(&modules, path)),
                false => next = Some(path.to_string()),
            }
        } else if let Some(module) = line.strip_prefix("pub mod ") {
            let name = module.split([' ', '{']).next().unwrap_or(module).to_string();
            modules.push(name);
            if let Some(path) = next.take() {
                found.push(page(&modules, &path));
            }
            if module.ends_with("{}") {
                modules.pop();
            }
        } else if line == "}" {
            modules.pop();
        }
    }
    Ok(found)
}

/// Finishes all pages of the guide in the folder of the site.
pub(crate) fn finish(site: &Path) -> Result<(), String> {
    let pages = list()?;
    for page in &pages {
        let path = site.join(&page.html);
        let mut text = read(&path)?;
        text = linked(&text, page, &pages, site)?;
        text = with_formulas(&text, &relative(&page.html, "math")).replacen("</head>", TABLES, 1);
        write(&path, &text)?;
    }
    for file in super::links::pages_of(site)? {
        let path = site.join(file);
        let text = read(&path)?;
        let raised = with_scripts(&text);
        if raised != text {
            write(&path, &raised)?;
        }
    }
    for name in ["katex.js", "katex.css", "LICENSE"] {
        copy(&root().join(KATEX).join(name), &site.join("math").join(name))?;
    }
    write(&site.join("math/render.js"), RENDER)
}

/// Marked formulas, rendered once the page is there.
const RENDER: &str = "\
document.querySelectorAll('.formula').forEach(function (element) {
    var display = element.tagName === 'DIV';
    katex.render(element.textContent, element, { displayMode: display, throwOnError: false });
});
document.documentElement.dataset.formulas = 'rendered';
";

/// The page with links that lead somewhere: to pages for .md files, to copies for other files of docs.
fn linked(text: &str, page: &Page, pages: &[Page], site: &Path) -> Result<String, String> {
    let folder = page.markdown.parent().unwrap_or(Path::new(""));
    let mut out = String::with_capacity(text.len());
    let mut done = 0;
    for tag in html::tags(text) {
        let Some(range) = tag.attribute("href").or_else(|| tag.attribute("src")) else { continue };
        let link = &text[range.clone()];
        let (path, fragment) = link.split_once('#').map_or((link, ""), |(path, f)| (path, f));
        let file = normal(&folder.join(path));
        // Links of rustdoc's own are to files of the site; those of Markdown to files of the workspace.
        let ours =
            ["md", "svg", "csv", "png"].iter().any(|e| Path::new(path).extension().is_some_and(|x| x == *e));
        if external(link) || !ours || path.contains("static.files") {
            continue;
        }
        let target = match pages.iter().find(|p| p.markdown == file) {
            Some(target) => target.html.clone(),
            None if file == Path::new("README.md") => "index.html".to_string(),
            None if file.starts_with("docs") && root().join(&file).is_file() => {
                let place = Path::new("files").join(file.strip_prefix("docs").unwrap_or(&file));
                copy(&root().join(&file), &site.join(&place))?;
                place.display().to_string()
            }
            None => return Err(format!("{}: a link to {link}, which is no page", page.markdown.display())),
        };
        out.push_str(&text[done..range.start]);
        out.push_str(&relative(&page.html, &target));
        if !fragment.is_empty() {
            out.push('#');
            out.push_str(fragment);
        }
        done = range.end;
    }
    out.push_str(&text[done..]);
    Ok(out)
}

/// `` $`x`$ `` and blocks marked `math` as elements for KaTeX, which is asked for where there are any.
fn with_formulas(text: &str, katex: &str) -> String {
    let block = ("<div class=\"example-wrap\"><pre class=\"language-math\"><code>", "</code></pre></div>");
    let (text, blocks) = replaced(text, block, ("<div class=\"formula\">", "</div>"));
    let inline = ("$<code>", "</code>$");
    let (text, spans) = replaced(&text, inline, ("<span class=\"formula\">", "</span>"));
    if blocks + spans == 0 {
        return text;
    }
    let head = format!(
        "<link rel=\"stylesheet\" href=\"{katex}/katex.css\"><style>{STYLE}</style>\
         <script defer src=\"{katex}/katex.js\"></script>\
         <script defer src=\"{katex}/render.js\"></script></head>"
    );
    text.replacen("</head>", &head, 1)
}

/// Long formulas scroll in themselves, not the page.
const STYLE: &str = "div.formula{overflow-x:auto;overflow-y:hidden;padding:.2em 0}\
    td .katex,th .katex{white-space:nowrap}";

/// Words of code in a table stay whole on a narrow window; the table scrolls in itself.
const TABLES: &str = "<style>@media(max-width:700px){.docblock td \
    code{overflow-wrap:normal;word-break:normal}.docblock td{min-width:7em}}</style></head>";

/// `B^{1/2}` and `x_{k+1}` in running text as raised and lowered text.
fn with_scripts(text: &str) -> String {
    let (mut out, mut done) = (String::with_capacity(text.len()), 0);
    for range in html::prose(text) {
        let (raised, _) = replaced(&text[range.clone()], ("^{", "}"), ("<sup>", "</sup>"));
        let (both, _) = replaced(&raised, ("_{", "}"), ("<sub>", "</sub>"));
        out.push_str(&text[done..range.start]);
        out.push_str(&both);
        done = range.end;
    }
    out.push_str(&text[done..]);
    out
}

/// Every stretch between one pair of markers put between another; how many there were.
fn replaced(text: &str, from: (&str, &str), to: (&str, &str)) -> (String, usize) {
    let (mut out, mut rest, mut count) = (String::with_capacity(text.len()), text, 0);
    while let Some(start) = rest.find(from.0) {
        let inside = &rest[start + from.0.len()..];
        let Some(end) = inside.find(from.1) else { break };
        out.push_str(&rest[..start]);
        out.push_str(to.0);
        out.push_str(&inside[..end]);
        out.push_str(to.1);
        rest = &inside[end + from.1.len()..];
        count += 1;
    }
    out.push_str(rest);
    (out, count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formulas_are_marked_and_bring_their_scripts() {
        let page = "<head></head>a $<code>x_k</code>$ b \
                    <div class=\"example-wrap\"><pre class=\"language-math\">\
                    <code>y^2</code></pre></div> <code>$z</code>";
        let done = with_formulas(page, "../math");
        assert!(done.contains(
            "a <span class=\"formula\">x_k</span> b <div class=\"formula\">y^2</div> <code>$z</code>"
        ));
        assert!(done.contains("src=\"../math/katex.js\""));
        assert_eq!(with_formulas("<head></head>plain", "math"), "<head></head>plain");
    }

    #[test]
    fn powers_in_running_text_are_raised() {
        let done = with_scripts("<p>B^{1/2} v, <code>x^{2}</code>, M_{k+1}</p>");
        assert_eq!(done, "<p>B<sup>1/2</sup> v, <code>x^{2}</code>, M<sub>k+1</sub></p>");
    }

    #[test]
    fn every_page_has_its_markdown_once() {
        let pages = list().unwrap();
        assert!(pages.iter().any(|p| p.html == "guide/theory/rod/index.html"));
        for page in &pages {
            assert!(root().join(&page.markdown).is_file(), "{}", page.markdown.display());
            assert_eq!(pages.iter().filter(|p| p.markdown == page.markdown).count(), 1);
        }
    }
}
