//! A recording whose clock is off by an unknown time.

use varda_assimilation::ObservationOperator;
use varda_implicit::{At, Rate, Refusal};

/// H where the recording's clock is off by c, an unknown constant in the state:
///
/// ```text
///     y(t, x) = H(t + δ, x + δ ẋ(x)),   δ = c − c₀
///     dy = H'(dx + δ ẋ'dx + ẋ dc) + ∂H/∂t dc
/// ```
///
/// with c₀ what the times of the observations contain already. To first order in δ: the state at t + δ is
/// off by ½δ² of its acceleration, and exact where δ = 0. ∂H/∂t at a given state is that of moving
/// supports, by a difference.
pub(crate) struct Clocked {
    operator: Box<dyn ObservationOperator>,
    rate: Box<dyn Rate>,
    /// Where c is in a state.
    place: usize,
    /// c₀ \[s\].
    known: f64,
    /// The point that what follows belongs to.
    at: Option<At>,
    x: Vec<f64>,
    /// ẋ, x + δ ẋ and ∂H/∂t there.
    rates: Vec<f64>,
    moved: Vec<f64>,
    by_time: Vec<f64>,
    /// An increment of the moved state, or what acts on it; one of rates; and values.
    increment: Vec<f64>,
    of_rates: Vec<f64>,
    values: Vec<f64>,
    second: Second,
}

/// Work space of second derivatives: nothing until they are asked for.
#[derive(Default)]
struct Second {
    /// dξ, ∂H/∂ξᵀ dy, its change, and the same at another time.
    moved: Vec<f64>,
    acting: Vec<f64>,
    change: Vec<f64>,
    later: Vec<f64>,
}

/// Half the interval of the difference for ∂²H/∂t² \[s\].
const SECOND_DIFFERENCE: f64 = 1e-4;

/// Half the interval of the difference for ∂H/∂t \[s\].
const DIFFERENCE: f64 = 1e-5;

impl Clocked {
    /// `place` is that of c in a state, `known` is c₀.
    pub(crate) fn new(
        operator: Box<dyn ObservationOperator>,
        rate: Box<dyn Rate>,
        place: usize,
        known: f64,
    ) -> Self {
        let (n, rates, rows) = (operator.state_dim(), rate.components().len(), operator.dim());
        Self {
            operator,
            rate,
            place,
            known,
            at: None,
            x: vec![0.0; n],
            rates: vec![0.0; rates],
            moved: vec![0.0; n],
            by_time: vec![0.0; rows],
            increment: vec![0.0; n],
            of_rates: vec![0.0; rates],
            values: vec![0.0; rows],
            second: Second::default(),
        }
    }

    fn shift(&self, x: &[f64]) -> f64 {
        x[self.place] - self.known
    }

    /// The time that the model has, `by` later.
    fn time(&self, at: At, x: &[f64], by: f64) -> At {
        At { time: at.time + self.shift(x) + by, ..at }
    }

    /// Moves a state to the time that the model has.
    fn shift_state(&mut self, at: At, x: &[f64]) {
        self.rate.eval(at.step, x, &mut self.rates);
        let delta = self.shift(x);
        self.moved.copy_from_slice(x);
        let moved = &mut self.moved[self.rate.components()];
        moved.iter_mut().zip(&self.rates).for_each(|(x, rate)| *x += delta * rate);
    }

    /// Prepares products at a state that was observed before.
    fn linearize(&mut self, at: At, x: &[f64]) {
        if self.at == Some(at) && self.x == x {
            return;
        }
        self.shift_state(at, x);
        let observed = "this state was observed before";
        let (before, after) = (self.time(at, x, -DIFFERENCE), self.time(at, x, DIFFERENCE));
        self.operator.observe(before, &self.moved, &mut self.values).expect(observed);
        self.operator.observe(after, &self.moved, &mut self.by_time).expect(observed);
        for (late, early) in self.by_time.iter_mut().zip(&self.values) {
            *late = (*late - early) / (2.0 * DIFFERENCE);
        }
        self.x.copy_from_slice(x);
        self.at = Some(at);
    }
}

impl ObservationOperator for Clocked {
    fn dim(&self) -> usize {
        self.operator.dim()
    }

    fn state_dim(&self) -> usize {
        self.operator.state_dim()
    }

    fn observe(&mut self, at: At, x: &[f64], y: &mut [f64]) -> Result<(), Refusal> {
        // the moved state is no longer that of products
        self.at = None;
        self.shift_state(at, x);
        self.operator.observe(self.time(at, x, 0.0), &self.moved, y)
    }

    fn tangent(&mut self, at: At, x: &[f64], dx: &[f64], dy: &mut [f64]) {
        self.linearize(at, x);
        let (delta, dc) = (self.shift(x), dx[self.place]);
        self.rate.tangent(at.step, x, dx, &mut self.of_rates);
        self.increment.copy_from_slice(dx);
        let moved = &mut self.increment[self.rate.components()];
        for ((dx, rate), d) in moved.iter_mut().zip(&self.rates).zip(&self.of_rates) {
            *dx += delta * d + dc * rate;
        }
        self.operator.tangent(self.time(at, x, 0.0), &self.moved, &self.increment, dy);
        dy.iter_mut().zip(&self.by_time).for_each(|(dy, rate)| *dy += dc * rate);
    }

    fn adjoint_add(&mut self, at: At, x: &[f64], dy: &[f64], dx: &mut [f64]) {
        self.linearize(at, x);
        let delta = self.shift(x);
        self.increment.fill(0.0);
        self.operator.adjoint_add(self.time(at, x, 0.0), &self.moved, dy, &mut self.increment);
        dx.iter_mut().zip(&self.increment).for_each(|(dx, l)| *dx += l);
        let acting = &self.increment[self.rate.components()];
        let by_state = acting.iter().zip(&self.rates).map(|(l, rate)| l * rate).sum::<f64>();
        let by_time = dy.iter().zip(&self.by_time).map(|(dy, rate)| dy * rate).sum::<f64>();
        dx[self.place] += by_state + by_time;
        self.of_rates.iter_mut().zip(acting).for_each(|(r, l)| *r = delta * l);
        self.rate.adjoint_add(at.step, x, &self.of_rates, dx);
    }

    fn has_second_derivatives(&self) -> bool {
        self.operator.has_second_derivatives()
    }

    /// With ξ = x + δ ẋ, dξ = dx + δ ẋ'dx + ẋ dc, g = ∂H/∂ξᵀ dy and
    /// dg = ∂²(dyᵀH)/∂ξ² dξ + ∂²(dyᵀH)/∂ξ∂t dc:
    ///
    /// ```text
    /// x: dg + ẋ'ᵀ (dc g + δ dg) + δ gᵀẋ'' dx
    /// c: dg·ẋ + g·ẋ'dx + ∂²(dyᵀH)/∂t∂ξ dξ + ∂²(dyᵀH)/∂t² dc
    /// ```
    ///
    /// of this y, in which the state moves by its rate: what its acceleration does is not in it.
    fn second_adjoint_add(&mut self, at: At, x: &[f64], dx: &[f64], dy: &[f64], out: &mut [f64]) {
        self.linearize(at, x);
        let (delta, dc) = (self.shift(x), dx[self.place]);
        let components = self.rate.components();
        let mut second = std::mem::take(&mut self.second);
        let Second { moved, acting, change, later } = &mut second;
        moved.clear();
        moved.extend_from_slice(dx);
        self.rate.tangent(at.step, x, dx, &mut self.of_rates);
        for ((dx, rate), d) in moved[components.clone()].iter_mut().zip(&self.rates).zip(&self.of_rates) {
            *dx += delta * d + dc * rate;
        }
        for zeroed in [&mut *acting, &mut *change, &mut *later] {
            zeroed.clear();
            zeroed.resize(x.len(), 0.0);
        }
        let now = self.time(at, x, 0.0);
        self.operator.adjoint_add(now, &self.moved, dy, acting);
        // ∂²(dyᵀH)/∂ξ∂t
        self.operator.adjoint_add(self.time(at, x, -DIFFERENCE), &self.moved, dy, change);
        self.operator.adjoint_add(self.time(at, x, DIFFERENCE), &self.moved, dy, later);
        for (late, early) in later.iter_mut().zip(change.iter_mut()) {
            *late = (*late - *early) / (2.0 * DIFFERENCE);
            *early = dc * *late;
        }
        self.operator.second_adjoint_add(now, &self.moved, moved, dy, change);

        let by_time = later.iter().zip(&*moved).map(|(l, d)| l * d).sum::<f64>();
        let of_change = change[components.clone()].iter().zip(&self.rates).map(|(c, r)| c * r);
        let of_rates = acting[components.clone()].iter().zip(&self.of_rates).map(|(g, r)| g * r);
        out[self.place] += by_time + of_change.sum::<f64>() + of_rates.sum::<f64>();
        out[self.place] += dc * self.second_by_time(at, x, dy);
        out.iter_mut().zip(&*change).for_each(|(out, c)| *out += c);
        let acting = &acting[components.clone()];
        for ((r, g), c) in self.of_rates.iter_mut().zip(acting).zip(&change[components]) {
            *r = dc * g + delta * c;
        }
        self.rate.adjoint_add(at.step, x, &self.of_rates, out);
        self.of_rates.iter_mut().zip(acting).for_each(|(r, g)| *r = delta * g);
        self.rate.second_adjoint_add(at.step, x, dx, &self.of_rates, out);
        self.second = second;
    }
}

impl Clocked {
    /// Σ dy ∂²H/∂t² of moving supports, by a difference.
    fn second_by_time(&mut self, at: At, x: &[f64], dy: &[f64]) -> f64 {
        [(-1.0, 1.0), (0.0, -2.0), (1.0, 1.0)].into_iter().fold(0.0, |sum, (side, weight)| {
            let there = self.time(at, x, side * SECOND_DIFFERENCE);
            let seen = self.operator.observe(there, &self.moved, &mut self.values);
            seen.expect("this state was observed before");
            let values = self.values.iter().zip(dy).map(|(y, dy)| y * dy).sum::<f64>();
            sum + weight * values / (SECOND_DIFFERENCE * SECOND_DIFFERENCE)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use varda_implicit::VelocityRate;
    use varda_implicit::check;

    /// Two places that move with their velocities and a support's: y = (sin x₀ + t², x₀ x₁).
    struct Seen;

    impl ObservationOperator for Seen {
        fn dim(&self) -> usize {
            2
        }
        fn state_dim(&self) -> usize {
            5
        }
        fn observe(&mut self, at: At, x: &[f64], y: &mut [f64]) -> Result<(), Refusal> {
            y.copy_from_slice(&[x[0].sin() + at.time * at.time, x[0] * x[1]]);
            Ok(())
        }
        fn tangent(&mut self, _: At, x: &[f64], dx: &[f64], dy: &mut [f64]) {
            dy.copy_from_slice(&[x[0].cos() * dx[0], dx[0] * x[1] + x[0] * dx[1]]);
        }
        fn adjoint_add(&mut self, _: At, x: &[f64], dy: &[f64], dx: &mut [f64]) {
            dx[0] += x[0].cos() * dy[0] + x[1] * dy[1];
            dx[1] += x[0] * dy[1];
        }
    }

    /// The state is [place, place, velocity, velocity, c].
    fn clocked() -> Clocked {
        Clocked::new(Box::new(Seen), Box::new(VelocityRate::new(0..2, 2, |_| 0.1)), 4, 0.01)
    }

    #[test]
    fn the_model_is_asked_for_the_time_it_has() {
        let (at, x) = (At { step: 3, time: 0.3 }, [0.4, -0.7, 2.0, 3.0, 0.03]);
        let mut y = [0.0; 2];
        clocked().observe(at, &x, &mut y).unwrap();
        let (a, b) = (0.4 + 0.02 * 2.0, -0.7 + 0.02 * 3.0);
        assert!((y[0] - (f64::sin(a) + 0.32 * 0.32)).abs() < 1e-15 && (y[1] - a * b).abs() < 1e-15, "{y:?}");
    }

    #[test]
    fn derivatives_are_exact() {
        let (at, x) = (At { step: 3, time: 0.3 }, [0.4, -0.7, 2.0, 3.0, 0.03]);
        let report = check::operator(&mut clocked(), at, &x, &[0.1; 5], 1).unwrap();
        assert!(report.passed(), "{report}");
    }
}
