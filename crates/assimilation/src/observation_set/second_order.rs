//! Second derivatives of the observations of a window.

use super::ObservationSet;
use crate::Prediction;

impl ObservationSet {
    /// Whether all operators have second derivatives.
    pub fn has_second_derivatives(&self) -> bool {
        self.operators.iter().all(|operator| operator.has_second_derivatives())
    }

    /// `moved` += the share of dx_k in the states observed between steps.
    pub(crate) fn between_tangent_add(&mut self, k: usize, x: &[f64], dx: &[f64], moved: &mut Prediction) {
        for i in self.between_of(k) {
            let Some((curve, share)) = &mut self.curve else { continue };
            let b = &self.between[i];
            curve.tangent((b.step, k, b.weight), x, dx, share);
            let state = &mut moved.states[i * x.len()..(i + 1) * x.len()];
            state.iter_mut().zip(share.iter()).for_each(|(state, share)| *state += share);
        }
    }

    /// out += the share of state k in Σ_i dy_i ∂²H_i dx, at a run with this prediction, whose states
    /// between steps are `moved` by dx.
    pub(crate) fn second_adjoint_add(
        &mut self,
        k: usize,
        [x, dx]: [&[f64]; 2],
        dy: &[f64],
        [run, moved]: [&Prediction; 2],
        out: &mut [f64],
    ) {
        let at = self.at(k);
        for sample in &self.samples[self.samples_of(k)] {
            let operator = &mut self.operators[sample.operator];
            let seen = &mut self.tangent[..operator.dim()];
            sample.acting(&self.parts, dy, seen);
            operator.second_adjoint_add(at, x, dx, seen, out);
        }
        for i in self.between_of(k) {
            let at = self.inside(&self.between[i]);
            let Some((curve, lambda)) = &mut self.curve else { continue };
            let b = &self.between[i];
            let operator = &mut self.operators[b.operator];
            let seen = &mut self.tangent[..operator.dim()];
            b.acting(dy, seen);
            let of = i * x.len()..(i + 1) * x.len();
            let (state, by) = (&run.states[of.clone()], &moved.states[of]);
            lambda.fill(0.0);
            operator.second_adjoint_add(at, state, by, seen, lambda);
            curve.adjoint_add((b.step, k, b.weight), x, lambda, out);
            lambda.fill(0.0);
            operator.adjoint_add(at, state, seen, lambda);
            curve.second_adjoint_add((b.step, k, b.weight), [x, dx], lambda, out);
        }
    }
}
