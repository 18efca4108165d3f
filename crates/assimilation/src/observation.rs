//! Observations y of a trajectory, and the operators H that predict them.

use crate::Error;
use crate::noise::{Correlated, Noise};
use std::ops::Range;
use varda_implicit::{At, ObservationOperator};

/// All observations of a window of K steps, with the operators that predict them.
///
/// ```text
///     H(x)_i = (1 − w_i) H_op(i)(x_{k_i})[row_i] + w_i H_op(i)(x_{k_i + 1})[row_i],    d = y − H(x)
/// ```
///
/// R is diag σ², but for observations with [`correlated`](Observation::correlated) errors, each of which
/// has a block. The m rows of all observations are stacked in one vector, in order of time (step, then
/// weight; observations of equal time keep the order they were given in). Every operator is called once for
/// every step at which it is needed, however many observations share it; rows nobody observed cost nothing
/// but that call.
pub struct ObservationSet {
    operators: Vec<Box<dyn ObservationOperator>>,
    observations: Vec<Observation>,
    /// t_0 … t_K.
    times: Vec<f64>,
    /// Offset of every observation in the stacked vector, and m.
    offsets: Vec<usize>,
    values: Vec<f64>,
    sigma: Vec<f64>,
    pub(crate) noise: Noise,
    /// One operator at one step, ordered by step; the samples of step k are `by_step[k]..by_step[k + 1]`, up
    /// to the last step with one.
    samples: Vec<Sample>,
    by_step: Vec<usize>,
    /// What each stacked row takes from the samples, ordered by sample.
    parts: Vec<Part>,
    buffer: Vec<f64>,
    tangent: Vec<f64>,
}

/// What was measured at one time by one operator: some of its rows, each with its value and standard
/// deviation.
///
/// A time between two steps is a weight on each. A component that was not measured is a row left out.
///
/// ```
/// use varda_assimilation::Observation;
///
/// // Rows 0 and 2 of operator 0 at step 20, both with σ = 0.1.
/// let first = Observation::new(20, vec![0, 2], vec![8.1, 14.9], 0.1);
/// // Row 0 of operator 1, half way between steps 30 and 31.
/// let second = Observation::new(30, vec![0], vec![15.4], 0.2).between(0.5).operator(1).label("tip");
/// assert_eq!((first.weight, second.weight), (0.0, 0.5));
/// ```
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Observation {
    /// Index of the operator in the set.
    pub operator: usize,
    /// The rows of the operator that were measured.
    pub rows: Vec<usize>,
    /// Step k of the window (0 is the initial state).
    pub step: usize,
    /// w ∈ [0, 1): the share of step k + 1. Time t_k + w Δt.
    pub weight: f64,
    /// y, one for each row.
    pub values: Vec<f64>,
    /// σ > 0, one for each row, in the unit of the value.
    pub sigma: Vec<f64>,
    /// Their covariance, where the errors of the rows are correlated.
    pub correlation: Option<Correlated>,
    /// The name of the instrument or place; for reports only.
    pub label: String,
}

impl Observation {
    /// Some rows of operator 0, measured at a step of the window with independent errors of one standard
    /// deviation σ.
    ///
    /// Nothing is checked here: [`ObservationSet::new`] checks all observations of a window.
    pub fn new(step: usize, rows: Vec<usize>, values: Vec<f64>, sigma: f64) -> Self {
        let sigma = vec![sigma; rows.len()];
        Self { operator: 0, rows, step, weight: 0.0, values, sigma, correlation: None, label: String::new() }
    }

    /// With a standard deviation σ for each row, and independent errors.
    pub fn sigmas(self, sigma: Vec<f64>) -> Self {
        Self { sigma, correlation: None, ..self }
    }

    /// At another step.
    pub fn at_step(self, step: usize) -> Self {
        Self { step, ..self }
    }

    /// Between its step k and step k + 1: `weight` w ∈ [0, 1) is the share of step k + 1.
    pub fn between(self, weight: f64) -> Self {
        Self { weight, ..self }
    }

    /// Through another operator of the set than the first.
    pub fn operator(self, operator: usize) -> Self {
        Self { operator, ..self }
    }

    /// With a name for reports.
    pub fn label(self, label: impl Into<String>) -> Self {
        Self { label: label.into(), ..self }
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
        Self::on_times((0..=steps).map(|k| k as f64).collect(), operators, observations)
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
        mut observations: Vec<Observation>,
    ) -> Result<Self, Error> {
        check_times(&times)?;
        let steps = times.len() - 1;
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
        let mut keyed = Vec::new();
        for observation in &observations {
            let offset = offsets[offsets.len() - 1];
            for (i, &operator_row) in observation.rows.iter().enumerate() {
                let (step, w, row) = (observation.step, observation.weight, offset + i);
                keyed.push((step, observation.operator, Part { operator_row, row, weight: 1.0 - w }));
                if w > 0.0 {
                    keyed.push((step + 1, observation.operator, Part { operator_row, row, weight: w }));
                }
            }
            offsets.push(offset + observation.rows.len());
        }
        keyed.sort_by_key(|&(step, operator, part)| (step, operator, part.row));

        let mut samples: Vec<Sample> = Vec::new();
        for (i, &(step, operator, _)) in keyed.iter().enumerate() {
            match samples.last_mut() {
                Some(last) if (last.step, last.operator) == (step, operator) => last.end = i + 1,
                _ => samples.push(Sample { operator, step, first: i, end: i + 1 }),
            }
        }
        let end = samples.last().map_or(0, |last| last.step + 1);
        let by_step = (0..=end).map(|k| samples.partition_point(|s| s.step < k)).collect();
        let widest = operators.iter().map(|o| o.dim()).max().unwrap_or(0);
        Ok(Self {
            values: observations.iter().flat_map(|o| o.values.iter().copied()).collect(),
            sigma: observations.iter().flat_map(|o| o.sigma.iter().copied()).collect(),
            noise: Noise::new(&observations, &offsets)?,
            operators,
            observations,
            times,
            offsets,
            samples,
            by_step,
            parts: keyed.into_iter().map(|(_, _, part)| part).collect(),
            buffer: vec![0.0; widest],
            tangent: vec![0.0; widest],
        })
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
        Self::on_times(times, operators, observations)
    }

    /// Step k and its time.
    fn at(&self, k: usize) -> At {
        At { step: k, time: self.times.get(k).copied().unwrap_or(f64::NAN) }
    }

    /// Where the samples of step k are.
    fn samples_of(&self, k: usize) -> Range<usize> {
        let none = self.samples.len()..self.samples.len();
        self.by_step.get(k..).and_then(|b| b.get(..2)).map_or(none, |b| b[0]..b[1])
    }

    /// m, the number of stacked rows.
    pub fn dim(&self) -> usize {
        self.values.len()
    }

    /// K, the length of the window in steps.
    pub fn steps(&self) -> usize {
        self.times.len() - 1
    }

    /// t_0 … t_K, the times of the steps.
    pub fn times(&self) -> &[f64] {
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
        self.samples.last().map(|s| s.step)
    }

    /// The observations, in order of time.
    pub fn observations(&self) -> &[Observation] {
        &self.observations
    }

    /// Where the rows of observation `i` (in order of time) are in the stacked vector.
    pub fn rows(&self, i: usize) -> Range<usize> {
        self.offsets[i]..self.offsets[i + 1]
    }

    /// y, stacked.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// σ, stacked: the square roots of the diagonal of R.
    pub fn sigma(&self) -> &[f64] {
        &self.sigma
    }

    /// y += the share of state x_k in H(x). Summed over k = 0 … `last_step` from zero this is H(x), of
    /// length `dim`.
    ///
    /// # Errors
    /// An operator that refuses the state, or a prediction that is not finite.
    ///
    /// # Panics
    /// If `y` is not of length `dim`.
    pub fn observe_add(&mut self, k: usize, x: &[f64], y: &mut [f64]) -> Result<(), Error> {
        assert_eq!(y.len(), self.dim(), "length of y");
        let at = self.at(k);
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
        Ok(())
    }

    /// dy += the share of dx_k in H' dx.
    ///
    /// # Panics
    /// If `dy` is not of length `dim`.
    pub fn tangent_add(&mut self, k: usize, x: &[f64], dx: &[f64], dy: &mut [f64]) {
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
    }

    /// dx_k += the share of state k in H'ᵀ dy.
    ///
    /// # Panics
    /// If `dy` is not of length `dim`.
    pub fn adjoint_add(&mut self, k: usize, x: &[f64], dy: &[f64], dx: &mut [f64]) {
        assert_eq!(dy.len(), self.dim(), "length of dy");
        let at = self.at(k);
        for sample in &self.samples[self.samples_of(k)] {
            let operator = &mut self.operators[sample.operator];
            let seen = &mut self.tangent[..operator.dim()];
            seen.fill(0.0);
            for part in &self.parts[sample.first..sample.end] {
                seen[part.operator_row] += part.weight * dy[part.row];
            }
            operator.adjoint_add(at, x, seen, dx);
        }
    }

    /// The stacked rows with a share of state x_k. (They are neighbours: those of step k, and before them
    /// those of step k − 1 that lie between the two.)
    pub(crate) fn rows_at(&self, k: usize) -> Range<usize> {
        let samples = &self.samples[self.samples_of(k)];
        let rows = || samples.iter().flat_map(|s| &self.parts[s.first..s.end]).map(|part| part.row);
        rows().min().map_or(self.dim()..self.dim(), |first| first..rows().max().unwrap_or(first) + 1)
    }

    /// Σ over the rows of the last step whose state they need: the steps of an adjoint sweep for each.
    pub(crate) fn steps_of_rows(&self) -> usize {
        self.observations.iter().map(|o| o.rows.len() * (o.step + usize::from(o.weight > 0.0))).sum()
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
