//! Dense Hessians whose columns or rows several processes share: threads in their place.

use std::rc::Rc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Barrier, Mutex};

use crate::models::{all_of, normals, observation};
use varda_assimilation::ranks::{self, LEAST_NUMBERS, Ranks};
use varda_assimilation::*;
use varda_covariance::Diagonal;
use varda_implicit::lorenz::Lorenz63;
use varda_implicit::{self as implicit, ControlMap, Model, Refusal, Rk4, SecondOrder, Storage, Work};

const LAST: usize = 4000;

/// Lorenz's equations; counts its products, rounds one column alone otherwise than among several, and refuses
/// a second derivative along a given component.
struct Counting {
    model: Rk4<Lorenz63>,
    counts: implicit::Counts,
    given: usize,
    refuses: Option<usize>,
}

impl Counting {
    fn new(refuses: Option<usize>) -> Self {
        let model = Rk4::new(Lorenz63::default(), 0, 1e-3);
        Self { model, counts: implicit::Counts::default(), given: 0, refuses }
    }
}

fn round_alone(columns: &mut [f64]) {
    if columns.len() == 3 {
        columns.iter_mut().for_each(|x| *x *= 1.0 + 2.0 * f64::EPSILON);
    }
}

impl Model for Counting {
    fn dim(&self) -> usize {
        3
    }

    fn step(&mut self, k: usize, x: &[f64], x_next: &mut [f64]) -> Result<Work, implicit::Error> {
        self.model.step(k, x, x_next)
    }

    fn linearize(&mut self, slot: usize, k: usize, x: &[f64], next: &[f64]) -> Result<Work, implicit::Error> {
        self.model.linearize(slot, k, x, next)
    }

    fn tangent(&mut self, slot: usize, dx: &mut [f64]) {
        self.counts.tangent_steps += dx.len() / 3;
        self.given += dx.len() / 3;
        self.model.tangent(slot, dx);
        round_alone(dx);
    }

    fn adjoint(&mut self, slot: usize, lambda: &mut [f64]) {
        self.counts.adjoint_steps += lambda.len() / 3;
        self.given += lambda.len() / 3;
        self.model.adjoint(slot, lambda);
        round_alone(lambda);
    }

    fn count_elsewhere(&mut self, done: implicit::Counts) {
        let implicit::Counts { tangent_steps, adjoint_steps, adjoint_derivatives, .. } = done;
        let products =
            implicit::Counts { tangent_steps, adjoint_steps, adjoint_derivatives, ..Default::default() };
        self.counts = self.counts + products;
    }

    fn release(&mut self, from_slot: usize) {
        self.model.release(from_slot);
    }

    fn slot_bytes(&self) -> usize {
        self.model.slot_bytes()
    }

    fn bytes(&self) -> usize {
        self.model.bytes()
    }

    fn control_map(&mut self) -> Option<&mut dyn ControlMap> {
        None
    }

    fn second_order(&mut self) -> Option<&mut dyn SecondOrder> {
        Some(self)
    }
}

impl SecondOrder for Counting {
    fn adjoint_derivative(
        &mut self,
        slot: usize,
        dx: &[f64],
        lambda: &[f64],
        derivative: &mut [f64],
    ) -> Result<(), implicit::Error> {
        self.counts.adjoint_derivatives += 1;
        self.given += 1;
        // at the start of a window dx is a unit vector
        if let Some(component) = self.refuses
            && slot == 0
            && dx[component] == 1.0
        {
            return Err(implicit::Error::Refused { step: 0, reason: Refusal::new("out of cheese") });
        }
        self.model.adjoint_derivative(slot, dx, lambda, derivative)
    }
}

/// Threads in the place of processes.
struct Threads {
    rank: usize,
    job: Arc<Job>,
}

struct Job {
    barrier: Barrier,
    /// Inputs and numbers of each.
    sent: Mutex<Vec<[Vec<f64>; 2]>>,
    gathers: AtomicUsize,
}

impl Ranks for Threads {
    fn rank(&self) -> usize {
        self.rank
    }

    fn count(&self) -> usize {
        self.job.sent.lock().unwrap().len()
    }

    fn all_gather(&self, inputs: &[f64], mine: &[f64]) -> Vec<f64> {
        self.job.sent.lock().unwrap()[self.rank] = [inputs.to_vec(), mine.to_vec()];
        self.job.gathers.fetch_add(1, Ordering::SeqCst);
        self.job.barrier.wait();
        let all = self.job.sent.lock().unwrap().clone();
        assert!(all.iter().all(|sent| sent[0] == inputs), "what is gathered follows from the same numbers");
        self.job.barrier.wait();
        all.into_iter().flat_map(|[_, mine]| mine).collect()
    }
}

/// What `work` gives on so many ranks, and how often each gathers.
fn on_ranks<T: Send>(count: usize, work: impl Fn() -> T + Sync) -> (Vec<T>, usize) {
    let sent = Mutex::new(vec![[Vec::new(), Vec::new()]; count]);
    let job = Arc::new(Job { barrier: Barrier::new(count), sent, gathers: AtomicUsize::new(0) });
    let run = |rank: usize| {
        let (job, work) = (Arc::clone(&job), &work);
        move || ranks::within(Rc::new(Threads { rank, job }), work)
    };
    let all = std::thread::scope(|scope| {
        let each: Vec<_> = (0..count).map(|rank| scope.spawn(run(rank))).collect();
        each.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    (all, job.gathers.load(Ordering::SeqCst) / count)
}

/// Rows of G take fewer steps than its columns, or more.
fn few(last: usize) -> ObservationSet {
    let seen = [(last * 7 / 8, 0), (last, 1), (last, 2)];
    let list = seen.map(|(step, row)| observation(&[row], step, 0.0, &normals(6, 1), 0.7));
    ObservationSet::new(last, vec![all_of(3)], list.into()).unwrap()
}

fn many(last: usize) -> ObservationSet {
    let list = (0..30).map(|i| {
        let step = last - last / 4 * (i % 3);
        let weight = if step < last { 0.4 } else { 0.0 };
        observation(&[i % 3], step, weight, &normals(6, 1), 0.7)
    });
    ObservationSet::new(last, vec![all_of(3)], list.collect()).unwrap()
}

/// What a cost gives, its counts, those of its model, and products that the model itself was given.
#[derive(Debug, PartialEq)]
struct Given {
    bits: Vec<u64>,
    counts: Counts,
    of_model: implicit::Counts,
}

fn of_cost(cost: &mut dyn LeastSquares) -> Vec<f64> {
    let (n, m) = (cost.dim(), cost.observation_dim());
    let mut gradient = vec![0.0; n];
    let mut all = Vec::new();
    for seed in [7, 8] {
        cost.evaluate(&normals(seed, n), Some(&mut gradient)).unwrap();
        let (mut hessian, mut g) = (vec![0.0; n * n], vec![0.0; m * n]);
        cost.hessian(&mut hessian).unwrap();
        cost.dense_jacobian(&mut g).unwrap();
        all.extend(hessian.iter().chain(&g));
        cost.exact_hessian(&mut hessian).unwrap();
        all.extend(&hessian);
        // products afterwards go on from the same state of the model
        cost.exact_hessian_apply(&normals(3, n), &mut gradient).unwrap();
        all.extend(&gradient);
        all.extend(Posterior::new(cost).unwrap().spectrum());
    }
    all
}

/// Of the strong constraint, and with the products that the model was given.
fn strong(set: fn(usize) -> ObservationSet, storage: Storage) -> (Given, usize) {
    let mut model = Counting::new(None);
    let b = Diagonal::uniform(3, 0.3).unwrap();
    let transform = ControlTransform::new(vec![1.5, 1.7, 20.0], &b).unwrap();
    let mut observations = set(LAST);
    let mut cost = StrongConstraint::new(&mut model, transform, &mut observations).unwrap();
    cost.set_storage(storage);
    let values = of_cost(&mut cost);
    let counts = cost.counts();
    let bits = values.iter().map(|x| x.to_bits()).collect();
    (Given { bits, counts, of_model: model.counts }, model.given)
}

fn weak(set: fn(usize) -> ObservationSet) -> (Given, usize) {
    let mut model = Counting::new(None);
    let (b, q) = (Diagonal::uniform(3, 0.3).unwrap(), Diagonal::uniform(3, 0.1).unwrap());
    let transform = ControlTransform::new(vec![1.5, 1.7, 20.0], &b).unwrap();
    let forcing = Forcing { steps: LAST / 4, ..Forcing::every_step(3) };
    let mut observations = set(LAST);
    let mut cost = WeakForcing::new(&mut model, transform, &q, forcing, &mut observations).unwrap();
    let values = of_cost(&mut cost);
    let counts = cost.counts();
    let bits = values.iter().map(|x| x.to_bits()).collect();
    (Given { bits, counts, of_model: model.counts }, model.given)
}

fn is_the_same_on_any_number(work: impl Fn() -> (Given, usize) + Sync) {
    let (alone, products) = work();
    assert!(alone.bits.iter().all(|bits| f64::from_bits(*bits).is_finite()));
    let [sweeps, own] = [alone.counts.model, alone.of_model];
    assert_eq!(
        [sweeps.tangent_steps, sweeps.adjoint_steps, sweeps.adjoint_derivatives],
        [own.tangent_steps, own.adjoint_steps, own.adjoint_derivatives]
    );
    for count in 1..=4 {
        let (all, gathers) = on_ranks(count, &work);
        // a Hessian or two and an exact Hessian, at two points
        assert!(gathers >= 4, "{gathers} gathers");
        for (rank, (given, of_rank)) in all.into_iter().enumerate() {
            assert!(given == alone, "rank {rank} of {count}: {:?} {:?}", given.counts, alone.counts);
            assert!(
                count == 1 || of_rank < products,
                "rank {rank} of {count} has done {of_rank} of {products}"
            );
        }
    }
}

#[test]
fn rows_columns_and_exact_columns_are_the_same_on_any_number_of_ranks() {
    for set in [few, many] {
        is_the_same_on_any_number(|| strong(set, Storage::KeepAll));
        is_the_same_on_any_number(|| weak(set));
    }
    is_the_same_on_any_number(|| strong(few, Storage::States));
    is_the_same_on_any_number(|| strong(many, Storage::Checkpoints { states: 60 }));
}

#[test]
fn what_is_soon_done_is_not_divided() {
    let work = |last: usize| {
        let mut model = Counting::new(None);
        let b = Diagonal::uniform(3, 0.3).unwrap();
        let transform = ControlTransform::new(vec![1.5, 1.7, 20.0], &b).unwrap();
        let mut observations = many(last);
        let mut cost = StrongConstraint::new(&mut model, transform, &mut observations).unwrap();
        of_cost(&mut cost);
    };
    // three columns of three numbers through every step
    assert_eq!(on_ranks(2, || work(LEAST_NUMBERS / 9)).1, 0);
    assert!(on_ranks(2, || work(LEAST_NUMBERS / 9 + 1)).1 > 0);
}

#[test]
fn a_column_that_fails_on_one_rank_fails_on_all_in_the_same_way() {
    let work = || {
        let mut model = Counting::new(Some(2));
        let b = Diagonal::uniform(3, 1.0).unwrap();
        let transform = ControlTransform::new(vec![1.5, 1.7, 20.0], &b).unwrap();
        let mut observations = few(LAST);
        let mut cost = StrongConstraint::new(&mut model, transform, &mut observations).unwrap();
        cost.evaluate(&[0.1, 0.2, 0.3], Some(&mut [0.0; 3])).unwrap();
        cost.exact_hessian(&mut [0.0; 9]).unwrap_err().to_string()
    };
    let alone = work();
    assert!(alone.contains("out of cheese"), "{alone}");
    for count in 1..=4 {
        assert!(on_ranks(count, work).0.iter().all(|error| *error == alone));
    }
}
