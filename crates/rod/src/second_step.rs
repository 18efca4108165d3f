//! What second derivatives of a rod's step keep beside the third ones of the energy, and angles of states.

use varda_implicit::{Interval, Scheme, SolvedStep};

use crate::dynamics::RodStep;
use crate::layout::band_product_add;
use crate::twist_equilibrium::ByParameters;

impl RodStep {
    /// Second derivatives of the first state, by parameters too where these and their increment are given.
    pub(crate) fn second_of_initial(
        &mut self,
        dz: &[f64],
        lambda: &[f64],
        out: &mut [f64],
        by: Option<ByParameters>,
    ) {
        let Some(twist) = &mut self.twist else { return };
        let layout = &self.system.layout;
        let (n, first) = (6 * layout.free_vertices.len(), layout.first_spin());
        self.lambda.clear();
        self.lambda.extend_from_slice(&lambda[n..first]);
        // angles that are given do not follow
        if dz.len() > n {
            self.lambda.fill(0.0);
        }
        self.lambda.extend(layout.end_angle().map(|end| lambda[end]));
        twist.second_add(&dz[..n / 2], &self.lambda, &mut out[..n / 2], by);
    }

    /// How many numbers second derivatives keep of loads, and of what resists a common turn.
    pub(crate) fn second_of_motion(&self) -> [usize; 2] {
        let turning =
            self.spin.as_ref().map_or(0, |spin| spin.second_kept(&self.system, self.repeated() > 0));
        [self.system.second_of_loads_kept(), turning]
    }

    /// Bands that second derivatives keep beside damping's: of the stage, and of the end clamp's angle.
    pub(crate) fn second_bands(&self) -> usize {
        1 + usize::from(self.curves_next())
    }

    /// Whether ψ of x_{k+1} may be in its angles: in that of the end clamp, and in those of sections in
    /// steps that end beyond their stage.
    fn curves_next(&self) -> bool {
        let layout = &self.system.layout;
        layout.end_angle().is_some() || (layout.spins && self.scheme != Scheme::BackwardEuler)
    }

    /// Whether λ sees that.
    pub(crate) fn curves_next_by(&self, at: &Interval, lambda: &[f64]) -> bool {
        let end = self.system.layout.end_angle();
        end.is_some_and(|end| lambda[end] != 0.0) || self.turns_with_frames(at)
    }

    pub(crate) fn turns_with_frames(&self, at: &Interval) -> bool {
        self.system.layout.spins && self.stage(at).of.to[1] != 0.0
    }

    /// `psi` = so much of what acts on the free angles of a state.
    pub(crate) fn angles_of(&mut self, lambda: &[f64], share: f64) {
        let (layout, angles) = (&self.system.layout, 6 * self.system.layout.free_vertices.len());
        self.psi.fill(0.0);
        for (f, &e) in layout.free_angles.iter().enumerate() {
            self.psi[e] = share * lambda[angles + f];
        }
    }

    /// The second derivatives of angles at x_{k+1} by its places, from their band.
    pub(crate) fn second_of_next(
        &mut self,
        step: &SolvedStep<'_>,
        band: &[f64],
        [dx, du]: [&[f64]; 2],
        [rx, ru]: [&mut [f64]; 2],
    ) {
        let mut next = std::mem::take(&mut self.state);
        self.follow(step.at, dx, du, &mut next);
        let [mut moved, mut by] = std::mem::take(&mut self.of_unknowns);
        let layout = &self.system.layout;
        moved.resize(layout.unknowns, 0.0);
        by.clear();
        by.resize(layout.unknowns, 0.0);
        let place = |v: usize| layout.unknown[layout.vertex(v)];
        for (next, &v) in next.chunks_exact(3).zip(&layout.free_vertices) {
            moved[place(v)..place(v) + 3].copy_from_slice(next);
        }
        band_product_add(layout.half_bandwidth, band, &moved, &mut by);
        next.fill(0.0);
        for (next, &v) in next.chunks_exact_mut(3).zip(&layout.free_vertices) {
            next.copy_from_slice(&by[place(v)..place(v) + 3]);
        }
        self.follow_transpose(step, &next, rx, &mut moved);
        ru.iter_mut().zip(&moved).for_each(|(r, m)| *r += m);
        (self.state, self.of_unknowns) = (next, [moved, by]);
    }
}
