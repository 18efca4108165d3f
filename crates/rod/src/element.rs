//! Energy, gradient and Hessian of one stretched edge and one bent (and twisted) vertex, in small fixed arrays.
//!
//! Local degrees of freedom are in the order of the whole rod: x_{i−1}, θ^{i−1}, x_i, θ^i, x_{i+1} with frames
//! (3, 1, 3, 1, 3), x_{i−1}, x_i, x_{i+1} without. Only lower triangles (row ≥ column) of Hessians are filled.
//!
//! Derivatives are taken in the time-parallel gauge: as the vertices move, the director of an edge is carried along by
//! parallel transport from where it is now (Bergou et al. 2010).

use crate::geometry::{Edge, M3, Turn, V3, cross_matrix, outer, symmetric_product};

/// Energy, gradient and lower triangle of the Hessian of an element with N degrees of freedom.
pub(crate) struct Element<const N: usize> {
    pub(crate) energy: f64,
    pub(crate) gradient: [f64; N],
    pub(crate) hessian: [[f64; N]; N],
}

/// Stretch of an edge, E = ½ EA (l − l̄)²/l̄: energy, force s = ∂E/∂l and the 3 × 3 Hessian with respect to e = x_{i+1} − x_i,
///
/// ```text
/// ∂²E/∂e² = EA/l̄ t tᵀ + s/l (I − t tᵀ)
/// ```
pub(crate) fn stretch(edge: &Edge, rest: f64, ea: f64) -> (f64, f64, M3) {
    let k = ea / rest;
    let d = edge.l - rest;
    let s = k * d;
    let hessian = outer(edge.t, edge.t) * (k - s / edge.l) + M3::from_diagonal(V3::splat(s / edge.l));
    (0.5 * k * d * d, s, hessian)
}

/// Bending of an isotropic, naturally straight vertex without frames,
///
/// ```text
/// E = ½ k |κb|² = 2k (1 − c)/(1 + c),   c = p·q,   k = EI/l̄_i
/// ```
///
/// a function of c alone: ∂E/∂c = −4k/χ², ∂²E/∂c² = 8k/χ³.
pub(crate) fn isotropic_bend(a: &Edge, b: &Edge, turn: &Turn, k: f64) -> Element<9> {
    let (p, q, chi) = (a.t, b.t, turn.chi);
    let diff = q - p;
    let one_minus_c = 0.5 * diff.length_squared();
    let c = 1.0 - one_minus_c;
    let d1 = -4.0 * k / (chi * chi);
    let d2 = -2.0 * d1 / chi;
    // ∂c/∂e = (q − c p)/|e| with q − c p = (q − p) + (1 − c) p, exact for nearly parallel edges.
    let ce = (diff + p * one_minus_c) / a.l;
    let cf = (q * one_minus_c - diff) / b.l;
    let (le2, lf2, lef) = (a.l * a.l, b.l * b.l, a.l * b.l);
    let i3 = M3::IDENTITY;
    let (pp, qq) = (outer(p, p), outer(q, q));
    let ee = outer(ce, ce) * d2 - (symmetric_product(ce, p) / a.l + (i3 - pp) * (c / le2)) * d1;
    let ff = outer(cf, cf) * d2 - (symmetric_product(cf, q) / b.l + (i3 - qq) * (c / lf2)) * d1;
    let ef = outer(ce, cf) * d2 + (i3 - qq - pp + outer(p, q) * c) * (d1 / lef);
    let mut out = Element { energy: 2.0 * k * one_minus_c / chi, gradient: [0.0; 9], hessian: [[0.0; 9]; 9] };
    vertex_gradient(ce * d1, cf * d1, [0, 3, 6], &mut out.gradient);
    vertex_hessian(ee, ef, ff, [0, 3, 6], &mut out.hessian);
    out
}

/// Material directors of the two edges at a vertex.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Directors {
    pub(crate) m1e: V3,
    pub(crate) m2e: V3,
    pub(crate) m1f: V3,
    pub(crate) m2f: V3,
}

/// Strains of a vertex with frames, κ₁, κ₂, τ, and their gradients in the local order.
///
/// ```text
/// κ₁ = ½ (m₂^{i−1} + m₂^i)·κb,   κ₂ = −½ (m₁^{i−1} + m₁^i)·κb
/// ∂(½ w·κb)/∂e^{i−1} = ( q × w/χ − ½ (w·κb) t̃ ) / l^{i−1},   ∂(½ w·κb)/∂e^i = ( w × p/χ − ½ (w·κb) t̃ ) / l^i
/// ∂τ/∂e^{i−1} = ½ κb/l^{i−1},   ∂τ/∂e^i = ½ κb/l^i
/// ```
pub(crate) struct Strains {
    pub(crate) value: [f64; 3],
    pub(crate) gradient: [[f64; 11]; 3],
    /// ½ w·κb and its gradients in e^{i−1} and e^i, for w = m₁^{i−1}, m₂^{i−1}, m₁^i, m₂^i.
    parts: [(f64, V3, V3); 4],
}

/// Where x_{i−1}, x_i, x_{i+1} begin in the local order with frames; θ^{i−1} is 3, θ^i is 7.
const X: [usize; 3] = [0, 4, 8];

impl Strains {
    pub(crate) fn of(a: &Edge, b: &Edge, turn: &Turn, m: &Directors, tau: f64) -> Strains {
        let part = |w: V3| {
            let h = 0.5 * w.dot(turn.kb);
            let back = turn.tilde * h;
            (h, (b.t.cross(w) / turn.chi - back) / a.l, (w.cross(a.t) / turn.chi - back) / b.l)
        };
        let parts = [part(m.m1e), part(m.m2e), part(m.m1f), part(m.m2f)];
        let [p1e, p2e, p1f, p2f] = &parts;
        let mut gradient = [[0.0; 11]; 3];
        vertex_gradient(p2e.1 + p2f.1, p2e.2 + p2f.2, X, &mut gradient[0]);
        vertex_gradient(-(p1e.1 + p1f.1), -(p1e.2 + p1f.2), X, &mut gradient[1]);
        let half = turn.kb * 0.5;
        vertex_gradient(half / a.l, half / b.l, X, &mut gradient[2]);
        (gradient[0][3], gradient[0][7]) = (-p1e.0, -p1f.0);
        (gradient[1][3], gradient[1][7]) = (-p2e.0, -p2f.0);
        (gradient[2][3], gradient[2][7]) = (-1.0, 1.0);
        Strains { value: [p2e.0 + p2f.0, -(p1e.0 + p1f.0), tau], gradient, parts }
    }
}

impl Strains {
    /// Σ_a s_a ∂²ε_a/∂θ² for θ^{i−1} and θ^i; the mixed one is zero.
    fn angle_curvature(&self, s: &[f64; 3]) -> [f64; 2] {
        let [p1e, p2e, p1f, p2f] = &self.parts;
        [s[1] * p1e.0 - s[0] * p2e.0, s[1] * p1f.0 - s[0] * p2f.0]
    }

    /// ∂²E/∂θ² of the vertex: (θ^{i−1} θ^{i−1}, θ^{i−1} θ^i, θ^i θ^i).
    pub(crate) fn angle_hessian(&self, k: &Stiffness) -> [f64; 3] {
        let second = self.angle_curvature(&k.stress(&self.value));
        let column = |j: usize| [self.gradient[0][j], self.gradient[1][j], self.gradient[2][j]];
        let product =
            |i: usize, j: usize| k.times(&column(j)).iter().zip(column(i)).map(|(a, b)| a * b).sum::<f64>();
        [product(3, 3) + second[0], product(3, 7), product(7, 7) + second[1]]
    }
}

/// Stiffness and rest strains of a vertex with frames: E = ½ (κ−κ̄)ᵀ K (κ−κ̄) + ½ K_τ (τ−τ̄)², K = EI/l̄_i, K_τ = GJ/l̄_i.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stiffness {
    pub(crate) bend: [f64; 3],
    pub(crate) twist: f64,
    pub(crate) rest: [f64; 3],
}

impl Stiffness {
    /// K (ε − ε̄) for all three strains.
    pub(crate) fn stress(&self, strain: &[f64; 3]) -> [f64; 3] {
        let d = [strain[0] - self.rest[0], strain[1] - self.rest[1], strain[2] - self.rest[2]];
        self.times(&d)
    }

    /// K d.
    pub(crate) fn times(&self, d: &[f64; 3]) -> [f64; 3] {
        let [k11, k12, k22] = self.bend;
        [k11 * d[0] + k12 * d[1], k12 * d[0] + k22 * d[1], self.twist * d[2]]
    }
}

/// Bend and twist energies of a vertex with frames: (E_κ, E_τ).
pub(crate) fn energies(strains: &Strains, k: &Stiffness) -> (f64, f64) {
    let s = k.stress(&strains.value);
    let d = |i: usize| strains.value[i] - k.rest[i];
    (0.5 * (s[0] * d(0) + s[1] * d(1)), 0.5 * s[2] * d(2))
}

/// Bend and twist of a vertex with frames: energy, gradient and Hessian
///
/// ```text
/// H = Σ_ab K_ab ∇ε_a ∇ε_bᵀ + Σ_a s_a ∇²ε_a,   s = K (ε − ε̄)
/// ```
///
/// The second derivatives of κ_w = ½ w·κb follow from κ_w = N/D with N = w·(e × f), D = |e||f| + e·f for fixed w; the
/// second-order part of the transport of w adds (κb wᵀ + w κbᵀ)/(4 l²). Those of τ are the symmetric part of ∂(½κb/l)
/// (the other part is the holonomy of the gauge; Bergou et al. 2010).
pub(crate) fn bend_twist(
    a: &Edge,
    b: &Edge,
    turn: &Turn,
    m: &Directors,
    strains: &Strains,
    k: &Stiffness,
) -> Element<11> {
    let s = k.stress(&strains.value);
    let (bend, twist) = energies(strains, k);
    let mut out = Element { energy: bend + twist, gradient: [0.0; 11], hessian: [[0.0; 11]; 11] };
    let [g1, g2, g3] = &strains.gradient;
    let [k11, k12, k22] = k.bend;
    for i in 0..11 {
        out.gradient[i] = s[0] * g1[i] + s[1] * g2[i] + s[2] * g3[i];
        let (c1, c2, c3) = (k11 * g1[i] + k12 * g2[i], k12 * g1[i] + k22 * g2[i], k.twist * g3[i]);
        for j in 0..=i {
            out.hessian[i][j] = c1 * g1[j] + c2 * g2[j] + c3 * g3[j];
        }
    }

    let (p, q, chi, kb, tilde) = (a.t, b.t, turn.chi, turn.kb, turn.tilde);
    let (le, lf) = (a.l, b.l);
    let [p1e, p2e, p1f, p2f] = &strains.parts;
    let (s1, s2, s3) = (s[0], s[1], s[2]);
    // w = s₁ m₂ − s₂ m₁ on either edge, κ_s = ½ (w_e + w_f)·κb = s₁ κ₁ + s₂ κ₂ and its gradient.
    let (we, wf) = (m.m2e * s1 - m.m1e * s2, m.m2f * s1 - m.m1f * s2);
    let ks = s1 * strains.value[0] + s2 * strains.value[1];
    let ks_e = (p2e.1 + p2f.1) * s1 - (p1e.1 + p1f.1) * s2;
    let ks_f = (p2e.2 + p2f.2) * s1 - (p1e.2 + p1f.2) * s2;
    let i3 = M3::IDENTITY;
    let ee = (symmetric_product(ks_e, tilde) / -le) - (i3 - outer(p, p)) * (ks / (chi * le * le))
        + symmetric_product(kb, we - (tilde + p) * s3) / (4.0 * le * le);
    let ff = (symmetric_product(ks_f, tilde) / -lf) - (i3 - outer(q, q)) * (ks / (chi * lf * lf))
        + symmetric_product(kb, wf - (tilde + q) * s3) / (4.0 * lf * lf);
    let ef = cross_matrix(p * s3 - (we + wf)) / (le * lf * chi)
        - outer(ks_e, tilde) / lf
        - outer(tilde, ks_f) / le
        - (i3 + outer(p, q)) * (ks / (chi * le * lf))
        - outer(kb, tilde) * (s3 / (2.0 * le * lf));
    vertex_hessian(ee, ef, ff, X, &mut out.hessian);
    // ∂κ₁/∂θ = −½ m₁·κb, ∂κ₂/∂θ = −½ m₂·κb; once more: −½ m₂·κb and ½ m₁·κb.
    let mixed = |m1: &(f64, V3, V3), m2: &(f64, V3, V3)| (m1.1 * -s1 - m2.1 * s2, m1.2 * -s1 - m2.2 * s2);
    let second = strains.angle_curvature(&s);
    for (row, (e, f), second) in [(3, mixed(p1e, p2e), second[0]), (7, mixed(p1f, p2f), second[1])] {
        let mut g = [0.0; 11];
        vertex_gradient(e, f, X, &mut g);
        for j in 0..11 {
            if j != 3 && j != 7 {
                out.hessian[row.max(j)][row.min(j)] += g[j];
            }
        }
        out.hessian[row][row] += second;
    }
    out
}

/// From derivatives in the edges e = x_i − x_{i−1}, f = x_{i+1} − x_i to those in the vertices, overwriting.
fn vertex_gradient<const N: usize>(e: V3, f: V3, at: [usize; 3], gradient: &mut [f64; N]) {
    for c in 0..3 {
        gradient[at[0] + c] = -e[c];
        gradient[at[1] + c] = e[c] - f[c];
        gradient[at[2] + c] = f[c];
    }
}

/// The same for second derivatives (ee and ff symmetric, ef = ∂²/∂e∂f), adding to the lower triangle.
fn vertex_hessian<const N: usize>(ee: M3, ef: M3, ff: M3, at: [usize; 3], hessian: &mut [[f64; N]; N]) {
    let [ee, ef, ff] = [ee, ef, ff].map(|m| m.transpose().to_cols_array_2d());
    for i in 0..3 {
        for j in 0..3 {
            if j <= i {
                hessian[at[0] + i][at[0] + j] += ee[i][j];
                hessian[at[1] + i][at[1] + j] += ee[i][j] - ef[i][j] - ef[j][i] + ff[i][j];
                hessian[at[2] + i][at[2] + j] += ff[i][j];
            }
            hessian[at[1] + i][at[0] + j] += ef[j][i] - ee[i][j];
            hessian[at[2] + i][at[0] + j] -= ef[j][i];
            hessian[at[2] + i][at[1] + j] += ef[j][i] - ff[i][j];
        }
    }
}
