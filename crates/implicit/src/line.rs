//! Transport along a line: linear advection–diffusion, and Burgers' equation.

#[cfg(feature = "implicit")]
use crate::{ImplicitModel, OneLeg, Scheme};
use crate::{Model, ParametricRhs, Rhs, Rk4, Structure};

/// The line that a field u is carried along, 0 ≤ s ≤ L, by points at equal distances h.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Points at which u is unknown, three at least.
    pub points: usize,
    /// L (m).
    pub length: f64,
    /// What lies beyond the first and the last point.
    pub ends: Ends,
}

/// What lies beyond the first and the last point of a [`Line`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Ends {
    /// The line closes to a circle: s_i = i h, h = L/n.
    Periodic,
    /// u is given at s = 0 and at s = L (m/s for Burgers' equation): s_i = (i + 1) h, h = L/(n + 1).
    Fixed {
        /// u(0).
        left: f64,
        /// u(L).
        right: f64,
    },
}

impl Line {
    /// h (m).
    pub fn spacing(&self) -> f64 {
        match self.ends {
            Ends::Periodic => self.length / self.points as f64,
            Ends::Fixed { .. } => self.length / (self.points + 1) as f64,
        }
    }

    /// s_i (m).
    pub fn position(&self, i: usize) -> f64 {
        match self.ends {
            Ends::Periodic => i as f64 * self.spacing(),
            Ends::Fixed { .. } => (i + 1) as f64 * self.spacing(),
        }
    }

    /// The point that is nearest to the place s (m).
    pub fn nearest(&self, s: f64) -> usize {
        let at = (s / self.spacing()).round().max(0.0) as usize;
        match self.ends {
            Ends::Periodic => at % self.points,
            Ends::Fixed { .. } => at.saturating_sub(1).min(self.points - 1),
        }
    }

    /// u(s) on the cubic through the four points around s (m) from 0 to L: the points with their weights,
    /// and what given ends add. At a point it is that point's u.
    ///
    /// ```
    /// use varda_implicit::line::{Ends, Line};
    ///
    /// let line = Line { points: 9, length: 1.0, ends: Ends::Fixed { left: 0.0, right: 1.0 } };
    /// let u: Vec<f64> = (0..9).map(|i| line.position(i).powi(3)).collect();
    /// for s in [0.0, 0.03, 0.5, 0.72, 1.0] {
    ///     let (weights, of_ends) = line.between(s);
    ///     let seen: f64 = of_ends + weights.iter().map(|(i, w)| w * u[*i]).sum::<f64>();
    ///     assert!((seen - s.powi(3)).abs() < 1e-14);
    /// }
    /// ```
    pub fn between(&self, s: f64) -> (Vec<(usize, f64)>, f64) {
        let at = s / self.spacing();
        // Nodes: the points of a circle, or those of a line with both ends as 0 and points + 1.
        let last = self.points as isize + 1;
        let node = if (at - at.round()).abs() <= 1e-9 { at.round() } else { at };
        let below = node.floor() as isize;
        let nodes: Vec<(isize, f64)> = if node == node.floor() {
            vec![(below, 1.0)]
        } else {
            let first = match self.ends {
                Ends::Periodic => below - 1,
                Ends::Fixed { .. } => (below - 1).clamp(0, last - 3),
            };
            let t = node - first as f64;
            let weight = |j: isize| {
                let others = (0..4).filter(|k| *k != j);
                others.map(|k| (t - k as f64) / (j - k) as f64).product::<f64>()
            };
            (0..4).map(|j| (first + j, weight(j))).collect()
        };
        match self.ends {
            Ends::Periodic => {
                let around = |i: isize| i.rem_euclid(self.points as isize) as usize;
                (nodes.into_iter().map(|(i, w)| (around(i), w)).collect(), 0.0)
            }
            Ends::Fixed { left, right } => {
                let at = |end: isize| nodes.iter().find(|n| n.0 == end).map_or(0.0, |n| n.1);
                let of_ends = at(0) * left + at(last) * right;
                let inside = nodes.iter().filter(|n| (1..last).contains(&n.0));
                (inside.map(|(i, w)| (*i as usize - 1, *w)).collect(), of_ends)
            }
        }
    }
}

/// A field carried along a line, by a constant speed or by itself, and spread by diffusion.
///
/// ```text
/// ∂u/∂t + (c + a u) ∂u/∂s = ν ∂²u/∂s²
/// u̇_i = −(c + a ū_i) (u_{i+1} − u_{i−1})/2h + ν (u_{i−1} − 2u_i + u_{i+1})/h²
/// ū_i = (u_{i−1} + u_i + u_{i+1})/3
/// ```
///
/// a = 0 is advection–diffusion, c = 0 and a = 1 Burgers' equation (Burgers 1948). Differences are centred,
/// of second order. The mean ū_i over three points (Zabusky and Kruskal 1965) makes transport keep Σ u and
/// Σ u² of a periodic line to rounding, so that a front sharper than the grid oscillates but does not blow
/// up; that front is resolved where |u| h ≲ 2ν.
///
/// For [`Rk4`] Δt is limited by ν Δt/h² ≲ 0.69 and |c + a u| Δt/h ≲ 2.8; implicit steps have no
/// limit. Their Jacobian is sparse for a periodic line (three values in a row, two rows of them in the
/// corners) and a band for fixed ends.
///
/// ```
/// use varda_implicit::line::{Ends, Line, Transport};
/// use varda_implicit::{ImplicitModel, Keep, OneLeg, Trajectory};
///
/// let line = Line { points: 100, length: 1.0, ends: Ends::Periodic };
/// let u0: Vec<f64> = (0..100).map(|i| (std::f64::consts::TAU * line.position(i)).sin()).collect();
/// let step = OneLeg::implicit_midpoint(Transport::burgers(line, 0.01), 1e-11);
/// let mut trajectory = Trajectory::new();
/// trajectory.run(&mut ImplicitModel::new(step, 0, 0.01), &u0, 50, Keep::States)?;
/// // the wave has steepened: from a slope of −2π m/s per m to ten times that
/// let u = trajectory.state(50);
/// assert!((u[51] - u[49]) / (2.0 * line.spacing()) < -15.0);
/// # Ok::<(), varda_implicit::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transport {
    line: Line,
    speed: f64,
    steepening: f64,
    diffusivity: f64,
}

impl Transport {
    /// Linear advection–diffusion, u̇ = −c u′ + ν u″: `speed` c (m/s), `diffusivity` ν (m²/s). u
    /// has any unit.
    ///
    /// # Panics
    /// If the line has less than three points or no positive length, or a number is not finite, or ν < 0.
    pub fn advection_diffusion(line: Line, speed: f64, diffusivity: f64) -> Self {
        Self::new(line, speed, 0.0, diffusivity)
    }

    /// Viscous Burgers' equation, u̇ = −u u′ + ν u″: u (m/s), `viscosity` ν (m²/s).
    ///
    /// # Panics
    /// As [`advection_diffusion`](Self::advection_diffusion).
    pub fn burgers(line: Line, viscosity: f64) -> Self {
        Self::new(line, 0.0, 1.0, viscosity)
    }

    fn new(line: Line, speed: f64, steepening: f64, diffusivity: f64) -> Self {
        assert!(line.points >= 3, "a line needs 3 points, not {}", line.points);
        assert!(line.length > 0.0 && line.length.is_finite(), "a line needs a length, not {}", line.length);
        if let Ends::Fixed { left, right } = line.ends {
            assert!(left.is_finite() && right.is_finite(), "the ends are fixed at {left} and {right}");
        }
        assert!(speed.is_finite(), "a speed must be finite, not {speed}");
        assert!(diffusivity >= 0.0 && diffusivity.is_finite(), "ν must not be negative: {diffusivity}");
        Self { line, speed, steepening, diffusivity }
    }

    /// The model of this equation by [`Rk4`], compiled in this crate.
    ///
    /// # Panics
    /// As [`Rk4::new`].
    pub fn rk4(self, first_index: usize, length: f64) -> Box<dyn Model + Send> {
        Box::new(Rk4::new(self, first_index, length))
    }

    /// The model of this equation by an implicit scheme, compiled in this crate. `tolerance` as for
    /// [`OneLeg::implicit_euler`].
    ///
    /// # Panics
    /// As [`ImplicitModel::new`].
    #[cfg(feature = "implicit")]
    pub fn implicit(
        self,
        scheme: Scheme,
        tolerance: f64,
        first_index: usize,
        length: f64,
    ) -> Box<dyn Model + Send> {
        Box::new(ImplicitModel::new(OneLeg::new(self, scheme, tolerance), first_index, length))
    }

    /// The speed c and the diffusivity ν.
    pub fn constants(&self) -> [f64; 2] {
        [self.speed, self.diffusivity]
    }

    /// Whether u carries itself.
    pub fn steepens(&self) -> bool {
        self.steepening != 0.0
    }

    /// The line.
    pub fn line(&self) -> &Line {
        &self.line
    }

    /// u beyond both ends.
    fn beyond(&self, u: &[f64]) -> [f64; 2] {
        match self.line.ends {
            Ends::Periodic => [u[u.len() - 1], u[0]],
            Ends::Fixed { left, right } => [left, right],
        }
    }

    /// du beyond both ends.
    fn beyond_tangent(&self, du: &[f64]) -> [f64; 2] {
        match self.line.ends {
            Ends::Periodic => [du[du.len() - 1], du[0]],
            Ends::Fixed { .. } => [0.0, 0.0],
        }
    }

    /// 1/2h and ν/h².
    fn scales(&self) -> [f64; 2] {
        let h = self.line.spacing();
        [0.5 / h, self.diffusivity / (h * h)]
    }

    /// c + a ū.
    fn speed_at(&self, [l, m, r]: [f64; 3]) -> f64 {
        self.speed + self.steepening / 3.0 * (l + m + r)
    }

    /// ∂u̇_i/∂u_{i−1}, ∂u̇_i/∂u_i, ∂u̇_i/∂u_{i+1}.
    fn row(&self, [transport, diffusion]: [f64; 2], near: [f64; 3]) -> [f64; 3] {
        let [l, _, r] = near;
        let carried = transport * self.speed_at(near);
        let carries = transport * self.steepening / 3.0 * (r - l);
        [diffusion + carried - carries, -2.0 * diffusion - carries, diffusion - carried - carries]
    }
}

/// u_{i−1}, u_i, u_{i+1}.
fn near(u: &[f64], beyond: [f64; 2], i: usize) -> [f64; 3] {
    let left = if i == 0 { beyond[0] } else { u[i - 1] };
    let right = if i + 1 == u.len() { beyond[1] } else { u[i + 1] };
    [left, u[i], right]
}

/// The speed c and the diffusivity ν.
impl ParametricRhs for Transport {
    fn parameters(&self) -> usize {
        2
    }

    fn set_parameters(&mut self, p: &[f64]) {
        (self.speed, self.diffusivity) = (p[0], p[1]);
    }

    fn parameter_jacobian(&mut self, _t: f64, u: &[f64], columns: &mut [f64]) {
        let (n, h, beyond) = (u.len(), self.line.spacing(), self.beyond(u));
        let (by_speed, by_diffusivity) = columns.split_at_mut(n);
        for (i, (c, d)) in by_speed.iter_mut().zip(by_diffusivity).enumerate() {
            let [l, m, r] = near(u, beyond, i);
            (*c, *d) = (-0.5 * (r - l) / h, (l - 2.0 * m + r) / (h * h));
        }
    }

    fn has_second_parameters(&self) -> bool {
        true
    }

    fn second_parameters(
        &mut self,
        _t: f64,
        u: &[f64],
        lambda: &[f64],
        columns: &mut [f64],
        square: &mut [f64],
    ) {
        let (n, h) = (u.len(), self.line.spacing());
        let periodic = self.line.ends == Ends::Periodic;
        square.fill(0.0);
        columns.fill(0.0);
        let (by_speed, by_diffusivity) = columns.split_at_mut(n);
        for (i, l) in lambda.iter().enumerate() {
            // values beyond ends that are held do not move
            let left = if i > 0 { Some(i - 1) } else { periodic.then_some(n - 1) };
            let right = if i + 1 < n { Some(i + 1) } else { periodic.then_some(0) };
            by_diffusivity[i] -= 2.0 * l / (h * h);
            for (j, sign) in [(left, -1.0), (right, 1.0)] {
                let Some(j) = j else { continue };
                by_speed[j] -= 0.5 * sign * l / h;
                by_diffusivity[j] += l / (h * h);
            }
        }
    }
}

impl Rhs for Transport {
    fn dim(&self) -> usize {
        self.line.points
    }

    fn eval(&mut self, _t: f64, u: &[f64], f: &mut [f64]) {
        let (beyond, [transport, diffusion]) = (self.beyond(u), self.scales());
        for (i, f) in f.iter_mut().enumerate() {
            let near @ [l, m, r] = near(u, beyond, i);
            *f = diffusion * (l - 2.0 * m + r) - transport * self.speed_at(near) * (r - l);
        }
    }

    fn tangent(&mut self, _t: f64, u: &[f64], du: &[f64], df: &mut [f64]) {
        let (beyond, beyond_tangent, scales) = (self.beyond(u), self.beyond_tangent(du), self.scales());
        for (i, df) in df.iter_mut().enumerate() {
            let (row, du) = (self.row(scales, near(u, beyond, i)), near(du, beyond_tangent, i));
            *df = row[0] * du[0] + row[1] * du[1] + row[2] * du[2];
        }
    }

    fn adjoint_add(&mut self, _t: f64, u: &[f64], lambda: &[f64], du: &mut [f64]) {
        let (n, beyond, scales) = (u.len(), self.beyond(u), self.scales());
        // what the rows send beyond both ends
        let mut out = [0.0; 2];
        for (i, l) in lambda.iter().enumerate() {
            let row = self.row(scales, near(u, beyond, i));
            *(if i == 0 { &mut out[0] } else { &mut du[i - 1] }) += row[0] * l;
            du[i] += row[1] * l;
            *(if i + 1 == n { &mut out[1] } else { &mut du[i + 1] }) += row[2] * l;
        }
        if self.line.ends == Ends::Periodic {
            du[n - 1] += out[0];
            du[0] += out[1];
        }
    }

    fn has_second_derivatives(&self) -> bool {
        true
    }

    /// The transport −a (l + m + r)(r − l)/6h is quadratic.
    fn second_adjoint_add(&mut self, _t: f64, u: &[f64], du: &[f64], lambda: &[f64], out: &mut [f64]) {
        let (n, beyond, [transport, _]) = (u.len(), self.beyond_tangent(du), self.scales());
        let mut outside = [0.0; 2];
        for (i, lambda) in lambda.iter().enumerate() {
            let [l, m, r] = near(du, beyond, i);
            let share = transport * self.steepening / 3.0 * lambda;
            let (sum, difference) = (l + m + r, r - l);
            *(if i == 0 { &mut outside[0] } else { &mut out[i - 1] }) -= share * (difference - sum);
            out[i] -= share * difference;
            *(if i + 1 == n { &mut outside[1] } else { &mut out[i + 1] }) -= share * (difference + sum);
        }
        if self.line.ends == Ends::Periodic {
            out[n - 1] += outside[0];
            out[0] += outside[1];
        }
    }

    fn structure(&self) -> Structure {
        let n = self.line.points;
        if self.line.ends != Ends::Periodic {
            return Structure::Band { half_bandwidth: 1 };
        }
        let (mut columns, mut rows) = (vec![0], Vec::with_capacity(3 * n));
        for j in 0..n {
            let mut column = [(j + n - 1) % n, j, (j + 1) % n];
            column.sort_unstable();
            rows.extend(column);
            columns.push(rows.len());
        }
        Structure::Sparse { columns, rows }
    }

    fn jacobian(&mut self, _t: f64, u: &[f64], values: &mut [f64]) -> bool {
        let (n, beyond, scales) = (u.len(), self.beyond(u), self.scales());
        for i in 0..n {
            let row = self.row(scales, near(u, beyond, i));
            if self.line.ends == Ends::Periodic {
                let (before, after) = ((i + n - 1) % n, (i + 1) % n);
                // rows j−1, j, j+1 of column j in ascending order: turned by a place in the last column, by
                // two in the first
                for (j, place, value) in [(before, 2, row[0]), (i, 1, row[1]), (after, 0, row[2])] {
                    let turn = 2 * usize::from(j == 0) + usize::from(j + 1 == n);
                    values[3 * j + (place + turn) % 3] = value;
                }
            } else {
                values[3 * i..3 * i + 3].copy_from_slice(&row);
            }
        }
        if self.line.ends != Ends::Periodic {
            values[0] = 0.0;
            values[3 * n - 1] = 0.0;
        }
        true
    }
}
