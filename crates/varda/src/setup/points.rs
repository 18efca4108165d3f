//! The points of a rod that a recording is about, by name or arc length.

use std::collections::{HashMap, HashSet};

use varda_rod::Marker;

use super::csv::Subject;
use super::files::Files;
use super::reachable::Reach;
use crate::scene::{Model, Recording, Use, rounded};

/// A point and its place on the rod.
#[derive(Debug, Clone)]
pub(super) struct Placed {
    pub(super) label: String,
    pub(super) marker: Marker,
    pub(super) withheld: bool,
}

impl Placed {
    pub(super) fn at_arc_length(s: f64) -> Self {
        Placed { label: format!("s = {s} m"), marker: Marker { s, offset: [0.0; 3].into() }, withheld: false }
    }

    pub(super) fn reach(&self) -> Reach {
        Reach { arc_length: self.marker.s, offset: self.marker.offset.norm() }
    }
}

/// What a row is about.
pub(super) enum About {
    /// A point, by its index.
    Point(usize),
    /// A marker that moves a support.
    Followed,
    /// A marker that is not on the rod.
    Ignored,
}

/// The points that the scene lists and those that rows add.
pub(super) struct Points<'a> {
    pub(super) all: Vec<Placed>,
    recording: &'a Recording,
    length: f64,
    followed: HashSet<&'a str>,
    /// Markers whose places files have.
    named: HashMap<String, usize>,
    /// The first point at an arc length, by its bits.
    at: HashMap<u64, usize>,
}

impl<'a> Points<'a> {
    /// Those of the scene, on a rod of this length \[m\].
    pub(super) fn of(files: &'a Files, recording: &'a Recording, length: f64) -> Self {
        let listed = recording.markers.iter().map(|m| Placed {
            label: format!("marker {}", m.name),
            marker: Marker { s: m.arc_length, offset: m.offset.into() },
            withheld: m.used == Use::Withhold,
        });
        let all: Vec<Placed> = listed.collect();
        let mut at = HashMap::new();
        for (i, point) in all.iter().enumerate() {
            at.entry(bits(point.marker.s)).or_insert(i);
        }
        let followed = match &files.scene.scene.model {
            Model::Rod(model) => model.followed_markers().collect(),
            _ => HashSet::new(),
        };
        Points { all, recording, length, followed, named: HashMap::new(), at }
    }

    /// The point of a row, which may have the arc length of a named marker \[m\].
    ///
    /// # Errors
    /// What is wrong with it.
    pub(super) fn about(&mut self, subject: &Subject, arc_length: Option<f64>) -> Result<About, String> {
        let name = match subject {
            Subject::ArcLength(s) => {
                self.on_the_rod(*s)?;
                let Points { at, all, .. } = self;
                let point = *at.entry(bits(*s)).or_insert_with(|| {
                    all.push(Placed::at_arc_length(*s));
                    all.len() - 1
                });
                return Ok(About::Point(point));
            }
            Subject::Marker(name) => name,
        };
        if self.followed.contains(name.as_str()) {
            return Ok(About::Followed);
        }
        if self.recording.ignore.contains(name) {
            return Ok(About::Ignored);
        }
        let in_scene = self.recording.markers.iter().position(|m| m.name == *name);
        let point = match (in_scene, arc_length, self.named.get(name)) {
            (Some(point), ..) => point,
            (None, Some(s), Some(&point)) if bits(s) == bits(self.all[point].marker.s) => point,
            (None, Some(s), Some(&point)) => {
                let before = self.all[point].marker.s;
                return Err(format!("marker {name:?} is at s_m = {s}, in a row before at {before}"));
            }
            (None, Some(s), None) => {
                self.on_the_rod(s)?;
                self.named.insert(name.clone(), self.all.len());
                self.all.push(Placed { label: format!("marker {name}"), ..Placed::at_arc_length(s) });
                self.all.len() - 1
            }
            (None, None, _) => {
                let remedy = "add it to [[observations.markers]] or to observations.ignore, or \
                              give its `s_m` in the file";
                return Err(format!("marker {name:?} has no place: {remedy}"));
            }
        };
        Ok(About::Point(point))
    }

    fn on_the_rod(&self, s: f64) -> Result<(), String> {
        let length = self.length;
        match s >= 0.0 && s <= length * (1.0 + 1e-9) {
            true => Ok(()),
            false => Err(format!("s_m = {} is off the rod (0 to {} m)", rounded(s), rounded(length))),
        }
    }
}

/// −0 is 0.
fn bits(s: f64) -> u64 {
    (s + 0.0).to_bits()
}
