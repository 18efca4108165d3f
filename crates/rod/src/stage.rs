//! The one implicit stage of a rod's step: what [`Scheme`] says of x and V, and what follows for θ and the
//! strains.

use varda_implicit::{Interval, Scheme, Stage};

/// A step is one backward Euler step of length η from (X*, V*, ε*), and x_{k+1} follows from where that
/// ends.
///
/// **Angles.** With damping or inertia θ has a rate and goes with the scheme. Without, it is the equilibrium
/// of the stage's vertices. Under midpoint that of X_{k+1} is needed: 2θ_y − θ_k would carry an error on
/// for ever with changing sign, so
///
/// ```text
/// θ_{k+1} = (16/9) θ_y − (7/9 − 1/9p) θ_k − (1/9p) θ_{k−1},   p = Δt_{k−1}/Δt
/// ```
///
/// which is exact for angles linear in time and takes two thirds off an error at every step (double root
/// −1/3).
///
/// **Strain rates** (ε(y) − ε*)/η at the stage's time, to the order of the scheme. Backward Euler and
/// BDF2 difference ε as they do x. Under midpoint y is not on the path but half way along the chord, where
/// ε differs from its mean over the ends by the curvature of ε along it; that of the step before, scaled by
/// ω² = (Δt/Δt_{k−1})², corrects ε*:
///
/// ```text
/// ε* = ε_k − ω² (½(ε_k + ε_{k−1}) − ε(½(x_k + x_{k−1})))
/// ```
///
/// **Spins** are measured from directors carried to edges where x_k and x_{k−1} lead to at the stage's
/// time, so that these are off by the square of Δt: see [`crate::spin`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct RodStage {
    /// Of X and V.
    pub(crate) of: Stage,
    /// Shares of θ_y, θ_k, θ_{k−1} in θ_{k+1}.
    pub(crate) angle: [f64; 3],
    /// Weights in ε* of the strains of x_k, x_{k−1} and ½(x_k + x_{k−1}).
    pub(crate) strain: [f64; 3],
    /// Shares of x_k and x_{k−1} in the edges that spins are measured along.
    pub(crate) along: [f64; 2],
}

impl RodStage {
    /// Configurations that ε* is made of: shares of x_k and x_{k−1}, how many steps before x_k they are,
    /// and their weight. The first is x_k.
    pub(crate) fn past(&self) -> impl Iterator<Item = ([f64; 2], f64, f64)> {
        let [now, before, between] = self.strain;
        let all = [([1.0, 0.0], 0.0, now), ([0.0, 1.0], 1.0, before), ([0.5, 0.5], 0.5, between)];
        all.into_iter().filter(|(_, age, weight)| *age == 0.0 || *weight != 0.0)
    }

    /// `rated`: angles have a rate, by damping or inertia. `history`: the state holds x_{k−1}.
    pub(crate) fn new(scheme: Scheme, at: &Interval, rated: bool, history: bool) -> RodStage {
        let of = scheme.stage(at);
        let [a0, a1] = of.from;
        let ahead = at.previous.filter(|_| history).map_or(0.0, |previous| (of.time - at.start) / previous);
        let along = [1.0 + ahead, -ahead];
        let plain = RodStage { of, angle: [of.to[0], of.to[1], 0.0], strain: [a0, a1, 0.0], along };
        match (scheme, at.previous) {
            (Scheme::Midpoint, Some(previous)) if history && rated => {
                let w2 = (at.length / previous).powi(2);
                RodStage { strain: [1.0 - 0.5 * w2, -0.5 * w2, w2], ..plain }
            }
            (Scheme::Midpoint, Some(previous)) if history => {
                let c = at.length / (9.0 * previous);
                RodStage { angle: [16.0 / 9.0, c - 7.0 / 9.0, -c], ..plain }
            }
            _ => plain,
        }
    }
}

/// Component i of a₀ x_k + a₁ x_{k−1} of a state (or increment) whose own part has length `own`; a
/// history without a share need not be there.
pub(crate) fn mixed([a0, a1]: [f64; 2], x: &[f64], own: usize, i: usize) -> f64 {
    a0 * x[i] + if a1 == 0.0 { 0.0 } else { a1 * x[own + i] }
}

/// The transpose of [`mixed`], for components i … i+N−1 at once.
pub(crate) fn mixed_add<const N: usize>(
    [a0, a1]: [f64; 2],
    dx: &mut [f64],
    own: usize,
    i: usize,
    values: [f64; N],
) {
    dx[i..i + N].iter_mut().zip(values).for_each(|(dx, value)| *dx += a0 * value);
    if a1 != 0.0 {
        dx[own + i..own + i + N].iter_mut().zip(values).for_each(|(dx, value)| *dx += a1 * value);
    }
}
