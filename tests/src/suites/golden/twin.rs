//! Small twin problems with known minima.

use super::{Fixture, expect_length, expect_size};
use crate::row::{Case, Outcome};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::error::Error;
use std::ops::ControlFlow;
use std::path::Path;
use varda_assimilation::{
    ControlTransform, CostFunction, Minimizer, Observation, ObservationSet, Posterior, Selection,
    StrongConstraint,
};
use varda_covariance::{Dense, Precision};
use varda_implicit::{Model, Rk4, lorenz::Lorenz63, lorenz::Lorenz96};

#[derive(Deserialize)]
#[allow(non_snake_case)]
struct Twin {
    model: ModelFields,
    n: usize,
    K: usize,
    B: Vec<Vec<f64>>,
    R_diag: f64,
    H_rows: Vec<usize>,
    xb: Vec<f64>,
    obs: BTreeMap<usize, Vec<f64>>,
    xa: Vec<f64>,
    J_b: f64,
    J_min: f64,
    trPa: f64,
}

#[derive(Deserialize)]
struct ModelFields {
    name: String,
    parameters: BTreeMap<String, f64>,
    integrator: Option<String>,
    dt: Option<f64>,
}

type AnyModel = Option<Box<dyn Model>>;

/// Most components of a state, and steps of a window.
const COMPONENTS: usize = 2000;
const STEPS: usize = 1_000_000;

impl Fixture for Twin {
    fn validate(&self) -> Result<(), String> {
        let n = self.n;
        expect_size("n", n, COMPONENTS)?;
        if self.K > STEPS {
            return Err(format!("K = {}, expected at most {STEPS}", self.K));
        }
        for (what, found) in [("xb", self.xb.len()), ("xa", self.xa.len()), ("B", self.B.len())] {
            expect_length(what, found, n)?;
        }
        for (i, row) in self.B.iter().enumerate() {
            expect_length(&format!("B[{i}]"), row.len(), n)?;
        }
        for (step, values) in &self.obs {
            expect_length(&format!("obs at step {step}"), values.len(), self.H_rows.len())?;
            if *step > self.K {
                return Err(format!("obs at step {step}: the window has {} steps (K)", self.K));
            }
        }
        match self.H_rows.iter().find(|row| **row >= n) {
            Some(row) => Err(format!("H_rows names component {row} of {n}")),
            None => Ok(()),
        }
    }
}

/// A text up to what is minimized.
pub(super) fn prepare(text: &str) -> Outcome {
    let twin = Twin::parse(text)?;
    twin.model()?;
    Dense::new(twin.n, &twin.B.concat())?;
    twin.observations(twin.K)?;
    Ok(())
}

impl Twin {
    /// The model; none where nothing moves.
    fn model(&self) -> Result<AnyModel, Box<dyn Error>> {
        let ModelFields { name, parameters, integrator, dt } = &self.model;
        let parameter =
            |key: &str| parameters.get(key).copied().ok_or(format!("model.parameters.{key} is missing"));
        if name == "none" {
            return Ok(None);
        }
        if integrator.as_deref() != Some("rk4") {
            return Err(format!("unknown integrator {integrator:?} of model {name:?} (known: rk4)").into());
        }
        let dt = dt.filter(|dt| *dt > 0.0).ok_or("model.dt is not a positive number")?;
        match name.as_str() {
            "lorenz63" => {
                expect_length("xb of lorenz63", self.n, 3)?;
                let rhs =
                    Lorenz63 { sigma: parameter("sigma")?, rho: parameter("rho")?, beta: parameter("beta")? };
                Ok(Some(Box::new(Rk4::new(rhs, 0, dt))))
            }
            "lorenz96" => {
                if parameters.get("n").is_some_and(|n| *n != self.n as f64) || self.n < 4 {
                    return Err(format!("model.parameters.n does not fit n = {}", self.n).into());
                }
                Ok(Some(Box::new(Rk4::new(Lorenz96::new(self.n, parameter("forcing")?), 0, dt))))
            }
            _ => Err(format!("unknown model {name:?} (known: none, lorenz63, lorenz96)").into()),
        }
    }

    /// The observations up to and including step `last`.
    fn observations(&self, last: usize) -> Result<ObservationSet, Box<dyn Error>> {
        let observation = |(&step, values): (&usize, &Vec<f64>)| Observation {
            operator: 0,
            rows: (0..values.len()).collect(),
            step,
            weight: 0.0,
            values: values.clone(),
            sigma: vec![self.R_diag.sqrt(); values.len()],
            label: String::new(),
        };
        let operator = Selection::new(self.H_rows.clone(), self.n)?;
        let all = self.obs.range(..=last).map(observation).collect();
        Ok(ObservationSet::new(self.K, vec![Box::new(operator)], all)?)
    }
}

pub(super) fn check(case: &mut Case, path: &Path) -> Outcome {
    let twin = Twin::read(path)?;
    let n = twin.n;
    let mut model = twin.model()?;
    let b = Dense::new(n, &twin.B.concat())?;
    let transform = ControlTransform::new(twin.xb.clone(), &b)?;
    let mut observations = twin.observations(twin.K)?;

    let mut v = vec![0.0; n];
    let j = cost(&mut model, &transform, &mut observations)?.evaluate(&v, None)?;
    case.at_most("j_background", (j - twin.J_b).abs() / twin.J_b.abs(), 1e-10, "-").computed(j);

    let how = minimize(&twin, &mut model, &transform, &mut v)?;
    let mut cost = cost(&mut model, &transform, &mut observations)?;
    let j = cost.evaluate(&v, Some(&mut vec![0.0; n]))?;
    case.at_most("j_analysis", (j - twin.J_min) / twin.J_min.abs(), 1e-8, "-").computed(j).note(how);

    let mut z = vec![0.0; n];
    transform.control(&v, &mut z);
    let difference: Vec<f64> = z.iter().zip(&twin.xa).map(|(a, b)| a - b).collect();
    let mut whitened = vec![0.0; n];
    b.whiten(&difference, &mut whitened);
    let distance = super::norm(&whitened);
    case.at_most("analysis", distance, 1e-4, "-").computed(distance);

    let trace = Posterior::new(&mut cost)?.trace(&transform);
    case.at_most("posterior_trace", (trace - twin.trPa).abs() / twin.trPa.abs(), 1e-6, "-").computed(trace);
    Ok(())
}

/// Hands the assembled cost of one of our own copies to `visit`, with its control and the known minimum of J.
pub(in crate::suites) fn shipped(
    name: &str,
    visit: &mut dyn FnMut(&mut StrongConstraint, &ControlTransform, f64) -> Outcome,
) -> Outcome {
    let twin = Twin::read(&super::shipped().join("twin").join(name).with_extension("json"))?;
    let mut model = twin.model()?;
    let b = Dense::new(twin.n, &twin.B.concat())?;
    let transform = ControlTransform::new(twin.xb.clone(), &b)?;
    let mut observations = twin.observations(twin.K)?;
    visit(&mut cost(&mut model, &transform, &mut observations)?, &transform, twin.J_min)
}

fn cost<'a>(
    model: &'a mut AnyModel,
    transform: &ControlTransform<'a>,
    observations: &'a mut ObservationSet,
) -> Result<StrongConstraint<'a>, varda_assimilation::Error> {
    match model {
        Some(model) => StrongConstraint::new(model.as_mut(), transform.clone(), observations),
        None => StrongConstraint::without_model(transform.clone(), observations),
    }
}

/// Minimizes from the background, into `v`; says how it was found.
///
/// At the right minimum 2J is about m, give or take a few √(2m). A minimum that fails this is a false one, as chaotic models
/// have in long windows; then windows that grow by one observation time (Pires, Vautard and Talagrand 1996) are tried too, and the
/// lower J is kept.
fn minimize(
    twin: &Twin,
    model: &mut AnyModel,
    transform: &ControlTransform,
    v: &mut Vec<f64>,
) -> Result<String, Box<dyn Error>> {
    let mut growing = v.clone();
    let mut all = twin.observations(twin.K)?;
    let m = all.dim() as f64;
    let (best, how) = super::minimize(&mut cost(model, transform, &mut all)?, v)?;
    if best.value < 0.5 * m + 5.0 * (0.5 * m).sqrt() {
        return Ok(how);
    }
    let mut found = None;
    for &last in twin.obs.keys() {
        let mut some = twin.observations(last)?;
        let go_on = &mut |_: &varda_assimilation::Iteration| ControlFlow::Continue(());
        let mut cost = cost(model, transform, &mut some)?;
        found = Some(Minimizer::default().minimize(&mut cost, &mut growing, go_on)?);
    }
    match found.filter(|f| f.value < best.value) {
        Some(found) => {
            *v = growing;
            Ok(super::describe(&found, "through growing windows"))
        }
        None => Ok(how),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use problems::rods::wave;

    /// A Lorenz 1963 window of `steps` steps, all components seen every tenth step, with R = 2.
    fn lorenz63(steps: usize) -> Twin {
        let parameters = [("sigma", 10.0), ("rho", 28.0), ("beta", 8.0 / 3.0)];
        let mut twin = Twin {
            model: ModelFields {
                name: "lorenz63".into(),
                parameters: parameters.map(|(k, v)| (k.to_string(), v)).into(),
                integrator: Some("rk4".into()),
                dt: Some(0.01),
            },
            n: 3,
            K: steps,
            B: vec![vec![2.0, 0.0, 0.0], vec![0.0, 2.0, 0.0], vec![0.0, 0.0, 2.0]],
            R_diag: 2.0,
            H_rows: vec![0, 1, 2],
            xb: vec![-3.0, -6.5, 18.0],
            obs: BTreeMap::new(),
            xa: vec![-4.3, -5.0, 20.0],
            J_b: 0.0,
            J_min: 0.0,
            trPa: 0.0,
        };
        let mut model = twin.model().unwrap().unwrap();
        let (mut x, mut next) = (twin.xa.clone(), vec![0.0; 3]);
        for k in 0..steps {
            model.step(k, &x, &mut next).unwrap();
            std::mem::swap(&mut x, &mut next);
            if (k + 1) % 10 == 0 {
                let y = x.iter().enumerate().map(|(c, x)| x + 2.0 * wave(3 * k + c, 9));
                twin.obs.insert(k + 1, y.collect());
            }
        }
        twin
    }

    #[test]
    fn growing_windows_find_the_minimum_of_a_long_chaotic_one() {
        let twin = lorenz63(600);
        let mut model = twin.model().unwrap();
        let b = Dense::new(3, &twin.B.concat()).unwrap();
        let transform = ControlTransform::new(twin.xb.clone(), &b).unwrap();
        let mut all = twin.observations(twin.K).unwrap();
        let mut value = |model: &mut AnyModel, v: &[f64]| {
            cost(model, &transform, &mut all).unwrap().evaluate(v, None).unwrap()
        };

        // Where one would be sure to end: from the truth.
        let increment: Vec<f64> = twin.xa.iter().zip(&twin.xb).map(|(a, b)| a - b).collect();
        let mut reference = vec![0.0; 3];
        b.whiten(&increment, &mut reference);
        let mut set = twin.observations(twin.K).unwrap();
        let (best, _) =
            super::super::minimize(&mut cost(&mut model, &transform, &mut set).unwrap(), &mut reference)
                .unwrap();

        // Straight from the background this problem ends elsewhere: it is a test of what follows.
        let mut v = vec![0.0; 3];
        let (straight, _) =
            super::super::minimize(&mut cost(&mut model, &transform, &mut set).unwrap(), &mut v).unwrap();
        assert!(straight.value > 2.0 * best.value, "{} and {}", straight.value, best.value);

        let mut v = vec![0.0; 3];
        let how = minimize(&twin, &mut model, &transform, &mut v).unwrap();
        let found = value(&mut model, &v);
        assert!((found - best.value).abs() <= 1e-8 * best.value, "{found} and {}: {how}", best.value);
    }
}
