//! Where J jumps: the sheets on either side of the edge that a minimization ended at.

use std::error::Error;
use std::fmt::Write;
use std::ops::ControlFlow;

use varda::scene::SceneFile;
use varda::setup::Problem;
use varda_assimilation::{
    AutoOptions, ControlTransform, CostFunction, Hessian, Minimizer, Stopping, StrongConstraint,
};

use super::runs::{TOLERANCE, norm};

/// Iterations at most: those of scenes.
const MOST: usize = 1000;
/// Lengths along −∇J at which J is looked at, in σ: from the first to 1.
const FIRST: f64 = 1e-13;
const PER_DECADE: u32 = 8;
const LENGTHS: u32 = 13 * PER_DECADE + 1;
/// Halvings of the length at which J jumps.
const HALVINGS: usize = 60;
/// J jumps where it differs by so much from the parabola through its value, slope and what it was before.
const JUMP: f64 = 1e-6;

const TEXT: &str = include_str!("edges.md");

/// The page of these seeds.
pub(super) fn page(seeds: &[u64]) -> Result<String, Box<dyn Error>> {
    let mut table = String::from(
        "| seed | Hessian | ended as | J | ‖∇J‖ over the first | at | J beyond − J | slope | \
         slope beyond |\n",
    );
    table += "|--:|---|---|--:|--:|--:|--:|--:|--:|\n";
    let hessians = [("Gauss–Newton", Hessian::GaussNewton), ("exact", Hessian::Exact)];
    for (&seed, (name, hessian)) in seeds.iter().flat_map(|seed| hessians.map(|hessian| (seed, hessian))) {
        let Edge { status, j, gradient, jump } = edge(seed, hessian)?;
        let _ = write!(table, "| {seed} | {name} | {status} | {j:.6} | {gradient:.1e} | ");
        let _ = match jump {
            Some(Jump { at, j, slope }) => {
                writeln!(table, "{:.1e} | {:.4} | {:.2e} | {:.2e} |", at[0], j[1] - j[0], slope[0], slope[1])
            }
            None => writeln!(table, "none to {:.0} | – | – | – |", length(LENGTHS - 1)),
        };
    }
    let listed: Vec<String> = seeds.iter().map(u64::to_string).collect();
    Ok(TEXT.replace("SEEDS_TABLE", &table).replace("SEEDS", &listed.join(",")))
}

/// An end of a minimization, and the nearest jump of J along −∇J from there.
struct Edge {
    status: String,
    /// J at the end.
    j: f64,
    /// ‖∇J‖ at the end over that at the background.
    gradient: f64,
    jump: Option<Jump>,
}

/// A jump of J on the way d = −∇J/‖∇J‖ from a point.
struct Jump {
    /// How far the two sides are from the point, in σ of the control variable.
    at: [f64; 2],
    /// J on the two sides.
    j: [f64; 2],
    /// Its slope along d on the two sides.
    slope: [f64; 2],
}

/// Minimizes J of a seed of case 4 with the plain prior, and looks for the edge.
fn edge(seed: u64, hessian: Hessian) -> Result<Edge, Box<dyn Error>> {
    let file = SceneFile::open("hanging-rod-case4-plain", &[format!("seed={seed}")])?;
    let problem = Problem::from_scene(&file)?;
    let transform = ControlTransform::new(problem.background.clone(), problem.covariance.as_ref())?;
    let (mut model, mut observations) = (problem.model(), problem.observations()?);
    let mut cost = StrongConstraint::new(model.as_mut(), transform, &mut observations)?;
    let mut v = vec![0.0; cost.dim()];
    let mut gradient = v.clone();
    cost.evaluate(&v, Some(&mut gradient))?;
    let first = norm(&gradient);
    let mut options = AutoOptions::default();
    options.trust_region = options.trust_region.with_hessian(hessian);
    options.trust_region.stopping = Stopping::new(TOLERANCE, MOST);
    let ended = Minimizer::Auto(options).minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(()))?;
    let j = cost.evaluate(&v, Some(&mut gradient))?;
    let size = norm(&gradient);
    let mut way = Way { cost: &mut cost, v, d: gradient.iter().map(|g| -g / size).collect() };
    let jump = way.jump(j, -size)?;
    Ok(Edge { status: format!("{:?}", ended.status), j, gradient: size / first, jump })
}

struct Way<'a, C> {
    cost: &'a mut C,
    v: Vec<f64>,
    d: Vec<f64>,
}

impl<C: CostFunction> Way<'_, C> {
    /// J and its slope along d.
    fn at(&mut self, t: f64) -> Result<[f64; 2], Box<dyn Error>> {
        let point: Vec<f64> = self.v.iter().zip(&self.d).map(|(v, d)| v + t * d).collect();
        let mut gradient = vec![0.0; point.len()];
        let j = self.cost.evaluate(&point, Some(&mut gradient))?;
        Ok([j, gradient.iter().zip(&self.d).map(|(g, d)| g * d).sum()])
    }

    /// The nearest jump: J there is not the integral of its slopes.
    fn jump(&mut self, j: f64, slope: f64) -> Result<Option<Jump>, Box<dyn Error>> {
        let mut before = (0.0, j, slope);
        for i in 0..LENGTHS {
            let t = length(i);
            let [j, slope] = self.at(t)?;
            if jumps(before, (t, j, slope)) {
                let mut after = (t, j, slope);
                for _ in 0..HALVINGS {
                    let middle = 0.5 * (before.0 + after.0);
                    if middle <= before.0 || middle >= after.0 {
                        break;
                    }
                    let [j, slope] = self.at(middle)?;
                    if jumps(before, (middle, j, slope)) {
                        after = (middle, j, slope);
                    } else {
                        before = (middle, j, slope);
                    }
                }
                let (a, b) = (before, after);
                return Ok(Some(Jump { at: [a.0, b.0], j: [a.1, b.1], slope: [a.2, b.2] }));
            }
            before = (t, j, slope);
        }
        Ok(None)
    }
}

/// Length number i.
fn length(i: u32) -> f64 {
    FIRST * 10f64.powf(f64::from(i) / f64::from(PER_DECADE))
}

/// Whether J between two points is not the mean of its slopes times the way, by more than a share of J.
fn jumps(a: (f64, f64, f64), b: (f64, f64, f64)) -> bool {
    let expected = 0.5 * (a.2 + b.2) * (b.0 - a.0);
    !((b.1 - a.1 - expected).abs() <= JUMP * a.1.abs() + 0.5 * (b.2 - a.2).abs() * (b.0 - a.0))
}
