//! Second derivatives of the rod's energy, Gauss–Newton products and those of the exact Hessian.

pub(super) mod exact;

use super::Options;
use crate::row::{Case, Outcome, Row, Rows};
use nalgebra::{Rotation3, SVector, Unit, Vector3};
use problems::costs::for_each_cost;
use problems::rods::wave;
use varda_assimilation::LeastSquares;
use varda_implicit::check;
use varda_rod::{Derivatives, Error, Framed, Rod, derivatives, energy};

pub(super) fn run(_options: &Options) -> Vec<Row> {
    let mut rows = Rows::new("hessian");
    for seed in 1..=5 {
        rows.case(&format!("two edges, configuration {seed}"), |case| {
            dual_numbers(case, &Bent::new(2, seed))
        });
    }
    for seed in 1..=3 {
        let bent = Bent::new(7, seed);
        rows.case(&format!("seven edges, configuration {seed}"), |case| {
            differences(case, &bent)?;
            rigid_motion(case, &bent)
        });
    }
    let outcome = for_each_cost(&mut |name, cost| {
        rows.case(name, |case| {
            products(case, cost)?;
            if !cost.has_exact_hessian() {
                return Ok(());
            }
            let v: Vec<f64> = (0..cost.dim()).map(|i| 0.2 * wave(i, 71)).collect();
            exact::product(case, cost, &v, exact::Accuracy::GOOD)
        });
        Ok(())
    });
    if let Err(error) = outcome {
        rows.case("assembled costs", |_| Err(error));
    }
    exact::reference(&mut rows);
    rows.finish()
}

/// An anisotropic rod bent, twisted and stretched, naturally curved, with segments of different length.
struct Bent {
    rod: Rod,
    vertices: Vec<Vector3<f64>>,
    directors: Vec<Vector3<f64>>,
    reference_twist: Vec<f64>,
    theta: Vec<f64>,
}

impl Bent {
    fn new(n: usize, seed: usize) -> Bent {
        let noise = |i: usize, kind: usize| wave(i, 10 * kind + seed);
        let rest_lengths: Vec<f64> = (0..n).map(|e| 0.1 + 0.03 * noise(e, 1)).collect();
        let inner = n - 1;
        let rod = Rod {
            voronoi_lengths: (0..inner).map(|i| 0.5 * (rest_lengths[i] + rest_lengths[i + 1])).collect(),
            ea: (0..n).map(|e| 3.0 + noise(e, 2)).collect(),
            ei: (0..inner).map(|i| [0.4 + 0.1 * noise(i, 3), 0.1 * noise(i, 4), 0.3]).collect(),
            gj: (0..inner).map(|i| 0.3 + 0.1 * noise(i, 5)).collect(),
            natural_curvature: (0..inner).map(|i| [0.3 * noise(i, 6), 0.3 * noise(i, 7)]).collect(),
            natural_twist: (0..inner).map(|i| 0.2 * noise(i, 8)).collect(),
            masses: vec![1.0; n + 1],
            spin_inertia: Vec::new(),
            rest_lengths,
        };
        // Each edge turns by up to about a radian and a half from the one before.
        let mut x = Vector3::zeros();
        let mut vertices = vec![x];
        let mut directors = Vec::new();
        for e in 0..n {
            let t = Vector3::new(noise(e, 9), noise(e, 10), 1.2).normalize();
            x += t * (rod.rest_lengths[e] * (1.0 + 0.05 * noise(e, 11)));
            vertices.push(x);
            let across = Vector3::new(noise(e, 12), noise(e, 13), noise(e, 14));
            directors.push((across - t * across.dot(&t)).normalize());
        }
        let theta = (0..n).map(|e| 2.0 * noise(e, 15)).collect();
        let mut bent = Bent { rod, vertices, directors, reference_twist: vec![0.0; inner], theta };
        // Whole turns count: one of them has two.
        let turns = |i: usize| if i == 0 { 2.0 * std::f64::consts::TAU } else { 0.0 };
        bent.reference_twist = (0..inner).map(|i| bent.frame_angle(&bent.vertices, i) + turns(i)).collect();
        bent
    }

    fn derivatives(&self) -> Result<Derivatives, Error> {
        derivatives(&self.rod, &self.framed())
    }

    fn framed(&self) -> Framed<'_> {
        let Bent { vertices, directors, reference_twist, theta, .. } = self;
        Framed { vertices, directors, reference_twist, theta }
    }

    /// The same rod after the degrees of freedom (x, then θ) have moved by h q, its frames carried along in
    /// parallel.
    fn moved(&self, q: &[f64], h: f64) -> Bent {
        let nx = 3 * self.vertices.len();
        let step = |v: usize| Vector3::from_column_slice(&q[3 * v..3 * v + 3]) * h;
        let vertices: Vec<_> = self.vertices.iter().enumerate().map(|(v, x)| x + step(v)).collect();
        let theta = self.theta.iter().zip(&q[nx..]).map(|(t, q)| t + h * q).collect();
        let directors = (0..self.theta.len()).map(|e| self.director(&vertices, e)).collect();
        let twist = |i: usize| {
            let change = self.frame_angle(&vertices, i) - self.frame_angle(&self.vertices, i);
            self.reference_twist[i] + change
        };
        let reference_twist = (0..self.reference_twist.len()).map(twist).collect();
        Bent { rod: self.rod.clone(), vertices, directors, reference_twist, theta }
    }

    /// d₁ of an edge where the vertices are `x`, carried from where it is given by parallel transport.
    fn director(&self, x: &[Vector3<f64>], e: usize) -> Vector3<f64> {
        transport(&tangent(&self.vertices, e), &tangent(x, e), &self.directors[e])
    }

    /// Angle at inner vertex i from d₁ before, carried over the vertex, to d₁ after it.
    fn frame_angle(&self, x: &[Vector3<f64>], i: usize) -> f64 {
        let (p, q) = (tangent(x, i), tangent(x, i + 1));
        let carried = transport(&p, &q, &self.director(x, i));
        let there = self.director(x, i + 1);
        carried.cross(&there).dot(&q).atan2(carried.dot(&there))
    }
}

/// Unit tangent of an edge.
fn tangent(x: &[Vector3<f64>], e: usize) -> Vector3<f64> {
    (x[e + 1] - x[e]).normalize()
}

/// w − (w·q) (p + q)/(1 + p·q), for w ⟂ p.
fn transport(p: &Vector3<f64>, q: &Vector3<f64>, w: &Vector3<f64>) -> Vector3<f64> {
    w - (p + q) * (w.dot(q) / (1.0 + p.dot(q)))
}

fn largest(a: impl Iterator<Item = f64>) -> f64 {
    a.fold(0.0, |m: f64, a| if a.is_nan() || m.is_nan() { f64::NAN } else { m.max(a.abs()) })
}

/// Energy, gradient and Hessian of one bent vertex, eleven degrees of freedom, against second-order dual
/// numbers in the energy.
fn dual_numbers(case: &mut Case, bent: &Bent) -> Outcome {
    let ours = bent.derivatives()?;
    let coordinates = bent.vertices.iter().flatten().chain(&bent.theta);
    let (total, gradient, hessian) = num_dual::hessian(
        |q: SVector<num_dual::Dual2SVec64<11>, 11>| {
            let x: [_; 3] = std::array::from_fn(|v| q.fixed_rows::<3>(3 * v).into_owned());
            energy(&bent.rod, &bent.framed(), &x, &[q[9], q[10]]).map(|energy| energy.total())
        },
        &SVector::from_iterator(coordinates.copied()),
    )?;
    case.reason("a few hundred operations with little cancellation: a thousand times their rounding");
    let value = ours.energy.total();
    case.at_most("energy", (value - total).abs() / total.abs(), 1e-12, "-").computed(value);
    let relative = |ours: &[f64], theirs: &[f64]| {
        largest(ours.iter().zip(theirs).map(|(a, b)| a - b)) / largest(theirs.iter().copied())
    };
    case.at_most("gradient", relative(&ours.gradient, gradient.as_slice()), 1e-12, "-");
    case.at_most("hessian", relative(&ours.hessian, hessian.as_slice()), 1e-12, "-");
    Ok(())
}

/// The Hessian of a longer rod against symmetric differences of its gradient, and the gradient against the
/// energy.
fn differences(case: &mut Case, bent: &Bent) -> Outcome {
    let here = bent.derivatives()?;
    let n = here.gradient.len();
    let h = 1e-3;
    // Each gradient is taken in the gauge of its own place, which turns, to first order antisymmetrically, as
    // the place moves: the symmetric part of the differences is the Hessian of the given gauge.
    let mut columns = vec![0.0; n * n];
    let mut unit = vec![0.0; n];
    for j in 0..n {
        unit[j] = 1.0;
        // extrapolated once: h⁴ is 1e-12, the constant up to 1e4 (an edge is 0.1 long)
        for (step, weight) in [(h, -1.0 / 3.0), (0.5 * h, 4.0 / 3.0)] {
            let ahead = bent.moved(&unit, step).derivatives()?;
            let behind = bent.moved(&unit, -step).derivatives()?;
            for i in 0..n {
                columns[i + j * n] += weight * (ahead.gradient[i] - behind.gradient[i]) / (2.0 * step);
            }
        }
        unit[j] = 0.0;
    }
    let error = largest((0..n * n).map(|at| {
        let (i, j) = (at % n, at / n);
        0.5 * (columns[i + j * n] + columns[j + i * n]) - here.hessian[at]
    }));
    let size = largest(here.hessian.iter().copied());
    case.at_most("hessian against differences", error / size, 1e-7, "-").computed(error).because(
        "h⁴ of the extrapolated differences is 1e-12, its constant up to 1e4 (an edge is 0.1 \
            long); ten times that",
    );
    let asymmetry = largest((0..n * n).map(|at| here.hessian[at] - here.hessian[at / n + at % n * n]));
    case.at_most("symmetry", asymmetry / size, 0.0, "-").because("one half is copied from the other");

    let q: Vec<f64> =
        (0..n).map(|i| if i < n - bent.theta.len() { 0.01 } else { 0.1 } * wave(i, 51)).collect();
    let mut energy = |s: &[f64]| {
        let there = bent.moved(&q, s[0]).derivatives();
        let refused = |e| varda_implicit::Error::Refused { step: 0, reason: varda_implicit::Refusal::new(e) };
        Ok(there.map_err(refused)?.energy.total())
    };
    let slope: f64 = here.gradient.iter().zip(&q).map(|(g, q)| g * q).sum();
    let taylor = check::taylor(&mut energy, &[slope], &[0.0], &[1.0])?;
    case.at_most("gradient: Taylor slope", (taylor.slope - 2.0).abs(), 0.05, "-")
        .computed(taylor.slope)
        .because("fitted over ten halvings, the term of third order moves a slope by less");

    // Remainder of second order: E(h) − E − h g·q − ½h² qᵀHq falls like h³.
    let curvature: f64 = (0..n)
        .flat_map(|j| (0..n).map(move |i| (i, j)))
        .map(|(i, j)| q[i] * here.hessian[i + j * n] * q[j])
        .sum();
    let remainder = |s: f64| -> Result<f64, Error> {
        let there = bent.moved(&q, s).derivatives()?.energy.total();
        Ok((there - here.energy.total() - s * slope - 0.5 * s * s * curvature).abs())
    };
    let order = (remainder(0.02)? / remainder(0.01)?).log2();
    case.at_most("hessian: Taylor slope", (order - 3.0).abs(), 0.1, "-")
        .computed(order)
        .because("two steps of 1 and 2 %: the term of fourth order moves the slope by a few per cent");
    Ok(())
}

/// Moving the rod and its frames rigidly changes no energy, and turns gradient and Hessian with it.
fn rigid_motion(case: &mut Case, bent: &Bent) -> Outcome {
    let here = bent.derivatives()?;
    let axis = Unit::new_normalize(Vector3::new(0.3, -0.8, 0.5));
    let turn = Rotation3::from_axis_angle(&axis, 2.1);
    let shift = Vector3::new(3.0, -1.0, 2.0);
    let there = Bent {
        rod: bent.rod.clone(),
        vertices: bent.vertices.iter().map(|x| turn * x + shift).collect(),
        directors: bent.directors.iter().map(|d| turn * d).collect(),
        reference_twist: bent.reference_twist.clone(),
        theta: bent.theta.clone(),
    }
    .derivatives()?;
    let (e, f) = (here.energy.total(), there.energy.total());
    case.reason(
        "coordinates of size 3 with edges of 0.1 round by 30 ε, times a ratio of stiffnesses of \
        about 1e2, ten times",
    );
    case.at_most("energy after a rigid motion", (f - e).abs() / e, 1e-11, "-").computed(f);
    let nx = 3 * bent.vertices.len();
    let n = here.gradient.len();
    let turned = |v: &[f64]| {
        let mut out = v.to_vec();
        for x in out[..nx].chunks_exact_mut(3) {
            let t = turn * Vector3::from_column_slice(x);
            x.copy_from_slice(t.as_slice());
        }
        out
    };
    let expected = turned(&here.gradient);
    let error = largest(there.gradient.iter().zip(&expected).map(|(a, b)| a - b));
    case.at_most("gradient after a rigid motion", error / largest(expected.iter().copied()), 1e-11, "-");
    let mut error: f64 = 0.0;
    for q in 0..4 {
        let q: Vec<f64> = (0..n).map(|i| wave(i, 61 + q)).collect();
        let expected = turned(&times(&here.hessian, &q));
        let found = times(&there.hessian, &turned(&q));
        let size = largest(expected.iter().copied());
        error = error.max(largest(found.iter().zip(&expected).map(|(a, b)| a - b)) / size);
    }
    case.at_most("hessian after a rigid motion", error, 1e-11, "-");

    case.reason("no rounding of coordinates here: a few hundred operations, ε each, ten times");
    // Generators: a translation is a null vector of the Hessian; a turn ω (δx = ω × x, δθ = ω·t)
    // meets no force.
    let (size, scale) = (largest(here.hessian.iter().copied()), largest(here.gradient.iter().copied()));
    let mut translation = vec![0.0; n];
    translation[..nx].chunks_exact_mut(3).for_each(|x| x.copy_from_slice(&[0.6, -0.3, 0.7]));
    case.at_most(
        "force of a translation",
        largest(times(&here.hessian, &translation).into_iter()) / size,
        1e-12,
        "-",
    );
    let omega = axis.into_inner();
    let mut rotation = Vec::new();
    bent.vertices.iter().for_each(|x| rotation.extend_from_slice(omega.cross(x).as_slice()));
    rotation.extend((0..bent.theta.len()).map(|e| omega.dot(&tangent(&bent.vertices, e))));
    let power: f64 = here.gradient.iter().zip(&rotation).map(|(g, q)| g * q).sum();
    case.at_most("work of a rotation", power.abs() / scale, 1e-12, "-").computed(power);
    Ok(())
}

fn times(matrix: &[f64], q: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; q.len()];
    for (column, q) in matrix.chunks_exact(q.len()).zip(q) {
        out.iter_mut().zip(column).for_each(|(o, m)| *o += m * q);
    }
    out
}

/// Gauss–Newton: the product against the matrix made by columns, and its symmetry.
fn products(case: &mut Case, cost: &mut dyn LeastSquares) -> Outcome {
    let n = cost.dim();
    let v: Vec<f64> = (0..n).map(|i| 0.2 * wave(i, 71)).collect();
    cost.evaluate(&v, Some(&mut vec![0.0; n]))?;
    let mut dense = vec![0.0; n * n];
    cost.hessian(&mut dense)?;
    let a: Vec<f64> = (0..n).map(|i| wave(i, 72)).collect();
    let b: Vec<f64> = (0..n).map(|i| wave(i, 73)).collect();
    let (mut product_a, mut product_b) = (vec![0.0; n], vec![0.0; n]);
    cost.hessian_apply(&a, &mut product_a)?;
    cost.hessian_apply(&b, &mut product_b)?;
    let columns = times(&dense, &a);
    let error =
        largest(product_a.iter().zip(&columns).map(|(p, c)| p - c)) / largest(columns.iter().copied());
    case.reason("two window sweeps against one, each good to about 1e-13");
    case.at_most("product against columns", error, 1e-11, "-");
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let norm = |a: &[f64]| dot(a, a).sqrt();
    let asymmetry = (dot(&b, &product_a) - dot(&a, &product_b)).abs() / (norm(&b) * norm(&product_a));
    case.at_most("symmetry of the product", asymmetry, 1e-12, "-");
    let curvature = dot(&a, &product_a) / dot(&a, &a);
    case.at_most("aᵀ A a ≥ |a|²", 1.0 - curvature, 1e-12, "-").computed(curvature);
    Ok(())
}
