//! Figures 1 to 4 of the paper, from the shipped scenes: `cargo xtask figures`.

use std::fmt::Write;
use std::path::Path;

use varda::outcome::{CovarianceBlock, Outcome};
use varda::report::chart::{Corner, Figure, Image, Panel, Series, Style};
use varda::run::{Listener, assimilate};
use varda::scene::SceneFile;
use varda::setup::Problem;
use varda_assimilation::{ControlTransform, CostFunction, LeastSquares, StrongConstraint};
use varda_covariance::Diagonal;

use crate::options::Result;

/// Draws all four into docs/figures below `top`, and writes docs/results/figures.md about them.
///
/// # Errors
/// A scene that does not run, a figure that cannot be drawn, a file that cannot be written.
pub fn draw(top: &Path) -> Result<()> {
    let cases = ["hanging-rod-case1", "hanging-rod-case2", "hanging-rod-case3"];
    let newton = ["algorithm.minimizer=newton".to_string(), "algorithm.max_iterations=25".to_string()];
    let outcomes: Vec<Outcome> = cases.iter().map(|case| outcome(case, &newton)).collect::<Result<_>>()?;
    let case3 = &outcomes[2];
    let pieces = [
        (rod(&outcomes[0])?, rod_words().to_string()),
        (convergence(&outcomes), convergence_words(&outcomes)),
        (covariances(&case3.covariances)?, covariance_words(&case3.covariances)),
        precision(case3)?,
    ];
    let mut page = String::from(HEAD);
    for (figure, words) in &pieces {
        let file = format!("{}.svg", figure.name);
        let path = top.join("docs/figures").join(&file);
        std::fs::write(&path, figure.svg()?).map_err(|e| format!("{}: {e}", path.display()))?;
        let number = figure.name.trim_start_matches("figure-");
        let _ = writeln!(page, "\n## Figure {number}\n\n![{}](../figures/{file})\n\n{words}", figure.title);
    }
    let path = top.join("docs/results/figures.md");
    std::fs::write(&path, page).map_err(|e| format!("{}: {e}", path.display()).into())
}

const HEAD: &str = "\
# The paper's figures

Figures 1 to 4 of Gabbard's paper, drawn anew from the shipped scenes `hanging-rod-case1` to
`hanging-rod-case3` by `cargo xtask figures`, each with what the paper says of it. The draws of background and
observations are ours (seed 0 of the scenes), so numbers differ from the paper's while what they show can be
compared. The prior of these scenes knows that the clamp has no error.
";

fn outcome(scene: &str, sets: &[String]) -> Result<Outcome> {
    let problem = Problem::from_scene(&SceneFile::open(scene, sets)?)?;
    Ok(assimilate(&problem, &mut Listener::silent())?)
}

/// Figure 1: the rod ten steps apart, seen along y (x-z) and along x (y-z), and the points observed.
fn rod(case1: &Outcome) -> Result<Figure> {
    let shapes = case1.shapes.as_ref().ok_or("the scene has no rod")?;
    let grid = &case1.experiment.grid;
    let range = |axes: &[usize]| {
        let all = shapes.truth.iter().flatten().flat_map(|p| axes.iter().map(|c| p[*c]));
        let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        (low, high)
    };
    let (across, up) = (range(&[0, 1]), range(&[2]));
    let middle = 0.5 * (across.0 + across.1);
    // Panels of 150 by 230 pixels leave 84 by 152 to the curves.
    let scale = (1.05 * (up.1 - up.0) / 152.0).max(1.05 * (across.1 - across.0) / 84.0);
    let around = |middle: f64, pixels: f64| (middle - 0.5 * scale * pixels, middle + 0.5 * scale * pixels);
    let ranges = [around(middle, 84.0), around(0.5 * (up.0 + up.1), 152.0)];
    let panel = |k: usize| {
        let curve = |label: &str, style, c: usize| Series {
            label: label.into(),
            style,
            points: shapes.truth[k].iter().map(|p| (p[c], p[2])).collect(),
        };
        let seen = shapes.seen.iter().filter(|s| s.step == k).map(|s| (s.position[0], s.position[2]));
        Panel {
            title: format!("step {k}"),
            x_label: "x, y [m]".into(),
            y_label: if k == 0 { "z [m]".into() } else { String::new() },
            equal: Some(ranges),
            series: vec![
                curve("y", Style::Line(1), 1),
                curve("x", Style::Line(7), 0),
                Series { label: "observed".into(), style: Style::Dots(0), points: seen.collect() },
            ],
            ..Panel::default()
        }
    };
    let panels: Vec<Panel> = (0..=10).map(|i| panel(i * grid.steps / 10)).collect();
    Ok(Figure {
        name: "figure-1".into(),
        title:
            "The driven hanging rod, ten steps apart: x-z in black, y-z in orange, what was observed in blue"
                .into(),
        columns: panels.len(),
        panels,
        panel_size: (150, 230),
    })
}

fn rod_words() -> &'static str {
    "The paper: a hanging rod oscillates due to an elliptical drive at its fixed upper end; dots are the \
     observation points. Ours: the truth of case 1 over the window of two periods, every tenth step; from \
     the second picture on dots are the four observed places with their noise (σ is a tenth of the length)."
}

/// Figure 2: J, gradient and errors of positions and velocities by Newton's method, cases 1 to 3.
fn convergence(outcomes: &[Outcome]) -> Figure {
    let panel = |y_label: &str, value: &dyn Fn(&varda::outcome::ConvergenceRow) -> f64, legend| {
        let series = outcomes.iter().enumerate().map(|(i, o)| {
            let first = o.convergence.first().map_or(1.0, value);
            Series {
                label: format!("case {}", i + 1),
                style: Style::Marked(i),
                points: o.convergence.iter().map(|r| (r.iteration as f64, value(r) / first)).collect(),
            }
        });
        Panel {
            x_label: "iteration".into(),
            y_label: y_label.into(),
            log_y: true,
            legend,
            series: series.collect(),
            ..Panel::default()
        }
    };
    let rmse = |i: usize| move |r: &varda::outcome::ConvergenceRow| r.rmse[i];
    Figure {
        name: "figure-2".into(),
        title: "Convergence of Newton's method in cases 1 to 3, each quantity over its first value".into(),
        panels: vec![
            panel("J", &|r| r.j, Some(Corner::Top)),
            panel("gradient norm", &|r| r.gradient_norm, None),
            panel("RMSE of positions", &rmse(0), None),
            panel("RMSE of velocities", &rmse(1), None),
        ],
        columns: 4,
        panel_size: (290, 290),
    }
}

fn convergence_words(outcomes: &[Outcome]) -> String {
    let mut words = String::from(
        "The paper: initial velocities are assimilated much faster and more effectively than initial \
         positions, which change little; in all cases loss and gradient plateau after about a dozen \
         iterations. Ours:\n\n| case | iterations | J | RMSE of positions | RMSE of velocities \
         |\n|---|---|---|---|---|\n",
    );
    for (i, o) in outcomes.iter().enumerate() {
        let ratio = |group: &str| {
            o.rmse.of(group).and_then(|g| g.known()).map_or(f64::NAN, |[before, after]| after / before)
        };
        let _ = writeln!(
            words,
            "| {} | {} | {:.1} → {:.1} | × {:.2} | × {:.2} |",
            i + 1,
            o.iterations[0],
            o.j_background,
            o.analysis.value,
            ratio("position"),
            ratio("velocity")
        );
    }
    words
}

/// Figure 3: covariances of velocities in case 3, before and after, on one scale of colours.
fn covariances(blocks: &[CovarianceBlock]) -> Result<Figure> {
    let of = |component: &str| blocks.iter().find(|b| b.group == "velocity" && b.component == component);
    let shown =
        ["x", "z"].map(of).into_iter().collect::<Option<Vec<_>>>().ok_or("no posterior of velocities")?;
    let mut panels = Vec::new();
    for block in shown {
        for (name, values) in [("prior", &block.prior), ("posterior", &block.posterior)] {
            let high = block.prior.iter().copied().fold(0.0, f64::max);
            panels.push(matrix(
                format!("{name}, v{}", block.component),
                &block.places,
                values.clone(),
                [0.0, high],
                "[m²/s²]",
            ));
        }
    }
    Ok(Figure {
        name: "figure-3".into(),
        title: "Covariances of velocities in case 3 before and after the observations, along the rod".into(),
        panels,
        columns: 4,
        panel_size: (330, 290),
    })
}

fn covariance_words(blocks: &[CovarianceBlock]) -> String {
    let ratio = |group: &str, component: &str, at: f64| {
        let block = blocks.iter().find(|b| b.group == group && b.component == component)?;
        let n = block.places.len();
        let i =
            (0..n).min_by(|a, b| (block.places[*a] - at).abs().total_cmp(&(block.places[*b] - at).abs()))?;
        Some((block.posterior[i * n + i] / block.prior[i * n + i]).sqrt())
    };
    let number = |group, component| ratio(group, component, 0.5).unwrap_or(f64::NAN);
    format!(
        "The paper (its caption says x, its text z; both are drawn): a noticeable decrease in the variance \
         of the velocity midway down the centerline; the covariances of positions are virtually unchanged. \
         Ours, σ after over σ before at half of the length: {:.2} and {:.2} for velocities along x and z, \
         {:.2} and {:.2} for positions.",
        number("velocity", "x"),
        number("velocity", "z"),
        number("position", "x"),
        number("position", "z"),
    )
}

fn matrix(title: String, places: &[f64], values: Vec<f64>, range: [f64; 2], label: &str) -> Panel {
    let (first, last) = (places[0], places[places.len() - 1]);
    let half = 0.5 * (last - first) / (places.len() - 1) as f64;
    let ends = [first - half, last + half];
    Panel {
        title,
        x_label: "arc length [m]".into(),
        y_label: "arc length [m]".into(),
        image: Some(Image {
            x: ends,
            y: ends,
            downwards: true,
            columns: places.len(),
            values,
            label: label.into(),
            range,
        }),
        ..Panel::default()
    }
}

/// Figure 4: the precision of the initial state that one time of observation brings, for x of positions and
/// velocities: M_{0→k}ᵀ H_kᵀ R⁻¹ H_k M_{0→k} of the second, fifth and tenth time in case 3.
fn precision(case3: &Outcome) -> Result<(Figure, String)> {
    let problem = Problem::from_scene(&SceneFile::open("hanging-rod-case3", &[])?)?;
    let layout = &problem.experiment.state;
    let geometry = layout.geometry.as_ref().ok_or("the scene has no rod")?;
    let n = layout.len();
    let identity = Diagonal::uniform(n, 1.0)?;
    let mut observations = problem.observations()?;
    let mut model = problem.model();
    // With B = I the rows of G are those of R^{-1/2} H_k M_{0→k}.
    let transform = ControlTransform::new(case3.analysis.analysis.clone(), &identity)?;
    let mut cost = StrongConstraint::new(model.as_mut(), transform, &mut observations)?;
    cost.evaluate(&vec![0.0; n], Some(&mut vec![0.0; n]))?;
    let m = cost.observation_dim();
    let each = m / 10;
    let mut panels = Vec::new();
    let mut largest = Vec::new();
    for (group, name, label) in [(0, "x", "[1/m²]"), (1, "vx", "[s²/m²]")] {
        let range = layout.groups[group].range.clone();
        let places: Vec<f64> = geometry.free.iter().map(|v| geometry.arc_lengths[*v]).collect();
        for time in [2, 5, 10] {
            let size = places.len();
            let mut values = vec![0.0; size * size];
            for row in (time - 1) * each..time * each {
                let (mut unit, mut g) = (vec![0.0; m], vec![0.0; n]);
                unit[row] = 1.0;
                cost.jacobian_transpose(&unit, &mut g)?;
                let along: Vec<f64> = g[range.clone()].iter().step_by(3).copied().collect();
                for (i, a) in along.iter().enumerate() {
                    for (j, b) in along.iter().enumerate() {
                        values[i * size + j] += a * b;
                    }
                }
            }
            let ends = values.iter().fold([0.0_f64, 0.0], |[l, h], v| [l.min(*v), h.max(*v)]);
            largest.push(ends[1]);
            panels.push(matrix(format!("{name}, observation {time}"), &places, values, ends, label));
        }
    }
    let words = format!(
        "The paper: positions are observed directly and affected strongly by single values; the precision \
         of velocities is more diffuse, since they are assimilated through the dynamics, and decreases at \
         later times. Ours, largest entry at the second, fifth and tenth time: {:.3}, {:.3}, {:.3} for \
         positions and {:.4}, {:.4}, {:.4} for velocities.",
        largest[0], largest[1], largest[2], largest[3], largest[4], largest[5]
    );
    let figure = Figure {
        name: "figure-4".into(),
        title: "Precision of the initial state brought by single times of observation in case 3".into(),
        panels,
        columns: 3,
        panel_size: (330, 290),
    };
    Ok((figure, words))
}
