//! Observations of a rod: where on it, when, in whose axes.

use std::collections::HashMap;

use varda_assimilation::{Observation, ObservationOperator};
use varda_implicit::Refusal;
use varda_rod::{Marker, Markers, RodStep};

use crate::Error;
use crate::scene::{Frame, OutsideWindow, Recording, SceneFile, Use};
use crate::setup::csv;
use crate::setup::csv::{Row, Subject};

/// A place on the rod that is looked at.
#[derive(Debug, Clone, PartialEq)]
pub struct Site {
    /// Name in reports: "marker …", or the arc length.
    pub label: String,
    /// Where.
    pub marker: Marker,
    /// What it is used for.
    pub used: Use,
}

/// What was seen of one site at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct Sighting {
    /// Index of the site.
    pub site: usize,
    /// Step k of the window; may lie beyond its end (then it judges the forecast).
    pub step: usize,
    /// Share of step k + 1, in [0, 1).
    pub weight: f64,
    /// The coordinates in the recording's axes (turned, not displaced: Rᵀ p) \[m\]; `None` was not observed.
    pub values: [Option<f64>; 3],
    /// Standard deviation of each \[m\].
    pub sigma: f64,
}

/// All that was seen of a rod.
#[derive(Debug, Clone, PartialEq)]
pub struct Sightings {
    /// The places.
    pub sites: Vec<Site>,
    /// What was seen, in the order of the file.
    pub seen: Vec<Sighting>,
    /// The rotation R from the recording's axes to the model's, by rows.
    pub rotation: [[f64; 3]; 3],
    /// What was left out on request.
    pub left_out: Vec<String>,
}

/// The grid of the window: step k is at `start + k · step` seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    /// Model time at the start \[s\].
    pub start: f64,
    /// Δt \[s\].
    pub step: f64,
    /// Steps in the window.
    pub steps: usize,
    /// Steps of the forecast beyond it.
    pub forecast: usize,
}

impl Window {
    /// Model time of step k \[s\].
    pub fn time(&self, k: usize) -> f64 {
        self.start + k as f64 * self.step
    }
}

impl Sighting {
    /// The place in the model's axes \[m\], where all three coordinates were seen.
    pub fn position(&self, rotation: &[[f64; 3]; 3]) -> Option<[f64; 3]> {
        let [Some(a), Some(b), Some(c)] = self.values else { return None };
        Some(std::array::from_fn(|i| rotation[i][0] * a + rotation[i][1] * b + rotation[i][2] * c))
    }

    /// Time within the window, in steps.
    pub fn at(&self) -> f64 {
        self.step as f64 + self.weight
    }
}

impl Sightings {
    /// What a recording saw, in the model's time.
    ///
    /// # Errors
    /// [`Error::Data`] or [`Error::Scene`] naming the line or the key.
    pub fn from_recording(
        file: &SceneFile,
        recording: &Recording,
        length: f64,
        window: &Window,
    ) -> Result<Self, Error> {
        let key = "observations.file";
        let Some(name) = &recording.file else {
            return Err(
                file.invalid("observations", "no file is named: give one with --set observations.file=…")
            );
        };
        let (label, text) = file.read(key, name)?;
        let rows = csv::observations(&label, &text)?;
        let bad =
            |row: &Row, message: String| Error::Data { place: format!("{label}:{}", row.line), message };

        let mut sites: Vec<Site> = recording
            .markers
            .iter()
            .map(|m| Site {
                label: format!("marker {}", m.name),
                marker: Marker { s: m.arc_length, offset: m.offset },
                used: m.used,
            })
            .collect();
        // −0 is 0.
        let bits = |s: f64| (s + 0.0).to_bits();
        let mut site_of = HashMap::new();
        for (i, site) in sites.iter().enumerate() {
            site_of.entry(bits(site.marker.s)).or_insert(i);
        }
        let rotation = recording.frame.rotation_rows();
        let shift: [f64; 3] =
            std::array::from_fn(|c| (0..3).map(|j| rotation[j][c] * recording.frame.translation[j]).sum());
        let (mut before, mut after, mut ignored) = (0, 0, 0);
        let mut seen = Vec::new();
        for row in &rows {
            let site = match &row.subject {
                Subject::Marker(name) if recording.ignore.contains(name) => {
                    ignored += 1;
                    continue;
                }
                Subject::Marker(name) => recording.markers.iter().position(|m| m.name == *name).ok_or_else(|| {
                    bad(row, format!("marker {name:?} has no place: add it to [[observations.markers]] or to observations.ignore"))
                })?,
                Subject::ArcLength(s) => {
                    if !(*s >= 0.0 && *s <= length * (1.0 + 1e-9)) {
                        return Err(bad(row, format!("s_m = {s} is off the rod (0 to {length} m)")));
                    }
                    *site_of.entry(bits(*s)).or_insert_with(|| {
                        let marker = Marker { s: *s, offset: [0.0; 3] };
                        sites.push(Site { label: format!("s = {s} m"), marker, used: Use::Assimilate });
                        sites.len() - 1
                    })
                }
            };
            let time = row.time - recording.time_zero;
            // A time within a thousandth of a step of an end of the window was meant to be that end.
            let slack = 1e-3;
            let at = (time - window.start) / window.step;
            let beyond = at > window.steps as f64 + slack;
            if at < -slack || beyond {
                if recording.outside_window == OutsideWindow::Error {
                    let (from, to) =
                        (window.start + recording.time_zero, window.time(window.steps) + recording.time_zero);
                    return Err(bad(
                        row,
                        format!("time_s = {} is outside the window ({from} to {to} s)", row.time),
                    ));
                }
                if !beyond || at > (window.steps + window.forecast) as f64 + slack {
                    *(if beyond { &mut after } else { &mut before }) += 1;
                    continue;
                }
            }
            let at = at.clamp(0.0, if beyond { f64::INFINITY } else { window.steps as f64 });
            // Closer to a step than rounding of the file's times can tell.
            let at = if (at - at.round()).abs() < 1e-6 { at.round() } else { at };
            let sigma = row.sigma.or(recording.sigma).ok_or_else(|| {
                bad(row, "no standard deviation: fill `sigma_m`, or give observations.sigma".to_string())
            })?;
            let values = std::array::from_fn(|c| row.position[c].map(|v| v + shift[c]));
            seen.push(Sighting { site, step: at.floor() as usize, weight: at.fract(), values, sigma });
        }
        let mut left_out = Vec::new();
        for (count, what) in [
            (ignored, "rows of ignored markers"),
            (before, "rows before the window"),
            (after, "rows after the window and its forecast"),
        ] {
            if count > 0 {
                left_out.push(format!("{count} {what}"));
            }
        }
        Ok(Sightings { sites, seen, rotation, left_out })
    }

    /// Those that are assimilated, for an [`ObservationSet`](varda_assimilation::ObservationSet) whose operator 0 is
    /// [`RodObservation`] over all sites.
    pub fn assimilated(&self, window: &Window) -> Vec<Observation> {
        let used =
            |s: &&Sighting| self.sites[s.site].used == Use::Assimilate && s.at() <= window.steps as f64;
        let observation = |s: &Sighting| {
            let present: Vec<(usize, f64)> =
                (0..3).filter_map(|c| s.values[c].map(|v| (3 * s.site + c, v))).collect();
            Observation {
                operator: 0,
                step: s.step,
                weight: s.weight,
                sigma: vec![s.sigma; present.len()],
                rows: present.iter().map(|p| p.0).collect(),
                values: present.iter().map(|p| p.1).collect(),
                label: self.sites[s.site].label.clone(),
            }
        };
        self.seen.iter().filter(used).map(observation).filter(|o| !o.rows.is_empty()).collect()
    }
}

impl Frame {
    /// The rows of R: as given, or Rodrigues' rotation about `axis`; the identity without either.
    pub fn rotation_rows(&self) -> [[f64; 3]; 3] {
        if let Some(rows) = self.rotation {
            return rows;
        }
        let (Some(axis), Some(angle)) = (self.axis, self.angle) else {
            return [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        };
        let norm = axis.iter().map(|a| a * a).sum::<f64>().sqrt();
        let [x, y, z] = axis.map(|a| a / norm);
        let (s, c) = angle.sin_cos();
        let v = 1.0 - c;
        [
            [c + x * x * v, x * y * v - z * s, x * z * v + y * s],
            [y * x * v + z * s, c + y * y * v, y * z * v - x * s],
            [z * x * v - y * s, z * y * v + x * s, c + z * z * v],
        ]
    }
}

/// H_k(x): the coordinates of all sites at step k, in the recording's axes, three rows a site: y = Rᵀ p.
///
/// On the centreline p is linear in arc length between two vertices (a prescribed vertex enters as a known function of
/// the step's time); off it p is carried by the section.
pub struct RodObservation {
    markers: Markers,
    rotation: [[f64; 3]; 3],
    window: Window,
    places: Vec<f64>,
}

impl RodObservation {
    /// # Errors
    /// A place off the rod.
    pub fn new(rod: &RodStep, sightings: &Sightings, window: Window) -> Result<Self, varda_rod::Error> {
        let markers: Vec<Marker> = sightings.sites.iter().map(|s| s.marker).collect();
        let places = vec![0.0; 3 * markers.len()];
        Ok(RodObservation {
            markers: Markers::new(rod, &markers)?,
            rotation: sightings.rotation,
            window,
            places,
        })
    }

    /// Where the sites are at step k \[m\], in the model's axes; three numbers a site.
    ///
    /// # Errors
    /// A state without frames: a fold, a zero edge, a value that is not finite.
    pub fn places(&mut self, k: usize, x: &[f64], places: &mut [f64]) -> Result<(), varda_rod::Error> {
        self.markers.places(self.window.time(k), x, places)
    }

    /// y = Rᵀ p, site by site.
    fn turn(&self, y: &mut [f64]) {
        let r = &self.rotation;
        for (p, y) in self.places.chunks_exact(3).zip(y.chunks_exact_mut(3)) {
            for c in 0..3 {
                y[c] = r[0][c] * p[0] + r[1][c] * p[1] + r[2][c] * p[2];
            }
        }
    }
}

impl ObservationOperator for RodObservation {
    fn dim(&self) -> usize {
        3 * self.markers.len()
    }

    fn observe(&mut self, k: usize, x: &[f64], y: &mut [f64]) -> Result<(), Refusal> {
        self.markers.places(self.window.time(k), x, &mut self.places)?;
        self.turn(y);
        Ok(())
    }

    fn tangent(&mut self, k: usize, x: &[f64], dx: &[f64], dy: &mut [f64]) {
        let seen = self.markers.tangent(self.window.time(k), x, dx, &mut self.places);
        seen.expect("this state was observed before");
        self.turn(dy);
    }

    fn adjoint_add(&mut self, k: usize, x: &[f64], dy: &[f64], dx: &mut [f64]) {
        let r = &self.rotation;
        for (y, p) in dy.chunks_exact(3).zip(self.places.chunks_exact_mut(3)) {
            for i in 0..3 {
                p[i] = r[i][0] * y[0] + r[i][1] * y[1] + r[i][2] * y[2];
            }
        }
        let seen = self.markers.adjoint_add(self.window.time(k), x, &self.places, dx);
        seen.expect("this state was observed before");
    }
}
