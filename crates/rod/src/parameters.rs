//! Constants of a rod as parameters: what they change, and ∂G/∂p.

use nalgebra::Vector3;
use varda_implicit::{Law, ParametricStep, Refusal, SolvedStep};

use crate::Error;
use crate::damping::KelvinVoigt;
use crate::dynamics::{RodStep, TwistUnknowns};
use crate::element::{self, Strains};
use crate::forces_of_motion::Motion;
use crate::layout::FIXED;
use crate::rod::Rod;
use crate::support::{Damping, Loads, Supports};
use crate::system::{PastStrains, System};

/// By how much the constants of a rod change with a parameter, times g(p) of its [`Law`]. Lists that are
/// empty change nothing; others have the length of that of the [`Rod`].
///
/// ```
/// use varda_rod::{Change, Law, Material, Parameter, Rod, Section};
///
/// let rod = Rod::uniform(1.0, 20, &Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01))?;
/// // EI = EI₀ eᵖ, and κ̄₁ = p per length
/// let ei = Change { ei: rod.ei.clone(), ..Change::default() };
/// let stiffness = Parameter { change: ei, law: Law::Exponential };
/// let curvature = rod.voronoi_lengths.iter().map(|l| [*l, 0.0]).collect();
/// let change = Change { natural_curvature: curvature, ..Change::default() };
/// let set = Parameter { change, law: Law::Linear };
/// assert!((stiffness.law.value(0.1) - 0.105).abs() < 2e-4 && set.law.slope(0.1) == 1.0);
/// # Ok::<(), varda_rod::Error>(())
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Change {
    /// Of [`Rod::ea`] \[N\].
    pub ea: Vec<f64>,
    /// Of [`Rod::ei`] \[N m²\].
    pub ei: Vec<[f64; 3]>,
    /// Of [`Rod::gj`] \[N m²\].
    pub gj: Vec<f64>,
    /// Of [`Rod::natural_curvature`], integrated \[–\].
    pub natural_curvature: Vec<[f64; 2]>,
    /// Of [`Rod::natural_twist`], integrated \[rad\].
    pub natural_twist: Vec<f64>,
    /// Of [`Rod::masses`] \[kg\].
    pub masses: Vec<f64>,
    /// Of [`Rod::spin_inertia`] \[kg m²\].
    pub spin_inertia: Vec<f64>,
    /// Of the damping: β \[s\] and α [1/s].
    pub damping: Damping,
    /// Of the acceleration of gravity [m/s²].
    pub gravity: Vector3<f64>,
}

impl Change {
    /// Whether bending depends on the angles of sections once the parameter is not zero.
    fn bends_by_angle(&self) -> bool {
        self.ei.iter().any(|k| k[0] != k[2] || k[1] != 0.0)
            || self.natural_curvature.iter().any(|k| *k != [0.0; 2])
    }

    fn needs_angles(&self) -> bool {
        self.bends_by_angle() || self.natural_twist.iter().any(|t| *t != 0.0)
    }

    fn is_of_bending(&self) -> bool {
        !(self.ei.is_empty()
            && self.gj.is_empty()
            && self.natural_curvature.is_empty()
            && self.natural_twist.is_empty())
    }
}

/// A parameter of a rod, zero at the rod as it is described.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// What it changes.
    pub change: Change,
    /// The constants are those at p = 0, and g(p) times the change.
    pub law: Law,
}

/// The parameters of a rod, and its constants where all are zero.
pub(crate) struct Parameters {
    list: Vec<Parameter>,
    rod: Rod,
    damping: Damping,
    gravity: Vector3<f64>,
    /// g′ of each at the present values.
    slopes: Vec<f64>,
    /// δσ of a Kelvin–Voigt element comes from the strains of the past, where there are any.
    none: PastStrains,
}

impl RodStep {
    /// The step of a rod that some constants of are parameters, each zero at the rod given: inside
    /// [`WithParameters`](varda_implicit::WithParameters) they are part of the state. By backward Euler;
    /// [`RodStep::with_scheme`] chooses another.
    ///
    /// Twist is among the unknowns where it would be with the constants that parameters lead to. A list of a
    /// change is that of the rod between the faces of its clamps ([`Rod::with_faces`]).
    ///
    /// ```
    /// use varda_implicit::{ImplicitModel, Model, WithParameters};
    /// use varda_rod::{
    ///     Change, Clamp, ClampAt, Damping, Law, Loads, Material, Parameter, Rod, RodStep, Section, Supports,
    ///     Vector3, straight_guess,
    /// };
    ///
    /// let section = Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01);
    /// let rod = Rod::uniform(1.0, 20, &section)?;
    /// let stiffness = Change { ei: rod.ei.clone(), ..Change::default() };
    /// let unknown = vec![Parameter { change: stiffness, law: Law::Exponential }];
    /// let clamp = Clamp::new(ClampAt::Edge, [0.0; 3], Vector3::x(), Vector3::z());
    /// let supports = Supports::clamped_start(clamp);
    /// let loads = Loads { gravity: Vector3::new(0.0, 0.0, -9.81), ..Loads::default() };
    /// let step = RodStep::with_parameters(rod, supports, loads, Damping::default(), unknown)?;
    /// let guess = straight_guess(step.rod(), step.supports(), 0.0, Vector3::x())?;
    /// let mut control = step.control_at_rest(&guess);
    /// control.push(0.2); // 22 % stiffer
    ///
    /// let mut model = ImplicitModel::new(WithParameters::new(step, 0), 0, 0.01);
    /// let (mut x, mut next) = (vec![0.0; model.dim()], vec![0.0; model.dim()]);
    /// model.initial_state(&control, &mut x)?;
    /// model.step(0, &x, &mut next)?;
    /// assert_eq!(next[control.len() - 1], 0.2);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// As [`RodStep::new`]; a list of the wrong length; a change of what the rod does not have: bending of a
    /// chain, spin inertia of massless twist, damping that is zero.
    pub fn with_parameters(
        rod: Rod,
        supports: Supports,
        loads: Loads,
        damping: Damping,
        parameters: Vec<Parameter>,
    ) -> Result<RodStep, Error> {
        let twist = match parameters.iter().any(|p| p.change.needs_angles()) {
            true => TwistUnknowns::Always,
            false => TwistUnknowns::WhereNeeded,
        };
        let by_angle = parameters.iter().any(|p| p.change.bends_by_angle());
        let mut step = RodStep::build(rod, supports, loads, damping, twist, by_angle)?;
        let rod = step.rod().clone();
        for parameter in &parameters {
            check(&parameter.change, &rod, &damping, step.system.layout.bending)?;
        }
        let gravity = step.system.loads.gravity;
        let slopes = vec![1.0; parameters.len()];
        let none = PastStrains::default();
        step.parameters =
            Some(Box::new(Parameters { list: parameters, rod, damping, gravity, slopes, none }));
        Ok(step)
    }
}

/// # Errors
/// See [`RodStep::with_parameters`].
fn check(change: &Change, rod: &Rod, damping: &Damping, bending: bool) -> Result<(), Error> {
    let (n, inner) = (rod.segments(), rod.ei.len());
    let lists = [
        ("change of EA", change.ea.len(), n),
        ("change of EI", change.ei.len(), inner),
        ("change of GJ", change.gj.len(), inner),
        ("change of natural curvature", change.natural_curvature.len(), inner),
        ("change of natural twist", change.natural_twist.len(), inner),
        ("change of masses", change.masses.len(), n + 1),
        ("change of spin inertia", change.spin_inertia.len(), rod.spin_inertia.len()),
    ];
    for (field, found, expected) in lists {
        if found != 0 && found != expected {
            return Err(Error::Count { field, found, expected });
        }
    }
    if change.is_of_bending() && !bending {
        return Err(Error::Value { field: "EI of a parameter", value: 0.0, expected: "a rod that bends" });
    }
    let pairs = [
        ("damping.stiffness", change.damping.stiffness, damping.stiffness),
        ("damping.mass", change.damping.mass, damping.mass),
    ];
    for (field, change, value) in pairs {
        if change != 0.0 && !(value > 0.0) {
            let expected = "a positive number, the prior of its parameter";
            return Err(Error::Value { field, value, expected });
        }
    }
    Ok(())
}

/// What a parameter does to ∂E/∂(x, θ) in the full order, to the moments of bent vertices, and to the
/// weight and inertia of every vertex.
pub(crate) struct ChangeOfForces {
    pub(crate) gradient: Vec<f64>,
    pub(crate) moments: Vec<[f64; 3]>,
    pub(crate) forces: Vec<Vector3<f64>>,
}

impl Parameters {
    /// How many there are.
    pub(crate) fn len(&self) -> usize {
        self.list.len()
    }

    /// What each does to the forces within the rod, the system having the shape of a state.
    pub(crate) fn of_forces(
        &self,
        system: &mut System,
        motion: &Motion,
        damping: &Damping,
    ) -> Vec<ChangeOfForces> {
        let (h, mut past) = (motion.start.length, PastStrains::default());
        if let Some(then) = motion.past {
            past.lengths = then.shape.edges.iter().map(|edge| edge.l).collect();
            past.bend = then.strains.iter().map(|strains| strains.value).collect();
        }
        let of = |(p, slope): (&Parameter, &f64)| {
            let Parameter { change, .. } = p;
            let rates = [damping.stiffness / h, change.damping.stiffness / h];
            system.change_of_elastic(change, rates, &past);
            let stress = |i| system.change_of_stress(i, change, rates, &past).1.map(|s| slope * s);
            let bent = if system.layout.bending { 1..system.layout.segments } else { 0..0 };
            let force = |v: usize| {
                let [velocity, acceleration] = motion.held[v];
                let (mass, more) = (system.rod.masses[v], change.masses.get(v).copied().unwrap_or(0.0));
                let gravity = system.loads.gravity;
                let each = (gravity - acceleration - velocity * damping.mass) * more
                    + (change.gravity - velocity * change.damping.mass) * mass;
                each * *slope
            };
            ChangeOfForces {
                moments: bent.map(stress).collect(),
                forces: (0..system.x.len()).map(force).collect(),
                gradient: system.gradient.iter().map(|g| slope * g).collect(),
            }
        };
        self.list.iter().zip(&self.slopes).map(of).collect()
    }

    /// The constants at p.
    fn constants(&mut self, p: &[f64], rod: &mut Rod) -> (Damping, Vector3<f64>) {
        rod.clone_from(&self.rod);
        let (mut damping, mut gravity) = (self.damping, self.gravity);
        for ((Parameter { change, law }, slope), &p) in self.list.iter().zip(&mut self.slopes).zip(p) {
            let g = law.value(p);
            *slope = law.slope(p);
            add(&mut rod.ea, &change.ea, g);
            add(&mut rod.gj, &change.gj, g);
            add(&mut rod.natural_twist, &change.natural_twist, g);
            add(&mut rod.masses, &change.masses, g);
            add(&mut rod.spin_inertia, &change.spin_inertia, g);
            rod.ei.iter_mut().zip(&change.ei).for_each(|(a, b)| add(a, b, g));
            rod.natural_curvature.iter_mut().zip(&change.natural_curvature).for_each(|(a, b)| add(a, b, g));
            damping.stiffness += g * change.damping.stiffness;
            damping.mass += g * change.damping.mass;
            gravity += change.gravity * g;
        }
        (damping, gravity)
    }
}

fn add(to: &mut [f64], change: &[f64], g: f64) {
    to.iter_mut().zip(change).for_each(|(to, change)| *to += g * change);
}

impl ParametricStep for RodStep {
    fn parameters(&self) -> usize {
        self.parameters.as_ref().map_or(0, |p| p.list.len())
    }

    fn set_parameters(&mut self, p: &[f64]) -> Result<(), Refusal> {
        let Some(parameters) = &mut self.parameters else { return Ok(()) };
        let (damping, gravity) = parameters.constants(p, &mut self.system.rod);
        self.system.rod.check()?;
        crate::material::positive_or_none("damping.stiffness", self.damping.stiffness, damping.stiffness)?;
        crate::material::positive_or_none("damping.mass", self.damping.mass, damping.mass)?;
        self.damping = damping;
        self.system.loads.gravity = gravity;
        self.system.set_stiffness(0.0, None);
        if let Some(twist) = &mut self.twist {
            twist.take_constants(&self.system);
        }
        Ok(())
    }

    fn parameter_jacobian(&mut self, of: &SolvedStep<'_>, columns: &mut [f64]) {
        self.set_edges_of(of.at, of.u);
        if let Some(spin) = &mut self.spin {
            spin.measure(&self.system).expect("the step was accepted before");
        }
        let Some(parameters) = self.parameters.take() else { return };
        let all = parameters.list.iter().zip(&parameters.slopes);
        for ((p, &slope), column) in all.zip(columns.chunks_exact_mut(of.u.len())) {
            self.change_of_equations(of, &p.change, &parameters.none, column);
            column.iter_mut().for_each(|g| *g *= slope);
        }
        self.parameters = Some(parameters);
    }

    fn initial_parameter_jacobian(&mut self, columns: &mut [f64]) {
        columns.fill(0.0);
        let (layout, given) = (&self.system.layout, self.control_len());
        let (Some(parameters), Some(twist)) = (&self.parameters, &mut self.twist) else { return };
        // angles that are part of the control do not follow
        let first = 6 * layout.free_vertices.len();
        if given > first {
            return;
        }
        let all = parameters.list.iter().zip(&parameters.slopes);
        for ((p, slope), column) in all.zip(columns.chunks_exact_mut(layout.state())) {
            let angles = &mut column[first..first + layout.free_angles.len()];
            twist.change(&p.change, angles);
            angles.iter_mut().for_each(|a| *a *= slope);
        }
    }
}

impl RodStep {
    /// What a change of the constants does to G at the present shape, that of a solved step.
    fn change_of_equations(
        &mut self,
        of: &SolvedStep<'_>,
        change: &Change,
        none: &PastStrains,
        dg: &mut [f64],
    ) {
        let h = self.scheme.stage(of.at).length;
        let past = self.viscous.as_ref().map_or(none, KelvinVoigt::past);
        let rates = [self.damping.stiffness / h, change.damping.stiffness / h];
        self.system.change_of_elastic(change, rates, past);
        for (full, &unknown) in self.system.layout.unknown.iter().enumerate() {
            if unknown != FIXED {
                dg[unknown] = self.system.gradient[full];
            }
        }
        let s = &self.system;
        let ([k, c], rate) = (self.inertia(h), change.damping.mass / h);
        for (f, &v) in s.layout.free_vertices.iter().enumerate() {
            let (mass, more) = (s.rod.masses[v], change.masses.get(v).copied().unwrap_or(0.0));
            let (d, e) = (s.x[v] - self.target[f], s.x[v] - self.start[f]);
            let force = (d * k + e * c - s.loads.gravity) * more + (e * rate - change.gravity) * mass;
            let i = s.layout.unknown[s.layout.vertex(v)];
            (0..3).for_each(|a| dg[i + a] += force[a]);
        }
        if let Some(spin) = self.spin.as_ref().filter(|_| s.layout.spins) {
            spin.change(s, &change.spin_inertia, [k, c], rate, dg);
        }
    }
}

impl System {
    /// Overwrites `gradient` (full order) with the change of the elastic and Kelvin–Voigt forces of the
    /// present shape, σ = k (ε − ε̄ + r (ε − ε*)) for every strain:
    ///
    /// ```text
    /// δσ = δk (ε − ε̄ + r (ε − ε*)) + k (δr (ε − ε*) − δε̄)
    /// ```
    ///
    /// `rates` are r and δr; `past` has ε*, where there are such strains.
    pub(crate) fn change_of_elastic(&mut self, change: &Change, rates: [f64; 2], past: &PastStrains) {
        let [r, dr] = rates;
        let System { layout, shape, gradient, rod, .. } = &mut *self;
        gradient.fill(0.0);
        if !change.ea.is_empty() || dr != 0.0 {
            for (e, edge) in shape.edges.iter().enumerate() {
                let rest = rod.rest_lengths[e];
                let gone = past.lengths.get(e).map_or(0.0, |l| edge.l - l);
                let more = change.ea.get(e).copied().unwrap_or(0.0);
                let force = (more * (edge.l - rest + r * gone) + rod.ea[e] * dr * gone) / rest;
                let (a, b) = (layout.vertex(e), layout.vertex(e + 1));
                for c in 0..3 {
                    gradient[a + c] -= force * edge.t[c];
                    gradient[b + c] += force * edge.t[c];
                }
            }
        }
        if !layout.bending || !(change.is_of_bending() || dr != 0.0) {
            return;
        }
        for i in 1..self.layout.segments {
            let System { layout, shape, gradient, rod, .. } = &mut *self;
            let first = layout.vertex(i - 1);
            if !layout.twist {
                let dei = change.ei.get(i - 1).copied().unwrap_or_default();
                let over = 1.0 / rod.voronoi_lengths[i - 1];
                let (a, b, turn) = (&shape.edges[i - 1], &shape.edges[i], shape.turn(i));
                let bent = element::isotropic_bend(a, b, turn, dei[0] * over);
                gradient[first..].iter_mut().zip(bent.gradient).for_each(|(g, d)| *g += d);
                continue;
            }
            let (strains, stress) = self.change_of_stress(i, change, rates, past);
            let gradient = &mut self.gradient;
            for (of_strain, stress) in strains.gradient.iter().zip(stress) {
                gradient[first..].iter_mut().zip(of_strain).for_each(|(g, d)| *g += stress * d);
            }
        }
    }
}

impl System {
    /// Strains of an interior vertex, and the change of their stress.
    fn change_of_stress(
        &self,
        i: usize,
        change: &Change,
        [r, dr]: [f64; 2],
        past: &PastStrains,
    ) -> (Strains, [f64; 3]) {
        let (strains, rod, over) = (self.shape.strains(i), &self.rod, 1.0 / self.rod.voronoi_lengths[i - 1]);
        let dei = change.ei.get(i - 1).copied().unwrap_or_default();
        let [k1, k2] = rod.natural_curvature[i - 1];
        let rest = [k1, k2, rod.natural_twist[i - 1]];
        let [dk1, dk2] = change.natural_curvature.get(i - 1).copied().unwrap_or_default();
        let drest = [dk1, dk2, change.natural_twist.get(i - 1).copied().unwrap_or(0.0)];
        let gone = past.bend.get(i - 1);
        let gone: [f64; 3] = std::array::from_fn(|a| gone.map_or(0.0, |p| strains.value[a] - p[a]));
        let by_stiffness: [f64; 3] =
            std::array::from_fn(|a| over * (strains.value[a] - rest[a] + r * gone[a]));
        let by_strain: [f64; 3] = std::array::from_fn(|a| over * (dr * gone[a] - drest[a]));
        let dgj = change.gj.get(i - 1).copied().unwrap_or(0.0);
        let stress = sum(times(dei, dgj, by_stiffness), times(rod.ei[i - 1], rod.gj[i - 1], by_strain));
        (strains, stress)
    }
}

fn times([k11, k12, k22]: [f64; 3], twist: f64, d: [f64; 3]) -> [f64; 3] {
    [k11 * d[0] + k12 * d[1], k12 * d[0] + k22 * d[1], twist * d[2]]
}

fn sum(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] + b[i])
}
