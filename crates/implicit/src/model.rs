//! The traits of a discrete model, and the work that its calls report.

use crate::{Error, Rate};
use std::ops::{Add, Sub};

/// A discrete model x_{k+1} = M_k(x_k) with its tangent linear and its adjoint (paper 2.16, 2.24, 2.25).
///
/// The linearization of step k is *defined* as that at the accepted pair (x_k, x_{k+1}): a function of the
/// stored states alone, so that keeping it, or forgetting and recomputing it, gives the same bits. It goes
/// into a slot that the caller names ([`Trajectory`](crate::Trajectory) does); products are made with what a
/// slot holds.
///
/// A model counts nothing and decides nothing about storage: it says what a call did ([`Work`]), and its
/// caller adds that up. Every method is required but [`rate`](Self::rate),
/// [`second_order`](Self::second_order) and those of the control, which follow from
/// [`control_map`](Self::control_map): a wrapper that forgets another does not compile.
///
/// ```
/// use varda_implicit::{ControlMap, Error, Model, Work, check};
///
/// /// x_{k+1} = x_k − 0.1 x_k²; the control is ln x₀.
/// #[derive(Default)]
/// struct Decay {
///     /// ∂x_{k+1}/∂x_k, a slot each.
///     slopes: Vec<f64>,
///     x0: f64,
/// }
///
/// impl Model for Decay {
///     fn dim(&self) -> usize {
///         1
///     }
///     fn step(&mut self, _k: usize, x: &[f64], x_next: &mut [f64]) -> Result<Work, Error> {
///         x_next[0] = x[0] - 0.1 * x[0] * x[0];
///         Ok(Work::default())
///     }
///     fn linearize(&mut self, slot: usize, _k: usize, x: &[f64], _: &[f64]) -> Result<Work, Error> {
///         self.slopes.resize(self.slopes.len().max(slot + 1), f64::NAN);
///         self.slopes[slot] = 1.0 - 0.2 * x[0];
///         Ok(Work::default())
///     }
///     fn tangent(&mut self, slot: usize, dx: &mut [f64]) {
///         dx.iter_mut().for_each(|dx| *dx *= self.slopes[slot]);
///     }
///     fn adjoint(&mut self, slot: usize, lambda: &mut [f64]) {
///         self.tangent(slot, lambda);
///     }
///     fn release(&mut self, from_slot: usize) {
///         self.slopes.truncate(from_slot);
///         self.slopes.shrink_to_fit();
///     }
///     fn slot_bytes(&self) -> usize {
///         size_of::<f64>()
///     }
///     fn bytes(&self) -> usize {
///         self.slopes.len() * size_of::<f64>()
///     }
///     fn control_map(&mut self) -> Option<&mut dyn ControlMap> {
///         Some(self)
///     }
/// }
///
/// impl ControlMap for Decay {
///     fn control_len(&self) -> usize {
///         1
///     }
///     fn to_state(&mut self, z: &[f64], x: &mut [f64]) -> Result<(), Error> {
///         self.x0 = z[0].exp();
///         x[0] = self.x0;
///         Ok(())
///     }
///     fn to_state_tangent(&mut self, dz: &[f64], dx: &mut [f64]) {
///         dx[0] = self.x0 * dz[0];
///     }
///     fn to_state_adjoint(&mut self, lambda: &[f64], dz: &mut [f64]) {
///         dz[0] = self.x0 * lambda[0];
///     }
/// }
///
/// let report = check::model(&mut Decay::default(), &[0.7], 3, &[0.1], 1)?;
/// assert!(report.passed(), "{report}");
/// # Ok::<(), varda_implicit::Error>(())
/// ```
pub trait Model {
    /// Length of the state x.
    fn dim(&self) -> usize;

    /// x_next = M_k(x). Pure: the result depends on k and x only.
    ///
    /// # Errors
    /// A step that cannot be taken; the error names it.
    fn step(&mut self, k: usize, x: &[f64], x_next: &mut [f64]) -> Result<Work, Error>;

    /// Linearizes step k at the accepted pair (x_k, x_{k+1}) into a slot (0, 1, 2 …), in place of what was
    /// there.
    ///
    /// # Errors
    /// A pair that is no step of the model, or a Jacobian without a factorization. The slot is then empty.
    fn linearize(&mut self, slot: usize, k: usize, x: &[f64], x_next: &[f64]) -> Result<Work, Error>;

    /// dx ← M_k dx in place, with the linearization in the slot, for one column or several, one after the
    /// other (`dx` has the length of the state times their number). Among several, a
    /// column's bits do not depend on the others; alone it may be rounded differently.
    ///
    /// # Panics
    /// If the slot is empty, or `dx.len()` is not a multiple of `dim()`.
    fn tangent(&mut self, slot: usize, dx: &mut [f64]);

    /// λ ← M_kᵀ λ in place, for one column or several, as for `tangent`. No hidden minus.
    ///
    /// # Panics
    /// As for `tangent`.
    fn adjoint(&mut self, slot: usize, lambda: &mut [f64]);

    /// Told of work that another process does in this one's place, to be added by a model that counts what it
    /// does. Nothing by default.
    fn count_elsewhere(&mut self, _done: Counts) {}

    /// Forgets what the slots from this one on hold, and gives their memory back.
    fn release(&mut self, from_slot: usize);

    /// Bytes that the linearization of one step takes.
    fn slot_bytes(&self) -> usize;

    /// Bytes of all linearizations held now.
    fn bytes(&self) -> usize;

    /// The rate of the state, or of some of its components, for observations between two steps: a cubic
    /// through states and rates. `None` (the default): a straight line.
    fn rate(&self) -> Option<Box<dyn Rate>> {
        None
    }

    /// The map from the control z, what is estimated, to the initial state; `None` where they are the same
    /// vector.
    fn control_map(&mut self) -> Option<&mut dyn ControlMap>;

    /// Second derivatives of the steps, for the exact Hessian of a cost; `None` (the default) where there are
    /// none, and Hessians are those of Gauss and Newton.
    fn second_order(&mut self) -> Option<&mut dyn SecondOrder> {
        None
    }

    /// Length of the control z.
    fn control_dim(&mut self) -> usize {
        let dim = self.dim();
        self.control_map().map_or(dim, |map| map.control_len())
    }

    /// x₀ from the control z.
    ///
    /// # Errors
    /// As [`ControlMap::to_state`].
    fn initial_state(&mut self, z: &[f64], x: &mut [f64]) -> Result<(), Error> {
        match self.control_map() {
            Some(map) => map.to_state(z, x),
            None => {
                x.copy_from_slice(z);
                Ok(())
            }
        }
    }

    /// dx₀ = ∂x₀/∂z dz at the control of the last `initial_state`.
    fn initial_tangent(&mut self, dz: &[f64], dx: &mut [f64]) {
        match self.control_map() {
            Some(map) => map.to_state_tangent(dz, dx),
            None => dx.copy_from_slice(dz),
        }
    }

    /// dz = (∂x₀/∂z)ᵀ λ₀ at the control of the last `initial_state`.
    fn initial_adjoint(&mut self, lambda: &[f64], dz: &mut [f64]) {
        match self.control_map() {
            Some(map) => map.to_state_adjoint(lambda, dz),
            None => dz.copy_from_slice(lambda),
        }
    }
}

/// The map z ↦ x₀ from the control to the initial state, with its derivative.
///
/// ```
/// use varda_implicit::{ControlMap, Error};
///
/// /// x₀ = (z, z²).
/// struct OnParabola(f64);
///
/// impl ControlMap for OnParabola {
///     fn control_len(&self) -> usize {
///         1
///     }
///     fn to_state(&mut self, z: &[f64], x: &mut [f64]) -> Result<(), Error> {
///         self.0 = z[0];
///         x.copy_from_slice(&[z[0], z[0] * z[0]]);
///         Ok(())
///     }
///     fn to_state_tangent(&mut self, dz: &[f64], dx: &mut [f64]) {
///         dx.copy_from_slice(&[dz[0], 2.0 * self.0 * dz[0]]);
///     }
///     fn to_state_adjoint(&mut self, lambda: &[f64], dz: &mut [f64]) {
///         dz[0] = lambda[0] + 2.0 * self.0 * lambda[1];
///     }
/// }
///
/// let (mut map, mut x, mut dz) = (OnParabola(0.0), [0.0; 2], [0.0]);
/// map.to_state(&[3.0], &mut x)?;
/// map.to_state_adjoint(&[0.0, 1.0], &mut dz);
/// assert_eq!((x, dz), ([3.0, 9.0], [6.0]));
/// # Ok::<(), Error>(())
/// ```
pub trait ControlMap {
    /// Length of the control z.
    fn control_len(&self) -> usize;

    /// x₀ from z. Keeps what the two derivatives need.
    ///
    /// # Errors
    /// A control from which no state follows.
    fn to_state(&mut self, z: &[f64], x: &mut [f64]) -> Result<(), Error>;

    /// dx₀ = ∂x₀/∂z dz at the control of the last `to_state`.
    fn to_state_tangent(&mut self, dz: &[f64], dx: &mut [f64]);

    /// dz = (∂x₀/∂z)ᵀ λ₀ at the control of the last `to_state`.
    fn to_state_adjoint(&mut self, lambda: &[f64], dz: &mut [f64]);
}

/// What the second-order adjoint needs of a [`Model`](crate::Model) beside its products: the derivative of
/// the adjoint step along a perturbation of the state it is taken at.
///
/// With λ_k = M_k'ᵀ λ_{k+1} + f_k, the derivative of λ_k along dx₀ is
///
/// ```text
/// λ̇_k = M_k'ᵀ λ̇_{k+1} + Σ_i λ_{k+1,i} ∂²M_{k,i}/∂x² dx_k + ḟ_k,     dx_{k+1} = M_k' dx_k
/// ```
///
/// (Wang, Navon, Le Dimet and Zou 1992), which gives the product of the exact Hessian of a cost with a vector
/// from one sweep each way. A model without second derivatives gives `None` from
/// [`Model::second_order`](crate::Model::second_order), and Hessians are then those of Gauss and Newton.
///
/// ```
/// use varda_implicit::{Model, Rk4, lorenz::Lorenz63};
///
/// let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);
/// let (x, dx, lambda) = ([1.0, 3.0, 20.0], [0.1, -0.2, 0.3], [0.0, 0.0, 1.0]);
/// let mut adjoint_at = |x: &[f64]| {
///     let (mut next, mut l) = ([0.0; 3], lambda);
///     model.step(0, x, &mut next).unwrap();
///     model.linearize(0, 0, x, &next).unwrap();
///     model.adjoint(0, &mut l);
///     l
/// };
/// let moved = |s: f64| [0, 1, 2].map(|i| x[i] + s * dx[i]);
/// let (plus, minus) = (adjoint_at(&moved(1e-4)), adjoint_at(&moved(-1e-4)));
/// adjoint_at(&x);
///
/// let mut derivative = [0.0; 3];
/// model.second_order().unwrap().adjoint_derivative(0, &dx, &lambda, &mut derivative)?;
/// for i in 0..3 {
///     assert!((derivative[i] - (plus[i] - minus[i]) / 2e-4).abs() < 1e-9);
/// }
/// # Ok::<(), varda_implicit::Error>(())
/// ```
pub trait SecondOrder: Model {
    /// dx ← M dx as [`Model::tangent`], for one column; what `adjoint_derivative` needs along the way may
    /// be kept in the slot.
    ///
    /// # Panics
    /// As [`Model::tangent`].
    fn tangent_kept(&mut self, slot: usize, dx: &mut [f64]) {
        self.tangent(slot, dx);
    }

    /// λ̇ ← M'ᵀ λ̇ + Σ_i λ_i ∂²M_i/∂x² dx in place, with the linearization in the slot:
    /// `lambda` is λ_{k+1}, at the end of the step, `dx` the perturbation at its start.
    ///
    /// What does not depend on dx may be kept in the slot, for the next call with the same λ; what
    /// `tangent_kept` left there is taken over where its dx was the same.
    ///
    /// # Errors
    /// Second derivatives that are not finite.
    ///
    /// # Panics
    /// If the slot is empty, or a slice has the wrong length.
    fn adjoint_derivative(
        &mut self,
        slot: usize,
        dx: &[f64],
        lambda: &[f64],
        derivative: &mut [f64],
    ) -> Result<(), Error>;

    /// dz += Σ_i λ_i ∂²x_{0,i}/∂z² δz, λ that of the initial state, at the control of the last
    /// `initial_state`. Nothing where control and state are the same vector, or the map between them is
    /// linear.
    fn initial_adjoint_derivative(&mut self, _delta: &[f64], _lambda: &[f64], _dz: &mut [f64]) {}
}

/// What one call of [`Model::step`] or [`Model::linearize`] did. The default is one step without a solve.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Work {
    /// Steps of the innermost model: 1, but where one step stands for several
    /// ([`Substepped`](crate::Substepped)).
    pub steps: usize,
    /// Extra substeps of a step that had to be split.
    pub substeps: usize,
    /// Newton iterations.
    pub newton_iterations: usize,
    /// Numerical factorizations of ∂G/∂u.
    pub factorizations: usize,
    /// Linearizations that took over the last factor of Newton's method (see
    /// [`Linearization`](crate::Linearization)).
    pub reused: usize,
    /// What the user should know: substeps taken, a pivot near zero.
    pub warnings: Vec<String>,
}

impl Default for Work {
    fn default() -> Self {
        Self {
            steps: 1,
            substeps: 0,
            newton_iterations: 0,
            factorizations: 0,
            reused: 0,
            warnings: Vec::new(),
        }
    }
}

impl Work {
    /// Adds what a further step of the innermost model did.
    pub fn add(&mut self, other: Work) {
        self.steps += other.steps;
        self.substeps += other.substeps;
        self.newton_iterations += other.newton_iterations;
        self.factorizations += other.factorizations;
        self.reused += other.reused;
        self.warnings.extend(other.warnings);
    }
}

/// Work of a model, added up by its caller. Integers, exact, the same on every run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Steps taken (one that was split counts once).
    pub model_steps: usize,
    /// Extra substeps of steps that had to be split.
    pub substeps: usize,
    /// Products with M_k, one a column.
    pub tangent_steps: usize,
    /// Products with M_kᵀ, one a column.
    pub adjoint_steps: usize,
    /// Linearizations of a step.
    pub linearizations: usize,
    /// Those of them that took over the last factor of Newton's method.
    pub reused: usize,
    /// Numerical factorizations of ∂G/∂u, in steps and in linearizations.
    pub factorizations: usize,
    /// Newton iterations.
    pub newton_iterations: usize,
    /// Derivatives of the adjoint step ([`SecondOrder`]).
    pub adjoint_derivatives: usize,
}

impl Counts {
    /// How many numbers these are.
    pub const LENGTH: usize = 9;

    /// The numbers, in the order of the fields.
    pub fn to_array(self) -> [usize; Self::LENGTH] {
        [
            self.model_steps,
            self.substeps,
            self.tangent_steps,
            self.adjoint_steps,
            self.linearizations,
            self.reused,
            self.factorizations,
            self.newton_iterations,
            self.adjoint_derivatives,
        ]
    }

    /// The counts of [`to_array`](Self::to_array).
    pub fn from_array(numbers: [usize; Self::LENGTH]) -> Self {
        let [
            model_steps,
            substeps,
            tangent_steps,
            adjoint_steps,
            linearizations,
            reused,
            factorizations,
            newton_iterations,
            adjoint_derivatives,
        ] = numbers;
        Counts {
            model_steps,
            substeps,
            tangent_steps,
            adjoint_steps,
            linearizations,
            reused,
            factorizations,
            newton_iterations,
            adjoint_derivatives,
        }
    }

    fn each(self, other: Self, f: fn(usize, usize) -> usize) -> Self {
        let (a, b) = (self.to_array(), other.to_array());
        Self::from_array(std::array::from_fn(|i| f(a[i], b[i])))
    }

    fn add_solves(&mut self, work: &Work) {
        self.substeps += work.substeps;
        self.newton_iterations += work.newton_iterations;
        self.factorizations += work.factorizations;
        self.reused += work.reused;
    }
}

impl Add for Counts {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        self.each(other, usize::add)
    }
}

impl Sub for Counts {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        self.each(other, usize::sub)
    }
}

/// Something a step went through that did not stop it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Warning {
    /// Index k of the step.
    pub step: usize,
    /// What happened.
    pub text: String,
}

/// What a caller of a model keeps of all its calls: their counts, and each warning once.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Log {
    /// The work done.
    pub counts: Counts,
    /// What steps went through, in the order it first happened; at most a thousand.
    pub warnings: Vec<Warning>,
}

/// Most warnings kept.
const MAX_WARNINGS: usize = 1000;

impl Log {
    /// Notes a step taken.
    pub fn step(&mut self, k: usize, work: Work) {
        self.counts.model_steps += work.steps;
        self.counts.add_solves(&work);
        self.warn(k, work.warnings);
    }

    /// Notes a step linearized.
    pub fn linearization(&mut self, k: usize, work: Work) {
        self.counts.linearizations += work.steps;
        self.counts.add_solves(&work);
        self.warn(k, work.warnings);
    }

    /// Adds another log.
    pub fn add(&mut self, other: &Log) {
        self.counts = self.counts + other.counts;
        for warning in &other.warnings {
            self.warn(warning.step, vec![warning.text.clone()]);
        }
    }

    #[inline]
    fn warn(&mut self, step: usize, texts: Vec<String>) {
        if !texts.is_empty() {
            self.keep(step, texts);
        }
    }

    #[cold]
    fn keep(&mut self, step: usize, texts: Vec<String>) {
        for text in texts {
            let known = self.warnings.iter().any(|w| w.step == step && w.text == text);
            if self.warnings.len() < MAX_WARNINGS && !known {
                self.warnings.push(Warning { step, text });
            }
        }
    }
}
