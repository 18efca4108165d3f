//! Energy, gradient and Hessian of one configuration with given frames, for users who bring their own time stepping.

use crate::Error;
use crate::element::{self, Stiffness, Strains};
use crate::geometry::{V3, perpendicular};
use crate::rod::Rod;
use crate::shape::Shape;

/// A configuration with its reference frames.
#[derive(Debug, Clone, Copy)]
pub struct Framed<'a> {
    /// x_0 … x_n \[m\].
    pub vertices: &'a [[f64; 3]],
    /// Reference director d₁ of every edge; m₁ = cos θ d₁ + sin θ d₂, d₂ = t × d₁.
    pub directors: &'a [[f64; 3]],
    /// Reference twist of every interior vertex \[rad\]; whole turns count.
    pub reference_twist: &'a [f64],
    /// θ of every edge \[rad\].
    pub theta: &'a [f64],
}

/// Elastic energies \[J\].
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Energy {
    /// E_ε.
    pub stretch: f64,
    /// E_κ.
    pub bend: f64,
    /// E_τ.
    pub twist: f64,
}

impl Energy {
    /// E = E_ε + E_κ + E_τ.
    pub fn total(&self) -> f64 {
        self.stretch + self.bend + self.twist
    }
}

/// Energy with its first and second derivatives. Degrees of freedom in the order x_0, y_0, z_0, x_1, … , z_n, θ^0 … θ^{n−1}.
#[derive(Debug, Clone, PartialEq)]
pub struct Derivatives {
    /// The energies.
    pub energy: Energy,
    /// ∂E/∂(x, θ), 4n + 3 numbers.
    pub gradient: Vec<f64>,
    /// ∂²E/∂(x, θ)², dense, symmetric, (4n + 3)² numbers, column by column.
    pub hessian: Vec<f64>,
}

/// Exact derivatives of the elastic energy; forces and twisting moments are minus its gradient
/// (paper 3.1, 3.2).
///
/// The gauge is the time-parallel one: as the vertices move, the director of an edge is
/// carried from its present tangent by parallel transport, and the reference twist changes continuously (Bergou et al.
/// 2008, 2010).
///
/// # Errors
/// [`Error`] for a fold, an edge without length, a value that is not finite, or arrays of the wrong length.
pub fn derivatives(rod: &Rod, at: &Framed) -> Result<Derivatives, Error> {
    rod.check()?;
    let n = rod.segments();
    let count = |field, found, expected| {
        if found == expected { Ok(()) } else { Err(Error::Count { field, found, expected }) }
    };
    count("vertices", at.vertices.len(), n + 1)?;
    count("directors", at.directors.len(), n)?;
    count("reference_twist", at.reference_twist.len(), n - 1)?;
    count("theta", at.theta.len(), n)?;
    let x: Vec<V3> = at.vertices.iter().map(|v| V3::from(*v)).collect();
    let mut shape = Shape::new(n);
    shape.set_edges(&x, true)?;
    for (e, d) in at.directors.iter().enumerate() {
        shape.d1[e] = perpendicular(V3::from(*d), shape.edges[e].t);
    }
    shape.set_angles(at.theta, Some(at.reference_twist));

    let full = 4 * n + 3;
    let mut out =
        Derivatives { energy: Energy::default(), gradient: vec![0.0; full], hessian: vec![0.0; full * full] };
    for e in 0..n {
        let (energy, force, h) = element::stretch(&shape.edges[e], rod.rest_lengths[e], rod.ea[e]);
        out.energy.stretch += energy;
        for i in 0..3 {
            for (a, sign) in [(3 * e, -1.0), (3 * e + 3, 1.0)] {
                out.gradient[a + i] += sign * force * shape.edges[e].t[i];
                for j in 0..3 {
                    out.hessian[a + i + (3 * e + j) * full] -= sign * h.col(j)[i];
                    out.hessian[a + i + (3 * e + 3 + j) * full] += sign * h.col(j)[i];
                }
            }
        }
    }
    for i in 1..n {
        let over = 1.0 / rod.voronoi_lengths[i - 1];
        let natural = rod.natural_curvature[i - 1];
        let k = Stiffness {
            bend: rod.ei[i - 1].map(|k| k * over),
            twist: rod.gj[i - 1] * over,
            rest: [natural[0], natural[1], rod.natural_twist[i - 1]],
        };
        let (a, b, turn, m) = (&shape.edges[i - 1], &shape.edges[i], shape.turn(i), shape.directors(i));
        let strains = Strains::of(a, b, turn, &m, shape.tau[i]);
        let (bend, twist) = element::energies(&strains, &k);
        out.energy.bend += bend;
        out.energy.twist += twist;
        let el = element::bend_twist(a, b, turn, &m, &strains, &k);
        let place = |local: usize| match local {
            3 => 3 * (n + 1) + i - 1,
            7 => 3 * (n + 1) + i,
            _ => 3 * (i - 1 + local / 4) + local % 4,
        };
        for r in 0..11 {
            out.gradient[place(r)] += el.gradient[r];
            for c in 0..11 {
                out.hessian[place(r) + place(c) * full] += el.hessian[r.max(c)][r.min(c)];
            }
        }
    }
    if !out.gradient.iter().all(|g| g.is_finite()) {
        return Err(Error::NonFinite {
            what: "the gradient, component",
            index: out.gradient.iter().position(|g| !g.is_finite()).unwrap_or(0),
        });
    }
    Ok(out)
}
