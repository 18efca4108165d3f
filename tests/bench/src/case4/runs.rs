//! One run of one minimizer on one draw, and the file that remembers it.

use std::error::Error;
use std::fmt::Write;
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;

use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use varda::scene::SceneFile;
use varda::setup::Problem;
use varda_assimilation::{
    AdamOptions, AutoOptions, ControlTransform, CostFunction, Iteration, LbfgsOptions, Minimizer, Minimum,
    NewtonOptions, RawVariables, Status, StrongConstraint, TrustRegionOptions, adam, continuation,
};

/// Relative gradient at which every run ends: that of scenes.
pub(super) const TOLERANCE: f64 = 1e-8;
/// Draws of the prior from which the reference starts Levenberg–Marquardt.
const DRAWS: usize = 5;
/// Curves are sampled at 10^(i/10 − 2.5) s.
pub(crate) const SAMPLES: usize = 44;

/// What is run on a draw.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Way {
    /// The default of scenes.
    Auto,
    /// Levenberg–Marquardt (the trust region) from the background.
    Lm,
    /// The same through σ × 10, 3, 1.
    Ladder,
    Lbfgs,
    /// The paper's: full steps.
    Newton,
    AdamControl,
    AdamRaw,
    /// Levenberg–Marquardt from a draw of the prior: for the reference.
    Draw(usize),
}

impl Way {
    /// All, the default first.
    pub(crate) const ALL: [Way; 7 + DRAWS] = [
        Way::Auto,
        Way::Lm,
        Way::Ladder,
        Way::Lbfgs,
        Way::Newton,
        Way::AdamControl,
        Way::AdamRaw,
        Way::Draw(0),
        Way::Draw(1),
        Way::Draw(2),
        Way::Draw(3),
        Way::Draw(4),
    ];

    /// Its name in files.
    pub(crate) fn name(self) -> String {
        match self {
            Way::Auto => "auto".into(),
            Way::Lm => "lm".into(),
            Way::Ladder => "ladder".into(),
            Way::Lbfgs => "lbfgs".into(),
            Way::Newton => "newton".into(),
            Way::AdamControl => "adam".into(),
            Way::AdamRaw => "adam-raw".into(),
            Way::Draw(i) => format!("draw{i}"),
        }
    }

    /// Whether the lowest J known is taken from it.
    pub(crate) fn is_reference(self) -> bool {
        matches!(self, Way::Lm | Way::Ladder | Way::Draw(_))
    }
}

/// A draw of the experiment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Twin {
    /// "clamp" or "plain".
    pub(crate) prior: &'static str,
    pub(crate) seed: u64,
}

/// How a run went.
#[derive(Debug, Clone)]
pub(crate) struct Run {
    pub(crate) twin: Twin,
    pub(crate) way: Way,
    /// As minimizers say it; "refused" where there was no first point.
    pub(crate) status: String,
    /// J at the background.
    pub(crate) j_background: f64,
    pub(crate) j: f64,
    /// ‖∇J‖ at the end over that at the background.
    pub(crate) gradient: f64,
    /// CPU seconds of the thread.
    pub(crate) seconds: f64,
    pub(crate) forward_runs: usize,
    pub(crate) gradients: usize,
    /// Lowest J so far at the sample times.
    pub(crate) curve: Vec<f64>,
}

impl Run {
    pub(crate) fn converged(&self) -> bool {
        self.status == "Converged"
    }

    /// Whether the run ended because the model failed, or could not begin.
    pub(crate) fn failed(&self) -> bool {
        matches!(self.status.as_str(), "Failed" | "refused")
    }
}

/// Runs one minimizer on one draw.
pub(crate) fn run(twin: Twin, way: Way) -> Result<Run, Box<dyn Error>> {
    let name = if twin.prior == "clamp" { "hanging-rod-case4" } else { "hanging-rod-case4-plain" };
    let file = SceneFile::open(name, &[format!("seed={}", twin.seed)])?;
    let problem = Problem::from_scene(&file)?;
    // For the raw variables.
    let precision = problem.covariance.precision().ok_or("B of case 4 has an inverse")?;
    let transform = ControlTransform::new(problem.background.clone(), problem.covariance.as_ref())?;
    let (mut model, mut observations) = (problem.model(), problem.observations()?);
    let mut cost = StrongConstraint::new(model.as_mut(), transform.clone(), &mut observations)?;
    let n = transform.dim();
    let mut v = vec![0.0; n];
    let mut gradient = vec![0.0; n];
    let j_background = cost.evaluate(&v, Some(&mut gradient))?;
    let first = norm(&gradient);
    let before = cost.counts();

    let mut curve = Curve { clock: Clock::start(), lowest: j_background, values: Vec::new() };
    let mut note = |i: &Iteration| {
        // J_o grows with 1/σ²: the true cost of an early stage of a ladder.
        curve.note(i.terms.background + i.terms.observation * i.observation_scale.powi(2));
        ControlFlow::Continue(())
    };
    if let Way::Draw(i) = way {
        let mut rng = ChaCha8Rng::seed_from_u64(twin.seed);
        // Streams 0 to 3 of a seed are truth, background, observations and ensemble.
        rng.set_stream(100 + i as u64);
        v.fill_with(|| StandardNormal.sample(&mut rng));
    }
    let lm = TrustRegionOptions::default().with_gradient_tolerance(TOLERANCE);
    let ended: Result<Minimum, varda_assimilation::Error> = match way {
        Way::Auto => {
            let mut options = AutoOptions::default();
            options.trust_region.stopping.gradient_tolerance = TOLERANCE;
            Minimizer::Auto(options).minimize(&mut cost, &mut v, &mut note)
        }
        Way::Lm => Minimizer::TrustRegion(lm).minimize(&mut cost, &mut v, &mut note),
        // A draw may start with a gradient many times that at the background: the tolerance is that of the
        // background.
        Way::Draw(_) => match cost.evaluate(&v, Some(&mut gradient)) {
            Ok(_) => {
                let tolerance = (TOLERANCE * first / norm(&gradient)).min(TOLERANCE);
                let options = lm.with_gradient_tolerance(tolerance);
                Minimizer::TrustRegion(options).minimize(&mut cost, &mut v, &mut note)
            }
            Err(error) => Err(error),
        },
        Way::Ladder => {
            continuation(&Minimizer::TrustRegion(lm), &mut cost, &mut v, &[10.0, 3.0, 1.0], &mut note)
        }
        Way::Lbfgs => {
            let options = LbfgsOptions::default().with_gradient_tolerance(TOLERANCE);
            Minimizer::Lbfgs(options).minimize(&mut cost, &mut v, &mut note)
        }
        Way::Newton => {
            let options = NewtonOptions::default().with_gradient_tolerance(TOLERANCE);
            Minimizer::Newton(options).minimize(&mut cost, &mut v, &mut note)
        }
        Way::AdamControl => {
            let options = AdamOptions::default().with_gradient_tolerance(TOLERANCE);
            adam(&mut cost, &mut v, &options, &mut note)
        }
        Way::AdamRaw => {
            // Metres and metres a second: 1e-3 of either a step.
            let options = AdamOptions::default().with_gradient_tolerance(TOLERANCE).with_learning_rate(1e-3);
            let mut z = transform.background().to_vec();
            let mut raw = RawVariables::new(&mut cost, &transform, precision)?;
            adam(&mut raw, &mut z, &options, &mut note)
        }
    };
    let seconds = curve.clock.seconds();
    let counts = cost.counts();
    let (status, j, last) = match ended {
        Ok(m) if m.status == Status::Converged && m.gradient_norm > TOLERANCE * first * (1.0 + 1e-9) => {
            // Only Adam in raw variables measures another gradient.
            ("Converged otherwise".to_string(), m.value, m.gradient_norm)
        }
        Ok(m) => (format!("{:?}", m.status), m.value, m.gradient_norm),
        Err(_) => ("refused".to_string(), f64::INFINITY, f64::INFINITY),
    };
    Ok(Run {
        twin,
        way,
        status,
        j_background,
        j,
        gradient: last / first,
        seconds,
        forward_runs: counts.forward_runs - before.forward_runs,
        gradients: counts.gradients - before.gradients,
        curve: curve.end(),
    })
}

/// CPU seconds of this thread where the system tells them (Linux), else the clock's.
struct Clock {
    cpu: Option<f64>,
    wall: Instant,
}

impl Clock {
    fn start() -> Clock {
        Clock { cpu: thread_seconds(), wall: Instant::now() }
    }

    fn seconds(&self) -> f64 {
        match (self.cpu, thread_seconds()) {
            (Some(start), Some(now)) => now - start,
            _ => self.wall.elapsed().as_secs_f64(),
        }
    }
}

fn thread_seconds() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(1e-9 * text.split_whitespace().next()?.parse::<f64>().ok()?)
}

/// The lowest J so far, by time.
struct Curve {
    clock: Clock,
    lowest: f64,
    values: Vec<f64>,
}

/// The time of sample i \[s\].
pub(crate) fn sample_time(i: usize) -> f64 {
    10f64.powf(0.1 * i as f64 - 2.5)
}

impl Curve {
    fn note(&mut self, j: f64) {
        let now = self.clock.seconds();
        while self.values.len() < SAMPLES && sample_time(self.values.len()) < now {
            self.values.push(self.lowest);
        }
        self.lowest = self.lowest.min(j);
    }

    fn end(mut self) -> Vec<f64> {
        self.values.resize(SAMPLES, self.lowest);
        self.values
    }
}

pub(super) fn norm(v: &[f64]) -> f64 {
    v.iter().map(|v| v * v).sum::<f64>().sqrt()
}

/// One line of the file that remembers runs.
pub(crate) fn line(run: &Run) -> String {
    let Twin { prior, seed } = run.twin;
    let mut text = format!(
        "{prior},{seed},{},{},{:e},{:e},{:e},{:.4},{},{},",
        run.way.name(),
        run.status,
        run.j_background,
        run.j,
        run.gradient,
        run.seconds,
        run.forward_runs,
        run.gradients
    );
    for j in &run.curve {
        let _ = write!(text, "{j:.9e} ");
    }
    text.truncate(text.trim_end().len());
    text
}

/// The runs a file remembers; none where there is no file.
pub(crate) fn remembered(file: &Path) -> Result<Vec<Run>, Box<dyn Error>> {
    let Ok(text) = std::fs::read_to_string(file) else { return Ok(Vec::new()) };
    text.lines()
        .map(|l| parsed(l).ok_or_else(|| format!("{}: not a run: {l}", file.display()).into()))
        .collect()
}

fn parsed(line: &str) -> Option<Run> {
    let cells: Vec<&str> = line.split(',').collect();
    let [prior, seed, way, status, j_background, j, gradient, seconds, forward_runs, gradients, curve] =
        cells[..]
    else {
        return None;
    };
    let prior = ["clamp", "plain"].into_iter().find(|p| *p == prior)?;
    Some(Run {
        twin: Twin { prior, seed: seed.parse().ok()? },
        way: Way::ALL.into_iter().find(|w| w.name() == way)?,
        status: status.to_string(),
        j_background: j_background.parse().ok()?,
        j: j.parse().ok()?,
        gradient: gradient.parse().ok()?,
        seconds: seconds.parse().ok()?,
        forward_runs: forward_runs.parse().ok()?,
        gradients: gradients.parse().ok()?,
        curve: curve.split(' ').map(|c| c.parse().ok()).collect::<Option<_>>()?,
    })
}
