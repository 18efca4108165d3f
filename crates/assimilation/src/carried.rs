//! The posterior of a model that errs, at later times.

use crate::{ControlTransform, Error, Forcing, WeakPosterior};
use varda_covariance::Covariance;
use varda_implicit::{At, Model, ObservationOperator};
use varda_linalg::interrupt;
use varda_linalg::shorter_root;

/// The covariance of the initial state and of the errors of a model, W Wᵀ − V Vᵀ
/// ([`WeakPosterior::with_errors`]): columns of an initial state, δz, and of what is known of the errors,
/// η_1 … η_N.
#[derive(Debug, Clone, PartialEq)]
pub struct ErrorColumns {
    /// V and W, each a list of columns.
    less: Columns,
    added: Columns,
    /// N, of the analysis.
    errors: usize,
}

/// Columns of (δz, η_1 … η_N).
#[derive(Debug, Clone, PartialEq)]
struct Columns {
    values: Vec<f64>,
    /// Length of a column.
    length: usize,
    /// How many errors are in it.
    errors: usize,
}

impl ErrorColumns {
    /// (I − Y Yᵀ) of the initial state and all errors: W = U ⊕ Q^{1/2} ⊕ …, the errors entering
    /// as they come, and V = W Y.
    pub(crate) fn difference(
        y: &[f64],
        errors: usize,
        transform: &ControlTransform,
        q: &dyn Covariance,
    ) -> Self {
        let n = transform.dim();
        let prior: Vec<f64> = (0..n * n).map(|i| f64::from(i % (n + 1) == 0)).collect();
        Self { less: physical(y, errors, transform, q), added: physical(&prior, 0, transform, q), errors }
    }

    /// W Wᵀ, W from columns in the whitened control.
    pub(crate) fn root(w: &[f64], errors: usize, transform: &ControlTransform, q: &dyn Covariance) -> Self {
        let none = Columns { values: Vec::new(), length: transform.control_dim(), errors: 0 };
        Self { less: none, added: physical(w, errors, transform, q), errors }
    }

    /// How many columns V and W have.
    pub fn count(&self) -> [usize; 2] {
        [&self.less, &self.added].map(|c| c.values.len() / c.length.max(1))
    }
}

/// Columns of (v, p_1 … p_N) in their units.
fn physical(whitened: &[f64], errors: usize, transform: &ControlTransform, q: &dyn Covariance) -> Columns {
    let (n, n_z) = (transform.dim(), transform.control_dim());
    let (block, rows) = (q.root_dim(), q.dim());
    let length = n_z + errors * rows;
    let short = n + errors * block;
    let mut values = vec![0.0; whitened.len() / short.max(1) * length];
    for (p, column) in whitened.chunks_exact(short.max(1)).zip(values.chunks_exact_mut(length.max(1))) {
        let (dz, eta) = column.split_at_mut(n_z);
        transform.tangent(&p[..n], dz);
        for (p, eta) in p[n..].chunks_exact(block.max(1)).zip(eta.chunks_exact_mut(rows.max(1))) {
            q.root(p, eta);
        }
    }
    Columns { values, length, errors }
}

/// The covariance of the states x_{k−1} and x_k at step k of a run, by columns that are shared by both: the
/// sum over the last of them less that over the first `less`.
///
/// ```
/// use varda_assimilation::Carried;
///
/// // One column that counts and, before it, one of what was learnt.
/// let at = Carried { step: 4, dim: 2, before: &[], now: &[0.6, 0.0, 1.0, 2.0], less: 1 };
/// let variance = at.variance();
/// assert!((variance[0] - 0.64).abs() < 1e-15 && variance[1] == 4.0);
/// ```
#[derive(Debug, Clone, Copy)]
pub struct Carried<'a> {
    /// k.
    pub step: usize,
    /// Length of a state.
    pub dim: usize,
    /// Columns of x_{k−1}; none at step 0.
    pub before: &'a [f64],
    /// Columns of x_k.
    pub now: &'a [f64],
    /// How many of the first columns count negative.
    pub less: usize,
}

impl Carried<'_> {
    /// Variances of x_k, the diagonal of P_k.
    pub fn variance(&self) -> Vec<f64> {
        self.sum_of_squares(self.dim, self.now.chunks_exact(self.dim.max(1)))
    }

    /// Variances of H(x_k), the diagonal of H P_k Hᵀ, linearized at the state `x`.
    ///
    /// # Panics
    /// If the operator is one of states of another length.
    pub fn of(&self, operator: &mut dyn ObservationOperator, at: At, x: &[f64]) -> Vec<f64> {
        let m = operator.dim();
        let mut seen = vec![0.0; self.now.len() / self.dim.max(1) * m];
        for (dx, dy) in self.now.chunks_exact(self.dim.max(1)).zip(seen.chunks_exact_mut(m.max(1))) {
            operator.tangent(at, x, dx, dy);
        }
        self.sum_of_squares(m, seen.chunks_exact(m.max(1)))
    }

    /// Sums of squares of `rows` rows, given by columns as this covariance has them; what rounding leaves of
    /// what is known far better than before is at least ε of that.
    ///
    /// # Panics
    /// If a column is of another length.
    pub fn sum_of_squares<'c>(&self, rows: usize, columns: impl Iterator<Item = &'c [f64]>) -> Vec<f64> {
        let mut sums = self.squares(rows);
        columns.for_each(|column| sums.add(column.iter().copied()));
        sums.end()
    }

    /// The same, given one column after the other.
    pub fn squares(&self, rows: usize) -> Squares {
        Squares { less: self.less, seen: 0, sums: [vec![0.0; rows], vec![0.0; rows]] }
    }
}

/// Sums of squares along the rows of what columns lead to ([`Carried::squares`]).
///
/// ```
/// use varda_assimilation::Carried;
///
/// let at = Carried { step: 0, dim: 1, before: &[], now: &[0.6, 1.0], less: 1 };
/// let mut squares = at.squares(1);
/// at.now.iter().for_each(|x| squares.add([2.0 * x].into_iter()));
/// assert!((squares.end()[0] - 4.0 * 0.64).abs() < 1e-15);
/// ```
#[derive(Debug, Clone)]
pub struct Squares {
    less: usize,
    seen: usize,
    sums: [Vec<f64>; 2],
}

impl Squares {
    /// The next column.
    ///
    /// # Panics
    /// If it is of another length than there are rows.
    pub fn add(&mut self, column: impl Iterator<Item = f64>) {
        let sum = &mut self.sums[usize::from(self.seen >= self.less)];
        let (mut rows, mut entries) = (0, column);
        for (s, w) in sum.iter_mut().zip(&mut entries) {
            *s += w * w;
            rows += 1;
        }
        assert!(rows == self.sums[0].len() && entries.next().is_none(), "length of a column");
        self.seen += 1;
    }

    /// The variances.
    pub fn end(self) -> Vec<f64> {
        let Self { less: count, sums: [less, added], .. } = self;
        added
            .iter()
            .zip(less)
            .map(|(a, l)| (a - l).max(if count > 0 { f64::EPSILON * a } else { 0.0 }))
            .collect()
    }
}

/// Carries the covariance of an initial state and of the errors of a model through the analysis by a weak
/// form and its forecast:
///
/// ```text
///     x_{k+1} = M_k(x_k) + E η_j,    δx_{k+1} = M_k δx_k + E δη_j,
///     P_k = W_k W_kᵀ − V_k V_kᵀ
/// ```
///
/// with M_k linearized along `states` (x₀, x₁, … one after the other). Errors that the analysis knows
/// nothing of, after its last observation, enter with their Q, so that a forecast is as uncertain as the
/// model is said to be. `on_state` is called at every step; columns of different calls need not belong
/// together. On a linear problem it is the covariance of the Kalman smoother, and of the filter's forecast.
///
/// Takes at every step one linearization (into slot 0) and a tangent product for each column, and a step of
/// the model where an error entered; where nothing more is known of errors to come, columns beyond twice the
/// length of a state are brought down to that length.
///
/// ```
/// use std::ops::ControlFlow;
/// use varda_assimilation::{ControlTransform, CostFunction, Forcing, LeastSquares, Minimizer, Observation};
/// use varda_assimilation::{ObservationSet, Selection, WeakForcing, WeakPosterior, propagate_errors};
/// use varda_covariance::Diagonal;
/// use varda_implicit::{Rk4, lorenz::Lorenz63};
///
/// let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);
/// let seen = vec![Observation::new(20, vec![0, 2], vec![8.1, 14.9], 0.1)];
/// let mut observations = ObservationSet::new(20, vec![Box::new(Selection::new(vec![0, 1, 2], 3)?)], seen)?;
/// let (b, q) = (Diagonal::uniform(3, 1.0)?, Diagonal::uniform(3, 0.2)?);
/// let forcing = Forcing { steps: 10, ..Forcing::every_step(3) };
/// let transform = ControlTransform::new(vec![1.5, 1.7, 20.0], &b)?;
/// let mut cost = WeakForcing::new(&mut model, transform.clone(), &q, forcing.clone(), &mut observations)?;
/// let mut v = vec![0.0; cost.dim()];
/// Minimizer::default().minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(()))?;
/// cost.linearize(&v, &mut vec![0.0; v.len()])?;
/// let columns = WeakPosterior::new(&mut cost)?.with_errors(&transform, &q, 1000);
/// let states: Vec<f64> = (0..=20).flat_map(|k| cost.state(k).to_vec()).collect();
/// drop(cost);
/// let mut sigma = vec![];
/// propagate_errors(&mut model, &columns, (&forcing, &q), &states, &mut |at| {
///     sigma.push(at.variance().iter().map(|v| v.sqrt()).collect::<Vec<_>>());
///     Ok(())
/// })?;
/// // What is seen at step 20 is known to σ there.
/// assert!(sigma[20][0] < 0.1 && sigma[20][2] < 0.1 && sigma[20][1] > 0.1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// A step that fails or cannot be linearized, a calculation that was told to end, and those of `on_state`.
///
/// # Panics
/// If `states` is not made of whole states, or the columns are those of another model or Q.
pub fn propagate_errors(
    model: &mut dyn Model,
    columns: &ErrorColumns,
    (forcing, q): (&Forcing, &dyn Covariance),
    states: &[f64],
    on_state: &mut dyn FnMut(&Carried) -> Result<(), Error>,
) -> Result<(), Error> {
    let n = model.dim();
    assert!(states.len().is_multiple_of(n), "a state has {n} values");
    let [less, _] = columns.count();
    model.release(1);
    let mut now = Vec::new();
    for of in [&columns.less, &columns.added] {
        for column in of.values.chunks_exact(of.length.max(1)) {
            let first = now.len();
            now.resize(first + n, 0.0);
            model.initial_tangent(&column[..of.length - of.errors * q.dim()], &mut now[first..]);
        }
    }
    let (mut before, mut landing) = (Vec::new(), vec![0.0; n]);
    let mut entering = Entering { forcing, q, columns, current: None, fresh: 0, eta: vec![0.0; q.dim()] };
    for (k, state) in states.chunks_exact(n).enumerate() {
        if interrupt::requested() {
            return Err(varda_linalg::Error::Interrupted.into());
        }
        on_state(&Carried { step: k, dim: n, before: &before, now: &now, less })?;
        let Some(next) = states.get((k + 1) * n..(k + 2) * n) else { break };
        entering.make_room(k, n, less, &mut now)?;
        before.clone_from(&now);
        let landed = if forcing.index(k).is_some_and(|j| j < columns.errors) {
            model.step(k, state, &mut landing)?;
            &landing[..]
        } else {
            next
        };
        model.linearize(0, k, state, landed)?;
        model.tangent(0, &mut now);
        entering.add(k, n, less, &mut now);
    }
    Ok(())
}

/// Errors that enter the columns of a state.
struct Entering<'a> {
    forcing: &'a Forcing,
    q: &'a dyn Covariance,
    columns: &'a ErrorColumns,
    /// The error that entered last.
    current: Option<usize>,
    /// Columns before those of that error, where W knows nothing of it.
    fresh: usize,
    eta: Vec<f64>,
}

impl Entering<'_> {
    /// Columns of zeros for the error that enters after step k, if W knows nothing of it; before that W is
    /// brought down to n columns where it has more than twice as many.
    fn make_room(&mut self, k: usize, n: usize, less: usize, now: &mut Vec<f64>) -> Result<(), Error> {
        let Some(j) = self.forcing.index(k).filter(|j| self.current != Some(*j)) else { return Ok(()) };
        self.current = Some(j);
        if j < self.columns.added.errors {
            return Ok(());
        }
        let count = now.len() / n - less;
        if count + self.q.root_dim() > 2 * n && count > n {
            let shorter = shorter_root(n, &now[less * n..])?;
            now.truncate(less * n);
            now.extend(shorter);
        }
        self.fresh = now.len() / n;
        now.resize(now.len() + n * self.q.root_dim(), 0.0);
        Ok(())
    }

    /// δx_{k+1} += E δη_j.
    fn add(&mut self, k: usize, n: usize, less: usize, now: &mut [f64]) {
        let Some(j) = self.forcing.index(k) else { return };
        let Self { forcing, q, columns, fresh, eta, .. } = self;
        let enter = |column: &mut [f64], eta: &[f64]| {
            forcing.components.iter().zip(eta).for_each(|(&c, eta)| column[c] += eta);
        };
        let (first, last) = now.split_at_mut(less * n);
        for (of, states) in [(&columns.less, first), (&columns.added, &mut *last)] {
            if j < of.errors {
                for (known, column) in of.values.chunks_exact(of.length).zip(states.chunks_exact_mut(n)) {
                    let after = of.length - (of.errors - j) * q.dim();
                    enter(column, &known[after..after + q.dim()]);
                }
            }
        }
        if j >= columns.added.errors {
            let mut unit = vec![0.0; q.root_dim()];
            for (i, column) in last[(*fresh - less) * n..].chunks_exact_mut(n).enumerate() {
                unit[i] = 1.0;
                q.root(&unit, eta);
                unit[i] = 0.0;
                enter(column, eta);
            }
        }
    }
}

impl WeakPosterior {
    /// The covariance of the initial state and of every error, to be carried along the run
    /// ([`propagate_errors`]); `q` is the cost's. With at most `most` unknowns, or as many values as
    /// unknowns, it is a root of P, which keeps half of the digits that the observations leave of the prior;
    /// else the prior less what was learnt, with a column for each value in place of one for each unknown.
    ///
    /// # Panics
    /// If transform and Q are not those of the cost.
    pub fn with_errors(&self, transform: &ControlTransform, q: &dyn Covariance, most: usize) -> ErrorColumns {
        let [r, n] = self.dims();
        let errors = (r - n) / q.root_dim().max(1);
        assert_eq!((n, r), (transform.dim(), n + errors * q.root_dim()), "lengths of the control");
        if r <= most || self.is_whole() {
            ErrorColumns::root(&self.root(), errors, transform, q)
        } else {
            ErrorColumns::difference(&self.learnt(), errors, transform, q)
        }
    }
}
