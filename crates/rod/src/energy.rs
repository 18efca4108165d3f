//! Energy, gradient and Hessian of one configuration with given frames, for users who bring their own time
//! stepping.

use nalgebra::Vector3;

use crate::Error;
use crate::element::{self, Stiffness};
use crate::geometry::{Turn, perpendicular, signed_angle};
use crate::rod::Rod;
use crate::scalar::Real;
use crate::shape::Shape;

/// A configuration with its reference frames.
#[derive(Debug, Clone, Copy)]
pub struct Framed<'a> {
    /// x_0 … x_n \[m\].
    pub vertices: &'a [Vector3<f64>],
    /// Reference director d₁ of every edge; m₁ = cos θ d₁ + sin θ d₂, d₂ = t × d₁.
    pub directors: &'a [Vector3<f64>],
    /// Reference twist of every interior vertex \[rad\]; whole turns count.
    pub reference_twist: &'a [f64],
    /// θ of every edge \[rad\].
    pub theta: &'a [f64],
}

/// Elastic energies \[J\].
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Energy<T = f64> {
    /// E_ε.
    pub stretch: T,
    /// E_κ.
    pub bend: T,
    /// E_τ.
    pub twist: T,
}

impl<T: Real> Energy<T> {
    /// E = E_ε + E_κ + E_τ.
    pub fn total(&self) -> T {
        self.stretch + self.bend + self.twist
    }

    fn zero() -> Energy<T> {
        Energy { stretch: T::zero(), bend: T::zero(), twist: T::zero() }
    }
}

/// Energy with its first and second derivatives. Degrees of freedom in the order x_0, y_0, z_0, x_1, … ,
/// z_n, θ^0 … θ^{n−1}.
#[derive(Debug, Clone, PartialEq)]
pub struct Derivatives {
    /// The energies.
    pub energy: Energy,
    /// ∂E/∂(x, θ), 4n + 3 numbers.
    pub gradient: Vec<f64>,
    /// ∂²E/∂(x, θ)², dense, symmetric, (4n + 3)² numbers, column by column.
    pub hessian: Vec<f64>,
}

impl Framed<'_> {
    fn check(&self, rod: &Rod) -> Result<(), Error> {
        rod.check()?;
        let n = rod.segments();
        count("vertices", self.vertices.len(), n + 1)?;
        count("directors", self.directors.len(), n)?;
        count("reference_twist", self.reference_twist.len(), n - 1)?;
        count("theta", self.theta.len(), n)
    }

    /// Edges and turns, and the directors made perpendicular to their edges; no angles yet.
    fn shape(&self) -> Result<Shape, Error> {
        let mut shape = Shape::new(self.directors.len());
        shape.set_edges(self.vertices, true)?;
        for (e, d) in self.directors.iter().enumerate() {
            shape.d1[e] = perpendicular(d, &shape.edges[e].t);
        }
        Ok(shape)
    }
}

fn count(field: &'static str, found: usize, expected: usize) -> Result<(), Error> {
    if found == expected { Ok(()) } else { Err(Error::Count { field, found, expected }) }
}

/// Stiffness and rest strains of interior vertex i.
fn stiffness<T: Real>(rod: &Rod, i: usize) -> Stiffness<T> {
    let over = 1.0 / rod.voronoi_lengths[i - 1];
    let natural = rod.natural_curvature[i - 1];
    Stiffness {
        bend: rod.ei[i - 1].map(|k| T::of(k * over)),
        twist: T::of(rod.gj[i - 1] * over),
        rest: [natural[0], natural[1], rod.natural_twist[i - 1]].map(T::of),
    }
}

/// Elastic energy (paper, section 5.2) at `vertices` and `theta`, the frames of `at` carried there: every
/// director by parallel transport from its edge in `at` to its edge now, every reference twist by the change
/// of the angle between them.
///
/// This is the function of which [`derivatives`] gives the derivatives at `at`. It is written over the
/// scalar, so that dual numbers differentiate it.
///
/// # Errors
/// [`Error`] for a fold, an edge without length, a value that is not finite, or arrays of the wrong length.
///
/// # Examples
///
/// The stretching force of one segment, EA (l − l̄)/l̄, from a dual number:
///
/// ```
/// use nalgebra::Vector3;
/// use num_dual::first_derivative;
/// use varda_rod::{Framed, Material, Rod, Section, energy};
///
/// let section = Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01);
/// let rod = Rod::uniform(1.0, 1, &section)?;
/// let x = [Vector3::zeros(), Vector3::x() * 1.1];
/// let at = Framed { vertices: &x, directors: &[Vector3::y()], reference_twist: &[], theta: &[0.0] };
/// let stretched = |length| {
///     let zero = length * 0.0;
///     let vertices = [Vector3::repeat(zero), Vector3::new(length, zero, zero)];
///     energy(&rod, &at, &vertices, &[zero]).expect("a straight segment").total()
/// };
/// let (value, force) = first_derivative(stretched, 1.1);
/// assert!((force - section.ea * 0.1).abs() < 1e-12 * section.ea);
/// assert!((value - 0.5 * section.ea * 0.01).abs() < 1e-12 * section.ea);
/// # Ok::<(), varda_rod::Error>(())
/// ```
pub fn energy<T: Real>(
    rod: &Rod,
    at: &Framed,
    vertices: &[Vector3<T>],
    theta: &[T],
) -> Result<Energy<T>, Error> {
    at.check(rod)?;
    let n = rod.segments();
    count("vertices", vertices.len(), n + 1)?;
    count("theta", theta.len(), n)?;
    let given = at.shape()?;
    let mut shape = Shape::new(n);
    shape.set_edges(vertices, true)?;
    for e in 0..n {
        let from = given.edges[e].t.map(T::of);
        let to = shape.edges[e].t;
        shape.d1[e] = Turn::between(&from, &to, e)
            .map_err(|_| Error::FrameUndefined)?
            .transport(&to, &given.d1[e].map(T::of));
    }
    let mut twist = Vec::with_capacity(n - 1);
    for i in 1..n {
        let change = angle_between(&shape, i) - T::of(angle_between(&given, i));
        let turns = (change.value() / std::f64::consts::TAU).round();
        twist.push(T::of(at.reference_twist[i - 1] - turns * std::f64::consts::TAU) + change);
    }
    shape.set_angles(theta, Some(&twist));

    let mut out = Energy::zero();
    for e in 0..n {
        out.stretch += element::stretch(&shape.edges[e], T::of(rod.rest_lengths[e]), T::of(rod.ea[e])).0;
    }
    for i in 1..n {
        let (bend, twist) = element::energies(&shape.strains(i), &stiffness(rod, i));
        out.bend += bend;
        out.twist += twist;
    }
    Ok(out)
}

/// Angle at interior vertex i from d₁ of the edge before, carried over the vertex, to d₁ of the edge
/// after it.
fn angle_between<T: Real>(shape: &Shape<T>, i: usize) -> T {
    let t = &shape.edges[i].t;
    signed_angle(&shape.turn(i).transport(t, &shape.d1[i - 1]), &shape.d1[i], t)
}

/// Exact derivatives of the elastic [`energy`]; forces and twisting moments are minus its gradient
/// (paper 3.1, 3.2).
///
/// The gauge is the time-parallel one: as the vertices move, the director of an edge is carried from its
/// present tangent by parallel transport, and the reference twist changes continuously (Bergou et al. 2008,
/// 2010).
///
/// ```
/// use varda_rod::{Framed, Material, Rod, Section, Vector3, derivatives};
///
/// // Two segments, the first stretched by a tenth: its ends are pulled together by EA/10.
/// let section = Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01);
/// let rod = Rod::uniform(2.0, 2, &section)?;
/// let vertices = [0.0, 1.1, 2.1].map(|x| Vector3::x() * x);
/// let directors = [Vector3::y(); 2];
/// let at = Framed { vertices: &vertices, directors: &directors, reference_twist: &[0.0], theta: &[0.0; 2] };
/// let d = derivatives(&rod, &at)?;
/// assert!((d.energy.total() - 0.5 * section.ea * 0.01).abs() < 1e-12 * section.ea);
/// assert!((d.gradient[3] - 0.1 * section.ea).abs() < 1e-12 * section.ea); // −force on vertex 1
/// # Ok::<(), varda_rod::Error>(())
/// ```
///
/// # Errors
/// [`Error`] for a fold, an edge without length, a value that is not finite, or arrays of the wrong length.
pub fn derivatives(rod: &Rod, at: &Framed) -> Result<Derivatives, Error> {
    at.check(rod)?;
    let n = rod.segments();
    let mut shape = at.shape()?;
    shape.set_angles(at.theta, Some(at.reference_twist));

    let full = 4 * n + 3;
    let mut out =
        Derivatives { energy: Energy::zero(), gradient: vec![0.0; full], hessian: vec![0.0; full * full] };
    for e in 0..n {
        let (energy, force, h) = element::stretch(&shape.edges[e], rod.rest_lengths[e], rod.ea[e]);
        out.energy.stretch += energy;
        for i in 0..3 {
            for (a, sign) in [(3 * e, -1.0), (3 * e + 3, 1.0)] {
                out.gradient[a + i] += sign * force * shape.edges[e].t[i];
                for j in 0..3 {
                    out.hessian[a + i + (3 * e + j) * full] -= sign * h[(i, j)];
                    out.hessian[a + i + (3 * e + 3 + j) * full] += sign * h[(i, j)];
                }
            }
        }
    }
    for i in 1..n {
        let k = stiffness(rod, i);
        let (a, b, turn, m) = (&shape.edges[i - 1], &shape.edges[i], shape.turn(i), shape.directors(i));
        let strains = shape.strains(i);
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
    if let Some(index) = out.gradient.iter().position(|g| !g.is_finite()) {
        return Err(Error::NonFinite { what: "the gradient, component", index });
    }
    Ok(out)
}
