//! Points carried by the rod: on the centreline, or off it in the frame of the section.

mod second;

use nalgebra::{Matrix3, Vector3};
use varda_implicit::{At, ImplicitStep, ObservationOperator, Refusal};

use crate::Error;
use crate::dynamics::RodStep;
use crate::moved_together::Together;
use crate::rod::Place;
use crate::system::System;

/// A point fixed to the rod: rest arc length s \[m\] and offset (o₁, o₂, o₃) along (m₁, m₂, t) of
/// the edge there \[m\].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Marker {
    /// Rest arc length \[m\].
    pub s: f64,
    /// Offset in the frame of the section \[m\]; zero for a point of the centreline.
    pub offset: Vector3<f64>,
}

/// Where markers are \[m\], as a function of time and state, with tangent and adjoint: an observation
/// operator with three rows a marker, y = Rᵀ (p − c) in axes that [`Markers::in_axes`] gives.
///
/// ```text
/// p = (1−w) x_i + w x_{i+1} + o₁ m₁ + o₂ m₂ + o₃ t        w linear in arc length on edge i
/// δm₁ = −(m₁·δt) t + δφ m₂,   δm₂ = −(m₂·δt) t − δφ m₁
/// δφ = δθ − δψ,   δt = (I − t tᵀ) δe/l
/// ```
///
/// with ψ the holonomy of the Bishop frame (Bergou et al. 2010). A prescribed direction has no δ. Frames
/// are computed only where a marker is off the centreline. The state is the [X, V, θ] of [`RodStep`]; the
/// time of an observation is the model's \[s\], which supports depend on.
///
/// # Examples
///
/// ```
/// use varda_implicit::{At, ObservationOperator};
/// use varda_rod::{Clamp, ClampAt, Damping, Loads, Marker, Markers, Material, Rod, RodStep, Section};
/// use varda_rod::{Supports, Vector3};
///
/// let rod = Rod::uniform(1.0, 10, &Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01))?;
/// let clamp = Clamp::new(ClampAt::Edge, [0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
/// let supports = Supports::clamped_start(clamp);
/// let step = RodStep::new(rod, supports, Loads::default(), Damping::default())?;
/// // 5 cm along the clamp's edge, and 2 cm above it.
/// let mut markers = Markers::new(&step, &[Marker { s: 0.05, offset: Vector3::new(0.02, 0.0, 0.0) }])?;
/// let straight: Vec<f64> = (2..=10).flat_map(|v| [0.1 * v as f64, 0.0, 0.0]).chain([0.0; 27]).collect();
/// let mut y = [0.0; 3];
/// markers.observe(At { step: 0, time: 0.0 }, &straight, &mut y)?;
/// assert!((Vector3::from(y) - Vector3::new(0.05, 0.0, 0.02)).norm() < 1e-15);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Markers {
    system: System,
    state_dim: usize,
    markers: Vec<(Place, Vector3<f64>)>,
    /// A marker is off the centreline.
    frames: bool,
    /// R and c, where places are not given in the model's axes.
    axes: Option<(Matrix3<f64>, Vector3<f64>)>,
    displacement: Vec<Vector3<f64>>,
    psi: Vec<f64>,
    angle: Vec<f64>,
    /// Parameters of the step that move its supports.
    moving: Vec<usize>,
    second: second::Second,
}

impl Markers {
    /// # Errors
    /// [`Error::OffRod`] for a place off the rod, [`Error::NonFinite`] for an offset that is not finite.
    pub fn new(rod: &RodStep, markers: &[Marker]) -> Result<Markers, Error> {
        let system = rod.system.clone();
        let n = system.rod.segments();
        let mut placed = Vec::with_capacity(markers.len());
        for (index, m) in markers.iter().enumerate() {
            if !m.offset.iter().all(|o| o.is_finite()) {
                return Err(Error::NonFinite { what: "the offset of marker", index });
            }
            placed.push((system.rod.place("marker", m.s)?, m.offset));
        }
        let frames = markers.iter().any(|m| m.offset[0] != 0.0 || m.offset[1] != 0.0);
        Ok(Markers {
            system,
            state_dim: rod.dim(),
            markers: placed,
            frames,
            axes: None,
            displacement: vec![Vector3::zeros(); n + 1],
            psi: vec![0.0; n],
            angle: vec![0.0; n],
            moving: rod.system.moves.parameters(),
            second: second::Second::default(),
        })
    }

    /// Number of markers.
    pub fn len(&self) -> usize {
        self.markers.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.markers.is_empty()
    }

    /// The same markers as seen in other axes: y = Rᵀ (p − c), the columns of R being those axes in the
    /// model's and c their origin \[m\].
    ///
    /// # Errors
    /// [`Error::Value`] where R is not a rotation (to 1e-3: four digits will do), [`Error::NonFinite`] for an
    /// origin that is not finite.
    pub fn in_axes(self, rotation: Matrix3<f64>, origin: Vector3<f64>) -> Result<Markers, Error> {
        let skew = (rotation.tr_mul(&rotation) - Matrix3::identity()).abs().max();
        if !(skew <= 1e-3 && rotation.determinant() > 0.0) {
            return Err(Error::Value {
                field: "rotation of the markers' axes",
                value: skew,
                expected: "a rotation: RᵀR = I, det R > 0",
            });
        }
        if let Some(index) = origin.iter().position(|c| !c.is_finite()) {
            return Err(Error::NonFinite { what: "the origin of the markers' axes, component", index });
        }
        Ok(Markers { axes: Some((rotation, origin)), ..self })
    }

    /// Puts the markers at other places, beyond an end of the rod straight on; off the centreline where `new`
    /// had some there, or [`with_frames`](Self::with_frames) was asked for.
    ///
    /// # Errors
    /// A place or an offset that is not finite.
    ///
    /// # Panics
    /// If there are not as many, or one is off the centreline of a rod whose frames are left out.
    pub fn move_to(&mut self, markers: &[Marker]) -> Result<(), Error> {
        assert_eq!(markers.len(), self.markers.len(), "as many markers as before");
        for (index, (to, m)) in self.markers.iter_mut().zip(markers).enumerate() {
            if !m.offset.iter().all(|o| o.is_finite()) {
                return Err(Error::NonFinite { what: "the offset of marker", index });
            }
            assert!(self.frames || (m.offset[0] == 0.0 && m.offset[1] == 0.0), "a rod with frames");
            let rod = &self.system.rod;
            // NaN stays NaN, and is off the rod
            let on_rod = if m.s > rod.length() {
                rod.length()
            } else if m.s < 0.0 {
                0.0
            } else {
                m.s
            };
            let mut place = rod.place("marker", on_rod)?;
            place.fraction += (m.s - on_rod) / rod.rest_lengths[place.edge];
            *to = (place, m.offset);
        }
        Ok(())
    }

    /// The same markers, which may come to be off the centreline.
    #[must_use]
    pub fn with_frames(self) -> Markers {
        Markers { frames: true, ..self }
    }

    /// ∂y/∂(s, o₁, o₂, o₃) of every marker at a state, four columns of three numbers each: what its
    /// place on the rod does to where it is seen. Along s it jumps where a vertex is passed.
    ///
    /// # Errors
    /// A state that cannot be observed.
    ///
    /// # Panics
    /// If a slice has the wrong length, or there are no frames ([`with_frames`](Self::with_frames)).
    pub fn by_place(&mut self, at: At, x: &[f64], columns: &mut [f64]) -> Result<(), Error> {
        assert_eq!(columns.len(), 12 * self.markers.len(), "twelve numbers for every marker");
        assert!(self.frames, "a rod with frames");
        self.set(at.time, x)?;
        let (shape, lengths) = (&self.system.shape, &self.system.rod.rest_lengths);
        for ((place, _), out) in self.markers.iter().zip(columns.chunks_exact_mut(12)) {
            let e = place.edge;
            let along = (self.system.x[e + 1] - self.system.x[e]) / lengths[e];
            let by = [along, shape.m1[e], shape.m2[e], shape.edges[e].t];
            for (column, by) in out.chunks_exact_mut(3).zip(by) {
                column.copy_from_slice(self.turned(by).as_slice());
            }
        }
        Ok(())
    }

    /// Takes the values of the parameters of the rod's step, which may move its supports.
    ///
    /// # Panics
    /// If there are fewer than the step has.
    pub fn set_parameters(&mut self, p: &[f64]) {
        self.system.moves.take(p);
    }

    /// Those parameters that move supports, ascending: the columns of [`by_parameters`](Self::by_parameters).
    pub fn moving_parameters(&self) -> &[usize] {
        &self.moving
    }

    /// ∂y/∂p at a state of those parameters that move supports, one column after the other.
    ///
    /// # Errors
    /// A state that cannot be observed.
    ///
    /// # Panics
    /// If a slice has the wrong length.
    pub fn by_parameters(&mut self, at: At, x: &[f64], columns: &mut [f64]) -> Result<(), Error> {
        self.set(at.time, x)?;
        let rows = 3 * self.markers.len();
        assert_eq!(columns.len(), self.moving.len() * rows, "a column of {rows} numbers for every parameter");
        for (i, column) in columns.chunks_exact_mut(rows.max(1)).enumerate() {
            let Self { system, displacement, angle, moving, .. } = &mut *self;
            let p = moving[i];
            match system.moved_increment(&system.shape, p, at.time, displacement, angle) {
                Some(_) => self.of_increment(column),
                None => column.fill(0.0),
            }
        }
        Ok(())
    }

    /// dy of the increment in `displacement` and, where there are frames, `angle`.
    fn of_increment(&self, dy: &mut [f64]) {
        let s = &self.system;
        for ((place, o), out) in self.markers.iter().zip(dy.chunks_exact_mut(3)) {
            let (i, w, tangent) = (place.edge, place.fraction, s.shape.edges[place.edge].t);
            let (a, b) = (&self.displacement[i], &self.displacement[i + 1]);
            let rate = (b - a) / s.shape.edges[i].l;
            let dt = rate - tangent * rate.dot(&tangent);
            let mut d = a * (1.0 - w) + b * w + dt * o[2];
            if self.frames {
                let (m1, m2) = (&s.shape.m1[i], &s.shape.m2[i]);
                d -= tangent * (o[0] * m1.dot(&dt) + o[1] * m2.dot(&dt));
                d += (m2 * o[0] - m1 * o[1]) * self.angle[i];
            }
            out.copy_from_slice(self.turned(d).as_slice());
        }
    }

    /// The transpose of an offset's increment on edge e: what a force does to the end of the edge (less to
    /// its start), and to its angle, where there are frames.
    fn offset_transpose(&self, e: usize, o: &Vector3<f64>, force: &Vector3<f64>) -> (Vector3<f64>, f64) {
        let (shape, edge) = (&self.system.shape, &self.system.shape.edges[e]);
        let (mut dt, mut turn) = (force * o[2], 0.0);
        if self.frames {
            let (m1, m2) = (&shape.m1[e], &shape.m2[e]);
            dt -= (m1 * o[0] + m2 * o[1]) * edge.t.dot(force);
            turn = (m2 * o[0] - m1 * o[1]).dot(force);
        }
        ((dt - edge.t * dt.dot(&edge.t)) / edge.l, turn)
    }

    /// dx += what acts on `displacement` and, where there are frames, on `angle`.
    fn displacements_transpose_add(&mut self, dx: &mut [f64]) {
        if self.frames {
            self.turn_angles_transpose(dx);
        }
        for (f, &v) in self.system.layout.free_vertices.iter().enumerate() {
            for c in 0..3 {
                dx[3 * f + c] += self.displacement[v][c];
            }
        }
    }

    /// `displacement` and `angle` = what acts on places and local angles.
    fn forces_of(&mut self, dy: &[f64]) {
        self.displacement.fill(Vector3::zeros());
        self.angle.fill(0.0);
        for ((place, o), dy) in self.markers.iter().zip(dy.chunks_exact(3)) {
            let (i, w) = (place.edge, place.fraction);
            let dp = self.force(dy);
            let (rate, turn) = self.offset_transpose(place.edge, o, &dp);
            self.angle[i] += turn;
            self.displacement[i] += dp * (1.0 - w) - rate;
            self.displacement[i + 1] += dp * w + rate;
        }
    }

    /// δp or p of a marker into the axes of the observer; p − c already taken.
    fn turned(&self, v: Vector3<f64>) -> Vector3<f64> {
        match &self.axes {
            Some((rotation, _)) => rotation.tr_mul(&v),
            None => v,
        }
    }

    /// What acts on a marker, in the model's axes.
    fn force(&self, dy: &[f64]) -> Vector3<f64> {
        let dy = Vector3::from_column_slice(dy);
        self.axes.as_ref().map_or(dy, |(rotation, _)| rotation * dy)
    }

    fn set(&mut self, t: f64, state: &[f64]) -> Result<(), Error> {
        let s = &mut self.system;
        assert_eq!(state.len(), self.state_dim, "a state of the rod's step");
        s.place(t)?;
        s.scatter_state(state);
        let guess = s.end_angle_guess();
        s.update_shape(self.frames, guess)
    }

    /// `angle` = δφ of every edge from the displacements and the state's δθ.
    fn turn_angles(&mut self, dx: &[f64]) {
        let s = &self.system;
        s.shape.holonomy(&self.displacement, &mut self.psi);
        let n = self.psi.len();
        let untwisted = s.angle_that_all_follow(&self.psi);
        for e in 0..n {
            self.angle[e] = untwisted - self.psi[e];
        }
        if s.layout.twist {
            let angles = &dx[6 * s.layout.free_vertices.len()..];
            for (f, &e) in s.layout.free_angles.iter().enumerate() {
                self.angle[e] = angles[f] - self.psi[e];
            }
            if s.supports.end.is_some() {
                self.angle[n - 1] = 0.0;
            }
        }
    }

    /// The transpose: from forces on `angle` to forces on the displacements and on δθ.
    fn turn_angles_transpose(&mut self, dx: &mut [f64]) {
        self.weigh_holonomy();
        let s = &self.system;
        if s.layout.twist {
            let angles = &mut dx[6 * s.layout.free_vertices.len()..];
            for (f, &e) in s.layout.free_angles.iter().enumerate() {
                angles[f] += self.angle[e];
            }
        }
        s.shape.holonomy_transpose_add(&self.psi, &mut self.displacement);
    }

    /// `psi` = what forces on `angle` are on ψ.
    fn weigh_holonomy(&mut self) {
        let s = &self.system;
        let n = self.psi.len();
        for e in 0..n {
            self.psi[e] = -self.angle[e];
        }
        if s.supports.end.is_some() {
            let all = if s.layout.twist { self.angle[n - 1] } else { self.angle.iter().sum() };
            self.psi[n - 1] += all;
        }
    }
}

impl ObservationOperator for Markers {
    fn dim(&self) -> usize {
        3 * self.markers.len()
    }

    fn state_dim(&self) -> usize {
        self.state_dim
    }

    /// # Panics
    /// If `x` or `y` has the wrong length.
    fn observe(&mut self, at: At, x: &[f64], y: &mut [f64]) -> Result<(), Refusal> {
        assert_eq!(y.len(), self.dim(), "three numbers for every marker");
        self.set(at.time, x)?;
        let origin = self.axes.map_or(Vector3::zeros(), |axes| axes.1);
        for ((place, o), out) in self.markers.iter().zip(y.chunks_exact_mut(3)) {
            let (i, w, s) = (place.edge, place.fraction, &self.system);
            let mut p = s.x[i] * (1.0 - w) + s.x[i + 1] * w + s.shape.edges[i].t * o[2];
            if self.frames {
                p += s.shape.m1[i] * o[0] + s.shape.m2[i] * o[1];
            }
            out.copy_from_slice(self.turned(p - origin).as_slice());
        }
        Ok(())
    }

    /// # Panics
    /// If a slice has the wrong length, or `observe` refuses this state.
    fn tangent(&mut self, at: At, x: &[f64], dx: &[f64], dy: &mut [f64]) {
        assert_eq!(dy.len(), self.dim(), "three numbers for every marker");
        self.set(at.time, x).expect("this state was observed before");
        self.system.displacements(dx, &mut self.displacement);
        if self.frames {
            self.turn_angles(dx);
        }
        self.of_increment(dy);
    }

    /// # Panics
    /// If a slice has the wrong length, or `observe` refuses this state.
    fn adjoint_add(&mut self, at: At, x: &[f64], dy: &[f64], dx: &mut [f64]) {
        assert_eq!(dy.len(), self.dim(), "three numbers for every marker");
        self.set(at.time, x).expect("this state was observed before");
        self.forces_of(dy);
        self.displacements_transpose_add(dx);
    }

    fn has_second_derivatives(&self) -> bool {
        !self.frames || self.system.layout.bending
    }

    /// # Panics
    /// If a slice has the wrong length, or `observe` refuses this state.
    fn second_adjoint_add(&mut self, at: At, x: &[f64], dx: &[f64], dy: &[f64], out: &mut [f64]) {
        if self.markers.iter().all(|(_, o)| *o == Vector3::zeros()) {
            return;
        }
        self.set(at.time, x).expect("this state was observed before");
        self.set_increment(dx, &[], &Together::default());
        self.second_of_increment(dy);
        self.displacements_transpose_add(out);
    }
}
