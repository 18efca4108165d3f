//! From `[estimate]` to unknown constants behind the state in the control.

use std::rc::Rc;

use varda_covariance::{
    BlockDiagonal, Covariance, CovarianceFunction, Diagonal, Kernel, Markov, Precision, Taper,
};
use varda_rod::{Change, Damping, Law, MovedBy, Parameter, Rod, Section, Vector3};

pub use super::constant::Constant;
use super::constant::{Effect, Kind, times};
use super::covariance::{Factored, WithoutError};
use super::estimate_supports;
use super::motion::Followed;
use crate::Error;
use crate::outcome::is_of_input;
use crate::scene::{
    ConstantPrior, OF_BASE, OF_OBSERVATIONS, OF_PLACES, PriorSpread, RodModel, SceneFile, Unknown,
};

/// Unknown constants p, in the order of the control. Each is zero at the value that the scene writes.
#[derive(Debug, Clone, Default)]
pub struct Estimates {
    /// What they are.
    pub constants: Vec<Constant>,
    /// How many the model depends on; they come first.
    of_model: usize,
    /// Those of a rod.
    pub(crate) of_rod: Vec<Parameter>,
    /// Places among `constants` of the first number of a rotation, a displacement and the biases of what is
    /// observed.
    pub(crate) seen: Seeing,
    /// Fields among the constants: their places \[m\] and the length over which they are alike.
    fields: Vec<(std::ops::Range<usize>, Vec<f64>, f64)>,
}

/// Most constants whose intervals are those of J along each: one takes some seven gradients.
const MOST_PROFILED: usize = 16;

/// Constants of the observations, by the place of their first number among all.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Seeing {
    /// How many sites have constants of their own.
    pub(crate) sites: usize,
    pub(crate) arc_length: Option<usize>,
    pub(crate) offset: Option<usize>,
    pub(crate) rotation: Option<usize>,
    pub(crate) translation: Option<usize>,
    /// That of every row which has a bias, of places and components and of sensors.
    pub(crate) bias: Rc<[Option<usize>]>,
    pub(crate) bias_of_sensors: Rc<[Option<usize>]>,
    /// Those of the rotation and the displacement of every camera; nothing where all are known.
    pub(crate) poses: Rc<[[Option<usize>; 2]]>,
    pub(crate) clock: Option<usize>,
    /// What of the clock's offset is in the times of the observations already \[s\].
    pub(crate) clock_known: f64,
}

impl Seeing {
    /// Whether the places of sites on a rod are unknown.
    pub(crate) fn moves_sites(&self) -> bool {
        self.arc_length.is_some() || self.offset.is_some()
    }

    /// Without what a recording's axes and errors are: places in those of the model.
    pub(crate) fn of_places(&self) -> Seeing {
        Seeing { rotation: None, translation: None, bias: Rc::default(), ..self.clone() }
    }

    /// What sensors on a rod have of it.
    pub(crate) fn of_sensors(&self) -> Seeing {
        Seeing { bias: Rc::clone(&self.bias_of_sensors), ..Seeing::default() }
    }
}

/// The rod before and after the masses hung on it, and its section.
pub(crate) struct Described<'a> {
    pub(crate) section: &'a Section,
    /// Masses of the vertices without those hung on them \[kg\].
    pub(crate) line_masses: &'a [f64],
    /// The rod between the faces of its clamps.
    pub(crate) rod: &'a Rod,
    pub(crate) damping: Damping,
    /// Recorded motions that its supports follow, and the first and last time of a run \[s\].
    pub(super) followed: &'a [Followed],
    pub(super) run: [f64; 2],
}

impl Estimates {
    /// Whether nothing is unknown but the state.
    pub fn is_empty(&self) -> bool {
        self.constants.is_empty()
    }

    /// How many numbers follow the state in the control.
    pub fn len(&self) -> usize {
        self.constants.len()
    }

    /// Whether their priors are independent of each other.
    pub(crate) fn are_independent(&self) -> bool {
        self.fields.is_empty()
    }

    /// σ of how far drives and recorded places of supports are off \[m\].
    pub(crate) fn supports_off(&self) -> f64 {
        let (mut recorded, mut turned, mut driven) = (0.0_f64, 0.0_f64, 0.0);
        for (parameter, constant) in self.of_rod.iter().zip(&self.constants) {
            for moved in &parameter.change.supports {
                match &moved.by {
                    MovedBy::Along(_) => recorded = recorded.max(constant.sigma),
                    MovedBy::Drive { drive, radii, phase } => {
                        let by_phase = phase * drive.radii[0].max(drive.radii[1]);
                        driven += (constant.sigma * radii[0].hypot(radii[1]).hypot(by_phase)).powi(2);
                    }
                    // what is on the rod stays as far from its support
                    MovedBy::Turn(_) => {}
                    MovedBy::TurnAlong { arm, .. } => turned = turned.max(constant.sigma * arm.norm()),
                }
            }
        }
        recorded.hypot(turned).hypot(driven.sqrt())
    }

    /// How many of them the model does not depend on.
    pub(crate) fn carried(&self) -> usize {
        self.len() - self.of_model
    }

    /// Those of a rod and of what is observed of it.
    ///
    /// # Errors
    /// [`Error::Scene`] pointing at the key.
    pub(crate) fn of_rod(file: &SceneFile, model: &RodModel, described: &Described) -> Result<Self, Error> {
        let mut all = Estimates::default();
        for (key, unknown) in file.scene.estimate.given() {
            if OF_PLACES.contains(&key) || OF_OBSERVATIONS.contains(&key) {
                continue;
            }
            all.add_of_rod(file, model, described, key, unknown)?;
        }
        all.add_of_observations(file, 3)?;
        Ok(all)
    }

    /// Those of an equation whose constants are these, by name, unit and value, and of what is observed of
    /// it; with the place and law of each of the equation's.
    ///
    /// # Errors
    /// [`Error::Scene`] pointing at the key.
    pub(crate) fn of_components(
        file: &SceneFile,
        known: &[(&'static str, &'static str, f64)],
    ) -> Result<(Self, Vec<(usize, Law)>), Error> {
        let (mut all, mut chosen) = (Estimates::default(), Vec::new());
        for (key, unknown) in file.scene.estimate.given() {
            let Some(place) = known.iter().position(|(name, ..)| *name == key) else { continue };
            let (path, (_, unit, value)) = (format!("estimate.{key}"), known[place]);
            let (path, prior) = file.checked(unknown.priors(&path, 1))?.remove(0);
            let (law, sigma) = match file.checked(prior.spread(&path))? {
                PriorSpread::Normal(sigma) => (Law::Linear, sigma),
                PriorSpread::LogNormal(sigma) if value != 0.0 => (Law::Exponential, sigma),
                PriorSpread::LogNormal(_) => {
                    return Err(file.invalid(&path, "is 0 in the scene, and a share of it too"));
                }
            };
            all.constants.push(Constant { name: key.to_string(), unit, value, law, sigma });
            chosen.push((place, law));
        }
        all.of_model = chosen.len();
        all.add_of_observations(file, 1)?;
        Ok((all, chosen))
    }

    fn add_of_rod(
        &mut self,
        file: &SceneFile,
        model: &RodModel,
        described: &Described,
        key: &'static str,
        unknown: &Unknown,
    ) -> Result<(), Error> {
        let path = format!("estimate.{key}");
        let field = match (unknown, key) {
            (Unknown::Every(prior), "natural_curvature" | "natural_twist") => Some(prior),
            _ => None,
        };
        if let Some((prior, length)) = field.and_then(|prior| Some((prior, prior.correlation_length?))) {
            return self.add_field(file, &path, key, prior, length, described.rod, model);
        }
        if OF_BASE.iter().any(|(base, _)| *base == key) {
            return self.add_base(file, model, described, key, unknown);
        }
        let section = described.section;
        let isotropic = section.ei1 == section.ei2;
        let of_supports = estimate_supports::kinds(key, model, &file.scene.estimate, isotropic);
        let kinds = of_supports.unwrap_or_else(|| kinds(key, model, described, unknown.together()));
        let priors = file.checked(unknown.priors(&path, kinds.len()))?;
        for (kind, (path, prior)) in kinds.into_iter().zip(priors) {
            self.add(file, &path, kind, prior)?;
        }
        Ok(())
    }

    /// Errors of recorded places or rotations.
    fn add_base(
        &mut self,
        file: &SceneFile,
        model: &RodModel,
        described: &Described,
        key: &str,
        unknown: &Unknown,
    ) -> Result<(), Error> {
        let path = &format!("estimate.{key}");
        let prior = file.prior_of_one(path, &Some(unknown.clone()))?;
        let Some(PriorSpread::Normal(sigma)) = prior else { unreachable!("the scene was checked") };
        let (followed, run) = (described.followed, described.run);
        let isotropic = described.section.ei1 == described.section.ei2;
        let about_t = estimate_supports::turns_show(model, &file.scene.estimate, isotropic);
        let all = match key {
            "base" => estimate_supports::of_base(unknown, sigma, model, followed, run),
            _ => estimate_supports::of_base_rotation(unknown, sigma, model, followed, (run, about_t)),
        };
        for (constant, parameter) in all.map_err(|message| file.invalid(path, message))? {
            self.of_rod.push(parameter);
            self.of_model += 1;
            self.constants.push(constant);
        }
        Ok(())
    }

    /// A constant of the rod, and what it changes.
    fn add(&mut self, file: &SceneFile, path: &str, kind: Kind, prior: &ConstantPrior) -> Result<(), Error> {
        let Kind { name, unit, value, change } = kind;
        let (law, sigma) = match file.checked(prior.spread(path))? {
            PriorSpread::Normal(sigma) => (Law::Linear, sigma),
            PriorSpread::LogNormal(sigma) if value != 0.0 => (Law::Exponential, sigma),
            PriorSpread::LogNormal(_) => {
                let message =
                    format!("{name} is 0 in the scene, and a share of it too: give sigma in {unit}");
                return Err(file.invalid(path, message));
            }
        };
        let change = match (law, change) {
            // linear in p, in the unit of the constant
            (Law::Linear, Effect::Share(_)) if value == 0.0 => {
                let message = format!("{name} is 0 in the scene: give it a positive value, its prior's");
                return Err(file.invalid(path, message));
            }
            (Law::Linear, Effect::Share(change)) => times(change, 1.0 / value),
            (Law::Exponential, Effect::Share(change)) => change,
            (Law::Linear, Effect::Unit(change)) => change,
            (Law::Exponential, Effect::Unit(change)) => times(change, value),
        };
        self.of_rod.push(Parameter { change, law });
        self.of_model += 1;
        self.constants.push(Constant { name, unit, value, law, sigma });
        Ok(())
    }

    /// A field along the rod: one number at every interior vertex, for each component.
    fn add_field(
        &mut self,
        file: &SceneFile,
        path: &str,
        key: &'static str,
        prior: &ConstantPrior,
        length: f64,
        rod: &Rod,
        model: &RodModel,
    ) -> Result<(), Error> {
        let s = rod.arc_lengths();
        let inner = rod.voronoi_lengths.len();
        let PriorSpread::Normal(sigma) = file.checked(prior.spread(path))? else {
            return Err(file.invalid(path, "a field is known to so much of its unit, not to a share"));
        };
        let (components, unit) = if key == "natural_twist" { (1, "rad/m") } else { (2, "1/m") };
        for c in 0..components {
            let first = self.len();
            for i in 0..inner {
                let mut change = Change::default();
                let (name, value) = if key == "natural_twist" {
                    change.natural_twist = vec![0.0; inner];
                    change.natural_twist[i] = rod.voronoi_lengths[i];
                    (format!("{key}(s = {:.4} m)", s[i + 1]), model.natural_twist)
                } else {
                    change.natural_curvature = vec![[0.0; 2]; inner];
                    change.natural_curvature[i][c] = rod.voronoi_lengths[i];
                    (format!("{key}[{c}](s = {:.4} m)", s[i + 1]), model.natural_curvature[c])
                };
                self.of_rod.push(Parameter { change, law: Law::Linear });
                self.of_model += 1;
                self.constants.push(Constant { name, unit, value, law: Law::Linear, sigma });
            }
            self.fields.push((first..self.len(), s[1..=inner].to_vec(), length));
        }
        Ok(())
    }

    /// Where the i-th is along the rod \[m\], of a field.
    pub(crate) fn arc_length(&self, i: usize) -> Option<f64> {
        let (range, places, _) = self.fields.iter().find(|field| field.0.contains(&i))?;
        Some(places[i - range.start])
    }

    /// Which of them are numbers of their own, of no field and of no error in time; none where they are many.
    pub(crate) fn single(&self) -> Vec<usize> {
        let is_single = |i: &usize| self.arc_length(*i).is_none() && !is_of_input(&self.constants[*i].name);
        let all: Vec<usize> = (0..self.len()).filter(is_single).collect();
        if all.len() > MOST_PROFILED { Vec::new() } else { all }
    }

    /// The covariance of their prior.
    ///
    /// # Errors
    /// [`Error::Covariance`] where that of a field cannot be formed.
    pub(crate) fn covariance(&self) -> Result<Box<dyn Precision>, Error> {
        let mut parts: Vec<Box<dyn Precision>> = Vec::new();
        let mut next = 0;
        while next < self.len() {
            match self.fields.iter().find(|field| field.0.start == next) {
                Some((range, places, length)) => {
                    let kernel = Kernel::Matern52 { length: *length };
                    let sigma = self.constants[next].sigma;
                    let function = CovarianceFunction { sigma, kernel, taper: Taper::None };
                    parts.push(Box::new(Markov::new(&function, places, &[])?));
                    next = range.end;
                }
                None => {
                    parts.push(Box::new(Diagonal::uniform(1, self.constants[next].sigma)?));
                    next += 1;
                }
            }
        }
        Ok(Box::new(BlockDiagonal::new(parts)))
    }

    /// `of_state` with the prior of the constants behind it.
    pub(crate) fn behind(&self, of_state: Factored) -> Result<Factored, Error> {
        if self.is_empty() {
            return Ok(of_state);
        }
        let mine = self.covariance()?;
        Ok(match of_state {
            Factored::Full(b) => Factored::Full(Box::new(BlockDiagonal::new(vec![b, mine]))),
            Factored::Singular(b) => {
                let mine: Box<dyn Covariance> = Box::new(mine);
                Factored::Singular(Box::new(BlockDiagonal::new(vec![b, mine])))
            }
        })
    }

    /// `of_state` with nothing behind it: constants have no model error.
    pub(crate) fn without_error(&self, of_state: Factored) -> Factored {
        if self.is_empty() {
            return of_state;
        }
        let of_state: Box<dyn Covariance> = match of_state {
            Factored::Full(b) => Box::new(b),
            Factored::Singular(b) => b,
        };
        Factored::Singular(Box::new(BlockDiagonal::new(vec![of_state, Box::new(WithoutError(self.len()))])))
    }
}

/// The components of a key, in order.
fn kinds(key: &'static str, model: &RodModel, d: &Described, together: bool) -> Vec<Kind> {
    let rod = d.rod;
    let none = Change::default;
    let kind = |name: String, unit, value, change| Kind { name, unit, value, change };
    let named = |unit, value, change| vec![kind(key.to_string(), unit, value, Effect::Share(change))];
    let ei = |c: usize| -> Vec<[f64; 3]> {
        rod.ei.iter().map(|k| std::array::from_fn(|i| if i == 2 * c { k[i] } else { 0.0 })).collect()
    };
    let lengths = |c: usize| -> Vec<[f64; 2]> {
        rod.voronoi_lengths.iter().map(|l| std::array::from_fn(|i| if i == c { *l } else { 0.0 })).collect()
    };
    match key {
        "youngs_modulus" => {
            let gj = if model.shear_follows() { rod.gj.clone() } else { Vec::new() };
            let change = Change { ea: rod.ea.clone(), ei: rod.ei.clone(), gj, ..none() };
            named("Pa", model.material.as_ref().map_or(0.0, |m| m.youngs_modulus), change)
        }
        "ei" if together => named("N m²", d.section.ei1, Change { ei: rod.ei.clone(), ..none() }),
        "ei" => [d.section.ei1, d.section.ei2]
            .into_iter()
            .enumerate()
            .map(|(c, value)| {
                let change = Effect::Share(Change { ei: ei(c), ..none() });
                kind(format!("ei[{c}]"), "N m²", value, change)
            })
            .collect(),
        "gj" => named("N m²", d.section.gj, Change { gj: rod.gj.clone(), ..none() }),
        "ea" => named("N", d.section.ea, Change { ea: rod.ea.clone(), ..none() }),
        "density" | "mass_per_length" => {
            let masses = d.line_masses.to_vec();
            let change = Change { masses, spin_inertia: rod.spin_inertia.clone(), ..none() };
            match key {
                "density" => named("kg/m³", model.material.as_ref().map_or(0.0, |m| m.density), change),
                _ => named("kg/m", d.section.mass_per_length, change),
            }
        }
        "damping_stiffness" => {
            let damping = Damping { stiffness: d.damping.stiffness, mass: 0.0 };
            named("s", d.damping.stiffness, Change { damping, ..none() })
        }
        "damping_mass" => {
            let damping = Damping { stiffness: 0.0, mass: d.damping.mass };
            named("1/s", d.damping.mass, Change { damping, ..none() })
        }
        "natural_curvature" => (0..2)
            .map(|c| {
                let change = Effect::Unit(Change { natural_curvature: lengths(c), ..none() });
                kind(format!("{key}[{c}]"), "1/m", model.natural_curvature[c], change)
            })
            .collect(),
        "natural_twist" => {
            let change = Effect::Unit(Change { natural_twist: rod.voronoi_lengths.clone(), ..none() });
            vec![kind(key.to_string(), "rad/m", model.natural_twist, change)]
        }
        "gravity_direction" => across(model.gravity.into())
            .into_iter()
            .enumerate()
            .map(|(i, axis)| {
                let change = Effect::Unit(Change { gravity_turn: axis, ..none() });
                kind(format!("{key}[{i}]"), "rad", 0.0, change)
            })
            .collect(),
        "point_mass" if together => {
            let mut rod = rod.clone();
            rod.masses.fill(0.0);
            for m in &model.point_masses {
                rod.add_point_mass(m.arc_length, m.mass).expect("hung on the rod before");
            }
            let value = model.point_masses.iter().map(|m| m.mass).sum();
            named("kg", value, Change { masses: rod.masses, ..none() })
        }
        _ => model
            .point_masses
            .iter()
            .enumerate()
            .map(|(i, m)| {
                let mut rod = rod.clone();
                rod.masses.fill(0.0);
                rod.add_point_mass(m.arc_length, 1.0).expect("hung on the rod before");
                let change = Effect::Unit(Change { masses: rod.masses, ..none() });
                kind(format!("point_mass[{i}]"), "kg", m.mass, change)
            })
            .collect(),
    }
}

/// Two axes across gravity: x and y of the model where it points along z.
fn across(gravity: Vector3<f64>) -> [Vector3<f64>; 2] {
    let down = gravity.try_normalize(0.0).unwrap_or(-Vector3::z());
    let first = [Vector3::x(), Vector3::y()].into_iter().find(|a| a.cross(&down).norm() > 0.7);
    let first = first.unwrap_or_else(Vector3::z);
    let first = (first - down * first.dot(&down)).normalize();
    [first, first.cross(&down)]
}
