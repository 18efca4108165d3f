//! What rods held at both ends are compared with: the elastic catenary, the elastica, Kirchhoff's equations.

use std::f64::consts::PI;
use varda_rod::{Rest, Rod, Vector3};

type V = Vector3<f64>;

/// The elastic cable without bending from the origin to (span, rise): pull H and lift V at its start.
pub struct Catenary {
    /// Weight per length \[N/m\].
    pub weight: f64,
    /// EA \[N\].
    pub ea: f64,
    /// H \[N\].
    pub pull: f64,
    /// V \[N\].
    pub lift: f64,
}

impl Catenary {
    /// Along its span and upwards.
    pub fn at(&self, s: f64) -> [f64; 2] {
        let Catenary { weight: w, ea, pull, lift } = *self;
        let left = lift - w * s;
        let x = pull * s / ea + pull / w * ((lift / pull).asinh() - (left / pull).asinh());
        let z =
            -(s / ea * (lift - 0.5 * w * s) + pull / w * (1f64.hypot(lift / pull) - 1f64.hypot(left / pull)));
        [x, z]
    }

    /// Its direction there.
    pub fn tangent(&self, s: f64) -> [f64; 2] {
        let left = self.lift - self.weight * s;
        let tension = self.pull.hypot(left);
        [self.pull / tension, -left / tension]
    }

    /// Newton's method in (ln H, V), differences for derivatives, halved steps.
    pub fn between(length: f64, [span, rise]: [f64; 2], weight: f64, ea: f64) -> Option<Catenary> {
        let of = |p: [f64; 2]| Catenary { weight, ea, pull: p[0].exp(), lift: p[1] };
        let miss = |p: [f64; 2]| {
            let [x, z] = of(p).at(length);
            [x - span, z - rise]
        };
        let size = |m: [f64; 2]| m[0].hypot(m[1]);
        // a cable longer than its chord hangs by its weight, a shorter one by its stiffness
        let taut = ea * (span.hypot(rise) / length - 1.0);
        let mut p = [taut.max(0.3 * span * weight).ln(), 0.5 * weight * length];
        for _ in 0..200 {
            let m = miss(p);
            if size(m) <= 1e-13 {
                return Some(of(p));
            }
            let d = 1e-6;
            let [a, b] = [0, 1].map(|i| {
                let [mut up, mut down] = [p; 2];
                up[i] += d;
                down[i] -= d;
                let (up, down) = (miss(up), miss(down));
                [(up[0] - down[0]) / (2.0 * d), (up[1] - down[1]) / (2.0 * d)]
            });
            let det = a[0] * b[1] - b[0] * a[1];
            let step = [(b[1] * m[0] - b[0] * m[1]) / det, (a[0] * m[1] - a[1] * m[0]) / det];
            let along = |t: f64| [p[0] - t * step[0], p[1] - t * step[1]];
            let t = (0..40).map(|i| 0.5f64.powi(i)).find(|t| size(miss(along(*t))) < size(m));
            let Some(t) = t else { return (size(m) <= 1e-11).then(|| of(p)) };
            p = along(t);
        }
        None
    }
}

/// The parameter m of the elastica with 2E/K − 1 = D/L, between clamps in line as between pins.
pub fn elastica_parameter(share: f64) -> f64 {
    let (mut low, mut high) = (0.0, 0.999);
    for _ in 0..60 {
        let m = 0.5 * (low + high);
        let (k, e) = elliptic(m);
        if 2.0 * e / k - 1.0 > share { low = m } else { high = m }
    }
    low
}

/// Its height √m L/K.
pub fn elastica_height(length: f64, share: f64) -> f64 {
    let m = elastica_parameter(share);
    m.sqrt() * length / elliptic(m).0
}

/// The elastica at arc lengths: along its chord and beside it, and its thrust. θ'' = −k² sin θ with
/// k = 4K/L from θ = 0 between clamps, k = 2K/L from the largest θ between pins.
pub fn elastica(length: f64, share: f64, ei: f64, clamped: bool, arc: &[f64]) -> (Vec<[f64; 2]>, f64) {
    let m = elastica_parameter(share);
    let rate = if clamped { 4.0 } else { 2.0 } * elliptic(m).0 / length;
    let start = if clamped { [0.0, 2.0 * m.sqrt() * rate] } else { [2.0 * m.sqrt().asin(), 0.0] };
    let slope = |y: [f64; 4]| [y[1], -rate * rate * y[0].sin(), y[0].cos(), y[0].sin()];
    let mut y = [start[0], start[1], 0.0, 0.0];
    let mut places = vec![[0.0; 2]];
    for pair in arc.windows(2) {
        for _ in 0..STEPS {
            y = runge_kutta(y, (pair[1] - pair[0]) / STEPS as f64, slope);
        }
        places.push([y[2], y[3]]);
    }
    (places, ei * rate * rate)
}

/// Steps of an integration over a segment.
const STEPS: usize = 20;

fn runge_kutta<const N: usize>(y: [f64; N], h: f64, slope: impl Fn([f64; N]) -> [f64; N]) -> [f64; N] {
    let along = |k: &[f64; N], h: f64| std::array::from_fn(|i| y[i] + h * k[i]);
    let a = slope(y);
    let b = slope(along(&a, 0.5 * h));
    let c = slope(along(&b, 0.5 * h));
    let d = slope(along(&c, h));
    std::array::from_fn(|i| y[i] + h / 6.0 * (a[i] + 2.0 * b[i] + 2.0 * c[i] + d[i]))
}

/// Complete elliptic integrals K and E of the parameter m, by the arithmetic-geometric mean.
fn elliptic(m: f64) -> (f64, f64) {
    let (mut a, mut b, mut sum, mut power) = (1.0f64, (1.0 - m).sqrt(), 0.5 * m, 0.5);
    for _ in 0..12 {
        let c = 0.5 * (a - b);
        (a, b) = (0.5 * (a + b), (a * b).sqrt());
        power *= 2.0;
        sum += power * c * c;
    }
    let k = PI / (2.0 * a);
    (k, k * (1.0 - sum))
}

/// Place, tangent and director of an end.
#[derive(Debug, Clone, Copy)]
pub struct Section {
    /// Its place \[m\].
    pub place: V,
    /// Its tangent.
    pub tangent: V,
    /// Its director m₁.
    pub director: V,
}

/// An isotropic, naturally straight rod between two clamps (Kirchhoff), weight per length w downwards.
pub struct Kirchhoff {
    /// EI \[N m²\], in both directions.
    pub ei: f64,
    /// GJ \[N m²\].
    pub gj: f64,
    /// EA \[N\].
    pub ea: f64,
    /// Weight per length \[N/m\].
    pub weight: f64,
    /// Both ends.
    pub ends: [Section; 2],
}

impl Kirchhoff {
    /// In n segments, clamped at its faces; of some mass where it has no weight.
    ///
    /// # Errors
    /// What varda-rod finds impossible.
    pub fn discrete(&self, length: f64, n: usize) -> Result<Rod, varda_rod::Error> {
        let mass_per_length = if self.weight > 0.0 { self.weight / 9.81 } else { 0.1 };
        let Kirchhoff { ei, gj, ea, .. } = *self;
        let section = varda_rod::Section { ea, ei1: ei, ei2: ei, gj, mass_per_length };
        Rod::uniform_between(length, n, &section, [true; 2])
    }

    /// Places at the arc lengths, from a first section and what the support exerts there:
    /// n' = w e_z, m' = −r' × n, t' = u × t, u = m/EI + (1/GJ − 1/EI)(m·t) t.
    fn integrate(&self, reaction: &[f64; 6], arc: &[f64]) -> (Vec<V>, Section) {
        let Section { place, tangent, director } = self.ends[0];
        let mut y = [0.0; 15];
        for c in 0..3 {
            (y[c], y[3 + c], y[6 + c]) = (place[c], tangent[c], director[c]);
            (y[9 + c], y[12 + c]) = (-reaction[c], -reaction[3 + c]);
        }
        let part = |y: &[f64; 15], i: usize| V::new(y[i], y[i + 1], y[i + 2]);
        let slope = |y: [f64; 15]| {
            let [t, d, n, m] = [3, 6, 9, 12].map(|i| part(&y, i));
            let along = t * (1.0 + n.dot(&t) / self.ea);
            let u = m / self.ei + t * (m.dot(&t) * (1.0 / self.gj - 1.0 / self.ei));
            let all = [along, u.cross(&t), u.cross(&d), V::z() * self.weight, -along.cross(&n)];
            std::array::from_fn(|i| all[i / 3][i % 3])
        };
        let mut places = vec![place];
        for pair in arc.windows(2) {
            for _ in 0..STEPS {
                y = runge_kutta(y, (pair[1] - pair[0]) / STEPS as f64, slope);
            }
            places.push(part(&y, 0));
        }
        let [place, tangent, director] = [0, 3, 6].map(|i| part(&y, i));
        (places, Section { place, tangent, director })
    }

    /// By how much the far end is missed: place over length, turn of the section.
    fn miss(&self, reaction: &[f64; 6], arc: &[f64]) -> [f64; 6] {
        let (end, at) = (self.ends[1], self.integrate(reaction, arc).1);
        let off = (at.place - end.place) / arc[arc.len() - 1];
        let axes = |s: &Section| [s.tangent, s.director, s.tangent.cross(&s.director)];
        let turn: V = axes(&end).iter().zip(axes(&at)).map(|(a, b)| a.cross(&b) * 0.5).sum();
        [off.x, off.y, off.z, turn.x, turn.y, turn.z]
    }

    /// The solution near a reaction (force, moment) at the start, by Newton's method with differences:
    /// places, and the reaction.
    pub fn near(&self, reaction: [f64; 6], arc: &[f64]) -> Option<(Vec<V>, [f64; 6])> {
        let length = arc[arc.len() - 1];
        let scale = |i: usize| self.ei / length.powi(if i < 3 { 2 } else { 1 });
        let size = |m: &[f64; 6]| m.iter().map(|v| v * v).sum::<f64>().sqrt();
        let mut p = reaction;
        for _ in 0..60 {
            let m = self.miss(&p, arc);
            if size(&m) <= 1e-9 {
                return Some((self.integrate(&p, arc).0, p));
            }
            let mut matrix = [[0.0; 7]; 6];
            for j in 0..6 {
                let d = 1e-5 * scale(j);
                let [mut up, mut down] = [p; 2];
                up[j] += d;
                down[j] -= d;
                let (up, down) = (self.miss(&up, arc), self.miss(&down, arc));
                for i in 0..6 {
                    matrix[i][j] = (up[i] - down[i]) / (2.0 * d) * scale(j);
                }
            }
            for i in 0..6 {
                matrix[i][6] = m[i];
            }
            let step = solve(matrix)?;
            let along = |t: f64| std::array::from_fn(|i| p[i] - t * step[i] * scale(i));
            let t = (0..30).map(|i| 0.5f64.powi(i)).find(|t| size(&self.miss(&along(*t), arc)) < size(&m))?;
            p = along(t);
        }
        None
    }
}

/// Gauss's elimination with the largest pivots.
fn solve(mut a: [[f64; 7]; 6]) -> Option<[f64; 6]> {
    for i in 0..6 {
        let pivot = (i..6).max_by(|p, q| a[*p][i].abs().total_cmp(&a[*q][i].abs()))?;
        a.swap(i, pivot);
        if !(a[i][i].abs() > 0.0) {
            return None;
        }
        for r in i + 1..6 {
            let factor = a[r][i] / a[i][i];
            for c in i..7 {
                a[r][c] -= factor * a[i][c];
            }
        }
    }
    let mut x = [0.0; 6];
    for i in (0..6).rev() {
        x[i] = (a[i][6] - (i + 1..6).map(|c| a[i][c] * x[c]).sum::<f64>()) / a[i][i];
    }
    Some(x)
}

/// Largest distance of vertices from places.
pub fn farthest(found: &Rest, places: &[V]) -> f64 {
    let off = found.vertices.iter().zip(places).map(|(x, y)| (x - y).norm());
    off.fold(0.0, greatest)
}

/// The larger; NaN stays.
pub fn greatest(a: f64, b: f64) -> f64 {
    if a >= b || a.is_nan() { a } else { b }
}
