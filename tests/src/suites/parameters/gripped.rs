//! Six constants of a cable between two grippers, recorded by another program, from half of its markers.

use problems::recordings::{CABLE_CONSTANTS, CABLE_PRIORS};
use varda::outcome::Verdict;
use varda::run::{Listener, assimilate};
use varda::setup::Problem;

use crate::row::{Case, Outcome, Rows};
use crate::suites::gripped_cable::gripped_cable;

pub(super) fn run(rows: &mut Rows) {
    rows.area("gripped cable");
    rows.case("six constants from half of the markers", gripped);
}

fn gripped(case: &mut Case) -> Outcome {
    let problem = Problem::from_scene(&gripped_cable(0.0, &CABLE_PRIORS)?)?;
    let ended = assimilate(&problem, &mut Listener::silent())?;
    for (name, truth) in CABLE_CONSTANTS {
        let e = ended.estimates.iter().find(|e| e.name == name).ok_or(format!("no estimate of {name}"))?;
        let (sigma, on_mesh) = (e.sigma.ok_or("no σ")?, e.sigma_on_mesh.ok_or("no σ")?);
        case.at_most(
            &format!("{name}: off the constant it was made with"),
            (e.value - truth).abs() / sigma,
            3.0,
            "σ",
        )
        .because("σ of the observations and of the mesh")
        .note(format!("{:.5} ± {sigma:.5}, of it {on_mesh:.5} without the mesh", e.value))
        .computed(e.value);
    }
    let (mut count, mut inside) = (0.0, 0.0);
    for seen in ended.observed.iter().filter(|seen| seen.reason == "withheld") {
        let sigma = seen.sigma_analysis.ok_or("no σ of a withheld coordinate")?.hypot(seen.sigma);
        count += 1.0;
        inside += f64::from(u8::from((seen.value - seen.analysis).abs() <= 1.96 * sigma));
    }
    case.at_most("covered, off 0.945", (inside / count - 0.945_f64).abs(), 0.045, "-")
        .computed(inside / count)
        .note(format!("{count} coordinates"))
        .because("90 to 99 % of coordinates kept back within 1.96 σ");
    case.at_most("does not fit", f64::from(u8::from(ended.judgement.verdict != Verdict::Fits)), 0.0, "-")
        .note(ended.judgement.text.clone())
        .because("σ supposes a fit");
    case.inform("seconds", ended.seconds.total, "s");
    case.inform("of it for the finer mesh", ended.seconds.mesh, "s");
    Ok(())
}
