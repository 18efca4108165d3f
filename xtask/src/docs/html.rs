//! As much of HTML as the pages of rustdoc need.

use std::ops::Range;
use std::path::{Component, Path, PathBuf};

/// A tag: its bytes in the text, brackets included, and where the values of its attributes are.
pub(crate) struct Tag {
    pub(crate) range: Range<usize>,
    pub(crate) attributes: Vec<(String, Range<usize>)>,
}

impl Tag {
    /// Where the value of an attribute is.
    pub(crate) fn attribute(&self, name: &str) -> Option<Range<usize>> {
        self.attributes.iter().find(|(n, _)| n == name).map(|(_, value)| value.clone())
    }
}

/// All opening and closing tags in order; the contents of scripts and styles are passed over.
pub(crate) fn tags(text: &str) -> Vec<Tag> {
    let bytes = text.as_bytes();
    let mut found = Vec::new();
    let mut at = 0;
    while let Some(start) = text[at..].find('<').map(|i| at + i) {
        if text[start..].starts_with("<!--") {
            at = text[start..].find("-->").map_or(text.len(), |i| start + i + 3);
            continue;
        }
        let (mut i, mut attributes) = (start + 1, Vec::new());
        let mut word = start + 1;
        while i < bytes.len() && bytes[i] != b'>' {
            match bytes[i] {
                quote @ (b'"' | b'\'') => {
                    let end = text[i + 1..].find(quote as char).map_or(text.len(), |j| i + 1 + j);
                    attributes.push((text[word..i].trim_end_matches('=').to_string(), i + 1..end));
                    i = (end + 1).min(text.len());
                    word = i;
                }
                b' ' | b'\n' => {
                    i += 1;
                    word = i;
                }
                _ => i += 1,
            }
        }
        let end = (i + 1).min(text.len());
        at = end;
        for raw in ["script", "style"] {
            if text[start + 1..].starts_with(raw) {
                let close = format!("</{raw}>");
                at = text[end..].find(&close).map_or(text.len(), |j| end + j);
            }
        }
        found.push(Tag { range: start..end, attributes });
    }
    found
}

/// `&amp;` and its like as characters, `%20` and its like as bytes.
pub(crate) fn decoded(link: &str) -> String {
    let plain = link.replace("&lt;", "<").replace("&gt;", ">").replace("&quot;", "\"").replace("&#39;", "'");
    let plain = plain.replace("&amp;", "&");
    let bytes = plain.as_bytes();
    let (mut out, mut i) = (Vec::new(), 0);
    while i < bytes.len() {
        let hex = |j: usize| bytes.get(j).and_then(|b| (*b as char).to_digit(16));
        match (bytes[i], hex(i + 1), hex(i + 2)) {
            (b'%', Some(high), Some(low)) => {
                out.push((16 * high + low) as u8);
                i += 3;
            }
            (byte, ..) => {
                out.push(byte);
                i += 1;
            }
        }
    }
    String::from_utf8_lossy(&out).into_owned()
}

/// A path without `.` and `..`.
pub(crate) fn normal(path: &Path) -> PathBuf {
    let mut out = PathBuf::new();
    for part in path.components() {
        match part {
            Component::CurDir => {}
            Component::ParentDir => {
                out.pop();
            }
            part => out.push(part),
        }
    }
    out
}

/// The way from the page `from` to the file `to`, both relative to the top of the site.
pub(crate) fn relative(from: &str, to: &str) -> String {
    "../".repeat(from.matches('/').count()) + to
}

/// Whether a link leads out of the site, or nowhere.
pub(crate) fn external(link: &str) -> bool {
    ["http://", "https://", "mailto:", "data:", "javascript:"].iter().any(|scheme| link.starts_with(scheme))
}

/// Stretches of text between tags that are neither code nor scripts nor formulas.
pub(crate) fn prose(text: &str) -> Vec<Range<usize>> {
    const SILENT: [&str; 5] = ["code", "pre", "script", "style", "title"];
    let tags = tags(text);
    let (mut found, mut depth) = (Vec::new(), 0_i32);
    for (i, tag) in tags.iter().enumerate() {
        let inside = &text[tag.range.clone()];
        let name = inside.trim_start_matches(['<', '/']);
        let name: String = name.chars().take_while(char::is_ascii_alphanumeric).collect();
        if SILENT.contains(&name.as_str()) {
            depth += if inside.starts_with("</") { -1 } else { 1 };
        }
        let formula = tag.attribute("class").is_some_and(|range| &text[range] == "formula");
        let end = tags.get(i + 1).map_or(text.len(), |next| next.range.start);
        if depth == 0 && !formula && tag.range.end < end {
            found.push(tag.range.end..end);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attributes_are_found_and_scripts_passed_over() {
        let text =
            r#"<p id="a" title='x > "y"'>1 < 2 <script>if (a<b) "href=c"</script><a class=d href="e#f">"#;
        let tags = tags(text);
        let values = |name| -> Vec<&str> {
            tags.iter().filter_map(|t| t.attribute(name)).map(|range| &text[range]).collect()
        };
        assert_eq!(values("id"), ["a"]);
        assert_eq!(values("title"), ["x > \"y\""]);
        assert_eq!(values("href"), ["e#f"]);
    }

    #[test]
    fn paths_and_links() {
        assert_eq!(relative("guide/theory/rod/index.html", "math/katex.js"), "../../../math/katex.js");
        assert_eq!(normal(Path::new("docs/guide/../theory/./a.md")), Path::new("docs/theory/a.md"));
        assert_eq!(decoded("a%20b&amp;c%zz"), "a b&c%zz");
    }
}
