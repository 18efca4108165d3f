//! Every check of a right-hand side.

use super::products::compare;
use super::taylor::fit;
use super::vectors::norm_of;
use crate::{Error, Rhs};
use varda_linalg::check::{Finding, Random, Report, differing};

/// Two forms of the adjoint may differ by this share of its norm: some tens of roundings.
const SAME_ADJOINT: f64 = 1e-14;

/// Every check of a right-hand side f at (t, x), with perturbations of the size of `scale`: same input, same
/// bits; the tangent is the derivative of f (Taylor), and the adjoint its transpose (dot product); the two
/// forms of the adjoint agree; the structure is one of an n × n matrix and has a diagonal; the Jacobian,
/// given or made from tangents in that structure, has the products of the tangent.
///
/// A term that vanishes at x shows nothing: take a state without zeros.
///
/// ```
/// use varda_implicit::{check, lorenz::Lorenz63};
///
/// let report = check::rhs(&mut Lorenz63::default(), 0.0, &[1.0, 3.0, 20.0], &[1.0; 3], 1)?;
/// assert!(report.passed(), "{report}");
/// # Ok::<(), varda_implicit::Error>(())
/// ```
///
/// # Errors
/// [`Error::EmptyTest`] where a check could not judge.
///
/// # Panics
/// If lengths differ.
pub fn rhs<R: Rhs>(f: &mut R, t: f64, x: &[f64], scale: &[f64], seed: u64) -> Result<Report, Error> {
    let n = f.dim();
    assert!(x.len() == n && scale.len() == n, "a state has {n} values");
    let mut random = Random(seed);
    let dx: Vec<f64> = scale.iter().map(|s| s * random.draw()).collect();
    let lambda: Vec<f64> = scale.iter().map(|s| random.draw() / s).collect();
    let moved = |h: f64| -> Vec<f64> { x.iter().zip(&dx).map(|(x, d)| x + h * d).collect() };
    let [mut value, mut again, mut tangent, mut back, mut added] = [0; 5].map(|_| vec![0.0; n]);
    let mut findings = Vec::new();

    f.eval(t, x, &mut value);
    f.eval(t, &moved(1e-3), &mut again);
    f.eval(t, x, &mut again);
    findings.push(Finding::at_most("f: values that differ when asked again", differing(&value, &again), 0.0));

    f.tangent(t, x, &dx, &mut tangent);
    let slope = fit(&mut |h| {
        f.eval(t, &moved(h), &mut again);
        again.iter_mut().zip(&value).for_each(|(a, v)| *a -= v);
        let difference = norm_of(&again, scale);
        again.iter_mut().zip(&tangent).for_each(|(a, t)| *a -= h * t);
        Ok((difference, norm_of(&again, scale)))
    })?;
    findings.push(Finding {
        what: "tangent: 2 − Taylor slope".to_string(),
        value: 2.0 - slope.slope,
        bound: 2.0 - slope.bound,
        pass: slope.pass,
    });

    f.adjoint(t, x, &lambda, &mut back);
    let norm = norm_of(&tangent, scale) / norm_of(&dx, scale);
    let dot = compare(&dx, &tangent, &lambda, &back, norm, [scale, scale])?;
    findings.push(Finding::at_most("adjoint: dot product", dot.value, dot.bound));
    added.fill(1.0);
    f.adjoint_add(t, x, &lambda, &mut added);
    // beside the largest: an entry whose terms cancel is known no better
    let inverse: Vec<f64> = scale.iter().map(|s| 1.0 / s).collect();
    let size = norm_of(&back, &inverse) + norm_of(&vec![1.0; n], &inverse);
    added.iter_mut().zip(&back).for_each(|(a, b)| *a -= 1.0 + b);
    let differ = norm_of(&added, &inverse) / size;
    findings.push(Finding::at_most("adjoint: difference to adjoint_add", differ, SAME_ADJOINT));

    let structure = f.structure();
    let usable = structure.check(n).is_ok() && (0..n).all(|i| structure.diagonal(n, i).is_some());
    findings.push(Finding::at_most("structure: faults of the pattern", if usable { 0.0 } else { 1.0 }, 0.0));
    if usable {
        let worst = crate::rhs::largest_disagreement(f, t, x, &structure);
        findings.push(Finding::at_most("jacobian: disagreement with the tangent", worst, 1e-8));
    }
    Ok(Report { findings })
}
