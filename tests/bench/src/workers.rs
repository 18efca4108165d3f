//! What a second model gains where the columns or rows of a dense Hessian are shared.

use super::{Options, Page, Result, Table};
use crate::cells;
use problems::rods::HangingRod;
use problems::small_problems::difference;
use std::time::Instant;
use varda_assimilation::{
    ControlTransform, CostFunction, GaussNewton, Observation, ObservationSet, Selection, StrongConstraint,
};
use varda_covariance::Diagonal;
use varda_implicit::{ImplicitModel, Model, OneLeg, Rk4, lorenz::Lorenz96};

const TEXT: &str = "\
Dense Gauss–Newton Hessians by the cost's own model alone, and with one further model that takes its share \
of the rows or columns (`StrongConstraint::set_workers`), which linearizes every step for itself. Time on \
the wall's clock, the least of one second of calls by turns: here two cores are meant to work. The results \
are the same bits.";

pub(super) fn run(options: &Options) -> Result<Page> {
    let names = ["problem", "n", "alone ms", "with one more ms", "of the time alone", "difference"];
    let mut table = Table::new("workers", "", &names);
    let (rod, truth) = HangingRod::flagship(1, true)?;
    let b = rod.background_covariance()?;
    let make = || -> Box<dyn Model + Send> { Box::new(rod.model(rod.first_step).expect("made before")) };
    let mut set = rod.observation_set(make().dim(), rod.observe(&truth, &mut || 0.5)?)?;
    row(&mut table, options, "flagship, by rows", &make, ControlTransform::new(truth, &b)?, &mut set)?;
    for n in if options.quick { [40].as_slice() } else { &[40, 200] } {
        lorenz96(&mut table, options, *n)?;
    }
    Ok(Page {
        title: "Sharing a dense Hessian between models",
        text: TEXT.into(),
        tables: vec![table],
        ..Page::default()
    })
}

type MakeModel<'a> = &'a dyn Fn() -> Box<dyn Model + Send>;

/// Windows of 20 steps: half of the variables seen at every second step (by columns), an eighth at the last
/// (by rows).
fn lorenz96(table: &mut Table, options: &Options, n: usize) -> Result<()> {
    let b = Diagonal::uniform(n, 0.5)?;
    let background: Vec<f64> = (0..n).map(|i| 3.0 + (1.7 * i as f64).sin()).collect();
    let rk4 = || -> Box<dyn Model + Send> { Box::new(Rk4::new(Lorenz96::new(n, 8.0), 0, 0.01)) };
    let midpoint = || -> Box<dyn Model + Send> {
        Box::new(ImplicitModel::new(OneLeg::implicit_midpoint(Lorenz96::new(n, 8.0), 1e-11), 0, 0.01))
    };
    let makes: [(&str, MakeModel); 2] = [("RK4", &rk4), ("midpoint", &midpoint)];
    for ((name, make), by) in makes.into_iter().flat_map(|m| [(m, "columns"), (m, "rows")]) {
        let (seen, first) = if by == "columns" { (n / 2, 2) } else { (n / 8, 20) };
        let observations = (first..=20).step_by(2).map(|step| Observation {
            operator: 0,
            values: vec![3.0; seen],
            sigma: vec![0.5; seen],
            rows: (0..seen).collect(),
            step,
            weight: 0.0,
            label: String::new(),
        });
        let all = Box::new(Selection::new((0..n).collect(), n)?);
        let mut set = ObservationSet::new(20, vec![all], observations.collect())?;
        let transform = ControlTransform::new(background.clone(), &b)?;
        row(table, options, &format!("Lorenz-96, {name}, by {by}"), make, transform, &mut set)?;
    }
    Ok(())
}

fn row(
    table: &mut Table,
    options: &Options,
    problem: &str,
    make: MakeModel,
    transform: ControlTransform,
    set: &mut ObservationSet,
) -> Result<()> {
    let mut model = make();
    let mut cost = StrongConstraint::new(&mut *model, transform, set)?;
    let n = cost.dim();
    cost.evaluate(&vec![0.0; n], Some(&mut vec![0.0; n]))?;
    let mut hessians = [vec![0.0; n * n], vec![0.0; n * n]];
    let mut least = [f64::INFINITY; 2];
    let (begun, enough) = (Instant::now(), if options.quick { 0.01 } else { 1.0 });
    while !(begun.elapsed().as_secs_f64() > enough) {
        for (further, (hessian, least)) in hessians.iter_mut().zip(&mut least).enumerate() {
            cost.set_workers(make, further)?;
            let since = Instant::now();
            cost.hessian(hessian)?;
            *least = least.min(since.elapsed().as_secs_f64());
        }
    }
    let [alone, with] = least;
    let differs = difference(&hessians[1], &hessians[0]);
    table.push(cells![problem, n, 1e3 * alone, 1e3 * with, with / alone, differs]);
    Ok(())
}
