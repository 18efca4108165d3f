//! Observed components of the state of a model that is not a rod.

use varda_assimilation::{ObservationOperator, Selection};
use varda_implicit::ParameterPlaces;

use super::components::ComponentSystem;
use super::files::Files;
use super::observations::{Draws, Observed, Site};
use super::seen_with::SeenWith;
use crate::Error;
use crate::scene::{Synthetic, TimeGrid};

/// The components that a twin experiment observes; their values are not yet drawn.
pub(crate) fn synthetic(
    files: &Files,
    keys: &Synthetic,
    system: &ComponentSystem,
    grid: TimeGrid,
) -> Result<Observed, Error> {
    let n = system.names.len();
    let components: Vec<usize> =
        if keys.components.is_empty() { (0..n).collect() } else { keys.components.clone() };
    let site = |(row, &c): (usize, &usize)| Site {
        label: system.names[c].clone(),
        rows: row..row + 1,
        anchors: vec![c],
        withheld: false,
    };
    let steps = files.scene.checked(keys.observed_steps(grid.steps))?;
    let sigma = files.scene.checked(keys.component_sigma())?;
    let (constants, seeing) = (system.estimates.len(), system.estimates.seen);
    Ok(Observed {
        sites: components.iter().enumerate().map(site).collect(),
        seen: Vec::new(),
        space: None,
        left_out: Vec::new(),
        recording: None,
        make_operator: Box::new(move || {
            let selection = Box::new(Selection::new(components.clone(), n)?);
            let operator: Box<dyn ObservationOperator> = match constants {
                0 => selection,
                _ => {
                    let places = ParameterPlaces::of_state(n, constants, n, 0);
                    Box::new(SeenWith::new(selection, places, seeing))
                }
            };
            Ok(operator)
        }),
        draws: Some(Draws { steps, sigma }),
    })
}
