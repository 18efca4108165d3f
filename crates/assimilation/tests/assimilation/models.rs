//! Small models with hand-written derivatives, and problems made of them.

use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use varda_assimilation::{At, Observation, ObservationOperator, ObservationSet, Refusal, Selection};
use varda_implicit::{ControlMap, Error, Model, Work};

pub(crate) fn normals(seed: u64, n: usize) -> Vec<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..n).map(|_| StandardNormal.sample(&mut rng)).collect()
}

pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

pub(crate) fn norm(a: &[f64]) -> f64 {
    dot(a, a).sqrt()
}

/// f(x), f'(x) dx and f'(x)ᵀ λ of an autonomous system.
pub(crate) trait Field {
    fn dim(&self) -> usize;
    fn value(&self, x: &[f64], f: &mut [f64]);
    fn tangent(&self, x: &[f64], dx: &[f64], df: &mut [f64]);
    fn adjoint(&self, x: &[f64], lambda: &[f64], dx: &mut [f64]);
}

pub(crate) struct Lorenz63;

impl Field for Lorenz63 {
    fn dim(&self) -> usize {
        3
    }
    fn value(&self, x: &[f64], f: &mut [f64]) {
        f[0] = 10.0 * (x[1] - x[0]);
        f[1] = x[0] * (28.0 - x[2]) - x[1];
        f[2] = x[0] * x[1] - 8.0 / 3.0 * x[2];
    }
    fn tangent(&self, x: &[f64], d: &[f64], f: &mut [f64]) {
        f[0] = 10.0 * (d[1] - d[0]);
        f[1] = d[0] * (28.0 - x[2]) - x[0] * d[2] - d[1];
        f[2] = d[0] * x[1] + x[0] * d[1] - 8.0 / 3.0 * d[2];
    }
    fn adjoint(&self, x: &[f64], l: &[f64], d: &mut [f64]) {
        d[0] = -10.0 * l[0] + (28.0 - x[2]) * l[1] + x[1] * l[2];
        d[1] = 10.0 * l[0] - l[1] + x[0] * l[2];
        d[2] = -x[0] * l[1] - 8.0 / 3.0 * l[2];
    }
}

pub(crate) struct Lorenz96(pub(crate) usize);

impl Field for Lorenz96 {
    fn dim(&self) -> usize {
        self.0
    }
    fn value(&self, x: &[f64], f: &mut [f64]) {
        let n = self.0;
        for i in 0..n {
            let (m2, m1, p1) = ((i + n - 2) % n, (i + n - 1) % n, (i + 1) % n);
            f[i] = (x[p1] - x[m2]) * x[m1] - x[i] + 8.0;
        }
    }
    fn tangent(&self, x: &[f64], d: &[f64], f: &mut [f64]) {
        let n = self.0;
        for i in 0..n {
            let (m2, m1, p1) = ((i + n - 2) % n, (i + n - 1) % n, (i + 1) % n);
            f[i] = (d[p1] - d[m2]) * x[m1] + (x[p1] - x[m2]) * d[m1] - d[i];
        }
    }
    fn adjoint(&self, x: &[f64], l: &[f64], d: &mut [f64]) {
        let n = self.0;
        d.fill(0.0);
        for i in 0..n {
            let (m2, m1, p1) = ((i + n - 2) % n, (i + n - 1) % n, (i + 1) % n);
            d[p1] += x[m1] * l[i];
            d[m2] -= x[m1] * l[i];
            d[m1] += (x[p1] - x[m2]) * l[i];
            d[i] -= l[i];
        }
    }
}

/// x' = A x, A by rows.
pub(crate) struct Linear(pub(crate) usize, pub(crate) Vec<f64>);

impl Field for Linear {
    fn dim(&self) -> usize {
        self.0
    }
    fn value(&self, x: &[f64], f: &mut [f64]) {
        f.iter_mut().zip(self.1.chunks(self.0)).for_each(|(f, a)| *f = dot(a, x));
    }
    fn tangent(&self, _x: &[f64], d: &[f64], f: &mut [f64]) {
        self.value(d, f);
    }
    fn adjoint(&self, _x: &[f64], l: &[f64], d: &mut [f64]) {
        d.fill(0.0);
        for (row, l) in self.1.chunks(self.0).zip(l) {
            d.iter_mut().zip(row).for_each(|(d, a)| *d += a * l);
        }
    }
}

/// Classical Runge–Kutta with its discrete tangent and adjoint. `mutation` is a relative error put into the
/// adjoint of step 0; states beyond `bound` are refused.
pub(crate) struct Rk4<F> {
    field: F,
    dt: f64,
    pub(crate) mutation: f64,
    pub(crate) bound: f64,
    /// The step and the stages of every slot.
    kept: Vec<Option<(usize, [Vec<f64>; 4])>>,
}

impl<F: Field> Rk4<F> {
    pub(crate) fn new(field: F, dt: f64) -> Self {
        Self { field, dt, mutation: 0.0, bound: 1e6, kept: (0..1000).map(|_| None).collect() }
    }

    fn stages(&self, x: &[f64]) -> ([Vec<f64>; 4], [Vec<f64>; 4]) {
        let n = self.field.dim();
        let (mut at, mut k): ([Vec<f64>; 4], [Vec<f64>; 4]) =
            (std::array::from_fn(|_| x.to_vec()), std::array::from_fn(|_| vec![0.0; n]));
        for s in 0..4 {
            if s > 0 {
                for i in 0..n {
                    at[s][i] = x[i] + [0.0, 0.5, 0.5, 1.0][s] * self.dt * k[s - 1][i];
                }
            }
            self.field.value(&at[s], &mut k[s]);
        }
        (at, k)
    }
}

const WEIGHTS: [f64; 4] = [1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0];
const NODES: [f64; 4] = [0.0, 0.5, 0.5, 1.0];

impl<F: Field> Model for Rk4<F> {
    fn dim(&self) -> usize {
        self.field.dim()
    }

    fn step(&mut self, k: usize, x: &[f64], x_next: &mut [f64]) -> Result<Work, Error> {
        let (_, slopes) = self.stages(x);
        for i in 0..x.len() {
            x_next[i] = x[i] + self.dt * (0..4).map(|s| WEIGHTS[s] * slopes[s][i]).sum::<f64>();
            if !(x_next[i].abs() < self.bound) {
                return Err(Error::NonFinite { step: k, what: "the state" });
            }
        }
        Ok(Work::default())
    }

    /// A linearization is at an accepted step: what errors of the model add to it does not belong there.
    fn linearize(&mut self, slot: usize, k: usize, x: &[f64], x_next: &[f64]) -> Result<Work, Error> {
        let mut accepted = x.to_vec();
        self.step(k, x, &mut accepted)?;
        assert_eq!(accepted, x_next, "linearized away from the step");
        self.kept[slot] = Some((k, self.stages(x).0));
        Ok(Work::default())
    }

    fn tangent(&mut self, slot: usize, dx: &mut [f64]) {
        dx.chunks_exact_mut(self.field.dim()).for_each(|dx| self.tangent_of_one(slot, dx));
    }

    fn adjoint(&mut self, slot: usize, lambda: &mut [f64]) {
        lambda.chunks_exact_mut(self.field.dim()).for_each(|lambda| self.adjoint_of_one(slot, lambda));
    }

    fn release(&mut self, from_slot: usize) {
        self.kept[from_slot..].fill(None);
    }

    fn slot_bytes(&self) -> usize {
        4 * self.dim() * size_of::<f64>()
    }

    fn bytes(&self) -> usize {
        self.kept.iter().flatten().count() * self.slot_bytes()
    }

    fn control_map(&mut self) -> Option<&mut dyn ControlMap> {
        None
    }
}

impl<F: Field> Rk4<F> {
    fn tangent_of_one(&self, slot: usize, dx: &mut [f64]) {
        let (_, at) = self.kept[slot].as_ref().expect("linearized");
        let (mut slope, mut sum) = (vec![0.0; dx.len()], dx.to_vec());
        for s in 0..4 {
            let stage: Vec<f64> = dx.iter().zip(&slope).map(|(d, k)| d + NODES[s] * self.dt * k).collect();
            self.field.tangent(&at[s], &stage, &mut slope);
            sum.iter_mut().zip(&slope).for_each(|(sum, k)| *sum += self.dt * WEIGHTS[s] * k);
        }
        dx.copy_from_slice(&sum);
    }

    fn adjoint_of_one(&self, slot: usize, lambda: &mut [f64]) {
        let (k, at) = self.kept[slot].as_ref().expect("linearized");
        let (mut sum, mut carried, mut back) = (lambda.to_vec(), vec![0.0; lambda.len()], lambda.to_vec());
        for s in (0..4).rev() {
            let mu: Vec<f64> =
                lambda.iter().zip(&carried).map(|(l, c)| self.dt * WEIGHTS[s] * l + c).collect();
            self.field.adjoint(&at[s], &mu, &mut back);
            sum.iter_mut().zip(&back).for_each(|(sum, b)| *sum += b);
            carried.iter_mut().zip(&back).for_each(|(c, b)| *c = NODES[s] * self.dt * b);
        }
        lambda.copy_from_slice(&sum);
        if *k == 0 {
            lambda[0] *= 1.0 + self.mutation;
        }
    }
}

/// The state after each of `steps` steps.
pub(crate) fn run(model: &mut dyn Model, x: &[f64], steps: usize) -> Vec<Vec<f64>> {
    let mut states = vec![x.to_vec()];
    for k in 0..steps {
        let mut next = x.to_vec();
        model.step(k, &states[k], &mut next).unwrap();
        states.push(next);
    }
    states
}

pub(crate) fn all_of(n: usize) -> Box<dyn ObservationOperator> {
    Box::new(Selection::new((0..n).collect(), n).unwrap())
}

/// y = (x₀², x₀ x₁): a curved operator, to be told from its linearization.
pub(crate) struct Products(pub(crate) usize);

impl ObservationOperator for Products {
    fn dim(&self) -> usize {
        2
    }
    fn state_dim(&self) -> usize {
        self.0
    }
    fn observe(&mut self, _at: At, x: &[f64], y: &mut [f64]) -> Result<(), Refusal> {
        if x[0] > 100.0 {
            return Err(Refusal::new("too far"));
        }
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

pub(crate) fn observation(
    rows: &[usize],
    step: usize,
    weight: f64,
    values: &[f64],
    sigma: f64,
) -> Observation {
    Observation::new(step, rows.to_vec(), values.to_vec(), sigma).between(weight)
}

/// A twin on Lorenz-63: a truth on the attractor, a background drawn around it with B = I, all three
/// components seen every `every` steps of 0.01 with R = 2 I.
pub(crate) fn lorenz63_twin(seed: u64, steps: usize, every: usize) -> (Vec<f64>, Vec<f64>, ObservationSet) {
    let mut model = Rk4::new(Lorenz63, 0.01);
    let start: Vec<f64> = normals(1000 + seed, 3).iter().map(|x| 5.0 * x).collect();
    let truth = run(&mut model, &start, 900).pop().unwrap();
    let background: Vec<f64> = truth.iter().zip(normals(2000 + seed, 3)).map(|(x, e)| x + e).collect();
    let noise = normals(3000 + seed, 3 * (steps + 1));
    let states = run(&mut model, &truth, steps);
    let observations = (1..=steps / every)
        .map(|j| {
            let y: Vec<f64> =
                states[j * every].iter().zip(&noise[3 * j..]).map(|(x, e)| x + 2f64.sqrt() * e).collect();
            observation(&[0, 1, 2], j * every, 0.0, &y, 2f64.sqrt())
        })
        .collect();
    (truth, background, ObservationSet::new(steps, vec![all_of(3)], observations).unwrap())
}
