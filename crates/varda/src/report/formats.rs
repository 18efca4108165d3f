//! Files of a result that other programs open.

use super::dataset::Dataset;
use super::folder::ResultFolder;
use super::{netcdf, npz, vtk};
use crate::Error;
use crate::scene::{Format, Output};

/// Writes a result in the formats that a scene asks for, with this in front of their names; `data` is made
/// only if there are such.
pub(super) fn write_formats(
    out: &ResultFolder,
    at: &str,
    output: &Output,
    data: impl FnOnce() -> Dataset,
) -> Result<(), Error> {
    if !output.is_more_than_csv() {
        return Ok(());
    }
    let data = data();
    let has = |format: Format| output.formats.contains(&format);
    if has(Format::Npz) {
        out.write_with(&format!("{at}result.npz"), |file| npz::write(&data, file))?;
    }
    if has(Format::Vtk) {
        let steps = vtk::steps(&data);
        for step in &steps {
            out.write_with(&format!("{at}{}", step.file), |file| vtk::write_step(&data, step, file))?;
        }
        out.write(&format!("{at}result.pvd"), &vtk::collection(&steps))?;
    }
    // last: it takes the arrays apart
    if has(Format::Netcdf) {
        out.write_with(&format!("{at}result.nc"), |file| netcdf::write(data, file))?;
    }
    Ok(())
}
