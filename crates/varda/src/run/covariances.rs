//! Some blocks of B and of P_a, to be looked at.

use varda_covariance::Covariance;

use crate::outcome::CovarianceBlock;
use crate::solve::PosteriorSpread;
use crate::state::{StateGroup, StateLayout};

/// Most rows of a block; of more numbers, evenly spaced ones are shown.
const MOST_ROWS: usize = 40;
/// Most multiplications: beyond, nothing is shown, so that a picture never takes longer than a few
/// milliseconds.
const MOST_WORK: usize = 30_000_000;

/// The blocks B_cc and P_cc of every component c of positions and velocities of a rod, or of the state of
/// another model; empty without the root of a posterior.
pub(super) fn covariances(
    layout: &StateLayout,
    covariance: &dyn Covariance,
    spread: Option<&PosteriorSpread>,
) -> Vec<CovarianceBlock> {
    let Some(spread) = spread.filter(|s| !s.root.is_empty()) else { return Vec::new() };
    let n = layout.len();
    if covariance.dim() != n {
        return Vec::new();
    }
    let columns = spread.root.len() / n;
    let groups: Vec<&StateGroup> =
        layout.groups.iter().filter(|g| g.part().is_none() || g.width == 3).collect();
    let rows_of = |group: &StateGroup| {
        let vectors = group.range.len() / group.width;
        let shown = vectors.min(MOST_ROWS);
        let at = move |i: usize| if shown < 2 { 0 } else { i * (vectors - 1) / (shown - 1) };
        (0..shown).map(at).collect::<Vec<usize>>()
    };
    let work: usize = groups.iter().map(|g| g.width * rows_of(g).len() * (MOST_ROWS * columns + n)).sum();
    if work > MOST_WORK {
        return Vec::new();
    }
    let mut blocks = Vec::new();
    for group in groups {
        let vectors = rows_of(group);
        for c in 0..group.width {
            let rows: Vec<usize> = vectors.iter().map(|i| group.range.start + group.width * i + c).collect();
            let root = |row: usize| (0..columns).map(move |j| spread.root[j * n + row]);
            let posterior = rows
                .iter()
                .flat_map(|a| rows.iter().map(|b| root(*a).zip(root(*b)).map(|(x, y)| x * y).sum::<f64>()));
            let mut prior = Vec::new();
            for row in &rows {
                let (mut unit, mut column) = (vec![0.0; n], vec![0.0; n]);
                unit[*row] = 1.0;
                covariance.apply(&unit, &mut column);
                prior.extend(rows.iter().map(|r| column[*r]));
            }
            let place = |i: &usize| layout.geometry.as_ref().map_or(*i as f64, |g| g.place(group, *i));
            blocks.push(CovarianceBlock {
                group: group.name,
                component: if group.width == 3 { ["x", "y", "z"][c] } else { "" },
                unit: group.unit,
                places: vectors.iter().map(place).collect(),
                prior,
                posterior: posterior.collect(),
            });
        }
    }
    blocks
}
