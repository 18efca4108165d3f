//! Several costs that share some of their unknowns, as one.

use super::{CostFunction, CostTerms, Counts, LeastSquares, dot};
use crate::Error;
use std::ops::Add;

/// Several windows of one system with some unknowns in common, as several recordings of one rod: each has an
/// initial state of its own, the constants are the same. With own unknowns v¹ … v^R and shared ones v_p,
///
/// ```text
///     J(v¹ … v^R, v_p) = Σ_r J_r(v^r, v_p) − ½ (R − 1) ‖v_p‖²
///     A = Σ_r E_r A_r E_rᵀ − (R − 1) E_p E_pᵀ
/// ```
///
/// where E_r puts the unknowns of cost r in their places. Each J_r is a cost of its own and has the prior of
/// the shared unknowns, ½‖v_p‖²; of their sum it is left once. A is block diagonal but for the rows and
/// columns of v_p. The unknowns of the joint cost are v¹, …, v^R, v_p, one after the other
/// ([`places`](Self::places)); its observed values are those of the costs, one after the other. With one cost
/// J and its derivatives are that cost's.
///
/// When to use: windows that do not follow each other, of models that are the same but for their initial
/// state, forcing or observations. When not: windows that follow each other are one window, or
/// [`cycle`](crate::cycle). Cost and memory: the sum of those of the parts; a dense A has (Σ n_r)² numbers.
///
/// # Examples
/// A decay rate p seen in two runs ẋ = −p x from other starts, each 1 ± 0.5:
///
/// ```
/// use std::ops::ControlFlow;
/// use varda_assimilation::*;
/// use varda_covariance::{BlockDiagonal, Diagonal};
/// # use varda_implicit::{ParametricRhs, Rhs, RhsWithParameters, Rk4};
/// # #[derive(Clone)]
/// # struct Decay(f64);
/// # impl Rhs for Decay {
/// #     fn dim(&self) -> usize { 1 }
/// #     fn eval(&mut self, _: f64, x: &[f64], f: &mut [f64]) { f[0] = -self.0 * x[0]; }
/// #     fn tangent(&mut self, _: f64, _: &[f64], dx: &[f64], df: &mut [f64]) { df[0] = -self.0 * dx[0]; }
/// #     fn adjoint_add(&mut self, _: f64, _: &[f64], l: &[f64], dx: &mut [f64]) { dx[0] -= self.0 * l[0]; }
/// # }
/// # impl ParametricRhs for Decay {
/// #     fn parameters(&self) -> usize { 1 }
/// #     fn set_parameters(&mut self, p: &[f64]) { self.0 = p[0]; }
/// #     fn parameter_jacobian(&mut self, _: f64, x: &[f64], columns: &mut [f64]) { columns[0] = -x[0]; }
/// # }
///
/// // control [x₀, p]; `Decay` is the right-hand side of the guide page "estimates"
/// let b = BlockDiagonal::new(vec![Diagonal::uniform(1, 0.5)?, Diagonal::uniform(1, 0.3)?]);
/// let transform = ControlTransform::new(vec![1.0, 0.5], &b)?;
/// let run = |start: f64| -> Result<_, Error> {
///     let value = |k: usize| start * (-0.4 * k as f64).exp();
///     let seen = (1..5).map(|k| Observation::new(5 * k, vec![0], vec![value(k)], 0.01));
///     ObservationSet::new(20, vec![Box::new(Selection::new(vec![0], 2)?)], seen.collect())
/// };
/// let mut models = [0, 1].map(|_| Rk4::new(RhsWithParameters::new(Decay(0.0), 0), 0, 0.1));
/// let mut sets = [run(1.3)?, run(0.8)?];
/// let mut costs = Vec::new();
/// for (model, set) in models.iter_mut().zip(&mut sets) {
///     costs.push(StrongConstraint::new(model, transform.clone(), set)?);
/// }
/// // unknown 1 of both is the rate
/// let parts = costs.iter_mut().map(|cost| cost as &mut dyn LeastSquares).collect();
/// let mut joint = Joint::new(parts, &[vec![1], vec![1]])?;
/// let mut v = vec![0.0; joint.dim()];
/// Minimizer::default().minimize(&mut joint, &mut v, &mut |_| ControlFlow::Continue(()))?;
/// let sigma = Posterior::new(&mut joint)?.marginal(joint.places(0))?.variance(&transform)[1].sqrt();
/// let rate = 0.5 + 0.3 * v[2]; // [x₀ of the first, x₀ of the second, p]
/// assert!((rate - 0.8).abs() < 3.0 * sigma && sigma < 0.02);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Joint<'a> {
    parts: Vec<Part<'a>>,
    dim: usize,
    shared: usize,
    terms: CostTerms,
}

/// One of the costs.
struct Part<'a> {
    cost: &'a mut (dyn LeastSquares + 'a),
    /// Where each of its unknowns stands among those of the joint cost.
    places: Vec<usize>,
    /// Its unknowns at the last evaluation.
    v: Vec<f64>,
    /// A direction, and what comes of it.
    dv: Vec<f64>,
    out: Vec<f64>,
    /// How many values are observed.
    observed: usize,
}

impl Part<'_> {
    fn scatter_add(&self, out: &mut [f64]) {
        self.out.iter().zip(&self.places).for_each(|(own, at)| out[*at] += own);
    }
}

fn gather(places: &[usize], v: &[f64], own: &mut [f64]) {
    own.iter_mut().zip(places).for_each(|(own, at)| *own = v[*at]);
}

impl<'a> Joint<'a> {
    /// Joins costs: `shared` has, for each of them, which of its unknowns are shared, in one order.
    ///
    /// # Errors
    /// No costs at all, lists of unlike length, an unknown that does not exist or is named twice; a cost with
    /// errors of the model, or not in whitened variables.
    pub fn new(costs: Vec<&'a mut (dyn LeastSquares + 'a)>, shared: &[Vec<usize>]) -> Result<Self, Error> {
        let (count, width) = (costs.len(), shared.first().map_or(0, Vec::len));
        if count == 0 {
            return Err(Error::Setting { what: "the number of costs that are joined", value: 0.0 });
        }
        if shared.len() != count {
            let what = "the list of shared unknowns";
            return Err(Error::Length { what, expected: count, found: shared.len() });
        }
        let own: usize = costs.iter().map(|cost| cost.dim().saturating_sub(width)).sum();
        let (mut parts, mut next) = (Vec::new(), 0);
        for (cost, shared) in costs.into_iter().zip(shared) {
            let n = cost.dim();
            let length = |what, expected, found| Err(Error::Length { what, expected, found });
            if shared.len() != width {
                return length("a list of shared unknowns", width, shared.len());
            }
            if cost.background_dim() != n {
                return length("the background of a cost that is joined", n, cost.background_dim());
            }
            if !cost.is_whitened() {
                return Err(Error::NotWhitened { minimizer: "a joint cost" });
            }
            let mut places = vec![usize::MAX; n];
            for (i, at) in shared.iter().enumerate() {
                match places.get_mut(*at) {
                    Some(place @ &mut usize::MAX) => *place = own + i,
                    _ => return Err(Error::Setting { what: "a shared unknown", value: *at as f64 }),
                }
            }
            for place in places.iter_mut().filter(|place| **place == usize::MAX) {
                *place = next;
                next += 1;
            }
            let observed = cost.observation_dim();
            let [v, dv, out] = std::array::from_fn(|_| vec![0.0; n]);
            parts.push(Part { cost, places, v, dv, out, observed });
        }
        Ok(Self { parts, dim: own + width, shared: width, terms: CostTerms::default() })
    }

    /// Where each unknown of cost r stands among those of the joint cost.
    ///
    /// # Panics
    /// If there is no such cost.
    pub fn places(&self, r: usize) -> &[usize] {
        &self.parts[r].places
    }

    /// J of cost r at the last evaluation, without the prior of the shared unknowns: what the parts of J are,
    /// ½‖v_p‖² beside.
    ///
    /// # Panics
    /// If there is no such cost.
    pub fn terms_of(&self, r: usize) -> CostTerms {
        let (part, first) = (&self.parts[r], self.dim - self.shared);
        let of_shared = |(v, at): (&f64, &usize)| if *at < first { 0.0 } else { 0.5 * v * v };
        let prior: f64 = part.v.iter().zip(&part.places).map(of_shared).sum();
        let terms = part.cost.terms();
        CostTerms { background: terms.background - prior, ..terms }
    }

    /// How many times too often the sum of costs has the prior of what is shared.
    fn surplus(&self) -> f64 {
        (self.parts.len() - 1) as f64
    }

    /// out ← out − (R − 1) v of the shared unknowns.
    fn take_surplus(&self, v: &[f64], out: &mut [f64]) {
        let (surplus, first) = (self.surplus(), self.dim - self.shared);
        out[first..].iter_mut().zip(&v[first..]).for_each(|(out, v)| *out -= surplus * v);
    }

    /// out = Σ E_r (P_r E_rᵀ dv) − (R − 1) dv of what is shared, for a product P_r of every cost.
    fn product(
        &mut self,
        dv: &[f64],
        out: &mut [f64],
        of: fn(&mut (dyn LeastSquares + '_), &[f64], &mut [f64]) -> Result<(), Error>,
    ) -> Result<(), Error> {
        assert_eq!((dv.len(), out.len()), (self.dim, self.dim), "length of a direction");
        out.fill(0.0);
        for part in &mut self.parts {
            gather(&part.places, dv, &mut part.dv);
            of(&mut *part.cost, &part.dv, &mut part.out)?;
            part.scatter_add(out);
        }
        self.take_surplus(dv, out);
        Ok(())
    }

    /// A symmetric matrix from those of the costs.
    fn matrix(
        &mut self,
        out: &mut [f64],
        of: fn(&mut (dyn LeastSquares + '_), &mut [f64]) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let (n, first) = (self.dim, self.dim - self.shared);
        assert_eq!(out.len(), n * n, "length of the Hessian");
        out.fill(0.0);
        for part in &mut self.parts {
            let own = part.places.len();
            let mut block = vec![0.0; own * own];
            of(&mut *part.cost, &mut block)?;
            for (column, j) in block.chunks_exact(own.max(1)).zip(&part.places) {
                column.iter().zip(&part.places).for_each(|(a, i)| out[i + j * n] += a);
            }
        }
        let surplus = self.surplus();
        (first..n).for_each(|i| out[i + i * n] -= surplus);
        Ok(())
    }
}

/// J of a cost at v, and its gradient.
type WithGradient = fn(&mut (dyn LeastSquares + '_), &[f64], &mut [f64]) -> Result<f64, Error>;

impl Joint<'_> {
    /// J at v, and its gradient from those of the costs.
    fn at(&mut self, v: &[f64], gradient: Option<(&mut [f64], WithGradient)>) -> Result<f64, Error> {
        assert_eq!(v.len(), self.dim, "length of v");
        self.parts.iter_mut().for_each(|part| gather(&part.places, v, &mut part.v));
        let mut terms = CostTerms::default();
        // with gradients asked for one by one a cost that fails would leave others at another point
        let runs_first = gradient.is_none() || self.parts.len() > 1;
        for part in self.parts.iter_mut().filter(|_| runs_first) {
            part.cost.evaluate(&part.v, None)?;
        }
        if let Some((gradient, of)) = gradient {
            assert_eq!(gradient.len(), self.dim, "length of the gradient");
            gradient.fill(0.0);
            for part in &mut self.parts {
                of(&mut *part.cost, &part.v, &mut part.out)?;
                part.scatter_add(gradient);
            }
            self.take_surplus(v, gradient);
        }
        for part in &self.parts {
            let of_part = part.cost.terms();
            terms.background += of_part.background;
            terms.observation += of_part.observation;
            terms.model_error += of_part.model_error;
        }
        let shared = &v[self.dim - self.shared..];
        terms.background -= 0.5 * self.surplus() * dot(shared, shared);
        self.terms = terms;
        Ok(terms.total())
    }
}

impl CostFunction for Joint<'_> {
    fn dim(&self) -> usize {
        self.dim
    }

    fn evaluate(&mut self, v: &[f64], gradient: Option<&mut [f64]>) -> Result<f64, Error> {
        let of: WithGradient = |cost, v, gradient| cost.evaluate(v, Some(gradient));
        self.at(v, gradient.map(|gradient| (gradient, of)))
    }

    fn terms(&self) -> CostTerms {
        self.terms
    }

    fn set_observation_scale(&mut self, scale: f64) {
        self.parts.iter_mut().for_each(|part| part.cost.set_observation_scale(scale));
    }

    /// The sums of the costs' work: one evaluation is a forward run of each.
    fn counts(&self) -> Counts {
        self.parts.iter().map(|part| part.cost.counts()).fold(Counts::default(), Counts::add)
    }
}

impl LeastSquares for Joint<'_> {
    fn observation_dim(&self) -> usize {
        self.parts.iter().map(|part| part.observed).sum()
    }

    fn background_dim(&self) -> usize {
        self.dim
    }

    fn linearize(&mut self, v: &[f64], gradient: &mut [f64]) -> Result<f64, Error> {
        // costs that are no sums of squares refuse
        self.at(v, Some((gradient, |cost, v, gradient| cost.linearize(v, gradient))))
    }

    fn departures(&self, b: &mut [f64], d: &mut [f64]) {
        let mut rest = d;
        for part in &self.parts {
            let (here, after) = rest.split_at_mut(part.observed);
            let mut own = vec![0.0; part.places.len()];
            part.cost.departures(&mut own, here);
            own.iter().zip(&part.places).for_each(|(own, at)| b[*at] = *own);
            rest = after;
        }
    }

    fn jacobian(&mut self, p: &[f64], dy: &mut [f64]) -> Result<(), Error> {
        let mut rest = dy;
        for part in &mut self.parts {
            let (here, after) = rest.split_at_mut(part.observed);
            gather(&part.places, p, &mut part.dv);
            part.cost.jacobian(&part.dv, here)?;
            rest = after;
        }
        Ok(())
    }

    fn jacobian_transpose(&mut self, dy: &[f64], p: &mut [f64]) -> Result<(), Error> {
        assert_eq!(dy.len(), self.observation_dim(), "length of dy");
        p.fill(0.0);
        let mut rest = dy;
        for part in &mut self.parts {
            let (here, after) = rest.split_at(part.observed);
            part.cost.jacobian_transpose(here, &mut part.out)?;
            part.scatter_add(p);
            rest = after;
        }
        Ok(())
    }

    fn hessian_apply(&mut self, p: &[f64], out: &mut [f64]) -> Result<(), Error> {
        self.product(p, out, |cost, p, out| cost.hessian_apply(p, out))
    }

    fn hessian(&mut self, out: &mut [f64]) -> Result<(), Error> {
        self.matrix(out, |cost, out| cost.hessian(out))
    }

    fn has_exact_hessian(&mut self) -> bool {
        self.parts.iter_mut().all(|part| part.cost.has_exact_hessian())
    }

    fn exact_hessian_apply(&mut self, p: &[f64], out: &mut [f64]) -> Result<(), Error> {
        self.product(p, out, |cost, p, out| cost.exact_hessian_apply(p, out))
    }

    fn exact_hessian(&mut self, out: &mut [f64]) -> Result<(), Error> {
        self.matrix(out, |cost, out| cost.exact_hessian(out))
    }

    fn dense_jacobian(&mut self, out: &mut [f64]) -> Result<(), Error> {
        let m = self.observation_dim();
        assert_eq!(out.len(), m * self.dim, "length of G");
        out.fill(0.0);
        let mut row = 0;
        for part in &mut self.parts {
            let mut block = vec![0.0; part.observed * part.places.len()];
            part.cost.dense_jacobian(&mut block)?;
            for (column, j) in block.chunks_exact(part.observed.max(1)).zip(&part.places) {
                out[row + j * m..][..part.observed].copy_from_slice(column);
            }
            row += part.observed;
        }
        Ok(())
    }
}
