//! What is gained by leaving out what a problem does not need: seconds and bytes.

use super::clock::timed;
use super::{Options, Page, Result, Table};
use crate::cells;
use problems::allocations::heap;
use problems::rods::{DrivenRod, HangingRod, wave};
use problems::small_problems::difference;
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use varda_assimilation::{
    ControlTransform, CostFunction, LanczosOptions, LeastSquares, LowRankPosterior, ObservationSet,
    Posterior, StrongConstraint,
};
use varda_covariance::{Covariance, Dense};
use varda_implicit::{ImplicitModel, Model, Storage};
use varda_rod::{RodStep, TwistUnknowns};

pub(super) fn run(options: &Options) -> Result<Page> {
    let mut benchmark = Benchmark {
        samples: options.samples(),
        table: Table::new(
            "variants",
            "",
            &[
                "task",
                "variant",
                "ms",
                "ms (least)",
                "heap, peak KiB",
                "time, in the first",
                "heap, in the first",
                "what differs",
            ],
        ),
        first: (f64::NAN, f64::NAN),
    };
    benchmark.steps()?;
    benchmark.windows()?;
    benchmark.storage()?;
    benchmark.posteriors()?;
    benchmark.covariances()?;
    Ok(Page {
        title: "What is left out, and what that saves",
        text: TEXT.into(),
        tables: vec![benchmark.table],
        ..Page::default()
    })
}

const TEXT: &str = "\
The first row of each task is how a scene does it, the others are alternatives. *Heap*: the most memory \
in use at once while the task was set up and done once, counted by the allocator. *What differs*: \
relative difference of the results. Flagship: the [hanging rod](../reference-problems.md#hanging-rod), \
case 1, with 144 controls and 120 observations.";

struct Benchmark {
    samples: usize,
    table: Table,
    /// Seconds and bytes of the first variant of the task.
    first: (f64, f64),
}

impl Benchmark {
    /// One variant: `set_up` gives the work, which gives a number to compare with that of the first variant.
    fn variant(
        &mut self,
        task: &str,
        variant: &str,
        differs: Option<f64>,
        work: &mut dyn FnMut() -> Result<()>,
    ) -> Result<()> {
        let (memory, done) = heap(&mut *work);
        done?;
        let timing = timed(self.samples, work)?;
        let peak = memory.peak as f64 / 1024.0;
        let new = self.table.rows.last().is_none_or(|r| r[0] != task.into());
        if new {
            self.first = (timing.least, peak);
        }
        self.table.push(cells![
            task,
            variant,
            1e3 * timing.median,
            1e3 * timing.least,
            peak,
            timing.least / self.first.0,
            peak / self.first.1,
            differs
        ]);
        Ok(())
    }

    fn steps(&mut self) -> Result<()> {
        let task = "100 steps of the driven rod";
        let run = |twist| -> Result<Vec<f64>> {
            let (mut model, mut x) = DrivenRod { twist, ..DrivenRod::SOFT }.model(0.02)?;
            let mut next = x.clone();
            for k in 0..100 {
                model.step(k, &x, &mut next)?;
                std::mem::swap(&mut x, &mut next);
            }
            x.truncate(3 * 24);
            Ok(x)
        };
        let (left_out, full) = (TwistUnknowns::WhereNeeded, TwistUnknowns::Always);
        let differs = difference(&run(full)?, &run(left_out)?);
        self.variant(task, "no angles", None, &mut || run(left_out).map(drop))?;
        self.variant(task, "angles", Some(differs), &mut || run(full).map(drop))
    }

    fn windows(&mut self) -> Result<()> {
        let task = "J and ∇J of the flagship";
        let gradient = |twist| -> Result<Vec<f64>> {
            let mut window = Window::new(twist)?;
            window.with(&mut |cost, v, g| cost.evaluate(v, Some(g)).map(drop).map_err(Into::into))
        };
        let (left_out, full) = (TwistUnknowns::WhereNeeded, TwistUnknowns::Always);
        let differs = difference(&gradient(full)?, &gradient(left_out)?);
        for (variant, twist, differs) in [("no angles", left_out, None), ("angles", full, Some(differs))] {
            let mut window = Window::new(twist)?;
            self.variant(task, variant, differs, &mut || {
                window
                    .with(&mut |cost, v, g| cost.evaluate(v, Some(g)).map(drop).map_err(Into::into))
                    .map(drop)
            })?;
        }
        Ok(())
    }

    /// Memory against work: the gradient and a product with the Hessian under every storage policy.
    fn storage(&mut self) -> Result<()> {
        let task = "J, ∇J and one product A v of the flagship";
        let policies = [
            ("all linearizations kept", Storage::KeepAll),
            ("states kept, refactoring", Storage::States),
            ("10 checkpoints", Storage::Checkpoints { states: 10 }),
            ("3 checkpoints", Storage::Checkpoints { states: 3 }),
        ];
        let mut first = Vec::new();
        for (variant, storage) in policies {
            let mut window = Window::new(TwistUnknowns::WhereNeeded)?;
            let mut product = Vec::new();
            let mut run = || {
                window.with(&mut |cost, v, g| {
                    cost.set_storage(storage);
                    cost.evaluate(v, Some(g))?;
                    product.resize(v.len(), 0.0);
                    Ok(cost.hessian_apply(v, &mut product)?)
                })
            };
            let result = run()?;
            let differs = (!first.is_empty()).then(|| difference(&result, &first));
            self.variant(task, variant, differs, &mut || run().map(drop))?;
            if first.is_empty() {
                first = result;
            }
        }
        Ok(())
    }

    /// σ of the analysis by a few products with the Hessian, and by all of it.
    fn posteriors(&mut self) -> Result<()> {
        let task = "σ_a of the flagship, from its gradient on";
        let lanczos = |cost: &mut StrongConstraint, out: &mut [f64]| -> Result<()> {
            let mut rng = ChaCha8Rng::seed_from_u64(1);
            let posterior = LowRankPosterior::lanczos(cost, &LanczosOptions::default(), &mut rng)?;
            out.copy_from_slice(&posterior.variance(cost.transform()));
            Ok(())
        };
        let dense = |cost: &mut StrongConstraint, out: &mut [f64]| -> Result<()> {
            out.copy_from_slice(&Posterior::new(cost)?.variance(cost.transform()));
            Ok(())
        };
        type Way<'w> = &'w dyn Fn(&mut StrongConstraint, &mut [f64]) -> Result<()>;
        let ways: [(&str, Way); 2] = [("dense Hessian", &dense), ("Krylov: Lanczos to 1e-6", &lanczos)];
        let mut exact = Vec::new();
        for (variant, way) in ways {
            let mut window = Window::new(TwistUnknowns::WhereNeeded)?;
            let samples = self.samples;
            let (mut memory, mut timing, mut variance) = (0, None, Vec::new());
            window.with(&mut |cost, v, g| {
                cost.evaluate(v, Some(g))?;
                let mut out = vec![0.0; v.len()];
                let (used, done) = heap(|| way(cost, &mut out));
                done?;
                memory = used.peak;
                timing = Some(timed(samples, || way(cost, &mut out))?);
                variance = out;
                Ok(())
            })?;
            let timing = timing.ok_or("not run")?;
            let peak = memory as f64 / 1024.0;
            let differs = if exact.is_empty() {
                self.first = (timing.least, peak);
                exact = variance;
                None
            } else {
                Some(difference(&variance, &exact))
            };
            let (time, heap) = (timing.least / self.first.0, peak / self.first.1);
            self.table.push(cells![
                task,
                variant,
                1e3 * timing.median,
                1e3 * timing.least,
                peak,
                time,
                heap,
                differs
            ]);
        }
        Ok(())
    }

    /// B as the same small block for x, y, z, and as one matrix.
    fn covariances(&mut self) -> Result<()> {
        let task = "B of the flagship and 1000 products B^{1/2} v";
        let (rod, truth) = HangingRod::flagship(1, true)?;
        let n = truth.len();
        let v: Vec<f64> = (0..n).map(|i| wave(i, 1)).collect();
        let matrix = {
            let b = rod.background_covariance()?;
            let (mut unit, mut matrix) = (vec![0.0; n], vec![0.0; n * n]);
            for (j, column) in matrix.chunks_exact_mut(n).enumerate() {
                unit[j] = 1.0;
                b.apply(&unit, column);
                unit[j] = 0.0;
            }
            matrix
        };
        let products = |b: &dyn Covariance| -> Vec<f64> {
            let mut x = vec![0.0; n];
            (0..1000).for_each(|_| b.root(&v, &mut x));
            x
        };
        let differs = {
            let (blocks, whole) = (rod.background_covariance()?, Dense::new(n, &matrix)?);
            let (mut by_blocks, mut by_whole) = (vec![0.0; n], vec![0.0; n]);
            blocks.apply(&v, &mut by_blocks);
            whole.apply(&v, &mut by_whole);
            difference(&by_whole, &by_blocks)
        };
        self.variant(task, "one block of 24 for x, y, z", None, &mut || {
            products(&rod.background_covariance()?);
            Ok(())
        })?;
        self.variant(task, "dense, 144 × 144", Some(differs), &mut || {
            products(&Dense::new(n, &matrix)?);
            Ok(())
        })
    }
}

/// What is done with the cost of a window, a point v that is new every time, and a gradient's place.
type Use<'u> = &'u mut dyn FnMut(&mut StrongConstraint, &[f64], &mut [f64]) -> Result<()>;

/// The flagship's window, case 1 with the prior conditioned on the clamp.
struct Window {
    rod: HangingRod,
    truth: Vec<f64>,
    twist: TwistUnknowns,
}

impl Window {
    fn new(twist: TwistUnknowns) -> Result<Window> {
        let (rod, truth) = HangingRod::flagship(1, true)?;
        Ok(Window { rod, truth, twist })
    }

    /// Makes the cost, uses it at a point of its prior and returns the gradient.
    fn with(&mut self, user: Use) -> Result<Vec<f64>> {
        let rod = &self.rod;
        let observations = rod.observe(&self.truth, &mut || 0.0)?;
        let mut model: ImplicitModel<RodStep> = rod.model_with(rod.first_step, self.twist)?;
        let mut set: ObservationSet = rod.observation_set(model.dim(), observations)?;
        let b = rod.background_covariance()?;
        let mut cost =
            StrongConstraint::new(&mut model, ControlTransform::new(self.truth.clone(), &b)?, &mut set)?;
        let v: Vec<f64> = (0..cost.dim()).map(|i| 0.1 * wave(i, 3)).collect();
        let mut g = vec![0.0; v.len()];
        user(&mut cost, &v, &mut g)?;
        Ok(g)
    }
}
