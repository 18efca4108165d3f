//! What grows with the size of a scene, and how fast.

use super::Options;
use crate::row::{Case, Outcome, Row, Rows};
use problems::allocations::heap;
use problems::long_rod::{self, slope};
use varda::outcome::Status;
use varda::run::{Listener, assimilate};
use varda::scene::SceneFile;
use varda::setup::{Plan, Problem};

pub(super) fn run(options: &Options) -> Vec<Row> {
    let mut rows = Rows::new("scaling").of(options);
    let sizes: &[usize] = if options.quick { &[600, 2400] } else { &[1250, 5000, 20_000] };
    rows.case("a rod of many segments", |case| many_segments(case, sizes));
    rows.finish()
}

/// B by recursion, a Krylov minimizer, a posterior of low rank: no n × n anywhere.
fn many_segments(case: &mut Case, sizes: &[usize]) -> Outcome {
    let (mut peaks, mut factorizations) = (Vec::new(), Vec::new());
    for &segments in sizes {
        let sets = long_rod::segments(segments);
        let file = SceneFile::parse("long-rod", "long-rod.toml", long_rod::SCENE, None, &sets)?;
        let said = Plan::new(&file)?.bytes;
        let (memory, outcome) =
            heap(|| assimilate(&Problem::from_scene(&file)?, &mut Listener::silent()).map(|o| (o.status, o)));
        let (status, outcome) = outcome?;
        case.count(&format!("{segments} segments: converged"), usize::from(status == Status::Converged), 1);
        case.count(&format!("{segments} segments: a posterior"), usize::from(outcome.has_posterior), 1);
        // What check says counts the tables that are written afterwards, which are not in this heap.
        let of_said = memory.peak as f64 / said as f64;
        case.at_most(&format!("{segments} segments: heap"), of_said, 1.2, "of what is said")
            .because("`check` says within 20 % what a run takes");
        peaks.push((segments as f64, memory.peak as f64));
        factorizations.push((segments as f64, outcome.counts.factorizations as f64));
    }
    case.at_most("peak of the heap against segments", slope(&peaks), 1.05, "slope")
        .because("linear, and what does not grow makes it less; a matrix of n × n would make it 2");
    case.at_most("factorizations against segments", slope(&factorizations).abs(), 0.2, "slope")
        .because("the problem is that of the continuous rod: iterations do not depend on its segments");
    Ok(())
}
