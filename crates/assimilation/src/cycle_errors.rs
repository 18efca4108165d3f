//! Windows of a sequence whose model errs.

use crate::cycle_members::truncate;
use crate::cycle_window::{
    Carry, Cycle, CyclePosterior, CycleState, CycledErrors, CycledEstimate, CycledMinimizer, Cycling, Ended,
    is_whole,
};
use crate::departures::{departures_at, expected_departures};
use crate::full_rank::FullRank;
use crate::{ControlTransform, Error, LeastSquares, StrongConstraint, WeakForcing, WeakPosterior, WeakState};
use varda_covariance::{Covariance, Precision};
use varda_linalg::shorter_root;

/// Most unknowns of a weak window whose posterior is handed out as a root; of more, and of fewer values, it
/// is the prior less what was learnt.
const MOST_ROOT_COLUMNS: usize = 1000;

impl Cycling<'_> {
    /// One window of 4D-Var with errors of the model: weak where they are estimated, else strong.
    pub(crate) fn erring(
        &self,
        state: &CycleState,
        b: &dyn Covariance,
        minimizer: CycledMinimizer,
        carry: Option<Carry>,
        errors: &CycledErrors,
    ) -> Result<(Cycle, CycleState), Error> {
        let mut observations = self.unseen(state.next)?;
        let m = observations.dim();
        let mut model = (self.make_model)(self.first_step(state.next));
        let over_states = match errors.estimated {
            CycledEstimate::States { b: first, q } => Some((first, q)),
            CycledEstimate::No | CycledEstimate::Forcing => None,
        };
        let carried_b = match over_states {
            Some(_) if !state.columns.is_empty() => Some(FullRank::new(b)?),
            _ => None,
        };
        let b: &dyn Covariance = carried_b.as_ref().map_or(b, |b| b);
        let z_b = &state.background;
        let transform = ControlTransform::new(z_b.clone(), b)?;
        let (n, n_z, head) = (model.dim(), transform.control_dim(), transform.dim());
        let forcing = errors.forcing.clone();
        let (mut states, mut weak, mut strong);
        let mut v = Vec::new();
        let cost: &mut dyn LeastSquares = match errors.estimated {
            CycledEstimate::States { b: first, q } => {
                let b: &dyn Precision = carried_b.as_ref().map_or(first, |b| b);
                states = WeakState::new(&mut *model, z_b.clone(), b, q, forcing, &mut observations)?;
                v = states.background()?;
                &mut states
            }
            CycledEstimate::Forcing => {
                weak =
                    WeakForcing::new(&mut *model, transform.clone(), errors.q, forcing, &mut observations)?;
                &mut weak
            }
            CycledEstimate::No => {
                strong = StrongConstraint::new(&mut *model, transform.clone(), &mut observations)?;
                &mut strong
            }
        };
        v.resize(cost.dim(), 0.0);
        let (background, predicted) = expected_departures(cost, &v, state.next, self.cycles)?;
        let minimum = minimizer.minimize(cost, &mut v)?;
        let departures = departures_at(cost, &v, &background, predicted);
        let mut whitened = v.clone();
        if over_states.is_some() {
            cost.linearize(&v, &mut vec![0.0; v.len()])?;
            cost.departures(&mut whitened, &mut vec![0.0; m]);
        }
        let asked = self.posterior && is_whole(minimum.status);
        let found = match carry {
            Some(_) => {
                cost.linearize(&v, &mut vec![0.0; v.len()])?;
                Some(WeakPosterior::new(cost)?)
            }
            None => None,
        };
        let root = found.as_ref().map_or(Vec::new(), WeakPosterior::root);
        let counts = cost.counts();
        let with_errors = |posterior: &WeakPosterior| {
            CyclePosterior::WithErrors(posterior.with_errors(&transform, errors.q, MOST_ROOT_COLUMNS))
        };
        let posterior = match (asked, &found) {
            (false, _) => None,
            (true, Some(found)) => Some(with_errors(found)),
            (true, None) => {
                cost.linearize(&v, &mut vec![0.0; v.len()])?;
                Some(CyclePosterior::of(WeakPosterior::new(cost), |found| with_errors(&found))?)
            }
        };

        let mut z = vec![0.0; n_z];
        match over_states {
            Some(_) => z.copy_from_slice(&v[..n_z]),
            None => transform.control(&v[..head], &mut z),
        }
        let eta = errors.values(&whitened[head..]);
        let (mut x_b, mut x) = (vec![0.0; n], vec![0.0; n]);
        model.initial_state(&state.background, &mut x_b)?;
        model.initial_state(&z, &mut x)?;
        let x_a = x.clone();
        let mut carried = Carried::new(errors, &root, v.len(), head, carry.map_or(1.0, |c| c.inflation), n);
        let mut dz = vec![0.0; n_z];
        for (dv, dx) in carried.root.chunks_exact(v.len().max(1)).zip(carried.columns.chunks_exact_mut(n)) {
            transform.tangent(&dv[..head], &mut dz);
            model.initial_tangent(&dz, dx);
        }
        let mut landing = vec![0.0; n];
        let (mut next, mut end) = (x.clone(), x.clone());
        for k in 0..self.steps() {
            model.step(k, &x, &mut landing)?;
            if carry.is_some() && k < self.shift {
                model.linearize(0, k, &x, &landing)?;
                model.tangent(0, &mut carried.columns);
                carried.enter(k);
            }
            errors.add(k, &eta, &mut landing);
            std::mem::swap(&mut x, &mut landing);
            if k + 1 == self.shift {
                next.copy_from_slice(&x);
            }
            if k + 1 == self.window {
                end.copy_from_slice(&x);
            }
        }
        let (mut columns, mut dropped) = (Vec::new(), 0.0);
        if let Some(carry) = carry {
            columns = carried.columns.chunks_exact(n).flat_map(|dx| &dx[..n_z]).copied().collect();
            // Errors add columns window by window: never more than the control is long, and without what has
            // no variance but rounding's, unless its inverse is asked for.
            let least = match (columns.len() > n_z * n_z, over_states) {
                (false, _) => 0.0,
                (true, None) => f64::EPSILON,
                (true, Some(_)) => {
                    columns = shorter_root(n_z, &columns)?;
                    0.0
                }
            };
            (columns, dropped) = truncate(n_z, columns, carry.dropped.max(least))?;
        }
        let from = Ended {
            minimum,
            counts,
            sigma: carry.map(|carry| carry.sigma(n_z, &columns)),
            errors: self.errors(state.next, [&x_b, &x_a, &end]),
            departures,
            inflation: carry.map_or(1.0, |carry| carry.inflation),
            drawn_again: 0,
            columns: columns.len() / n_z,
            dropped,
            model_errors: eta,
            posterior,
        };
        next.truncate(n_z);
        let after = CycleState { next: state.next + 1, background: next, columns };
        Ok((self.cycle(state, z, end, m, from), after))
    }
}

/// A root of the covariance of a state, by columns, on its way through a window whose model errs.
struct Carried<'a> {
    errors: &'a CycledErrors<'a>,
    /// A root of the covariance of the control (v, p_1 … p_N), by columns.
    root: Vec<f64>,
    /// Length of the control, and of v.
    dims: [usize; 2],
    n: usize,
    columns: Vec<f64>,
    /// The error that has columns of its own, and the first of them: one that nothing has estimated.
    open: Option<(usize, usize)>,
}

impl<'a> Carried<'a> {
    fn new(
        errors: &'a CycledErrors<'a>,
        root: &[f64],
        dim: usize,
        head: usize,
        inflation: f64,
        n: usize,
    ) -> Self {
        let root: Vec<f64> = root.iter().map(|w| inflation * w).collect();
        let columns = vec![0.0; root.len() / dim.max(1) * n];
        Self { errors, root, dims: [dim, head], n, columns, open: None }
    }

    /// W += E Q^{1/2} P_j after step k, P_j the rows of the root that belong to η_j; of an error that
    /// nothing has estimated, Q^{1/2} itself in columns of its own.
    fn enter(&mut self, k: usize) {
        let Some(j) = self.errors.forcing.index(k) else { return };
        let ([dim, head], q, n) = (self.dims, self.errors.q, self.n);
        let (first, mut eta) = (head + j * q.root_dim(), vec![0.0; q.dim()]);
        if first + q.root_dim() <= dim {
            for (w, dx) in self.root.chunks_exact(dim).zip(self.columns.chunks_exact_mut(n)) {
                q.root(&w[first..first + q.root_dim()], &mut eta);
                self.errors.place(&eta, dx);
            }
            return;
        }
        let start = match self.open {
            Some((open, start)) if open == j => start,
            _ => {
                let start = self.columns.len();
                self.columns.resize(start + q.root_dim() * n, 0.0);
                start
            }
        };
        self.open = Some((j, start));
        let mut unit = vec![0.0; q.root_dim()];
        for (i, dx) in self.columns[start..].chunks_exact_mut(n).enumerate() {
            unit[i] = 1.0;
            q.root(&unit, &mut eta);
            unit[i] = 0.0;
            self.errors.place(&eta, dx);
        }
    }
}

impl CycledErrors<'_> {
    /// η_j = Q^{1/2} p_j, one after the other.
    fn values(&self, p: &[f64]) -> Vec<f64> {
        let mut eta = vec![0.0; p.len() / self.q.root_dim().max(1) * self.q.dim()];
        for (p, eta) in p.chunks_exact(self.q.root_dim().max(1)).zip(eta.chunks_exact_mut(self.q.dim())) {
            self.q.root(p, eta);
        }
        eta
    }

    /// x += E η.
    fn place(&self, eta: &[f64], x: &mut [f64]) {
        self.forcing.components.iter().zip(eta).for_each(|(&c, eta)| x[c] += eta);
    }

    /// x += E η_j after step k, of errors one after the other; nothing beyond the last of them.
    fn add(&self, k: usize, eta: &[f64], x: &mut [f64]) {
        let size = self.q.dim();
        let error = self.forcing.index(k).and_then(|j| eta.get(j * size..(j + 1) * size));
        self.place(error.unwrap_or(&[]), x);
    }

    /// Adds to members of length n a draw each of the sum of the errors of so many steps, without moving
    /// their mean.
    pub(crate) fn draw(&self, members: &mut [f64], n: usize, steps: usize, window: usize) {
        // An error held over l steps adds up to l η.
        let mut times = vec![0.0; steps];
        (0..steps).filter_map(|k| self.forcing.index(k)).for_each(|j| times[j] += 1.0);
        let count = members.len() / n;
        let size = times.iter().map(|l| l * l).sum::<f64>().sqrt();
        if size == 0.0 || count < 2 {
            return;
        }
        let size = size * (count as f64 / (count - 1) as f64).sqrt();
        let mut normal = (self.normals)(window);
        let (mut xi, mut draws) = (vec![0.0; self.q.root_dim()], vec![0.0; count * self.q.dim()]);
        for draw in draws.chunks_exact_mut(self.q.dim()) {
            xi.fill_with(|| size * normal());
            self.q.root(&xi, draw);
        }
        let mean = crate::cycle_members::mean(&draws, self.q.dim());
        for (member, draw) in members.chunks_exact_mut(n).zip(draws.chunks_exact_mut(self.q.dim())) {
            draw.iter_mut().zip(&mean).for_each(|(d, mean)| *d -= mean);
            self.place(draw, member);
        }
    }
}
