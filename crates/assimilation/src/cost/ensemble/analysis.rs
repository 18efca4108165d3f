//! From the linearized ensemble to the analysis: exact solves, outer iterations, the posterior ensemble.

use super::EnVar;
use crate::cost::{CostFunction, CostTerms, dot, norm};
use crate::cycle_members::{finite_size_inflation, localized_inflation};
use crate::minimize::{NOISE, at_least_one, eigen, setters};
use crate::{Error, Iteration, Minimum, Status};
use std::ops::ControlFlow;
use varda_linalg::{Svd, interrupt};

/// Settings of [`EnVar::minimize`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct EnVarOptions {
    /// Linearizations at most; 1 is 4D-EnVar proper, more the iterative ensemble smoother.
    pub max_outer: usize,
    /// Converged when a step ‖Δv‖ (in standard deviations of the prior) is at most this.
    pub step_tolerance: f64,
}

impl Default for EnVarOptions {
    fn default() -> Self {
        Self { max_outer: 10, step_tolerance: 1e-3 }
    }
}

setters!(EnVarOptions {
    with_max_outer: max_outer: usize,
    with_step_tolerance: step_tolerance: f64,
});

/// How the perturbations of an ensemble are brought from the prior to the posterior.
pub enum EnsembleUpdate<'u> {
    /// x_i ← x_i − U Gᵀ φ(GGᵀ) Y_i, φ(λ) = 1 / (√(1+λ) (√(1+λ) + 1)): deterministic. Without
    /// localization this is the symmetric square root X (I + GᵀG)^{-1/2} of Bocquet and Sakov (2014), with
    /// it the modified gain of Bishop, Whitaker and Lei (2017).
    SquareRoot,
    /// x_i ← x_i + U Gᵀ (I + GGᵀ)⁻¹ (ε_i − Y_i): an ensemble of assimilations, each with its own
    /// perturbed observations. The closure draws standard normals; the perturbations are centred over the
    /// members.
    PerturbedObservations(&'u mut dyn FnMut() -> f64),
}

/// The way from a point to the minimum of the quadratic J about it.
struct Way {
    /// J at the point.
    value: f64,
    /// By how much the quadratic J is lower at its minimum.
    promised: f64,
    /// ‖Δv‖.
    size: f64,
}

/// A part of such a way that was taken.
struct Step {
    size: f64,
    /// J of the run from its end.
    terms: CostTerms,
    is_whole: bool,
    /// Longer parts after which J was higher, or the model failed.
    rejected: usize,
}

/// A problem is linear where J of the run differs from that of the quadratic by no more than this part of
/// the decrease: small differences between members leave 10⁻⁸ of it to rounding.
const LINEAR: f64 = 1e-6;

/// Eigenpairs of GGᵀ or of GᵀG, whichever is smaller.
struct Gram {
    dual: bool,
    values: Vec<f64>,
    vectors: Vec<f64>,
}

impl EnVar<'_> {
    /// Gauss–Newton with exact solves: linearize, go to the minimum of the quadratic J, until a step
    /// ‖Δv‖ is at most τ = `step_tolerance`. Starts from `v`, and leaves the analysis in it.
    ///
    /// Every step is judged by a forward run of the control, the last one too: `value` and `terms` are J of
    /// the run from the point left in `v`, never that of the quadratic. A step after which J is higher is
    /// halved, so that `v` is the lowest point found. The gradient is that of the last quadratic.
    ///
    /// | status | when |
    /// |---|---|
    /// | `Converged` | a whole step is at most τ and does not raise J by more than J resolves |
    /// | `Converged` | `max_outer` = 1, and J of the run is that of the quadratic: the problem is linear |
    /// | `LinearizedOnce` | `max_outer` = 1, and they differ |
    /// | `MaxIterations` | `max_outer` > 1 linearizations were not enough |
    /// | `Stalled` | no part of a step lowers J: the members, or their localization, give no descent |
    ///
    /// J resolves ½τ², by which a shift of τ standard deviations of the analysis changes it, and
    /// 10⁻¹¹ of itself. A last step that raises it by less is not taken.
    ///
    /// # Errors
    /// A first point at which the model fails, `max_outer` = 0, an eigenvalue iteration that fails. A step on
    /// which the model fails however short ends the run as `Stalled`.
    ///
    /// # Panics
    /// If `v` is not of length `dim`.
    pub fn minimize(
        &mut self,
        v: &mut [f64],
        options: &EnVarOptions,
        on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
    ) -> Result<Minimum, Error> {
        at_least_one("max_outer", options.max_outer)?;
        if self.base.v != v {
            self.relinearize(v)?;
        }
        let n = self.dim();
        let (mut target, mut gradient) = (vec![0.0; n], vec![0.0; n]);
        let mut step = Step { size: 0.0, terms: CostTerms::default(), is_whole: true, rejected: 0 };
        let (mut first, mut outer, mut failure) = (f64::NAN, 0, None);
        let status = loop {
            // Where it is linearized, the quadratic J is that of the run.
            let value = self.evaluate(v, Some(&mut gradient))?;
            step.terms = self.terms;
            let gradient_norm = norm(&gradient);
            if outer == 0 {
                first = gradient_norm;
            }
            let flow = on_iteration(&Iteration {
                index: outer,
                value,
                terms: step.terms,
                gradient_norm,
                step_norm: step.size,
                damping: 0.0,
                rejected: step.rejected,
                inner_iterations: 0,
                hessian: None,
                observation_scale: self.scale,
                gradient_goal: 0.0,
                attempt: 1,
                attempts: 1,
                counts: self.counts(),
                v,
            });
            if flow.is_break() {
                break Status::Interrupted;
            }
            self.solve(&mut target)?;
            outer += 1;
            let way = Way {
                value,
                promised: value - self.evaluate(&target, None)?,
                size: target.iter().zip(&*v).map(|(t, v)| (t - v) * (t - v)).sum::<f64>().sqrt(),
            };
            let is_small = way.size <= options.step_tolerance || way.promised <= NOISE * value;
            if is_small {
                let resolved = (0.5 * options.step_tolerance.powi(2)).max(NOISE * value);
                match self.nonlinear_terms(&target) {
                    Ok(terms) if terms.total() <= value => {
                        v.copy_from_slice(&target);
                        step.terms = terms;
                        break Status::Converged;
                    }
                    Ok(terms) if terms.total() - value <= resolved => break Status::Converged,
                    Ok(_) => {}
                    Err(error) => failure = Some(error),
                }
            }
            let is_last = outer == options.max_outer;
            match self.descend(v, &target, &way, !is_last, &mut failure) {
                None => break Status::Stalled,
                Some(taken) => step = taken,
            }
            if is_last {
                let differs = (step.terms.total() - (value - way.promised)).abs();
                let is_linear = step.is_whole && differs <= LINEAR * way.promised;
                break match options.max_outer {
                    1 if is_linear => Status::Converged,
                    1 => Status::LinearizedOnce,
                    _ => Status::MaxIterations,
                };
            }
        };
        self.evaluate(v, Some(&mut gradient))?;
        self.terms = step.terms;
        Ok(Minimum {
            value: step.terms.total(),
            terms: step.terms,
            gradient_norm_first: first,
            gradient_norm: norm(&gradient),
            outer_iterations: outer,
            inner_iterations: 0,
            status,
            failure: failure.filter(|_| status == Status::Stalled),
            ritz: Vec::new(),
            inverse_hessian: None,
            started_beside: false,
            quadratic: false,
            attempts: Vec::new(),
        })
    }

    /// Takes v to `target`, or halving to a point before it, where J of the run is no higher, and where the
    /// members can be run about it if that is asked for. `None`, and v as it was, where the decrease that the
    /// quadratic promises falls below the noise of J first.
    fn descend(
        &mut self,
        v: &mut [f64],
        target: &[f64],
        way: &Way,
        relinearize: bool,
        failure: &mut Option<Error>,
    ) -> Option<Step> {
        let start = v.to_vec();
        let (mut length, mut rejected) = (1.0, 0);
        while length * (2.0 - length) * way.promised > NOISE * way.value {
            v.iter_mut().zip(start.iter().zip(target)).for_each(|(v, (s, t))| *v = s + length * (t - s));
            let terms = self.nonlinear_terms(v).and_then(|terms| {
                let lower = terms.total() <= way.value;
                if lower && relinearize {
                    self.relinearize(v)?;
                }
                Ok(lower.then_some(terms))
            });
            match terms {
                Ok(Some(terms)) => {
                    return Some(Step { size: length * way.size, terms, is_whole: rejected == 0, rejected });
                }
                Ok(None) => {}
                Err(error) => *failure = Some(error),
            }
            rejected += 1;
            length *= 0.5;
        }
        v.copy_from_slice(&start);
        None
    }

    /// v = argmin J: Gᵀ (I + GGᵀ)⁻¹ (d₀ + G v₀), by an eigenvalue decomposition of the smaller of
    /// GGᵀ and GᵀG.
    ///
    /// # Errors
    /// An eigenvalue iteration that fails.
    ///
    /// # Panics
    /// If `v` is not of length `dim`.
    pub fn solve(&mut self, v: &mut [f64]) -> Result<(), Error> {
        let gram = self.gram()?;
        let mut w = vec![0.0; self.observations.dim()];
        self.forward(&self.base.v, &mut w);
        w.iter_mut().zip(&self.base.d).for_each(|(w, d)| *w += d / self.scale);
        self.gain(&gram, |lambda| 1.0 / (1.0 + lambda), &w, v);
        Ok(())
    }

    /// The perturbations of the posterior ensemble in the control z, scaled as the columns of X, one after
    /// the other: their sample covariance stands for U (I + GᵀG)⁻¹ Uᵀ at the last linearization.
    ///
    /// # Errors
    /// An eigenvalue iteration that fails.
    pub fn posterior_perturbations(&mut self, update: &mut EnsembleUpdate) -> Result<Vec<f64>, Error> {
        let (n_z, m, members) =
            (self.transform.control_dim(), self.observations.dim(), self.ensemble.members());
        let gram = self.gram()?;
        let size = ((members - 1).max(1) as f64).sqrt();
        let mut whitened: Vec<f64> = self.base.y.iter().map(|y| -y / self.scale).collect();
        self.observations.whiten_rows(members, &mut whitened);
        if let EnsembleUpdate::PerturbedObservations(normal) = &mut *update {
            let noise: Vec<f64> = (0..members * m).map(|_| normal() / size).collect();
            for a in 0..m {
                let mean = (0..members).map(|i| noise[i * m + a]).sum::<f64>() / members as f64;
                (0..members).for_each(|i| whitened[a * members + i] += noise[i * m + a] - mean);
            }
        }
        let phi = |lambda: f64| match update {
            EnsembleUpdate::SquareRoot => 1.0 / ((1.0 + lambda).sqrt() * ((1.0 + lambda).sqrt() + 1.0)),
            EnsembleUpdate::PerturbedObservations(_) => 1.0 / (1.0 + lambda),
        };
        let mut columns = vec![0.0; members * n_z];
        let (mut w, mut v, mut dz) = (vec![0.0; m], vec![0.0; self.dim()], vec![0.0; n_z]);
        for (i, column) in columns.chunks_exact_mut(n_z).enumerate() {
            (0..m).for_each(|a| w[a] = whitened[a * members + i]);
            self.gain(&gram, phi, &w, &mut v);
            self.transform.tangent(&v, &mut dz);
            self.ensemble.perturbation(i, column);
            column.iter_mut().zip(&dz).for_each(|(x, dz)| *x += dz);
        }
        Ok(columns)
    }

    /// Variances of the control z, the diagonal of U (I + GᵀG)⁻¹ Uᵀ at the last linearization, and the
    /// degrees of freedom for signal, tr GGᵀ(I + GGᵀ)⁻¹. Exact for the localized or hybrid covariance
    /// U Uᵀ, where the sample covariance of [`posterior_perturbations`](Self::posterior_perturbations) is
    /// that of the members. No model is run.
    ///
    /// # Errors
    /// An eigenvalue iteration that fails.
    pub fn posterior_variance(&self) -> Result<(Vec<f64>, f64), Error> {
        let (n, m) = (self.dim(), self.observations.dim());
        // GGᵀ takes least memory, and is as good where its rounding is far below the smallest variance.
        let gram = if m < n { Some(self.gram()?) } else { None };
        let resolved = |g: &Gram| {
            let largest = g.values.last().copied().unwrap_or(0.0);
            g.values.len() as f64 * f64::EPSILON * largest <= 1e-6
        };
        let Some(gram) = gram.filter(resolved) else { return self.posterior_variance_by_g() };
        let (mut w, size) = (vec![0.0; m], gram.values.len());
        let variance = self.over_components(&mut |u| {
            self.forward(u, &mut w);
            let pairs = gram.vectors.chunks_exact(size.max(1)).zip(&gram.values);
            let seen: f64 = pairs.map(|(z, lambda)| dot(z, &w).powi(2) / (1.0 + lambda)).sum();
            dot(u, u) - seen
        });
        Ok((variance, gram.values.iter().map(|lambda| lambda / (1.0 + lambda)).sum()))
    }

    /// `posterior_variance` by the singular values of G: of u = Uᵀ e_p what nothing sees,
    /// and the rest over μ.
    fn posterior_variance_by_g(&self) -> Result<(Vec<f64>, f64), Error> {
        let (n, m) = (self.dim(), self.observations.dim());
        let Svd { values, right, .. } = Svd::thin(m, n, &self.jacobian())?;
        let mut rest = vec![0.0; n];
        let variance = self.over_components(&mut |u| {
            rest.copy_from_slice(u);
            let mut sum = 0.0;
            for (z, s) in right.chunks_exact(n.max(1)).zip(&values) {
                let c = dot(z, u);
                rest.iter_mut().zip(z).for_each(|(r, z)| *r -= c * z);
                sum += c * c / (1.0 + s * s);
            }
            sum + dot(&rest, &rest)
        });
        Ok((variance, values.iter().map(|s| s * s / (1.0 + s * s)).sum()))
    }

    /// f(Uᵀ e_p) for every component p of the control.
    fn over_components(&self, f: &mut dyn FnMut(&[f64]) -> f64) -> Vec<f64> {
        let n_z = self.transform.control_dim();
        let (mut unit, mut u) = (vec![0.0; n_z], vec![0.0; self.dim()]);
        let of = |p: usize| {
            if interrupt::requested() {
                // what comes of it is not looked at
                return f64::NAN;
            }
            unit[p] = 1.0;
            self.transform.adjoint(&unit, &mut u);
            unit[p] = 0.0;
            f(&u)
        };
        (0..n_z).map(of).collect()
    }

    /// The factor on the deviations of the members that a finite number of them asks for, at the last
    /// linearization: see `finite_size_inflation`, and with localization `localized_inflation`.
    pub(crate) fn finite_size_inflation(&self) -> Result<f64, Error> {
        let gram = self.gram()?;
        let mut along = self.base.d.clone();
        if !gram.dual {
            // c = uᵀd = vᵀGᵀd / √λ
            let mut right = vec![0.0; self.dim()];
            self.transpose(&self.base.d, &mut right);
            along = right;
        }
        let size = gram.values.len().max(1);
        let pairs = gram.vectors.chunks_exact(size).zip(&gram.values).map(|(z, lambda)| {
            let c = dot(z, &along);
            let unseen = !gram.dual && *lambda <= f64::EPSILON;
            let c = if gram.dual { c } else { c / lambda.sqrt() };
            (*lambda, if unseen { 0.0 } else { c })
        });
        if self.ensemble.localization().rank() > 1 {
            return Ok(localized_inflation(self.ensemble.members(), pairs));
        }
        Ok(finite_size_inflation(self.ensemble.members(), pairs))
    }

    /// tr G Gᵀ at the last linearization, with σ of the observations as they are.
    pub(crate) fn predicted_trace(&self) -> f64 {
        if self.observations.is_correlated() {
            return self.jacobian().iter().map(|g| (g * self.scale).powi(2)).sum();
        }
        let (members, r_s) = (self.ensemble.members(), self.static_dim());
        let w_s = self.static_part.map_or(0.0, |(_, weight)| weight * weight);
        let w_e = self.ensemble_weight * self.ensemble_weight;
        let localization = self.ensemble.localization();
        let of_row = |a: usize| {
            let (y, rho) = (&self.base.y[a * members..][..members], localization.row(self.anchors[a]));
            let g = &self.base.g_static[a * r_s..][..r_s];
            w_e * dot(rho, rho) * dot(y, y) + w_s * dot(g, g)
        };
        (0..self.observations.dim()).map(of_row).sum()
    }

    fn gram(&self) -> Result<Gram, Error> {
        let (n, m) = (self.dim(), self.observations.dim());
        if m == 0 {
            return Ok(Gram { dual: true, values: Vec::new(), vectors: Vec::new() });
        }
        let dual = m <= n;
        let size = m.min(n);
        let mut matrix = vec![0.0; size * size];
        if dual {
            // β_s² G_s G_sᵀ + β_e² (Y Yᵀ) ∘ (ρ ρᵀ): the Schur product in observation space.
            let (members, r_s) = (self.ensemble.members(), self.static_dim());
            let w_s = self.static_part.map_or(0.0, |(_, weight)| weight * weight);
            let w_e = self.ensemble_weight * self.ensemble_weight;
            let localization = self.ensemble.localization();
            let y = |a: usize| &self.base.y[a * members..][..members];
            let g = |a: usize| &self.base.g_static[a * r_s..][..r_s];
            for a in 0..m {
                if interrupt::requested() {
                    return Err(varda_linalg::Error::Interrupted.into());
                }
                for b in 0..=a {
                    let c = dot(localization.row(self.anchors[a]), localization.row(self.anchors[b]));
                    let value = w_e * c * dot(y(a), y(b)) + w_s * dot(g(a), g(b));
                    matrix[a + b * m] = value / (self.scale * self.scale);
                    matrix[b + a * m] = matrix[a + b * m];
                }
            }
            if self.observations.is_correlated() {
                self.observations.whiten_rows(m, &mut matrix);
                matrix.chunks_exact_mut(m).for_each(|row| self.observations.whiten_blocks(row));
            }
        } else {
            self.normal_matrix(&mut matrix);
        }
        let (mut values, vectors) = eigen(size, &matrix)?;
        values.iter_mut().for_each(|lambda| *lambda = lambda.max(0.0));
        Ok(Gram { dual, values, vectors })
    }

    /// v = Gᵀ φ(GGᵀ) w = φ(GᵀG) Gᵀ w.
    fn gain(&self, gram: &Gram, phi: impl Fn(f64) -> f64, w: &[f64], v: &mut [f64]) {
        let mut right = if gram.dual { w.to_vec() } else { vec![0.0; self.dim()] };
        if !gram.dual {
            self.transpose(w, &mut right);
        }
        let mut filtered = vec![0.0; right.len()];
        for (z, lambda) in gram.vectors.chunks_exact(right.len().max(1)).zip(&gram.values) {
            let c = phi(*lambda) * dot(z, &right);
            filtered.iter_mut().zip(z).for_each(|(f, z)| *f += c * z);
        }
        if gram.dual {
            self.transpose(&filtered, v);
        } else {
            v.copy_from_slice(&filtered);
        }
    }
}
