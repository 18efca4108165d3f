//! Several recordings in one estimate: a page and a summary of all, and a folder for each.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::folder::ResultFolder;
use super::markup::{escape, in_brackets, list, scene_section, short, status_words, table, verdict};
use super::page::{Page, PageData};
use super::plot::write_page;
use super::summary::peak_bytes;
use super::{Summary, estimates, tables, write_one};
use crate::Error;
use crate::outcome::{Estimated, JointOutcome, Outcome, Seconds, Share, Verdict, WorkCounts, in_words};

/// The keys of summary.json of several recordings, in their order; `recordings` has those of each.
#[derive(Debug, Serialize)]
pub struct JointSummary {
    /// Whether the analyses explain the observations.
    pub verdict: Verdict,
    /// The numbers behind the verdict, and what to try.
    pub verdict_text: String,
    /// Name of the scene.
    pub scene: String,
    /// Seed of every random number.
    pub seed: u64,
    /// Version of Varda.
    pub version: &'static str,
    /// Method, as in a scene.
    pub method: &'static str,
    /// Minimizer, as in a scene.
    pub minimizer: &'static str,
    /// How the minimization ended.
    pub status: &'static str,
    /// Number of unknowns of all recordings, shared constants once.
    pub n_unknown: usize,
    /// Number of observed values m.
    pub n_obs: usize,
    /// J at the backgrounds.
    pub j_background: f64,
    /// J at the analyses.
    pub j_analysis: f64,
    /// What J is made of, each part with its mean.
    pub j_shares: Vec<Share>,
    /// 2J/m.
    pub chi2: f64,
    /// Degrees of freedom for signal; `null` without a posterior.
    pub degrees_of_freedom: Option<f64>,
    /// ‖∇J‖ at the first point, in the control variable.
    pub gradient_norm_first: f64,
    /// ‖∇J‖ at the last point.
    pub gradient_norm_last: f64,
    /// Outer iterations.
    pub outer_iterations: usize,
    /// Inner iterations, summed.
    pub inner_iterations: usize,
    /// Work of all models in the minimization.
    pub counts: WorkCounts,
    /// The constants of all recordings, then those of each.
    pub estimates: Vec<Estimated>,
    /// Where the time went \[s\].
    pub seconds: Seconds,
    /// Most memory the process used \[bytes\]; `null` where the system does not tell.
    pub peak_bytes: Option<u64>,
    /// Remarks that are of no recording alone.
    pub warnings: Vec<String>,
    /// The recordings in turn, each as in the summary.json of its own folder.
    pub recordings: Vec<Summary>,
}

impl JointSummary {
    /// The summary of a run.
    pub fn new(outcome: &JointOutcome) -> JointSummary {
        let algorithm = &outcome.scene.algorithm;
        JointSummary {
            verdict: outcome.judgement.verdict,
            verdict_text: outcome.judgement.text.clone(),
            scene: outcome.name.clone(),
            seed: outcome.scene.seed,
            version: env!("CARGO_PKG_VERSION"),
            method: algorithm.method.name(),
            minimizer: algorithm.solver_name(),
            status: outcome.status.name(),
            n_unknown: outcome.unknowns,
            n_obs: outcome.observations,
            j_background: outcome.j_background,
            j_analysis: outcome.j,
            j_shares: outcome.shares.clone(),
            chi2: outcome.chi2,
            degrees_of_freedom: outcome.degrees_of_freedom,
            gradient_norm_first: outcome.gradient_norms[0],
            gradient_norm_last: outcome.gradient_norms[1],
            outer_iterations: outcome.iterations[0],
            inner_iterations: outcome.iterations[1],
            counts: outcome.counts,
            estimates: outcome.estimates.clone(),
            seconds: outcome.seconds,
            peak_bytes: peak_bytes(),
            warnings: outcome.warnings.clone(),
            recordings: outcome.recordings.iter().map(Summary::new).collect(),
        }
    }

    /// As JSON text.
    #[allow(clippy::missing_panics_doc)] // a summary is plain data
    pub fn to_json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self).expect("a summary is plain data");
        text.push('\n');
        text
    }
}

/// Writes the result of several recordings to `folder`, whole or not at all: summary.json, report.html,
/// estimates.csv and convergence.csv of all, and for each recording a folder with the files of a run of its
/// own.
///
/// # Errors
/// As [`write()`](super::write()).
pub fn write_recordings(outcome: &JointOutcome, folder: &Path) -> Result<PathBuf, Error> {
    let out = ResultFolder::begin(folder)?;
    for one in &outcome.recordings {
        write_one(&out, &format!("{}/", one.experiment.name), one)?;
    }
    let summary = JointSummary::new(outcome);
    write_page(&out, "", &page(outcome, &summary))?;
    out.write("estimates.csv", &estimates::csv(&outcome.estimates))?;
    out.write("convergence.csv", &tables::convergence(&outcome.convergence))?;
    // Last: a folder without it is not a result.
    out.write("summary.json", &summary.to_json())?;
    out.publish()
}

fn page(outcome: &JointOutcome, summary: &JointSummary) -> PageData {
    let title = match outcome.scene.title.as_str() {
        "" => outcome.name.as_str(),
        title => title,
    };
    let mut body = format!(
        "<header><h1>{}</h1><p class=\"sub\">scene <code>{}</code> · seed {} · {} by {} · {} \
         · <span class=\"status {}\">{}</span></p></header>{}",
        escape(title),
        escape(&outcome.name),
        summary.seed,
        summary.method,
        summary.minimizer,
        in_words(outcome.recordings.len()),
        summary.status,
        status_words(outcome.status),
        verdict(&outcome.judgement),
    );
    if !summary.warnings.is_empty() {
        let notes = list(&summary.warnings);
        let _ = write!(body, "<section class=\"notes\"><h2>What to know</h2>{notes}</section>");
    }
    body.push_str(&estimates::section(&outcome.estimates));
    let share = |share: &Share| {
        let expected = share.expected.map_or("–".into(), short);
        format!(
            "<tr><th scope=\"row\">{}</th><td>{}</td><td>{expected}</td></tr>",
            share.part,
            short(share.j)
        )
    };
    let _ = write!(
        body,
        "<section><h2>The cost</h2><p>J {} → {}; 2J/m = {:.3} of {} values, {} unknowns; {} \
         iterations.</p>{}</section>",
        short(outcome.j_background),
        short(outcome.j),
        outcome.chi2,
        outcome.observations,
        outcome.unknowns,
        outcome.iterations[0],
        table(&["part of J", "is", "to expect"], &outcome.shares.iter().map(share).collect::<String>()),
    );
    outcome.recordings.iter().for_each(|one| body.push_str(&section(one)));
    body.push_str(&scene_section(&outcome.scene));
    let _ = write!(
        body,
        "<footer><p>Made by Varda {}. Files beside this page: summary.json, estimates.csv, convergence.csv, \
         and a folder for each recording.</p></footer>",
        summary.version,
    );
    let mut page = Page::new(title);
    page.push(&body);
    page.finish()
}

/// One recording: its verdict, how well it is fitted, and where its own page is.
fn section(one: &Outcome) -> String {
    let name = &one.experiment.name;
    let row = |f: &crate::outcome::Fit| {
        format!(
            "<tr><th scope=\"row\">{}</th><td>{}</td><td>{}</td><td>{}</td><td>{:.2}</td></tr>",
            escape(&f.label),
            f.count,
            short(f.rms_background),
            short(f.rms_analysis),
            f.ratio
        )
    };
    let unit = in_brackets(one.fit.iter().map(|f| f.quantity.unit()));
    let [before, after] = ["background", "analysis"].map(|of| format!("rms d, {of}{unit}"));
    let mut out = format!(
        "<section><h2>Recording {0}</h2>{1}<p>J {2}, 2J/m = {3:.3} of {4} values; <a \
         href=\"{0}/report.html\">its own page</a> has figures, trajectory and forecast.</p>{5}",
        escape(name),
        verdict(&one.judgement),
        short(one.analysis.value),
        one.analysis.chi2,
        one.analysis.observations,
        table(
            &["what is seen", "values", &before, &after, "rms d/σ"],
            &one.fit.iter().map(row).collect::<String>()
        ),
    );
    if !one.warnings.is_empty() {
        out.push_str(&list(&one.warnings));
    }
    out.push_str("</section>");
    out
}
