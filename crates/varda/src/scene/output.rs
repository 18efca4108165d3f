//! `[output]`: which files a run leaves.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Which files a run leaves beside its tables, figures and report.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Output {
    /// Formats of the numbers: "csv", "netcdf" (result.nc), "npz" (result.npz), "vtk" (result.pvd, of rods).
    /// Tables in CSV are always written, whether they are named or not.
    pub formats: Vec<Format>,
}

/// A format of results.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// Comma-separated tables.
    Csv,
    /// One NetCDF file (classic, 64-bit offsets) with the names and units of the CF conventions.
    Netcdf,
    /// One archive of NumPy arrays.
    Npz,
    /// The rod at every step as a VTK unstructured grid, and a collection of them with their times.
    Vtk,
}

impl Default for Output {
    fn default() -> Self {
        Output { formats: vec![Format::Csv] }
    }
}

impl Output {
    /// Whether there is any format beside CSV.
    pub fn is_more_than_csv(&self) -> bool {
        self.formats.iter().any(|format| *format != Format::Csv)
    }
}
