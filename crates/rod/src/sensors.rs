//! Sensors on a rod that see forces, accelerations and angular rates of one state.

mod second;
mod second_moments;
mod second_parameters;
mod second_rotations;
mod second_supports;

use nalgebra::Vector3;
use varda_implicit::{At, ImplicitStep, ObservationOperator, ParametricStep, Refusal, Remembered};

use crate::Error;
use crate::dynamics::RodStep;
use crate::forces_of_motion::{Motion, with_forces};
use crate::forces_tangent::moved_by;
use crate::read_rotations::ReadRotations;
use crate::rod::Place;
use crate::sensor::{Placed, Row, Sensor, placed};
use crate::sensor_rows::{Present, SHARE};
use crate::statics::reactions::all_loads;
use crate::support::Damping;
use crate::system::System;

/// What sensors measure of a rod in one state, with tangent and adjoint: an observation operator.
///
/// ```text
/// F^e = −Σ_{v ≤ e} ∂E/∂x_v,   N = F^e·t^e                       tension of edge e [N]
/// R = Σ_v (∂E/∂x_v − F_v + m_v (ẍ_v + α ẋ_v))            over the held vertices of a support [N]
/// M = (x_b − x_a) × (∂E/∂x_b − F_b) + t (∂E/∂θ − M_t)    of a clamp at x_a, beside x_b [N m]
/// M_i = EI_i (κ_i − κ̄_i)/l̄,   T = GJ (τ − τ̄)/l̄         moments within the rod [N m]
/// a_v = (F_v − ∂E/∂x_v)/m_v − α V_v,   a = (1−w) a_i + w a_{i+1}      acceleration [m/s²]
/// f = Aᵀ(a − g)                                              specific force, A = (m₁, m₂, t) [m/s²]
/// ω = t × ṫ,   ṫ = (I − t tᵀ)(V_{e+1} − V_e)/l^e              angular rate of a section [rad/s]
/// ρ = log(Qᵀ (m₁, m₂, t) Aᵀ)                      orientation of a body, from Q that was read [rad]
/// θ (t₁, t₂)/sin θ,   (t₁, t₂, cos θ) = Qᵀ t         direction, from the third axis of Q [rad]
/// ```
///
/// with F_v the loads of a vertex, and stress of strain rates and drag from the velocities in the state:
/// ε̇ is a difference over a thousandth of the interval Δt, back along V. Accelerations are those that the
/// forces of the state make (Newton's second law), not differences between steps: one state is enough,
/// and it is what the equations of a step of backward Euler and BDF2 have for V̇. Those of supports are
/// second differences over Δt. The rate of a stored angle, where strain rates need it, is that since the
/// state before, which a two-step state has (zero at step 0, whose past is itself). At rest there are
/// neither rates nor inertia.
///
/// Orientations and directions are angles from what was read at that time
/// ([`measured_from`](Self::measured_from)), to be observed as zero: a rotation has three degrees of
/// freedom and a direction two, in whatever numbers they are written. H is then a function of time, and the
/// departure 0 − H(x) is log(q(x)⁻¹ q_read) along the axes of the body.
///
/// Forces are those of [`InternalForces`](crate::InternalForces). They depend on the parameters of the rod:
/// [`by_parameters`](Self::by_parameters).
///
/// # Examples
///
/// A cell in the clamp of a rod that hangs at rest feels its weight:
///
/// ```
/// use varda_implicit::{At, ImplicitStep, ObservationOperator};
/// use varda_rod::{Clamp, ClampAt, Damping, Loads, Material, Rod, RodStep, Search, Section, Sensor};
/// use varda_rod::{Sensors, Supports, Vector3, rest};
///
/// let section = Section::circle(&Material::new(1e7, 0.5, 1100.0), 0.005);
/// let rod = Rod::uniform(1.0, 20, &section)?;
/// let weight = 9.81 * rod.masses.iter().sum::<f64>();
/// let supports = Supports::clamped_start(Clamp::new(ClampAt::Edge, [0.0; 3], -Vector3::z(), Vector3::x()));
/// let loads = Loads { gravity: Vector3::new(0.0, 0.0, -9.81), ..Loads::default() };
/// let found = rest(&rod, &supports, &loads, 0.0, &Search::default())?;
/// let step = RodStep::new(rod, supports, loads, Damping::default())?;
/// let mut x = step.control_at_rest(&found.rest);
/// x.resize(step.dim(), 0.0);
///
/// let cell = Sensor::SupportForce { s: 0.0 };
/// let all = [cell, Sensor::Tension { s: 0.5 }, Sensor::Acceleration { s: 1.0 }];
/// let mut sensors = Sensors::new(step, 0.01, &all)?;
/// let mut y = [0.0; 7];
/// sensors.observe(At { step: 0, time: 0.0 }, &x, &mut y)?;
/// assert!((y[2] - weight).abs() < 1e-9 * weight && y[3] > 0.4 * weight && y[3] < 0.6 * weight);
/// assert!(y[4..].iter().all(|a| a.abs() < 1e-6));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Sensors {
    step: RodStep,
    /// Δt \[s\].
    interval: f64,
    sensors: Vec<Placed>,
    rows: usize,
    state_dim: usize,
    parameters: Vec<f64>,
    /// The state a little earlier.
    before: Vec<f64>,
    /// Rows of H', one after the other.
    known: Remembered,
    /// Second derivatives with parameters, of a state and what acts on its values: nothing until they are
    /// asked for.
    known_second: Remembered,
}

impl Sensors {
    /// Sensors on the rod of a step, whose states are `interval` \[s\] apart.
    ///
    /// # Errors
    /// [`Error::OffRod`] for a place off the rod, [`Error::NotHeld`] where no support (no clamp) is,
    /// [`Error::NoRates`] where strain rates need angles of the state before and there are none,
    /// [`Error::Value`] for an interval that is not positive.
    pub fn new(step: RodStep, interval: f64, sensors: &[Sensor]) -> Result<Sensors, Error> {
        if !(interval > 0.0 && interval.is_finite()) {
            return Err(Error::Value {
                field: "interval of sensors",
                value: interval,
                expected: "above zero",
            });
        }
        let layout = &step.system.layout;
        let rates = !step.is_at_rest && step.damping.stiffness > 0.0 && layout.twist;
        if rates && step.repeated() == 0 {
            return Err(Error::NoRates);
        }
        let placed = sensors.iter().map(|sensor| placed(&step.system, sensor));
        let sensors_placed = placed.collect::<Result<Vec<_>, _>>()?;
        let rows = sensors.iter().map(Sensor::rows).sum();
        let (state_dim, parameters) = (step.dim(), step.parameters());
        Ok(Sensors {
            interval,
            sensors: sensors_placed,
            rows,
            state_dim,
            parameters: vec![0.0; parameters],
            before: vec![0.0; state_dim],
            known: Remembered::new(state_dim, rows * state_dim),
            known_second: Remembered::new(state_dim + rows, parameters * (state_dim + parameters)),
            step,
        })
    }

    /// The same with what a sensor of an orientation or a direction read: it is measured from that which is
    /// nearest in time. Nothing for another sensor.
    ///
    /// ```
    /// use varda_implicit::{At, ImplicitStep, ObservationOperator};
    /// use varda_rod::{Clamp, ClampAt, Damping, Loads, Material, Matrix3, ReadRotations, Rod, RodStep};
    /// use varda_rod::{Section, Sensor, Sensors, Supports, UnitQuaternion, Vector3, straight_guess};
    ///
    /// let rod = Rod::uniform(1.0, 4, &Section::circle(&Material::new(1e7, 0.5, 1100.0), 0.005))?;
    /// let clamp = Clamp::new(ClampAt::Edge, [0.0; 3], Vector3::z(), Vector3::x());
    /// let supports = Supports::clamped_start(clamp);
    /// let straight = straight_guess(&rod, &supports, 0.0, [0.0, 0.0, 1.0])?;
    /// let step = RodStep::new(rod, supports, Loads::default(), Damping::default())?;
    /// let mut x = step.control_at_rest(&straight);
    /// x.resize(step.dim(), 0.0);
    /// // its axes are those of the model, and a body on it that was read a tenth of a radian about z
    /// let body = Sensor::Orientation { s: 0.7, axes: Matrix3::identity() };
    /// let read = UnitQuaternion::from_scaled_axis(Vector3::z() * 0.1);
    /// let read = ReadRotations::new(vec![(0.0, read)]);
    /// let mut sensors = Sensors::new(step, 0.01, &[body])?.measured_from(0, read);
    /// let mut y = [0.0; 3];
    /// sensors.observe(At { step: 0, time: 0.0 }, &x, &mut y)?;
    /// assert!(y[0].abs() < 1e-15 && y[1].abs() < 1e-15 && (y[2] + 0.1).abs() < 1e-15);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Panics
    /// If there is no such sensor.
    pub fn measured_from(mut self, sensor: usize, read: ReadRotations) -> Sensors {
        if let Placed::Direction(_, rows) | Placed::Orientation(_, _, rows) = &mut self.sensors[sensor] {
            *rows = read;
        }
        self
    }

    /// Takes the values of the parameters of the rod's step.
    ///
    /// # Errors
    /// Values at which there is no rod.
    ///
    /// # Panics
    /// If there are not as many as the step has.
    pub fn set_parameters(&mut self, p: &[f64]) -> Result<(), Refusal> {
        if p != self.parameters {
            self.step.set_parameters(p)?;
            self.parameters.copy_from_slice(p);
            self.known.forget();
            self.known_second.forget();
        }
        Ok(())
    }

    /// Number of the parameters of the rod's step.
    pub fn parameters(&self) -> usize {
        self.parameters.len()
    }

    /// ∂y/∂p at a state of all parameters of the step, one column after the other.
    ///
    /// # Errors
    /// A state that cannot be observed.
    ///
    /// # Panics
    /// If a slice has the wrong length.
    pub fn by_parameters(&mut self, at: At, x: &[f64], columns: &mut [f64]) -> Result<(), Error> {
        let (rows, count) = (self.rows, self.parameters.len());
        assert_eq!(columns.len(), rows * count, "a column of {rows} rows for every parameter");
        let Some(parameters) = self.step.parameters.take() else { return Ok(()) };
        let (zero, mut dp) = (vec![0.0; x.len()], vec![0.0; count]);
        let done = self.with_state(at.time, x, &mut |system, motion, present| {
            let changes = parameters.of_forces(system, motion, &present.damping, present.times);
            let mut tangent = present.tangent(system, motion, changes);
            let all = present.rows();
            for (p, column) in columns.chunks_exact_mut(rows).enumerate() {
                dp.fill(0.0);
                dp[p] = 1.0;
                tangent.vary(system, motion.start.length, [&zero, &zero, &dp]);
                let change = &parameters.list[p].change;
                let moved = motion.interval.filter(|_| !change.supports.is_empty());
                let moved = moved.map(|h| moved_by(system, p, h, present.times[0]));
                let slope = parameters.slopes[p];
                // what of an acceleration is not the force on the vertex over its mass
                let inertia = |v: usize| match (present.is_free[v], &moved) {
                    (false, Some(moved)) => moved[v][1],
                    (false, None) => Vector3::zeros(),
                    (true, _) => {
                        let more = change.masses.get(v).copied().unwrap_or(0.0) / system.rod.masses[v];
                        let slower = present.velocities[v] * change.damping.mass;
                        (present.net(v) * (more / system.rod.masses[v]) - slower) * slope
                    }
                };
                let faster = |v: usize| match (present.is_free[v], &moved) {
                    (false, Some(moved)) => moved[v][0],
                    _ => Vector3::zeros(),
                };
                let at = |place: &Place, of: &dyn Fn(usize) -> Vector3<f64>| {
                    of(place.edge) * (1.0 - place.fraction) + of(place.edge + 1) * place.fraction
                };
                let gravity = parameters.change_of_gravity(change, &system.loads.gravity) * slope;
                for (out, row) in column.iter_mut().zip(&all) {
                    if let Placed::Moment(shares) = row.sensor {
                        let of = |(v, share): &(usize, f64)| tangent.moment(*v) * *share;
                        *out = row.direction.dot(&shares.iter().map(of).sum::<Vector3<f64>>());
                        continue;
                    }
                    *out = present.weights(system, motion, row).along(system, &tangent);
                    let axis = present.direction(system, row);
                    *out += match row.sensor {
                        Placed::Acceleration(place) if !present.at_rest => axis.dot(&at(place, &inertia)),
                        Placed::SpecificForce(..) if present.at_rest => -axis.dot(&gravity),
                        Placed::SpecificForce(place, _) => axis.dot(&(at(place, &inertia) - gravity)),
                        Placed::AngularRate(e) => {
                            axis.dot(&(faster(e + 1) - faster(*e))) / system.shape.edges[*e].l
                        }
                        _ => 0.0,
                    };
                }
            }
        });
        self.step.parameters = Some(parameters);
        done
    }

    /// Calls `act` with the rod in a state.
    fn with_state(
        &mut self,
        t: f64,
        x: &[f64],
        act: &mut dyn FnMut(&mut System, &Motion<'_>, &Present<'_>),
    ) -> Result<(), Error> {
        assert_eq!(x.len(), self.state_dim, "a state of the rod's step");
        let Sensors { step, interval, sensors, before, .. } = self;
        let at_rest = step.is_at_rest;
        earlier(step, if at_rest { 0.0 } else { SHARE }, *interval, x, before);
        let damping = if at_rest { Damping::default() } else { step.damping };
        let times = [t, t - SHARE * *interval];
        let held_over = (!at_rest).then_some(*interval);
        with_forces(step, (t, x), ((times[1], before), true), held_over, &mut |system, motion| {
            system.elastic(None);
            let (layout, n) = (&system.layout, system.x.len());
            let (mut is_free, mut velocities) = (vec![false; n], vec![Vector3::zeros(); n]);
            let first = 3 * layout.free_vertices.len();
            for (f, &v) in layout.free_vertices.iter().enumerate() {
                is_free[v] = true;
                velocities[v] = Vector3::from_column_slice(&x[first + 3 * f..][..3]);
            }
            let gradient = |v: usize| Vector3::from_column_slice(&system.gradient[layout.vertex(v)..][..3]);
            let loads = all_loads(system, Some(motion.start));
            let about_tangent = |e: usize| match layout.twist {
                true => system.gradient[layout.angle(e)] - loads.moments[e],
                false => 0.0,
            };
            let present = Present {
                sensors,
                gradient: (0..n).map(gradient).collect(),
                about_tangent: (0..n - 1).map(about_tangent).collect(),
                loads: loads.forces,
                is_free,
                velocities,
                damping,
                times,
                at_rest,
                state: x,
            };
            act(system, motion, &present);
        })
    }

    /// Calls `act` with the rows of H' at a state that was observed before, one after the other.
    fn with_rows(&mut self, at: At, x: &[f64], act: impl FnOnce(std::slice::ChunksExact<'_, f64>)) {
        let mut known = std::mem::take(&mut self.known);
        act(known.at(at, x, |rows| self.fill_rows(at, x, rows)).chunks_exact(x.len()));
        self.known = known;
    }

    /// Fills zeros with these rows.
    fn fill_rows(&mut self, at: At, x: &[f64], rows: &mut [f64]) {
        let (history, at_rest) = (self.step.repeated(), self.step.is_at_rest);
        let back = if at_rest { 0.0 } else { SHARE * self.interval };
        let done = self.with_state(at.time, x, &mut |system, motion, present| {
            let tangent = present.tangent(system, motion, Vec::new());
            for (row, of) in rows.chunks_exact_mut(x.len()).zip(&present.rows()) {
                if let Placed::Spin(i) = of.sensor {
                    row[*i] += 1.0;
                    continue;
                }
                let mut on = present.weights(system, motion, of);
                tangent.transpose_add(system, motion.start.length, &mut on);
                present.onto_state(system, motion, &mut on, (history, back), row);
            }
        });
        done.expect("this state was observed before");
    }
}

impl ObservationOperator for Sensors {
    fn dim(&self) -> usize {
        self.rows
    }

    fn state_dim(&self) -> usize {
        self.state_dim
    }

    /// # Panics
    /// If `x` or `y` has the wrong length.
    fn observe(&mut self, at: At, x: &[f64], y: &mut [f64]) -> Result<(), Refusal> {
        assert_eq!(y.len(), self.rows, "a number for every row");
        self.with_state(at.time, x, &mut |system, motion, present| {
            for (y, row) in y.iter_mut().zip(&present.rows()) {
                *y = present.value(system, motion, row);
            }
        })?;
        Ok(())
    }

    /// # Panics
    /// If a slice has the wrong length, or `observe` refuses this state.
    fn tangent(&mut self, at: At, x: &[f64], dx: &[f64], dy: &mut [f64]) {
        assert_eq!(dy.len(), self.rows, "a number for every row");
        self.with_rows(at, x, |rows| {
            for (dy, row) in dy.iter_mut().zip(rows) {
                *dy = row.iter().zip(dx).map(|(row, dx)| row * dx).sum();
            }
        });
    }

    /// # Panics
    /// If a slice has the wrong length, or `observe` refuses this state.
    fn adjoint_add(&mut self, at: At, x: &[f64], dy: &[f64], dx: &mut [f64]) {
        assert_eq!(dy.len(), self.rows, "a number for every row");
        self.with_rows(at, x, |rows| {
            for (dy, row) in dy.iter().zip(rows) {
                dx.iter_mut().zip(row).for_each(|(dx, row)| *dx += dy * row);
            }
        });
    }

    /// Not of a rod at rest, nor with a load that has none.
    fn has_second_derivatives(&self) -> bool {
        !self.step.is_at_rest && self.step.system.loads_have_second_derivatives()
    }

    /// # Panics
    /// If a slice has the wrong length, or `observe` refuses this state.
    fn second_adjoint_add(&mut self, at: At, x: &[f64], dx: &[f64], dy: &[f64], out: &mut [f64]) {
        assert_eq!(dy.len(), self.rows, "a number for every row");
        self.second_add(at.time, x, dx, dy, out);
    }
}

/// The state a little earlier: places back along their velocities, angles along what they did since the
/// state before, where there is one.
fn earlier(step: &RodStep, share: f64, interval: f64, x: &[f64], before: &mut [f64]) {
    let (layout, history) = (&step.system.layout, step.repeated());
    let places = 3 * layout.free_vertices.len();
    before.copy_from_slice(x);
    for i in 0..places {
        before[i] -= share * interval * x[places + i];
    }
    if history > 0 {
        for i in 2 * places..2 * places + layout.free_angles.len() {
            before[i] -= share * (x[i] - x[layout.state() + i]);
        }
    }
}
