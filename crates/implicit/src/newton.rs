//! Newton's method for a system of equations, globalized.

use crate::{Equations, Error, Interval, Refusal};
use varda_linalg::{Factor, LinearSolver, Structure, dot};

/// Limits of the iteration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct NewtonOptions {
    /// Most iterations (linear solves) of one call.
    pub max_iterations: usize,
    /// Most halvings of one update.
    pub max_backtracks: usize,
}

impl Default for NewtonOptions {
    fn default() -> Self {
        Self { max_iterations: 50, max_backtracks: 30 }
    }
}

impl NewtonOptions {
    /// The same with another [`max_iterations`](Self::max_iterations).
    #[must_use]
    pub fn with_max_iterations(mut self, max_iterations: usize) -> Self {
        self.max_iterations = max_iterations;
        self
    }

    /// The same with another [`max_backtracks`](Self::max_backtracks).
    #[must_use]
    pub fn with_max_backtracks(mut self, max_backtracks: usize) -> Self {
        self.max_backtracks = max_backtracks;
        self
    }
}

/// Work and outcome of one call of [`solve`].
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct NewtonReport {
    /// Linear solves; the last one ended the iteration and its update was applied.
    pub iterations: usize,
    /// Numerical factorizations: one per iteration, and one more per shift tried.
    pub factorizations: usize,
    /// Size of the last update, in the step's own norm.
    pub last_update: f64,
    /// Shifts of the diagonal that were tried because ∂G/∂u was not positive definite.
    pub shifts: usize,
    /// Halvings of an update.
    pub backtracks: usize,
    /// The updates stopped shrinking above the threshold, with a residual that is all rounding (see
    /// [`solve`]).
    pub at_rounding: bool,
    /// The minimum is not isolated: ∂G/∂u is singular there and has no negative eigenvalue (see
    /// [`solve`]).
    pub neutral: bool,
}

/// Work space of [`solve`], made once for a step's structure and used for as many calls as one likes.
#[derive(Debug)]
pub struct NewtonWork {
    pub(crate) solver: LinearSolver,
    pub(crate) values: Vec<f64>,
    pub(crate) factor: Factor,
    pub(crate) g: Vec<f64>,
    du: Vec<f64>,
    trial: Vec<f64>,
    probe: Vec<f64>,
    report: NewtonReport,
}

impl NewtonWork {
    /// Space for n unknowns and a Jacobian of the given structure.
    ///
    /// # Panics
    /// If a sparse structure is not a pattern of n columns.
    pub fn new(unknowns: usize, structure: &Structure) -> Self {
        let solver = LinearSolver::new(unknowns, structure);
        Self {
            values: vec![0.0; solver.values_len()],
            factor: solver.empty_factor(),
            solver,
            g: vec![0.0; unknowns],
            du: vec![0.0; unknowns],
            trial: vec![0.0; unknowns],
            probe: vec![0.0; unknowns],
            report: NewtonReport::default(),
        }
    }

    /// What the last call of [`solve`] did, also where it failed.
    pub fn report(&self) -> &NewtonReport {
        &self.report
    }
}

/// Why a call of [`solve`] found no solution.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NewtonFailure {
    /// The iterations or the halvings ran out, or the updates stalled.
    #[error("Newton stopped after {iterations} iterations with |du| = {update:e} (wanted {tolerance:e})")]
    Diverged {
        /// Iterations done.
        iterations: usize,
        /// Size of the last update, in the norm of the equations.
        update: f64,
        /// The size that was asked for.
        tolerance: f64,
    },
    /// ∂G/∂u has no usable factorization.
    #[error("the Jacobian ∂G/∂u is singular at row {row}")]
    SingularJacobian {
        /// Row of the first unusable pivot.
        row: usize,
    },
    /// A value that is not finite.
    #[error("{what} is not finite")]
    NonFinite {
        /// Which vector.
        what: &'static str,
    },
    /// The equations refused the guess, or a trusted update.
    #[error("{0}")]
    Refused(Refusal),
}

impl From<Refusal> for NewtonFailure {
    fn from(reason: Refusal) -> Self {
        Self::Refused(reason)
    }
}

impl NewtonFailure {
    /// The error of the step whose equations these were.
    pub fn in_step(self, at: &Interval) -> Error {
        let step = at.index;
        match self {
            NewtonFailure::Diverged { iterations, update, tolerance } => Error::NewtonDiverged {
                step,
                time: at.start,
                length: at.length,
                iterations,
                update,
                tolerance,
            },
            NewtonFailure::SingularJacobian { row } => Error::SingularJacobian { step, row },
            NewtonFailure::NonFinite { what } => Error::NonFinite { step, what },
            NewtonFailure::Refused(reason) => Error::refused(step, reason),
        }
    }
}

/// Armijo's constant: the share of the predicted decrease that a step must bring.
const DECREASE: f64 = 1e-4;
/// First shift of the diagonal, as a share of every row's own |diagonal|.
const FIRST_SHIFT: f64 = 1e-3;
/// A shift that keeps being enough shrinks to this.
const LEAST_SHIFT: f64 = 1e-12;
/// A shift is given up beyond this.
const LAST_SHIFT: f64 = 1e12;
/// Two potentials that agree to this share of themselves cannot be told apart.
const POTENTIAL_ROUNDING: f64 = 1e-10;
/// Trusted steps in a row that may fail to halve the update.
const STALLED: usize = 3;
/// Trusted steps that are tested after all, where they stalled.
const MOST_TESTED: usize = 50;
/// A saddle is left by a step this many times the trusted size, then halved as needed.
const ESCAPE: f64 = 1e4;
/// A matrix that this share of its largest diagonal entry makes positive definite is taken for semidefinite.
const SEMIDEFINITE: f64 = 1e-13;
/// Factors by which two updates in a row must have shrunk for the next to be predicted. Of the steps of the
/// stiff cases and two shipped rods none then left an update above a twentieth of the tolerance; with a tenth
/// and a hundredth, one left 2e4 of it.
const SHRINKS: [f64; 2] = [0.05, 0.002];
/// A residual below this many roundings of the unknowns is rounding.
const ROUNDINGS: f64 = 16.0;

/// Solves G(u) = 0 for u, from the guess in `u`.
///
/// ```text
/// ∂G/∂u du = −G,   u ← u ⊕ α du
/// ```
///
/// **With a potential** (G = ∂Φ/∂u) a minimum of Φ is looked for. Where the factorization shows
/// ∂G/∂u not positive definite, a growing multiple of |diag ∂G/∂u| is added (relative to each row's
/// own diagonal: unknowns may be lengths and angles), so that du is a direction of descent; α is halved
/// until Φ decreases by Armijo's rule or, where Φ cannot resolve it, until Φ is equal to rounding and its
/// slope along du has shrunk (Hager and Zhang 2005). A saddle is not accepted: where the shifted update is
/// tiny the iteration leaves along a direction of negative curvature. This needs the inertia, thus
/// `Structure::SymmetricBand`; with other structures only descent along du is ensured. Where ∂G/∂u is
/// singular to rounding but nowhere negative (a chain without tension, a column free to buckle to any side),
/// the minimum is not isolated: shifted updates then count like unshifted ones, and the report says
/// `neutral`.
///
/// **Without a potential** α is halved until the simplified update has shrunk, the natural monotonicity test
/// size(J⁻¹G(u ⊕ α du)) ≤ (1 − α/4) size(du) with the factor at hand (Deuflhard 2004, section
/// 3.3): it has the units of u and does not see the scaling of the equations.
///
/// A trial point is assembled with its Jacobian, so that an accepted full step costs one assembly and one
/// factorization. A trial point that the equations refuse is too far: the update is halved. Full unshifted
/// updates no larger than `trusted_below` are taken without a test, and one below `converged_below` is
/// applied and ends the iteration. So does one after which the next is expected to be: a trusted third of
/// three full updates that shrink by twenty and then by five hundred at least, as they do where convergence
/// is quadratic (an inexact Jacobian does not make them).
///
/// **Rounding.** Where trusted updates stop shrinking before that, the iteration ends only if the residual
/// cannot be told from a change of the unknowns in their last digits, |g_i| ≤ 16 ε Σ_j |J_ij| |u_j| for
/// every row (Oettli and Prager 1964: u is then the exact root of equations as close as the machine can state
/// them); the report says so. Else it fails.
///
/// # Errors
/// - [`NewtonFailure::Refused`] if the equations refuse the guess, or a trusted update.
/// - [`NewtonFailure::SingularJacobian`] if there is no usable factorization.
/// - [`NewtonFailure::NonFinite`] if an update or a residual is not finite.
/// - [`NewtonFailure::Diverged`] if the iterations or the halvings run out, or the updates stall.
///
/// # Panics
/// If the length of `u` is not that of `work`.
///
/// # Examples
///
/// The energy Φ(u) = u⁴/4 − u²/2 from near its maximum at 0, where plain Newton would stay:
///
/// ```
/// use varda_implicit::{Equations, NewtonOptions, NewtonWork, Refusal, Structure, solve};
///
/// struct TwoWells;
///
/// impl Equations for TwoWells {
///     fn assemble(
///         &mut self,
///         u: &[f64],
///         g: &mut [f64],
///         jacobian: Option<&mut [f64]>,
///     ) -> Result<Option<f64>, Refusal> {
///         g[0] = u[0].powi(3) - u[0];
///         if let Some(values) = jacobian {
///             values[0] = 3.0 * u[0] * u[0] - 1.0;
///         }
///         Ok(Some(0.25 * u[0].powi(4) - 0.5 * u[0] * u[0]))
///     }
///     fn converged_below(&self) -> f64 {
///         1e-12
///     }
/// }
///
/// let mut work = NewtonWork::new(1, &Structure::SymmetricBand { half_bandwidth: 0 });
/// let mut u = [1e-3];
/// solve(&mut TwoWells, &mut u, &mut work, &NewtonOptions::default())?;
/// assert!((u[0] - 1.0).abs() < 1e-12);
/// # Ok::<(), varda_implicit::NewtonFailure>(())
/// ```
pub fn solve<E: Equations + ?Sized>(
    equations: &mut E,
    u: &mut [f64],
    work: &mut NewtonWork,
    options: &NewtonOptions,
) -> Result<NewtonReport, NewtonFailure> {
    assert_eq!(u.len(), work.g.len(), "the work space was made for another number of unknowns");
    work.report = NewtonReport { last_update: f64::INFINITY, ..NewtonReport::default() };
    let (converged, trusted) = (equations.converged_below(), equations.trusted_below());
    let mut potential = equations.assemble(u, &mut work.g, Some(&mut work.values))?;
    if !work.g.iter().all(|g| g.is_finite()) {
        return Err(NewtonFailure::NonFinite { what: "the residual of the guess" });
    }
    // the last shift that was needed, kept over iterations that need none
    let mut remembered = 0.0;
    let (mut stalled, mut tested) = (0, 0);
    // the sizes of the updates that were taken whole, back to the last that was not
    let mut whole = [f64::INFINITY; 2];
    for iteration in 1..=options.max_iterations {
        work.report.iterations = iteration;
        let shift = work.factor_descending(potential.is_some(), remembered)?;
        if shift > 0.0 {
            remembered = shift;
        }
        work.newton_update();
        let size = equations.size(&work.du);
        if !size.is_finite() {
            return Err(NewtonFailure::NonFinite { what: "the Newton update" });
        }
        let previous = std::mem::replace(&mut work.report.last_update, size);
        let neutral = shift > 0.0 && size <= trusted && work.is_semidefinite();
        let full = shift == 0.0 || neutral;
        let ends = size <= trusted && shift == 0.0 && expected_update(whole, size) <= converged;
        if full && (size <= converged || ends) {
            work.report.neutral = neutral;
            equations.retract(u, &work.du, 1.0, &mut work.trial);
            u.copy_from_slice(&work.trial);
            return Ok(work.report);
        }
        let mut is_whole = shift == 0.0;
        if full && size <= trusted {
            stalled = if size > 0.5 * previous { stalled + 1 } else { 0 };
            if stalled >= STALLED {
                work.report.at_rounding = work.residual_is_rounding(u);
                if work.report.at_rounding {
                    return Ok(work.report);
                }
                // too small to be tested is not yet small enough: tested steps for a while, where there is a
                // potential
                let Some(phi) = potential.filter(|_| tested < MOST_TESTED) else {
                    return Err(work.diverged(equations));
                };
                tested += 1;
                let test = work.descent(phi);
                let accepted = work.backtrack(equations, u, &test, options);
                potential = accepted.ok_or_else(|| work.diverged(equations))?;
                u.copy_from_slice(&work.trial);
                whole = [f64::INFINITY; 2];
                continue;
            }
            equations.retract(u, &work.du, 1.0, &mut work.trial);
            potential = equations.assemble(&work.trial, &mut work.g, Some(&mut work.values))?;
        } else {
            let test = match potential {
                Some(phi) if shift > 0.0 && size <= trusted => {
                    work.negative_curvature(equations, ESCAPE * trusted, phi)
                }
                Some(phi) => Some(work.descent(phi)),
                None => Some(Test::Contraction { size }),
            };
            let halvings = work.report.backtracks;
            let leaving = shift > 0.0 && size <= trusted && potential.is_some();
            let mut accepted = test.and_then(|test| work.backtrack(equations, u, &test, options));
            if accepted.is_none() && leaving {
                // a curvature too slight for Φ to show: nearer to the point where the residual is zero, it
                // may be none
                accepted = Some(work.shifted_update(equations, u, shift)?);
            }
            potential = accepted.ok_or_else(|| work.diverged(equations))?;
            is_whole &= work.report.backtracks == halvings && equations.longest(&work.du) >= 1.0;
        }
        u.copy_from_slice(&work.trial);
        whole = if is_whole { [whole[1], size] } else { [f64::INFINITY; 2] };
    }
    Err(work.diverged(equations))
}

/// The size of the update after one of size d₃, where two before it had sizes d₁, d₂ and the three
/// shrink fast: d₃ r' (r'/r) with rates r = d₂/d₁ and r' = d₃/d₂, as if the rate improved by the
/// same factor once more; near a solution it improves by more. Infinite elsewhere.
fn expected_update([first, second]: [f64; 2], third: f64) -> f64 {
    let (before, now) = (second / first, third / second);
    let fast = before <= SHRINKS[0] && now <= SHRINKS[1];
    // without two sizes before, a rate is 0 or no number
    if fast && before > 0.0 { third * now * (now / before) } else { f64::INFINITY }
}

impl NewtonWork {
    /// Factors ∂G/∂u; with a potential, shifted until positive definite. Returns the shift.
    fn factor_descending(&mut self, has_potential: bool, last: f64) -> Result<f64, NewtonFailure> {
        self.report.factorizations += 1;
        match self.solver.factor(&self.values, &mut self.factor) {
            Ok(negative) if !has_potential || negative == 0 => return Ok(0.0),
            Err(bad) if !has_potential => {
                return Err(NewtonFailure::SingularJacobian { row: bad.row });
            }
            _ => {}
        }
        // shifts that were enough shrink, so that soft directions are not held back for long
        let mut shift = if last > 0.0 { (last / 4.0).max(LEAST_SHIFT) } else { FIRST_SHIFT };
        while shift <= LAST_SHIFT {
            self.report.factorizations += 1;
            self.report.shifts += 1;
            if self.solver.factor_shifted(&self.values, shift, &mut self.factor) == Ok(0) {
                return Ok(shift);
            }
            shift *= 4.0;
        }
        // only a Jacobian that is zero or not finite in some row withstands every shift
        let row =
            self.solver.factor_shifted(&self.values, shift, &mut self.factor).err().map_or(0, |bad| bad.row);
        Err(NewtonFailure::SingularJacobian { row })
    }

    /// Takes the shifted update without a test. Returns the potential there.
    fn shifted_update<E: Equations + ?Sized>(
        &mut self,
        equations: &mut E,
        u: &[f64],
        shift: f64,
    ) -> Result<Option<f64>, NewtonFailure> {
        let mut trial = std::mem::take(&mut self.trial);
        let assembled = equations.assemble(u, &mut self.g, Some(&mut self.values));
        if assembled.is_ok() {
            self.report.factorizations += 1;
            let _ = self.solver.factor_shifted(&self.values, shift, &mut self.factor);
            self.newton_update();
            equations.retract(u, &self.du, 1.0, &mut trial);
        }
        self.trial = trial;
        assembled?;
        Ok(equations.assemble(&self.trial, &mut self.g, Some(&mut self.values))?)
    }

    /// Whether ∂G/∂u has no negative eigenvalue beyond rounding. Leaves another factor.
    fn is_semidefinite(&mut self) -> bool {
        self.report.factorizations += 1;
        self.solver.factor_lifted(&self.values, SEMIDEFINITE, &mut self.factor) == Ok(0)
    }

    /// du = −J⁻¹ g.
    fn newton_update(&mut self) {
        for (d, g) in self.du.iter_mut().zip(&self.g) {
            *d = -g;
        }
        self.solver.solve(&self.factor, &mut self.du);
    }

    /// The test of a step along du, turned downhill.
    fn descent(&mut self, phi: f64) -> Test {
        let mut slope = dot(&self.g, &self.du);
        if slope > 0.0 {
            // an LU factor of an indefinite Hessian: the update leads uphill, its reverse does not
            self.du.iter_mut().for_each(|d| *d = -*d);
            slope = -slope;
        }
        Test::Decrease { phi, slope }
    }

    /// du becomes a direction of negative curvature of the given size, downhill. `None` where there is none
    /// to be had.
    fn negative_curvature<E: Equations + ?Sized>(
        &mut self,
        equations: &E,
        size: f64,
        phi: f64,
    ) -> Option<Test> {
        self.report.factorizations += 1;
        self.solver.factor(&self.values, &mut self.factor).ok()?;
        let curvature = self.solver.negative_curvature(&self.factor, &mut self.du)?;
        let scale = size / equations.size(&self.du);
        let scale = if dot(&self.g, &self.du) > 0.0 { -scale } else { scale };
        self.du.iter_mut().for_each(|d| *d *= scale);
        Some(Test::Curvature { phi, slope: dot(&self.g, &self.du), curvature: curvature * scale * scale })
    }

    /// Halves α, from the longest step, until the test holds at u ⊕ α du, and leaves that point in
    /// `trial`, its equations in `g` and `values`. Returns its potential; `None` where the halvings ran out.
    fn backtrack<E: Equations + ?Sized>(
        &mut self,
        equations: &mut E,
        u: &[f64],
        test: &Test,
        options: &NewtonOptions,
    ) -> Option<Option<f64>> {
        let mut alpha = equations.longest(&self.du).min(1.0);
        for _ in 0..=options.max_backtracks {
            equations.retract(u, &self.du, alpha, &mut self.trial);
            let assembled = equations.assemble(&self.trial, &mut self.g, Some(&mut self.values));
            if let Ok(potential) = assembled
                && self.holds(equations, test, alpha, potential)
            {
                return Some(potential);
            }
            alpha *= 0.5;
            self.report.backtracks += 1;
        }
        None
    }

    /// Whether the point just assembled passes. False for anything that is not a number.
    fn holds<E: Equations + ?Sized>(
        &mut self,
        equations: &E,
        test: &Test,
        alpha: f64,
        potential: Option<f64>,
    ) -> bool {
        match (test, potential) {
            (&Test::Decrease { phi, slope }, Some(trial)) => {
                // Armijo's rule on a parabola is a bound on the slope at its end, which rounding of Φ does
                // not touch.
                let equal = (trial - phi).abs() <= POTENTIAL_ROUNDING * phi.abs().max(trial.abs());
                trial <= phi + DECREASE * alpha * slope
                    || equal && dot(&self.g, &self.du) <= (2.0 * DECREASE - 1.0) * slope
            }
            (&Test::Curvature { phi, slope, curvature }, Some(trial)) => {
                trial <= phi + DECREASE * (alpha * slope + 0.5 * alpha * alpha * curvature)
            }
            (&Test::Contraction { size }, None) => {
                self.probe.copy_from_slice(&self.g);
                self.solver.solve(&self.factor, &mut self.probe);
                equations.size(&self.probe) <= (1.0 - 0.25 * alpha) * size
            }
            _ => false,
        }
    }

    /// |g_i| ≤ 16 ε Σ_j |J_ij| |u_j| in every row.
    fn residual_is_rounding(&mut self, u: &[f64]) -> bool {
        self.solver.absolute_product(&self.values, u, &mut self.probe);
        self.g.iter().zip(&self.probe).all(|(g, scale)| g.abs() <= ROUNDINGS * f64::EPSILON * scale)
    }

    fn diverged<E: Equations + ?Sized>(&self, equations: &E) -> NewtonFailure {
        NewtonFailure::Diverged {
            iterations: self.report.iterations,
            update: self.report.last_update,
            tolerance: equations.converged_below(),
        }
    }
}

/// What a trial point must show.
enum Test {
    /// Φ falls along du with this slope.
    Decrease { phi: f64, slope: f64 },
    /// Φ falls along du with this slope and this (negative) curvature.
    Curvature { phi: f64, slope: f64, curvature: f64 },
    /// The simplified update is smaller than du.
    Contraction { size: f64 },
}
