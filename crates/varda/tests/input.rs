//! Input that nobody meant: mutated scenes and CSV files are read or refused with their place, without a
//! panic.

#[path = "support/harness.rs"]
mod harness;

use proptest::prelude::*;
use varda::scene::{SHIPPED, SceneFile};

/// Values at the edges of what a key can say.
const EXTREMES: [&str; 26] = [
    "0",
    "-0.0",
    "1",
    "-1",
    "2",
    "3",
    "0.5",
    "1e-3",
    "1e3",
    "1e12",
    "1000000000000",
    "9223372036854775807",
    "-9223372036854775808",
    "1e300",
    "-1e300",
    "1e-300",
    "5e-324",
    "1e-49",
    "9e49",
    "-9e49",
    "nan",
    "inf",
    "-inf",
    "\"\"",
    "[]",
    "{}",
];

/// A shipped scene, small.
fn base(i: usize) -> toml::Table {
    let mut scene: toml::Table = SHIPPED[i % SHIPPED.len()].text.parse().unwrap();
    let mut set = |path: &[&str], most: i64| {
        let mut at = Some(&mut scene);
        for part in &path[..path.len() - 1] {
            at = at.and_then(|t| t.get_mut(*part)).and_then(toml::Value::as_table_mut);
        }
        if let Some(toml::Value::Integer(value)) = at.and_then(|t| t.get_mut(path[path.len() - 1])) {
            *value = most.min(*value);
        }
    };
    set(&["time", "window"], 8);
    set(&["time", "spin_up"], 2);
    set(&["model", "segments"], 6);
    set(&["model", "points"], 20);
    set(&["background", "covariance", "steps"], 200);
    set(&["algorithm", "cycles", "count"], 3);
    set(&["algorithm", "cycles", "spin_up"], 0);
    set(&["observations", "every"], 4);
    set(&["algorithm", "ensemble", "members"], 5);
    set(&["algorithm", "model_error", "every"], 4);
    // Lists of steps were written for a longer window.
    let window = scene.get("time").and_then(|time| time["window"].as_integer());
    if let (Some(window), Some(toml::Value::Array(steps))) = (window, scene["observations"].get_mut("steps"))
    {
        steps.retain(|k| k.as_integer().is_some_and(|k| k <= window));
    }
    if let Some(algorithm) = scene.get_mut("algorithm").and_then(toml::Value::as_table_mut) {
        algorithm.remove("window_growth");
    }
    scene
}

/// Replaces the `at`-th leaf (counted round) by `value`.
fn replace(scene: &mut toml::Table, at: usize, value: &toml::Value) {
    fn leaves<'a>(value: &'a mut toml::Value, out: &mut Vec<&'a mut toml::Value>) {
        let plain = match value {
            toml::Value::Table(t) => t.is_empty(),
            toml::Value::Array(a) => a.is_empty(),
            _ => true,
        };
        match value {
            leaf if plain => out.push(leaf),
            toml::Value::Table(t) => t.iter_mut().for_each(|(_, v)| leaves(v, out)),
            toml::Value::Array(a) => a.iter_mut().for_each(|v| leaves(v, out)),
            _ => {}
        }
    }
    let mut all = Vec::new();
    scene.iter_mut().for_each(|(_, v)| leaves(v, &mut all));
    let at = at % all.len();
    *all[at] = value.clone();
}

fn extreme() -> impl Strategy<Value = toml::Value> {
    let parse = |text: &str| format!("v = {text}").parse::<toml::Table>().unwrap()["v"].clone();
    prop_oneof![
        4 => (0..EXTREMES.len()).prop_map(move |i| parse(EXTREMES[i])),
        1 => any::<f64>().prop_map(toml::Value::Float),
        1 => (-60.0..60.0_f64).prop_map(|e| toml::Value::Float(10f64.powf(e))),
        1 => (0..100_i64).prop_map(toml::Value::Integer),
    ]
}

/// What happens to a text on its way.
fn damaged(text: Vec<u8>) -> impl Strategy<Value = Vec<u8>> {
    let n = text.len().max(1);
    (0..9_u8, 0..n, 0..n, any::<u8>()).prop_map(move |(kind, i, j, byte)| {
        let mut out = text.clone();
        match kind {
            0 => out.truncate(i),
            1 => out[i.min(n - 1)] = byte,
            2 => {
                let mut lines: Vec<&[u8]> = text.split(|b| *b == b'\n').collect();
                let m = lines.len();
                lines.swap(i % m, j % m);
                out = lines.join(&b'\n');
            }
            3 => out.splice(0..0, *b"\xef\xbb\xbf").for_each(drop),
            4 => out = String::from_utf8_lossy(&text).replace('\n', "\r\n").into_bytes(),
            5 => out.extend_from_slice(&text),
            6 => out.splice(i..i, std::iter::repeat_n(b'[', 5000)).for_each(drop),
            7 => out.splice(i..i, std::iter::repeat_n(byte, 100_000)).for_each(drop),
            _ => out.splice(i..i, *b"1e999").for_each(drop),
        }
        out
    })
}

fn config(cases: u32) -> ProptestConfig {
    // PROPTEST_CASES asks for more.
    let cases = std::env::var("PROPTEST_CASES").ok().and_then(|n| n.parse().ok()).unwrap_or(cases);
    ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
}

const OBSERVATIONS: &str = "time_s,marker,x_m,y_m,z_m,sigma_m\n# é\n0,tïp,1,,3,0.1\n\n0.5,b,-0,1e-310,3,\n";
const BACKGROUND: &str = "vertex,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s\n1,0,0,0,0,0,0\n2,1,1,1,1,1,1\n";

proptest! {
    #![proptest_config(config(400))]

    #[test]
    fn a_scene_with_extreme_values_is_built_or_refused(
        i in 0..SHIPPED.len(),
        changes in prop::collection::vec((any::<usize>(), extreme()), 1..3),
    ) {
        let mut scene = base(i);
        for (at, value) in &changes {
            replace(&mut scene, *at, value);
        }
        harness::scene(toml::to_string(&scene).unwrap().as_bytes());
    }

    #[test]
    fn a_damaged_scene_is_built_or_refused(
        bytes in (0..SHIPPED.len())
            .prop_flat_map(|i| damaged(toml::to_string(&base(i)).unwrap().into_bytes())),
    ) {
        harness::scene(&bytes);
    }

    #[test]
    fn a_damaged_table_is_read_or_refused(
        bytes in prop_oneof![
            damaged(OBSERVATIONS.into()),
            damaged(BACKGROUND.into()),
            prop::collection::vec(any::<u8>(), 0..200)
        ],
    ) {
        harness::csv(&bytes);
    }

    #[test]
    fn any_text_is_no_panic(text in ".{0,200}") {
        harness::scene(text.as_bytes());
        harness::csv(text.as_bytes());
        let _ = SceneFile::open("lorenz63", &[text]);
    }
}

/// Most of the small scenes the mutations start from are built: else the properties would test refusals only.
#[test]
fn what_is_mutated_is_valid() {
    let built = |i: &usize| harness::scene(toml::to_string(&base(*i)).unwrap().as_bytes());
    let valid = (0..SHIPPED.len()).filter(built).count();
    assert!(2 * valid > SHIPPED.len(), "{valid} of {}", SHIPPED.len());
}

#[test]
fn absurd_sizes_are_refused_by_the_key_that_asks_for_them() {
    for (scene, set, key) in [
        ("hanging-rod", "model.segments=1000000000000", "model.segments"),
        ("hanging-rod", "time.window=1000000000000", "time.window"),
        ("hanging-rod", "time.spin_up=1000000000000", "time.spin_up"),
        ("hanging-rod", "report.forecast=1e30", "report.forecast"),
        ("lorenz96", "model.variables=1000000000000", "model.variables"),
        ("lorenz96-4denvar", "algorithm.ensemble.members=1000000000000", "algorithm.ensemble.members"),
        ("lorenz96-cycling-4dvar", "algorithm.cycles.count=1000000000000", "algorithm.cycles.count"),
        ("lorenz96-cycling-4dvar", "algorithm.cycles.count=9000000", "algorithm.cycles.count"),
        ("lorenz96", "algorithm.max_iterations=1000000000000", "algorithm.max_iterations"),
        ("burgers", "model.points=1000000000000", "model.points"),
    ] {
        let error = SceneFile::open(scene, &[set.to_string()]).unwrap_err().to_string();
        assert!(error.contains(key) && error.contains("at most"), "{set}: {error}");
    }
}

#[test]
fn a_file_without_an_end_and_a_scene_too_long_are_refused() {
    let error = SceneFile::open("/dev/zero", &[]).unwrap_err().to_string();
    assert!(error.contains("/dev/zero") && error.contains("more than 1048576 bytes"), "{error}");
    let text = "#".repeat((1 << 20) + 1);
    let error = SceneFile::parse("s", "s.toml", &text, None, &[]).unwrap_err().to_string();
    assert!(error.starts_with("s.toml: 1048577 bytes"), "{error}");
}
