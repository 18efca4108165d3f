//! Checks a scene against its own JSON Schema: unknown keys, missing keys, wrong types and impossible values,
//! each with its place and with what was meant.

use serde_json::Value as Json;

use super::place::Place;
use super::sizes::{LARGEST, SMALLEST};
use super::tree::{Node, Value};

/// What is wrong, and where.
#[derive(Debug)]
pub(super) struct Wrong {
    pub(super) place: Place,
    pub(super) message: String,
}

/// Checks `node` (called `path` in messages) against `schema`, a part of `root`.
pub(super) fn check(node: &Node, path: &str, schema: &Json, root: &Json) -> Result<(), Wrong> {
    let schema = resolve_for(node, schema, root);
    if let Some(choices) = schema["oneOf"].as_array() {
        return check_choice(node, path, choices, root);
    }
    let types: Vec<&str> = match &schema["type"] {
        Json::String(t) => vec![t],
        Json::Array(all) => all.iter().filter_map(Json::as_str).filter(|t| *t != "null").collect(),
        _ => Vec::new(),
    };
    let wrong = |message: String| Err(Wrong { place: node.place.clone(), message });
    match (types.first().copied().unwrap_or(""), &node.value) {
        ("object", Value::Table(_)) => check_table(node, path, schema, root),
        ("array", Value::Array(items)) => {
            let (min, max) = (schema["minItems"].as_u64(), schema["maxItems"].as_u64());
            if min.is_some_and(|m| (items.len() as u64) < m) || max.is_some_and(|m| items.len() as u64 > m) {
                let expected = match (min, max) {
                    (Some(m), _) => format!("{m}"),
                    (None, m) => format!("at most {}", m.unwrap_or(0)),
                };
                return wrong(format!("`{path}` has {} entries, expected {expected}", items.len()));
            }
            for (i, item) in items.iter().enumerate() {
                check(item, &format!("{path}[{i}]"), &schema["items"], root)?;
                if schema["x-positive"] == true && !number(&item.value).is_some_and(|v| v > 0.0) {
                    return Err(Wrong {
                        place: item.place.clone(),
                        message: format!("`{path}[{i}]` must be greater than 0{}", unit(schema)),
                    });
                }
            }
            Ok(())
        }
        ("string", Value::String(_)) | ("boolean", Value::Boolean(_)) => Ok(()),
        ("integer", Value::Integer(i)) => check_range(node, path, *i as f64, schema),
        ("number", Value::Integer(_) | Value::Float(_)) => {
            check_range(node, path, number(&node.value).unwrap_or(f64::NAN), schema)
        }
        (expected, found) => {
            let advice = match (expected, found) {
                ("number", Value::String(_)) => "; write a plain number in that SI unit, without quotes",
                ("integer", Value::Float(_)) => "; write it without a decimal point",
                _ => "",
            };
            let expected = match expected {
                "object" => "a table",
                "array" => "a list",
                "number" => "a number",
                "integer" => "a whole number",
                "boolean" => "true or false",
                other => other,
            };
            wrong(format!("`{path}` must be {expected}{}, found {}{advice}", unit(schema), describe(found)))
        }
    }
}

fn check_table(node: &Node, path: &str, schema: &Json, root: &Json) -> Result<(), Wrong> {
    let Value::Table(entries) = &node.value else { return Ok(()) };
    if schema["additionalProperties"] == true {
        // keys of another table, checked where they are put in
        return Ok(());
    }
    if schema["additionalProperties"].is_object() {
        let below = |key: &str| format!("{path}.{key}");
        let mut all = entries.iter();
        return all.try_for_each(|e| check(&e.node, &below(&e.key), &schema["additionalProperties"], root));
    }
    let empty = serde_json::Map::new();
    let known = schema["properties"].as_object().unwrap_or(&empty);
    let section = if path.is_empty() { "the top level".to_string() } else { format!("[{path}]") };
    let below = |key: &str| if path.is_empty() { key.to_string() } else { format!("{path}.{key}") };
    for entry in entries {
        let Some(property) = known.get(&entry.key) else {
            let names: Vec<&str> = known.keys().map(String::as_str).collect();
            let meant = match nearest(&entry.key, &names) {
                Some(name) => format!("did you mean `{name}`{}? ", about(resolve(&known[name], root), root)),
                None => String::new(),
            };
            let message =
                format!("unknown key `{}` in {section}; {meant}Known keys: {}", entry.key, names.join(", "));
            return Err(Wrong { place: entry.place.clone(), message });
        };
        check(&entry.node, &below(&entry.key), property, root)?;
    }
    for key in schema["required"].as_array().into_iter().flatten().filter_map(Json::as_str) {
        if !entries.iter().any(|e| e.key == key) {
            let message = format!("{section} needs the key `{key}`{}", about(&known[key], root));
            return Err(Wrong { place: node.place.clone(), message });
        }
    }
    Ok(())
}

/// One of several words, or one of several tables told apart by their key `kind`.
fn check_choice(node: &Node, path: &str, choices: &[Json], root: &Json) -> Result<(), Wrong> {
    let words = choices.iter().filter_map(|c| c["const"].as_str());
    let kinds = choices.iter().filter_map(|c| c["properties"]["kind"]["const"].as_str());
    let names: Vec<&str> = words.chain(kinds).collect();
    let tagged = choices.iter().any(|c| c["type"] == "object");
    let (place, label, word) = match (&node.value, tagged) {
        (Value::String(s), false) => (&node.place, path.to_string(), Some(s)),
        (Value::Table(entries), true) => match entries.iter().find(|e| e.key == "kind") {
            Some(e) => match &e.node.value {
                Value::String(s) => (&e.node.place, format!("{path}.kind"), Some(s)),
                _ => (&e.node.place, format!("{path}.kind"), None),
            },
            None => {
                let message = format!("[{path}] needs the key `kind`, one of: {}", names.join(", "));
                return Err(Wrong { place: node.place.clone(), message });
            }
        },
        _ => (&node.place, path.to_string(), None),
    };
    let Some(word) = word else {
        let what = if tagged && label == path { "a table with the key `kind`, one" } else { "one" };
        let message = format!("`{label}` must be {what} of: {}", names.join(", "));
        return Err(Wrong { place: place.clone(), message });
    };
    match choices
        .iter()
        .find(|c| c["const"] == word.as_str() || c["properties"]["kind"]["const"] == word.as_str())
    {
        Some(choice) if tagged => check_table(node, path, choice, root),
        Some(_) => Ok(()),
        None => {
            let meant = nearest(word, &names).map_or(String::new(), |n| format!("did you mean \"{n}\"? "));
            let message =
                format!("`{label}` = {word:?} is unknown; {meant}Expected one of: {}", names.join(", "));
            Err(Wrong { place: place.clone(), message })
        }
    }
}

fn check_range(node: &Node, path: &str, value: f64, schema: &Json) -> Result<(), Wrong> {
    let limit = |key: &str| schema[key].as_f64();
    let expected = if !value.is_finite() {
        Some("finite".to_string())
    } else if value != 0.0 && !(SMALLEST..=LARGEST).contains(&value.abs()) {
        Some(format!("0, or between {SMALLEST:e} and {LARGEST:e} in size"))
    } else if let Some(m) = limit("exclusiveMinimum").filter(|m| value <= *m) {
        Some(format!("greater than {m}"))
    } else if let Some(m) = limit("minimum").filter(|m| value < *m) {
        Some(format!("at least {m}"))
    } else {
        limit("maximum").filter(|m| value > *m).map(|m| format!("at most {m}"))
    };
    let readable = value == 0.0 || (1e-4..1e10).contains(&value.abs());
    let shown = if readable { format!("{value}") } else { format!("{value:e}") };
    match expected {
        None => Ok(()),
        Some(expected) => Err(Wrong {
            place: node.place.clone(),
            message: format!(
                "`{path}` = {shown} is impossible: it must be {expected}{}{}",
                unit(schema),
                schema["x-meant"].as_str().map_or(String::new(), |meant| format!("; {meant}"))
            ),
        }),
    }
}

/// The same as `resolve`; of a value that may be a table, a list, a word or a number, the part that the value
/// is of.
fn resolve_for<'a>(node: &Node, schema: &'a Json, root: &'a Json) -> &'a Json {
    let kinds: &[&str] = match node.value {
        Value::Table(_) => &["object"],
        Value::Array(_) => &["array"],
        Value::String(_) => &["string"],
        Value::Integer(_) | Value::Float(_) => &["number", "integer"],
        Value::Boolean(_) => &["boolean"],
        Value::Datetime => &[],
    };
    let is_table = kinds == ["object"];
    let by_names = matches!(&node.value, Value::Table(entries) if !entries.is_empty()
        && entries.iter().all(|e| matches!(e.node.value, Value::Table(_))));
    let mut inner = schema;
    loop {
        inner = if let Some(name) = inner["$ref"].as_str().and_then(|r| r.strip_prefix("#/$defs/")) {
            &root["$defs"][name]
        } else if let Some(all) = inner["anyOf"].as_array() {
            let is = |s: &Json| {
                let s = resolve(s, root);
                let of = |s: &Json| s["type"].as_str().is_some_and(|t| kinds.contains(&t));
                of(s) || of(&s["oneOf"][0])
            };
            // tables by names are those of tables alone
            let named = |s: &Json| resolve(s, root)["additionalProperties"].is_object() == by_names;
            let near = |s: &&Json| (resolve(s, root)["type"] == "object") == is_table;
            let some = || all.iter().filter(|s| s["type"] != "null");
            let first = some().find(|s| is(s) && named(s)).or_else(|| some().find(|s| is(s)));
            match first.or_else(|| some().find(near)).or_else(|| some().next()) {
                Some(one) => one,
                None => return inner,
            }
        } else {
            return inner;
        };
    }
}

/// Follows a `$ref` and steps over "or null".
fn resolve<'a>(schema: &'a Json, root: &'a Json) -> &'a Json {
    if let Some(name) = schema["$ref"].as_str().and_then(|r| r.strip_prefix("#/$defs/")) {
        return resolve(&root["$defs"][name], root);
    }
    match schema["anyOf"].as_array().and_then(|all| all.iter().find(|s| s["type"] != "null")) {
        Some(inner) => resolve(inner, root),
        None => schema,
    }
}

/// " (first sentence of its description)".
fn about(schema: &Json, root: &Json) -> String {
    let text = schema["description"]
        .as_str()
        .or_else(|| resolve(schema, root)["description"].as_str())
        .unwrap_or("");
    let sentence = text.split_terminator(". ").next().unwrap_or("").trim_end_matches('.').replace('\n', " ");
    if sentence.is_empty() { sentence } else { format!(" ({sentence})") }
}

fn unit(schema: &Json) -> String {
    schema["x-unit"].as_str().map_or(String::new(), |u| format!(" [{u}]"))
}

fn number(value: &Value) -> Option<f64> {
    match value {
        Value::Integer(i) => Some(*i as f64),
        Value::Float(f) => Some(*f),
        _ => None,
    }
}

fn describe(value: &Value) -> String {
    match value {
        Value::Table(_) => "a table".into(),
        Value::Array(_) => "a list".into(),
        Value::String(s) => format!("the text {s:?}"),
        Value::Integer(i) => format!("the number {i}"),
        Value::Float(f) => format!("the number {f}"),
        Value::Boolean(b) => format!("{b}"),
        Value::Datetime => "a date".into(),
    }
}

/// The known name closest to a misspelt one, if any is close.
pub(crate) fn nearest<'a>(word: &str, names: &[&'a str]) -> Option<&'a str> {
    let word = word.to_lowercase();
    let related = |n: &str| word.len() > 2 && n.len() > 2 && (n.starts_with(&word) || word.starts_with(n));
    let score = |n: &str| if related(n) { 1 } else { strsim::levenshtein(&word, &n.to_lowercase()) };
    let allowed = 2.max(word.chars().count() / 3);
    names
        .iter()
        .copied()
        .map(|n| (score(n), n))
        .filter(|(d, _)| *d <= allowed)
        .min_by_key(|(d, _)| *d)
        .map(|(_, n)| n)
}
