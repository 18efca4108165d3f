//! A TOML document as a tree in which every key and value knows where it was written.

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::place::Place;
use crate::Error;

/// A value and where it was written.
#[derive(Debug, Clone)]
pub(super) struct Node {
    pub(super) place: Place,
    pub(super) value: Value,
}

/// A TOML value.
#[derive(Debug, Clone)]
pub(super) enum Value {
    Table(Vec<Entry>),
    Array(Vec<Node>),
    String(String),
    Integer(i64),
    Float(f64),
    Boolean(bool),
    Datetime,
}

/// A key of a table.
#[derive(Debug, Clone)]
pub(super) struct Entry {
    pub(super) key: String,
    pub(super) place: Place,
    pub(super) node: Node,
}

/// Parses a document; `label` is its name in messages.
pub(super) fn parse(label: &str, text: &str) -> Result<Node, Error> {
    let lines = Lines::new(text);
    let place = |span: std::ops::Range<usize>| lines.place(span.start);
    let table = DeTable::parse(text).map_err(|e| {
        let at = e.span().map(place);
        Error::Scene {
            place: at.as_ref().map_or(label.to_string(), |at| format!("{label}:{at}")),
            message: format!("not TOML: {}", e.message().replace('\n', ", ")),
            excerpt: at.map_or(String::new(), |at| at.excerpt(text)),
        }
    })?;
    let value = convert_table(table.get_ref(), &place);
    Ok(Node { place: Place::Text { line: 1, column: 1 }, value })
}

/// Calls a key of a table by its other name.
///
/// # Errors
/// [`Error::Scene`] where both are there.
pub(super) fn rename(
    root: &mut Node,
    (label, text): (&str, &str),
    [table, other, key]: [&str; 3],
) -> Result<(), Error> {
    let Value::Table(entries) = &mut root.value else { return Ok(()) };
    let Some(entry) = entries.iter_mut().find(|e| e.key == table) else { return Ok(()) };
    let Value::Table(keys) = &mut entry.node.value else { return Ok(()) };
    let Some(at) = keys.iter().position(|e| e.key == other) else { return Ok(()) };
    if keys.iter().any(|e| e.key == key) {
        let message = format!("`{table}.{other}` is another name of `{table}.{key}`: leave one of them out");
        let place = match &keys[at].place {
            Place::Text { line, column } => format!("{label}:{line}:{column}"),
            set => set.to_string(),
        };
        return Err(Error::Scene { place, message, excerpt: keys[at].place.excerpt(text) });
    }
    keys[at].key = key.to_string();
    Ok(())
}

/// The tree with `key=value` put in (a dotted key; the value as TOML, or as a string where it is not TOML).
pub(super) fn set(root: &mut Node, assignment: &str) -> Result<(), Error> {
    let place = format!("--set {assignment}");
    let bad = |message: String| Error::Scene { place: place.clone(), message, excerpt: String::new() };
    let Some((key, text)) = assignment.split_once('=') else {
        return Err(bad("expected key=value, for example --set algorithm.max_iterations=20".into()));
    };
    let place = Place::Set(assignment.to_string());
    let here = |_| place.clone();
    let value = match DeValue::parse(text.trim()) {
        Ok(value) => convert(value.get_ref(), &here),
        Err(_) => Value::String(text.trim().to_string()),
    };
    let mut node = root;
    let parts: Vec<&str> = key.trim().split('.').collect();
    // No key of a scene is as deep as eight tables.
    if parts.iter().any(|p| p.is_empty()) || parts.len() > 8 {
        return Err(bad(format!("{:?} is not a dotted key such as observations.sigma", key.trim())));
    }
    for part in parts {
        node = match &mut node.value {
            Value::Table(entries) => {
                let at = entries.iter().position(|e| e.key == part).unwrap_or_else(|| {
                    let node = Node { place: place.clone(), value: Value::Table(Vec::new()) };
                    entries.push(Entry { key: part.to_string(), place: place.clone(), node });
                    entries.len() - 1
                });
                &mut entries[at].node
            }
            Value::Array(items) => {
                let count = items.len();
                match part.parse::<usize>().ok().filter(|i| *i < count) {
                    Some(i) => &mut items[i],
                    None => {
                        return Err(bad(format!(
                            "{part:?} is not an index of a list of {count}, counted from 0"
                        )));
                    }
                }
            }
            _ => return Err(bad(format!("there is no key {part:?} below a plain value"))),
        };
    }
    *node = Node { place, value };
    Ok(())
}

/// Puts `from` into `into`: tables key by key, anything else, and a table of another `kind`, as a whole.
pub(super) fn merge(into: &mut Node, from: &Node) {
    let kind = |node: &Node| node.child("kind").map(Node::to_json);
    let other = kind(from).is_some() && kind(from) != kind(into);
    match (&mut into.value, &from.value) {
        (Value::Table(_), Value::Table(entries)) if !other => {
            for entry in entries {
                if into.child(&entry.key).is_some() {
                    merge(into.child_or_table(&entry.key, &entry.place), &entry.node);
                } else {
                    *into.child_or_table(&entry.key, &entry.place) = entry.node.clone();
                }
            }
        }
        _ => *into = from.clone(),
    }
}

impl Node {
    /// What a key of a table says.
    pub(super) fn child(&self, key: &str) -> Option<&Node> {
        let Value::Table(entries) = &self.value else { return None };
        entries.iter().find(|e| e.key == key).map(|e| &e.node)
    }

    /// One of a list.
    pub(super) fn item(&self, i: usize) -> Option<&Node> {
        let Value::Array(items) = &self.value else { return None };
        items.get(i)
    }

    /// A key of a table, made one where it is no table.
    pub(super) fn child_or_table(&mut self, key: &str, place: &Place) -> &mut Node {
        if !matches!(self.value, Value::Table(_)) {
            self.value = Value::Table(Vec::new());
        }
        let Value::Table(entries) = &mut self.value else { unreachable!("made one") };
        let at = entries.iter().position(|e| e.key == key).unwrap_or_else(|| {
            let node = Node { place: place.clone(), value: Value::Table(Vec::new()) };
            entries.push(Entry { key: key.to_string(), place: place.clone(), node });
            entries.len() - 1
        });
        &mut entries[at].node
    }

    /// Takes a key out of a table.
    pub(super) fn remove(&mut self, key: &str) {
        if let Value::Table(entries) = &mut self.value {
            entries.retain(|e| e.key != key);
        }
    }

    /// The value as JSON (what serde reads the scene from).
    pub(super) fn to_json(&self) -> serde_json::Value {
        match &self.value {
            Value::Table(entries) => entries.iter().map(|e| (e.key.clone(), e.node.to_json())).collect(),
            Value::Array(items) => items.iter().map(Node::to_json).collect(),
            Value::String(s) => s.as_str().into(),
            Value::Integer(i) => (*i).into(),
            Value::Float(f) => (*f).into(),
            Value::Boolean(b) => (*b).into(),
            Value::Datetime => serde_json::Value::Null,
        }
    }

    /// Places of this node and all below it, by dotted path.
    pub(super) fn places(&self, path: &str, out: &mut std::collections::BTreeMap<String, Place>) {
        out.insert(path.to_string(), self.place.clone());
        let below = |part: &str| if path.is_empty() { part.to_string() } else { format!("{path}.{part}") };
        match &self.value {
            Value::Table(entries) => entries.iter().for_each(|e| e.node.places(&below(&e.key), out)),
            Value::Array(items) => {
                items.iter().enumerate().for_each(|(i, n)| n.places(&below(&i.to_string()), out))
            }
            _ => {}
        }
    }
}

fn convert_table(table: &DeTable<'_>, place: &impl Fn(std::ops::Range<usize>) -> Place) -> Value {
    let entry = |(key, value): (&Spanned<std::borrow::Cow<'_, str>>, &Spanned<DeValue<'_>>)| Entry {
        key: key.get_ref().to_string(),
        place: place(key.span()),
        node: Node { place: place(value.span()), value: convert(value.get_ref(), place) },
    };
    Value::Table(table.iter().map(entry).collect())
}

fn convert(value: &DeValue<'_>, place: &impl Fn(std::ops::Range<usize>) -> Place) -> Value {
    match value {
        DeValue::Table(table) => convert_table(table, place),
        DeValue::Array(items) => Value::Array(
            items
                .iter()
                .map(|v| Node { place: place(v.span()), value: convert(v.get_ref(), place) })
                .collect(),
        ),
        DeValue::String(s) => Value::String(s.to_string()),
        // Digits too many for 64 bits become a float, which the check then refuses where an integer is meant.
        DeValue::Integer(i) => match i64::from_str_radix(i.as_str(), i.radix()) {
            Ok(i) => Value::Integer(i),
            Err(_) => Value::Float(i.as_str().parse().unwrap_or(f64::NAN)),
        },
        DeValue::Float(f) => Value::Float(f.as_str().parse().unwrap_or(f64::NAN)),
        DeValue::Boolean(b) => Value::Boolean(*b),
        DeValue::Datetime(_) => Value::Datetime,
    }
}

/// Finds line and column of a byte offset without reading the text from its start.
struct Lines<'a> {
    text: &'a [u8],
    /// Where lines begin.
    starts: Vec<usize>,
    /// Characters before every [`BLOCK`]th byte.
    before: Vec<usize>,
}

const BLOCK: usize = 64;

impl<'a> Lines<'a> {
    fn new(text: &'a str) -> Self {
        let breaks = text.bytes().enumerate().filter(|(_, b)| *b == b'\n').map(|(i, _)| i + 1);
        let mut count = 0;
        let before = text.as_bytes().chunks(BLOCK).map(|block| {
            let here = count;
            count += characters(block);
            here
        });
        Lines {
            text: text.as_bytes(),
            before: before.collect(),
            starts: std::iter::once(0).chain(breaks).collect(),
        }
    }

    /// Line and column (in characters), both from 1.
    fn place(&self, offset: usize) -> Place {
        let offset = offset.min(self.text.len());
        let line = self.starts.partition_point(|s| *s <= offset);
        Place::Text { line, column: self.until(offset) - self.until(self.starts[line - 1]) + 1 }
    }

    /// Characters before a byte.
    fn until(&self, offset: usize) -> usize {
        let block = (offset / BLOCK).min(self.before.len().saturating_sub(1));
        self.before.get(block).map_or(0, |n| n + characters(&self.text[block * BLOCK..offset]))
    }
}

/// Bytes that are not a continuation of a UTF-8 character.
fn characters(bytes: &[u8]) -> usize {
    bytes.iter().filter(|b| **b & 0xC0 != 0x80).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_those_counted_from_the_start() {
        for text in ["", "a", "a = 1\nβ = 2\n\nγδ = 3", &"ω = \"∂\"\n".repeat(40), &"é".repeat(300)] {
            let lines = Lines::new(text);
            for (offset, _) in text.char_indices().chain([(text.len(), ' ')]) {
                let before = &text[..offset];
                let start = before.rfind('\n').map_or(0, |i| i + 1);
                let place = Place::Text {
                    line: before.matches('\n').count() + 1,
                    column: before[start..].chars().count() + 1,
                };
                assert_eq!(lines.place(offset), place, "{text:?} {offset}");
            }
        }
    }
}
