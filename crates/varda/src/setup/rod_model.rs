//! From `[model] kind = "rod"` to the rod of varda-rod.

use std::f64::consts::TAU;

use varda_implicit::{ParameterPlaces, Scheme};
use varda_rod::{
    Clamp, ClampAt, Damping, Loads, Material, Rest, Rod, RodStep, Search, Section, Supports, Vector3, rest,
};

use crate::Error;
use crate::scene::{self, Integrator, RodModel, SceneFile, Shear, rounded};
use crate::setup::csv;
use crate::setup::estimate::{Described, Estimates};
use crate::setup::files::Files;
use crate::setup::loads::loads;
use crate::setup::motion::{Held, Motions, Moving};

/// A rod with what holds it and what pulls at it.
#[derive(Clone)]
pub struct RodParts {
    /// The rod.
    pub rod: Rod,
    /// What holds it.
    pub supports: Supports,
    /// What pulls at it.
    pub loads: Loads,
    /// Sum of the largest sizes of its forces, without its weight \[N\].
    pub pull: f64,
    /// What damps it.
    pub damping: Damping,
    /// How it is integrated.
    pub scheme: Scheme,
    /// It is at rest at every step.
    pub at_rest_always: bool,
    /// What picks its equilibrium.
    pub search: Search,
    /// How the recorded motions of its supports are followed.
    pub remarks: Vec<String>,
    /// Whether angles and spins at the start of a window are unknowns.
    pub spins_in_control: bool,
    /// The rod at rest at a time \[s\], the start of a run, whose angles the first step starts from.
    pub first: Option<(Rest, f64)>,
    /// Angle of the end clamp \[rad\], whole turns included, at a time \[s\] from which runs start, where a
    /// file or an earlier window says it.
    pub end_angle: Option<(f64, f64)>,
    /// What is unknown beside the state.
    pub estimates: Estimates,
}

impl RodParts {
    /// The rod a scene describes.
    ///
    /// # Errors
    /// [`Error::Scene`] pointing at the key, or the error of a file it names.
    pub(crate) fn read(files: &Files, model: &RodModel) -> Result<RodParts, Error> {
        let file = files.scene;
        let refuse = |path: &str| {
            let path = path.to_string();
            move |e: varda_rod::Error| file.invalid(&path, e.to_string())
        };
        let (section, rotary_inertia) = section(file, model)?;
        let mut rod = Rod::with_segments(&file.checked(model.rest_lengths())?, &section)
            .map_err(refuse("model"))?
            .with_faces(model.faces())
            .naturally(model.natural_curvature, model.natural_twist);
        if model.twist_inertia {
            rod = rod.with_rotary_inertia(rotary_inertia);
        }
        let line_masses = rod.masses.clone();
        for (i, mass) in model.point_masses.iter().enumerate() {
            rod.add_point_mass(mass.arc_length, mass.mass)
                .map_err(refuse(&format!("model.point_masses.{i}")))?;
        }
        let search = match &model.initial_shape {
            Some(keys) => {
                Search::default().with_initial_shape(shape(files, "model.initial_shape", keys, &rod)?)
            }
            None => Search::default(),
        };
        if let Some(keys) = &model.rest_shape {
            let measured = shape(files, "model.rest_shape", &keys.shape(), &rod)?;
            let director =
                keys.director.or(model.start.as_ref().and_then(|c| c.director)).unwrap_or_default();
            rod = rod.at_ease_in(&measured.vertices, director.into()).map_err(refuse("model.rest_shape"))?;
        }
        let mut motions = Motions::of(files)?;
        let mut supports = Supports::default();
        if let Some(clamp) = &model.start {
            supports.start = Some(self::clamp(&mut motions, "model.start", model.clamp, clamp)?);
        }
        if let Some(clamp) = &model.end {
            supports.end = Some(self::clamp(&mut motions, "model.end", model.clamp, clamp)?);
        }
        for (i, p) in model.prescribed.iter().enumerate() {
            let held = Held { position: p.position, ..Held::default() };
            let moving = motions.read(&format!("model.prescribed.{i}"), held, p.motion.as_ref())?;
            supports.prescribed.push((p.vertex, moving.place));
        }
        let (loads, pull) = loads(file, &mut motions, model, &rod)?;
        let damping = Damping { stiffness: model.damping.stiffness, mass: model.damping.mass };
        let scheme = file.checked(file.scene.time.integrator.of_rod())?;
        let (run, followed, mut remarks) = (motions.run, motions.followed, motions.remarks);
        remarks.extend(edge_clamps(model, &rod));
        let covariance = file.checked(file.scene.background.covariance.of_rod("background.covariance"))?;
        let spins_in_control = match covariance {
            Some(kernel) => file.checked(kernel.spin_sigmas("background.covariance"))?.is_some(),
            None => false,
        };
        let between_faces = rod.clone().with_faces(supports.faces());
        let described = Described {
            section: &section,
            line_masses: &line_masses,
            rod: &between_faces,
            damping,
            followed: &followed,
            run,
        };
        let estimates = Estimates::of_rod(file, model, &described)?;
        let parts = RodParts {
            estimates,
            rod,
            supports,
            loads,
            pull,
            damping,
            scheme,
            at_rest_always: file.scene.time.integrator == Integrator::QuasiStatic,
            search,
            remarks,
            spins_in_control,
            first: None,
            end_angle: None,
        };
        parts.dynamics().map_err(refuse("model"))?;
        Ok(parts)
    }

    /// Its dynamics by the integrator of the scene.
    ///
    /// # Errors
    /// What varda-rod finds impossible.
    pub fn dynamics(&self) -> Result<RodStep, varda_rod::Error> {
        let (rod, supports, loads) = (self.rod.clone(), self.supports.clone(), self.loads.clone());
        let step = match self.estimates.of_rod.clone() {
            none if none.is_empty() => RodStep::new(rod, supports, loads, self.damping)?,
            unknown => RodStep::with_parameters(rod, supports, loads, self.damping, unknown)?,
        };
        let mut step = if self.at_rest_always { step.at_rest()? } else { step.with_scheme(self.scheme) };
        if self.spins_in_control {
            step = step.with_spins_in_control();
        }
        let step = match &self.first {
            Some((first, t)) => step.starting_from(first, *t),
            None => step,
        };
        Ok(match self.end_angle {
            Some((angle, t)) => step.with_end_angle(angle, t),
            None => step,
        })
    }

    /// Where the unknown constants stand in a state.
    ///
    /// # Errors
    /// What varda-rod finds impossible.
    pub(crate) fn places(&self) -> Result<ParameterPlaces, varda_rod::Error> {
        Ok(ParameterPlaces::of(&self.dynamics()?, self.estimates.len()))
    }

    /// The rod at rest, supports where they are at time t \[s\].
    ///
    /// # Errors
    /// [`Error::Preparation`] where no equilibrium is found.
    pub fn at_rest(&self, t: f64) -> Result<Rest, Error> {
        let mut search = self.search.clone();
        let turned = TAU * self.supports.turns_at(t);
        if let Some(shape) = search.initial_shape.as_mut().filter(|_| turned != 0.0) {
            // measured places say nothing of twist
            let n = shape.theta.len() as f64;
            shape.theta.iter_mut().enumerate().for_each(|(e, a)| *a += turned * (e as f64 + 0.5) / n);
        }
        let found = rest(&self.rod, &self.supports, &self.loads, t, &search)
            .map_err(|reason| Error::Preparation { stage: "static equilibrium", reason })?;
        Ok(found.rest)
    }
}

/// The shape that keys describe.
fn shape(files: &Files, path: &str, keys: &scene::ShapePoints, rod: &Rod) -> Result<Rest, Error> {
    let Some(name) = &keys.file else {
        let points = keys.points.iter().flatten().map(|p| Vector3::from(*p)).collect::<Vec<_>>();
        return Rest::through(rod, &points)
            .map_err(|e| files.scene.invalid(&format!("{path}.points"), e.to_string()));
    };
    let path = format!("{path}.file");
    let (label, text) = files.text(&path, name)?;
    let rows = csv::numbers(&label, &text, ["s_m", "x_m", "y_m", "z_m"])?;
    let length = rod.length();
    if let Some(i) = rows.iter().position(|r| !(r[0] >= 0.0 && r[0] <= length * (1.0 + 1e-9))) {
        let message = format!("arc length {} m is off the rod (0 to {} m)", rows[i][0], rounded(length));
        return Err(Error::Data { place: format!("{label}, row {}", i + 1), message });
    }
    let s: Vec<f64> = rows.iter().map(|r| r[0]).collect();
    let points: Vec<_> = rows.iter().map(|&[_, x, y, z]| Vector3::new(x, y, z)).collect();
    Rest::through_at(rod, &s, &points).map_err(|e| Error::Data { place: label, message: e.to_string() })
}

/// The section, and its ρ(I₁ + I₂) per length \[kg m\], zero where that is not given.
fn section(file: &SceneFile, model: &RodModel) -> Result<(Section, f64), Error> {
    let solid = |of: &dyn Fn(&Material) -> Section| {
        let m = file.checked(model.solid_material())?;
        let material = match m.shear {
            Shear::Modulus(shear_modulus) => {
                Material { youngs_modulus: m.youngs_modulus, shear_modulus, density: m.density }
            }
            Shear::PoissonRatio(ratio) => Material::new(m.youngs_modulus, ratio, m.density),
        };
        let section = of(&material);
        Ok((section, section.rotary_inertia(&material)))
    };
    match model.section {
        scene::Section::Circle { radius } => solid(&|m| Section::circle(m, radius)),
        scene::Section::Ellipse { semi_axes: [a1, a2] } => solid(&|m| Section::ellipse(m, a1, a2)),
        scene::Section::Rectangle { width, height } => solid(&|m| Section::rectangle(m, width, height)),
        scene::Section::Stiffness { ea, ei: [ei1, ei2], gj, mass_per_length, rotary_inertia } => {
            Ok((Section { ea, ei1, ei2, gj, mass_per_length }, rotary_inertia.unwrap_or(0.0)))
        }
    }
}

fn clamp(
    motions: &mut Motions,
    path: &str,
    at: scene::ClampAt,
    clamp: &scene::Clamp,
) -> Result<Clamp, Error> {
    let held = Held { position: clamp.position, tangent: clamp.tangent, director: clamp.director };
    let Moving { place, tangent, director } = motions.read(path, held, clamp.motion.as_ref())?;
    let at = match at {
        scene::ClampAt::Face => ClampAt::Face,
        scene::ClampAt::Edge => ClampAt::Edge,
    };
    let turns = clamp.turns.as_ref().map(|turns| motions.turns(path, turns)).transpose()?;
    Ok(Clamp { at, position: place, tangent, director, turns })
}

/// What to know of neighbouring vertices whose places are given: they hold an edge.
fn edge_clamps(model: &RodModel, rod: &Rod) -> Vec<String> {
    let mut held: Vec<usize> = model.prescribed.iter().map(|p| p.vertex).collect();
    held.sort_unstable();
    let pairs = held.windows(2).filter(|pair| pair[0] + 1 == pair[1]);
    let remark = |pair: &[usize]| {
        let half = rounded(0.5 * rod.rest_lengths[pair[0]]);
        format!(
            "prescribed vertices {} and {} hold the edge between them as a clamp does: the rod bends as if \
             it were half a segment ({half} m) shorter; [model.start] and [model.end] hold it at their faces",
            pair[0], pair[1]
        )
    };
    pairs.map(remark).collect()
}
