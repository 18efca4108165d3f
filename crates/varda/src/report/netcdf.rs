//! NetCDF: the classic format with 64-bit offsets, which every NetCDF library reads.

use std::io::{Error, Write};

use netcdf_writer::{DimensionId, NcAttrValue, NcFileBuilder, NcWriteOptions, VariableId};

use super::dataset::{Array, Dataset, Values};

/// Writes a result as one file.
///
/// # Errors
/// Those of the file; an array of more than 4 GB, which the format has no room for.
pub(super) fn write(data: Dataset, file: &mut dyn Write) -> Result<(), Error> {
    build(data)
        .and_then(|builder| builder.write(file, NcWriteOptions::offset64()))
        .map(|_| ())
        .map_err(Error::other)
}

/// The file in memory; each array is gone when it is in it.
fn build(data: Dataset) -> netcdf_writer::Result<NcFileBuilder> {
    let mut file = NcFileBuilder::new();
    for (name, text) in data.attributes {
        file.add_attribute(name, NcAttrValue::Chars(text))?;
    }
    let mut known: Vec<(String, DimensionId)> = Vec::new();
    let mut dimension = |file: &mut NcFileBuilder, name: &str, length: usize| {
        if let Some((_, id)) = known.iter().find(|(known, _)| known == name) {
            return Ok(*id);
        }
        let id = file.add_dimension(name, length as u64)?;
        known.push((name.to_string(), id));
        netcdf_writer::Result::Ok(id)
    };
    for array in data.arrays {
        let mut dimensions = Vec::new();
        for (name, length) in array.dimensions.iter().zip(&array.shape) {
            dimensions.push(dimension(&mut file, name, *length)?);
        }
        let variable = match &array.values {
            Values::Floats(values) => {
                let variable = file.add_variable::<f64>(array.name.as_str(), &dimensions)?;
                file.write_variable(variable, values)?;
                if values.iter().any(|value| value.is_nan()) {
                    let missing = NcAttrValue::Doubles(vec![f64::NAN]);
                    file.add_variable_attribute(variable, "_FillValue", missing)?;
                }
                variable
            }
            Values::Integers(values) => {
                let variable = file.add_variable::<i32>(array.name.as_str(), &dimensions)?;
                file.write_variable(variable, values)?;
                variable
            }
            Values::Texts(texts) => {
                let width = texts.iter().map(String::len).max().unwrap_or(0).max(1);
                dimensions.push(dimension(&mut file, &format!("text{width}"), width)?);
                let variable = file.add_char_variable(array.name.as_str(), &dimensions)?;
                file.write_char_variable_strings(variable, texts)?;
                file.add_variable_attribute(variable, "_Encoding", NcAttrValue::Chars("utf-8".into()))?;
                variable
            }
        };
        describe(&mut file, variable, &array)?;
    }
    Ok(file)
}

fn describe(file: &mut NcFileBuilder, variable: VariableId, array: &Array) -> netcdf_writer::Result<()> {
    // what the CF conventions call it
    let standard = match array.name.as_str() {
        "member" => "realization",
        _ => "",
    };
    let said = [
        ("long_name", array.long_name.as_str()),
        ("standard_name", standard),
        ("units", array.unit),
        ("coordinates", array.coordinates),
    ];
    for (name, text) in said.into_iter().filter(|(_, text)| !text.is_empty()) {
        file.add_variable_attribute(variable, name, NcAttrValue::Chars(text.to_string()))?;
    }
    Ok(())
}
