//! Energy, gradient and Hessian of one stretched edge and one bent (and twisted) vertex, in small fixed
//! arrays.
//!
//! Local degrees of freedom are in the order of the whole rod: x_{i−1}, θ^{i−1}, x_i, θ^i, x_{i+1} with
//! frames (3, 1, 3, 1, 3), x_{i−1}, x_i, x_{i+1} without. Only lower triangles (row ≥ column) of Hessians
//! are filled.
//!
//! Derivatives are taken in the time-parallel gauge: as the vertices move, the director of an edge is carried
//! along by parallel transport from where it is now (Bergou et al. 2010).

use nalgebra::{Matrix3, Vector3};

use crate::geometry::{Edge, Turn, outer, symmetric_product};
use crate::scalar::{Real, square};

/// Degrees of freedom at a bent vertex with frames: three places and two angles.
pub(crate) const LOCAL: usize = 11;
/// Numbers for an edge and the vertex it starts at: the gradient of its length, and those of the three
/// strains there.
pub(crate) const STRAINS: usize = 3 + 3 * LOCAL;

/// Energy, gradient and lower triangle of the Hessian of an element with N degrees of freedom.
pub(crate) struct Element<T, const N: usize> {
    pub(crate) energy: T,
    pub(crate) gradient: [T; N],
    pub(crate) hessian: [[T; N]; N],
}

/// Stretch of an edge, E = ½ EA (l − l̄)²/l̄: energy, force s = ∂E/∂l and the 3 × 3 Hessian with
/// respect to e = x_{i+1} − x_i,
///
/// ```text
/// ∂²E/∂e² = EA/l̄ t tᵀ + s/l (I − t tᵀ)
/// ```
pub(crate) fn stretch<T: Real>(edge: &Edge<T>, rest: T, ea: T) -> (T, T, Matrix3<T>) {
    let k = ea / rest;
    let d = edge.l - rest;
    let s = k * d;
    let across = s / edge.l;
    let hessian = outer(&edge.t, &edge.t) * (k - across) + Matrix3::from_diagonal_element(across);
    (T::of(0.5) * k * d * d, s, hessian)
}

/// The Hessian of an edge with respect to both its vertices, `second` the place of the second one; an angle
/// between is zero.
pub(crate) fn edge_hessian<const N: usize>(h: &Matrix3<f64>, second: usize) -> [[f64; N]; N] {
    let mut out = [[0.0; N]; N];
    add_edge_hessian(&mut out, [0, second], h);
    out
}

/// Adds that Hessian to an element in which the vertices of the edge have the places `first` and `second`.
pub(crate) fn add_edge_hessian<const N: usize>(
    out: &mut [[f64; N]; N],
    [first, second]: [usize; 2],
    h: &Matrix3<f64>,
) {
    for i in 0..3 {
        for j in 0..3 {
            out[first + i][first + j] += h[(i, j)];
            out[second + i][second + j] += h[(i, j)];
            out[second + i][first + j] -= h[(i, j)];
        }
    }
}

/// Bending of an isotropic, naturally straight vertex without frames,
///
/// ```text
/// E = ½ k |κb|² = 2k (1 − c)/(1 + c),   c = p·q,   k = EI/l̄_i
/// ```
///
/// a function of c alone: ∂E/∂c = −4k/χ², ∂²E/∂c² = 8k/χ³.
pub(crate) fn isotropic_bend<T: Real>(a: &Edge<T>, b: &Edge<T>, turn: &Turn<T>, k: T) -> Element<T, 9> {
    let (p, q, chi) = (&a.t, &b.t, turn.chi);
    let diff = q - p;
    let one_minus_c = T::of(0.5) * square(&diff);
    let c = T::one() - one_minus_c;
    let d1 = T::of(-4.0) * k / (chi * chi);
    let d2 = T::of(-2.0) * d1 / chi;
    // ∂c/∂e = (q − c p)/|e| with q − c p = (q − p) + (1 − c) p, exact for nearly parallel edges.
    let ce = (diff + p * one_minus_c) / a.l;
    let cf = (q * one_minus_c - diff) / b.l;
    let (le2, lf2, lef) = (a.l * a.l, b.l * b.l, a.l * b.l);
    let i3 = Matrix3::identity();
    let (pp, qq) = (outer(p, p), outer(q, q));
    let ee = outer(&ce, &ce) * d2 - (symmetric_product(&ce, p) / a.l + (i3 - pp) * (c / le2)) * d1;
    let ff = outer(&cf, &cf) * d2 - (symmetric_product(&cf, q) / b.l + (i3 - qq) * (c / lf2)) * d1;
    let ef = outer(&ce, &cf) * d2 + (i3 - qq - pp + outer(p, q) * c) * (d1 / lef);
    let zero = T::zero();
    let mut out =
        Element { energy: isotropic_energy(a, b, turn, k), gradient: [zero; 9], hessian: [[zero; 9]; 9] };
    vertex_gradient(&(ce * d1), &(cf * d1), [0, 3, 6], &mut out.gradient);
    vertex_hessian(&ee, &ef, &ff, [0, 3, 6], &mut out.hessian);
    out
}

/// The energy alone of [`isotropic_bend`].
pub(crate) fn isotropic_energy<T: Real>(a: &Edge<T>, b: &Edge<T>, turn: &Turn<T>, k: T) -> T {
    // 1 − c, exact for nearly parallel edges
    let one_minus_c = T::of(0.5) * square(&(b.t - a.t));
    T::of(2.0) * k * one_minus_c / turn.chi
}

/// Material directors of the two edges at a vertex.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Directors<T = f64> {
    pub(crate) m1e: Vector3<T>,
    pub(crate) m2e: Vector3<T>,
    pub(crate) m1f: Vector3<T>,
    pub(crate) m2f: Vector3<T>,
}

/// Strains of a vertex with frames, κ₁, κ₂, τ, and their gradients in the local order.
///
/// ```text
/// κ₁ = ½ (m₂^{i−1} + m₂^i)·κb,   κ₂ = −½ (m₁^{i−1} + m₁^i)·κb
/// ∂(½ w·κb)/∂e^{i−1} = ( q × w/χ − ½ (w·κb) t̃ ) / l^{i−1}
/// ∂(½ w·κb)/∂e^i     = ( w × p/χ − ½ (w·κb) t̃ ) / l^i
/// ∂τ/∂e^{i−1} = ½ κb/l^{i−1},   ∂τ/∂e^i = ½ κb/l^i
/// ```
pub(crate) struct Strains<T = f64> {
    pub(crate) value: [T; 3],
    pub(crate) gradient: [[T; 11]; 3],
    /// For w = m₁^{i−1}, m₂^{i−1}, m₁^i, m₂^i.
    parts: [Part<T>; 4],
}

/// ½ w·κb and its gradients in e^{i−1} and e^i.
type Part<T> = (T, Vector3<T>, Vector3<T>);

/// Where x_{i−1}, x_i, x_{i+1} begin in the local order with frames; θ^{i−1} is 3, θ^i is 7.
const X: [usize; 3] = [0, 4, 8];

impl Strains {
    /// What the strains change by along q, in the local order.
    pub(crate) fn along(&self, q: &[f64; LOCAL]) -> [f64; 3] {
        let mut changes = [0.0; 3];
        // the three sums side by side: one after the other each waits for its last addition
        for (i, q) in q.iter().enumerate() {
            changes.iter_mut().zip(&self.gradient).for_each(|(change, gradient)| *change += gradient[i] * q);
        }
        changes
    }
}

impl<T: Real> Strains<T> {
    pub(crate) fn of(a: &Edge<T>, b: &Edge<T>, turn: &Turn<T>, m: &Directors<T>, tau: T) -> Strains<T> {
        let half = T::of(0.5);
        let part = |w: &Vector3<T>| {
            let h = half * w.dot(&turn.kb);
            let back = turn.tilde * h;
            (h, (b.t.cross(w) / turn.chi - back) / a.l, (w.cross(&a.t) / turn.chi - back) / b.l)
        };
        let parts = [part(&m.m1e), part(&m.m2e), part(&m.m1f), part(&m.m2f)];
        let [p1e, p2e, p1f, p2f] = &parts;
        let mut gradient = [[T::zero(); 11]; 3];
        vertex_gradient(&(p2e.1 + p2f.1), &(p2e.2 + p2f.2), X, &mut gradient[0]);
        vertex_gradient(&-(p1e.1 + p1f.1), &-(p1e.2 + p1f.2), X, &mut gradient[1]);
        let kb = turn.kb * half;
        vertex_gradient(&(kb / a.l), &(kb / b.l), X, &mut gradient[2]);
        (gradient[0][3], gradient[0][7]) = (-p1e.0, -p1f.0);
        (gradient[1][3], gradient[1][7]) = (-p2e.0, -p2f.0);
        (gradient[2][3], gradient[2][7]) = (-T::one(), T::one());
        Strains { value: [p2e.0 + p2f.0, -(p1e.0 + p1f.0), tau], gradient, parts }
    }

    /// Σ_a s_a ∂²ε_a/∂θ² for θ^{i−1} and θ^i; the mixed one is zero.
    fn angle_curvature(&self, s: &[T; 3]) -> [T; 2] {
        let [p1e, p2e, p1f, p2f] = &self.parts;
        [s[1] * p1e.0 - s[0] * p2e.0, s[1] * p1f.0 - s[0] * p2f.0]
    }

    /// ∂²E/∂θ² of the vertex: (θ^{i−1} θ^{i−1}, θ^{i−1} θ^i, θ^i θ^i).
    pub(crate) fn angle_hessian(&self, k: &Stiffness<T>) -> [T; 3] {
        let second = self.angle_curvature(&k.stress(&self.value));
        let column = |j: usize| [self.gradient[0][j], self.gradient[1][j], self.gradient[2][j]];
        let product = |i: usize, j: usize| {
            let terms = k.times(&column(j)).into_iter().zip(column(i));
            terms.fold(T::zero(), |sum, (a, b)| sum + a * b)
        };
        [product(3, 3) + second[0], product(3, 7), product(7, 7) + second[1]]
    }
}

/// Stiffness and rest strains of a vertex with frames: E = ½ (κ−κ̄)ᵀ K (κ−κ̄) + ½ K_τ
/// (τ−τ̄)², K = EI/l̄_i, K_τ = GJ/l̄_i.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stiffness<T = f64> {
    pub(crate) bend: [T; 3],
    pub(crate) twist: T,
    pub(crate) rest: [T; 3],
}

impl<T: Real> Stiffness<T> {
    /// K (ε − ε̄) for all three strains.
    pub(crate) fn stress(&self, strain: &[T; 3]) -> [T; 3] {
        let d = [strain[0] - self.rest[0], strain[1] - self.rest[1], strain[2] - self.rest[2]];
        self.times(&d)
    }

    /// K d.
    pub(crate) fn times(&self, d: &[T; 3]) -> [T; 3] {
        let [k11, k12, k22] = self.bend;
        [k11 * d[0] + k12 * d[1], k12 * d[0] + k22 * d[1], self.twist * d[2]]
    }
}

/// Bend and twist energies of a vertex with frames: (E_κ, E_τ).
pub(crate) fn energies<T: Real>(strains: &Strains<T>, k: &Stiffness<T>) -> (T, T) {
    let s = k.stress(&strains.value);
    let d = |i: usize| strains.value[i] - k.rest[i];
    let half = T::of(0.5);
    (half * (s[0] * d(0) + s[1] * d(1)), half * s[2] * d(2))
}

/// Bend and twist of a vertex with frames: energy, gradient and Hessian
///
/// ```text
/// H = Σ_ab K_ab ∇ε_a ∇ε_bᵀ + Σ_a s_a ∇²ε_a,   s = K (ε − ε̄)
/// ```
///
/// The second derivatives of κ_w = ½ w·κb follow from κ_w = N/D with N = w·(e × f), D = |e||f| + e·f
/// for fixed w; the second-order part of the transport of w adds (κb wᵀ + w κbᵀ)/(4 l²). Those of τ
/// are the symmetric part of ∂(½κb/l) (the other part is the holonomy of the gauge; Bergou et al. 2010).
pub(crate) fn bend_twist<T: Real>(
    a: &Edge<T>,
    b: &Edge<T>,
    turn: &Turn<T>,
    m: &Directors<T>,
    strains: &Strains<T>,
    k: &Stiffness<T>,
) -> Element<T, 11> {
    let zero = T::zero();
    let s = k.stress(&strains.value);
    let (bend, twist) = energies(strains, k);
    let mut out = Element { energy: bend + twist, gradient: [zero; 11], hessian: [[zero; 11]; 11] };
    let [g1, g2, g3] = &strains.gradient;
    let [k11, k12, k22] = k.bend;
    for i in 0..11 {
        out.gradient[i] = s[0] * g1[i] + s[1] * g2[i] + s[2] * g3[i];
        let (c1, c2, c3) = (k11 * g1[i] + k12 * g2[i], k12 * g1[i] + k22 * g2[i], k.twist * g3[i]);
        for j in 0..=i {
            out.hessian[i][j] = c1 * g1[j] + c2 * g2[j] + c3 * g3[j];
        }
    }

    strain_hessian_add(a, b, turn, m, strains, &s, &mut out.hessian);
    out
}

/// Adds Σ_a s_a ∂²ε_a, the second derivatives of the strains of a vertex with frames, to a lower
/// triangle.
pub(crate) fn strain_hessian_add<T: Real>(
    a: &Edge<T>,
    b: &Edge<T>,
    turn: &Turn<T>,
    m: &Directors<T>,
    strains: &Strains<T>,
    s: &[T; 3],
    hessian: &mut [[T; 11]; 11],
) {
    let zero = T::zero();
    let (p, q, chi, kb, tilde) = (&a.t, &b.t, turn.chi, &turn.kb, &turn.tilde);
    let (le, lf) = (a.l, b.l);
    let [p1e, p2e, p1f, p2f] = &strains.parts;
    let (s1, s2, s3) = (s[0], s[1], s[2]);
    // w = s₁ m₂ − s₂ m₁ on either edge, κ_s = ½ (w_e + w_f)·κb = s₁ κ₁ + s₂ κ₂ and
    // its gradient.
    let (we, wf) = (m.m2e * s1 - m.m1e * s2, m.m2f * s1 - m.m1f * s2);
    let ks = s1 * strains.value[0] + s2 * strains.value[1];
    let ks_e = (p2e.1 + p2f.1) * s1 - (p1e.1 + p1f.1) * s2;
    let ks_f = (p2e.2 + p2f.2) * s1 - (p1e.2 + p1f.2) * s2;
    let (i3, four, two) = (Matrix3::identity(), T::of(4.0), T::of(2.0));
    let ee = (symmetric_product(&ks_e, tilde) / -le) - (i3 - outer(p, p)) * (ks / (chi * le * le))
        + symmetric_product(kb, &(we - (tilde + p) * s3)) / (four * le * le);
    let ff = (symmetric_product(&ks_f, tilde) / -lf) - (i3 - outer(q, q)) * (ks / (chi * lf * lf))
        + symmetric_product(kb, &(wf - (tilde + q) * s3)) / (four * lf * lf);
    let ef = (p * s3 - (we + wf)).cross_matrix() / (le * lf * chi)
        - outer(&ks_e, tilde) / lf
        - outer(tilde, &ks_f) / le
        - (i3 + outer(p, q)) * (ks / (chi * le * lf))
        - outer(kb, tilde) * (s3 / (two * le * lf));
    vertex_hessian(&ee, &ef, &ff, X, hessian);
    // ∂κ₁/∂θ = −½ m₁·κb, ∂κ₂/∂θ = −½ m₂·κb; once more: −½ m₂·κb and ½
    // m₁·κb.
    let mixed = |m1: &Part<T>, m2: &Part<T>| (m1.1 * -s1 - m2.1 * s2, m1.2 * -s1 - m2.2 * s2);
    let second = strains.angle_curvature(s);
    for (row, (e, f), second) in [(3, mixed(p1e, p2e), second[0]), (7, mixed(p1f, p2f), second[1])] {
        let mut g = [zero; 11];
        vertex_gradient(&e, &f, X, &mut g);
        for j in 0..11 {
            if j != 3 && j != 7 {
                hessian[row.max(j)][row.min(j)] += g[j];
            }
        }
        hessian[row][row] += second;
    }
}

/// From derivatives in the edges e = x_i − x_{i−1}, f = x_{i+1} − x_i to those in the vertices,
/// overwriting.
#[inline(always)]
fn vertex_gradient<T: Real, const N: usize>(
    e: &Vector3<T>,
    f: &Vector3<T>,
    at: [usize; 3],
    gradient: &mut [T; N],
) {
    for c in 0..3 {
        gradient[at[0] + c] = -e[c];
        gradient[at[1] + c] = e[c] - f[c];
        gradient[at[2] + c] = f[c];
    }
}

/// The same for second derivatives (ee and ff symmetric, ef = ∂²/∂e∂f), adding to the lower triangle.
#[inline(always)]
fn vertex_hessian<T: Real, const N: usize>(
    ee: &Matrix3<T>,
    ef: &Matrix3<T>,
    ff: &Matrix3<T>,
    at: [usize; 3],
    hessian: &mut [[T; N]; N],
) {
    for i in 0..3 {
        for j in 0..3 {
            let (x, y) = ((i, j), (j, i));
            if j <= i {
                hessian[at[0] + i][at[0] + j] += ee[x];
                hessian[at[1] + i][at[1] + j] += ee[x] - ef[x] - ef[y] + ff[x];
                hessian[at[2] + i][at[2] + j] += ff[x];
            }
            hessian[at[1] + i][at[0] + j] += ef[y] - ee[x];
            hessian[at[2] + i][at[0] + j] -= ef[y];
            hessian[at[2] + i][at[1] + j] += ef[y] - ff[x];
        }
    }
}
