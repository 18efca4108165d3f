//! Recordings of motion-capture systems, converted to Varda's own CSV.
//!
//! C3D files, and text files that Motive (OptiTrack), Nexus (Vicon) and programs of biomechanics (TRC)
//! export. The kind is told by the contents. What was not seen has no row.
//!
//! ```
//! use varda::convert::{Options, Up, read};
//!
//! let trc = "PathFileType\t4\t(X/Y/Z)\tcable.trc\n\
//!     DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n\
//!     100\t100\t2\t1\tmm\t100\t1\t2\n\
//!     Frame#\tTime\ttip\t\t\n\t\tX1\tY1\tZ1\n\n\
//!     1\t0.00\t100\t-500\t0\n2\t0.01\t101\t-501\t0\n";
//! let recording = read("cable.trc", trc.as_bytes(), &Options { up: Some(Up::Y), ..Options::default() })?;
//! let csv = recording.to_csv();
//! assert_eq!(csv.lines().nth(1), Some("0,tip,0.1,0,-0.5"));
//! # Ok::<(), varda::Error>(())
//! ```

mod c3d;
mod motive;
mod recording;
mod text;
mod trc;
mod vicon;

pub use recording::{Options, Recording, Track, Unit, Up};

use crate::Error;

/// Reads a recording; `file` is its name in messages.
///
/// # Errors
/// [`Error::Data`] naming file and line (or block of a C3D file) and what is wrong, or listing the kinds that
/// are known.
pub fn read(file: &str, bytes: &[u8], options: &Options) -> Result<Recording, Error> {
    if c3d::is_c3d(bytes) {
        return c3d::read(file, bytes, options);
    }
    let text = text::decoded(file, bytes)?;
    let first = text.lines().next().unwrap_or("").trim_start();
    if first.starts_with("PathFileType") {
        trc::read(file, &text, options)
    } else if first.starts_with("Format Version") {
        motive::read(file, &text, options)
    } else if vicon::is_vicon(&text) {
        vicon::read(file, &text, options)
    } else {
        let message = "neither a C3D file nor a text that Motive (first words `Format Version`), Nexus (a \
                       section `Trajectories`) or a TRC exporter (`PathFileType`) writes; a table of your \
                       own needs no conversion, only the header time_s,marker,x_m,y_m,z_m";
        Err(Error::Data { place: file.to_string(), message: message.into() })
    }
}
