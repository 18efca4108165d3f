//! `cargo xtask reports`: pages of results in a headless browser. Scenes of every kind run; a script opens
//! their pages at two widths, uses them as a reader does, and reports what fails.

use std::path::Path;
use std::process::{Command, Stdio};

use crate::browser::{self, Report};
use crate::{release_binary, root};

/// Commands that make pages, each with its folder.
const RUNS: [(&str, &[&str]); 10] = [
    ("hose", &["run", "hose"]),
    ("rod", &["run", "hanging-rod"]),
    ("wires", &["run", "wires"]),
    ("lorenz96", &["run", "lorenz96"]),
    ("cycles", &["run", "lorenz96-cycling-4dvar", "--set", "algorithm.cycles.count=40"]),
    ("rod-cycles", &["run", "hanging-rod-cycling", "--set", "algorithm.cycles.count=3"]),
    ("compare", &["compare", "lorenz63"]),
    ("sweep", &["sweep", "lorenz63", "--set", "observations.sigma=0.5,1,2", "--seeds", "0..4", "--fresh"]),
    ("modes", &["modes", "beam-release"]),
    ("weak", &["run", "hanging-rod-weak"]),
];

/// The largest page \[bytes\].
const LARGEST: u64 = 3_000_000;

/// Checks made of each view at least, and of all views that show a rod: a script that ended early made fewer.
const CHECKS: usize = 14;

/// `cargo xtask reports [VARDA]`.
pub(crate) fn check(arguments: &[&str]) -> Result<(), String> {
    let varda = match arguments {
        [] => release_binary("varda")?,
        [binary] => Path::new(binary).to_path_buf(),
        other => return Err(format!("unknown arguments of reports: {}", other.join(" "))),
    };
    let site = root().join("target/reports");
    let mut pages = Vec::new();
    let mut faults = Vec::new();
    for (name, arguments) in RUNS {
        let folder = site.join(name);
        let mut command = Command::new(&varda);
        command.args(arguments).arg("--out").arg(&folder).current_dir(root()).stdout(Stdio::null());
        // Codes 3 and 4 say that a run does not fit or did not converge: it has a page all the same.
        let code = command.status().map_err(|e| format!("{command:?}: {e}"))?.code();
        if !matches!(code, Some(0 | 3 | 4)) {
            return Err(format!("exit code {code:?}: {command:?}"));
        }
        let page = folder.join("report.html");
        let bytes = std::fs::metadata(&page).map_err(|e| format!("{}: {e}", page.display()))?.len();
        if bytes > LARGEST {
            faults.push(format!("{name}: the page has {bytes} bytes, {LARGEST} are allowed"));
        }
        pages.push(format!("{name}/report.html"));
    }
    if let Some(report) = browser::look(&site, &pages, include_str!("reports/harness.js"))? {
        let Report { faults: found, seen, counts } = report;
        if counts.len() != 3
            || counts[0] != 2 * pages.len()
            || counts[1] < CHECKS * counts[0]
            || counts[2] == 0
        {
            return Err(format!("the browser saw {seen} of {} pages in two widths", pages.len()));
        }
        faults.extend(found);
    }
    faults.iter().for_each(|fault| println!("{fault}"));
    if faults.is_empty() { Ok(()) } else { Err(format!("{} faults in reports", faults.len())) }
}
