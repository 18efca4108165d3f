//! A scene for a rod at rest that was seen once: a file of points without times.

use std::fmt::Write;

use varda_rod::Vector3;

use super::csv;
use super::recording_scene::{Recorded, Track, across, filled, rounded, scene_of_recording, vector};
use crate::Error;

const TEMPLATE: &str = include_str!("../../scenes/shape.toml");
/// σ of a point, as a share of the rod's length: as points are picked in a photograph.
const SIGMA: f64 = 0.005;

/// The TOML of a scene for a file of places: a recording, or a shape without times.
///
/// # Errors
/// [`Error::Data`] for a file that is neither, or says too little.
pub fn scene_of_file(file: &str, text: &str) -> Result<String, Error> {
    if csv::is_shape(text) { scene_of_shape(file, text) } else { scene_of_recording(file, text) }
}

/// The TOML of a scene of method "static" for a shape, whose text is `text`; `file` is its name as the scene
/// writes it. Arc lengths are those of the file or, of named points, sums of distances in the order of the
/// shortest way. A coordinate that was not seen counts as zero in the guess of the clamp.
///
/// # Errors
/// [`Error::Data`] for a file that is no shape, or has fewer than three points.
fn scene_of_shape(file: &str, text: &str) -> Result<String, Error> {
    let mut rows = csv::shape(file, text)?;
    rows.iter_mut().for_each(|row| row.position = row.position.map(|x| Some(x.unwrap_or(0.0))));
    let points = Recorded::of(&rows);
    if points.tracks.len() < 3 {
        let message =
            format!("a shape of {} points: it takes three to see how it bends", points.tracks.len());
        return Err(Error::Data { place: file.to_string(), message });
    }
    Ok(scene(file, &points))
}

fn scene(file: &str, points: &Recorded) -> String {
    let (tracks, length) = (&points.tracks, points.length());
    let [start, second, before, end] = [0, 1, tracks.len() - 2, tracks.len() - 1].map(|i| &tracks[i]);
    let direction =
        |from: &Track, to: &Track| (to.mean() - from.mean()).try_normalize(1e-12).unwrap_or(-Vector3::z());
    let tangent = direction(start, second);
    let position = start.mean() - tangent * start.arc_length;
    let are_named = tracks.iter().all(|t| t.name.is_some()) && !points.placed;
    let last = direction(before, end);
    let far = format!(
        "# [model.end]                    # where the far end is held too\n# position = {}\n# tangent = {}\n\
         # director = {}\n",
        vector(end.mean()),
        vector(last),
        vector(across(last))
    );
    let mut markers = String::new();
    for track in tracks {
        let Some(name) = &track.name else { continue };
        let note =
            if are_named { "  # m, yours: a sum of distances, a lower bound" } else { "  # from the file" };
        let _ = write!(
            markers,
            "\n[[observations.markers]]\nname = {name:?}\narc_length = {:?}{note}\n",
            rounded_to_length(track.arc_length)
        );
    }
    let values = [
        ("{file}", file.to_string()),
        ("{title}", format!("{:?}", format!("A rod at rest, from {file}"))),
        ("{length}", format!("{:?}", rounded_to_length(length))),
        (
            "{length_note}",
            match are_named {
                true => "the sum of the distances between points, a lower bound",
                false => "the file's last point; from the clamp's face",
            }
            .to_string(),
        ),
        ("{last}", format!("{:?}", rounded_to_length(length))),
        ("{segments}", (4 * tracks.len()).clamp(20, 100).to_string()),
        ("{position}", vector(position)),
        (
            "{position_note}",
            if start.arc_length > 0.0 { "a guess from the first two points" } else { "the first point" }
                .to_string(),
        ),
        ("{tangent}", vector(tangent)),
        ("{director}", vector(across(tangent))),
        ("{end}", far),
        ("{path}", format!("{file:?}")),
        ("{sigma}", format!("{:?}", rounded(SIGMA * length))),
        ("{markers}", markers),
    ];
    filled(TEMPLATE, &values)
}

/// To a tenth of a millimetre.
fn rounded_to_length(s: f64) -> f64 {
    (1e4 * s).round() / 1e4
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::SceneFile;

    /// Twelve points of a quarter of a circle in the plane x, z.
    fn shape(named: bool) -> String {
        let mut text = if named { "marker,x_mm,y_mm,z_mm\n" } else { "s_mm,x_mm,y_mm,z_mm\n" }.to_string();
        for i in 0..12 {
            let angle = std::f64::consts::FRAC_PI_2 * f64::from(i) / 11.0;
            let first = if named { format!("p{i}") } else { format!("{}", 200.0 * angle) };
            let _ = writeln!(text, "{first},{},,{}", 200.0 * angle.sin(), 200.0 * (angle.cos() - 1.0));
        }
        text
    }

    #[test]
    fn a_shape_gives_a_scene_without_times() {
        for named in [true, false] {
            let text = scene_of_shape("seen.csv", &shape(named)).unwrap();
            let file = SceneFile::parse("seen", "seen.toml", &text, None, &[]).unwrap();
            let model = text.lines().find(|line| line.starts_with("length = ")).unwrap();
            let length: f64 = model.split_whitespace().nth(2).unwrap().parse().unwrap();
            // a chord is shorter than its arc by 1/24 of the angle's square
            assert!((length - 0.3142).abs() < if named { 5e-4 } else { 1e-4 }, "{length}");
            assert_eq!(text.matches("[[observations.markers]]").count(), if named { 12 } else { 0 });
            assert!(text.contains("position = [0.0000, 0.0000, 0.0000]"), "{text}");
            assert_eq!(file.scene.algorithm.method.name(), "static");
        }
    }

    #[test]
    fn two_points_are_no_shape() {
        let error = scene_of_shape("two.csv", "s_m,x_m,y_m,z_m\n0,0,0,0\n0.1,0.1,0,0\n").unwrap_err();
        assert!(error.to_string().contains("two.csv: a shape of 2 points"), "{error}");
    }
}
