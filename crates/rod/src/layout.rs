//! Which degrees of freedom are unknown, and where they sit.

use crate::Error;
use crate::rod::Rod;
use crate::support::{Damping, Supports};

pub(crate) const FIXED: usize = usize::MAX;

/// Numbering. The full order goes along the rod, x_0, θ^0, x_1, θ^1, … , x_n (without the θ where there
/// is no twist); unknowns are the free ones of these in the same order, which keeps the band narrow.
#[derive(Debug, Clone)]
pub(crate) struct Layout {
    pub(crate) segments: usize,
    /// θ are unknowns.
    pub(crate) twist: bool,
    /// Sections have inertia against spin: their spins are part of the state.
    pub(crate) spins: bool,
    /// Vertices bend (false for a chain).
    pub(crate) bending: bool,
    /// Degrees of freedom from one vertex to the next in the full order: 4 with θ, 3 without.
    stride: usize,
    /// Unknown of every degree of freedom in the full order, or `FIXED`.
    pub(crate) unknown: Vec<usize>,
    /// Vertices that are not prescribed, ascending.
    pub(crate) free_vertices: Vec<usize>,
    /// Edges whose θ is unknown, ascending; empty without twist.
    pub(crate) free_angles: Vec<usize>,
    pub(crate) unknowns: usize,
    pub(crate) half_bandwidth: usize,
}

impl Layout {
    /// The layout a rod needs: no θ where the twist is provably zero, no bending for a chain.
    ///
    /// The twist of a naturally straight isotropic rod is zero in equilibrium as long as at most one end
    /// holds a director and no strain-rate damping ties θ to its past: bending does not depend on θ, and τ
    /// = 0 costs nothing. With inertia against spin it is not: directors carried along the rod spin against
    /// those carried in time.
    pub(crate) fn needed(
        rod: &Rod,
        supports: &Supports,
        damping: &Damping,
        force_twist: bool,
    ) -> Result<Layout, Error> {
        let bending = !rod.is_chain() && rod.segments() > 1;
        let held = supports.start.is_some() && supports.end.is_some();
        let twistless = rod.is_isotropic_and_straight()
            && !held
            && damping.stiffness == 0.0
            && !force_twist
            && !rod.spins();
        let prescribed = supports.prescribed_vertices(rod)?;
        let mut angles = vec![true; rod.segments()];
        if supports.start.is_some() {
            angles[0] = false;
        }
        if supports.end.is_some() {
            angles[rod.segments() - 1] = false;
        }
        let free_vertices = (0..=rod.segments()).filter(|v| prescribed.binary_search(v).is_err()).collect();
        let twist = bending && !twistless;
        let free_angles = (0..rod.segments()).filter(|&e| twist && angles[e]).collect();
        let spins = twist && rod.spins();
        Ok(Layout { spins, ..Layout::of(rod.segments(), twist, bending, free_vertices, free_angles) })
    }

    /// The same rod with all vertices held and only the angles unknown.
    pub(crate) fn angles_only(&self) -> Layout {
        Layout::of(self.segments, self.twist, self.bending, Vec::new(), self.free_angles.clone())
    }

    /// The same rod with nothing held: unknowns in the full order.
    pub(crate) fn all_free(&self) -> Layout {
        let angles = (0..self.segments).filter(|_| self.twist).collect();
        Layout::of(self.segments, self.twist, self.bending, (0..=self.segments).collect(), angles)
    }

    fn of(
        segments: usize,
        twist: bool,
        bending: bool,
        free_vertices: Vec<usize>,
        free_angles: Vec<usize>,
    ) -> Layout {
        let stride = if twist { 4 } else { 3 };
        let full = stride * segments + 3;
        let mut unknown = vec![FIXED; full];
        for v in &free_vertices {
            unknown[stride * v..stride * v + 3].fill(0);
        }
        for e in &free_angles {
            unknown[stride * e + 3] = 0;
        }
        let mut unknowns = 0;
        for u in unknown.iter_mut().filter(|u| **u != FIXED) {
            *u = unknowns;
            unknowns += 1;
        }
        // The widest element: three vertices and two angles where the rod bends, else one edge.
        let width = if bending && segments > 1 { 2 * stride + 3 } else { stride + 3 };
        let reach = unknown.windows(width).map(|w| {
            let mut free = w.iter().filter(|u| **u != FIXED);
            free.next().map_or(0, |first| free.next_back().map_or(0, |last| last - first))
        });
        let half_bandwidth = reach.max().unwrap_or(0);
        Layout {
            segments,
            twist,
            spins: false,
            bending,
            stride,
            unknown,
            free_vertices,
            free_angles,
            unknowns,
            half_bandwidth,
        }
    }

    pub(crate) fn full(&self) -> usize {
        self.unknown.len()
    }

    /// Numbers of the lower band of a symmetric matrix over the unknowns.
    pub(crate) fn band(&self) -> usize {
        self.unknowns * (self.half_bandwidth + 1)
    }

    /// The full order from the unknowns; zero for what is held.
    pub(crate) fn fill(&self, unknowns: &[f64], full: &mut [f64]) {
        for (full, &unknown) in full.iter_mut().zip(&self.unknown) {
            *full = if unknown == FIXED { 0.0 } else { unknowns[unknown] };
        }
    }

    /// The unknowns from the full order.
    pub(crate) fn take(&self, full: &[f64], unknowns: &mut [f64]) {
        for (&full, &unknown) in full.iter().zip(&self.unknown) {
            if unknown != FIXED {
                unknowns[unknown] = full;
            }
        }
    }

    /// First degree of freedom of a vertex in the full order.
    pub(crate) fn vertex(&self, v: usize) -> usize {
        self.stride * v
    }

    /// Degree of freedom of θ^e in the full order.
    pub(crate) fn angle(&self, e: usize) -> usize {
        debug_assert!(self.twist);
        self.stride * e + 3
    }

    /// Whether all angles together are free to turn: no end holds a director.
    pub(crate) fn turns_freely(&self) -> bool {
        self.free_angles.len() == self.segments
    }

    /// Whether both ends hold a director and twist is an unknown: the end clamp's angle is then part of the
    /// state, since it counts whole turns.
    pub(crate) fn ends_held(&self) -> bool {
        self.twist && self.free_angles.len() + 2 == self.segments
    }

    /// Where the end clamp's angle stands in the state.
    pub(crate) fn end_angle(&self) -> Option<usize> {
        self.ends_held().then(|| self.first_spin() + if self.spins { self.free_angles.len() } else { 0 })
    }

    /// Number of angles that follow from the places in equilibrium: the free ones and the end clamp's.
    pub(crate) fn following(&self) -> usize {
        self.free_angles.len() + usize::from(self.ends_held())
    }

    /// Where spins start in the state: after the free angles.
    pub(crate) fn first_spin(&self) -> usize {
        6 * self.free_vertices.len() + self.free_angles.len()
    }

    /// Length of the state [X, V, θ], or [X, V, θ, ω], and the end clamp's angle.
    pub(crate) fn state(&self) -> usize {
        let spins = if self.spins { self.free_angles.len() } else { 0 };
        self.first_spin() + spins + usize::from(self.ends_held())
    }
}

/// A symmetric matrix of n rows from its lower band into a general one (see `Structure::Band`).
pub(crate) fn mirror(lower: &[f64], w: usize, values: &mut [f64]) {
    for (i, row) in lower.chunks_exact(w + 1).enumerate() {
        for j in i.saturating_sub(w)..=i {
            let value = row[j + w - i];
            values[i * (2 * w + 1) + j + w - i] = value;
            values[j * (2 * w + 1) + i + w - j] = value;
        }
    }
}

/// out += the symmetric matrix of a lower band times x, in the order of the unknowns.
pub(crate) fn band_product_add(w: usize, band: &[f64], x: &[f64], out: &mut [f64]) {
    for (i, row) in band.chunks_exact(w + 1).enumerate() {
        let first = i.saturating_sub(w);
        let row = &row[w + first - i..];
        let mut sum = row[i - first] * x[i];
        for (j, h) in (first..i).zip(row) {
            sum += h * x[j];
            out[j] += h * x[i];
        }
        out[i] += sum;
    }
}

/// The lower band of ∂G/∂u, row by row (see `Structure::SymmetricBand`).
pub(crate) struct Band<'a> {
    pub(crate) layout: &'a Layout,
    pub(crate) values: &'a mut [f64],
}

impl Band<'_> {
    /// Adds the lower triangle of an element whose degrees of freedom are `first`, `first` + 1, … in the
    /// full order.
    pub(crate) fn add<const N: usize>(&mut self, first: usize, h: &[[f64; N]; N]) {
        let w = self.layout.half_bandwidth;
        let map = &self.layout.unknown[first..first + N];
        let base = map[0];
        if base != FIXED && map[N - 1] == base + N - 1 && w + 1 >= N {
            for i in 0..N {
                let row = (base + i) * (w + 1) + w - i;
                let target = &mut self.values[row..row + i + 1];
                for (t, v) in target.iter_mut().zip(&h[i][..=i]) {
                    *t += v;
                }
            }
            return;
        }
        for i in (0..N).filter(|&i| map[i] != FIXED) {
            for j in (0..=i).filter(|&j| map[j] != FIXED) {
                self.values[map[i] * (w + 1) + w + map[j] - map[i]] += h[i][j];
            }
        }
    }
}
