//! Recordings as they come: read right, or refused with file, line and cause.

use super::folder::{Folder, RECORDED_ROD};
use crate::row::{Case, Outcome, Rows};
use crate::suites::Options;
use varda::Error;
use varda::setup::Inputs;

/// What must come of a file.
enum Wanted {
    /// So many values, each as in the file without fault; and a remark with these words.
    Reads(usize, &'static str),
    /// An error with these words.
    Refused(&'static [&'static str]),
}
use Wanted::{Reads, Refused};

/// A name, the file's bytes, keys that are set, what must come of it.
type Broken = (&'static str, Vec<u8>, &'static [&'static str], Wanted);

pub(super) fn run(options: &Options, rows: &mut Rows) {
    rows.area("file");
    rows.reason("a file is read right, or refused with its name, the line and the cause");
    let every = if options.quick { 10 } else { 1 };
    for (name, bytes, sets, wanted) in observations().into_iter().step_by(every) {
        rows.case(name, |case| broken(case, name, ("seen.csv", &bytes), sets, &wanted));
    }
    rows.area("file of a base");
    for (name, bytes, sets, wanted) in bases().into_iter().step_by(every) {
        rows.case(name, |case| broken(case, name, ("base.csv", &bytes), sets, &wanted));
    }
}

fn broken(case: &mut Case, name: &str, file: (&str, &[u8]), sets: &[&str], wanted: &Wanted) -> Outcome {
    let clean = inputs(&format!("{name} clean"), ("seen.csv", recording(seen).as_bytes()), &[])?;
    match (inputs(name, file, sets), wanted) {
        (Ok(read), Reads(values, remark)) => {
            let found = read.observed.seen.iter().flat_map(|s| &s.values).flatten().count();
            case.count("values", found, *values);
            case.at_most("a value off", off(&read, &clean), 1e-12, "m").because("rounding of a unit");
            let told = read.observed.left_out.iter().chain(remarks(&read)).any(|l| l.contains(remark));
            case.count("remarks that say so", usize::from(remark.is_empty() || told), 1);
        }
        (Err(error), Refused(words)) => {
            let message = error.to_string();
            let missing: Vec<&str> = words.iter().filter(|w| !message.contains(**w)).copied().collect();
            let named = message.contains(file.0);
            case.count("words missing", missing.len() + usize::from(!named), 0).note(
                if missing.is_empty() && named { String::new() } else { format!("{missing:?}: {message}") },
            );
        }
        (Ok(_), Refused(_)) => {
            case.count("refused", 0, 1).note("it was read");
        }
        (Err(error), Reads(..)) => {
            case.count("read", 0, 1).note(error.to_string());
        }
    }
    Ok(())
}

fn remarks(inputs: &Inputs) -> &[String] {
    match &inputs.system {
        varda::setup::system::System::Rod(rod) => &rod.parts.remarks,
        varda::setup::system::System::Components(_) => &[],
    }
}

/// How far values are from those of the same marker at the same time in the file without fault.
fn off(read: &Inputs, clean: &Inputs) -> f64 {
    let clean = &clean.observed.seen;
    let mut most = 0.0;
    for seen in &read.observed.seen {
        let same = clean.iter().find(|c| c.site == seen.site && (c.at() - seen.at()).abs() < 1e-6);
        for (c, value) in seen.values.iter().enumerate() {
            let Some(value) = value else { continue };
            let right = same.and_then(|s| s.values[c]).unwrap_or(f64::NAN);
            most = super::common::greatest(most, (value - right).abs());
        }
    }
    most
}

fn inputs(case: &str, (file, bytes): (&str, &[u8]), sets: &[&str]) -> Result<Inputs, Error> {
    let failed = |reason| Error::Write { path: file.into(), reason };
    let folder = Folder::new(case).map_err(failed)?;
    let has_base = file == "base.csv";
    let base = if has_base { "motion = { kind = \"table\", file = \"base.csv\", sigma = 0.0 }" } else { "" };
    folder.write("seen.csv", recording(seen).as_bytes()).map_err(failed)?;
    folder.write(file, bytes).map_err(failed)?;
    Inputs::read(&folder.scene(&RECORDED_ROD.replace("# motion", base), sets)?)
}

/// A row: step of 0.02 s, marker, place; `None` is not written.
type Row = Option<(String, String, [String; 3])>;

/// The marker `m` (0 middle, 1 tip) in frame k: a slow swing.
fn place(k: usize, m: usize) -> [f64; 3] {
    let swing = 0.02 * (0.3 * k as f64).sin() * (m + 1) as f64;
    [swing, 0.001 * k as f64, 0.75 - 0.25 * m as f64 + 0.001]
}

const NAMES: [&str; 2] = ["middle", "tip"];

fn cells(k: usize, name: &str, place: [f64; 3]) -> Row {
    Some((format!("{:.2}", 0.02 * k as f64), name.into(), place.map(|v| format!("{v:.6}"))))
}

fn seen(k: usize, m: usize) -> Row {
    cells(k, NAMES[m], place(k, m))
}

const HEADER: &str = "time_s,marker,x_m,y_m,z_m";

/// Twenty frames of two markers: 120 values.
fn table(header: &str, row: impl Fn(usize, usize) -> Row) -> Vec<String> {
    let mut lines = vec![header.to_string()];
    for k in 0..20 {
        for m in 0..2 {
            if let Some((time, name, [x, y, z])) = row(k, m) {
                lines.push(format!("{time},{name},{x},{y},{z}"));
            }
        }
    }
    lines
}

fn recording(row: impl Fn(usize, usize) -> Row) -> String {
    table(HEADER, row).join("\n") + "\n"
}

/// The rows with another place.
fn moved(change: impl Fn(usize, usize, [f64; 3]) -> [f64; 3]) -> Vec<u8> {
    recording(|k, m| cells(k, NAMES[m], change(k, m, place(k, m)))).into_bytes()
}

/// The rows with other labels.
fn labelled(label: impl Fn(usize, usize) -> usize) -> Vec<u8> {
    recording(|k, m| cells(k, NAMES[label(k, m)], place(k, m))).into_bytes()
}

/// The file with some of its text replaced.
fn edited(old: &str, new: &str) -> Vec<u8> {
    recording(seen).replacen(old, new, 1).into_bytes()
}

/// A file with one more line after the first rows.
fn with_line(line: &str) -> Vec<u8> {
    let mut lines = table(HEADER, seen);
    lines.insert(7, line.into());
    (lines.join("\n") + "\n").into_bytes()
}

/// Places and times in other units.
fn scaled(header: &str, [time, length]: [f64; 2]) -> Vec<u8> {
    let row = |k: usize, m: usize| {
        let time_text = format!("{}", (0.02 * k as f64 * time * 1e6).round() / 1e6);
        Some((
            time_text,
            NAMES[m].into(),
            place(k, m).map(|v| format!("{:.9}", (v * 1e6).round() * 1e-6 * length)),
        ))
    };
    (table(header, row).join("\n") + "\n").into_bytes()
}

fn utf_16(text: &str) -> Vec<u8> {
    let mut bytes = vec![0xff, 0xfe];
    text.encode_utf16().for_each(|unit| bytes.extend(unit.to_le_bytes()));
    bytes
}

fn observations() -> Vec<Broken> {
    let plain = recording(seen);
    let reversed = {
        let mut lines = table(HEADER, seen);
        lines[1..].reverse();
        (lines.join("\n") + "\n").into_bytes()
    };
    let twice = format!("{plain}{}", plain.split_once('\n').unwrap_or_default().1).into_bytes();
    let mixed = {
        let mut lines = table(HEADER, seen);
        lines[1..].sort_by_key(|l| l.bytes().map(usize::from).sum::<usize>() % 7);
        (lines.join("\n") + "\n").into_bytes()
    };
    let semicolons = plain.replace(',', ";").replace('.', ",").into_bytes();
    let skip: &[&str] = &["observations.unreachable=skip"];
    vec![
        ("a clean file", plain.clone().into_bytes(), &[], Reads(120, "")),
        ("a byte-order mark", format!("\u{feff}{plain}").into_bytes(), &[], Reads(120, "")),
        ("lines of Windows", plain.replace('\n', "\r\n").into_bytes(), &[], Reads(120, "")),
        ("semicolons and decimal commas", semicolons, &[], Reads(120, "")),
        ("tabs", plain.replace(',', "\t").into_bytes(), &[], Reads(120, "")),
        ("blanks around cells", plain.replace(',', " , ").into_bytes(), &[], Reads(120, "")),
        ("quoted cells", plain.replace("tip", "\"tip\"").into_bytes(), &[], Reads(120, "")),
        ("empty lines", plain.replace("\n0.1", "\n\n0.1").into_bytes(), &[], Reads(120, "")),
        ("comments", with_line("# the cable was touched here"), &[], Reads(120, "")),
        ("millimetres that say so", scaled("time_s,marker,x_mm,y_mm,z_mm", [1.0, 1e3]), &[], Reads(120, "")),
        ("centimetres that say so", scaled("time_s,marker,x_cm,y_cm,z_cm", [1.0, 1e2]), &[], Reads(120, "")),
        ("milliseconds that say so", scaled("time_ms,marker,x_m,y_m,z_m", [1e3, 1.0]), &[], Reads(120, "")),
        ("rows in any order", mixed, &[], Reads(120, "")),
        ("time running backwards", reversed, &[], Reads(120, "")),
        ("every row twice", twice, &[], Reads(120, "40 rows that repeat")),
        (
            "columns in another order",
            plain
                .lines()
                .map(|l| {
                    let c: Vec<&str> = l.split(',').collect();
                    format!("{},{},{},{},{}\n", c[4], c[1], c[3], c[0], c[2])
                })
                .collect::<String>()
                .into_bytes(),
            &[],
            Reads(120, ""),
        ),
        (
            "a marker gone for a while",
            recording(|k, m| if m == 1 && (5..12).contains(&k) { None } else { seen(k, m) }).into_bytes(),
            &[],
            Reads(99, ""),
        ),
        (
            "empty cells where it was not seen",
            recording(|k, m| {
                let (time, name, cells) = seen(k, m)?;
                Some((time, name, if k == 3 { [const { String::new() }; 3] } else { cells }))
            })
            .into_bytes(),
            &[],
            Reads(114, ""),
        ),
        (
            "another rate for each marker",
            recording(|k, m| if m == 0 && k % 3 != 0 { None } else { seen(k, m) }).into_bytes(),
            &[],
            Reads(81, ""),
        ),
        ("nan", edited("0.751000", "nan"), &[], Refused(&["seen.csv:2", "`z_m` is NaN", "empty"])),
        ("an infinity", edited("0.751000", "-inf"), &[], Refused(&["seen.csv:2", "`z_m` is -inf"])),
        ("a huge number", edited("0.751000", "1e300"), &[], Refused(&["seen.csv:2", "1e300", "larger than"])),
        ("a word for a number", edited("0.751000", "lost"), &[], Refused(&["seen.csv:2", "\"lost\""])),
        ("a further column", edited("z_m\n", "z_m,roll_deg\n"), &[], Refused(&["seen.csv:1", "roll_deg"])),
        (
            "a column twice",
            edited("z_m\n", "z_m,x_mm\n"),
            &[],
            Refused(&["seen.csv:1", "\"x_m\" is there twice"]),
        ),
        ("a missing column", edited(",z_m", ""), &[], Refused(&["seen.csv:1", "\"z_m\""])),
        (
            "a short row",
            with_line("0.06,tip,0,0"),
            &[],
            Refused(&["seen.csv:8", "another length", "5 columns"]),
        ),
        ("a long row", with_line("0.06,tip,0,0,1,2"), &[], Refused(&["seen.csv:8", "another length"])),
        (
            "a decimal comma among commas",
            edited("0.751000", "0,751"),
            &[],
            Refused(&["seen.csv:2", "another length"]),
        ),
        (
            "a row without a time",
            with_line(",tip,0,0,0.6"),
            &[],
            Refused(&["seen.csv:8", "`time_s` is empty"]),
        ),
        (
            "a row without a name",
            with_line("0.06,,0,0,0.6"),
            &[],
            Refused(&["seen.csv:8", "`marker` is empty"]),
        ),
        (
            "a marker nobody placed",
            with_line("0.06,elbow,0,0,0.6"),
            &[],
            Refused(&["seen.csv:8", "\"elbow\"", "ignore"]),
        ),
        (
            "a time outside the window",
            with_line("7,tip,0,0,0.6"),
            &[],
            Refused(&["seen.csv:8", "time_s = 7", "0.4 s"]),
        ),
        ("another program's text", utf_16(&plain), &[], Refused(&["UTF-16", "UTF-8"])),
        (
            "Latin letters of one byte",
            [plain.as_bytes(), b"# \xb5m\n"].concat(),
            &[],
            Refused(&["line 42", "UTF-8"]),
        ),
        ("an empty file", Vec::new(), &[], Refused(&["seen.csv:1", "time_s"])),
        (
            "a header alone",
            format!("{HEADER}\n").into_bytes(),
            &[],
            Refused(&["seen.csv:1", "no observations"]),
        ),
        (
            "millimetres",
            moved(|_, _, p| p.map(|v| 1e3 * v)),
            &[],
            Refused(&["seen.csv:2", "40 of 40", "millimetres?", "x_mm"]),
        ),
        (
            "centimetres",
            moved(|_, _, p| p.map(|v| 1e2 * v)),
            &[],
            Refused(&["seen.csv:2", "centimetres?", "x_cm"]),
        ),
        (
            "other axes",
            moved(|_, _, [x, y, z]| [x, z, -y]),
            &[],
            Refused(&["Other axes?", "observations.frame"]),
        ),
        (
            "another origin",
            moved(|_, _, [x, y, z]| [x - 4.0, y, z]),
            &[],
            Refused(&["40 of 40", "another origin"]),
        ),
        (
            "a lost marker as zeros",
            moved(|k, m, p| if k == 4 && m == 1 { [0.0; 3] } else { p }),
            &[],
            Refused(&["seen.csv:11", "marker tip at time 0.08 s", "0,0,0?"]),
        ),
        (
            "zeros, left out",
            moved(|k, m, p| if k == 4 && m == 1 { [0.0; 3] } else { p }),
            skip,
            Reads(117, "in lines 11:"),
        ),
        (
            "labels exchanged for a while",
            labelled(|k, m| if (6..9).contains(&k) { 1 - m } else { m }),
            &[],
            Refused(&[
                "seen.csv:14",
                "labels exchanged: marker middle and marker tip from 0.12 s to 0.16 s",
                "14 to 19",
            ]),
        ),
        (
            "labels exchanged to the end",
            labelled(|k, m| if k >= 12 { 1 - m } else { m }),
            &[],
            Refused(&["seen.csv:26", "marker middle and marker tip from 0.24 s on, to the end"]),
        ),
        (
            "labels exchanged, left out",
            labelled(|k, m| if (6..9).contains(&k) { 1 - m } else { m }),
            skip,
            Reads(102, "rows of exchanged labels, in lines 14, 15, 16, 17, 18, 19"),
        ),
        (
            "a jump within reach",
            moved(|k, m, p| if k == 9 && m == 1 { [0.1, 0.05, 0.95] } else { p }),
            &[],
            Refused(&[
                "seen.csv:21",
                "marker tip at time 0.18 s",
                "(0.1, 0.05, 0.95)",
                "(line 19)",
                "five times",
            ]),
        ),
        (
            "a jump beyond a stated speed",
            moved(|k, m, [x, y, z]| if k == 9 && m == 1 { [x, y + 0.03, z] } else { [x, y, z] }),
            &["observations.max_speed=0.5"],
            Refused(&["seen.csv:21", "m/s", "observations.max_speed is 0.5 m/s", "false detection"]),
        ),
        (
            "a marker at two places at once",
            with_line("0.06,tip,0.2,0.1,0.6"),
            &[],
            Refused(&["marker tip at time 0.06 s", "at the same time"]),
        ),
    ]
}

/// Rows of a base that moves from its place.
fn base(change: impl Fn(usize, String) -> Option<String>) -> Vec<u8> {
    let row = |k: usize| change(k, format!("{:.2},{:.4},0,0", 0.02 * k as f64, 1e-5 * (k * k) as f64));
    let rows: String = (0..=25).filter_map(row).map(|l| l + "\n").collect();
    format!("time_s,x_m,y_m,z_m\n{rows}").into_bytes()
}

fn bases() -> Vec<Broken> {
    let text = String::from_utf8(base(|_, l| Some(l))).unwrap_or_default();
    vec![
        ("a clean base", text.clone().into_bytes(), &[], Reads(120, "")),
        ("semicolons", text.replace(',', ";").replace('.', ",").into_bytes(), &[], Reads(120, "")),
        (
            "a gap",
            base(|k, l| (!(8..18).contains(&k)).then_some(l)),
            &[],
            Reads(120, "no rows from 0.14 to 0.36 s"),
        ),
        (
            "a gap of empty cells",
            base(|k, l| Some(if (8..18).contains(&k) { format!("{:.2},,,", 0.02 * k as f64) } else { l })),
            &[],
            Reads(120, "no rows from 0.14 to 0.36 s"),
        ),
        (
            "half a row",
            base(|k, l| Some(if k == 3 { "0.06,1,,0".into() } else { l })),
            &[],
            Refused(&["base.csv:5", "`y_m` is empty"]),
        ),
        (
            "a time twice",
            base(|k, l| Some(if k == 3 { "0.04,0,0,0".into() } else { l })),
            &[],
            Refused(&["base.csv:5", "time_s = 0.04 is not after"]),
        ),
        (
            "another clock",
            base(|k, _| Some(format!("{},0,0,0", 900.0 + 0.02 * k as f64))),
            &[],
            Refused(&["from 900", "needs 0 to 0.4 s", "time_zero"]),
        ),
        ("too short", base(|k, l| (k < 15).then_some(l)), &[], Refused(&["to 0.28 s", "needs 0 to 0.4 s"])),
        ("no rows", b"time_s,x_m,y_m,z_m\n".to_vec(), &[], Refused(&["has no rows"])),
        (
            "a word",
            base(|k, l| Some(if k == 3 { "0.06,here,0,0".into() } else { l })),
            &[],
            Refused(&["base.csv:5", "\"here\""]),
        ),
    ]
}
