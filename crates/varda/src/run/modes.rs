//! Natural modes of the rod of a scene.

use crate::Error;
use crate::outcome::RodModes;
use crate::scene::SceneFile;
use crate::setup::Inputs;

/// The lowest `count` natural modes of the rod of a scene about its shape at rest, supports where they are at
/// the start of the window.
///
/// # Errors
/// [`Error::Scene`] where the model is not a rod, [`Error::Preparation`] where it finds no rest,
/// [`Error::Rod`].
pub fn modes(file: &SceneFile, count: usize) -> Result<RodModes, Error> {
    let inputs = Inputs::for_simulation(file)?;
    let Some(rod) = inputs.system.rod() else {
        return Err(file.invalid("model.kind", "only a rod has natural modes about its rest"));
    };
    let (parts, time) = (&rod.parts, inputs.grid.start);
    let rest = parts.at_rest(time)?;
    let found = varda_rod::modes(&parts.rod, &parts.supports, &parts.loads, time, &rest, count)?;
    Ok(RodModes {
        name: file.name.clone(),
        time,
        arc_lengths: parts.rod.arc_lengths(),
        vertices: rest.vertices.into_iter().map(Into::into).collect(),
        gyration: (parts.rod.spin_inertia.iter().sum::<f64>() / parts.rod.masses.iter().sum::<f64>()).sqrt(),
        spin_inertia: parts.rod.spin_inertia.clone(),
        found,
    })
}
