//! Points carried by the rod: on the centreline, or off it in the frame of the section.

use nalgebra::Vector3;
use varda_implicit::ImplicitStep;

use crate::Error;
use crate::dynamics::RodStep;
use crate::rod::Place;
use crate::system::System;

/// A point fixed to the rod: rest arc length s \[m\] and offset (o₁, o₂, o₃) along (m₁, m₂, t) of the edge there \[m\].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Marker {
    /// Rest arc length \[m\].
    pub s: f64,
    /// Offset in the frame of the section \[m\]; zero for a point of the centreline.
    pub offset: Vector3<f64>,
}

/// Where markers are, as a function of time and state, with tangent and adjoint:
///
/// ```text
/// p = (1−w) x_i + w x_{i+1} + o₁ m₁ + o₂ m₂ + o₃ t                      w linear in arc length on edge i
/// δm₁ = −(m₁·δt) t + δφ m₂,   δm₂ = −(m₂·δt) t − δφ m₁,   δφ = δθ − δψ,   δt = (I − t tᵀ) δe/l
/// ```
///
/// with ψ the holonomy of the Bishop frame (Bergou et al. 2010). A prescribed direction has no δ. Frames are computed only
/// where a marker is off the centreline. The state is the [X, V, θ] of [`RodStep`].
pub struct Markers {
    system: System,
    state_dim: usize,
    markers: Vec<(Place, Vector3<f64>)>,
    /// A marker is off the centreline.
    frames: bool,
    displacement: Vec<Vector3<f64>>,
    psi: Vec<f64>,
    angle: Vec<f64>,
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
            displacement: vec![Vector3::zeros(); n + 1],
            psi: vec![0.0; n],
            angle: vec![0.0; n],
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

    /// Length of the state the markers are read from.
    pub fn state_dim(&self) -> usize {
        self.state_dim
    }

    /// Places of all markers \[m\], three numbers each, in a state at time t.
    ///
    /// # Errors
    /// [`Error`] where the state has no frames (a fold, a zero edge) or is not finite.
    ///
    /// # Panics
    /// If `state` or `places` has the wrong length.
    pub fn places(&mut self, t: f64, state: &[f64], places: &mut [f64]) -> Result<(), Error> {
        assert_eq!(places.len(), 3 * self.markers.len(), "three numbers for every marker");
        self.set(t, state)?;
        for ((place, o), out) in self.markers.iter().zip(places.chunks_exact_mut(3)) {
            let (i, w, s) = (place.edge, place.fraction, &self.system);
            let mut p = s.x[i] * (1.0 - w) + s.x[i + 1] * w + s.shape.edges[i].t * o[2];
            if self.frames {
                p += s.shape.m1[i] * o[0] + s.shape.m2[i] * o[1];
            }
            out.copy_from_slice(p.as_slice());
        }
        Ok(())
    }

    /// dp = ∂p/∂x dx at a state at time t.
    ///
    /// # Errors
    /// As [`Markers::places`].
    ///
    /// # Panics
    /// As [`Markers::places`].
    pub fn tangent(&mut self, t: f64, state: &[f64], dx: &[f64], dp: &mut [f64]) -> Result<(), Error> {
        assert_eq!(dp.len(), 3 * self.markers.len(), "three numbers for every marker");
        self.set(t, state)?;
        self.system.displacements(dx, &mut self.displacement);
        if self.frames {
            self.turn_angles(dx);
        }
        let s = &self.system;
        for ((place, o), out) in self.markers.iter().zip(dp.chunks_exact_mut(3)) {
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
            out.copy_from_slice(d.as_slice());
        }
        Ok(())
    }

    /// dx += (∂p/∂x)ᵀ dp at a state at time t.
    ///
    /// # Errors
    /// As [`Markers::places`].
    ///
    /// # Panics
    /// As [`Markers::places`].
    pub fn adjoint_add(&mut self, t: f64, state: &[f64], dp: &[f64], dx: &mut [f64]) -> Result<(), Error> {
        assert_eq!(dp.len(), 3 * self.markers.len(), "three numbers for every marker");
        self.set(t, state)?;
        self.displacement.fill(Vector3::zeros());
        self.angle.fill(0.0);
        let s = &self.system;
        for ((place, o), dp) in self.markers.iter().zip(dp.chunks_exact(3)) {
            let (i, w, edge) = (place.edge, place.fraction, &s.shape.edges[place.edge]);
            let dp = Vector3::from_column_slice(dp);
            let mut dt = dp * o[2];
            if self.frames {
                let (m1, m2) = (&s.shape.m1[i], &s.shape.m2[i]);
                dt -= (m1 * o[0] + m2 * o[1]) * edge.t.dot(&dp);
                self.angle[i] += (m2 * o[0] - m1 * o[1]).dot(&dp);
            }
            let rate = (dt - edge.t * dt.dot(&edge.t)) / edge.l;
            self.displacement[i] += dp * (1.0 - w) - rate;
            self.displacement[i + 1] += dp * w + rate;
        }
        if self.frames {
            self.turn_angles_transpose(dx);
        }
        for (f, &v) in self.system.layout.free_vertices.iter().enumerate() {
            for c in 0..3 {
                dx[3 * f + c] += self.displacement[v][c];
            }
        }
        Ok(())
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
        let s = &self.system;
        let n = self.psi.len();
        for e in 0..n {
            self.psi[e] = -self.angle[e];
        }
        if s.layout.twist {
            let angles = &mut dx[6 * s.layout.free_vertices.len()..];
            for (f, &e) in s.layout.free_angles.iter().enumerate() {
                angles[f] += self.angle[e];
            }
            if s.supports.end.is_some() {
                self.psi[n - 1] = 0.0;
            }
        } else if s.supports.end.is_some() {
            self.psi[n - 1] += self.angle.iter().sum::<f64>();
        }
        s.shape.holonomy_transpose_add(&self.psi, &mut self.displacement);
    }
}
