//! From `[estimate]` to unknown constants of what is observed: places of sites, mounts, cameras, biases.

use std::collections::BTreeMap;
use std::rc::Rc;

use varda_rod::Law;

use super::constant::Constant;
use super::estimate::Estimates;
use crate::Error;
use crate::scene::{ConstantPrior, Model, Observations, PriorSpread, SceneFile, Unknown};

const AXES: [&str; 3] = ["x", "y", "z"];

impl Estimates {
    /// What the observations depend on; `width` values to a site.
    pub(super) fn add_of_observations(&mut self, file: &SceneFile, width: usize) -> Result<(), Error> {
        let estimate = &file.scene.estimate;
        if [&estimate.marker_arc_length, &estimate.marker_offset].into_iter().any(Option::is_some) {
            self.seen.sites = sites(file)?.len();
        }
        if let Some(unknown) = &estimate.marker_arc_length {
            self.seen.arc_length = Some(self.len());
            let names: Vec<String> =
                sites(file)?.iter().map(|site| format!("marker_arc_length[{site}]")).collect();
            self.add_additive(file, "estimate.marker_arc_length", unknown, &names, "m")?;
        }
        if let Some(unknown) = &estimate.marker_offset {
            self.seen.offset = Some(self.len());
            let of = |site: &String| ["m1", "m2", "t"].map(|axis| format!("marker_offset[{site}].{axis}"));
            let names: Vec<String> = sites(file)?.iter().flat_map(of).collect();
            self.add_additive(file, "estimate.marker_offset", unknown, &names, "m")?;
        }
        let mounts = [
            ("mount_rotation", &estimate.mount_rotation, "rad"),
            ("mount_translation", &estimate.mount_translation, "m"),
        ];
        for (key, unknown, unit) in mounts {
            let Some(unknown) = unknown else { continue };
            let first = self.len();
            match key {
                "mount_rotation" => self.seen.rotation = Some(first),
                _ => self.seen.translation = Some(first),
            }
            let names = AXES.map(|axis| format!("{key}.{axis}"));
            self.add_additive(file, &format!("estimate.{key}"), unknown, &names, unit)?;
        }
        self.add_poses(file)?;
        match &estimate.bias {
            Some(Unknown::Named(by_name)) => self.add_named_biases(file, by_name, width)?,
            Some(unknown) => {
                let first = self.len();
                let names: Vec<String> =
                    sites(file)?.iter().flat_map(|site| bias(site, &AXES[..width])).collect();
                self.seen.bias = (first..first + names.len()).map(Some).collect();
                self.add_additive(
                    file,
                    "estimate.bias",
                    unknown,
                    &names,
                    if width == 1 { "1" } else { "m" },
                )?;
            }
            None => {}
        }
        if let Some(unknown) = &estimate.clock {
            (self.seen.clock, self.seen.clock_known) = (Some(self.len()), file.adjusted.clock);
            self.add_additive(file, "estimate.clock", unknown, &["clock".to_string()], "s")?;
        }
        Ok(())
    }

    /// Rotations and displacements of cameras.
    fn add_poses(&mut self, file: &SceneFile) -> Result<(), Error> {
        let estimate = &file.scene.estimate;
        let keys = [
            ("camera_rotation", &estimate.camera_rotation, "rad"),
            ("camera_translation", &estimate.camera_translation, "m"),
        ];
        let cameras = file.scene.observations.cameras();
        let mut poses = vec![[None; 2]; cameras.len()];
        for (i, (key, unknown, unit)) in keys.into_iter().enumerate() {
            let Some(unknown) = unknown else { continue };
            let path = format!("estimate.{key}");
            let names = |camera: &str| AXES.map(|axis| format!("{key}[{camera}].{axis}"));
            if !matches!(unknown, Unknown::Named(_)) {
                let first = self.len();
                let all: Vec<String> = cameras.iter().flat_map(|camera| names(&camera.name)).collect();
                self.add_additive(file, &path, unknown, &all, unit)?;
                poses.iter_mut().enumerate().for_each(|(c, pose)| pose[i] = Some(first + 3 * c));
            }
            let Unknown::Named(by_name) = unknown else { continue };
            for (camera, pose) in cameras.iter().zip(&mut poses) {
                let Some(prior) = by_name.get(&camera.name) else { continue };
                let (path, prior) = (format!("{path}.{}", camera.name), Unknown::Every(prior.clone()));
                pose[i] = Some(self.len());
                self.add_additive(file, &path, &prior, &names(&camera.name), unit)?;
            }
        }
        if poses.iter().flatten().any(Option::is_some) {
            self.seen.poses = poses.into();
        }
        Ok(())
    }

    /// Biases of sensors and sites by their names.
    fn add_named_biases(
        &mut self,
        file: &SceneFile,
        by_name: &BTreeMap<String, ConstantPrior>,
        width: usize,
    ) -> Result<(), Error> {
        let sensors = file.scene.observations.sensors();
        let sites = sites(file).unwrap_or_default();
        let is_known = |name: &String| sites.contains(name) || sensors.iter().any(|s| s.name == *name);
        if let Some(name) = by_name.keys().find(|name| !is_known(name)) {
            let known = sensors.iter().map(|s| &s.name).chain(&sites).cloned().collect::<Vec<_>>().join(", ");
            let message = format!("{name:?} is none of what is observed: {known}");
            return Err(file.invalid("estimate.bias", message));
        }
        let mut rows = |all: Vec<(&String, &[&str], &'static str)>| -> Result<Rc<[Option<usize>]>, Error> {
            let mut rows = Vec::new();
            for (name, axes, unit) in all {
                let first = self.len();
                let Some(prior) = by_name.get(name) else {
                    rows.extend(axes.iter().map(|_| None));
                    continue;
                };
                let (path, unknown) = (format!("estimate.bias.{name}"), Unknown::Every(prior.clone()));
                self.add_additive(file, &path, &unknown, &bias(name, axes), unit)?;
                rows.extend((first..self.len()).map(Some));
            }
            Ok(rows.into())
        };
        let unit = if width == 1 { "1" } else { "m" };
        let of_sites = rows(sites.iter().map(|site| (site, &AXES[..width], unit)).collect())?;
        let quantities = sensors.iter().map(|s| (&s.name, s.kind.quantity()));
        let of_sensors = rows(quantities.map(|(name, of)| (name, of.axes(), of.unit())).collect())?;
        (self.seen.bias, self.seen.bias_of_sensors) = (of_sites, of_sensors);
        Ok(())
    }

    /// Numbers that are zero in the scene and added to what is observed.
    fn add_additive(
        &mut self,
        file: &SceneFile,
        path: &str,
        unknown: &Unknown,
        names: &[String],
        unit: &'static str,
    ) -> Result<(), Error> {
        let priors = file.checked(unknown.priors(path, names.len()))?;
        for (name, (path, prior)) in names.iter().zip(priors) {
            let PriorSpread::Normal(sigma) = file.checked(prior.spread(&path))? else {
                return Err(file.invalid(&path, "is zero in the scene: give sigma in its unit, not a share"));
            };
            self.constants.push(Constant { name: name.clone(), unit, value: 0.0, law: Law::Linear, sigma });
        }
        Ok(())
    }
}

/// The names of biases of what has such axes; one value has no axis.
fn bias(name: &str, axes: &[&str]) -> Vec<String> {
    match axes {
        [_] => vec![format!("bias[{name}]")],
        _ => axes.iter().map(|axis| format!("bias[{name}].{axis}")).collect(),
    }
}

/// Names of what is observed, in the order of its rows.
fn sites(file: &SceneFile) -> Result<Vec<String>, Error> {
    match (&file.scene.observations, &file.scene.model) {
        (Observations::File(recording), _) if recording.markers.is_empty() => {
            let message = "an unknown of every marker needs [[observations.markers]]";
            Err(file.invalid("estimate", message))
        }
        (Observations::File(recording), _) => Ok(recording.markers.iter().map(|m| m.name.clone()).collect()),
        (Observations::Synthetic(keys), Model::Rod(_)) => {
            Ok(keys.places.iter().map(|s| format!("s = {s} m")).collect())
        }
        (Observations::Synthetic(keys), model) if keys.components.is_empty() => {
            Ok((0..model.components().unwrap_or(0)).map(|c| c.to_string()).collect())
        }
        (Observations::Synthetic(keys), _) => Ok(keys.components.iter().map(usize::to_string).collect()),
    }
}
