//! 4D-EnVar with an ensemble that spans is linear 4D-Var; the hybrid at weights 0 and 1 is its pure ends.

use super::common::{gap, go_on};
use crate::row::{Case, Outcome, Rows};
use problems::small_problems::{
    RING, all_of, coupled, difference, localized, normals, observation, ring, ring_model, spanning,
};
use std::error::Error;
use varda_assimilation::{
    ControlTransform, CostFunction, EnVar, EnVarOptions, EnsembleUpdate, NewtonOptions, ObservationSet,
    Posterior, Stopping, StrongConstraint, newton,
};
use varda_covariance::{Ensemble, Hybrid, Localization};
use varda_implicit::lorenz::Lorenz96;
use varda_implicit::{Model, Rk4};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

pub(super) fn rows(rows: &mut Rows) {
    rows.case("linear ring", spans);
    rows.case("lorenz96, 6 variables", ends);
}

const LINEARIZED: &str = "differences of runs by an ensemble lose half of the digits: √ε, rounded down";
const GUARD: &str = "what must differ differs by more than a million times what is asked of what must agree";

const TIGHT: Stopping = Stopping::new(1e-13, 10);

fn spans(case: &mut Case) -> Outcome {
    let b = coupled(RING, 0.8)?;
    let background = normals(1, RING);
    let strong = |seed: u64| -> Result<(Vec<f64>, Vec<f64>, f64)> {
        let (mut model, mut set) = (ring_model(), ring(&normals(seed, 12))?);
        let transform = ControlTransform::new(background.clone(), &b)?;
        let mut cost = StrongConstraint::new(&mut model, transform.clone(), &mut set)?;
        let mut v = vec![0.0; RING];
        let minimum = newton(&mut cost, &mut v, &NewtonOptions::default().with_stopping(TIGHT), &mut go_on)?;
        let mut z = vec![0.0; RING];
        transform.control(&v, &mut z);
        Ok((z, Posterior::new(&mut cost)?.variance(&transform), minimum.value))
    };
    let (expected, variance, value) = strong(2)?;
    let ensemble = Ensemble::new(&spanning(&b, &background), Localization::none(RING))?;
    let make = || -> Box<dyn Model + Send> { Box::new(ring_model()) };
    let mut set = ring(&normals(2, 12))?;
    let mut cost = EnVar::new(&make, background.clone(), &ensemble, &mut set, &[])?;
    let mut v = vec![0.0; cost.dim()];
    let options = EnVarOptions::default().with_max_outer(1);
    let minimum = cost.minimize(&mut v, &options, &mut go_on)?;
    let mut z = vec![0.0; RING];
    cost.transform().control(&v, &mut z);
    case.reason(LINEARIZED);
    case.at_most("4denvar = 4dvar: analysis", difference(&z, &expected), 1e-8, "-");
    case.at_most("4denvar = 4dvar: J", gap(minimum.value, value), 1e-8, "-").computed(minimum.value);
    let columns = cost.posterior_perturbations(&mut EnsembleUpdate::SquareRoot)?;
    let by_root: Vec<f64> = (0..RING).map(|p| columns.chunks(RING).map(|x| x[p] * x[p]).sum()).collect();
    case.at_most("4denvar = 4dvar: posterior variance", difference(&by_root, &variance), 1e-8, "-");
    let other = difference(&strong(3)?.0, &expected);
    case.at_most("guard: 1e-2 / |Δ| for other observations", 1e-2 / other, 1.0, "-").because(GUARD);
    Ok(())
}

fn make() -> Box<dyn Model + Send> {
    Box::new(Rk4::new(Lorenz96::new(RING, 8.0), 0, 0.03))
}

fn ends(case: &mut Case) -> Outcome {
    let static_part = coupled(RING, 0.4)?;
    let ensemble = localized()?;
    let background = normals(5, RING);
    let anchors = [0, 2, 5].repeat(4);
    let solved = |cost: &mut EnVar| -> Result<Vec<f64>> {
        let mut v = vec![0.0; cost.dim()];
        cost.solve(&mut v)?;
        let mut z = vec![0.0; RING];
        cost.transform().control(&v, &mut z);
        Ok(z)
    };
    let hybrid = |of_static: f64, of_ensemble: f64| -> Result<(Vec<f64>, Vec<f64>)> {
        let hybrid = Hybrid::new(&static_part, of_static, ensemble.clone(), of_ensemble)?;
        let mut set = ring(&normals(6, 12))?;
        let mut cost = EnVar::hybrid(&make, background.clone(), &hybrid, &mut set, &anchors)?;
        let z = solved(&mut cost)?;
        Ok((z, cost.whitened_innovations().to_vec()))
    };
    let mut set = ring(&normals(6, 12))?;
    let pure = solved(&mut EnVar::new(&make, background.clone(), &ensemble, &mut set, &anchors)?)?;
    case.reason(LINEARIZED);
    case.at_most("hybrid at weights 0, 1 = 4denvar", difference(&hybrid(0.0, 1.0)?.0, &pure), 1e-8, "-");

    // Nothing moves with the window but the innovations: 3D-Var of the increment with those of the run
    // (3D-FGAT).
    let (found, innovations) = hybrid(1.0, 0.0)?;
    let sigma: Vec<f64> = (0..12).map(|i| 0.3 + 0.1 * f64::from(i / 3)).collect();
    let values: Vec<f64> = innovations.iter().zip(&sigma).map(|(d, s)| d * s).collect();
    let mut at_once = observation(&anchors, 0, 0.0, &values, 1.0);
    at_once.sigma = sigma;
    let mut set = ObservationSet::new(0, vec![all_of(RING)?], vec![at_once])?;
    let transform = ControlTransform::new(background.clone(), &static_part)?;
    let about_zero = ControlTransform::new(vec![0.0; RING], &static_part)?;
    let mut cost = StrongConstraint::without_model(about_zero, &mut set)?;
    let mut v = vec![0.0; RING];
    newton(&mut cost, &mut v, &NewtonOptions::default().with_stopping(TIGHT), &mut go_on)?;
    let mut fgat = vec![0.0; RING];
    transform.control(&v, &mut fgat);
    case.at_most(
        "hybrid at weights 1, 0 = 3dvar with the window's innovations",
        difference(&found, &fgat),
        1e-8,
        "-",
    );
    let mixed = difference(&hybrid(0.6, 0.8)?.0, &pure).min(difference(&hybrid(0.6, 0.8)?.0, &fgat));
    case.at_most("guard: 1e-2 / |Δ| of a mixture from either end", 1e-2 / mixed, 1.0, "-").because(GUARD);
    Ok(())
}
