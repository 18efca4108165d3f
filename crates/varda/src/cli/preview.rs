//! What `check` prints, and what `run` says of a scene before it starts.

use std::fmt::Write;
use std::process::ExitCode;

use super::style;
use crate::Error;
use crate::outcome::{Neighbours, RecordingSummary, TrackSummary};
use crate::preview::{Finding, MeshEffect, Misfit, ModeDamping, Preview, Severity, findings};
use crate::scene::SceneFile;
use crate::setup::{Inputs, Recordings};

/// The lines of `run` before it starts: the rows of a recording, and what looks wrong.
pub(super) fn in_short(inputs: &Inputs) -> String {
    let mut out = String::new();
    if let Some(recording) = &inputs.observed.recording {
        let _ = writeln!(out, "data: {}", data(recording));
    }
    for finding in findings(inputs) {
        let _ = writeln!(out, "{}: {finding}", name(finding.severity));
    }
    out
}

/// `check --json`: what was found and all numbers behind it, or the error of a scene that cannot be read.
pub(super) fn check_as_json(opened: Result<SceneFile, Error>) -> ExitCode {
    let previews = opened.and_then(|file| {
        let previews = match file.has_recordings() {
            true => {
                let each = Recordings::inputs(&file)?.into_iter().map(Preview::of);
                let previews = each.collect::<Result<Vec<_>, _>>()?;
                // what they share must be the same
                Recordings::from_scene(&file)?;
                previews
            }
            false => vec![Preview::new(&file)?],
        };
        Ok((file.name, previews))
    });
    let (scene, findings, previews) = match previews {
        Ok((scene, previews)) => {
            let findings = previews.iter().flat_map(|p| p.findings.clone()).collect::<Vec<_>>();
            (Some(scene), findings, previews)
        }
        Err(error) => {
            let (place, text) = match error {
                Error::Scene { place, message, .. } | Error::Data { place, message } => (place, message),
                other => (String::new(), other.to_string()),
            };
            (None, vec![Finding { severity: Severity::Error, place, text }], Vec::new())
        }
    };
    let wrong = findings.iter().any(|finding| finding.severity == Severity::Error);
    let found = serde_json::json!({
        "scene": scene,
        "version": env!("CARGO_PKG_VERSION"),
        "method": "check",
        "findings": findings,
        "scenes": previews,
    });
    style::line(format_args!("{found:#}"));
    if wrong { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}

/// What `check` prints.
pub(super) fn table(preview: &Preview) -> String {
    let p = &preview.plan;
    let mut out = format!("{}: {}\n", p.name, headline(&preview.findings));
    let mut line = |name: &str, text: String| {
        let _ = writeln!(out, "  {name:<14} {text}");
    };
    if !p.title.is_empty() {
        line("title", p.title.clone());
    }
    line("state", format!("{} numbers", p.n_state));
    let known = if p.n_known > 0 { format!(", {} of them known", p.n_known) } else { String::new() };
    line("control", format!("{} numbers{known}", p.n_control));
    line("method", p.method.clone());
    if p.n_errors > 0 {
        line("model error", format!("{} numbers at most", p.n_errors));
    }
    if p.members > 0 {
        line("ensemble", format!("{} members, {} runs of the window at a time", p.members, p.members + 1));
    }
    if p.is_one_shape {
        line("observations", format!("{} values of one shape, without times", p.n_obs));
    } else {
        line("observations", format!("{} values at {} times", p.n_obs, p.times));
        line(
            "window",
            format!(
                "{} steps of {:.6} s from t = {:.6} s, after {} steps of spin-up",
                p.window.steps, p.window.step, p.window.start, p.spin_up
            ),
        );
    }
    if let Some([count, shift, steps]) = p.cycles {
        line("cycles", format!("{count} windows, {shift} steps apart: {steps} steps"));
    }
    let about = format!("about {:.1} MB", p.bytes as f64 / 1e6);
    line(
        "memory",
        match p.bytes_per_part {
            None => about,
            Some(bytes) => format!(
                "{about} without adaptive steps; each step that time.tolerance adds takes {:.1} kB more",
                bytes as f64 / 1e3
            ),
        },
    );
    line("time", expected(preview.seconds));
    if let Some(recording) = &preview.recording {
        line("data", data(recording));
        for alike in alike(&recording.tracks) {
            line("", self::tracks(&alike));
        }
        if !recording.neighbours.is_empty() {
            line("neighbours", neighbours(&recording.neighbours));
        }
    }
    if let Some(misfit) = &preview.misfit {
        line("background", background(misfit));
    }
    for mode in &preview.modes {
        line("mode", self::mode(mode));
    }
    if let Some(mesh) = &preview.mesh {
        line("mesh", self::mesh(mesh));
    }
    for text in &p.left_out {
        line("left out", text.clone());
    }
    for finding in &preview.findings {
        line(name(finding.severity), finding.to_string());
    }
    out
}

fn name(severity: Severity) -> &'static str {
    match severity {
        Severity::Warning => "warning",
        Severity::Error => "error",
    }
}

/// "nothing wrong", or how much of what.
fn headline(findings: &[Finding]) -> String {
    let count = |severity| findings.iter().filter(|f| f.severity == severity).count();
    let of = |n: usize, what: &str| match n {
        0 => None,
        1 => Some(format!("1 {what}")),
        n => Some(format!("{n} {what}s")),
    };
    let parts: Vec<String> = [of(count(Severity::Error), "error"), of(count(Severity::Warning), "warning")]
        .into_iter()
        .flatten()
        .collect();
    if parts.is_empty() { "nothing wrong".into() } else { parts.join(", ") }
}

fn data(recording: &RecordingSummary) -> String {
    let ([first, last], [from, to]) = (recording.span, recording.window);
    let times = match first == last && from == to {
        true => String::new(),
        false => format!(" {first} to {last} s, the window is {from:.6} to {to:.6} s;"),
    };
    format!(
        "{};{times} {} {}",
        recording.rows,
        recording.tracks.iter().filter(|t| t.rows > 0).count(),
        recording.sites_are.name()
    )
}

/// Markers with the same rate, σ and no gap go together; scatter is that of the first.
fn alike(tracks: &[TrackSummary]) -> Vec<Vec<&TrackSummary>> {
    let mut groups: Vec<Vec<&TrackSummary>> = Vec::new();
    let same = |a: &TrackSummary, b: &TrackSummary| {
        let close = |x: f64, y: f64| (x - y).abs() <= 1e-6 * x.abs();
        a.rows == b.rows
            && a.quantity == b.quantity
            && close(a.interval, b.interval)
            && close(a.sigma, b.sigma)
    };
    for track in tracks {
        let whole = |t: &TrackSummary| t.gap.is_none();
        match groups.iter_mut().find(|g| whole(g[0]) && whole(track) && same(g[0], track)) {
            Some(group) => group.push(track),
            None => groups.push(vec![track]),
        }
    }
    groups
}

fn tracks(alike: &[&TrackSummary]) -> String {
    let track = alike[0];
    let unit = track.quantity.unit_after();
    let labels: Vec<&str> = alike.iter().map(|t| t.label.as_str()).collect();
    let each = if alike.len() > 1 { " each" } else { "" };
    let mut text = format!("{}: {} rows{each}", labels.join(", "), track.rows);
    if track.interval > 0.0 {
        let _ = write!(text, ", every {:.6} s ({:.4} Hz)", track.interval, 1.0 / track.interval);
    }
    if let Some([begin, length]) = track.gap {
        let _ = write!(text, ", longest gap {length:.4} s from {begin:.4} s");
    }
    let _ = write!(text, ", σ {:.2e}{unit}", track.sigma);
    if let Some(scatter) = track.scatter {
        let _ = write!(text, ", scatters by {scatter:.1e}{unit} from row to row");
    }
    text
}

fn neighbours(all: &[Neighbours]) -> String {
    let one = |n: &Neighbours| {
        let [a, b] = &n.labels;
        format!("{a} to {b}: {:.4} m apart at most, {:.4} m of rod", n.farthest, n.arc)
    };
    const SHOWN: usize = 6;
    let more = all.len().saturating_sub(SHOWN);
    let more = if more > 0 { format!("; {more} more") } else { String::new() };
    format!("{}{more}", all.iter().take(SHOWN).map(one).collect::<Vec<_>>().join("; "))
}

fn background(misfit: &Misfit) -> String {
    format!(
        "2J/m = {:.3} before the analysis, {:.1} σ rms over {} values; farthest {}, {:.1} σ",
        misfit.chi2,
        misfit.chi2.sqrt(),
        misfit.values,
        misfit.worst.0,
        misfit.worst.1
    )
}

fn mode(mode: &ModeDamping) -> String {
    format!(
        "{:.4} Hz, {:.0} steps a period: slowed by {:.2} % and damped by {:.3} 1/s by the integrator, \
         {:.3} 1/s at most by the material",
        mode.frequency,
        mode.steps,
        100.0 * mode.slowed,
        mode.numerical,
        mode.material
    )
}

fn mesh(mesh: &MeshEffect) -> String {
    format!(
        "twice as many segments move the rod at rest by {:.2e} m at most, at s = {:.4} m ({:.3} % of its \
         length)",
        mesh.moves,
        mesh.arc_length,
        100.0 * mesh.share
    )
}

fn expected([least, most]: [f64; 2]) -> String {
    let shown = |s: f64| match s {
        s if s < 0.01 => "0.01 s".into(),
        s if s < 0.095 => format!("{s:.2} s"),
        s if s < 9.5 => format!("{s:.1} s"),
        s if s < 300.0 => format!("{s:.0} s"),
        s => format!("{:.0} min", s / 60.0),
    };
    if most < 0.01 {
        return "below 0.01 s for the analysis, by one forward run".into();
    }
    format!("about {} to {} for the analysis, by one forward run", shown(least), shown(most))
}
