//! NPZ: the arrays of NumPy in one archive, without compression.

use std::io::{Error, Write};

use rawzip::{CompressionMethod, ZipArchiveWriter};

use super::dataset::{Dataset, Values};

/// Writes a result as one archive: an array a member, and `about`, a JSON text with the attributes and with
/// dimensions, unit and name of every array.
///
/// # Errors
/// Those of the file.
pub(super) fn write(data: &Dataset, file: &mut dyn Write) -> Result<(), Error> {
    let mut archive = ZipArchiveWriter::new(file);
    let about = about(data);
    let all = data.arrays.iter().map(|array| (array.name.as_str(), &array.shape[..], &array.values));
    let about = Values::Texts(vec![about]);
    for (name, shape, values) in all.chain([("about", &[][..], &about)]) {
        let name = format!("{name}.npy");
        let (mut entry, config) = archive
            .new_file(&name)
            .compression_method(CompressionMethod::STORE)
            .start()
            .map_err(Error::other)?;
        let mut writer = config.wrap(&mut entry);
        write_array(shape, values, &mut writer)?;
        let (_, written) = writer.finish().map_err(Error::other)?;
        entry.finish(written).map_err(Error::other)?;
    }
    archive.finish().map_err(Error::other)?.flush()
}

fn about(data: &Dataset) -> String {
    let attributes: serde_json::Map<_, _> =
        data.attributes.iter().map(|(name, text)| (name.to_string(), text.as_str().into())).collect();
    let array = |array: &super::dataset::Array| {
        let said = serde_json::json!({
            "dimensions": array.dimensions, "unit": array.unit, "long_name": array.long_name,
        });
        (array.name.clone(), said)
    };
    let arrays: serde_json::Map<_, _> = data.arrays.iter().map(array).collect();
    serde_json::json!({ "attributes": attributes, "arrays": arrays }).to_string()
}

/// An array in NumPy's format, version 1.0.
fn write_array(shape: &[usize], values: &Values, file: &mut impl Write) -> Result<(), Error> {
    let width = match values {
        Values::Texts(texts) => texts.iter().map(|text| text.chars().count()).max().unwrap_or(0).max(1),
        _ => 0,
    };
    let kind = match values {
        Values::Floats(_) => "<f8".to_string(),
        Values::Integers(_) => "<i4".to_string(),
        Values::Texts(_) => format!("<U{width}"),
    };
    let shape: String = shape.iter().map(|n| format!("{n},")).collect();
    let mut header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({shape}), }}");
    // magic, version, length of the header, header and a line's end: a multiple of 64 bytes
    let before = 10;
    let padded = (before + header.len() + 1).next_multiple_of(64);
    header.push_str(&" ".repeat(padded - before - header.len() - 1));
    header.push('\n');
    file.write_all(b"\x93NUMPY\x01\x00")?;
    file.write_all(&(header.len() as u16).to_le_bytes())?;
    file.write_all(header.as_bytes())?;
    match values {
        Values::Floats(values) => values.iter().try_for_each(|value| file.write_all(&value.to_le_bytes())),
        Values::Integers(values) => values.iter().try_for_each(|value| file.write_all(&value.to_le_bytes())),
        Values::Texts(texts) => texts.iter().try_for_each(|text| {
            let padded = text.chars().map(u32::from).chain(std::iter::repeat(0)).take(width);
            padded.into_iter().try_for_each(|code| file.write_all(&code.to_le_bytes()))
        }),
    }
}
