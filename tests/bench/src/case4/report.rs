//! The study as a table (Markdown), its runs (CSV), and error against seconds (SVG).

use std::fmt::Write;

use super::runs::{Run, SAMPLES, Twin, Way, sample_time};

/// At the lowest known: within this share of J.
const SAME: f64 = 1e-6;

/// The runs with the lowest J known of every draw: of Levenberg–Marquardt from the background, through the
/// ladder, and from draws of the prior.
pub(crate) struct Study {
    pub(crate) runs: Vec<Run>,
    pub(crate) words: &'static str,
}

impl Study {
    /// The lowest J the reference found, and whether a run that converged is there.
    fn lowest(&self, twin: Twin) -> (f64, bool) {
        let of = || self.runs.iter().filter(move |r| r.twin == twin && r.way.is_reference());
        let lowest = of().map(|r| r.j).fold(f64::INFINITY, f64::min);
        (lowest, of().any(|r| r.converged() && r.j <= lowest * (1.0 + SAME)))
    }

    /// J / J_lowest − 1.
    fn gap(&self, run: &Run) -> f64 {
        run.j / self.lowest(run.twin).0 - 1.0
    }

    fn of(&self, prior: &str, way: Way) -> Vec<&Run> {
        self.runs.iter().filter(|r| r.twin.prior == prior && r.way == way).collect()
    }

    pub(crate) fn markdown(&self) -> String {
        let mut text = String::from(self.words);
        for prior in ["clamp", "plain"] {
            let _ = write!(
                text,
                "\n## Prior \"{prior}\"\n\n\
                 | minimizer | seeds | converged | at the lowest J known | both | median gap | worst gap | \
                 model failure | median CPU s | median forward runs | median gradients \
                 |\n|---|---|---|---|---|---|---|---|---|---|---|\n"
            );
            for way in Way::ALL {
                let runs = self.of(prior, way);
                if runs.is_empty() || matches!(way, Way::Draw(1..)) {
                    continue;
                }
                let count = |f: &dyn Fn(&Run) -> bool| runs.iter().filter(|r| f(r)).count();
                let middle = |f: &dyn Fn(&Run) -> f64| median(runs.iter().map(|r| f(r)).collect());
                let low = |r: &Run| self.gap(r) <= SAME;
                let _ = writeln!(
                    text,
                    "| {} | {} | {} | {} | {} | {} | {} | {} | {:.2} | {} | {} |",
                    title(way),
                    runs.len(),
                    count(&|r| r.converged()),
                    count(&low),
                    count(&|r| r.converged() && low(r)),
                    short(middle(&|r| self.gap(r))),
                    short(runs.iter().map(|r| self.gap(r)).fold(f64::NEG_INFINITY, f64::max)),
                    count(&|r| r.failed()),
                    middle(&|r| r.seconds),
                    middle(&|r| r.forward_runs as f64),
                    middle(&|r| r.gradients as f64),
                );
            }
            text.push_str(&self.exceptions(prior));
        }
        text
    }

    /// The seeds where the default is not at a stationary point with the lowest J known.
    fn exceptions(&self, prior: &str) -> String {
        let all = self.of(prior, Way::Auto);
        let wrong: Vec<&Run> = all.iter().copied().filter(|r| !r.converged() || self.gap(r) > SAME).collect();
        let lower = all.iter().filter(|r| self.gap(r) < -SAME).count();
        let mut text = format!("\nThe default is below the lowest of the reference for {lower} seeds. ");
        if wrong.is_empty() {
            text.push_str("It converged to the lowest J known for every seed.\n");
            return text;
        }
        text.push_str(
            "Seeds where it did not converge or is not at the lowest J known:\n\n\
             | seed | ended | J | lowest J known | a stationary point known there | gap | ‖∇J‖ / first \
             |\n|---|---|---|---|---|---|---|\n",
        );
        for run in wrong {
            let (lowest, stationary) = self.lowest(run.twin);
            let _ = writeln!(
                text,
                "| {} | {} | {:.6} | {lowest:.6} | {} | {} | {:.1e} |",
                run.twin.seed,
                run.status,
                run.j,
                if stationary { "yes" } else { "no" },
                short(self.gap(run)),
                run.gradient
            );
        }
        text
    }

    pub(crate) fn csv(&self) -> String {
        let mut text = String::from(
            "prior,seed,minimizer,status,j_background,j,lowest_known,gap,relative_gradient,cpu_seconds,\
             forward_runs,gradients\n",
        );
        for r in &self.runs {
            let _ = writeln!(
                text,
                "{},{},{},{},{:.6e},{:.10e},{:.10e},{:.3e},{:.3e},{:.3},{},{}",
                r.twin.prior,
                r.twin.seed,
                r.way.name(),
                r.status,
                r.j_background,
                r.j,
                self.lowest(r.twin).0,
                self.gap(r),
                r.gradient,
                r.seconds,
                r.forward_runs,
                r.gradients
            );
        }
        text
    }

    /// Median over seeds of (J − J*)/(J₀ − J*) against CPU seconds, both axes logarithmic.
    pub(crate) fn svg(&self) -> String {
        let (wide, high) = (440.0, 380.0);
        let mut text = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {high}\" width=\"{}\" \
             height=\"{high}\" font-family=\"sans-serif\" font-size=\"11\" role=\"img\">\n<title>Case 4: \
             error against seconds</title>\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n",
            2.0 * wide + 170.0,
            2.0 * wide + 170.0
        );
        // decades of seconds and of the gap
        let (t0, t1, y0, y1) = (-2.5, 1.8, -10.0, 0.3);
        let x = |panel: f64, t: f64| panel * wide + 55.0 + (t - t0) / (t1 - t0) * (wide - 75.0);
        let y = |gap: f64| 40.0 + (y1 - gap) / (y1 - y0) * (high - 90.0);
        for (panel, prior) in ["clamp", "plain"].into_iter().enumerate() {
            let at = panel as f64;
            let _ = writeln!(
                text,
                "<text x=\"{:.0}\" y=\"24\" font-size=\"13\">prior {prior}: median over seeds of (J − \
                 J*)/(J₀ − J*)</text><text x=\"{:.0}\" y=\"{:.0}\">CPU seconds</text>",
                x(at, t0),
                x(at, -0.6),
                high - 12.0
            );
            for t in -2..=1 {
                let (px, low) = (x(at, f64::from(t)), y(y0));
                let _ = writeln!(
                    text,
                    "<path d=\"M{px:.1} {:.1}V{low:.1}\" stroke=\"#ddd\"/><text x=\"{px:.1}\" y=\"{:.1}\" \
                        text-anchor=\"middle\">1e{t}</text>",
                    y(y1),
                    low + 16.0
                );
            }
            for decade in (-10..=0).step_by(2) {
                let py = y(f64::from(decade));
                let _ = writeln!(
                    text,
                    "<path d=\"M{:.1} {py:.1}H{:.1}\" stroke=\"#ddd\"/><text x=\"{:.1}\" y=\"{:.1}\" \
                        text-anchor=\"end\">1e{decade}</text>",
                    x(at, t0),
                    x(at, t1),
                    x(at, t0) - 5.0,
                    py + 4.0
                );
            }
            for (way, colour) in COLOURS {
                let runs = self.of(prior, way);
                if runs.is_empty() {
                    continue;
                }
                let mut path = String::new();
                for i in 0..SAMPLES {
                    let gaps = runs.iter().map(|r| {
                        let lowest = self.lowest(r.twin).0;
                        ((r.curve[i] - lowest) / (r.j_background - lowest)).max(1e-12)
                    });
                    let t = sample_time(i).log10();
                    let gap = median(gaps.collect()).log10().max(y0);
                    let _ = write!(path, "{}{:.1} {:.1}", if i == 0 { 'M' } else { 'L' }, x(at, t), y(gap));
                }
                let _ = writeln!(
                    text,
                    "<path d=\"{path}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.8\"/>"
                );
            }
        }
        for (i, (way, colour)) in COLOURS.into_iter().enumerate() {
            let (px, py) = (2.0 * wide + 5.0, 60.0 + 20.0 * i as f64);
            let _ = writeln!(
                text,
                "<path d=\"M{px} {py}h20\" stroke=\"{colour}\" stroke-width=\"2\"/><text x=\"{}\" \
                    y=\"{}\">{}</text>",
                px + 26.0,
                py + 4.0,
                way.name()
            );
        }
        text + "</svg>\n"
    }
}

/// Okabe and Ito's colours.
const COLOURS: [(Way, &str); 7] = [
    (Way::Auto, "#000000"),
    (Way::Lm, "#0072b2"),
    (Way::Ladder, "#009e73"),
    (Way::Lbfgs, "#d55e00"),
    (Way::Newton, "#cc79a7"),
    (Way::AdamControl, "#e69f00"),
    (Way::AdamRaw, "#999999"),
];

fn title(way: Way) -> &'static str {
    match way {
        Way::Auto => "**the default (`auto`)**",
        Way::Lm => "LM (`trust-region`) from the background",
        Way::Ladder => "continuation: LM through σ × 10, 3, 1",
        Way::Lbfgs => "L-BFGS",
        Way::Newton => "the paper's Newton, full steps",
        Way::AdamControl => "Adam in the control variable",
        Way::AdamRaw => "Adam in raw variables",
        Way::Draw(_) => "LM from a draw of the prior (the first of five)",
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// A gap in two digits; rounding of J is 0.
fn short(gap: f64) -> String {
    if gap.abs() < 1e-9 { "0".into() } else { format!("{gap:.1e}") }
}
