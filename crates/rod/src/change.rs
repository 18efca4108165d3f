//! Constants of a rod that depend on parameters, and what a change of them does to its elastic forces.

use nalgebra::Vector3;
use varda_implicit::Law;

use crate::along::Along;
use crate::element::{self, Strains};
use crate::layout::Layout;
use crate::moved::Moved;
use crate::moved_increment::Increments;
use crate::rod::Rod;
use crate::rotation::{exponential, left_jacobian, left_jacobian_derivative};
use crate::support::Damping;
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
    /// A rotation vector by which gravity is turned \[rad\]; those of several parameters are added.
    pub gravity_turn: Vector3<f64>,
    /// Of the supports.
    pub supports: Vec<Moved>,
}

impl Change {
    /// Whether bending depends on the angles of sections once the parameter is not zero.
    pub(crate) fn bends_by_angle(&self) -> bool {
        self.ei.iter().any(|k| k[0] != k[2] || k[1] != 0.0)
            || self.natural_curvature.iter().any(|k| *k != [0.0; 2])
    }

    /// Whether it changes anything but supports.
    pub(crate) fn is_of_constants(&self) -> bool {
        let lists = [&self.ea, &self.gj, &self.natural_twist, &self.masses, &self.spin_inertia];
        lists.into_iter().any(|list| !list.is_empty())
            || !self.ei.is_empty()
            || !self.natural_curvature.is_empty()
            || self.damping != Damping::default()
            || self.gravity != Vector3::zeros()
            || self.gravity_turn != Vector3::zeros()
    }

    /// Whether it changes stiffness, damped or not: changes of anything else have no second derivative with
    /// each other in the elastic forces.
    pub(crate) fn is_of_stiffness(&self) -> bool {
        !(self.ea.is_empty() && self.ei.is_empty() && self.gj.is_empty()) || self.damping.stiffness != 0.0
    }

    pub(crate) fn needs_angles(&self) -> bool {
        self.bends_by_angle() || self.natural_twist.iter().any(|t| *t != 0.0)
    }

    pub(crate) fn is_of_bending(&self) -> bool {
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
    pub(crate) list: Vec<Parameter>,
    pub(crate) rod: Rod,
    pub(crate) damping: Damping,
    pub(crate) gravity: Vector3<f64>,
    /// g′ of each at the present values, and g″.
    pub(crate) slopes: Vec<f64>,
    pub(crate) curvatures: Vec<f64>,
    /// The rotation of gravity at the present values.
    pub(crate) turn: Vector3<f64>,
    /// δσ of a Kelvin–Voigt element comes from the strains of the past, where there are any.
    pub(crate) none: PastStrains,
    /// Work space of parameters that move supports.
    pub(crate) moved: Increments,
    /// Work space of second derivatives: nothing until they are asked for.
    pub(crate) second: Second,
}

/// Work space of second derivatives.
#[derive(Default)]
pub(crate) struct Second {
    pub(crate) along: Along,
    /// μ, and a column, in the full order.
    pub(crate) mu: Vec<f64>,
    pub(crate) full: Vec<f64>,
    /// Changes of gravity, one a parameter.
    pub(crate) gravities: Vec<Vector3<f64>>,
    /// Stresses of edges and the vertices they start at.
    pub(crate) stresses: Vec<[f64; 4]>,
    /// μᵀ ∂G/∂g of each parameter.
    pub(crate) first: Vec<f64>,
    /// The rod with nothing held, where parameters move supports.
    pub(crate) all_free: Option<Layout>,
}

impl Parameters {
    /// How many there are.
    pub(crate) fn len(&self) -> usize {
        self.list.len()
    }

    /// The constants at p.
    pub(crate) fn constants(&mut self, p: &[f64], rod: &mut Rod) -> (Damping, Vector3<f64>) {
        rod.clone_from(&self.rod);
        let (mut damping, mut gravity) = (self.damping, self.gravity);
        self.turn = Vector3::zeros();
        let derivatives = self.slopes.iter_mut().zip(&mut self.curvatures);
        for ((Parameter { change, law }, (slope, curvature)), &p) in self.list.iter().zip(derivatives).zip(p)
        {
            let g = law.value(p);
            *slope = law.slope(p);
            *curvature = law.curvature(p);
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
            self.turn += change.gravity_turn * g;
        }
        (damping, exponential(&self.turn) * gravity)
    }
}

impl Parameters {
    /// What a change does to the gravity that there is.
    pub(crate) fn change_of_gravity(&self, change: &Change, gravity: &Vector3<f64>) -> Vector3<f64> {
        let turned = left_jacobian(&self.turn) * change.gravity_turn;
        exponential(&self.turn) * change.gravity + turned.cross(gravity)
    }

    /// What a second change does to that, the `changes` of gravity being those of both.
    pub(crate) fn second_change_of_gravity(
        &self,
        [a, b]: [&Change; 2],
        changes: [&Vector3<f64>; 2],
        gravity: &Vector3<f64>,
    ) -> Vector3<f64> {
        let (rotation, jacobian) = (exponential(&self.turn), left_jacobian(&self.turn));
        let curved = left_jacobian_derivative(&self.turn, &b.gravity_turn) * a.gravity_turn;
        let [by_a, by_b] = [a, b].map(|change| jacobian * change.gravity_turn);
        by_b.cross(&(rotation * a.gravity)) + by_a.cross(changes[1]) + curved.cross(gravity)
    }
}

fn add(to: &mut [f64], change: &[f64], g: f64) {
    to.iter_mut().zip(change).for_each(|(to, change)| *to += g * change);
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
            let by = self.change_of_vertex(i, change);
            let System { layout, shape, gradient, .. } = &mut *self;
            let first = layout.vertex(i - 1);
            if !layout.twist {
                let (a, b, turn) = (&shape.edges[i - 1], &shape.edges[i], shape.turn(i));
                let bent = element::isotropic_bend(a, b, turn, by.isotropic());
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
    pub(crate) fn change_of_stress(
        &self,
        i: usize,
        change: &Change,
        [r, dr]: [f64; 2],
        past: &PastStrains,
    ) -> (Strains, [f64; 3]) {
        let strains = self.shape.strains(i);
        let stress = self.change_of_vertex(i, change).stress(&strains.value, [r, dr], past.bend.get(i - 1));
        (strains, stress)
    }
}

/// What a change does to the stiffness and rest strains of an interior vertex, beside what they are, all of
/// one vertex.
pub(crate) struct VertexChange {
    over: f64,
    ei: [f64; 3],
    gj: f64,
    rest: [f64; 3],
    dei: [f64; 3],
    dgj: f64,
    drest: [f64; 3],
}

impl System {
    /// That of vertex i.
    pub(crate) fn change_of_vertex(&self, i: usize, change: &Change) -> VertexChange {
        let rod = &self.rod;
        let [k1, k2] = rod.natural_curvature[i - 1];
        let [dk1, dk2] = change.natural_curvature.get(i - 1).copied().unwrap_or_default();
        VertexChange {
            over: 1.0 / rod.voronoi_lengths[i - 1],
            ei: rod.ei[i - 1],
            gj: rod.gj[i - 1],
            rest: [k1, k2, rod.natural_twist[i - 1]],
            dei: change.ei.get(i - 1).copied().unwrap_or_default(),
            dgj: change.gj.get(i - 1).copied().unwrap_or(0.0),
            drest: [dk1, dk2, change.natural_twist.get(i - 1).copied().unwrap_or(0.0)],
        }
    }
}

impl VertexChange {
    /// δk of a vertex that bends alike in all directions.
    pub(crate) fn isotropic(&self) -> f64 {
        self.dei[0] * self.over
    }

    /// δk d.
    fn by_stiffness(&self, d: [f64; 3]) -> [f64; 3] {
        times(self.dei, self.dgj, d.map(|d| self.over * d))
    }

    /// k d.
    fn stiffness(&self, d: [f64; 3]) -> [f64; 3] {
        times(self.ei, self.gj, d.map(|d| self.over * d))
    }

    /// δσ at strains ε, `past` being ε*.
    pub(crate) fn stress(&self, value: &[f64; 3], [r, dr]: [f64; 2], past: Option<&[f64; 3]>) -> [f64; 3] {
        let gone = gone(value, past);
        let by_stiffness = std::array::from_fn(|a| value[a] - self.rest[a] + r * gone[a]);
        let by_strain = std::array::from_fn(|a| dr * gone[a] - self.drest[a]);
        sum(self.by_stiffness(by_stiffness), self.stiffness(by_strain))
    }

    /// ∂δσ/∂ε times a change of strains: δk (1 + r) + k δr.
    pub(crate) fn stress_of(&self, rate: &[f64; 3], [r, dr]: [f64; 2]) -> [f64; 3] {
        sum(self.by_stiffness(rate.map(|e| (1.0 + r) * e)), self.stiffness(rate.map(|e| dr * e)))
    }

    /// ∂δσ/∂ε* times a change of strains: −δk r − k δr.
    pub(crate) fn stress_of_past(&self, rate: &[f64; 3], [r, dr]: [f64; 2]) -> [f64; 3] {
        sum(self.by_stiffness(rate.map(|e| -r * e)), self.stiffness(rate.map(|e| -dr * e)))
    }

    /// What a second change does to δσ.
    pub(crate) fn second(
        &self,
        other: &VertexChange,
        [dr, other_dr]: [f64; 2],
        value: &[f64; 3],
        past: Option<&[f64; 3]>,
    ) -> [f64; 3] {
        let gone = gone(value, past);
        let strain = |of: &VertexChange, dr: f64| std::array::from_fn(|a| dr * gone[a] - of.drest[a]);
        sum(self.by_stiffness(strain(other, other_dr)), other.by_stiffness(strain(self, dr)))
    }
}

/// ε − ε*, where there is a past.
fn gone(value: &[f64; 3], past: Option<&[f64; 3]>) -> [f64; 3] {
    std::array::from_fn(|a| past.map_or(0.0, |p| value[a] - p[a]))
}

fn times([k11, k12, k22]: [f64; 3], twist: f64, d: [f64; 3]) -> [f64; 3] {
    [k11 * d[0] + k12 * d[1], k12 * d[0] + k22 * d[1], twist * d[2]]
}

fn sum(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] + b[i])
}
