//! VTK: a rod at every step as an unstructured grid of lines in XML, and a collection with their times.

use std::fmt::Write as _;
use std::io::{Error, Write};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::dataset::{Dataset, Values};

/// VTK's number of a cell that is one line.
const LINE: u8 = 3;

/// A step that has a file.
pub(super) struct Step {
    /// Its number.
    pub(super) number: usize,
    /// Its time \[s\].
    pub(super) time: f64,
    /// The name of its file, as the collection has it.
    pub(super) file: String,
}

/// The steps at which the rod is known.
pub(super) fn steps(data: &Dataset) -> Vec<Step> {
    let (times, positions) =
        (data.floats("time").unwrap_or_default(), data.floats("position").unwrap_or_default());
    let length = positions.len() / times.len().max(1);
    let known = |number: usize| positions[number * length..][..length].iter().all(|x| x.is_finite());
    let step = |(number, time): (usize, &f64)| Step {
        number,
        time: *time,
        file: format!("vtk/step-{number:06}.vtu"),
    };
    times.iter().enumerate().filter(|(number, _)| length > 0 && known(*number)).map(step).collect()
}

/// The collection: which file belongs to which time.
pub(super) fn collection(steps: &[Step]) -> String {
    let mut out = format!(
        "{}<VTKFile type=\"Collection\" version=\"1.0\" byte_order=\"LittleEndian\">\n  <Collection>\n",
        XML
    );
    for step in steps {
        let _ = writeln!(out, "    <DataSet timestep=\"{}\" part=\"0\" file=\"{}\"/>", step.time, step.file);
    }
    out.push_str("  </Collection>\n</VTKFile>\n");
    out
}

const XML: &str = "<?xml version=\"1.0\"?>\n";

/// The grid of a step. Arrays along the vertices are point data, arrays along the edges cell data; moments,
/// which are those between two edges, are point data that the two ends do not have.
///
/// # Errors
/// Those of the file.
pub(super) fn write_step(data: &Dataset, step: &Step, file: &mut dyn Write) -> Result<(), Error> {
    let positions = at_step(data, "position", step).unwrap_or_default();
    let vertices = positions.len() / 3;
    let edges = vertices.saturating_sub(1);
    let [mut points, mut cells] = [String::new(), String::new()];
    for array in data.arrays.iter().filter(|array| array.dimensions.first() == Some(&"time")) {
        let Some(values) = at_step(data, &array.name, step) else { continue };
        let width = array.shape.iter().skip(2).product();
        match array.dimensions.get(1) {
            Some(&"s") if array.name != "position" => float_array(&mut points, &array.name, width, values),
            Some(&"s_edge") => float_array(&mut cells, &array.name, width, values),
            Some(&"s_inner") => {
                let end = vec![f64::NAN; width];
                float_array(&mut points, &array.name, width, &[&end, values, &end].concat());
            }
            _ => {}
        }
    }
    if let Some(velocity) = at_step(data, "velocity", step) {
        let speed: Vec<f64> =
            velocity.chunks(3).map(|v| v.iter().map(|c| c * c).sum::<f64>().sqrt()).collect();
        float_array(&mut points, "speed", 1, &speed);
    }
    for (name, from) in [("displacement_from_background", "position_background"), ("error", "position_truth")]
    {
        if let Some(from) = at_step(data, from, step) {
            let difference: Vec<f64> = positions.iter().zip(from).map(|(x, from)| x - from).collect();
            float_array(&mut points, name, 3, &difference);
        }
    }
    let mut places = String::new();
    float_array(&mut places, "position", 3, positions);
    let ends = (0..edges as i64).flat_map(|e| [e, e + 1]);
    let mut lines = String::new();
    data_array(&mut lines, "Int64", "connectivity", 1, ends.flat_map(i64::to_le_bytes));
    data_array(&mut lines, "Int64", "offsets", 1, (1..=edges as i64).flat_map(|e| (2 * e).to_le_bytes()));
    data_array(&mut lines, "UInt8", "types", 1, std::iter::repeat_n(LINE, edges));
    let time = format!(
        "<DataArray type=\"Float64\" Name=\"TimeValue\" NumberOfTuples=\"1\" \
         format=\"ascii\">{}</DataArray>",
        step.time
    );
    write!(
        file,
        "{XML}<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\" \
         header_type=\"UInt64\">\n<UnstructuredGrid>\n<FieldData>\n{time}\n</FieldData>\n<Piece \
         NumberOfPoints=\"{vertices}\" NumberOfCells=\"{edges}\">\n<Points>\n{places}</Points>\n<Cells>\n\
         {lines}</Cells>\n<PointData>\n{points}</PointData>\n<CellData>\n{cells}</CellData>\n</Piece>\n\
         </UnstructuredGrid>\n</VTKFile>\n"
    )
}

/// The values of an array at a step.
fn at_step<'a>(data: &'a Dataset, name: &str, step: &Step) -> Option<&'a [f64]> {
    let array = data.arrays.iter().find(|array| array.name == name)?;
    let length = array.shape[1..].iter().product();
    match &array.values {
        Values::Floats(values) => values.get(step.number * length..)?.get(..length),
        _ => None,
    }
}

fn float_array(out: &mut String, name: &str, width: usize, values: &[f64]) {
    data_array(out, "Float64", name, width, values.iter().flat_map(|value| value.to_le_bytes()));
}

/// An array in base64, which reads back to the same bits and knows NaN, behind the number of its bytes.
fn data_array(out: &mut String, kind: &str, name: &str, width: usize, bytes: impl Iterator<Item = u8>) {
    let mut all = vec![0; size_of::<u64>()];
    all.extend(bytes);
    let length = (all.len() - size_of::<u64>()) as u64;
    all[..size_of::<u64>()].copy_from_slice(&length.to_le_bytes());
    let _ = writeln!(
        out,
        "<DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{width}\" \
         format=\"binary\">{}</DataArray>",
        STANDARD.encode(all)
    );
}
