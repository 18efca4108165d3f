//! Observations y of a trajectory, and the operators H that predict them.

mod second_order;

use crate::between::Between;
use crate::noise::ObservationErrors;
use crate::{Error, Observation};
use std::ops::Range;
use varda_implicit::{At, ObservationOperator, Rate};

/// All observations of a window of K steps, with the operators that predict them.
///
/// ```text
///     H(x)_i = H_op(i)(x_{k_i})[row_i] at a step, between two steps
///     H(x)_i = H_op(i)(x(w_i))[row_i]                                          with the rates of the state
///     H(x)_i = (1 − w_i) H_op(i)(x_{k_i})[row_i] + w_i H_op(i)(x_{k_i + 1})[row_i]              without,
///     d = y − H(x)
/// ```
///
/// with x(w) the cubic through both states and their rates (Hermite; a straight line in components whose
/// rate is not known). Costs take the rates of their model ([`Model::rate`](varda_implicit::Model::rate));
/// for a set used alone see [`follow`](Self::follow). The cubic errs by (ωΔt)⁴/384 of the amplitude of an
/// oscillation, the line by (ωΔt)²/8.
///
/// R is diag σ², but for observations with [`correlated`](Observation::correlated) errors, each of which
/// has a block. The m rows of all observations are stacked in one vector, in order of time (step, then
/// weight; observations of equal time keep the order they were given in). Every operator is called once for
/// every step at which it is needed, however many observations share it; rows nobody observed cost nothing
/// but that call. Memory goes with the observations, not with the steps.
///
/// ```
/// use varda_assimilation::{Observation, ObservationSet, Selection};
///
/// // Components 0 and 2 of a state of three: 0 at step 4, both half way between steps 7 and 8.
/// let h = Selection::new(vec![0, 2], 3)?;
/// let seen = vec![
///     Observation::new(4, vec![0], vec![1.2], 0.1),
///     Observation::new(7, vec![0, 1], vec![1.4, -0.3], 0.1).between(0.5),
/// ];
/// let set = ObservationSet::new(10, vec![Box::new(h)], seen)?;
/// assert_eq!((set.dim(), set.last_step()), (3, Some(8)));
/// # Ok::<(), varda_assimilation::Error>(())
/// ```
pub struct ObservationSet {
    operators: Vec<Box<dyn ObservationOperator>>,
    observations: Vec<Observation>,
    times: Times,
    /// Offset of every observation in the stacked vector, and m.
    offsets: Vec<usize>,
    values: Vec<f64>,
    sigma: Vec<f64>,
    pub(crate) noise: ObservationErrors,
    /// One operator at one step, ordered by step.
    samples: Vec<Sample>,
    /// What each stacked row takes from the samples, ordered by sample.
    parts: Vec<Part>,
    /// With rates: one operator at one time between two steps, in order of time.
    between: Vec<Inside>,
    /// The state between two steps, where rates are known, and work space for it.
    curve: Option<(Between, Vec<f64>)>,
    buffer: Vec<f64>,
    tangent: Vec<f64>,
}

/// H(x) of a run, and the states between steps that were observed on the way.
#[derive(Debug, Clone, Default)]
pub struct Prediction {
    values: Vec<f64>,
    /// One state for each of `between`.
    states: Vec<f64>,
}

impl Prediction {
    /// H(x), stacked.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Bytes of the states between steps.
    pub fn bytes(&self) -> usize {
        size_of_val(self.states.as_slice())
    }

    /// Back to zero, before another run.
    pub fn clear(&mut self) {
        self.values.fill(0.0);
        self.states.fill(0.0);
    }
}

/// One operator at one time between two steps.
#[derive(Debug, Clone)]
struct Inside {
    operator: usize,
    step: usize,
    weight: f64,
    /// Rows of the operator, and the stacked rows they are.
    rows: Vec<[usize; 2]>,
}

impl Inside {
    /// What stacked values act with on the rows of the operator.
    fn acting(&self, dy: &[f64], seen: &mut [f64]) {
        seen.fill(0.0);
        self.rows.iter().for_each(|&[from, to]| seen[from] += dy[to]);
    }
}

/// The times t_0 … t_K of the steps of a window.
#[derive(Debug, Clone)]
pub(crate) enum Times {
    /// Step k has the time k, for k = 0 … K.
    Steps(usize),
    /// As given, ascending.
    Given(Vec<f64>),
}

impl Times {
    /// K.
    fn steps(&self) -> usize {
        match self {
            Times::Steps(steps) => *steps,
            Times::Given(times) => times.len() - 1,
        }
    }

    /// t_k; NaN beyond the window.
    fn at(&self, k: usize) -> f64 {
        match self {
            Times::Steps(_) => k as f64,
            Times::Given(times) => times.get(k).copied().unwrap_or(f64::NAN),
        }
    }

    /// Those of the first `steps` steps.
    pub(crate) fn first(&self, steps: usize) -> Times {
        match self {
            Times::Steps(_) => Times::Steps(steps),
            Times::Given(times) => Times::Given(times[..=steps].to_vec()),
        }
    }
}

#[derive(Debug, Clone, Copy)]
struct Sample {
    operator: usize,
    step: usize,
    /// Range in `parts`.
    first: usize,
    end: usize,
}

impl Sample {
    /// What stacked values act with on the rows of the operator.
    fn acting(&self, parts: &[Part], dy: &[f64], seen: &mut [f64]) {
        seen.fill(0.0);
        for part in &parts[self.first..self.end] {
            seen[part.operator_row] += part.weight * dy[part.row];
        }
    }
}

#[derive(Debug, Clone, Copy)]
struct Part {
    operator_row: usize,
    row: usize,
    weight: f64,
}

impl ObservationSet {
    /// The observations of a window of `steps` steps, in any order. Operators are given k as the time of step
    /// k; for operators that depend on time see [`on_times`](Self::on_times).
    ///
    /// # Errors
    /// As for [`on_times`](Self::on_times).
    pub fn new(
        steps: usize,
        operators: Vec<Box<dyn ObservationOperator>>,
        observations: Vec<Observation>,
    ) -> Result<Self, Error> {
        Self::of(Times::Steps(steps), operators, observations)
    }

    /// The observations of a window whose steps have the times t_0 … t_K, in any order.
    ///
    /// # Errors
    /// Times that do not ascend; operators of states of different lengths; an observation with an unknown
    /// operator or row, outside the window, with a weight outside [0, 1), a value that is not finite or a σ
    /// that is not positive and finite; each error names the observation by its index in `observations`.
    pub fn on_times(
        times: Vec<f64>,
        operators: Vec<Box<dyn ObservationOperator>>,
        observations: Vec<Observation>,
    ) -> Result<Self, Error> {
        check_times(&times)?;
        Self::of(Times::Given(times), operators, observations)
    }

    /// The observations of a window on a grid of time that has been checked.
    pub(crate) fn of(
        times: Times,
        operators: Vec<Box<dyn ObservationOperator>>,
        mut observations: Vec<Observation>,
    ) -> Result<Self, Error> {
        let steps = times.steps();
        let lengths = || operators.iter().map(|o| o.state_dim());
        if let Some((operator, found)) = lengths().enumerate().find(|&(_, n)| Some(n) != lengths().next()) {
            let expected = operators[0].state_dim();
            return Err(Error::StateLength { operator, expected, found });
        }
        for (index, observation) in observations.iter().enumerate() {
            validate(index, observation, steps, &operators)?;
        }
        observations.sort_by(|a, b| a.step.cmp(&b.step).then(a.weight.total_cmp(&b.weight)));

        let mut offsets = vec![0];
        observations.iter().for_each(|o| offsets.push(offsets[offsets.len() - 1] + o.rows.len()));
        let widest = operators.iter().map(|o| o.dim()).max().unwrap_or(0);
        let mut set = Self {
            values: observations.iter().flat_map(|o| o.values.iter().copied()).collect(),
            sigma: observations.iter().flat_map(|o| o.sigma.iter().copied()).collect(),
            noise: ObservationErrors::new(&observations, &offsets)?,
            operators,
            observations,
            times,
            offsets,
            samples: Vec::new(),
            parts: Vec::new(),
            between: Vec::new(),
            curve: None,
            buffer: vec![0.0; widest],
            tangent: vec![0.0; widest],
        };
        set.follow(None);
        Ok(set)
    }

    /// Between two steps the state follows the cubic with these rates from now on; without, H(x) is a
    /// straight line there. Predictions made before are of no use then.
    pub fn follow(&mut self, rate: Option<Box<dyn Rate>>) {
        let n = self.operators.first().map_or(0, |o| o.state_dim());
        self.curve = rate.map(|rate| (Between::new(rate), vec![0.0; n]));
        self.between.clear();
        let mut keyed = Vec::new();
        for (o, &offset) in self.observations.iter().zip(&self.offsets) {
            let (operator, step, w) = (o.operator, o.step, o.weight);
            if w > 0.0 && self.curve.is_some() {
                let same = |b: &Inside| (b.operator, b.step, b.weight) == (operator, step, w);
                if !self.between.last().is_some_and(same) {
                    self.between.push(Inside { operator, step, weight: w, rows: Vec::new() });
                }
                let at = self.between.len() - 1;
                let rows = o.rows.iter().enumerate().map(|(i, &row)| [row, offset + i]);
                self.between[at].rows.extend(rows);
                continue;
            }
            for (i, &operator_row) in o.rows.iter().enumerate() {
                let row = offset + i;
                keyed.push((step, operator, Part { operator_row, row, weight: 1.0 - w }));
                if w > 0.0 {
                    keyed.push((step + 1, operator, Part { operator_row, row, weight: w }));
                }
            }
        }
        keyed.sort_by_key(|&(step, operator, part)| (step, operator, part.row));
        self.samples.clear();
        for (i, &(step, operator, _)) in keyed.iter().enumerate() {
            match self.samples.last_mut() {
                Some(last) if (last.step, last.operator) == (step, operator) => last.end = i + 1,
                _ => self.samples.push(Sample { operator, step, first: i, end: i + 1 }),
            }
        }
        self.parts = keyed.into_iter().map(|(_, _, part)| part).collect();
    }

    /// Whether the state follows a cubic between two steps.
    pub fn is_cubic(&self) -> bool {
        self.curve.is_some()
    }

    /// Room for H(x) of a run.
    pub fn prediction(&self) -> Prediction {
        let states = self.between.len() * self.curve.as_ref().map_or(0, |(_, state)| state.len());
        Prediction { values: vec![0.0; self.dim()], states: vec![0.0; states] }
    }

    /// The operators and the observations, in order of time: what another set can be made of.
    pub fn into_parts(self) -> (Vec<Box<dyn ObservationOperator>>, Vec<Observation>) {
        (self.operators, self.observations)
    }

    /// The set without some stacked rows; those left keep their order.
    ///
    /// # Errors
    /// A marginal covariance of correlated rows that cannot be factorized.
    ///
    /// # Panics
    /// If a row does not exist.
    pub fn without(self, rows: &[usize]) -> Result<Self, Error> {
        let mut keep = vec![true; self.dim()];
        rows.iter().for_each(|&row| keep[row] = false);
        let (times, offsets) = (self.times.clone(), self.offsets.clone());
        let (operators, mut observations) = self.into_parts();
        for (o, at) in observations.iter_mut().zip(offsets) {
            o.retain(&|i| keep[at + i])?;
        }
        observations.retain(|o| !o.rows.is_empty());
        Self::of(times, operators, observations)
    }

    /// Step k and its time.
    fn at(&self, k: usize) -> At {
        At { step: k, time: self.times.at(k) }
    }

    /// Where the samples of step k are.
    fn samples_of(&self, k: usize) -> Range<usize> {
        let first = self.samples.partition_point(|s| s.step < k);
        first..first + self.samples[first..].iter().take_while(|s| s.step == k).count()
    }

    /// m, the number of stacked rows.
    pub fn dim(&self) -> usize {
        self.values.len()
    }

    /// K, the length of the window in steps.
    pub fn steps(&self) -> usize {
        self.times.steps()
    }

    /// The times of the steps.
    pub(crate) fn times(&self) -> &Times {
        &self.times
    }

    /// Refuses a model whose state has another length than the state that the operators read.
    ///
    /// # Errors
    /// [`Error::StateLength`].
    pub fn check_state(&self, state_dim: usize) -> Result<(), Error> {
        match self.operators.first().map(|o| o.state_dim()) {
            Some(found) if found != state_dim => {
                Err(Error::StateLength { operator: 0, expected: state_dim, found })
            }
            _ => Ok(()),
        }
    }

    /// The last step whose state is needed; `None` where nothing is observed.
    pub fn last_step(&self) -> Option<usize> {
        let between = self.between.last().map(|b| b.step + 1);
        self.samples.last().map(|s| s.step).max(between)
    }

    /// The observations, in order of time.
    pub fn observations(&self) -> &[Observation] {
        &self.observations
    }

    /// Where the rows of observation `i` (in order of time) are in the stacked vector.
    pub fn rows(&self, i: usize) -> Range<usize> {
        self.offsets[i]..self.offsets[i + 1]
    }

    /// The observation that a row of the stacked vector belongs to.
    pub(crate) fn observation_of(&self, row: usize) -> usize {
        self.offsets.partition_point(|first| *first <= row) - 1
    }

    /// y, stacked.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// σ, stacked: the square roots of the diagonal of R.
    pub fn sigma(&self) -> &[f64] {
        &self.sigma
    }

    /// Where the times between steps are that state x_k has a share in: those of the interval before step k,
    /// then those of the interval after.
    fn between_of(&self, k: usize) -> Range<usize> {
        let first = self.between.partition_point(|b| b.step + 1 < k);
        first..first + self.between[first..].iter().take_while(|b| b.step <= k).count()
    }

    /// The time of an interval between two steps.
    fn inside(&self, b: &Inside) -> At {
        let (start, end) = (self.times.at(b.step), self.times.at(b.step + 1));
        At { step: b.step, time: start + b.weight * (end - start) }
    }

    /// Adds the share of state x_k to H(x). Called for k = 0 … `last_step` in this order, from a
    /// [`prediction`](Self::prediction) of this set, it makes H(x).
    ///
    /// # Errors
    /// An operator that refuses the state, or a prediction that is not finite.
    ///
    /// # Panics
    /// If `prediction` is not one of this set.
    pub fn observe_add(&mut self, k: usize, x: &[f64], prediction: &mut Prediction) -> Result<(), Error> {
        let (y, at) = (&mut prediction.values, self.at(k));
        assert_eq!(y.len(), self.dim(), "length of y");
        for sample in &self.samples[self.samples_of(k)] {
            let operator = &mut self.operators[sample.operator];
            let seen = &mut self.buffer[..operator.dim()];
            operator.observe(at, x, seen).map_err(|reason| Error::Observe {
                operator: sample.operator,
                step: k,
                reason,
            })?;
            for part in &self.parts[sample.first..sample.end] {
                y[part.row] += part.weight * seen[part.operator_row];
                if !y[part.row].is_finite() {
                    return Err(Error::NonFinite { what: "a predicted observation", step: k });
                }
            }
        }
        for i in self.between_of(k) {
            let at = self.inside(&self.between[i]);
            let Some((curve, _)) = &mut self.curve else { continue };
            let b = &self.between[i];
            let state = &mut prediction.states[i * x.len()..(i + 1) * x.len()];
            curve.add(b.step, k, b.weight, x, state);
            if k == b.step {
                continue;
            }
            let operator = &mut self.operators[b.operator];
            let seen = &mut self.buffer[..operator.dim()];
            operator.observe(at, state, seen).map_err(|reason| Error::Observe {
                operator: b.operator,
                step: k,
                reason,
            })?;
            b.rows.iter().for_each(|&[from, to]| y[to] = seen[from]);
            if !b.rows.iter().all(|&[_, to]| y[to].is_finite()) {
                return Err(Error::NonFinite { what: "a predicted observation", step: k });
            }
        }
        Ok(())
    }

    /// dy += the share of dx_k in H' dx, at a run with this prediction.
    ///
    /// # Panics
    /// If `dy` is not of length `dim`, or `run` is not a prediction of this set.
    pub fn tangent_add(&mut self, k: usize, x: &[f64], dx: &[f64], run: &Prediction, dy: &mut [f64]) {
        self.add_tangent(k, x, dx, run, dy, false);
    }

    /// As `tangent_add`, for a dx that is the same at every step and has no rate.
    pub(crate) fn persistent_tangent_add(
        &mut self,
        k: usize,
        x: &[f64],
        dx: &[f64],
        run: &Prediction,
        dy: &mut [f64],
    ) {
        self.add_tangent(k, x, dx, run, dy, true);
    }

    fn add_tangent(
        &mut self,
        k: usize,
        x: &[f64],
        dx: &[f64],
        run: &Prediction,
        dy: &mut [f64],
        persists: bool,
    ) {
        assert_eq!(dy.len(), self.dim(), "length of dy");
        let at = self.at(k);
        for sample in &self.samples[self.samples_of(k)] {
            let operator = &mut self.operators[sample.operator];
            let seen = &mut self.tangent[..operator.dim()];
            operator.tangent(at, x, dx, seen);
            for part in &self.parts[sample.first..sample.end] {
                dy[part.row] += part.weight * seen[part.operator_row];
            }
        }
        for i in self.between_of(k) {
            let at = self.inside(&self.between[i]);
            let Some((curve, share)) = &mut self.curve else { continue };
            let b = &self.between[i];
            match (persists, k == b.step) {
                (false, _) => curve.tangent((b.step, k, b.weight), x, dx, share),
                (true, true) => share.copy_from_slice(dx),
                (true, false) => continue,
            }
            let operator = &mut self.operators[b.operator];
            let seen = &mut self.tangent[..operator.dim()];
            operator.tangent(at, &run.states[i * x.len()..(i + 1) * x.len()], share, seen);
            b.rows.iter().for_each(|&[from, to]| dy[to] += seen[from]);
        }
    }

    /// dx_k += the share of state k in H'ᵀ dy, at a run with this prediction.
    ///
    /// # Panics
    /// If `dy` is not of length `dim`, or `run` is not a prediction of this set.
    pub fn adjoint_add(&mut self, k: usize, x: &[f64], dy: &[f64], run: &Prediction, dx: &mut [f64]) {
        assert_eq!(dy.len(), self.dim(), "length of dy");
        let at = self.at(k);
        for sample in &self.samples[self.samples_of(k)] {
            let operator = &mut self.operators[sample.operator];
            let seen = &mut self.tangent[..operator.dim()];
            sample.acting(&self.parts, dy, seen);
            operator.adjoint_add(at, x, seen, dx);
        }
        for i in self.between_of(k) {
            let at = self.inside(&self.between[i]);
            let Some((curve, lambda)) = &mut self.curve else { continue };
            let b = &self.between[i];
            let operator = &mut self.operators[b.operator];
            let seen = &mut self.tangent[..operator.dim()];
            b.acting(dy, seen);
            lambda.fill(0.0);
            operator.adjoint_add(at, &run.states[i * x.len()..(i + 1) * x.len()], seen, lambda);
            curve.adjoint_add((b.step, k, b.weight), x, lambda, dx);
        }
    }

    /// The stacked rows with a share of state x_k. (They are neighbours: those of step k, and before them
    /// those of step k − 1 that lie between the two.)
    pub fn rows_at(&self, k: usize) -> Range<usize> {
        let samples = &self.samples[self.samples_of(k)];
        let between = &self.between[self.between_of(k)];
        let rows = || {
            let at_step = samples.iter().flat_map(|s| &self.parts[s.first..s.end]).map(|part| part.row);
            at_step.chain(between.iter().flat_map(|b| &b.rows).map(|rows| rows[1]))
        };
        rows().min().map_or(self.dim()..self.dim(), |first| first..rows().max().unwrap_or(first) + 1)
    }

    /// Of each stacked row the last step whose state it needs: the steps of an adjoint sweep for it.
    pub(crate) fn steps_of_rows(&self) -> Vec<usize> {
        self.observations.iter().flat_map(|o| std::iter::repeat_n(o.last_step(), o.rows.len())).collect()
    }

    /// d = y − H(x), the innovations, from the predictions H(x).
    ///
    /// # Panics
    /// If a slice is not of length `dim`.
    pub fn innovations(&self, predicted: &[f64], d: &mut [f64]) {
        assert!(predicted.len() == self.dim() && d.len() == self.dim(), "lengths of H(x) and d");
        for ((d, y), p) in d.iter_mut().zip(&self.values).zip(predicted) {
            *d = y - p;
        }
    }
}

fn check_times(times: &[f64]) -> Result<(), Error> {
    let ascend = |pair: &&[f64]| !(pair[0] < pair[1]);
    match times.windows(2).find(ascend).map(|pair| pair[1]).or(times.iter().copied().find(|t| !t.is_finite()))
    {
        Some(value) => Err(Error::Setting { what: "a time of the window, after the one before it,", value }),
        None if times.is_empty() => Err(Error::Length { what: "the grid of time", expected: 1, found: 0 }),
        None => Ok(()),
    }
}

fn validate(
    index: usize,
    observation: &Observation,
    steps: usize,
    operators: &[Box<dyn ObservationOperator>],
) -> Result<(), Error> {
    let Observation { operator, ref rows, step, weight, ref values, ref sigma, .. } = *observation;
    if operator >= operators.len() {
        return Err(Error::UnknownOperator { observation: index, operator, operators: operators.len() });
    }
    let dim = operators[operator].dim();
    if let Some(&row) = rows.iter().find(|&&row| row >= dim) {
        return Err(Error::UnknownRow { observation: index, row, rows: dim });
    }
    if !(0.0..1.0).contains(&weight) {
        return Err(Error::Weight { observation: index, weight });
    }
    if step > steps || (step == steps && weight > 0.0) {
        return Err(Error::OutsideWindow { observation: index, step, weight, steps });
    }
    if rows.len() != values.len() || rows.len() != sigma.len() {
        return Err(Error::Lengths {
            observation: index,
            rows: rows.len(),
            values: values.len(),
            sigmas: sigma.len(),
        });
    }
    if let Some(entry) = values.iter().position(|y| !y.is_finite()) {
        return Err(Error::Value { observation: index, entry, value: values[entry] });
    }
    if let Some(entry) = sigma.iter().position(|s| !(*s > 0.0 && s.is_finite())) {
        return Err(Error::Sigma { observation: index, entry, sigma: sigma[entry] });
    }
    Ok(())
}
