//! The tangent of the forces within a rod: what small changes of its states do to them.

pub(crate) mod transpose;

use nalgebra::{Matrix3, Vector3, Vector6};

use crate::Error;
use crate::change::{Parameter, Parameters};
use crate::dynamics::RodStep;
use crate::element::{self, Strains};
use crate::forces_of_motion::{Motion, Past, edge_forces, with_forces_at};
use crate::internal_forces::InternalForces;
use crate::load::EdgeLoad;
use crate::shape::Shape;
use crate::statics::reactions::{EdgeSums, Reaction, all_loads, exerted};
use crate::support::Damping;
use crate::system::{PastStrains, StageStart, System};

impl RodStep {
    /// The tangent of [`internal_forces`](Self::internal_forces): for every column δx of the state, and of
    /// the state before, `see` is called with
    ///
    /// ```text
    /// δF = ∂F/∂x δx + ∂F/∂x_before δx_before + ∂F/∂p δp
    /// ```
    ///
    /// δx is made of columns of the length of a state, one after the other, δp of as many columns of the
    /// rod's parameters ([`RodStep::with_parameters`]). With W Wᵀ the covariance of a state, the sums of
    /// squares over the columns of W are the variances of its forces.
    ///
    /// # Errors
    /// As [`internal_forces`](Self::internal_forces).
    ///
    /// # Panics
    /// If a state or a column has not the length of a state of this rod, or there are not as many columns
    /// before.
    pub fn internal_forces_tangent(
        &mut self,
        t: f64,
        state: &[f64],
        before: (f64, &[f64]),
        [dx, dx_before, dp]: [&[f64]; 3],
        see: &mut dyn FnMut(&mut InternalForces),
    ) -> Result<(), Error> {
        let n = state.len();
        assert!(dx.len() == dx_before.len() && dx.len().is_multiple_of(n), "a column has {n} values");
        let share = self.damping.stiffness / (t - before.0 + self.damping.stiffness);
        let (parameters, columns) = (self.parameters.take(), dx.len() / n);
        let known = parameters.as_ref().map_or(0, |p| p.len());
        assert!(dp.len() == columns * known, "a column has {known} parameters");
        let (damping, times) = (self.damping, [t, before.0]);
        let done = with_forces_at(self, t, state, before, &mut |system, motion| {
            let changes =
                parameters.as_ref().map_or_else(Vec::new, |p| p.of_forces(system, motion, &damping, times));
            let past = motion.past.filter(|_| share > 0.0);
            let mut tangent = Tangent::new(system, motion.start, past, share, changes);
            for (c, (dx, dx_before)) in dx.chunks_exact(n).zip(dx_before.chunks_exact(n)).enumerate() {
                see(tangent.of(
                    system,
                    motion.start.length,
                    [dx, dx_before, &dp[c * known..(c + 1) * known]],
                ));
            }
        });
        self.parameters = parameters;
        done
    }
}

/// What a parameter does to ∂E/∂(x, θ) in the full order, to the moments of bent vertices, and to the
/// weight and inertia of every vertex.
pub(crate) struct ChangeOfForces {
    gradient: Vec<f64>,
    moments: Vec<[f64; 3]>,
    forces: Vec<Vector3<f64>>,
    /// Increments of the present configuration and of the one before, where it moves supports.
    moved: Option<[Increment; 2]>,
}

impl ChangeOfForces {
    fn is_none(&self) -> bool {
        let nothing = |moved: &Increment| {
            moved.places.iter().all(|x| *x == Vector3::zeros()) && moved.angles.iter().all(|a| *a == 0.0)
        };
        self.gradient.iter().all(|g| *g == 0.0)
            && self.moments.iter().all(|m| *m == [0.0; 3])
            && self.forces.iter().all(|f| *f == Vector3::zeros())
            && self.moved.as_ref().is_none_or(|moved| moved.iter().all(nothing))
    }
}

impl Parameters {
    /// What those do that change them to the forces within the rod, the system having the shape of a state:
    /// of an error in time only the numbers about that time.
    pub(crate) fn of_forces(
        &self,
        system: &mut System,
        motion: &Motion,
        damping: &Damping,
        times: [f64; 2],
    ) -> Vec<(usize, ChangeOfForces)> {
        let mut all = self.of_constants(system, motion, damping);
        for (index, moved) in self.of_supports(system, motion, damping, times) {
            match all.binary_search_by_key(&index, |(index, _)| *index) {
                Ok(place) => {
                    let (forces, of) = (moved.forces, &mut all[place].1);
                    of.forces.iter_mut().zip(forces).for_each(|(force, more)| *force += more);
                    of.moved = moved.moved;
                }
                Err(place) => all.insert(place, (index, moved)),
            }
        }
        all
    }

    /// That of parameters that move supports, and by that alone.
    pub(crate) fn of_supports(
        &self,
        system: &System,
        motion: &Motion,
        damping: &Damping,
        times: [f64; 2],
    ) -> Vec<(usize, ChangeOfForces)> {
        let bent = if system.layout.bending { system.layout.segments - 1 } else { 0 };
        let of = |(index, parameter): (usize, &Parameter)| {
            if parameter.change.supports.is_empty() {
                return None;
            }
            let mut of = ChangeOfForces {
                gradient: vec![0.0; system.layout.full()],
                moments: vec![[0.0; 3]; bent],
                forces: vec![Vector3::zeros(); system.x.len()],
                moved: Some(moved(system, motion, index, times)),
            };
            if let Some(interval) = motion.interval {
                let moved = moved_by(system, index, interval, times[0]);
                for ((force, [v, a]), mass) in of.forces.iter_mut().zip(moved).zip(&system.rod.masses) {
                    *force -= (a + v * damping.mass) * *mass;
                }
            }
            (!of.is_none()).then_some((index, of))
        };
        self.list.iter().enumerate().filter_map(of).collect()
    }

    /// That of parameters that change constants, and by that alone.
    pub(crate) fn of_constants(
        &self,
        system: &mut System,
        motion: &Motion,
        damping: &Damping,
    ) -> Vec<(usize, ChangeOfForces)> {
        let h = motion.start.length;
        let past = motion.past.map_or_else(PastStrains::default, |past| past.strains());
        let of = |(index, (p, slope)): (usize, (&Parameter, &f64))| {
            let Parameter { change, .. } = p;
            let rates = [damping.stiffness / h, change.damping.stiffness / h];
            system.change_of_elastic(change, rates, &past);
            let more_gravity = self.change_of_gravity(change, &system.loads.gravity);
            let stress = |i| system.change_of_stress(i, change, rates, &past).1.map(|s| slope * s);
            let bent = if system.layout.bending { 1..system.layout.segments } else { 0..0 };
            let force = |v: usize| {
                let [velocity, acceleration] = motion.held[v];
                let (mass, more) = (system.rod.masses[v], change.masses.get(v).copied().unwrap_or(0.0));
                let gravity = system.loads.gravity;
                let each = (gravity - acceleration - velocity * damping.mass) * more
                    + (more_gravity - velocity * change.damping.mass) * mass;
                each * *slope
            };
            let of = ChangeOfForces {
                moments: bent.map(stress).collect(),
                forces: (0..system.x.len()).map(force).collect(),
                gradient: system.gradient.iter().map(|g| slope * g).collect(),
                moved: None,
            };
            (!of.is_none()).then_some((index, of))
        };
        self.list.iter().zip(&self.slopes).enumerate().filter_map(of).collect()
    }
}

/// (δẋ, δẍ) of held vertices that a parameter moves, differences over h on both sides of t.
pub(crate) fn moved_by(system: &System, parameter: usize, h: f64, t: f64) -> Vec<[Vector3<f64>; 2]> {
    let at = |t: f64| {
        let mut places = vec![Vector3::zeros(); system.x.len()];
        system.moved_places(parameter, t, &mut places).expect("supports were placed at these times");
        places
    };
    let (a, b, c) = (at(t - h), at(t), at(t + h));
    let of = |v: usize| [(c[v] - a[v]) / (2.0 * h), (c[v] - b[v] * 2.0 + a[v]) / (h * h)];
    (0..a.len()).map(of).collect()
}

/// The increments of two configurations by supports that a parameter moves.
pub(crate) fn moved(system: &System, motion: &Motion, parameter: usize, times: [f64; 2]) -> [Increment; 2] {
    let of = |shape: Option<&Shape>, t: f64| {
        let mut moved = Increment::new(system.rod.segments());
        let Increment { places, angles } = &mut moved;
        match shape {
            Some(shape) => {
                system.moved_increment(shape, parameter, t, places, angles);
            }
            // places alone are read there
            None => {
                system.moved_places(parameter, t, places).expect("supports were placed at these times");
            }
        }
        moved
    };
    [of(Some(&system.shape), times[0]), of(motion.past.map(|past| &past.shape), times[1])]
}

/// What an increment of a configuration does to its vertices, and to its angles in their local gauge.
pub(crate) struct Increment {
    pub(crate) places: Vec<Vector3<f64>>,
    pub(crate) angles: Vec<f64>,
}

impl Increment {
    pub(crate) fn new(segments: usize) -> Increment {
        Increment { places: vec![Vector3::zeros(); segments + 1], angles: vec![0.0; segments] }
    }

    /// Of the part of a state that belongs to this shape.
    fn set(&mut self, system: &System, shape: &Shape, dx: &[f64]) {
        let layout = &system.layout;
        system.displacements(dx, &mut self.places);
        if !layout.bending {
            return;
        }
        let (psi, first) = (&mut self.angles, 6 * layout.free_vertices.len());
        shape.holonomy(&self.places, psi);
        let all = system.angle_that_all_follow(psi);
        let mut free = 0;
        for (e, angle) in psi.iter_mut().enumerate() {
            let is_free = layout.free_angles.get(free) == Some(&e);
            // an angle that is given turns with its clamp
            *angle = match (layout.twist, is_free) {
                (true, true) => dx[first + free] - *angle,
                (true, false) => 0.0,
                (false, _) => all - *angle,
            };
            free += usize::from(is_free);
        }
    }

    pub(crate) fn add(&mut self, other: &Increment, times: f64) {
        self.places.iter_mut().zip(&other.places).for_each(|(a, b)| *a += b * times);
        self.angles.iter_mut().zip(&other.angles).for_each(|(a, b)| *a += b * times);
    }

    /// The eleven numbers at a bent vertex.
    pub(crate) fn at(&self, vertex: usize) -> [f64; 11] {
        let [a, b, c] = [0, 1, 2].map(|i| self.places[vertex - 1 + i]);
        let [p, q] = [self.angles[vertex - 1], self.angles[vertex]];
        [a.x, a.y, a.z, p, b.x, b.y, b.z, q, c.x, c.y, c.z]
    }
}

/// A bent vertex: second derivatives of its energy, and its strains.
struct Bent {
    hessian: [[f64; 11]; 11],
    strains: Strains,
}

/// A load of the motion on an edge. Its forces are a function of the configuration: what directors that are
/// carried along bring is that of ∂E/∂x.
struct Loaded {
    edge: usize,
    acts: EdgeLoad,
}

/// The linearization about one state, the system having its shape.
pub(crate) struct Tangent<'a> {
    /// ∂(force on the second vertex)/∂e of every edge.
    stretched: Vec<Matrix3<f64>>,
    bent: Vec<Bent>,
    loaded: Vec<Loaded>,
    /// The forces at every edge.
    forces: Vec<Vector3<f64>>,
    past: Option<&'a Past>,
    share: f64,
    pub(crate) now: Increment,
    pub(crate) before: Increment,
    /// What parameters do, by their numbers.
    changes: Vec<(usize, ChangeOfForces)>,
    /// What a clamp at the start and one at the end exert on the vertex beside their place, and about the
    /// tangent.
    clamped: [Option<(Vector3<f64>, f64)>; 2],
    pub(crate) gradient: Vec<f64>,
    pub(crate) loads: EdgeSums,
    out: InternalForces,
}

impl<'a> Tangent<'a> {
    pub(crate) fn new(
        system: &mut System,
        start: StageStart,
        past: Option<&'a Past>,
        share: f64,
        changes: Vec<(usize, ChangeOfForces)>,
    ) -> Tangent<'a> {
        let n = system.rod.segments();
        system.elastic(None);
        let all = all_loads(system, Some(start));
        let reactions = exerted(system, &system.gradient, &all);
        let clamped = |beside: usize, edge: usize| {
            let (layout, i) = (&system.layout, system.layout.vertex(beside));
            let force = Vector3::from_column_slice(&system.gradient[i..i + 3]) - all.forces[beside];
            let angle = layout.twist.then(|| system.gradient[layout.angle(edge)] - all.moments[edge]);
            (force, angle.unwrap_or(0.0))
        };
        let (start_clamp, end_clamp) = (&system.supports.start, &system.supports.end);
        let clamped =
            [start_clamp.as_ref().map(|_| clamped(1, 0)), end_clamp.as_ref().map(|_| clamped(n - 1, n - 1))];
        let stretched = |e: usize| {
            let (edge, (ea, rest)) = (&system.shape.edges[e], system.stretch[e]);
            let (_, _, hessian) = element::stretch(edge, rest, ea);
            if !system.layout.twist {
                return hessian;
            }
            // Second derivatives in the local gauge are taken symmetric. Directors that are carried about a
            // closed way of the tangent come back turned by its area: what is left of the moment about an
            // edge out of equilibrium turns the force by half of that.
            let moment = system.gradient[system.layout.angle(e)];
            hessian + edge.t.cross_matrix() * (0.5 * moment / (edge.l * edge.l))
        };
        let mut loaded = Vec::new();
        system.each_load(Some(start), |acts, motion, _| {
            loaded.push(Loaded { edge: motion.edge, acts: *acts });
        });
        let bent = |i: usize| {
            let (a, b, k) = (&system.shape.edges[i - 1], &system.shape.edges[i], &system.bend[i - 1]);
            let (turn, strains) = (system.shape.turn(i), system.shape.strains(i));
            let mut hessian = [[0.0; 11]; 11];
            if system.layout.twist {
                let m = system.shape.directors(i);
                hessian = element::bend_twist(a, b, turn, &m, &strains, k).hessian;
            } else {
                let of_places = element::isotropic_bend(a, b, turn, k.bend[0]).hessian;
                let with_angles = |i: usize| i + i / 3;
                for (i, row) in of_places.iter().enumerate() {
                    row.iter().enumerate().for_each(|(j, h)| hessian[with_angles(i)][with_angles(j)] = *h);
                }
            }
            for i in 0..11 {
                (0..i).for_each(|j| hessian[j][i] = hessian[i][j]);
            }
            Bent { hessian, strains }
        };
        Tangent {
            stretched: (0..n).map(stretched).collect(),
            loaded,
            bent: if system.layout.bending { (1..n).map(bent).collect() } else { Vec::new() },
            forces: edge_forces(system, &system.gradient, &reactions),
            past,
            share,
            changes,
            clamped,
            now: Increment::new(n),
            before: Increment::new(n),
            gradient: vec![0.0; system.layout.full()],
            loads: EdgeSums { forces: vec![Vector3::zeros(); n + 1], moments: vec![0.0; n] },
            out: InternalForces::default(),
        }
    }

    /// Changes of both configurations, of ∂E/∂(x, θ), of moments and of loads.
    pub(crate) fn vary(&mut self, system: &System, h: f64, [dx, dx_before, dp]: [&[f64]; 3]) {
        self.now.set(system, &system.shape, dx);
        match self.past {
            Some(past) => self.before.set(system, &past.shape, dx_before),
            None => system.displacements(dx_before, &mut self.before.places),
        }
        for (change, dp) in self.changes.iter().map(|(p, change)| (change, &dp[*p])) {
            if let Some([now, before]) = &change.moved {
                self.now.add(now, *dp);
                self.before.add(before, *dp);
            }
        }
        self.gradient.fill(0.0);
        let InternalForces { tension, shear, bending, twisting, .. } = &mut self.out;
        [shear, bending].into_iter().for_each(Vec::clear);
        [tension, twisting].into_iter().for_each(Vec::clear);
        self.stretch(system);
        self.bend(system);
        self.load(h);
        self.change(dp);
    }

    /// The change of the moment at bent vertex i, bending and twisting.
    pub(crate) fn moment(&self, i: usize) -> Vector3<f64> {
        let [m1, m2] = self.out.bending[i - 1];
        Vector3::new(m1, m2, self.out.twisting[i - 1])
    }

    fn of(&mut self, system: &System, h: f64, increments: [&[f64]; 3]) -> &mut InternalForces {
        self.vary(system, h, increments);
        let mut reactions = exerted(system, &self.gradient, &self.loads);
        self.turn_clamps(system, &mut reactions);
        let varied = edge_forces(system, &self.gradient, &reactions);
        self.out.reactions = reactions;
        let InternalForces { tension, shear, .. } = &mut self.out;
        for (e, (edge, df)) in system.shape.edges.iter().zip(&varied).enumerate() {
            let moved = self.now.places[e + 1] - self.now.places[e];
            let dt = (moved - edge.t * edge.t.dot(&moved)) / edge.l;
            tension.push(df.dot(&edge.t) + self.forces[e].dot(&dt));
            if !system.layout.bending {
                shear.push([0.0; 2]);
                continue;
            }
            let (m1, m2) = (&system.shape.m1[e], &system.shape.m2[e]);
            let turned = self.now.angles[e];
            let dm1 = m2 * turned - edge.t * m1.dot(&dt);
            let dm2 = m1 * -turned - edge.t * m2.dot(&dt);
            let f = &self.forces[e];
            shear.push([df.dot(m1) + f.dot(&dm1), df.dot(m2) + f.dot(&dm2)]);
        }
        &mut self.out
    }

    /// What the edges add to δ(∂E/∂x).
    fn stretch(&mut self, system: &System) {
        for (e, edge) in system.shape.edges.iter().enumerate() {
            let (ea, rest) = system.stretch[e];
            let moved = |of: &Increment| of.places[e + 1] - of.places[e];
            let mut force = self.stretched[e] * moved(&self.now);
            if let Some(past) = self.past {
                let [by_then, by_now] = &past.by_edge[e];
                let longer = by_then.dot(&moved(&self.before)) + by_now.dot(&moved(&self.now));
                force -= edge.t * (ea / rest * self.share * longer);
            }
            let (a, b) = (system.layout.vertex(e), system.layout.vertex(e + 1));
            for c in 0..3 {
                self.gradient[a + c] -= force[c];
                self.gradient[b + c] += force[c];
            }
        }
    }

    /// What bent vertices add to it, and the changes of their moments, bending and twisting.
    fn bend(&mut self, system: &System) {
        let angle = system.layout.twist.then_some([3, 7]);
        for (i, bent) in self.bent.iter().enumerate() {
            let (q, k) = (self.now.at(i + 1), &system.bend[i]);
            // by rows of the symmetric matrix: eleven sums side by side
            let mut force = [0.0; 11];
            for (row, q) in bent.hessian.iter().zip(&q) {
                force.iter_mut().zip(row).for_each(|(force, h)| *force += h * q);
            }
            let mut strain = bent.strains.along(&q);
            if let Some(past) = self.past {
                let q = self.before.at(i + 1);
                let rest = past.strains[i].along(&q).map(|strain| self.share * strain);
                let stress = k.times(&rest);
                for (c, force) in force.iter_mut().enumerate() {
                    *force -= (0..3).map(|a| bent.strains.gradient[a][c] * stress[a]).sum::<f64>();
                }
                strain.iter_mut().zip(rest).for_each(|(strain, rest)| *strain -= rest);
            }
            let [m1, m2, twist] = k.times(&strain);
            self.out.bending.push([m1, m2]);
            self.out.twisting.push(twist);
            let mut add = |first: usize, values: &[f64]| {
                self.gradient[first..].iter_mut().zip(values).for_each(|(g, v)| *g += v);
            };
            for (v, first) in [0, 4, 8].into_iter().enumerate() {
                add(system.layout.vertex(i + v), &force[first..first + 3]);
            }
            for (e, place) in angle.into_iter().flatten().enumerate() {
                add(system.layout.angle(i + e), &force[place..=place]);
            }
        }
    }

    /// What a clamp that moves does to the moment it exerts: to its arm, and to the direction of its twist.
    fn turn_clamps(&self, system: &System, reactions: &mut [Reaction]) {
        if system.moves.is_empty() {
            return;
        }
        let n = system.rod.segments();
        for ([vertex, beside, edge], held) in [[0, 1, 0], [n, n - 1, n - 1]].into_iter().zip(&self.clamped) {
            let (Some((force, twist)), Some(reaction)) =
                (held, reactions.iter_mut().find(|r| r.vertex == vertex))
            else {
                continue;
            };
            let arm = self.now.places[beside] - self.now.places[vertex];
            let along = (self.now.places[edge + 1] - self.now.places[edge]) / system.shape.edges[edge].l;
            reaction.moment += arm.cross(force) + along * *twist;
        }
    }

    /// What the parameters add to all of it.
    fn change(&mut self, dp: &[f64]) {
        for (change, dp) in self.changes.iter().map(|(p, change)| (change, &dp[*p])) {
            self.gradient.iter_mut().zip(&change.gradient).for_each(|(g, c)| *g += c * dp);
            self.loads.forces.iter_mut().zip(&change.forces).for_each(|(f, c)| *f += c * *dp);
            let moments = self.out.bending.iter_mut().zip(&mut self.out.twisting);
            for (([m1, m2], twist), [a, b, c]) in moments.zip(&change.moments) {
                *m1 += a * dp;
                *m2 += b * dp;
                *twist += c * dp;
            }
        }
    }

    /// Changes of the forces of loads that depend on the motion.
    fn load(&mut self, h: f64) {
        let (now, before, loads) = (&self.now, &self.before, &mut self.loads);
        loads.forces.fill(Vector3::zeros());
        loads.moments.fill(0.0);
        for &Loaded { edge: e, ref acts } in &self.loaded {
            let of = |i: &Increment| {
                let [a, b] = [i.places[e], i.places[e + 1]];
                Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z)
            };
            let (places, turned) = (of(now), now.angles[e]);
            let velocities = (places - of(before)) / h;
            let forces = acts.by_places * places + acts.by_velocities * velocities + acts.by_angle * turned;
            for (i, force) in forces.iter().enumerate() {
                loads.forces[e + i / 3][i % 3] += force;
            }
            loads.moments[e] += acts.moment_by_places.dot(&places) + acts.moment_by_angle * turned;
        }
    }
}
