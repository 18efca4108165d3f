//! Problems that several suites and benchmarks use: the hanging rod of the paper, a driven one, rods of every
//! kind, Lorenz 1996.

use crate::scene::{Motion, SCENES, Scene, Shape};
use std::error::Error;
use std::f64::consts::TAU;
use std::sync::Arc;
use varda_assimilation::{LinearObservation, Observation, ObservationSet};
use varda_covariance::{BlockDiagonal, CovarianceFunction, Dense, Interleaved, Kernel, Taper};
use varda_implicit::{ImplicitModel, ImplicitStep, Model, Scheme};
use varda_rod::{
    Clamp, ClampAt, Damping, Drag, EllipseDrive, FollowerForce, Load, Loads, Material, Moment, Motion as _,
    Rod, RodStep, Section, Supports, TwistUnknowns, equilibrium, straight_guess,
};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// A rod hanging from a clamp that moves along an ellipse, with a prior and observed points (paper, section
/// 3).
#[derive(Debug, Clone)]
pub struct HangingRod {
    /// The rod, in equal segments.
    pub rod: Rod,
    /// Motion of vertex 0.
    pub drive: EllipseDrive,
    /// m₁ of the first edge.
    pub director: [f64; 3],
    /// \[m/s²\].
    pub gravity: [f64; 3],
    /// Δt \[s\].
    pub dt: f64,
    /// Steps from the resting start to the window.
    pub first_step: usize,
    /// Steps of the window.
    pub steps: usize,
    /// Background errors.
    pub prior: Prior,
    /// Observed places, as parts of the length.
    pub s_over_length: Vec<f64>,
    /// σ of every observed coordinate \[m\].
    pub sigma_y: f64,
}

/// Background errors of positions and velocities, with Gaussian kernels and a triangle taper.
#[derive(Debug, Clone, Copy)]
pub struct Prior {
    /// σ of positions \[m\].
    pub sigma_x: f64,
    /// σ of velocities \[m/s\].
    pub sigma_v: f64,
    /// Correlation length of positions \[m\].
    pub length_x: f64,
    /// Correlation length of velocities \[m\].
    pub length_v: f64,
    /// Support of the taper \[m\].
    pub support: f64,
    /// The two prescribed vertices are known exactly.
    pub conditioned: bool,
}

/// The localized background error covariance.
pub type Background = BlockDiagonal<Interleaved<Dense>>;

impl HangingRod {
    /// Case 1 … 4 of the paper's Table 3.3, read from the shipped scene, and the true control at the start
    /// of the window.
    ///
    /// # Errors
    /// Where the rod cannot be run up to the window.
    ///
    /// # Panics
    /// If there is no such case.
    pub fn flagship(case: usize, conditioned: bool) -> Result<(HangingRod, Vec<f64>)> {
        let Scene { model, time, background, observations } = toml::from_str(SCENES[case - 1])?;
        let (Shape { radius }, Motion { radii, omega, ramp_periods }) = (model.section, model.start.motion);
        let material = model.material;
        let material = Material::new(material.youngs_modulus, material.poisson_ratio, material.density);
        let prior = background.covariance;
        let mut problem = HangingRod {
            rod: Rod::uniform(model.length, model.segments, &Section::circle(&material, radius))?,
            drive: EllipseDrive {
                centre: [0.0; 3].into(),
                radii,
                omega,
                phase: 0.0,
                ramp: ramp_periods * TAU / omega,
            },
            director: model.start.director,
            gravity: model.gravity,
            dt: TAU / (time.steps_per_period * omega),
            first_step: time.spin_up,
            steps: time.window,
            prior: Prior {
                sigma_x: prior.sigma_x_over_length * model.length,
                sigma_v: prior.sigma_v_over_mean_speed,
                length_x: prior.correlation_length_x,
                length_v: prior.correlation_length_v,
                support: prior.localization_length,
                conditioned,
            },
            s_over_length: observations.places.iter().map(|s| s / model.length).collect(),
            sigma_y: observations.sigma_over_length * model.length,
        };
        let truth = problem.spin_up()?;
        let velocities = &truth[truth.len() / 2..];
        let speed = |v: &[f64]| v.iter().map(|v| v * v).sum::<f64>().sqrt();
        let mean = velocities.chunks_exact(3).map(speed).sum::<f64>() / (velocities.len() / 3) as f64;
        problem.prior.sigma_v *= mean;
        Ok((problem, truth))
    }

    /// The model whose step 0 is step `first` from the resting start.
    ///
    /// # Errors
    /// Impossible numbers.
    pub fn model(&self, first: usize) -> Result<ImplicitModel<RodStep>> {
        self.model_with(first, TwistUnknowns::WhereNeeded)
    }

    /// The same, with angles where they are not needed.
    ///
    /// # Errors
    /// Impossible numbers.
    pub fn model_with(&self, first: usize, twist: TwistUnknowns) -> Result<ImplicitModel<RodStep>> {
        let loads = Loads { gravity: self.gravity.into(), ..Loads::default() };
        let step = RodStep::with_twist(self.rod.clone(), self.supports(), loads, Damping::default(), twist)?;
        Ok(ImplicitModel::new(step, first, self.dt))
    }

    fn supports(&self) -> Supports {
        let position = Arc::new(self.drive);
        let (tangent, director) = (Arc::new([0.0, 0.0, -1.0]), Arc::new(self.director));
        Supports::clamped_start(Clamp { at: ClampAt::Edge, position, tangent, director, turns: None })
    }

    /// The control [X, V] at the start of the window, from hanging at rest at time 0.
    fn spin_up(&self) -> Result<Vec<f64>> {
        let mut model = self.model(0)?;
        let loads = Loads { gravity: self.gravity.into(), ..Loads::default() };
        let guess = straight_guess(&self.rod, &self.supports(), 0.0, [0.0, 0.0, -1.0])?;
        let (rest, _) = equilibrium(&self.rod, &self.supports(), &loads, 0.0, &guess)?;
        let z = model.step_ref().control_at_rest(&rest);
        let mut x = vec![0.0; model.dim()];
        model.initial_state(&z, &mut x)?;
        let mut next = x.clone();
        for k in 0..self.first_step {
            model.step(k, &x, &mut next)?;
            std::mem::swap(&mut x, &mut next);
        }
        x.truncate(z.len());
        Ok(x)
    }

    /// Rest arc lengths of the free vertices (2 … n), and of the prescribed ones.
    fn places(&self) -> (Vec<f64>, Vec<f64>) {
        let mut s = self.rod.arc_lengths();
        let free = s.split_off(2);
        (free, s)
    }

    /// B, localized.
    ///
    /// # Errors
    /// A B that is not positive definite.
    pub fn background_covariance(&self) -> Result<Background> {
        let p = &self.prior;
        let (free, known) = self.places();
        let known = if p.conditioned { known } else { Vec::new() };
        let mut parts = Vec::new();
        for (sigma, length) in [(p.sigma_x, p.length_x), (p.sigma_v, p.length_v)] {
            let taper = Taper::Triangle { support: p.support };
            let block = CovarianceFunction { sigma, kernel: Kernel::Gaussian { length }, taper };
            let matrix = block.conditioned_matrix(&free, &known)?;
            parts.push(Interleaved::new(Dense::new(free.len(), &matrix)?, 3));
        }
        Ok(BlockDiagonal::new(parts))
    }

    /// The share of vertex i and i + 1 in the observed point p, linear in arc length: (i, weight of i + 1).
    fn point(&self, p: usize) -> Result<(usize, f64)> {
        let s = self.s_over_length[p] * self.rod.length();
        let place = self.rod.place("observed point", s)?;
        Ok((place.edge, place.fraction))
    }

    /// What the points observe of a state of the model: rows 3p, 3p+1, 3p+2 for point p. Prescribed vertices
    /// have no column; their known motion is taken off the observed values by [`HangingRod::observation`].
    ///
    /// # Errors
    /// A place off the rod.
    pub fn operator(&self, state_dim: usize) -> Result<LinearObservation> {
        let points = self.s_over_length.len();
        let mut entries = Vec::new();
        for p in 0..points {
            let (i, w) = self.point(p)?;
            for (vertex, weight) in [(i, 1.0 - w), (i + 1, w)] {
                for c in (0..3).filter(|_| vertex >= 2 && weight != 0.0) {
                    entries.push((3 * p + c, 3 * (vertex - 2) + c, weight));
                }
            }
        }
        Ok(LinearObservation::new(3 * points, state_dim, &entries)?)
    }

    /// Point p seen at `step` of the window; components that are `None` were not observed.
    ///
    /// # Errors
    /// A point that does not exist.
    pub fn observation(&self, step: usize, p: usize, seen: [Option<f64>; 3]) -> Result<Observation> {
        if p >= self.s_over_length.len() {
            return Err(format!("point {p} of {}", self.s_over_length.len()).into());
        }
        let (i, w) = self.point(p)?;
        let top = self.drive.at((self.first_step + step) as f64 * self.dt);
        let below = [top[0], top[1], top[2] - self.rod.rest_lengths[0]];
        let known = |c: usize| match i {
            0 => (1.0 - w) * top[c] + w * below[c],
            1 => (1.0 - w) * below[c],
            _ => 0.0,
        };
        let rows: Vec<usize> = (0..3).filter(|&c| seen[c].is_some()).collect();
        let values = rows.iter().filter_map(|&c| seen[c].map(|y| y - known(c))).collect();
        let rows = rows.iter().map(|c| 3 * p + c).collect();
        Ok(Observation::new(step, rows, values, self.sigma_y).label(format!("point {p}")))
    }

    /// All observations of the window.
    ///
    /// # Errors
    /// As [`ObservationSet::new`].
    pub fn observation_set(
        &self,
        state_dim: usize,
        observations: Vec<Observation>,
    ) -> Result<ObservationSet> {
        Ok(ObservationSet::new(self.steps, vec![Box::new(self.operator(state_dim)?)], observations)?)
    }

    /// The same with noise from a fixed sequence.
    ///
    /// # Errors
    /// As [`observe`](Self::observe).
    pub fn observe_with_waves(&self, truth: &[f64]) -> Result<Vec<Observation>> {
        let mut i = 0;
        self.observe(truth, &mut || {
            i += 1;
            wave(i, 3)
        })
    }

    /// Observations of the window from the control `truth`, every tenth step, with errors from `noise` (in
    /// units of σ).
    ///
    /// # Errors
    /// A model that cannot run.
    pub fn observe(&self, truth: &[f64], noise: &mut dyn FnMut() -> f64) -> Result<Vec<Observation>> {
        let mut model = self.model(self.first_step)?;
        let mut x = vec![0.0; model.dim()];
        model.initial_state(truth, &mut x)?;
        let mut next = x.clone();
        let mut all = Vec::new();
        for k in 0..self.steps {
            model.step(k, &x, &mut next)?;
            std::mem::swap(&mut x, &mut next);
            let step = k + 1;
            if !step.is_multiple_of(10) {
                continue;
            }
            let time = (self.first_step + step) as f64 * self.dt;
            for p in 0..self.s_over_length.len() {
                let (i, w) = self.point(p)?;
                let vertices = model.step_mut().vertices(time, &x)?;
                let seen = |c: usize| (1.0 - w) * vertices[i][c] + w * vertices[i + 1][c];
                let y = std::array::from_fn(|c| Some(seen(c) + self.sigma_y * noise()));
                all.push(self.observation(step, p, y)?);
            }
        }
        Ok(all)
    }
}

/// A rod of 1 m and 5 mm radius, from rest, straight down and unstretched; its clamp goes round once a
/// second.
#[derive(Debug, Clone, Copy)]
pub struct DrivenRod {
    /// Equal segments.
    pub segments: usize,
    /// Young's modulus \[Pa\]; the shear modulus is a third of it.
    pub modulus: f64,
    /// Whether angles are unknowns although the rod cannot twist.
    pub twist: TwistUnknowns,
    /// Of its steps.
    pub scheme: Scheme,
}

impl DrivenRod {
    /// The soft one: 25 segments, 1 MPa, no angles, backward Euler.
    pub const SOFT: DrivenRod = DrivenRod {
        segments: 25,
        modulus: 1e6,
        twist: TwistUnknowns::WhereNeeded,
        scheme: Scheme::BackwardEuler,
    };

    /// The rod.
    ///
    /// # Errors
    /// Impossible numbers.
    pub fn rod(&self) -> Result<Rod> {
        let e = self.modulus;
        let material = Material { youngs_modulus: e, shear_modulus: e / 3.0, density: 1200.0 };
        Ok(Rod::uniform(1.0, self.segments, &Section::circle(&material, 0.005))?)
    }

    /// How it is held: vertices 0 and 1 driven.
    pub fn supports(&self) -> Supports {
        let drive = |t: f64| [0.10 * (1.0 - (TAU * t).cos()), 0.05 * (TAU * t).sin(), 0.0];
        Supports::clamped_start(Clamp::new(ClampAt::Edge, drive, [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]))
    }

    /// Its weight.
    pub fn loads(&self) -> Loads {
        Loads { gravity: [0.0, 0.0, -9.81].into(), ..Loads::default() }
    }

    /// Its step, and the control at rest, straight down and unstretched.
    ///
    /// # Errors
    /// Impossible numbers.
    pub fn step(&self) -> Result<(RodStep, Vec<f64>)> {
        let (rod, supports) = (self.rod()?, self.supports());
        let start = straight_guess(&rod, &supports, 0.0, [0.0, 0.0, -1.0])?;
        let step = RodStep::with_twist(rod, supports, self.loads(), Damping::default(), self.twist)?;
        let control = step.control_at_rest(&start);
        Ok((step.with_scheme(self.scheme), control))
    }

    /// Steps of Δt from time 0, and the state at rest.
    ///
    /// # Errors
    /// Impossible numbers.
    pub fn model(&self, dt: f64) -> Result<(ImplicitModel<RodStep>, Vec<f64>)> {
        let (step, control) = self.step()?;
        let mut model = ImplicitModel::new(step, 0, dt);
        let mut x = vec![0.0; model.dim()];
        model.initial_state(&control, &mut x)?;
        Ok((model, x))
    }
}

/// A rod of one kind, to take single steps of.
pub struct RodCase {
    /// What is special about it.
    pub name: &'static str,
    /// Its step.
    pub model: ImplicitModel<RodStep>,
    /// A control near which it steps.
    pub control: Vec<f64>,
}

/// Rods with every feature the step has: twist, both dampings, both ends clamped, pinned, no bending,
/// everything at once, and by the second-order schemes, with and without a state before.
///
/// # Errors
/// A rod that cannot be made.
pub fn rods() -> Result<Vec<RodCase>> {
    let damping = |stiffness, mass| Damping { stiffness, mass };
    let clamped = || Supports::clamped_start(swinging());
    Ok(vec![
        rod_case("rod without twist", straight(8, false)?, clamped(), damping(0.0, 0.0))?,
        rod_case("anisotropic rod with twist", curved()?, clamped(), damping(0.0, 0.0))?,
        rod_case("rod with both dampings", straight(8, false)?, clamped(), damping(0.004, 0.7))?,
        rod_case("anisotropic rod with both dampings", curved()?, clamped(), damping(0.004, 0.7))?,
        rod_case("rod clamped at both ends", straight(8, false)?, both_ends(), damping(0.0, 0.0))?,
        rod_case("damped anisotropic rod clamped at both ends", curved()?, both_ends(), damping(0.004, 0.7))?,
        rod_case(
            "damped anisotropic rod hung and clamped",
            curved()?,
            hung_and_clamped(),
            damping(0.004, 0.7),
        )?,
        rod_case("pinned anisotropic rod", curved()?, pinned(), damping(0.004, 0.0))?,
        rod_case("chain", straight(8, true)?, clamped(), damping(0.004, 0.7))?,
        by(Scheme::Midpoint, rod_case("rod by midpoint", straight(8, false)?, clamped(), damping(0.0, 0.7))?),
        by(
            Scheme::Midpoint,
            rod_case("anisotropic rod by midpoint", curved()?, clamped(), damping(0.0, 0.0))?,
        ),
        by(
            Scheme::Midpoint,
            rod_case("damped anisotropic rod by midpoint", curved()?, both_ends(), damping(0.004, 0.7))?,
        ),
        by(Scheme::Bdf2, rod_case("rod by bdf2", straight(8, false)?, clamped(), damping(0.0, 0.7))?),
        by(
            Scheme::Bdf2,
            rod_case("damped anisotropic rod by bdf2", curved()?, both_ends(), damping(0.004, 0.7))?,
        ),
    ])
}

/// Rods with loads that depend on their motion: drag, forces that turn with sections, moments; with and
/// without twist otherwise.
///
/// # Errors
/// A rod that cannot be made.
pub fn loaded_rods() -> Result<Vec<RodCase>> {
    let damping = |stiffness, mass| Damping { stiffness, mass };
    let clamped = || Supports::clamped_start(swinging());
    // past the rod one way at all times: drag is once differentiable where it turns
    let flow = [0.7, 0.4, 4.0].into();
    let drag = || Arc::new(Drag { flow, tangential: 0.3, ..Drag::of(30.0, 0.02) });
    let (plain, bent) = (straight(8, false)?, curved()?);
    let push = Arc::new(FollowerForce::new(&bent, 0.6, |t: f64| [0.1 + t, -0.1, 0.1])?);
    let jet = Arc::new(FollowerForce::tangential(&bent, bent.length(), |_| -0.1)?);
    let turning = Arc::new(Moment::new(&bent, 0.5, |t: f64| [0.02, -0.02 - 0.1 * t, 0.03])?);
    let twisting = Arc::new(Moment::about_tangent(&plain, 0.9, |_| 0.02)?);
    Ok(vec![
        by(
            Scheme::Bdf2,
            loaded("rod in a current", vec![drag()], plain.clone(), clamped(), damping(0.0, 0.7))?,
        ),
        by(
            Scheme::Midpoint,
            loaded("pushed and turned rod", vec![push, jet, turning], bent, clamped(), damping(0.0, 0.0))?,
        ),
        loaded("twisted rod in a current", vec![drag(), twisting], plain, both_ends(), damping(0.004, 0.7))?,
    ])
}

/// The same rod by another scheme.
fn by(scheme: Scheme, case: RodCase) -> RodCase {
    let step = case.model.into_inner().with_scheme(scheme);
    RodCase { model: ImplicitModel::new(step, FIRST, DT), ..case }
}

const MATERIAL: Material = Material { youngs_modulus: 1e6, shear_modulus: 1e6 / 3.0, density: 1100.0 };

/// Δt of the rods above \[s\].
pub const DT: f64 = 0.01;
/// Index of their first step.
pub const FIRST: usize = 3;

fn rod_case(name: &'static str, rod: Rod, supports: Supports, damping: Damping) -> Result<RodCase> {
    loaded(name, Vec::new(), rod, supports, damping)
}

fn loaded(
    name: &'static str,
    of_motion: Vec<Arc<dyn Load>>,
    rod: Rod,
    supports: Supports,
    damping: Damping,
) -> Result<RodCase> {
    let force = |t: f64| [0.02 * t.cos(), 0.01, 0.0];
    let loads =
        Loads { gravity: [0.0, 0.0, -9.81].into(), point_forces: vec![(0.61, Arc::new(force))], of_motion };
    let start = FIRST as f64 * DT;
    let clamped_at_end = supports.end.is_some();
    let clamps = supports.start.iter().count() + supports.end.iter().count();
    let mut shape = straight_guess(&rod, &supports, start, [0.0, 0.0, -1.0])?;
    if clamped_at_end {
        shape = equilibrium(&rod, &supports, &loads, start, &shape)?.0;
    }
    let model = ImplicitModel::new(RodStep::new(rod, supports, loads, damping)?, FIRST, DT);
    let mut control = model.step_ref().control_at_rest(&shape);
    let positions = control.len() / 2;
    if clamps == 0 {
        // Bowed, so that a curved rod free to spin has one stable angle.
        control[..positions].chunks_exact_mut(3).for_each(|x| x[0] += 0.4 * x[2] * x[2]);
    }
    for (i, z) in control.iter_mut().enumerate() {
        // 4 mm and 0.2 m/s of smooth noise
        *z += if i < positions { 0.004 } else { 0.2 } * wave(i, 1);
    }
    Ok(RodCase { name, model, control })
}

/// Typical sizes of the components of a rod's state: 1 cm, 1 m/s, 0.1 rad.
pub fn rod_scale(step: &RodStep) -> Vec<f64> {
    let n = step.control_len() / 2;
    let mut scale = vec![0.01; n];
    scale.resize(2 * n, 1.0);
    scale.resize(step.dim() - step.history(), 0.1);
    scale.extend_from_within(..step.history());
    scale
}

/// A deterministic sequence in [−1, 1], different for every seed.
pub fn wave(i: usize, seed: usize) -> f64 {
    (12.9898 * (i as f64 + 1.0) + 78.233 * seed as f64).sin()
}

fn straight(segments: usize, chain: bool) -> Result<Rod> {
    let mut section = Section::circle(&MATERIAL, 0.01);
    if chain {
        (section.ei1, section.ei2, section.gj) = (0.0, 0.0, 0.0);
    }
    Ok(Rod::uniform(0.9, segments, &section)?)
}

/// Anisotropic, naturally curved and twisted, unequal segments, a point mass.
fn curved() -> Result<Rod> {
    let lengths: Vec<f64> = (0..9).map(|i| 0.1 + 0.02 * (i as f64).sin()).collect();
    let section = Section::ellipse(&MATERIAL, 0.012, 0.009);
    let mut rod = Rod::with_segments(&lengths, &section)?.naturally([0.5, -0.3], 0.8);
    rod.add_point_mass(0.5, 0.05)?;
    Ok(rod)
}

/// A clamp that moves, swings and turns about itself.
fn swinging() -> Clamp {
    Clamp::new(
        ClampAt::Edge,
        drive(),
        |t: f64| [0.3 * (3.0 * t).sin(), 0.1, -1.0],
        |t: f64| [(4.0 * t).cos(), (4.0 * t).sin(), 0.0],
    )
}

fn drive() -> EllipseDrive {
    EllipseDrive { centre: [0.0; 3].into(), radii: [0.06, 0.03], omega: 10.0, phase: 0.0, ramp: 0.1 }
}

fn both_ends() -> Supports {
    let end = Clamp::new(
        ClampAt::Edge,
        |t: f64| [0.35 + 0.05 * t, 0.1, -0.4],
        [0.8, 0.2, 0.6],
        |t: f64| [(2.0 * t).sin(), (2.0 * t).cos(), 0.3],
    );
    Supports { start: Some(swinging()), end: Some(end), ..Supports::default() }
}

/// The first vertex driven, the last edge held at its face: the first frame is carried from a direction that
/// does not move.
fn hung_and_clamped() -> Supports {
    let end = Clamp::new(
        ClampAt::Face,
        |t: f64| [0.35 + 0.05 * t, 0.1, -0.4],
        [0.8, 0.2, 0.6],
        |t: f64| [(2.0 * t).sin(), (2.0 * t).cos(), 0.3],
    );
    Supports {
        end: Some(end),
        prescribed: vec![(0, Arc::new(drive()))],
        free_frame: ([0.0, 0.0, -1.0].into(), [1.0, 0.0, 0.0].into()),
        ..Supports::default()
    }
}

/// The first vertex driven, a later one held; the frame of the first edge carried from straight down.
fn pinned() -> Supports {
    Supports {
        prescribed: vec![(0, Arc::new(drive())), (5, Arc::new([0.1, 0.0, -0.505]))],
        free_frame: ([0.0, 0.0, -1.0].into(), [1.0, 0.0, 0.0].into()),
        ..Supports::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use varda_assimilation::{ControlTransform, CostFunction, StrongConstraint};

    /// Points on the prescribed edge and beside it: the known motion is on the observed side, so that the
    /// truth fits exactly.
    #[test]
    fn observed_points_may_touch_prescribed_vertices() {
        let (mut rod, truth) = HangingRod::flagship(1, true).unwrap();
        rod.s_over_length = vec![0.0, 0.03, 0.04, 0.05, 0.5, 1.0];
        let observations = rod.observe(&truth, &mut || 0.0).unwrap();
        let mut model = rod.model(rod.first_step).unwrap();
        let mut set = rod.observation_set(model.dim(), observations).unwrap();
        let b = rod.background_covariance().unwrap();
        let transform = ControlTransform::new(truth, &b).unwrap();
        let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
        let j = cost.evaluate(&[0.0; 144], None).unwrap();
        // 360 coordinates of rounding size over σ = 0.1
        assert!(j < 1e-25, "{j:e}");
    }
}
