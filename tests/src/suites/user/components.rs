//! Recordings of models that are not rods: components, and places on a line.

use super::folder::Folder;
use crate::row::{Case, Outcome, Rows};
use varda::preview::{Severity, findings};
use varda::setup::Inputs;

/// A ring of eight variables; the file has its components.
const RING: &str = r#"
[model]
kind = "lorenz96"
variables = 8
[time]
integrator = "rk4"
step = 0.025
window = 8
[background]
from = "truth-plus-draw"
covariance = { kind = "diagonal", sigma = 1.0 }
[observations]
kind = "file"
file = "seen.csv"
sigma = 0.4
"#;

/// Fronts on a circle; the file has places.
const CIRCLE: &str = r#"
[model]
kind = "kuramoto-sivashinsky"
points = 64
length = 50.0
[time]
integrator = "midpoint"
step = 0.25
window = 8
[background]
from = "truth-plus-draw"
covariance = { kind = "line", sigma = 0.5, correlation_length = 5.0 }
[observations]
kind = "file"
file = "seen.csv"
sigma = 0.1
"#;

/// What must come of a file.
enum Wanted {
    /// So many rows of so many are used; nothing is said.
    Used([usize; 2]),
    /// An error with these words.
    Refused(&'static [&'static str]),
    /// A finding with these words.
    Said(Severity, &'static [&'static str]),
}
use Wanted::{Refused, Said, Used};

/// A name, the scene, keys that are set, the file, what must come of it.
type Input = (&'static str, &'static str, &'static [&'static str], &'static str, Wanted);

pub(super) fn run(rows: &mut Rows) {
    rows.area("recorded components");
    rows.reason("rows are used, or refused with file, row and cause");
    for (name, scene, sets, csv, wanted) in INPUTS {
        rows.case(name, |case| read(case, [name, scene, csv], sets, wanted));
    }
}

fn read(case: &mut Case, [name, scene, csv]: [&str; 3], sets: &[&str], wanted: &Wanted) -> Outcome {
    let folder = Folder::new(name)?;
    folder.write("seen.csv", csv.as_bytes())?;
    let inputs = folder.scene(scene, sets).and_then(|file| Inputs::read(&file));
    let has = |words: &[&str], text: &str| words.iter().all(|word| text.contains(word));
    let (right, note) = match (&inputs, wanted) {
        (Err(error), Refused(words)) => (has(words, &error.to_string()), error.to_string()),
        (Err(error), _) => (false, error.to_string()),
        (Ok(inputs), wanted) => {
            let found = findings(inputs);
            let rows = inputs.observed.recording.as_ref().map(|r| r.rows).unwrap_or_default();
            let right = match wanted {
                Used(counts) => found.is_empty() && [rows.used, rows.all] == *counts,
                Refused(_) => false,
                Said(severity, words) => {
                    found.iter().any(|f| f.severity == *severity && has(words, &f.to_string()))
                }
            };
            let said: Vec<String> = found.iter().map(ToString::to_string).collect();
            (right && rows.parts() == rows.all, format!("{rows} {}", said.join("; ")))
        }
    };
    case.count("as it should be", usize::from(right), 1).note(note);
    Ok(())
}

const INPUTS: &[Input] = &[
    (
        "errors correlated in time",
        RING,
        &["observations.correlation={ time = 0.1 }"],
        "time_s,component,value\n0.1,x1,1.5\n0.2,x1,-3\n",
        Used([2, 2]),
    ),
    (
        "correlated errors of one time and place",
        RING,
        &["observations.correlation={ time = 0.1 }"],
        "time_s,component,value\n0.1,x1,1.5\n0.1,x1,-3\n",
        Refused(&["observations.correlation", "x1 is seen twice at 0.1 s"]),
    ),
    (
        "a length on a ring",
        RING,
        &["observations.correlation={ length = 0.1 }"],
        "time_s,component,value\n0.1,x1,1.5\n",
        Refused(&["correlation", "no line"]),
    ),
    ("names and numbers", RING, &[], "time_s,component,value\n0.1,x1,1.5\n0.1,2,-3\n", Used([2, 2])),
    ("unsorted, twice", RING, &[], "value,component,time_s\n1,3,0.2\n2,3,0.1\n1,3,0.2\n", Used([2, 3])),
    ("decimal commas", RING, &[], "time_s;component;value;sigma\n0,1;x1;1,5;0,2\n", Used([1, 1])),
    ("times in ms", RING, &[], "time_ms,component,value\n100,x1,1.5\n", Used([1, 1])),
    ("a component of no model", RING, &[], "time_s,component,value\n0.1,8,1\n", Refused(&[":2", "0 to 7"])),
    ("a value that is no number", RING, &[], "time_s,component,value\n0.1,1,inf\n", Refused(&[":2", "inf"])),
    ("places of a ring", RING, &[], "time_s,s_m,value\n0.1,1,1\n", Refused(&[":2", "no line"])),
    (
        "ms called s",
        RING,
        &[],
        "time_s,component,value\n0,1,1\n100,1,1\n",
        Refused(&["seen.csv:3", "outside the window", "time_ms"]),
    ),
    (
        "no row in the window",
        RING,
        &["observations.outside_window=skip"],
        "time_s,component,value\n7,1,1\n7.1,1,1\n",
        Said(Severity::Error, &["nothing is observed", "2 outside", "time_zero = 7"]),
    ),
    (
        "σ beyond the attractor",
        RING,
        &["observations.sigma=40.0"],
        "time_s,component,value\n0.1,1,1\n",
        Said(Severity::Warning, &["observations.sigma", "nothing is learnt"]),
    ),
    (
        "a key of rods",
        RING,
        &["observations.max_speed=1.0"],
        "time_s,component,value\n0.1,1,1\n",
        Refused(&["max_speed", "is about rods"]),
    ),
    ("places between points", CIRCLE, &[], "time_s,s_cm,value\n1,33,0.5\n1,5000,0.1\n", Used([2, 2])),
    (
        "places in mm",
        CIRCLE,
        &[],
        "time_s,s_m,value\n1,25000,0.5\n",
        Refused(&["seen.csv:2", "off the line (0 to 50 m)", "s_mm"]),
    ),
];
