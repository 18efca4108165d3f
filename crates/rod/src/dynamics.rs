//! Time steps of the rod for the generic layer.

use nalgebra::Vector3;
use varda_implicit::{Interval, Refusal, Scheme};

use crate::Error;
use crate::at_rest::AtRest;
use crate::change::Parameters;
use crate::damping::KelvinVoigt;
use crate::equilibrium::Rest;
use crate::predict::Carry;
use crate::rod::Rod;
use crate::spin::Spin;
use crate::stage::{RodStage, mixed, mixed_add};
use crate::support::{Damping, Loads, Supports};
use crate::system::{StageStart, System};
use crate::twist_equilibrium::TwistEquilibrium;

/// A step of a rod with massless twist (paper, section 3), by backward Euler or one of the second-order
/// schemes.
///
/// ```text
/// X_{k+1} − X_k − Δt V_{k+1} = 0                                               (backward Euler)
/// M (V_{k+1} − V_k) + Δt (∂E/∂X(X_{k+1}, θ_{k+1}) + α M V_{k+1} − F_ext(t_{k+1})) = 0
/// ∂E/∂θ(X_{k+1}, θ_{k+1}) = 0
/// ```
///
/// Every [`Scheme`] is one such step of length η from a point (X*, V*) between the last states to a stage
/// (Y, θ_y) at time t* where forces and supports are taken (midpoint: Y = ½(X_k + X_{k+1}), t* = t_{k+½}),
/// so there is one step here and [`Scheme::stage`] gives the weights. V is eliminated: the unknowns are u =
/// (Y, θ_y), interleaved along the rod so that ∂G/∂u is a symmetric band (half-bandwidth 10; 8 without
/// twist; 5 for a chain), and G = ∂Φ/∂u is the gradient of
///
/// ```text
/// Φ(u) = |Y − X* − η V*|²_M / (2η²) + α |Y − X*|²_M / (2η)
///      + E(Y, θ_y) + (β/2η) Σ k (ε − ε*)² − F_ext(t*)·Y
/// ```
///
/// State x = [X, V, θ] of the free vertices and angles (SI units: m, m/s, rad); under BDF2, and under
/// midpoint with twist or Kelvin–Voigt damping, followed by the same of the step before. Control z =
/// [X₀, V₀], θ₀ being the twist equilibrium of X₀ nearest to the untwisted frame.
///
/// With [`Rod::spin_inertia`] the third equation is I^i θ̈^i = T_i + T_ext (paper, section 3), θ̇ being
/// the spin ω of a section about its tangent, measured against the director that parallel transport carries
/// along with the tangent in time. Φ gains ½ I (s − s*)²/η² of the spins s within the stage, and the
/// state is [X, V, θ, ω]; ω₀ = 0, unless the control has it ([`RodStep::with_spins_in_control`]). Where
/// both ends are clamped the end clamp's angle stands at the end of the state: unwrapped, it counts the turns
/// of the clamps, and each step takes it on the branch that their motion leads to. Use it inside
/// [`ImplicitModel`](varda_implicit::ImplicitModel); [`RodStep::model`] does.
///
/// First guess of a step: X_k carried along rigidly with the supports, θ_k; where Φ is lower there, with
/// its edges turned towards those of X* + η V* as well.
///
/// ```
/// use varda_implicit::{Model, Scheme};
/// use varda_rod::{Clamp, ClampAt, Damping, Loads, Material, Rod, RodStep, Section, Supports, Vector3};
/// use varda_rod::straight_guess;
///
/// let rod = Rod::uniform(1.0, 20, &Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01))?;
/// let supports = Supports::clamped_start(Clamp::new(ClampAt::Edge, [0.0; 3], Vector3::x(), Vector3::z()));
/// let loads = Loads { gravity: Vector3::new(0.0, 0.0, -9.81), ..Loads::default() };
/// let guess = straight_guess(&rod, &supports, 0.0, Vector3::x())?;
/// let step = RodStep::new(rod, supports, loads, Damping::default())?.with_scheme(Scheme::Bdf2);
///
/// // Let go straight and at rest, for one step of 0.01 s: the first of BDF2 is midpoint's, ½ g Δt² down.
/// let (control, tip) = (step.control_at_rest(&guess), step.free_vertices().len() - 1);
/// let mut model = step.model(0, 0.01);
/// let (mut x, mut next) = (vec![0.0; model.dim()], vec![0.0; model.dim()]);
/// model.initial_state(&control, &mut x)?;
/// model.step(0, &x, &mut next)?;
/// assert!((next[3 * tip + 2] + 0.5 * 9.81 * 1e-4).abs() < 1e-6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct RodStep {
    pub(crate) system: System,
    pub(crate) scheme: Scheme,
    pub(crate) damping: Damping,
    pub(crate) viscous: Option<KelvinVoigt>,
    pub(crate) twist: Option<TwistEquilibrium>,
    pub(crate) spin: Option<Spin>,
    spins_in_control: bool,
    pub(crate) parameters: Option<Box<Parameters>>,
    /// Every step ends at rest, and what the first state then needs.
    pub(crate) is_at_rest: bool,
    pub(crate) at_rest: Option<Box<AtRest>>,
    pub(crate) carry: Carry,
    /// X* and X* + η V* of the free vertices in the step being worked on.
    pub(crate) start: Vec<Vector3<f64>>,
    pub(crate) target: Vec<Vector3<f64>>,
    /// X* of all vertices, where a load depends on the motion, and δX* by unknowns.
    pub(crate) start_of_all: Vec<Vector3<f64>>,
    pub(crate) star: Vec<f64>,
    pub(crate) end_angle: f64,
    pub(crate) tolerance: f64,
    pub(crate) state: Vec<f64>,
    pub(crate) lambda: Vec<f64>,
    pub(crate) displacement: Vec<Vector3<f64>>,
    pub(crate) psi: Vec<f64>,
    /// Work space of second derivatives, nothing until they are asked for: μ in the full order, and two
    /// vectors of unknowns.
    pub(crate) full: Vec<f64>,
    pub(crate) of_unknowns: [Vec<f64>; 2],
}

impl RodStep {
    /// By backward Euler; [`RodStep::with_scheme`] chooses another.
    ///
    /// # Errors
    /// [`Error`] naming the field, vertex or place that is impossible.
    pub fn new(rod: Rod, supports: Supports, loads: Loads, damping: Damping) -> Result<Self, Error> {
        Self::with_twist(rod, supports, loads, damping, TwistUnknowns::WhereNeeded)
    }

    /// The same, with the choice to keep twist unknowns that are provably zero (to check that leaving them
    /// out is right).
    ///
    /// # Errors
    /// As [`RodStep::new`].
    pub fn with_twist(
        rod: Rod,
        supports: Supports,
        loads: Loads,
        damping: Damping,
        twist: TwistUnknowns,
    ) -> Result<Self, Error> {
        Self::build(rod, supports, loads, damping, twist, false)
    }

    /// `by_angle`: bending may come to depend on the angles of sections though it does not now.
    pub(crate) fn build(
        rod: Rod,
        supports: Supports,
        loads: Loads,
        damping: Damping,
        twist: TwistUnknowns,
        by_angle: bool,
    ) -> Result<Self, Error> {
        let system = System::new(rod, supports, loads, &damping, twist == TwistUnknowns::Always)?;
        let (n, free) = (system.rod.segments(), system.layout.free_vertices.len());
        Ok(RodStep {
            scheme: Scheme::BackwardEuler,
            viscous: (damping.stiffness > 0.0).then(|| KelvinVoigt::new(&system, 1)),
            spin: Spin::new(&system, damping.stiffness > 0.0 || by_angle),
            twist: (!system.layout.free_angles.is_empty()).then(|| TwistEquilibrium::new(&system, by_angle)),
            spins_in_control: false,
            parameters: None,
            is_at_rest: false,
            at_rest: None,
            carry: Carry::new(&system),
            tolerance: 1e-11 * system.rod.length(),
            start: vec![Vector3::zeros(); free],
            target: vec![Vector3::zeros(); free],
            start_of_all: vec![Vector3::zeros(); n + 1],
            star: vec![0.0; system.layout.unknowns],
            end_angle: 0.0,
            state: vec![0.0; system.layout.state()],
            lambda: Vec::new(),
            displacement: vec![Vector3::zeros(); n + 1],
            psi: vec![0.0; n],
            full: Vec::new(),
            of_unknowns: [Vec::new(), Vec::new()],
            damping,
            system,
        })
    }

    /// The same rod integrated by another scheme.
    pub fn with_scheme(mut self, scheme: Scheme) -> Self {
        self.scheme = scheme;
        // configurations that ε* is made of: see `RodStage`
        let past = [(Scheme::BackwardEuler, 1), (Scheme::Midpoint, 3), (Scheme::Bdf2, 2)];
        let count = past.iter().find(|p| p.0 == scheme).map_or(0, |p| p.1);
        self.viscous = self.viscous.map(|_| KelvinVoigt::new(&self.system, count));
        self
    }

    /// The scheme.
    pub fn scheme(&self) -> Scheme {
        self.scheme
    }

    /// The rod itself.
    pub fn rod(&self) -> &Rod {
        &self.system.rod
    }

    /// What holds it.
    pub fn supports(&self) -> &Supports {
        &self.system.supports
    }

    /// Numbers of the vertices that are not prescribed, ascending: the order of X and V in the state.
    pub fn free_vertices(&self) -> &[usize] {
        &self.system.layout.free_vertices
    }

    /// Numbers of the edges whose angle θ is unknown, ascending; empty where twist is left out.
    pub fn free_angles(&self) -> &[usize] {
        &self.system.layout.free_angles
    }

    /// Length of the control z = [X₀, V₀], or [X₀, V₀, θ₀, ω₀].
    pub fn control_len(&self) -> usize {
        let angles = if self.spins_in_control { 2 * self.free_angles().len() } else { 0 };
        6 * self.system.layout.free_vertices.len() + angles
    }

    /// The same step with the control z = [X₀, V₀, θ₀, ω₀], where sections have inertia: free
    /// angles and their spins in place of angles in equilibrium and sections that do not spin.
    #[must_use]
    pub fn with_spins_in_control(mut self) -> RodStep {
        self.spins_in_control = self.system.layout.spins;
        self
    }

    /// The same step, the first angles of a run looked for from those of a shape at rest at time t \[s\],
    /// which picks their branch, not from zero; [`Clamp::turns`](crate::Clamp::turns) since then are added.
    ///
    /// # Panics
    /// If the shape has not one angle for every edge.
    #[must_use]
    pub fn starting_from(mut self, shape: &Rest, t: f64) -> RodStep {
        assert_eq!(shape.theta.len(), self.rod().segments(), "one angle for every edge");
        if let Some(twist) = &mut self.twist {
            twist.first = Some((shape.theta.clone(), self.system.supports.turns_at(t)));
        }
        self
    }

    /// The same where the end clamp has this angle at time t \[s\], whole turns included: that of a state
    /// ([`end_angle`](Self::end_angle)) whose places and velocities runs start from. Nothing changes where
    /// the rod has no such angle.
    #[must_use]
    pub fn with_end_angle(mut self, angle: f64, t: f64) -> RodStep {
        let (n, turns) = (self.rod().segments(), self.system.supports.turns_at(t));
        let held = self.system.layout.ends_held();
        if let Some(twist) = self.twist.as_mut().filter(|_| held) {
            let (mut theta, before) = twist.first.take().unwrap_or((vec![0.0; n], turns));
            let missing = angle - theta[n - 1] - std::f64::consts::TAU * (turns - before);
            // less than that picks no other branch
            if missing.abs() > 1.0 {
                let share = |e: usize| e as f64 / (n - 1) as f64;
                theta.iter_mut().enumerate().for_each(|(e, theta)| *theta += missing * share(e));
            }
            twist.first = Some((theta, before));
        }
        self
    }

    /// The angle of the end clamp in a state \[rad\], whole turns included; `None` where it is not part of
    /// the state: a rod without a director at both ends, or without twist.
    ///
    /// # Panics
    /// If `state` is shorter than a state.
    pub fn end_angle(&self, state: &[f64]) -> Option<f64> {
        self.system.layout.end_angle().map(|i| state[i])
    }

    /// The control z = [X₀, 0], or [X₀, 0, θ₀, 0], of the rod at rest in this shape.
    ///
    /// # Panics
    /// If the shape has fewer vertices or angles than the rod.
    pub fn control_at_rest(&self, shape: &Rest) -> Vec<f64> {
        let mut z = vec![0.0; self.control_len()];
        let angles = z[6 * self.free_vertices().len()..].iter_mut();
        angles.zip(self.free_angles()).for_each(|(angle, &e)| *angle = shape.theta[e]);
        for (x, &v) in z.chunks_exact_mut(3).zip(self.free_vertices()) {
            x.copy_from_slice(shape.vertices[v].as_slice());
        }
        z
    }

    /// Places of all vertices at time t in a state or control, prescribed ones included \[m\].
    ///
    /// # Errors
    /// [`Error`] where a support's motion is not usable at t.
    ///
    /// # Panics
    /// If `state` is shorter than the places and velocities of the free vertices.
    pub fn vertices(&mut self, t: f64, state: &[f64]) -> Result<Vec<Vector3<f64>>, Error> {
        self.system.place(t)?;
        let f = self.system.layout.free_vertices.len();
        assert!(state.len() >= 6 * f, "a state or control is at least {} long", 6 * f);
        for (i, &v) in self.system.layout.free_vertices.iter().enumerate() {
            self.system.x[v] = Vector3::from_column_slice(&state[3 * i..3 * i + 3]);
        }
        Ok(self.system.x.clone())
    }

    /// What this rod does not need and therefore does not have.
    pub fn left_out(&self) -> Vec<String> {
        let layout = &self.system.layout;
        let n = layout.segments;
        let mut out = Vec::new();
        if !layout.bending {
            out.push("bending and twisting: no stiffness against them (a chain)".to_string());
        } else if !layout.twist {
            out.push(format!(
                "{n} twist angles, frames and the twist energy: an isotropic, naturally straight rod held by \
                 one director does not twist"
            ));
        }
        if layout.twist && self.system.loads.need_angles() {
            out.push("no angle: a load turns sections or follows them".to_string());
        }
        if layout.spins {
            out.push("no angle: sections have inertia against twist".to_string());
        } else if !layout.free_angles.is_empty() {
            out.push("the inertia of sections against twist: their angles are in equilibrium".to_string());
        }
        let fixed = n + 1 - layout.free_vertices.len();
        if fixed > 0 {
            out.push(format!("{} unknowns and their Hessian blocks: {fixed} prescribed vertices", 3 * fixed));
        }
        if self.is_at_rest {
            out.push("inertia and damping: the rod is at rest at every step".to_string());
            return out;
        }
        if self.viscous.is_none() {
            out.push("strain-rate damping".to_string());
        }
        if self.damping.mass == 0.0 {
            out.push("mass-proportional damping".to_string());
        }
        out.push("velocities as unknowns of the step: they follow from the places".to_string());
        out
    }

    /// Half-bandwidth of ∂G/∂u.
    pub fn half_bandwidth(&self) -> usize {
        self.system.layout.half_bandwidth
    }

    /// Damping or inertia ties θ to its past.
    fn angles_have_rates(&self) -> bool {
        self.viscous.is_some() || self.system.layout.spins
    }

    pub(crate) fn stage(&self, at: &Interval) -> RodStage {
        RodStage::new(self.scheme, at, self.angles_have_rates(), self.repeated() > 0)
    }

    /// Sets everything that depends on the interval and x_k but not on u.
    pub(crate) fn prepare(&mut self, at: &Interval, x: &[f64]) -> Result<(), Refusal> {
        let stage = self.stage(at);
        let (h, from) = (stage.of.length, stage.of.from);
        let s = &mut self.system;
        let (own, nf) = (s.layout.state(), s.layout.free_vertices.len());
        if self.viscous.is_some() || s.layout.twist {
            s.place(at.start)?;
            s.scatter_state(x);
            let guess = s.end_angle_guess();
            s.update_shape(true, guess)?;
            self.end_angle = s.theta.last().copied().unwrap_or(0.0);
            if s.layout.ends_held() {
                self.end_angle += s.clamps_turn(at.start, stage.of.time)?.0;
            }
        }
        if let Some(spin) = &mut self.spin {
            spin.start_from(s);
        }
        if let Some(viscous) = &mut self.viscous {
            viscous.clear(s);
            viscous.add(s, stage.strain[0]);
            let before = at.previous.unwrap_or(0.0);
            for (of, age, weight) in stage.past().skip(1) {
                for (i, v) in self.state.iter_mut().enumerate() {
                    *v = mixed(of, x, own, i);
                }
                s.place(at.start - age * before)?;
                s.scatter_state(&self.state);
                let near = if s.layout.ends_held() { s.end_angle_guess() } else { self.end_angle };
                s.update_shape(true, near)?;
                viscous.add(s, weight);
            }
            viscous.fold_in(s, self.damping.stiffness / h);
        }
        if let Some(spin) = self.spin.as_mut().filter(|_| s.layout.spins) {
            if let Some(previous) = at.previous.filter(|_| stage.along[1] != 0.0) {
                s.place(at.start - previous)?;
                s.scatter_state(&x[own..]);
                s.update_shape(true, s.end_angle_guess())?;
                spin.came_from(s);
            }
            spin.aim(s, &stage, self.damping.mass, x)?;
        }
        if !s.loads.of_motion.is_empty() {
            self.start_of_all.fill(Vector3::zeros());
            let times = [at.start, at.start - at.previous.unwrap_or(0.0)];
            for (share, time) in from.into_iter().zip(times).filter(|(share, _)| *share != 0.0) {
                s.place(time)?;
                self.start_of_all.iter_mut().zip(&s.x).for_each(|(start, x)| *start += x * share);
            }
            for (f, &v) in s.layout.free_vertices.iter().enumerate() {
                self.start_of_all[v] = Vector3::from_fn(|c, _| mixed(from, x, own, 3 * f + c));
            }
        }
        s.place(stage.of.time)?;
        for f in 0..nf {
            let star = |i: usize| Vector3::from_fn(|c, _| mixed(from, x, own, 3 * i + c));
            self.start[f] = star(f);
            self.target[f] = self.start[f] + star(nf + f) * h;
        }
        Ok(())
    }

    /// Where the stage of length η starts, for the velocities that loads see.
    pub(crate) fn stage_start(&self, length: f64) -> StageStart<'_> {
        StageStart { places: &self.start_of_all, length }
    }

    /// The same for loads of the motion; none at rest, where nothing moves.
    pub(crate) fn start_of_motion(&self, length: f64) -> Option<StageStart<'_>> {
        (!self.is_at_rest).then(|| self.stage_start(length))
    }

    /// `star` = δX* by unknowns, from an increment of the state.
    pub(crate) fn star(&mut self, from: [f64; 2], dx: &[f64]) {
        let layout = &self.system.layout;
        self.star.fill(0.0);
        for (f, &v) in layout.free_vertices.iter().enumerate() {
            let i = layout.unknown[layout.vertex(v)];
            for c in 0..3 {
                self.star[i + c] = mixed(from, dx, layout.state(), 3 * f + c);
            }
        }
    }

    /// The transpose of `star`: dx += what acts on X*, by unknowns.
    pub(crate) fn star_transpose_add(&self, from: [f64; 2], star: &[f64], dx: &mut [f64]) {
        let layout = &self.system.layout;
        for (f, &v) in layout.free_vertices.iter().enumerate() {
            let i = layout.unknown[layout.vertex(v)];
            mixed_add(from, dx, layout.state(), 3 * f, [star[i], star[i + 1], star[i + 2]]);
        }
    }

    /// What M is multiplied by in the stage's equations: 1/η² and α/η, nothing at rest.
    pub(crate) fn inertia(&self, h: f64) -> [f64; 2] {
        if self.is_at_rest { [0.0; 2] } else { [1.0 / (h * h), self.damping.mass / h] }
    }

    /// How many components at the end of the state repeat the first ones of the state before.
    pub(crate) fn repeated(&self) -> usize {
        let layout = &self.system.layout;
        match self.scheme {
            Scheme::BackwardEuler => 0,
            Scheme::Midpoint if self.viscous.is_none() && layout.free_angles.is_empty() => 0,
            Scheme::Midpoint | Scheme::Bdf2 => layout.state(),
        }
    }

    /// Edges and turns at u. The point was assembled before, so its geometry is sound.
    ///
    /// Places the supports first: products of other steps may have been asked for in between.
    pub(crate) fn set_edges_of(&mut self, at: &Interval, u: &[f64]) {
        self.system.place(self.scheme.stage(at).time).expect("the step was accepted before");
        self.system.scatter(u);
        self.system.update_shape(true, self.end_angle).expect("u was assembled before");
    }

    /// The present step's strains and shapes at x and u.
    pub(crate) fn prepare_and_shape(&mut self, at: &Interval, x: &[f64], u: &[f64]) {
        self.prepare(at, x).expect("the step was accepted before");
        self.system.scatter(u);
        self.system.update_shape(true, self.end_angle).expect("the step was accepted before");
    }
}

/// Whether twist angles are unknowns where they are provably zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TwistUnknowns {
    /// Left out where they are provably zero (the default).
    WhereNeeded,
    /// Kept wherever the rod bends.
    Always,
}
