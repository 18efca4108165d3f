//! What is observed, whatever its kind.
//!
//! A kind of observations is one variant of [`Observations`](crate::scene::Observations) and one file of this
//! folder, which makes an [`Observed`] of it. Later stages know nothing else of it: sites are groups of rows
//! of the observation operator, and values are read, or drawn around the truth of a twin experiment.

use std::cell::OnceCell;
use std::collections::HashMap;
use std::ops::Range;
use std::rc::Rc;

use varda_assimilation::{Observation, ObservationOperator, ObservationSet};
use varda_implicit::{At, Model};

use super::error_correlation::{Chains, ErrorKernel};
use super::random::{Stream, normal, stream};
use super::rotations::{self, Rotations};
use super::runs::run_states;
use crate::Error;
use crate::outcome::{PixelSight, Quantity, Reading, RecordingSummary, Sight};
use crate::scene::{SceneFile, SensorKind, TimeGrid, rounded};

/// Makes an observation operator.
pub type MakeOperator = Box<dyn Fn() -> Result<Box<dyn ObservationOperator>, Error>>;

/// Everything that is observed.
pub struct Observed {
    /// The sites, in the order of their rows.
    pub sites: Vec<Site>,
    /// What was seen of them, in the order of the file or of time.
    pub seen: Vec<Seen>,
    /// Where they are in space, for models in space.
    pub space: Option<ObservedSpace>,
    /// What was left out on request.
    pub left_out: Vec<String>,
    /// What its file holds, of a recording.
    pub recording: Option<RecordingSummary>,
    /// How errors are correlated; `None` where they are independent.
    pub(crate) errors: Option<ErrorKernel>,
    /// Makes H, all sites stacked.
    pub(crate) make_operator: MakeOperator,
    /// What sensors have read of rotations; of a twin experiment once that is drawn.
    pub(crate) rotations: Rc<OnceCell<Rotations>>,
    /// The values of a twin experiment that are still to be drawn.
    pub(crate) draws: Option<Draws>,
}

/// A marker, place or component that is observed, or a marker in a camera: some rows of the observation
/// operator.
#[derive(Debug, Clone, PartialEq)]
pub struct Site {
    /// Name in reports: "marker …", an arc length, the name of a component; with " in camera …".
    pub label: String,
    /// What its values are.
    pub quantity: Quantity,
    /// The name of the camera that saw it.
    pub camera: Option<String>,
    /// The name and the kind of the sensor that it is.
    pub sensor: Option<(String, SensorKind)>,
    /// Its rows of H.
    pub rows: Range<usize>,
    /// For each row the component of the control at the same place (localization of ensembles).
    pub anchors: Vec<usize>,
    /// Its place along the rod or line \[m\], where the model has one.
    pub place: Option<f64>,
    /// Whether it is kept back from the assimilation.
    pub withheld: bool,
}

/// What was seen of one site at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    /// Index of the site.
    pub site: usize,
    /// Step k of the window; may lie after its end, in the forecast.
    pub step: usize,
    /// Fraction of the way to step k + 1, in [0, 1).
    pub weight: f64,
    /// A value for each row of the site; `None` was not observed.
    pub values: Vec<Option<f64>>,
    /// Standard deviation of each value.
    pub sigma: f64,
}

/// Sites in space.
pub struct ObservedSpace {
    /// Arc length of every site \[m\].
    pub arc_lengths: Vec<f64>,
    /// The rotation R from the axes of coordinates that were seen to those of the model, by rows.
    pub rotation: [[f64; 3]; 3],
    /// Makes the operator that gives the places of all sites in the model's axes, three rows a site.
    pub(crate) make_places: MakeOperator,
}

/// Values to be drawn around the truth.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Draws {
    /// Steps of the window.
    pub(crate) steps: Vec<usize>,
    /// Standard deviation of a value of each site.
    pub(crate) sigma: Vec<f64>,
    /// Width and height within which the values of each site are, where that is bounded: the image of a
    /// camera \[px\].
    pub(crate) within: Vec<Option<[f64; 2]>>,
}

/// H(x) of all rows, with the step in the error.
///
/// # Errors
/// [`varda_assimilation::Error::Observe`] where the state cannot be observed.
pub(crate) fn observe(
    operator: &mut dyn ObservationOperator,
    at: At,
    x: &[f64],
    y: &mut [f64],
) -> Result<(), varda_assimilation::Error> {
    let failed = |reason| varda_assimilation::Error::Observe { operator: 0, step: at.step, reason };
    operator.observe(at, x, y).map_err(failed)
}

/// Whether a coordinate is within an image whose first pixel has its middle at 0.
pub(super) fn is_within(pixel: f64, size: f64) -> bool {
    pixel >= -0.5 && pixel <= size - 0.5
}

impl Site {
    /// Whether its values are angles from what it has read.
    pub(crate) fn is_rotation(&self) -> bool {
        self.sensor.as_ref().is_some_and(|(_, kind)| kind.is_rotation())
    }

    /// Its name without that of its camera.
    pub(crate) fn of_point(&self) -> &str {
        let of_camera = self.camera.as_ref().map(|camera| format!(" in camera {camera}"));
        of_camera.and_then(|of| self.label.strip_suffix(&of)).unwrap_or(&self.label)
    }
}

impl Seen {
    /// Time within the window, in steps.
    pub fn at(&self) -> f64 {
        self.step as f64 + self.weight
    }
}

impl Observed {
    /// Numbers of the values that are assimilated and of the times they belong to.
    pub fn sizes(&self, grid: &TimeGrid) -> [usize; 2] {
        if let Some(draws) = &self.draws {
            let rows: usize = self.sites.iter().map(|s| s.rows.len()).sum();
            return [rows * draws.steps.len(), draws.steps.len()];
        }
        let used = || self.seen.iter().filter(|s| self.is_assimilated(s, grid));
        let values = |s: &Seen| s.values.iter().flatten().count();
        let mut times: Vec<f64> = used().filter(|s| values(s) > 0).map(Seen::at).collect();
        times.sort_by(f64::total_cmp);
        times.dedup();
        [used().map(values).sum(), times.len()]
    }

    /// The number of times between two steps that are assimilated.
    pub(crate) fn times_between(&self, grid: &TimeGrid) -> usize {
        let used = self.seen.iter().filter(|s| s.weight > 0.0 && self.is_assimilated(s, grid));
        let mut times: Vec<f64> = used.map(Seen::at).collect();
        times.sort_by(f64::total_cmp);
        times.dedup();
        times.len()
    }

    /// Takes errors for correlated, where the scene says so.
    ///
    /// # Errors
    /// [`Error::Scene`] where two values of one chain have the same place.
    pub(super) fn correlate(&mut self, file: &SceneFile, grid: &TimeGrid) -> Result<(), Error> {
        self.errors = ErrorKernel::of_scene(file)?;
        let Some((_, chains)) = self.chains(grid) else { return Ok(()) };
        let mut known: HashMap<(usize, u64), &Seen> = HashMap::new();
        for seen in &self.seen {
            for (chain, place) in self.entries(&chains, seen) {
                let Some(other) = known.insert((chain, (place + 0.0).to_bits()), seen) else { continue };
                let (label, t) =
                    (&self.sites[seen.site].label, rounded(grid.time(seen.step) + seen.weight * grid.step));
                let twice = match seen.site == other.site {
                    true => format!("{label} is seen twice at {t} s"),
                    false => format!("{} and {label} are at the same place", self.sites[other.site].label),
                };
                let remedy = "their errors would be equal; keep one of them, or no correlation";
                return Err(file.invalid("observations.correlation", format!("{twice}: {remedy}")));
            }
        }
        Ok(())
    }

    fn chains(&self, grid: &TimeGrid) -> Option<(ErrorKernel, Chains)> {
        let times = self.seen.iter().map(|s| (s.step, s.weight));
        self.errors.map(|errors| (errors, Chains::of(errors, times, grid)))
    }

    /// The chain and the place of each value that was seen.
    fn entries(&self, chains: &Chains, seen: &Seen) -> Vec<(usize, f64)> {
        let site = &self.sites[seen.site];
        let present: Vec<usize> = (0..site.rows.len()).filter(|axis| seen.values[*axis].is_some()).collect();
        chains.entries((seen.step, seen.weight), site.rows.clone(), site.place, &present)
    }

    /// Draws the values of a twin experiment: H of the truth at the observed steps, in the order of time,
    /// plus independent errors. Nothing for observations that were read.
    pub(crate) fn draw(
        &mut self,
        model: &mut dyn Model,
        grid: &TimeGrid,
        truth: &[f64],
        seed: u64,
    ) -> Result<(), Error> {
        let Some(Draws { mut steps, sigma, within }) = self.draws.take() else { return Ok(()) };
        if self.errors.is_some() {
            // the order of an observation set
            steps.sort_unstable();
        }
        let last = steps.iter().copied().max().unwrap_or(0);
        let states = run_states(model, truth, last)?;
        let mut operator = (self.make_operator)()?;
        let mut rng = stream(seed, Stream::Observations);
        let mut y = vec![0.0; operator.dim()];
        let n = model.dim();
        let mut noise = Vec::new();
        for step in steps {
            observe(operator.as_mut(), grid.at(step), &states[step * n..(step + 1) * n], &mut y)?;
            for (site, place) in self.sites.iter().enumerate() {
                let (sigma, y) = (sigma[site], &y[place.rows.clone()]);
                let inside = |size: [f64; 2]| y.iter().zip(size).all(|(y, size)| is_within(*y, size));
                if !within[site].is_none_or(inside) {
                    continue;
                }
                let white = if self.errors.is_some() { 1.0 } else { sigma };
                noise.extend(y.iter().map(|_| normal(&mut rng, white)));
                let values = y.iter().map(|y| Some(*y)).collect();
                self.seen.push(Seen { site, step, weight: 0.0, values, sigma });
            }
        }
        if self.errors.is_some() {
            let all: Vec<&Seen> = self.seen.iter().collect();
            let set = ObservationSet::on_times(grid.times(), vec![operator], self.of(&all, grid))?;
            set.errors().root(&mut noise);
        }
        self.add(&noise, grid);
        Ok(())
    }

    /// Adds errors to what was drawn, and takes rotations for what their values are measured from.
    fn add(&mut self, noise: &[f64], grid: &TimeGrid) {
        let first = self.sites.iter().position(|site| site.sensor.is_some()).unwrap_or(self.sites.len());
        let mut rotations: HashMap<usize, Vec<(usize, Vec<f64>, &[f64])>> = HashMap::new();
        let mut rest = noise;
        for seen in &mut self.seen {
            let (errors, others) = rest.split_at(seen.values.len());
            rest = others;
            if self.sites[seen.site].is_rotation() {
                let truth = seen.values.iter_mut().flat_map(|value| value.replace(0.0)).collect();
                rotations.entry(seen.site - first).or_default().push((seen.step, truth, errors));
            } else {
                seen.values.iter_mut().flatten().zip(errors).for_each(|(y, e)| *y += e);
            }
        }
        let kind = |sensor: usize| self.sites[first + sensor].sensor.as_ref().map(|(_, kind)| *kind);
        let drawn = rotations.into_iter().filter_map(|(sensor, mut rows)| {
            rows.sort_by_key(|(step, ..)| *step);
            let truth: Vec<_> = rows.iter().map(|(step, y, _)| (grid.time(*step), &y[..])).collect();
            let errors: Vec<_> = rows.iter().map(|(.., errors)| *errors).collect();
            Some((sensor, (kind(sensor)?, rotations::drawn(kind(sensor)?, &truth, &errors))))
        });
        let _ = self.rotations.set(Rotations::new(first, drawn.collect()));
    }

    /// Whether it is in the window and not kept back.
    pub(crate) fn is_assimilated(&self, seen: &Seen, grid: &TimeGrid) -> bool {
        !self.sites[seen.site].withheld && seen.at() <= grid.steps as f64
    }

    /// The observations that are assimilated, for operator 0.
    pub fn assimilated(&self, grid: &TimeGrid) -> Vec<Observation> {
        let used: Vec<&Seen> = self.seen.iter().filter(|s| self.is_assimilated(s, grid)).collect();
        self.of(&used, grid)
    }

    /// Some of what was seen as observations for operator 0, but for what has no value.
    fn of(&self, seen: &[&Seen], grid: &TimeGrid) -> Vec<Observation> {
        let chains = self.chains(grid);
        let observation = |s: &&Seen| {
            let site = &self.sites[s.site];
            let present: Vec<(usize, f64)> =
                site.rows.clone().zip(&s.values).filter_map(|(row, v)| v.map(|v| (row, v))).collect();
            let (rows, values) = present.into_iter().unzip();
            let seen = Observation::new(s.step, rows, values, s.sigma).between(s.weight);
            let seen = match &chains {
                Some((errors, chains)) => seen.chained(errors.kernel, self.entries(chains, s)),
                None => seen,
            };
            // The coordinates of a point are one sighting.
            let seen = if site.quantity != Quantity::Component { seen.together() } else { seen };
            seen.label(site.label.clone())
        };
        seen.iter().map(observation).filter(|o| !o.rows.is_empty()).collect()
    }

    /// The set of the observations that are assimilated, with an operator of its own.
    ///
    /// # Errors
    /// [`Error::Assimilation`].
    pub fn set(&self, grid: &TimeGrid) -> Result<ObservationSet, Error> {
        self.set_with(self.operator()?, grid)
    }

    /// The same with another operator, of states that are longer.
    ///
    /// # Errors
    /// [`Error::Assimilation`].
    pub(crate) fn set_with(
        &self,
        operator: Box<dyn ObservationOperator>,
        grid: &TimeGrid,
    ) -> Result<ObservationSet, Error> {
        Ok(ObservationSet::on_times(grid.times_of_window(), vec![operator], self.assimilated(grid))?)
    }

    /// Everything that was seen in window and forecast, used or not, with a row for every row of its site:
    /// where predictions are wanted beside what was seen. Values that are missing are zeros. Beside it the
    /// place of each observation in `seen`, in the order of the set, which is that of time.
    ///
    /// # Errors
    /// [`Error::Assimilation`].
    pub(crate) fn everything(&self, grid: &TimeGrid) -> Result<(ObservationSet, Vec<usize>), Error> {
        let last = grid.last_step() as f64;
        let mut order: Vec<usize> = (0..self.seen.len()).filter(|i| self.seen[*i].at() <= last).collect();
        let of = |i: usize| &self.seen[i];
        order.sort_by(|a, b| of(*a).step.cmp(&of(*b).step).then(of(*a).weight.total_cmp(&of(*b).weight)));
        let row = |i: &usize| {
            let (s, rows) = (of(*i), self.sites[of(*i).site].rows.clone());
            Observation::new(s.step, rows.clone().collect(), vec![0.0; rows.len()], s.sigma).between(s.weight)
        };
        let seen = order.iter().map(row).collect();
        Ok((ObservationSet::on_times(grid.times(), vec![self.operator()?], seen)?, order))
    }

    /// H, all sites stacked.
    ///
    /// # Errors
    /// [`Error::Rod`] for a marker off the rod.
    pub fn operator(&self) -> Result<Box<dyn ObservationOperator>, Error> {
        (self.make_operator)()
    }

    /// For each row of the operator the component of the control at the same place.
    pub fn anchors(&self) -> Vec<usize> {
        self.sites.iter().flat_map(|s| s.anchors.iter().copied()).collect()
    }

    /// What cameras saw of both u and v.
    pub fn pixels(&self, grid: &TimeGrid) -> Vec<PixelSight> {
        let sight = |s: &Seen| {
            let site = &self.sites[s.site];
            let [Some(u), Some(v)] = s.values[..] else { return None };
            Some(PixelSight {
                time: grid.start + s.at() * grid.step,
                camera: site.camera.clone()?,
                arc_length: site.place?,
                pixel: [u, v],
                sigma: s.sigma,
            })
        };
        self.seen.iter().filter_map(sight).collect()
    }

    /// A value of a site at one time \[s\] as one of another time: the same, but for one that is measured
    /// from what was read then.
    pub(crate) fn as_from(&self, value: &[f64], site: usize, times: [f64; 2]) -> Vec<f64> {
        match self.rotations.get() {
            Some(rotations) => rotations.carried(site, value, times),
            None => value.to_vec(),
        }
    }

    /// What sensors read.
    pub fn readings(&self, grid: &TimeGrid) -> Vec<Reading> {
        let reading = |s: &Seen| {
            let (sensor, kind) = self.sites[s.site].sensor.clone()?;
            let time = grid.start + s.at() * grid.step;
            let cells = self.rotations.get().and_then(|rotations| rotations.cells(s.site, time));
            Some(Reading {
                time,
                sensor,
                columns: kind.columns(),
                values: cells.map_or_else(|| s.values.clone(), |cells| cells.into_iter().map(Some).collect()),
                sigma: s.sigma,
            })
        };
        self.seen.iter().filter_map(reading).collect()
    }

    /// What was seen whole of sites in space, in the model's axes.
    pub fn sights(&self) -> Vec<Sight> {
        let Some(space) = &self.space else { return Vec::new() };
        let r = &space.rotation;
        let sight = |s: &Seen| {
            if self.sites[s.site].quantity != Quantity::Place {
                return None;
            }
            let [Some(a), Some(b), Some(c)] = s.values[..] else { return None };
            Some(Sight {
                site: s.site,
                arc_length: space.arc_lengths[s.site],
                withheld: self.sites[s.site].withheld,
                step: s.step,
                weight: s.weight,
                position: std::array::from_fn(|i| r[i][0] * a + r[i][1] * b + r[i][2] * c),
                sigma: s.sigma,
            })
        };
        self.seen.iter().filter_map(sight).collect()
    }
}
