//! Observations y of a trajectory, and the operators H that predict them.

use crate::noise::ObservationErrors;
use crate::{Error, Observation};
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
    buffer: Vec<f64>,
    tangent: Vec<f64>,
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
        let widest = operators.iter().map(|o| o.dim()).max().unwrap_or(0);
        Ok(Self {
            values: observations.iter().flat_map(|o| o.values.iter().copied()).collect(),
            sigma: observations.iter().flat_map(|o| o.sigma.iter().copied()).collect(),
            noise: ObservationErrors::new(&observations, &offsets)?,
            operators,
            observations,
            times,
            offsets,
            samples,
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
        let steps = |o: &Observation| o.rows.len().saturating_mul(o.step + usize::from(o.weight > 0.0));
        self.observations.iter().map(steps).fold(0, usize::saturating_add)
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

impl ObservationSet {
    /// d ← R^{-1/2} d, stacked.
    ///
    /// # Panics
    /// If `d` is not of length `dim`.
    pub fn whiten(&self, d: &mut [f64]) {
        assert_eq!(d.len(), self.dim(), "length of d");
        d.iter_mut().zip(&self.noise.scale).for_each(|(d, s)| *d /= s);
        self.whiten_blocks(d);
    }

    /// d ← R^{-1/2}ᵀ d, stacked.
    ///
    /// # Panics
    /// If `d` is not of length `dim`.
    pub fn whiten_transpose(&self, d: &mut [f64]) {
        assert_eq!(d.len(), self.dim(), "length of d");
        self.whiten_blocks_transpose(d);
        d.iter_mut().zip(&self.noise.scale).for_each(|(d, s)| *d /= s);
    }

    /// R, dense, by columns: for small problems and references.
    pub fn error_covariance(&self) -> Vec<f64> {
        let m = self.dim();
        let mut r = vec![0.0; m * m];
        self.sigma().iter().enumerate().for_each(|(i, s)| r[i + i * m] = s * s);
        for (rows, block) in &self.noise.blocks {
            let (mut unit, mut column) = (vec![0.0; rows.len()], vec![0.0; rows.len()]);
            for j in 0..rows.len() {
                unit[j] = 1.0;
                block.covariance().apply(&unit, &mut column);
                unit[j] = 0.0;
                r[(rows.start + j) * m + rows.start..][..rows.len()].copy_from_slice(&column);
            }
        }
        r
    }

    /// R by its square root.
    pub fn errors(&self) -> &ObservationErrors {
        &self.noise
    }

    /// Whether some observation has correlated errors.
    pub fn is_correlated(&self) -> bool {
        !self.noise.blocks.is_empty()
    }

    /// σ of independent rows, 1 of correlated ones.
    pub(crate) fn row_scale(&self) -> &[f64] {
        &self.noise.scale
    }

    /// The correlated blocks of R^{-1/2} alone.
    pub(crate) fn whiten_blocks(&self, d: &mut [f64]) {
        for (rows, block) in &self.noise.blocks {
            let raw = d[rows.clone()].to_vec();
            block.covariance().whiten(&raw, &mut d[rows.clone()]);
        }
    }

    /// Their transposes.
    pub(crate) fn whiten_blocks_transpose(&self, d: &mut [f64]) {
        for (rows, block) in &self.noise.blocks {
            let raw = d[rows.clone()].to_vec();
            block.covariance().whiten_transpose(&raw, &mut d[rows.clone()]);
        }
    }

    /// The blocks of R^{-1/2} on the rows of G, given as the columns of Gᵀ, each of length n.
    pub(crate) fn whiten_rows(&self, n: usize, transposed: &mut [f64]) {
        for (rows, block) in &self.noise.blocks {
            let (mut raw, mut white) = (vec![0.0; rows.len()], vec![0.0; rows.len()]);
            for j in 0..n {
                rows.clone().zip(&mut raw).for_each(|(i, raw)| *raw = transposed[i * n + j]);
                block.covariance().whiten(&raw, &mut white);
                rows.clone().zip(&white).for_each(|(i, white)| transposed[i * n + j] = *white);
            }
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
