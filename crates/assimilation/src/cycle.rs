//! Cycling: consecutive windows, each starting from the analysis of the one before.

use crate::cost::run_all;
use crate::minimize::eigen;
use crate::{
    ControlTransform, CostFunction, CostTerms, Counts, EnVar, EnVarOptions, EnsembleUpdate, Error,
    GaussNewton, Minimizer, Minimum, ObservationSet, Status, StrongConstraint,
};
use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use std::ops::ControlFlow;
use varda_covariance::{Covariance, Ensemble, Hybrid, Localization};
use varda_implicit::{Keep, Model, Trajectory};

/// A sequence of windows. Window c covers the steps first + c S … first + c S + K of a long run.
///
/// Every observation is used once: a window after the first takes those later than step K − S, the ones no window before has seen (the single
/// data assimilation of Bocquet and Sakov 2014). So windows overlap (S < K), share the step at which one ends and the next begins (S = K), or
/// tile the time (S = K + 1: the background is a forecast to the first observed step). A window of K = 0 is 3D-Var, or an ensemble Kalman filter:
/// one time is analysed, then S steps are forecast.
#[derive(Clone, Copy)]
pub struct Cycling<'a> {
    /// The first step of the first window.
    pub first: usize,
    /// K, the length of a window in steps.
    pub window: usize,
    /// S, the steps from one window to the next; at most K + 1, any for K = 0.
    pub shift: usize,
    /// How many windows.
    pub cycles: usize,
    /// A model whose step 0 is the given step of the long run.
    pub make_model: &'a dyn Fn(usize) -> Box<dyn Model + Send>,
    /// The observations of the window that starts at the given step, with steps counted from there; also those already seen.
    pub observations: &'a dyn Fn(usize) -> Result<ObservationSet, Error>,
    /// The true state at a step, where it is known.
    pub truth: Option<&'a dyn Fn(usize) -> Vec<f64>>,
}

/// Where the background covariance of a window comes from.
pub enum CycledCovariance<'a> {
    /// The same B for every window: strong 4D-Var (3D-Var for K = 0).
    Static(&'a dyn Covariance),
    /// The posterior of the window before (strong 4D-Var), carried to the start of the next by the tangent: B = α² M P_a Mᵀ, plus where given β² B_s
    /// for what the model does not know (an extended Kalman smoother with iterated windows). n tangent sweeps and n² numbers more than static B.
    Propagated {
        /// B of the first window.
        first: &'a dyn Covariance,
        /// α, on standard deviations.
        inflation: f64,
        /// B_s and β.
        static_part: Option<(&'a dyn Covariance, f64)>,
    },
    /// An ensemble carried from window to window: 4D-EnVar, hybrid 4D-EnVar, the iterative ensemble Kalman smoother.
    Ensemble(CycledEnsemble<'a>),
}

/// An ensemble and how it is carried.
pub struct CycledEnsemble<'a> {
    /// The members of the first window's background in the control z, one after the other; their mean is the background.
    pub members: Vec<f64>,
    /// α ≥ 1 multiplies the perturbations of every background, before the window is assimilated.
    pub inflation: f64,
    /// C.
    pub localization: Localization,
    /// The component of the control at whose place each stacked row was measured; asked for where C localizes.
    pub anchors: &'a dyn Fn(&ObservationSet) -> Vec<usize>,
    /// B_s, β_s and β_e of a hybrid; `None` is β_e = 1 alone.
    pub static_part: Option<(&'a dyn Covariance, f64, f64)>,
    /// From the prior perturbations to those of the posterior.
    pub update: EnsembleUpdate<'a>,
    /// Outer iterations.
    pub options: EnVarOptions,
}

/// What one window gave.
#[derive(Debug, Clone, PartialEq)]
pub struct Cycle {
    /// Index c.
    pub index: usize,
    /// The first step of the window.
    pub first_step: usize,
    /// z_a at the start of the window.
    pub analysis: Vec<f64>,
    /// J at the analysis.
    pub value: f64,
    /// Its parts.
    pub terms: CostTerms,
    /// m, the number of observed values used.
    pub observations: usize,
    /// χ² = 2J/m; 0 where nothing is observed.
    pub chi2: f64,
    /// How the minimization ended.
    pub status: Status,
    /// Its outer iterations.
    pub outer_iterations: usize,
    /// Work of the minimization; the forecast to the next window comes on top.
    pub counts: Counts,
    /// Standard deviation expected of the analysis at the window's end, root mean square over the state: the ensemble's spread; that of the
    /// background of the next window for a propagated posterior; `None` for static B.
    pub spread: Option<f64>,
    /// Root mean square errors, where the truth is known.
    pub errors: Option<CycleErrors>,
}

/// Root mean square errors over the state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CycleErrors {
    /// Of the background at the window's start.
    pub background: f64,
    /// Of the analysis at the window's start.
    pub start: f64,
    /// Of the analysis at the window's end: of the run from z_a, or of the mean of the members' runs.
    pub end: f64,
}

/// Assimilates the windows one after the other from the background z_b of the first (an ensemble brings its own: its mean; `background` is
/// then ignored and may be empty):
///
/// ```text
///     z_b, B  →  z_a = argmin J over window c  →  z_b' = M_S(z_a),  B' as `covariance` says
/// ```
///
/// | B | when to use | when not | cost of a window beyond its minimization | memory beyond a window's |
/// |---|---|---|---|---|
/// | static | a first answer; errors that vary little with the flow | sparse observations of a chaotic model: B is too narrow or too wide by turns | 1 forward run | – |
/// | propagated | n up to some hundreds; sparse observations | a large n; alone over long cycles (give it a static part) | 1 forward run, 2n tangent sweeps, n³ | 2n² |
/// | ensemble | no adjoint at hand; the best scores for its cost | N below the growing directions, unlocalized | N forward runs | N trajectories |
///
/// The background of a window is the run from the analysis before (the mean of the members' runs), read off the leading components of the state,
/// which are taken to be the control. A minimization that ends otherwise than converged hands its best point on: see `status`.
/// `on_cycle` may end the sequence.
///
/// # Errors
/// A shift of 0 or beyond K + 1, an inflation that is not positive; a model that fails between two windows, observations or covariances that
/// cannot be built.
pub fn cycle(
    cycling: &Cycling,
    background: &[f64],
    covariance: CycledCovariance,
    minimizer: &Minimizer,
    on_cycle: &mut dyn FnMut(&Cycle) -> ControlFlow<()>,
) -> Result<Vec<Cycle>, Error> {
    if cycling.shift == 0 || (cycling.window > 0 && cycling.shift > cycling.window + 1) {
        return Err(Error::Setting { what: "the shift between windows", value: cycling.shift as f64 });
    }
    let positive = |inflation: f64| {
        if inflation > 0.0 && inflation.is_finite() {
            Ok(())
        } else {
            Err(Error::Setting { what: "inflation", value: inflation })
        }
    };
    match covariance {
        CycledCovariance::Static(b) => {
            let mut state = Variational { background: background.to_vec(), carried: None };
            repeat(cycling, on_cycle, &mut |c| state.window(cycling, c, b, minimizer, None))
        }
        CycledCovariance::Propagated { first, inflation, static_part } => {
            positive(inflation)?;
            let mut state = Variational { background: background.to_vec(), carried: None };
            repeat(cycling, on_cycle, &mut |c| {
                let Some(carried) = state.carried.take() else {
                    return state.window(cycling, c, first, minimizer, Some(inflation));
                };
                match static_part {
                    Some((b, weight)) => {
                        let hybrid = Hybrid::new(b, weight, carried, 1.0)?;
                        state.window(cycling, c, &hybrid, minimizer, Some(inflation))
                    }
                    None => state.window(cycling, c, &carried, minimizer, Some(inflation)),
                }
            })
        }
        CycledCovariance::Ensemble(mut ensemble) => {
            positive(ensemble.inflation)?;
            repeat(cycling, on_cycle, &mut |c| ensemble.window(cycling, c))
        }
    }
}

/// Window after window, until the last or until the caller has enough.
fn repeat(
    cycling: &Cycling,
    on_cycle: &mut dyn FnMut(&Cycle) -> ControlFlow<()>,
    window: &mut dyn FnMut(usize) -> Result<Cycle, Error>,
) -> Result<Vec<Cycle>, Error> {
    let mut cycles = Vec::new();
    for c in 0..cycling.cycles {
        cycles.push(window(c)?);
        if on_cycle(&cycles[c]).is_break() {
            break;
        }
    }
    Ok(cycles)
}

impl Cycling<'_> {
    /// The observations of window c that no window before has used.
    fn unseen(&self, c: usize) -> Result<ObservationSet, Error> {
        let set = (self.observations)(self.first + c * self.shift)?;
        if c == 0 || self.shift > self.window {
            return Ok(set);
        }
        let (steps, seen) = (set.steps(), (self.window - self.shift) as f64);
        let (operators, observations) = set.into_parts();
        let unseen = observations.into_iter().filter(|o| o.step as f64 + o.weight > seen).collect();
        ObservationSet::new(steps, operators, unseen)
    }

    /// Steps to run from the analysis: to the end of this window and the start of the next.
    fn steps(&self) -> usize {
        self.window.max(self.shift)
    }

    fn report(
        &self,
        c: usize,
        analysis: Vec<f64>,
        minimum: &Minimum,
        observations: usize,
        counts: Counts,
        spread: Option<f64>,
        [background, start, end]: [&[f64]; 3],
    ) -> Cycle {
        let first_step = self.first + c * self.shift;
        let errors = self.truth.map(|truth| {
            let (at_start, at_end) = (truth(first_step), truth(first_step + self.window));
            CycleErrors {
                background: rms(background, &at_start),
                start: rms(start, &at_start),
                end: rms(end, &at_end),
            }
        });
        Cycle {
            index: c,
            first_step,
            analysis,
            value: minimum.value,
            terms: minimum.terms,
            observations,
            chi2: if observations == 0 { 0.0 } else { 2.0 * minimum.value / observations as f64 },
            status: minimum.status,
            outer_iterations: minimum.outer_iterations,
            counts,
            spread,
            errors,
        }
    }
}

/// What strong 4D-Var carries from window to window.
struct Variational {
    background: Vec<f64>,
    /// The propagated posterior.
    carried: Option<Ensemble>,
}

impl Variational {
    fn window(
        &mut self,
        cycling: &Cycling,
        c: usize,
        b: &dyn Covariance,
        minimizer: &Minimizer,
        propagate: Option<f64>,
    ) -> Result<Cycle, Error> {
        let mut observations = cycling.unseen(c)?;
        let m = observations.dim();
        let mut model = (cycling.make_model)(cycling.first + c * cycling.shift);
        let transform = ControlTransform::new(self.background.clone(), b)?;
        let n_z = transform.control_dim();
        let mut cost = StrongConstraint::new(&mut *model, transform.clone(), &mut observations)?;
        let mut v = vec![0.0; cost.dim()];
        let minimum = minimizer.minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(()))?;
        let mut columns = match propagate {
            Some(_) => posterior_root(&mut cost, &transform, &v)?,
            None => Vec::new(),
        };
        let counts = cost.counts();

        let mut z = vec![0.0; n_z];
        transform.control(&v, &mut z);
        let (mut x_b, mut x_a) = (vec![0.0; model.dim()], vec![0.0; model.dim()]);
        model.initial_state(&self.background, &mut x_b)?;
        model.initial_state(&z, &mut x_a)?;
        let keep = if propagate.is_some() { Keep::Linearizations } else { Keep::States };
        let mut trajectory = Trajectory::new();
        trajectory.run(&mut *model, &x_a, cycling.steps(), keep)?;
        self.background = trajectory.state(cycling.shift)[..n_z].to_vec();
        let mut spread = None;
        if let Some(inflation) = propagate {
            let mut dx = vec![0.0; model.dim()];
            for column in columns.chunks_exact_mut(n_z) {
                model.initial_tangent(column, &mut dx);
                (0..cycling.shift).for_each(|k| model.tangent(k, &mut dx));
                column.iter_mut().zip(&dx).for_each(|(w, dx)| *w = inflation * dx);
            }
            spread = Some((columns.iter().map(|w| w * w).sum::<f64>() / n_z as f64).sqrt());
            self.carried = Some(Ensemble::from_perturbations(&columns, Localization::none(n_z))?);
        }
        let end = trajectory.state(cycling.window);
        Ok(cycling.report(c, z, &minimum, m, counts, spread, [&x_b, &x_a, end]))
    }
}

/// U A^{-1/2} at v, by columns: a square root of P_a.
fn posterior_root(
    cost: &mut StrongConstraint,
    transform: &ControlTransform,
    v: &[f64],
) -> Result<Vec<f64>, Error> {
    let n = v.len();
    let mut hessian = vec![0.0; n * n];
    cost.evaluate(v, Some(&mut vec![0.0; n]))?;
    cost.hessian(&mut hessian)?;
    let (values, mut vectors) = eigen(n, &hessian)?;
    let mut columns = vec![0.0; n * transform.control_dim()];
    for ((column, z), mu) in
        columns.chunks_exact_mut(transform.control_dim()).zip(vectors.chunks_exact_mut(n)).zip(values)
    {
        // Eigenvalues of I + GᵀG are at least 1 but for rounding.
        z.iter_mut().for_each(|z| *z /= mu.max(1.0).sqrt());
        transform.tangent(z, column);
    }
    if n <= transform.control_dim() { Ok(columns) } else { square_root(transform.control_dim(), &columns) }
}

/// A root of W Wᵀ with no more columns than rows: a hybrid B has more, and they would add up from window to window.
fn square_root(n: usize, columns: &[f64]) -> Result<Vec<f64>, Error> {
    let mut covariance = vec![0.0; n * n];
    let w = MatRef::from_column_major_slice(columns, n, columns.len() / n);
    let product = MatMut::from_column_major_slice_mut(&mut covariance, n, n);
    matmul(product, Accum::Replace, w, w.transpose(), 1.0, Par::Seq);
    let (values, mut vectors) = eigen(n, &covariance)?;
    for (z, lambda) in vectors.chunks_exact_mut(n).zip(values) {
        z.iter_mut().for_each(|z| *z *= lambda.max(0.0).sqrt());
    }
    Ok(vectors)
}

impl CycledEnsemble<'_> {
    fn window(&mut self, cycling: &Cycling, c: usize) -> Result<Cycle, Error> {
        let first = cycling.first + c * cycling.shift;
        let mut observations = cycling.unseen(c)?;
        let m = observations.dim();
        let make = || (cycling.make_model)(first);
        let unbroken = Ensemble::new(&self.members, self.localization.clone())?;
        let (n_z, count, mean) = (unbroken.dim(), unbroken.members(), unbroken.mean().to_vec());
        for x in self.members.chunks_exact_mut(n_z) {
            x.iter_mut().zip(&mean).for_each(|(x, m)| *x = m + self.inflation * (*x - m));
        }
        let ensemble = Ensemble::new(&self.members, self.localization.clone())?;
        let anchors = if self.localization.rank() == 1 { Vec::new() } else { (self.anchors)(&observations) };

        let hybrid = match self.static_part {
            Some((b, beta_s, beta_e)) => Some(Hybrid::new(b, beta_s, ensemble.clone(), beta_e)?),
            None => None,
        };
        let mut cost = match &hybrid {
            Some(hybrid) => EnVar::hybrid(&make, mean.clone(), hybrid, &mut observations, &anchors)?,
            None => EnVar::new(&make, mean.clone(), &ensemble, &mut observations, &anchors)?,
        };
        let mut v = vec![0.0; cost.dim()];
        let minimum = cost.minimize(&mut v, &self.options, &mut |_| ControlFlow::Continue(()))?;
        let mut z = vec![0.0; n_z];
        cost.transform().control(&v, &mut z);
        let perturbations = cost.posterior_perturbations(&mut self.update)?;
        let counts = cost.counts();
        let size = ((count - 1) as f64).sqrt();
        for (member, x) in self.members.chunks_exact_mut(n_z).zip(perturbations.chunks_exact(n_z)) {
            member.iter_mut().zip(x).zip(&z).for_each(|((member, x), z)| *member = z + size * x);
        }

        let mut models: Vec<_> = (0..count).map(|_| make()).collect();
        let (n, steps) = (models[0].dim(), cycling.steps());
        let (mut x_b, mut x_a) = (vec![0.0; n], vec![0.0; n]);
        models[0].initial_state(&mean, &mut x_b)?;
        models[0].initial_state(&z, &mut x_a)?;
        let mut states = vec![0.0; count * (steps + 1) * n];
        run_all(&mut models, &self.members, &mut states, steps)?;
        let at = |i: usize, k: usize| &states[(i * (steps + 1) + k) * n..][..n];
        let mut end = vec![0.0; n];
        for i in 0..count {
            self.members[i * n_z..][..n_z].copy_from_slice(&at(i, cycling.shift)[..n_z]);
            end.iter_mut().zip(at(i, cycling.window)).for_each(|(e, x)| *e += x / count as f64);
        }
        let scatter: f64 = (0..count).map(|i| rms(at(i, cycling.window), &end).powi(2)).sum();
        let spread = Some((scatter / (count - 1) as f64).sqrt());
        Ok(cycling.report(c, z, &minimum, m, counts, spread, [&x_b, &x_a, &end]))
    }
}

/// √(mean (a − b)²).
fn rms(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len(), "length of the true state");
    (a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>() / a.len() as f64).sqrt()
}
