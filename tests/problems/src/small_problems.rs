//! Small windows on which methods are compared with each other.

use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::error::Error;
use varda_assimilation::{Observation, ObservationOperator, ObservationSet, Selection};
use varda_covariance::{Covariance, Dense, Ensemble, Localization, Taper};
use varda_implicit::lorenz::{Lorenz63, Lorenz96};
use varda_implicit::{At, Model, Refusal, Rhs, Rk4};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// n draws of the standard normal distribution.
pub fn normals(seed: u64, n: usize) -> Vec<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..n).map(|_| StandardNormal.sample(&mut rng)).collect()
}

/// aᵀb.
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// ‖a − b‖ / ‖b‖.
///
/// # Panics
/// If lengths differ.
pub fn difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len(), "lengths compared");
    let gap: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - b).collect();
    (dot(&gap, &gap) / dot(b, b)).sqrt()
}

/// B_ij = σ² exp(−|i − j| / 2).
///
/// # Errors
/// As `Dense::new`.
pub fn coupled(n: usize, sigma: f64) -> Result<Dense> {
    let entry = |i: usize, j: usize| sigma * sigma * (-0.5 * i.abs_diff(j) as f64).exp();
    let matrix: Vec<f64> = (0..n * n).map(|k| entry(k % n, k / n)).collect();
    Ok(Dense::new(n, &matrix)?)
}

/// A B without inverse: rank 3 of 5, known by its root alone, and no `Precision`.
pub struct Thin;

const THIN_ROOT: [[f64; 3]; 5] =
    [[1.0, 0.0, 0.0], [0.5, 0.8, 0.0], [0.2, 0.4, 0.9], [0.0, 0.5, 0.4], [0.3, -0.2, 0.6]];

impl Covariance for Thin {
    fn dim(&self) -> usize {
        5
    }
    fn root_dim(&self) -> usize {
        3
    }
    fn apply(&self, x: &[f64], y: &mut [f64]) {
        let mut v = [0.0; 3];
        self.root_transpose(x, &mut v);
        self.root(&v, y);
    }
    fn root(&self, v: &[f64], x: &mut [f64]) {
        x.iter_mut().zip(THIN_ROOT).for_each(|(x, row)| *x = dot(&row, v));
    }
    fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
        (0..3).for_each(|j| v[j] = (0..5).map(|i| THIN_ROOT[i][j] * x[i]).sum());
    }
    fn variance(&self, variance: &mut [f64]) {
        variance.iter_mut().zip(THIN_ROOT).for_each(|(v, row)| *v = dot(&row, &row));
    }
}

/// ẋ = A x, A by rows.
#[derive(Clone)]
pub struct Linear(pub usize, pub Vec<f64>);

impl Linear {
    /// Stable, neighbours on a circle coupled.
    pub fn ring(n: usize) -> Linear {
        let mut a = vec![0.0; n * n];
        for i in 0..n {
            a[i * n + i] = -0.4;
            a[i * n + (i + 1) % n] = 1.1;
            a[i * n + (i + n - 1) % n] = -0.7;
        }
        Linear(n, a)
    }
}

impl Rhs for Linear {
    fn dim(&self) -> usize {
        self.0
    }
    fn eval(&mut self, _t: f64, x: &[f64], f: &mut [f64]) {
        f.iter_mut().zip(self.1.chunks_exact(self.0)).for_each(|(f, row)| *f = dot(row, x));
    }
    fn tangent(&mut self, t: f64, _x: &[f64], dx: &[f64], df: &mut [f64]) {
        self.eval(t, dx, df);
    }
    fn adjoint_add(&mut self, _t: f64, _x: &[f64], lambda: &[f64], dx: &mut [f64]) {
        for (row, l) in self.1.chunks_exact(self.0).zip(lambda) {
            dx.iter_mut().zip(row).for_each(|(d, a)| *d += a * l);
        }
    }
}

/// y = (x₀², x₀ x₁).
pub struct Products {
    /// Length of the state.
    pub state_dim: usize,
}

impl ObservationOperator for Products {
    fn dim(&self) -> usize {
        2
    }
    fn state_dim(&self) -> usize {
        self.state_dim
    }
    fn observe(&mut self, _at: At, x: &[f64], y: &mut [f64]) -> std::result::Result<(), Refusal> {
        (y[0], y[1]) = (x[0] * x[0], x[0] * x[1]);
        Ok(())
    }
    fn tangent(&mut self, _at: At, x: &[f64], dx: &[f64], dy: &mut [f64]) {
        (dy[0], dy[1]) = (2.0 * x[0] * dx[0], x[0] * dx[1] + x[1] * dx[0]);
    }
    fn adjoint_add(&mut self, _at: At, x: &[f64], dy: &[f64], dx: &mut [f64]) {
        dx[0] += 2.0 * x[0] * dy[0] + x[1] * dy[1];
        dx[1] += x[0] * dy[1];
    }
}

/// The whole state as an operator.
///
/// # Errors
/// As `Selection::new`.
pub fn all_of(n: usize) -> Result<Box<dyn ObservationOperator>> {
    Ok(Box::new(Selection::new((0..n).collect(), n)?))
}

/// Rows of the first operator, seen with one σ.
pub fn observation(rows: &[usize], step: usize, weight: f64, values: &[f64], sigma: f64) -> Observation {
    Observation::new(step, rows.to_vec(), values.to_vec(), sigma).between(weight)
}

/// The states after 0 … `steps` steps.
///
/// # Errors
/// A model that fails.
pub fn states(model: &mut dyn Model, x: &[f64], steps: usize) -> Result<Vec<Vec<f64>>> {
    let mut states = vec![x.to_vec()];
    for k in 0..steps {
        let mut next = x.to_vec();
        model.step(k, &states[k], &mut next)?;
        states.push(next);
    }
    Ok(states)
}

/// A model, a background, and what is observed.
pub type Window<M> = (M, Vec<f64>, ObservationSet);

/// Steps of [`linear`].
pub const LINEAR_STEPS: usize = 8;

/// Four linear variables, three of them seen at four times, at both ends of the window too.
///
/// # Errors
/// None in practice.
pub fn linear() -> Result<Window<Rk4<Linear>>> {
    let n = 4;
    let field = Linear(n, normals(20, n * n).iter().map(|a| 0.5 * a).collect());
    let values = normals(22, 12);
    let seen = [0, 2, 4, LINEAR_STEPS].into_iter().enumerate().map(|(j, step)| {
        observation(&[j % 2, 2, 3], step, 0.0, &values[3 * j..3 * j + 3], 0.3 + 0.1 * j as f64)
    });
    let set = ObservationSet::new(LINEAR_STEPS, vec![all_of(n)?], seen.collect())?;
    Ok((Rk4::new(field, 0, 0.1), normals(21, n), set))
}

/// Variables of [`ring`].
pub const RING: usize = 6;

/// Six linear variables, three of them seen at steps 0, 4, 7.5 and 10 of 12, with twelve values `y`.
///
/// # Errors
/// None in practice.
pub fn ring(y: &[f64]) -> Result<ObservationSet> {
    let times = [(0, 0.0), (4, 0.0), (7, 0.5), (10, 0.0)];
    let seen = times.iter().enumerate().map(|(j, (step, weight))| {
        observation(&[0, 2, 5], *step, *weight, &y[3 * j..3 * j + 3], 0.3 + 0.1 * j as f64)
    });
    Ok(ObservationSet::new(12, vec![all_of(RING)?], seen.collect())?)
}

/// The model of [`ring`].
pub fn ring_model() -> Rk4<Linear> {
    Rk4::new(Linear::ring(RING), 0, 0.1)
}

/// Lorenz 1996 with 6 variables: two operators, one of them curved, times between steps, several σ.
///
/// # Errors
/// None in practice.
pub fn curved() -> Result<Window<Rk4<Lorenz96>>> {
    let background: Vec<f64> = normals(5, 6).iter().map(|x| 2.0 + 2.0 * x).collect();
    let values = normals(6, 15);
    let mut seen = Vec::new();
    for (j, (step, weight)) in [(0, 0.0), (3, 0.3), (3, 0.7), (7, 0.0), (12, 0.0)].into_iter().enumerate() {
        let mut o = observation(&[5, 1, 2], step, weight, &values[3 * j..3 * j + 3], 0.7);
        o.sigma[1] = 0.3;
        seen.push(o.clone());
        (o.operator, o.rows, o.weight, o.step) = (1, vec![1, 0, 1], 0.0, (step + 1).min(12));
        seen.push(o);
    }
    let set = ObservationSet::new(14, vec![all_of(6)?, Box::new(Products { state_dim: 6 })], seen)?;
    Ok((Rk4::new(Lorenz96::new(6, 8.0), 0, 0.03), background, set))
}

/// Lorenz 1996 with 30 variables, 12 values at three times: more unknowns than observations.
///
/// # Errors
/// None in practice.
pub fn wide() -> Result<Window<Rk4<Lorenz96>>> {
    let mut model = Rk4::new(Lorenz96::new(30, 8.0), 0, 0.05);
    let start: Vec<f64> = normals(45, 30).iter().map(|x| 2.0 + 3.0 * x).collect();
    let truth = states(&mut model, &start, 200)?.swap_remove(200);
    let background = truth.iter().zip(normals(46, 30)).map(|(x, e)| x + 0.3 * e).collect();
    let run = states(&mut model, &truth, 6)?;
    let noise = normals(47, 12);
    let seen = (0..3).map(|j| {
        let y: Vec<f64> = (0..4).map(|i| run[2 + 2 * j][7 * i] + 0.1 * noise[4 * j + i]).collect();
        observation(&[0, 7, 14, 21], 2 + 2 * j, 0.0, &y, 0.1)
    });
    let set = ObservationSet::new(6, vec![all_of(30)?], seen.collect())?;
    Ok((Rk4::new(Lorenz96::new(30, 8.0), 0, 0.05), background, set))
}

/// Lorenz 1963 over 100 steps, all seen every tenth with R = 2 I, a background drawn around the truth with
/// B = I; the truth first.
///
/// # Errors
/// None in practice.
pub fn long_lorenz63(seed: u64) -> Result<(Vec<f64>, Vec<f64>, ObservationSet)> {
    let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);
    let start: Vec<f64> = normals(1000 + seed, 3).iter().map(|x| 5.0 * x).collect();
    let truth = states(&mut model, &start, 900)?.swap_remove(900);
    let background = truth.iter().zip(normals(2000 + seed, 3)).map(|(x, e)| x + e).collect();
    let noise = normals(3000 + seed, 303);
    let run = states(&mut model, &truth, 100)?;
    let sigma = 2f64.sqrt();
    let seen = (1..=10).map(|j| {
        let y: Vec<f64> = run[10 * j].iter().zip(&noise[3 * j..]).map(|(x, e)| x + sigma * e).collect();
        observation(&[0, 1, 2], 10 * j, 0.0, &y, sigma)
    });
    let set = ObservationSet::new(100, vec![all_of(3)?], seen.collect())?;
    Ok((truth, background, set))
}

/// n + 1 members around `mean` whose covariance is B: an ensemble that spans.
pub fn spanning(b: &dyn Covariance, mean: &[f64]) -> Vec<f64> {
    let n = b.dim();
    // The Helmert basis: n vectors of length n + 1, orthonormal and orthogonal to (1, …, 1).
    let mut members = mean.repeat(n + 1);
    let (mut unit, mut column) = (vec![0.0; n], vec![0.0; n]);
    for j in 0..n {
        unit[j] = 1.0;
        b.root(&unit, &mut column);
        unit[j] = 0.0;
        let length = (((j + 1) * (j + 2)) as f64).sqrt();
        for (i, member) in members.chunks_exact_mut(n).take(j + 2).enumerate() {
            let h = (n as f64).sqrt() * if i <= j { 1.0 } else { -((j + 1) as f64) } / length;
            member.iter_mut().zip(&column).for_each(|(x, c)| *x += h * c);
        }
    }
    members
}

/// Five members for the variables of [`RING`], localized.
///
/// # Errors
/// None in practice.
pub fn localized() -> Result<Ensemble> {
    let distance = |i: usize, j: usize| i.abs_diff(j) as f64;
    let taper = Taper::GaspariCohn { support: 5.0 };
    let members: Vec<f64> = normals(4, 5 * RING).iter().map(|x| 0.3 * x).collect();
    Ok(Ensemble::new(&members, Localization::by_distance(taper, RING, distance, 0.0)?)?)
}

/// Lorenz 1996 with N variables over 100 steps of 0.01, every second variable seen every tenth step with R =
/// I, B = 0.25 I: background, observations, and the point x_b + 0.1 sin i in the control variable.
///
/// # Errors
/// None in practice.
pub fn lorenz96_window(n: usize) -> Result<(Vec<f64>, ObservationSet, Vec<f64>)> {
    let truth: Vec<f64> = (0..n).map(|i| 8.0 + 4.0 * (0.9 * i as f64).sin()).collect();
    let background: Vec<f64> =
        truth.iter().enumerate().map(|(i, x)| x + 0.5 * (2.3 * i as f64 + 1.0).cos()).collect();
    let mut model = Rk4::new(Lorenz96::new(n, 8.0), 0, 0.01);
    let mut observations = Vec::new();
    let (mut x, mut next) = (truth, vec![0.0; n]);
    for k in 0..100 {
        model.step(k, &x, &mut next)?;
        std::mem::swap(&mut x, &mut next);
        let step = k + 1;
        if step % 10 == 0 {
            let y = |j: usize| x[2 * j] + (12.9898 * (step * n + j) as f64).sin();
            let (rows, values) = ((0..n / 2).collect(), (0..n / 2).map(y).collect());
            observations.push(Observation::new(step, rows, values, 1.0));
        }
    }
    let even = Selection::new((0..n).step_by(2).collect(), n)?;
    let set = ObservationSet::new(100, vec![Box::new(even)], observations)?;
    // v = (x − x_b)/σ with σ = ½
    let v = (0..n).map(|i| 0.2 * (i as f64).sin()).collect();
    Ok((background, set, v))
}
