//! Small twin problems with known minima.

use super::fixture::{Fixture, expect_length, expect_size};
use super::upwind::Upwind;
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
    /// Numbers, booleans or text; those that a model does not know are ignored.
    #[serde(default)]
    parameters: BTreeMap<String, serde_json::Value>,
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
        let parameter = |key: &str| match parameters.get(key) {
            None => Err(format!("model.parameters.{key} is missing")),
            Some(value) => value.as_f64().ok_or(format!("model.parameters.{key} is {value}, not a number")),
        };
        let by = |known: &str| match integrator.as_deref() {
            Some(integrator) if integrator == known => Ok(()),
            other => Err(format!("unknown integrator {other:?} of model {name:?} (known: {known})")),
        };
        let dt = || dt.filter(|dt| *dt > 0.0).ok_or("model.dt is not a positive number");
        if parameters.get("n").and_then(|n| n.as_f64()).is_some_and(|n| n != self.n as f64) {
            return Err(format!("model.parameters.n does not fit n = {}", self.n).into());
        }
        match name.as_str() {
            "none" => Ok(None),
            "lorenz63" => {
                by("rk4")?;
                expect_length("xb of lorenz63", self.n, 3)?;
                let rhs =
                    Lorenz63 { sigma: parameter("sigma")?, rho: parameter("rho")?, beta: parameter("beta")? };
                Ok(Some(Box::new(Rk4::new(rhs, 0, dt()?))))
            }
            "lorenz96" => {
                by("rk4")?;
                if self.n < 4 {
                    return Err(format!("lorenz96 needs n of at least 4, not {}", self.n).into());
                }
                Ok(Some(Box::new(Rk4::new(Lorenz96::new(self.n, parameter("forcing")?), 0, dt()?))))
            }
            "linear-advection-diffusion" => {
                by("explicit-euler-upwind")?;
                let (courant, nu) = (parameter("courant")?, parameter("nu")?);
                Ok(Some(Box::new(Upwind { n: self.n, courant, nu })))
            }
            _ => {
                let known = "none, lorenz63, lorenz96, linear-advection-diffusion";
                Err(format!("unknown model {name:?} (known: {known})").into())
            }
        }
    }

    /// The observations up to and including step `last`.
    fn observations(&self, last: usize) -> Result<ObservationSet, Box<dyn Error>> {
        let observation = |(&step, values): (&usize, &Vec<f64>)| {
            let rows = (0..values.len()).collect();
            Observation::new(step, rows, values.clone(), self.R_diag.sqrt())
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
    let distance = super::fixture::norm(&whitened);
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
    let twin = Twin::read(&super::fixture::shipped().join("twin").join(name).with_extension("json"))?;
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
/// At the right minimum 2J is about m, give or take a few √(2m). A minimum that fails this is a false one,
/// as chaotic models have in long windows; then windows that grow by one observation time (Pires, Vautard and
/// Talagrand 1996) are tried too, and the lower J is kept.
fn minimize(
    twin: &Twin,
    model: &mut AnyModel,
    transform: &ControlTransform,
    v: &mut Vec<f64>,
) -> Result<String, Box<dyn Error>> {
    let mut growing = v.clone();
    let mut all = twin.observations(twin.K)?;
    let m = all.dim() as f64;
    let (best, how) = super::minimum::minimize(&mut cost(model, transform, &mut all)?, v)?;
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
            Ok(super::minimum::describe(&found, "through growing windows"))
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
                parameters: parameters.map(|(k, v)| (k.to_string(), v.into())).into(),
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

    /// Advection–diffusion seen without noise from the background: the minimum is the background, with J =
    /// 0 there.
    fn advection(courant: serde_json::Value) -> Twin {
        let n = 8;
        let xb: Vec<f64> = (0..n).map(|i| wave(i, 3)).collect();
        let parameters = [("courant", courant), ("nu", 0.05.into()), ("periodic", true.into())];
        Twin {
            model: ModelFields {
                name: "linear-advection-diffusion".into(),
                parameters: parameters.map(|(k, v)| (k.to_string(), v)).into(),
                integrator: Some("explicit-euler-upwind".into()),
                dt: Some(1.0),
            },
            n,
            K: 4,
            B: (0..n).map(|i| (0..n).map(|j| f64::from(u8::from(i == j))).collect()).collect(),
            R_diag: 0.01,
            H_rows: vec![0, 3],
            xa: xb.clone(),
            xb,
            obs: BTreeMap::new(),
            J_b: 0.0,
            J_min: 0.0,
            trPa: 0.0,
        }
    }

    #[test]
    fn parameters_may_be_booleans_and_text_but_not_where_a_number_is_needed() {
        let text = r#"{"name": "linear-advection-diffusion", "dt": 1, "integrator": "explicit-euler-upwind",
            "parameters": {"courant": 0.5, "nu": 0.1, "periodic": true, "scheme": "upwind"}}"#;
        let model: ModelFields = serde_json::from_str(text).unwrap();
        assert_eq!(model.parameters.len(), 4);
        let mut twin = advection(0.5.into());
        twin.model = model;
        let model = twin.model().unwrap().unwrap();
        assert_eq!(model.dim(), 8);
        let error = advection("a half".into()).model().err().unwrap().to_string();
        assert!(error.contains("courant") && error.contains("not a number"), "{error}");
        twin.model.integrator = Some("rk4".into());
        assert!(twin.model().err().unwrap().to_string().contains("unknown integrator"));
    }

    #[test]
    fn advection_is_minimized_to_its_truth() {
        let mut twin = advection(0.4.into());
        let (mut x, mut next) = (twin.xb.clone(), vec![0.0; twin.n]);
        let mut model = twin.model().unwrap();
        for k in 0..twin.K {
            model.as_mut().unwrap().step(k, &x, &mut next).unwrap();
            std::mem::swap(&mut x, &mut next);
            twin.obs.insert(k + 1, twin.H_rows.iter().map(|&i| x[i]).collect());
        }
        twin.xb.iter_mut().for_each(|x| *x += 0.3);
        let b = Dense::new(twin.n, &twin.B.concat()).unwrap();
        let transform = ControlTransform::new(twin.xb.clone(), &b).unwrap();
        let mut v = vec![0.0; twin.n];
        let before = {
            let mut all = twin.observations(twin.K).unwrap();
            cost(&mut model, &transform, &mut all).unwrap().evaluate(&v, None).unwrap()
        };
        minimize(&twin, &mut model, &transform, &mut v).unwrap();
        let mut all = twin.observations(twin.K).unwrap();
        let mut g = vec![0.0; twin.n];
        let mut cost = cost(&mut model, &transform, &mut all).unwrap();
        let after = cost.evaluate(&v, Some(&mut g)).unwrap();
        assert!(after < 0.1 * before && g.iter().all(|g| g.abs() < 1e-9), "{before} {after} {g:?}");
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
        let (best, _) = super::super::minimum::minimize(
            &mut cost(&mut model, &transform, &mut set).unwrap(),
            &mut reference,
        )
        .unwrap();

        // Straight from the background this problem ends elsewhere: it is a test of what follows.
        let mut v = vec![0.0; 3];
        let (straight, _) =
            super::super::minimum::minimize(&mut cost(&mut model, &transform, &mut set).unwrap(), &mut v)
                .unwrap();
        assert!(straight.value > 2.0 * best.value, "{} and {}", straight.value, best.value);

        let mut v = vec![0.0; 3];
        let how = minimize(&twin, &mut model, &transform, &mut v).unwrap();
        let found = value(&mut model, &v);
        assert!((found - best.value).abs() <= 1e-8 * best.value, "{found} and {}: {how}", best.value);
    }
}
