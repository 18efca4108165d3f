//! One window of 4D-Var in a few calls.

use crate::{
    Analysis, ControlTransform, CostFunction, CostTerms, Error, Iteration, Minimizer, Minimum, Observation,
    ObservationOperator, ObservationSet, Posterior, Selection, Status, StrongConstraint,
};
use rand::Rng;
use std::ops::ControlFlow;
use varda_covariance::Covariance;
use varda_implicit::{Keep, Model, Trajectory};

/// The library's short form of strong-constraint 4D-Var: a model, a background, observations, and the
/// analysis.
///
/// ```text
///     J(v) = ½‖v‖² + ½ Σ_k ‖y_k − H_k(x_k)‖²_{R_k⁻¹},    x₀ = x_b + B^{1/2} v,
///     x_{k+1} = M_k(x_k)
/// ```
///
/// # When to use
/// For a first result, and wherever one window with one model is all there is. Model errors, ensembles
/// without adjoint, cycles and the control of every iteration are in the layers below, which this type only
/// puts together: [`ObservationSet`], [`ControlTransform`], [`StrongConstraint`], [`Minimizer`],
/// [`Posterior`].
///
/// # Cost
/// That of the minimizer, and of the posterior: a dense Hessian, n tangent or m adjoint sweeps and 9 n³ or
/// so. For more than a few thousand unknowns see [`LowRankPosterior`](crate::LowRankPosterior).
///
/// # Examples
/// ```
/// use varda_assimilation::Assimilation;
/// use varda_covariance::Diagonal;
/// use varda_implicit::{Rk4, lorenz::Lorenz63};
///
/// let model = Rk4::new(Lorenz63::default(), 0, 0.01);
/// let result = Assimilation::new(model)
///     .background(vec![1.5, 1.7, 20.0], Diagonal::uniform(3, 1.0)?)
///     .observe(20, [0, 2], [8.1, 14.9], 0.1)
///     .observe(30, [0], [15.4], 0.1)
///     .analyse()?;
/// assert!(result.converged());
/// assert!(result.sigma()[0] < 1.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// Model and covariance can be borrowed, and times can take the place of steps:
///
/// ```
/// use varda_assimilation::{Assimilation, Observation};
/// use varda_covariance::Diagonal;
/// use varda_implicit::{Rk4, lorenz::Lorenz63};
///
/// let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);
/// let b = Diagonal::uniform(3, 1.0)?;
/// let result = Assimilation::borrowing(&mut model)
///     .background(vec![1.5, 1.7, 20.0], &b)
///     .on_times((0..=40).map(|k| 0.01 * k as f64).collect())
///     .observe_at(0.2, [0, 2], [8.1, 14.9], 0.1)
///     .observe_at(0.305, [0], [15.4], 0.1)
///     .observation(Observation::new(40, vec![1], vec![16.0], 0.5).label("y"))
///     .analyse()?;
/// assert_eq!(result.trajectory().len(), 41);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Assimilation<'a> {
    model: Owner<'a>,
    background: Vec<f64>,
    covariance: Option<Box<dyn Covariance + 'a>>,
    operators: Vec<Box<dyn ObservationOperator>>,
    observations: Vec<Seen>,
    steps: Option<usize>,
    times: Option<Vec<f64>>,
    minimizer: Minimizer,
}

/// A model that is owned or borrowed.
enum Owner<'a> {
    Own(Box<dyn Model + 'a>),
    Borrowed(&'a mut (dyn Model + 'a)),
}

/// An observation whose step is known, or still to be found from its time.
enum Seen {
    AtStep(Observation),
    AtTime(f64, Observation),
}

impl<'a> Assimilation<'a> {
    /// With a model of its own.
    pub fn new(model: impl Model + 'a) -> Self {
        Self::with(Owner::Own(Box::new(model)))
    }

    /// With a borrowed model.
    pub fn borrowing(model: &'a mut (dyn Model + 'a)) -> Self {
        Self::with(Owner::Borrowed(model))
    }

    fn with(model: Owner<'a>) -> Self {
        Self {
            model,
            background: Vec::new(),
            covariance: None,
            operators: Vec::new(),
            observations: Vec::new(),
            steps: None,
            times: None,
            minimizer: Minimizer::default(),
        }
    }

    /// What is known before: the control x_b of the model (its initial state, as a rule) and the covariance B
    /// of its errors, by value, by reference or behind an `Arc`.
    pub fn background(mut self, x_b: impl Into<Vec<f64>>, b: impl Covariance + 'a) -> Self {
        self.background = x_b.into();
        self.covariance = Some(Box::new(b));
        self
    }

    /// Components of the state measured at a step of the window, with errors of one standard deviation σ.
    pub fn observe(
        self,
        step: usize,
        components: impl IntoIterator<Item = usize>,
        values: impl IntoIterator<Item = f64>,
        sigma: f64,
    ) -> Self {
        let (rows, values) = (components.into_iter().collect(), values.into_iter().collect());
        self.observation(Observation::new(step, rows, values, sigma))
    }

    /// Components of the state measured at a time of the grid given by [`on_times`](Self::on_times), between
    /// two steps if need be.
    pub fn observe_at(
        mut self,
        time: f64,
        components: impl IntoIterator<Item = usize>,
        values: impl IntoIterator<Item = f64>,
        sigma: f64,
    ) -> Self {
        let (rows, values) = (components.into_iter().collect(), values.into_iter().collect());
        self.observations.push(Seen::AtTime(time, Observation::new(0, rows, values, sigma)));
        self
    }

    /// Any observation. Operator 0 is the whole state; those of [`operator`](Self::operator) are 1, 2, … in
    /// their order.
    pub fn observation(mut self, observation: Observation) -> Self {
        self.observations.push(Seen::AtStep(observation));
        self
    }

    /// One more observation operator, for [`Observation::operator`].
    pub fn operator(mut self, operator: impl ObservationOperator + 'static) -> Self {
        self.operators.push(Box::new(operator));
        self
    }

    /// The times t_0 … t_K of the steps, for operators that depend on time and for
    /// [`observe_at`](Self::observe_at). Without them the time of step k is k.
    pub fn on_times(mut self, times: Vec<f64>) -> Self {
        self.times = Some(times);
        self
    }

    /// K, the length of the window; without it (and without times) the window ends at the last observation.
    pub fn steps(mut self, steps: usize) -> Self {
        self.steps = Some(steps);
        self
    }

    /// Another minimizer than the default one.
    pub fn minimizer(mut self, minimizer: Minimizer) -> Self {
        self.minimizer = minimizer;
        self
    }

    /// Minimizes J, and takes the posterior at the minimum.
    ///
    /// # Errors
    /// No background; lengths that disagree; an observation outside the window or with values out of range; a
    /// model that cannot be run from the background. How the minimization ended is
    /// [`AnalysisResult::status`].
    pub fn analyse(self) -> Result<AnalysisResult<'a>, Error> {
        self.analyse_with(&mut |_| ControlFlow::Continue(()))
    }

    /// As [`analyse`](Self::analyse), telling every iteration to a callback, which may stop the run.
    ///
    /// # Errors
    /// As for [`analyse`](Self::analyse).
    pub fn analyse_with(
        mut self,
        on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
    ) -> Result<AnalysisResult<'a>, Error> {
        let model: &mut dyn Model = match &mut self.model {
            Owner::Own(model) => &mut **model,
            Owner::Borrowed(model) => &mut **model,
        };
        let state_dim = model.dim();
        let Some(covariance) = self.covariance else {
            return Err(Error::Length { what: "the background", expected: model.control_dim(), found: 0 });
        };
        let observations = place(self.observations, self.times.as_deref())?;
        let last = observations.iter().map(|o| o.last_step()).max().unwrap_or(0);
        let times = match self.times {
            Some(times) => times,
            None => (0..=self.steps.unwrap_or(last)).map(|k| k as f64).collect(),
        };
        let steps = times.len().saturating_sub(1);
        let whole = Selection::new((0..state_dim).collect(), state_dim)?;
        let mut operators: Vec<Box<dyn ObservationOperator>> = vec![Box::new(whole)];
        operators.append(&mut self.operators);
        let mut set = ObservationSet::on_times(times, operators, observations)?;

        let transform = ControlTransform::new(self.background, &*covariance)?;
        let mut v = vec![0.0; transform.dim()];
        let mut cost = StrongConstraint::new(&mut *model, transform.clone(), &mut set)?;
        let minimum = self.minimizer.minimize(&mut cost, &mut v, on_iteration)?;
        cost.evaluate(&v, Some(&mut vec![0.0; v.len()]))?;
        let posterior = Posterior::new(&mut cost)?;
        let analysis = Analysis::new(&transform, &v, &minimum, &posterior, set.dim());

        let mut x0 = vec![0.0; state_dim];
        model.initial_state(&analysis.analysis, &mut x0)?;
        let mut trajectory = Trajectory::new();
        trajectory.run(model, &x0, steps, Keep::States)?;
        let trajectory = trajectory.states().chunks_exact(state_dim).map(<[f64]>::to_vec).collect();
        Ok(AnalysisResult { analysis, minimum, posterior, trajectory, v, covariance })
    }
}

/// Steps and weights of observations that were given by their times.
fn place(observations: Vec<Seen>, times: Option<&[f64]>) -> Result<Vec<Observation>, Error> {
    let at = |seen| match seen {
        Seen::AtStep(observation) => Ok(observation),
        Seen::AtTime(time, observation) => {
            let outside =
                || Error::Setting { what: "a time of an observation, in the grid of times,", value: time };
            let times = times.ok_or_else(outside)?;
            let after = times.partition_point(|t| *t <= time);
            match (after.checked_sub(1), times.get(after)) {
                (Some(k), None) if times[k] == time => Ok(observation.at_step(k)),
                (Some(k), Some(next)) => {
                    Ok(observation.at_step(k).between((time - times[k]) / (next - times[k])))
                }
                _ => Err(outside()),
            }
        }
    };
    observations.into_iter().map(at).collect()
}

/// What [`Assimilation::analyse`] gives.
pub struct AnalysisResult<'a> {
    analysis: Analysis,
    minimum: Minimum,
    posterior: Posterior,
    trajectory: Vec<Vec<f64>>,
    v: Vec<f64>,
    covariance: Box<dyn Covariance + 'a>,
}

impl AnalysisResult<'_> {
    /// The analysis x_a of the control: of the initial state, as a rule.
    pub fn state(&self) -> &[f64] {
        &self.analysis.analysis
    }

    /// σ_a, the standard deviations of its errors.
    pub fn sigma(&self) -> &[f64] {
        &self.analysis.sigma_analysis
    }

    /// How the minimization ended.
    pub fn status(&self) -> Status {
        self.minimum.status
    }

    /// Whether the gradient has vanished as far as was asked for.
    pub fn converged(&self) -> bool {
        self.minimum.status == Status::Converged
    }

    /// J_b and J_o at the analysis.
    pub fn terms(&self) -> CostTerms {
        self.minimum.terms
    }

    /// x_0 … x_K from the analysis.
    pub fn trajectory(&self) -> &[Vec<f64>] {
        &self.trajectory
    }

    /// A draw of the control from N(x_a, P_a), with the caller's generator.
    pub fn draw<R: Rng + ?Sized>(&self, rng: &mut R) -> Vec<f64> {
        let transform = ControlTransform::checked(self.analysis.background.clone(), &*self.covariance);
        self.posterior.draw(&transform, &self.v, rng)
    }

    /// Background, analysis and their standard deviations, χ² and degrees of freedom for signal.
    pub fn analysis(&self) -> &Analysis {
        &self.analysis
    }

    /// What the minimizer reports.
    pub fn minimum(&self) -> &Minimum {
        &self.minimum
    }

    /// The posterior in the control variable.
    pub fn posterior(&self) -> &Posterior {
        &self.posterior
    }
}
