//! Time integration schemes that solve one implicit stage a step.

use crate::Interval;

/// A scheme for ẋ = f(t, x) that takes f once a step (one-leg methods, Dahlquist 1975). All three are
/// A-stable and are one implicit Euler step of length η from a point x* between the last states, see
/// [`Scheme::stage`]:
///
/// ```text
/// y = x* + η f(t*, y),   x* = a₀ x_k + a₁ x_{k−1},   x_{k+1} = b₀ y + b₁ x_k
///
/// backward Euler   η = Δt               x* = x_k
///                  t* = t_{k+1}         x_{k+1} = y
/// midpoint         η = Δt/2             x* = x_k
///                  t* = t_{k+½}         x_{k+1} = 2y − x_k
/// BDF2             η = Δt(1+ω)/(1+2ω)   x* = ((1+ω)² x_k − ω² x_{k−1})/(1+2ω)
///                  t* = t_{k+1}         x_{k+1} = y
/// ```
///
/// with ω = Δt/Δt_{k−1}, the ratio to the step before (BDF2 of variable step: Hairer, Nørsett and
/// Wanner 1993, III.5). Backward Euler is of first order and damps whatever it does not resolve; midpoint is
/// of second order and damps nothing (it keeps quadratic invariants); BDF2 is of second order and damps what
/// it does not resolve. It starts with one midpoint step.
///
/// ```
/// use varda_implicit::{ImplicitModel, Model, OneLeg, Scheme, lorenz::Lorenz63};
///
/// let step = OneLeg::new(Lorenz63::default(), Scheme::Midpoint, 1e-10);
/// let mut model = ImplicitModel::new(step, 0, 0.01);
/// let mut next = vec![0.0; model.dim()];
/// model.step(0, &[1.0, 3.0, 20.0], &mut next)?;
/// assert_eq!(Scheme::Midpoint.order(), 2);
/// # Ok::<(), varda_implicit::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scheme {
    /// x_{k+1} = x_k + Δt f(t_{k+1}, x_{k+1}).
    BackwardEuler,
    /// x_{k+1} = x_k + Δt f(t_{k+½}, ½(x_k + x_{k+1})).
    Midpoint,
    /// (3 x_{k+1} − 4 x_k + x_{k−1})/(2Δt) = f(t_{k+1}, x_{k+1}), here for constant Δt.
    Bdf2,
}

/// The one implicit stage of a step: weights as in [`Scheme`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stage {
    /// t* (s).
    pub time: f64,
    /// η (s).
    pub length: f64,
    /// a₀, a₁: the shares of x_k and x_{k−1} in x*.
    pub from: [f64; 2],
    /// b₀, b₁: the shares of y and x_k in x_{k+1}.
    pub to: [f64; 2],
}

impl Scheme {
    /// Order of accuracy.
    pub fn order(self) -> i32 {
        match self {
            Scheme::BackwardEuler => 1,
            Scheme::Midpoint | Scheme::Bdf2 => 2,
        }
    }

    /// The stage of a step; BDF2 without a step before it is the midpoint rule.
    pub fn stage(self, at: &Interval) -> Stage {
        match (self, at.previous) {
            (Scheme::BackwardEuler, _) => {
                Stage { time: at.end(), length: at.length, from: [1.0, 0.0], to: [1.0, 0.0] }
            }
            (Scheme::Bdf2, Some(previous)) => {
                let w = at.length / previous;
                let c = 1.0 / (1.0 + 2.0 * w);
                Stage {
                    time: at.end(),
                    length: at.length * (1.0 + w) * c,
                    from: [(1.0 + w) * (1.0 + w) * c, -w * w * c],
                    to: [1.0, 0.0],
                }
            }
            (Scheme::Midpoint | Scheme::Bdf2, _) => Stage {
                time: at.start + 0.5 * at.length,
                length: 0.5 * at.length,
                from: [1.0, 0.0],
                to: [2.0, -1.0],
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A stage solved for x(t) = t² must return it: y = x* + η x′(t*), for any Δt and any step before.
    #[test]
    fn second_order_schemes_are_exact_on_parabolas() {
        let at = |start: f64, length, previous| Interval { index: 3, start, length, previous };
        for (scheme, at) in [
            (Scheme::Midpoint, at(0.7, 0.3, None)),
            (Scheme::Bdf2, at(0.7, 0.3, Some(0.3))),
            (Scheme::Bdf2, at(0.7, 0.3, Some(0.1))),
            (Scheme::Bdf2, at(0.7, 0.3, None)),
        ] {
            let stage = scheme.stage(&at);
            let x = |t: f64| t * t;
            let before = at.previous.map_or(f64::NAN, |p| x(at.start - p));
            let past = if stage.from[1] == 0.0 { 0.0 } else { stage.from[1] * before };
            let y = stage.from[0] * x(at.start) + past + stage.length * 2.0 * stage.time;
            let end = stage.to[0] * y + stage.to[1] * x(at.start);
            assert!((end - x(at.end())).abs() < 1e-15, "{scheme:?}: {end}");
        }
    }
}
