//! What `[observations]` must satisfy beyond the type of each key.

use varda_implicit::line::Ends;

use super::invalid::{Check, invalid, on_rod};
use super::parsed::Along;
use super::validate_frame::{validate_frame, validate_rotation};
use super::{
    Camera, Frame, Kernel, Model, Origin, Recording, RodModel, Scene, Sensor, Synthetic, UnreachableRows, Use,
};

/// Observations of a twin experiment with a rod.
pub(super) fn validate_places(s: &Synthetic, scene: &Scene, rod: &RodModel) -> Check {
    s.place_sigma()?;
    validate_cameras(&s.cameras)?;
    for (i, camera) in s.cameras.iter().enumerate() {
        if camera.sigma.is_none() {
            return invalid(format!("observations.cameras.{i}.sigma"), "a twin draws pixels with it [px]");
        }
        if camera.used == Use::Withhold {
            return invalid(format!("observations.cameras.{i}.use"), "a twin assimilates what it draws");
        }
    }
    validate_sensors(&s.sensors, scene, rod)?;
    for (i, sensor) in s.sensors.iter().enumerate() {
        if sensor.sigma.is_none() {
            let message = format!("a twin draws {} with it", sensor.kind.columns().join(", "));
            return invalid(format!("observations.sensors.{i}.sigma"), message);
        }
        if sensor.used == Use::Withhold {
            return invalid(format!("observations.sensors.{i}.use"), "a twin assimilates what it draws");
        }
    }
    validate_times(s, scene)?;
    let length = rod.rest_lengths()?.iter().sum();
    if s.places.is_empty() && (s.sensors.is_empty() || !s.cameras.is_empty()) {
        return invalid("observations", "a rod needs `places`, the observed arc lengths [m]");
    }
    if !s.components.is_empty() {
        return invalid("observations.components", "a rod is observed at `places` (arc lengths)");
    }
    s.places.iter().enumerate().try_for_each(|(i, s)| on_rod(&format!("observations.places.{i}"), *s, length))
}

/// Observations of a twin experiment with another model.
pub(super) fn validate_components(s: &Synthetic, scene: &Scene) -> Check {
    s.sigma()?;
    validate_times(s, scene)?;
    if !s.places.is_empty() {
        return invalid("observations.places", "this model is observed in `components`");
    }
    if !s.cameras.is_empty() {
        return invalid("observations.cameras", "cameras see a rod");
    }
    if !s.sensors.is_empty() {
        return invalid("observations.sensors", "sensors are on a rod");
    }
    s.component_sigma()?;
    let n = scene.model.components().unwrap_or(0);
    match s.components.iter().position(|c| *c >= n) {
        Some(i) => {
            let message = format!("the model has components 0 to {}", n - 1);
            invalid(format!("observations.components.{i}"), message)
        }
        None => Ok(()),
    }
}

fn validate_times(s: &Synthetic, scene: &Scene) -> Check {
    let section = "observations";
    s.observed_steps(scene.time.window)?;
    if scene.background.from != Origin::TruthPlusDraw {
        return invalid(
            section,
            "synthetic observations need a truth: background.from = \"truth-plus-draw\"",
        );
    }
    let window = scene.time.window;
    if let Some(i) = s.steps.as_ref().and_then(|steps| steps.iter().position(|k| *k > window)) {
        return invalid(
            format!("{section}.steps.{i}"),
            format!("outside the window, which has {window} steps"),
        );
    }
    if s.every.is_some_and(|e| e > window) {
        return invalid(
            format!("{section}.every"),
            format!("no observation falls in the window, which has {window} steps"),
        );
    }
    Ok(())
}

/// Observations of a rod read from a file.
pub(super) fn validate_recording(f: &Recording, scene: &Scene, rod: &RodModel) -> Check {
    let length = rod.rest_lengths()?.iter().sum();
    for (i, marker) in f.markers.iter().enumerate() {
        on_rod(&format!("observations.markers.{i}.arc_length"), marker.arc_length, length)?;
        if f.markers[..i].iter().any(|m| m.name == marker.name) || f.ignore.contains(&marker.name) {
            return invalid(
                format!("observations.markers.{i}.name"),
                format!("marker {:?} is named twice", marker.name),
            );
        }
        if rod.followed_markers().any(|name| name == marker.name) {
            return invalid(
                format!("observations.markers.{i}.name"),
                format!("marker {:?} moves a support: it cannot be observed as well", marker.name),
            );
        }
    }
    validate_cameras(&f.cameras)?;
    if f.pixels.is_some() && f.cameras.is_empty() {
        return invalid("observations.pixels", "needs [[observations.cameras]]");
    }
    validate_sensors(&f.sensors, scene, rod)?;
    if f.readings.is_some() == f.sensors.is_empty() {
        let (key, other) = match f.sensors.is_empty() {
            true => ("readings", "[[observations.sensors]]"),
            false => ("sensors", "`readings`, the file of what they read"),
        };
        return invalid(format!("observations.{key}"), format!("needs {other}"));
    }
    validate_frame(&f.frame, "observations.frame")
}

fn validate_sensors(sensors: &[Sensor], scene: &Scene, rod: &RodModel) -> Check {
    let length = rod.rest_lengths()?.iter().sum();
    for (i, sensor) in sensors.iter().enumerate() {
        on_rod(&format!("observations.sensors.{i}.arc_length"), sensor.arc_length, length)?;
        if sensors[..i].iter().any(|other| other.name == sensor.name) {
            let message = format!("sensor {:?} is there twice", sensor.name);
            return invalid(format!("observations.sensors.{i}.name"), message);
        }
        if let Some(axes) = &sensor.axes {
            let key = format!("observations.sensors.{i}.axes");
            validate_rotation(axes, &key)?;
            if !sensor.kind.has_axes() {
                return invalid(key, "is of kinds \"specific-force\" and \"orientation\" alone");
            }
        }
    }
    if sensors.is_empty() {
        return Ok(());
    }
    if scene.time.tolerance.is_some() {
        let message = "sensors on a rod take the rates of a state from steps of the grid: leave it out";
        return invalid("time.tolerance", message);
    }
    if scene.estimate.clock.is_some() {
        let message = "the forces of a state that is moved along its velocities by a clock's offset are \
                       those of a stretched rod: leave it out, or [[observations.sensors]]";
        return invalid("estimate.clock", message);
    }
    Ok(())
}

fn validate_cameras(cameras: &[Camera]) -> Check {
    for (i, camera) in cameras.iter().enumerate() {
        let key = |name: &str| format!("observations.cameras.{i}.{name}");
        if cameras[..i].iter().any(|other| other.name == camera.name) {
            return invalid(key("name"), format!("camera {:?} is there twice", camera.name));
        }
        if let Some(f) = camera.focal_length.iter().find(|f| !(**f > 0.0)) {
            return invalid(key("focal_length"), format!("{f} px: a focal length is above 0"));
        }
        if let Some(size) = camera.image.iter().flatten().find(|size| !(**size > 0.0)) {
            return invalid(key("image"), format!("{size} px: width and height are above 0"));
        }
        validate_rotation(&camera.rotation, &key("rotation"))?;
    }
    Ok(())
}

/// Observations of another model read from a file.
pub(super) fn validate_recorded_components(f: &Recording) -> Check {
    let of_rods = [
        ("frame", f.frame != Frame::default()),
        ("unreachable", f.unreachable != UnreachableRows::default()),
        ("max_speed", f.max_speed.is_some()),
        ("markers", !f.markers.is_empty()),
        ("ignore", !f.ignore.is_empty()),
        ("pixels", f.pixels.is_some()),
        ("cameras", !f.cameras.is_empty()),
        ("readings", f.readings.is_some()),
        ("sensors", !f.sensors.is_empty()),
    ];
    match of_rods.iter().find(|(_, given)| *given) {
        Some((key, _)) => {
            let message = "is about rods: a row of this model's file is time_s,component,value";
            invalid(format!("observations.{key}"), message)
        }
        None => Ok(()),
    }
}

/// The correlation of errors.
pub(super) fn validate_correlation(scene: &Scene) -> Check {
    let Some(keys) = scene.observations.correlation() else { return Ok(()) };
    let path = "observations.correlation";
    let along = keys.along()?;
    if keys.kernel == Kernel::Gaussian {
        let message = "errors of observations take \"matern-1/2\", \"matern-3/2\" or \"matern-5/2\": a \
                       Gaussian kernel has no inverse to working precision";
        return invalid(format!("{path}.kernel"), message);
    }
    if scene.algorithm.background_check.is_some() {
        let message = "the background check judges values one by one: it takes independent errors \
                       (algorithm.robust works with correlated ones)";
        return invalid("algorithm.background_check", message);
    }
    match along {
        Along::Length(_) if !scene.observations.sensors().is_empty() => {
            invalid(format!("{path}.length"), "sensors and markers have no common line: take `time`")
        }
        Along::Length(_) if !scene.observations.cameras().is_empty() => {
            let message = "pixels of several cameras have no common line: take `time`";
            invalid(format!("{path}.length"), message)
        }
        Along::Time(_) if scene.algorithm.cycles.is_some() => {
            let message =
                "errors correlated in time tie one window to the next: take one window, or `length`";
            invalid(format!("{path}.time"), message)
        }
        Along::Length(_) => match (&scene.model, scene.model.line()) {
            (Model::Rod(_), _) => Ok(()),
            (_, Some(line)) if line.ends != Ends::Periodic => Ok(()),
            (_, Some(_)) => invalid(
                format!("{path}.length"),
                "errors are correlated along a line with two ends, and this one closes to a circle",
            ),
            (_, None) => invalid(format!("{path}.length"), "this model has no line; take `time`"),
        },
        Along::Time(_) => Ok(()),
    }
}
