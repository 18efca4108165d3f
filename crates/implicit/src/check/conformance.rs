//! Every check of a model: its steps, its products, its slots, the map of its control.

use super::products::{compare, dot_product};
use super::second_order::second_order;
use super::taylor::{fit, taylor_step};
use super::vectors::norm_of;
use crate::{Error, Model};
use varda_linalg::check::{Finding, Random, Report, differing};

/// Columns of one product that are rounded in another order than a single column may differ by this share of
/// their size.
const COLUMNS: f64 = 1e-12;

/// Every check of a model over the first `steps` steps from the control z, with perturbations of the size of
/// `scale` (of a state; those of the control are its first components): all of [`conformance`] at the first
/// and at the last of these steps, from the states that the model reaches; a step that no other step changes;
/// two slots that do not disturb each other; and the map of the control: the same bits again, its tangent
/// (Taylor), its transpose (dot product).
///
/// A term that vanishes in the states given shows nothing: take a control without zeros, and several steps.
///
/// ```
/// use varda_implicit::{Rk4, check, lorenz::Lorenz63};
///
/// let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);
/// let report = check::model(&mut model, &[1.0, 3.0, 20.0], 5, &[1.0; 3], 1)?;
/// assert!(report.passed(), "{report}");
/// # Ok::<(), varda_implicit::Error>(())
/// ```
///
/// # Errors
/// Those of the model; [`Error::EmptyTest`] where a check could not judge, as with fewer than two steps.
///
/// # Panics
/// If the control or `scale` has the wrong length, or the control is longer than the state.
pub fn model(
    model: &mut dyn Model,
    control: &[f64],
    steps: usize,
    scale: &[f64],
    seed: u64,
) -> Result<Report, Error> {
    let (n, n_z) = (model.dim(), model.control_dim());
    assert!(control.len() == n_z && scale.len() == n, "the control has {n_z} values, a state {n}");
    assert!(n_z <= n, "a control of {n_z} values for a state of {n} has no scale");
    if steps < 2 {
        return Err(Error::EmptyTest { what: "one step cannot show what depends on k" });
    }
    let mut findings = control_map(model, control, [&scale[..n_z], scale], seed)?;
    let mut x = vec![0.0; n];
    model.initial_state(control, &mut x)?;
    let (first, mut next) = (x.clone(), x.clone());
    for k in 0..steps {
        if k == 0 || k + 1 == steps {
            let found = conformance(model, k, &x, scale, seed)?;
            findings.extend(found.into_iter().map(|f| f.of(&format!("step {k}"))));
        }
        if k + 1 < steps {
            model.step(k, &x, &mut next)?;
            std::mem::swap(&mut x, &mut next);
        }
    }
    findings.push(other_steps(model, [0, steps - 1], [&first, &x])?);
    findings.extend(slots(model, [0, steps - 1], [&first, &x], scale, seed)?);
    Ok(Report { findings })
}

/// The map z ↦ x₀: pure, differentiated, transposed.
fn control_map(
    model: &mut dyn Model,
    z: &[f64],
    scales: [&[f64]; 2],
    seed: u64,
) -> Result<Vec<Finding>, Error> {
    let n = model.dim();
    let mut random = Random(seed);
    let dz: Vec<f64> = scales[0].iter().map(|s| s * random.draw()).collect();
    let lambda: Vec<f64> = scales[1].iter().map(|s| random.draw() / s).collect();
    let moved = |h: f64| -> Vec<f64> { z.iter().zip(&dz).map(|(z, d)| z + h * d).collect() };
    let (mut x, mut again, mut elsewhere) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
    model.initial_state(z, &mut x)?;
    model.initial_state(&moved(1e-3), &mut elsewhere)?;
    model.initial_state(z, &mut again)?;
    let pure =
        Finding::at_most("initial state: values that differ when run again", differing(&x, &again), 0.0);
    let (mut tangent, mut back) = (vec![0.0; n], vec![0.0; z.len()]);
    model.initial_tangent(&dz, &mut tangent);
    model.initial_adjoint(&lambda, &mut back);
    let norm = norm_of(&tangent, scales[1]) / norm_of(&dz, scales[0]);
    let dot = compare(&dz, &tangent, &lambda, &back, norm, scales)?;
    let taylor = fit(&mut |h| {
        model.initial_state(&moved(h), &mut elsewhere)?;
        elsewhere.iter_mut().zip(&x).for_each(|(e, x)| *e -= x);
        let difference = norm_of(&elsewhere, scales[1]);
        elsewhere.iter_mut().zip(&tangent).for_each(|(e, t)| *e -= h * t);
        Ok((difference, norm_of(&elsewhere, scales[1])))
    })?;
    Ok(vec![
        pure,
        Finding {
            what: "initial state: 2 − Taylor slope of its tangent".to_string(),
            value: 2.0 - taylor.slope,
            bound: 2.0 - taylor.bound,
            pass: taylor.pass,
        },
        Finding::at_most("initial state: dot product of its adjoint", dot.value, dot.bound),
    ])
}

/// The first of two steps, taken before and after the other.
fn other_steps(model: &mut dyn Model, steps: [usize; 2], states: [&[f64]; 2]) -> Result<Finding, Error> {
    let [mut before, mut after] = [0; 2].map(|_| vec![0.0; model.dim()]);
    model.step(steps[0], states[0], &mut before)?;
    model.step(steps[1], states[1], &mut after)?;
    model.step(steps[0], states[0], &mut after)?;
    let changed = differing(&before, &after);
    Ok(Finding::at_most("step: values that a step elsewhere changes", changed, 0.0))
}

/// Two steps linearized into two slots: each holds its own, whatever happens to the other.
fn slots(
    model: &mut dyn Model,
    steps: [usize; 2],
    states: [&[f64]; 2],
    scale: &[f64],
    seed: u64,
) -> Result<[Finding; 3], Error> {
    let mut random = Random(seed);
    let dx: Vec<f64> = scale.iter().map(|s| s * random.draw()).collect();
    let [mut next, mut last] = [dx.clone(), dx.clone()];
    let products = |model: &mut dyn Model, slot: usize| {
        let mut columns = [dx.clone(), dx.clone()];
        model.tangent(slot, &mut columns[0]);
        model.adjoint(slot, &mut columns[1]);
        columns.concat()
    };
    model.step(steps[0], states[0], &mut next)?;
    model.step(steps[1], states[1], &mut last)?;
    model.linearize(0, steps[1], states[1], &last)?;
    let last_in_first = products(model, 0);
    model.linearize(0, steps[0], states[0], &next)?;
    let alone = products(model, 0);
    model.linearize(1, steps[1], states[1], &last)?;
    let (beside, last_in_second) = (products(model, 0), products(model, 1));
    model.release(1);
    let released = products(model, 0);
    let finding = |what: &str, a: &[f64], b: &[f64]| Finding::at_most(what, differing(a, b), 0.0);
    Ok([
        finding("slots: values of slot 0 that slot 1 changes", &alone, &beside),
        finding("slots: values that are others in slot 1 than in slot 0", &last_in_first, &last_in_second),
        finding("slots: values of slot 0 that releasing slot 1 changes", &alone, &released),
    ])
}

/// Every check of a model on step k from the state x, with perturbations of the size of `scale`: same input,
/// same bits; a zero perturbation stays zero; the tangent is linear; it is the derivative (Taylor); the
/// adjoint is its transpose; products with several columns are those of the single ones; linearizing twice
/// gives the same bits; and where the model has second derivatives those of [`second_order`].
///
/// # Errors
/// Those of the model and of the single checks.
///
/// # Panics
/// If lengths differ.
pub fn conformance(
    model: &mut dyn Model,
    k: usize,
    x: &[f64],
    scale: &[f64],
    seed: u64,
) -> Result<Vec<Finding>, Error> {
    let n = model.dim();
    assert!(x.len() == n && scale.len() == n, "lengths differ");
    let mut random = Random(seed);
    let mut draw = || -> Vec<f64> { scale.iter().map(|s| s * random.draw()).collect() };
    let (a, b) = (draw(), draw());
    let mut findings = Vec::new();

    let (mut next, mut again, mut elsewhere) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
    model.step(k, x, &mut next)?;
    let moved: Vec<f64> = x.iter().zip(&a).map(|(x, a)| x + 1e-3 * a).collect();
    model.step(k, &moved, &mut elsewhere)?;
    model.step(k, x, &mut again)?;
    findings.push(Finding::at_most("step: values that differ when run again", differing(&next, &again), 0.0));

    model.linearize(0, k, x, &next)?;
    let tangent = |model: &mut dyn Model, v: &[f64]| {
        let mut out = v.to_vec();
        model.tangent(0, &mut out);
        out
    };
    let zero = vec![0.0; n];
    let of_zero = tangent(model, &zero).iter().filter(|v| **v != 0.0).count();
    findings.push(Finding::at_most("tangent: values of M 0 that are not zero", of_zero as f64, 0.0));

    let (m_a, m_b) = (tangent(model, &a), tangent(model, &b));
    let mixed: Vec<f64> = a.iter().zip(&b).map(|(a, b)| 0.75 * a - 1.5 * b).collect();
    let left: Vec<f64> =
        tangent(model, &mixed).iter().zip(&m_a).zip(&m_b).map(|((m, a), b)| m - 0.75 * a + 1.5 * b).collect();

    let test = dot_product(model, 0..1, scale, seed)?;
    let largest = norm_of(&m_a, scale).max(norm_of(&m_b, scale));
    findings.push(Finding::at_most(
        "tangent: departure from linearity",
        norm_of(&left, scale) / largest,
        test.bound,
    ));
    findings.push(Finding::at_most("adjoint: dot product", test.value, test.bound));
    findings.extend(columns(model, &a, &b, scale));

    model.linearize(0, k, &moved, &elsewhere)?;
    model.linearize(0, k, x, &next)?;
    let repeated = tangent(model, &a);
    findings.push(Finding::at_most(
        "linearize: values that differ when run again",
        differing(&m_a, &repeated),
        0.0,
    ));

    let slope = taylor_step(model, k, x, &a, scale)?;
    findings.push(Finding {
        what: "tangent: 2 − Taylor slope".to_string(),
        value: 2.0 - slope.slope,
        bound: 2.0 - slope.bound,
        pass: slope.pass,
    });
    findings.extend(second_order(model, k, x, scale, seed)?);
    Ok(findings)
}

/// Three columns at once against each of them alone.
fn columns(model: &mut dyn Model, a: &[f64], b: &[f64], scale: &[f64]) -> [Finding; 2] {
    let n = a.len();
    let inverse: Vec<f64> = scale.iter().map(|s| 1.0 / s).collect();
    let adjoint_of = |v: &[f64]| -> Vec<f64> { v.iter().zip(scale).map(|(v, s)| v / (s * s)).collect() };
    let mut worst = |columns: [Vec<f64>; 3], transpose: bool, scale: &[f64]| {
        let mut product = |v: &mut [f64]| if transpose { model.adjoint(0, v) } else { model.tangent(0, v) };
        let mut at_once = columns.concat();
        product(&mut at_once);
        let mut worst = 0.0_f64;
        for (mut alone, at_once) in columns.into_iter().zip(at_once.chunks_exact(n)) {
            product(&mut alone);
            let size = norm_of(&alone, scale);
            alone.iter_mut().zip(at_once).for_each(|(a, b)| *a -= b);
            let difference = norm_of(&alone, scale);
            let share = if difference == 0.0 { 0.0 } else { difference / size };
            worst = if share <= worst { worst } else { share };
        }
        worst
    };
    let tangent = worst([a.to_vec(), b.to_vec(), a.to_vec()], false, scale);
    let adjoint = worst([adjoint_of(a), adjoint_of(b), adjoint_of(a)], true, &inverse);
    [
        Finding::at_most("tangent: three columns at once against single ones", tangent, COLUMNS),
        Finding::at_most("adjoint: three columns at once against single ones", adjoint, COLUMNS),
    ]
}
