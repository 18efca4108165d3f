//! Where and how often the model errs: what the two weak-constraint forms share.

use crate::Error;
use varda_covariance::{Covariance, Precision};

/// Where and how often the error of a model enters its state:
///
/// ```text
///     x_{k+1} = M_k(x_k) + E η_j
/// ```
///
/// with E placing η on `components` of the state. One Q for the whole window.
///
/// ```
/// use varda_assimilation::Forcing;
///
/// // A bias of the first two of three components, held over ten steps at a time.
/// let bias = Forcing { components: vec![0, 1], steps: 10, held: true };
/// assert_ne!(bias, Forcing::every_step(3));
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Forcing {
    /// The components of the state that are forced, as many as Q has rows. A component left out obeys the
    /// model exactly (of a rod, the angles: Q acts on [X, V]).
    pub components: Vec<usize>,
    /// Length n of a sub-window in steps; 1 is an error in every step.
    pub steps: usize,
    /// Whether η_j is held over the n steps of sub-window j, added after each of them (a bias of the model),
    /// or added once, at the end of the sub-window. Q is the covariance of one η_j either way.
    pub held: bool,
}

impl Forcing {
    /// All n components of the state after every step.
    pub fn every_step(n: usize) -> Self {
        Self { components: (0..n).collect(), steps: 1, held: false }
    }

    /// The index j of the η that enters after step k.
    pub fn index(&self, k: usize) -> Option<usize> {
        let n = self.steps;
        if self.held { Some(k / n) } else { (k + 1).is_multiple_of(n).then(|| (k + 1) / n - 1) }
    }
}

/// What the control is made of beyond the initial state.
#[derive(Clone, Copy)]
pub(super) enum WeakControl<'a> {
    /// Whitened forcing, η = Q^{1/2} p.
    Forcing { q: &'a dyn Covariance },
    /// The states at the ends of the sub-windows (and z itself).
    States { b: &'a dyn Precision, q: &'a dyn Precision },
}

/// Model error in a window that is run to step `last`.
pub(super) struct ModelErrorTerm<'a> {
    pub(super) over: WeakControl<'a>,
    forcing: Forcing,
    last: usize,
    physical: Vec<f64>,
    whitened: Vec<f64>,
}

impl<'a> ModelErrorTerm<'a> {
    pub(super) fn new(
        forcing: Forcing,
        over: WeakControl<'a>,
        state_dim: usize,
        last: usize,
    ) -> Result<Self, Error> {
        let q: &dyn Covariance = match over {
            WeakControl::Forcing { q } => q,
            WeakControl::States { q, .. } => q,
        };
        let found = forcing.components.len();
        if q.dim() != found {
            return Err(Error::Length { what: "the forced components", expected: q.dim(), found });
        }
        let mut seen = vec![false; state_dim];
        for (row, &column) in forcing.components.iter().enumerate() {
            if column >= state_dim || std::mem::replace(&mut seen[column], true) {
                return Err(Error::OperatorEntry {
                    row,
                    rows: found,
                    column,
                    columns: state_dim,
                    value: 1.0,
                });
            }
        }
        if forcing.steps == 0 {
            return Err(Error::Setting { what: "the steps of a sub-window", value: 0.0 });
        }
        let (physical, whitened) = (vec![0.0; q.dim()], vec![0.0; q.root_dim()]);
        Ok(Self { over, forcing, last, physical, whitened })
    }

    /// N, how many η there are.
    pub(super) fn count(&self) -> usize {
        if self.forcing.held {
            self.last.div_ceil(self.forcing.steps)
        } else {
            self.last / self.forcing.steps
        }
    }

    /// Numbers of one η in the control.
    pub(super) fn block(&self) -> usize {
        self.whitened.len()
    }

    pub(super) fn dim(&self) -> usize {
        self.count() * self.block()
    }

    pub(super) fn forcing(&self) -> &Forcing {
        &self.forcing
    }

    fn q(&self) -> &'a dyn Covariance {
        match self.over {
            WeakControl::Forcing { q } => q,
            WeakControl::States { q, .. } => q,
        }
    }

    /// Which η enters after step k.
    pub(super) fn index(&self, k: usize) -> Option<usize> {
        self.forcing.index(k)
    }

    /// How many landings M_k(x_k) are kept.
    pub(super) fn slots(&self) -> usize {
        if self.forcing.held { self.last } else { self.count() }
    }

    /// Which of them is that of step k; none where x_{k+1} = M_k(x_k).
    pub(super) fn slot(&self, k: usize) -> Option<usize> {
        if self.forcing.held { Some(k) } else { self.index(k) }
    }

    /// Turns M_k(x_k) in `x_next` into x_{k+1}; keeps it, and over states the whitened error.
    pub(super) fn enter(
        &mut self,
        k: usize,
        v: &[f64],
        x_next: &mut [f64],
        landings: &mut [f64],
        prior: &mut [f64],
    ) {
        let (Some(j), Some(slot)) = (self.index(k), self.slot(k)) else { return };
        let (n, r) = (x_next.len(), self.block());
        landings[slot * n..(slot + 1) * n].copy_from_slice(x_next);
        let v = &v[j * r..(j + 1) * r];
        match self.over {
            WeakControl::Forcing { q } => {
                q.root(v, &mut self.physical);
                for (&c, eta) in self.forcing.components.iter().zip(&self.physical) {
                    x_next[c] += eta;
                }
            }
            WeakControl::States { q, .. } => {
                for ((&c, eta), v) in self.forcing.components.iter().zip(&mut self.physical).zip(v) {
                    *eta = v - x_next[c];
                    x_next[c] = *v;
                }
                q.whiten(&self.physical, &mut prior[j * r..(j + 1) * r]);
            }
        }
    }

    /// dx += E Q^{1/2} p_j after step k.
    pub(super) fn tangent_add(&mut self, k: usize, p: &[f64], dx: &mut [f64]) {
        let (Some(j), r) = (self.index(k), self.block()) else { return };
        self.q().root(&p[j * r..(j + 1) * r], &mut self.physical);
        for (&c, eta) in self.forcing.components.iter().zip(&self.physical) {
            dx[c] += eta;
        }
    }

    /// p_j += Q^{1/2}ᵀ Eᵀ λ after step k.
    pub(super) fn adjoint_add(&mut self, k: usize, lambda: &[f64], p: &mut [f64]) {
        let (Some(j), r) = (self.index(k), self.block()) else { return };
        for (&c, eta) in self.forcing.components.iter().zip(&mut self.physical) {
            *eta = lambda[c];
        }
        self.q().root_transpose(&self.physical, &mut self.whitened);
        p[j * r..(j + 1) * r].iter_mut().zip(&self.whitened).for_each(|(p, w)| *p += w);
    }
}
