//! Fixtures made elsewhere: rods with 50-digit derivatives, assimilation windows and twins with known minima.

mod der;
mod fixture;
mod hanging_rod;
mod minimum;
mod reference_values;
mod statics;
pub(super) mod twin;
mod upwind;

use super::Options;
use crate::row::{Case, Outcome, Row, Rows};
use fixture::{Fixture, shipped};
use std::path::{Path, PathBuf};

pub(super) fn run(options: &Options) -> Vec<Row> {
    let mut rows = Rows::new("golden");
    rows.reason("tolerance stated with the fixtures (their README)");
    let folder = options.fixtures.clone().unwrap_or_else(shipped);
    let found = fixtures(&mut rows, &folder);
    if found == 0 {
        let reason = format!("{}: no fixtures in der, hanging-rod, twin or statics", folder.display());
        rows.case("fixtures", |_| Err(reason.into()));
    }
    reference_values::run(&mut rows);
    rows.finish()
}

/// Checks every fixture in a folder. Returns how many there were.
fn fixtures(rows: &mut Rows, folder: &Path) -> usize {
    type Check = fn(&mut Case, &Path) -> Outcome;
    let kinds: [(&str, bool, Check); 4] = [
        ("der", false, der::check),
        ("hanging-rod", true, hanging_rod::check),
        ("twin", false, twin::check),
        ("statics", false, statics::check),
    ];
    let mut found = 0;
    for (kind, is_folder, check) in kinds {
        let Ok(entries) = std::fs::read_dir(folder.join(kind)) else { continue };
        let mut paths: Vec<PathBuf> = entries.flatten().map(|e| e.path()).collect();
        paths.retain(|p| if is_folder { p.is_dir() } else { p.extension().is_some_and(|e| e == "json") });
        paths.sort();
        found += paths.len();
        for path in paths {
            // a folder's name may have dots in it
            let name = if is_folder { path.file_name() } else { path.file_stem() };
            let name = name.unwrap_or_default().to_string_lossy().into_owned();
            rows.case(&name, |case| check(case, &path));
        }
    }
    found
}

/// Reads a text as a fixture of every kind, up to what is computed with it where that is small. For property
/// tests and fuzzing.
pub(super) fn read_all(text: &str) {
    let mut rows = Rows::new("read");
    if let Ok(fixture) = <der::Given as Fixture>::parse(text)
        && fixture.is_small()
    {
        // Not through `Rows::case`, which would catch a panic.
        let _ = der::compare(&mut rows.open("der"), &fixture);
    }
    let _ = twin::prepare(text);
    let _ = statics::prepare(text);
    let _ = hanging_rod::prepare(text);
    let _ = hanging_rod::Reference::parse(text);
    let _ = hanging_rod::read_rows(text.as_bytes(), &[10, 20], &mut |_, _, _| Ok(()));
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use serde_json::{Value, json};

    /// One small fixture of every kind, as text.
    fn texts() -> Vec<String> {
        let read = |name: &str| std::fs::read_to_string(shipped().join(name)).unwrap();
        let rod = "hanging-rod/aniso-case2-n12";
        vec![
            read("der/straight_rest_3.json"),
            read("der/curved_iso_5.json"),
            read("twin/l63.json"),
            read(&format!("{rod}/problem.json")),
            read(&format!("{rod}/reference.json")),
            read("statics/e02-turn3-090-w10.json"),
        ]
    }

    /// The places of a tree, leaves and branches, one after the other.
    fn places<'a>(value: &'a mut Value, visit: &mut dyn FnMut(&mut Value)) {
        visit(value);
        match value {
            Value::Array(items) => items.iter_mut().for_each(|v| places(v, visit)),
            Value::Object(entries) => entries.iter_mut().for_each(|(_, v)| places(v, visit)),
            _ => {}
        }
    }

    /// The `at`-th place (counted round) becomes another value, or its list loses or gains an entry.
    fn changed(text: &str, at: usize, kind: usize) -> String {
        let mut tree: Value = serde_json::from_str(text).unwrap();
        let mut count = 0;
        places(&mut tree, &mut |_| count += 1);
        let (chosen, mut i) = (at % count, 0);
        places(&mut tree, &mut |value| {
            if i == chosen {
                let list = value.as_array().cloned();
                *value = match (kind, list) {
                    (0, Some(mut list)) => {
                        list.pop();
                        json!(list)
                    }
                    (1, Some(mut list)) => {
                        list.extend(list.last().cloned());
                        json!(list)
                    }
                    (2, _) => json!(0),
                    (3, _) => json!(-1.0),
                    (4, _) => json!(usize::MAX),
                    (5, _) => json!(1e300),
                    (6, _) => json!(5e-324),
                    (7, _) => json!([]),
                    (8, _) => json!("text"),
                    (9, _) => json!(1_000_000_000_000_u64),
                    (_, _) => Value::Null,
                };
            }
            i += 1;
        });
        tree.to_string()
    }

    /// The numbers that are fields, not entries of lists.
    fn fields(value: &mut Value, visit: &mut dyn FnMut(&mut Value)) {
        match value {
            Value::Array(items) => items.iter_mut().filter(|v| !v.is_number()).for_each(|v| fields(v, visit)),
            Value::Object(entries) => entries.iter_mut().for_each(|(_, v)| fields(v, visit)),
            Value::Number(_) => visit(value),
            _ => {}
        }
    }

    #[test]
    fn every_field_changed_is_read_or_refused() {
        for text in texts() {
            let given: Value = serde_json::from_str(&text).unwrap();
            for other in [json!(0), json!(-1.0), json!(usize::MAX), json!(1e300), json!(5e-324), json!(null)]
            {
                for chosen in 0.. {
                    let (mut tree, mut i) = (given.clone(), 0_usize);
                    fields(&mut tree, &mut |value| {
                        if i == chosen {
                            *value = other.clone();
                        }
                        i += 1;
                    });
                    if chosen >= i {
                        break;
                    }
                    read_all(&tree.to_string());
                }
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig {
            cases: 400,
            failure_persistence: None,
            ..ProptestConfig::default()
        })]

        #[test]
        fn a_changed_fixture_is_read_or_refused(i in 0..6_usize, at in any::<usize>(), kind in 0..11_usize) {
            read_all(&changed(&texts()[i], at, kind));
        }

        #[test]
        fn a_cut_or_garbled_fixture_is_read_or_refused(
            i in 0..6_usize,
            at in any::<usize>(),
            byte in any::<u8>(),
        ) {
            let mut bytes = texts()[i].clone().into_bytes();
            let at = at % bytes.len();
            read_all(&String::from_utf8_lossy(&bytes[..at]));
            bytes[at] = byte;
            read_all(&String::from_utf8_lossy(&bytes));
        }

        #[test]
        fn any_text_is_no_panic(text in ".{0,200}") {
            read_all(&text);
        }
    }

    /// Without a change they are right, so that the properties are not about refusals only.
    #[test]
    fn what_is_changed_is_valid() {
        let texts = texts();
        for der in &texts[..2] {
            assert!(der::Given::parse(der).unwrap().is_small());
        }
        twin::prepare(&texts[2]).unwrap();
        hanging_rod::prepare(&texts[3]).unwrap();
        hanging_rod::Reference::parse(&texts[4]).unwrap();
        statics::prepare(&texts[5]).unwrap();
    }

    #[test]
    fn a_malformed_fixture_is_an_error_that_names_file_and_field() {
        let folder = std::env::temp_dir().join(format!("varda-fixtures-{}", std::process::id()));
        let der = |change: &dyn Fn(&mut Value)| {
            let text = std::fs::read_to_string(shipped().join("der/curved_iso_5.json")).unwrap();
            let mut tree: Value = serde_json::from_str(&text).unwrap();
            change(&mut tree);
            std::fs::create_dir_all(folder.join("der")).unwrap();
            std::fs::write(folder.join("der/changed.json"), tree.to_string()).unwrap();
            let rows = run(&Options { fixtures: Some(folder.clone()), ..Options::default() });
            let row = rows.into_iter().find(|r| r.case == "changed").unwrap();
            assert!(!row.pass);
            row.note
        };
        let cut = |name: &'static str| {
            move |v: &mut Value| {
                v[name].as_array_mut().unwrap().pop();
            }
        };
        for field in ["rest_lengths", "voronoi_lengths", "EI", "kappa_bar", "vertices", "ref_d1", "theta"] {
            let note = der(&cut(field));
            assert!(note.contains("changed.json: ") && note.contains(field), "{field}: {note}");
        }
        let note = der(&|v| v["n_edges"] = json!(1_000_000_000_000_u64));
        assert!(note.contains("changed.json: n_edges = 1000000000000"), "{note}");
        let note = der(&|v| v["hessian_lower_coo"]["bend"][0][1] = json!(99));
        assert!(note.contains("hessian_lower_coo names entry"), "{note}");
        let note = der(&|v| v["theta"][0] = json!("north"));
        assert!(note.contains("changed.json") && note.contains("expected f64"), "{note}");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
