//! Products with the exact Hessian of a window: the second-order adjoint.

use std::ops::Range;

use super::exact_work::Exact;
use super::model_error::WeakControl;
use super::{CostFunction, Counts, StrongConstraint};
use crate::Error;
use crate::ranks::{self, Ranks};
use varda_implicit::Storage;

impl StrongConstraint<'_> {
    /// Whether model and operators have second derivatives; not where v is states.
    pub(super) fn has_second_derivatives(&mut self) -> bool {
        let states = self.errors.as_ref().is_some_and(|e| matches!(e.over, WeakControl::States { .. }));
        let model = self.model.as_mut().is_none_or(|model| model.second_order().is_some());
        model && !states && self.observations.has_second_derivatives()
    }

    /// The products with all unit vectors, one after the other, which processes share.
    pub(super) fn exact_columns(&mut self, out: &mut [f64]) -> Result<(), Error> {
        let n = self.dim();
        match ranks::for_numbers(n * self.last * self.state_dim) {
            // what is found with the first column is there for the others, on every process
            Some(ranks) => {
                let (first, others) = out.split_at_mut(n);
                self.exact_products(0..1, first)?;
                self.exact_columns_divided(&*ranks, others)
            }
            None => self.exact_products(0..n, out),
        }
    }

    /// All columns but the first: those of this process, and what the others gather. Where one of them has
    /// failed each does all of them, and fails in the same way.
    fn exact_columns_divided(&mut self, ranks: &dyn Ranks, others: &mut [f64]) -> Result<(), Error> {
        let n = self.dim();
        let share = |rank: usize| ranks::share(n - 1, rank, ranks.count());
        let before = self.counts();
        let mut mine = vec![0.0; share(ranks.rank()).len() * n];
        let own = share(ranks.rank());
        let done = self.exact_products(own.start + 1..own.end + 1, &mut mine);
        let work = (self.counts() - before).numbers().map(|number| number as f64);
        let message = [f64::from(u8::from(done.is_ok()))].into_iter().chain(work).chain(mine);
        let all = ranks.all_gather(&self.linearized_at(), &message.collect::<Vec<f64>>());
        let (mut rest, mut everyone, mut elsewhere) = (&all[..], true, Counts::default());
        for rank in 0..ranks.count() {
            let (head, columns) = rest.split_at(1 + Counts::LENGTH);
            let of_rank = share(rank).start * n..share(rank).end * n;
            let (columns, next) = columns.split_at(of_rank.len());
            others[of_rank].copy_from_slice(columns);
            everyone = everyone && head[0] == 1.0;
            if rank != ranks.rank() {
                let mut numbers = head[1..].iter().map(|number| *number as usize);
                elsewhere = elsewhere + Counts::of(|| numbers.next().unwrap_or(0));
            }
            rest = next;
        }
        if !everyone {
            return self.exact_products(1..n, others);
        }
        self.count_elsewhere(elsewhere);
        Ok(())
    }

    /// Adds work that another process has done in this one's place.
    fn count_elsewhere(&mut self, done: Counts) {
        self.log.counts = self.log.counts + done.model;
        self.counts = self.counts + Counts { model: varda_implicit::Counts::default(), ..done };
        if let Some(model) = &mut self.model {
            model.count_elsewhere(done.model);
        }
    }

    /// The products with some unit vectors.
    fn exact_products(&mut self, units: Range<usize>, out: &mut [f64]) -> Result<(), Error> {
        let n = self.dim();
        let mut unit = vec![0.0; n];
        for (j, column) in units.zip(out.chunks_exact_mut(n.max(1))) {
            unit[j] = 1.0;
            self.exact_product(&unit, column)?;
            unit[j] = 0.0;
        }
        Ok(())
    }

    /// out = ∇²J dv at the base point:
    ///
    /// ```text
    ///     dx_{k+1} = M_k dx_k
    ///     λ̇_k = M_kᵀ λ̇_{k+1} + Σ_i λ_{k+1,i} ∂²M_{k,i} dx_k
    ///           + H_kᵀ R_k⁻¹ H_k dx_k − Σ_j (R_k⁻¹ d_k)_j ∂²H_{k,j} dx_k
    /// ```
    ///
    /// Memory: the path dx_k, and where all linearizations are kept λ_k with it.
    pub(super) fn exact_product(&mut self, dv: &[f64], out: &mut [f64]) -> Result<(), Error> {
        if !self.has_second_derivatives() {
            return Err(Error::NoSecondDerivatives);
        }
        self.return_to_base()?;
        let mut exact = std::mem::take(&mut self.exact);
        let done = self.exact_sweeps(&mut exact, dv, out);
        self.exact = exact;
        done
    }

    fn exact_sweeps(&mut self, exact: &mut Exact, dv: &[f64], out: &mut [f64]) -> Result<(), Error> {
        self.tangent_path(exact, dv)?;
        self.whiten(&mut exact.dy);
        self.whiten_transpose(&mut exact.dy);
        self.counts.exact_sweeps += 1;

        let n = self.state_dim;
        let keeps_all = self.base.trajectory.storage() == Storage::KeepAll;
        let Self { model, transform, observations, errors, base, lambda, last, .. } = self;
        let Exact { slope, lambdas, known, path, moved, derivative, dy, dz } = exact;
        let moved = moved.as_ref().expect("made by the sweep before");
        let (out, forcing) = out.split_at_mut(transform.dim());
        forcing.fill(0.0);
        derivative.resize(n, 0.0);
        derivative.fill(0.0);
        lambda.fill(0.0);
        lambdas.resize(if keeps_all { (*last + 1) * n } else { 0 }, 0.0);
        let predicted = &base.predicted;
        // adds what state k is forced by, to λ where it is not known, and to its derivative
        let mut force = |k: usize, x: &[f64], lambda: &mut [f64], derivative: &mut [f64], known: bool| {
            let dx = &path[k * n..(k + 1) * n];
            if !known {
                observations.adjoint_add(k, x, slope, predicted, lambda);
            }
            observations.adjoint_add(k, x, dy, predicted, derivative);
            observations.second_adjoint_add(k, [x, dx], slope, [predicted, moved], derivative);
            if let (Some(errors), Some(before)) = (&mut *errors, k.checked_sub(1)) {
                errors.adjoint_add(before, derivative, forcing);
            }
        };
        match model {
            Some(model) => {
                let (mut failure, was_known, last) = (None, *known, *last);
                let mut act = |step: &mut varda_implicit::LinearizedStep<'_>| {
                    let (k, after) = (step.k, (step.k + 1) * n..(step.k + 2) * n);
                    if k + 1 == last {
                        force(last, step.x_next, lambda, derivative, was_known);
                    }
                    if failure.is_some() {
                        return;
                    }
                    if keeps_all && !was_known {
                        lambdas[after.clone()].copy_from_slice(lambda);
                    }
                    let at_end = if keeps_all { &lambdas[after] } else { &lambda[..] };
                    let dx = &path[k * n..(k + 1) * n];
                    failure = step.adjoint_derivative(dx, at_end, derivative).err();
                    if !was_known {
                        step.adjoint(lambda);
                    }
                    force(k, step.x, lambda, derivative, was_known);
                };
                if last == 0 {
                    force(0, base.trajectory.state(0), lambda, derivative, was_known);
                } else {
                    base.trajectory.for_each_step_reversed(&mut **model, &mut act)?;
                }
                if let Some(error) = failure {
                    return Err(error.into());
                }
                if keeps_all {
                    if !was_known {
                        lambdas[..n].copy_from_slice(lambda);
                    }
                    lambda.copy_from_slice(&lambdas[..n]);
                    *known = true;
                }
                dz.resize(transform.control_dim(), 0.0);
                model.initial_adjoint(derivative, dz);
                let second = model.second_order().ok_or(Error::NoSecondDerivatives)?;
                second.initial_adjoint_derivative(&self.dz, lambda, dz);
            }
            None => {
                force(0, base.trajectory.state(0), lambda, derivative, false);
                dz.clear();
                dz.extend_from_slice(derivative);
            }
        }
        transform.adjoint(dz, out);
        let whole = out.iter_mut().chain(forcing.iter_mut());
        whole.zip(dv).for_each(|(out, dv)| *out += dv);
        Ok(())
    }

    /// dx_k of every step, H dx, and the derivatives of the states observed between steps; dz in `self.dz`.
    fn tangent_path(&mut self, exact: &mut Exact, dv: &[f64]) -> Result<(), Error> {
        let n = self.state_dim;
        let Self { model, transform, observations, errors, base, lambda: dx, dz, last, counts, .. } = self;
        counts.tangent_sweeps += 1;
        let Exact { path, moved, dy, .. } = exact;
        path.resize((*last + 1) * n, 0.0);
        dy.resize(observations.dim(), 0.0);
        dy.fill(0.0);
        let moved = moved.get_or_insert_with(|| observations.prediction());
        moved.clear();
        let (dv, forcing) = dv.split_at(transform.dim());
        transform.tangent(dv, dz);
        let predicted = &base.predicted;
        let mut see = |k: usize, x: &[f64], dx: &mut [f64]| {
            if let (Some(errors), Some(before)) = (&mut *errors, k.checked_sub(1)) {
                errors.tangent_add(before, forcing, dx);
            }
            path[k * n..(k + 1) * n].copy_from_slice(dx);
            observations.tangent_add(k, x, dx, predicted, dy);
            observations.between_tangent_add(k, x, dx, moved);
        };
        match model {
            Some(model) => {
                model.initial_tangent(dz, dx);
                see(0, base.trajectory.state(0), dx);
                base.trajectory.for_each_step(&mut **model, &mut |step| {
                    step.tangent_kept(dx);
                    see(step.k + 1, step.x_next, dx);
                })?;
            }
            None => {
                dx.copy_from_slice(dz);
                see(0, base.trajectory.state(0), dx);
            }
        }
        Ok(())
    }
}
