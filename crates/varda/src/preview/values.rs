//! Values that a scene may have and that are seldom meant: another unit, most often.

use super::finding::Finding;
use crate::scene::{
    Camera, Clamp, Covariance, Integrator, KernelCovariance, Model, Motion, Observations, RodModel, Scene,
    Section, rounded,
};

/// What of a scene looks as if it were not meant.
pub(super) fn values(scene: &Scene) -> Vec<Finding> {
    let mut found = Found::default();
    match &scene.model {
        Model::Rod(rod) => {
            let length = rod.rest_lengths().map_or(f64::NAN, |l| rounded(l.iter().sum()));
            of_rod(rod, length, &mut found);
            of_time(scene, &mut found);
            of_background(&scene.background.covariance, length, &mut found);
            of_observations(&scene.observations, length, &mut found);
            scene.observations.cameras().iter().enumerate().for_each(|(i, c)| of_camera(c, i, &mut found));
        }
        other => of_components(other, scene, &mut found),
    }
    found.0
}

#[derive(Default)]
struct Found(Vec<Finding>);

impl Found {
    /// A warning where a value is wrong.
    fn say(&mut self, wrong: bool, place: &str, text: impl FnOnce() -> String) {
        if wrong {
            self.0.push(Finding::warning(place, text()));
        }
    }
}

fn of_rod(rod: &RodModel, length: f64, found: &mut Found) {
    let thickest = thickness(&rod.section);
    found.say(length > 100.0, "model.length", || {
        format!(
            "a rod {length} m long: lengths are metres; {} m was meant, written in mm?",
            rounded(1e-3 * length)
        )
    });
    found.say(length < 5e-3, "model.length", || {
        format!("a rod {length} m long: lengths are metres; {} m was meant?", rounded(1e3 * length))
    });
    found.say(thickest > 0.25 * length, "model.section", || {
        format!(
            "{thickest} m from the middle to the outside, on a rod {length} m long, is no rod; millimetres, \
             {} m?",
            rounded(1e-3 * thickest)
        )
    });
    found.say(thickest > 0.0 && thickest < 1e-5, "model.section", || {
        format!("{thickest} m is thinner than a hair; was {} m meant?", rounded(1e3 * thickest))
    });
    if let Some(material) = &rod.material {
        let (e, rho) = (material.youngs_modulus, material.density);
        found.say(e < 1e4, "model.material.youngs_modulus", || {
            format!(
                "{e} Pa is softer than a gel; GPa or MPa, {:e} or {:e} Pa?",
                rounded(1e9 * e),
                rounded(1e6 * e)
            )
        });
        found.say(e > 2e12, "model.material.youngs_modulus", || {
            format!("{e:e} Pa is stiffer than diamond; {:e} Pa?", rounded(1e-3 * e))
        });
        found.say(rho < 10.0, "model.material.density", || {
            format!("{rho} kg/m³ is little more than air; g/cm³, {} kg/m³?", rounded(1e3 * rho))
        });
        found.say(rho > 25e3, "model.material.density", || {
            format!("{rho} kg/m³ is more than any metal has; {} kg/m³?", rounded(1e-3 * rho))
        });
    }
    if let Section::Stiffness { ea, ei, gj, .. } = rod.section {
        let most = ei[0].max(ei[1]);
        // of a section of any shape EI/EA is the square of a length across it
        let across = (most / ea).sqrt();
        found.say(across > 0.25 * length, "model.section.ei", || {
            format!(
                "EI = {most} N m² with EA = {ea} N is that of a section {across:.3} m across, on a rod \
                 {length} m long; N mm², EI = {:e} N m²?",
                rounded(1e-6 * most)
            )
        });
        found.say(
            gj > 0.0 && most > 0.0 && !(1e-3..=10.0).contains(&(gj / most)),
            "model.section.gj",
            || format!("GJ = {gj} N m² beside EI = {most} N m²: solids have GJ from 0.6 to 1 of EI"),
        );
    }
    let [k1, k2] = rod.natural_curvature;
    let curvature = k1.hypot(k2);
    found.say(curvature * thickest > 0.5, "model.natural_curvature", || {
        format!(
            "{curvature} 1/m bends the rod within its own thickness; a radius in metres, so {:.4} 1/m?",
            1.0 / curvature
        )
    });
    let twist = rod.natural_twist;
    found.say((twist * length).abs() > 200.0, "model.natural_twist", || {
        format!(
            "{twist} rad/m is {:.0} turns; degrees, {:.4} rad/m?",
            twist * length / std::f64::consts::TAU,
            twist.to_radians()
        )
    });
    let gravity = norm(&rod.gravity);
    found.say(gravity > 0.0 && !(0.5..=30.0).contains(&gravity), "model.gravity", || {
        format!("{gravity} m/s², where the Earth has 9.81; mm/s², or another planet?")
    });
    found.say(rod.damping.stiffness > 1.0, "model.damping.stiffness", || {
        let time = rod.damping.stiffness;
        format!("a relaxation time of {time} s; milliseconds, {} s?", rounded(1e-3 * time))
    });
    let mass = line_mass(rod) * length;
    for (i, point) in rod.point_masses.iter().enumerate() {
        found.say(point.mass > 100.0 * mass, &format!("model.point_masses.{i}.mass"), || {
            format!("{} kg on a rod of {mass:.4} kg; grams, {} kg?", point.mass, rounded(1e-3 * point.mass))
        });
    }
    for (path, clamp) in [("model.start", &rod.start), ("model.end", &rod.end)] {
        if let Some(clamp) = clamp {
            of_clamp(clamp, path, length, found);
        }
    }
    let place = |clamp: &Option<Clamp>| clamp.as_ref().filter(|c| c.motion.is_none())?.position;
    if let (Some(a), Some(b)) = (place(&rod.start), place(&rod.end)) {
        let apart = rounded(norm(&[b[0] - a[0], b[1] - a[1], b[2] - a[2]]));
        found.say(apart > 1.2 * length, "model.end.position", || {
            format!(
                "the clamps are {apart} m apart and the rod is {length} m long: it is stretched by {:.0} %",
                100.0 * (apart / length - 1.0)
            )
        });
    }
}

fn of_clamp(clamp: &Clamp, path: &str, length: f64, found: &mut Found) {
    if let (Some(t), Some(d)) = (&clamp.tangent, &clamp.director) {
        let along = (0..3).map(|i| t[i] * d[i]).sum::<f64>() / (norm(t) * norm(d));
        found.say(along.abs() > 0.02, &format!("{path}.director"), || {
            format!(
                "{d:?} is {:.1}° from lying across the tangent {t:?}: m₁ lies across the rod, and the \
                 part across is taken",
                along.abs().asin().to_degrees()
            )
        });
    }
    if let Some(Motion::Ellipse { radii, omega, .. }) = clamp.motion {
        let most = radii[0].abs().max(radii[1].abs());
        found.say(most > 2.0 * length, &format!("{path}.motion.radii"), || {
            format!("{most} m, on a rod {length} m long; millimetres, {} m?", rounded(1e-3 * most))
        });
        let speed = most * omega;
        found.say(speed > 340.0, &format!("{path}.motion.omega"), || {
            format!("{omega} rad/s moves the clamp at {speed:.3e} m/s; degrees a second, or turns a minute?")
        });
    }
}

fn of_time(scene: &Scene, found: &mut Found) {
    if let Some(step) = scene.time.step {
        let moves = scene.time.integrator != Integrator::QuasiStatic;
        found.say(step >= 1.0 && moves, "time.step", || {
            format!("{step} s to a step of a rod; milliseconds, {} s?", rounded(1e-3 * step))
        });
        found.say(step < 1e-6, "time.step", || format!("{step:e} s to a step; {:e} s?", rounded(1e3 * step)));
    }
    if let (Some(n), Model::Rod(_)) = (scene.time.steps_per_period, &scene.model) {
        found.say(n < 12, "time.steps_per_period", || {
            format!("{n} steps do not follow a circle: take 20 or more")
        });
    }
}

fn of_background(covariance: &Covariance, length: f64, found: &mut Found) {
    let Covariance::Kernel(keys) = covariance else { return };
    let KernelCovariance { sigma_x, sigma_v, correlation_length_x, correlation_length_v, .. } = keys;
    let path = "background.covariance";
    if let Some(sigma) = sigma_x {
        found.say(*sigma > length, &format!("{path}.sigma_x"), || {
            format!(
                "{sigma} m, on a rod {length} m long, says that nothing is known; millimetres, {} m?",
                rounded(1e-3 * sigma)
            )
        });
    }
    if let Some(share) = keys.sigma_x_over_length {
        found.say(share > 1.0, &format!("{path}.sigma_x_over_length"), || {
            format!("{share} lengths says that nothing is known; per cent, {}?", rounded(1e-2 * share))
        });
    }
    if let Some(sigma) = sigma_v {
        found.say(*sigma > 100.0, &format!("{path}.sigma_v"), || {
            format!("{sigma} m/s; mm/s, {} m/s?", rounded(1e-3 * sigma))
        });
    }
    for (key, l) in
        [("correlation_length_x", correlation_length_x), ("correlation_length_v", correlation_length_v)]
    {
        found.say(*l > 10.0 * length, &format!("{path}.{key}"), || {
            format!("{l} m on a rod {length} m long; millimetres, {} m?", rounded(1e-3 * l))
        });
    }
}

fn of_observations(observations: &Observations, length: f64, found: &mut Found) {
    let sigma = match observations {
        Observations::Synthetic(keys) => {
            if let Some(share) = keys.sigma_over_length {
                found.say(share > 0.5, "observations.sigma_over_length", || {
                    format!("{share} lengths says nothing of a place; per cent, {}?", rounded(1e-2 * share))
                });
            }
            keys.sigma
        }
        Observations::File(keys) => {
            for (i, marker) in keys.markers.iter().enumerate() {
                let offset = norm(&marker.offset);
                found.say(offset > 0.25 * length, &format!("observations.markers.{i}.offset"), || {
                    format!(
                        "marker {:?} sits {offset} m off a rod {length} m long; millimetres, {:?} m?",
                        marker.name,
                        marker.offset.map(|c| rounded(1e-3 * c))
                    )
                });
            }
            if let Some(speed) = keys.max_speed {
                found.say(speed > 1000.0, "observations.max_speed", || {
                    format!("{speed} m/s; mm/s, {} m/s?", rounded(1e-3 * speed))
                });
            }
            of_angle(keys.frame.angle, "observations.frame.angle", found);
            keys.sigma
        }
    };
    if let Some(sigma) = sigma {
        found.say(sigma >= 0.5 * length, "observations.sigma", || {
            format!(
                "{sigma} m says nothing of a place on a rod {length} m long; millimetres, {} m?",
                rounded(1e-3 * sigma)
            )
        });
        found.say(sigma < 1e-8 * length, "observations.sigma", || {
            format!("{sigma:e} m is finer than atoms on a rod {length} m long; {:e} m?", rounded(1e3 * sigma))
        });
    }
}

/// A calibration in other units, or of an image of another size.
fn of_camera(camera: &Camera, index: usize, found: &mut Found) {
    let key = |name: &str| format!("observations.cameras.{index}.{name}");
    let [fx, fy] = camera.focal_length;
    let name = &camera.name;
    found.say(fx.min(fy) < 50.0, &key("focal_length"), || {
        format!("{fx} and {fy} px: millimetres? In pixels it is f over the size of a pixel, some hundreds")
    });
    found.say(!(0.8..=1.25).contains(&(fx / fy)), &key("focal_length"), || {
        format!("{fx} and {fy} px: pixels of camera {name} would be far from square")
    });
    if let Some([width, height]) = camera.image {
        let [cx, cy] = camera.principal_point;
        let inside = (0.0..width).contains(&cx) && (0.0..height).contains(&cy);
        found.say(!inside, &key("principal_point"), || {
            format!("({cx}, {cy}) px is outside the image, {width} × {height} px: of another size of image?")
        });
    }
    if let Some(sigma) = camera.sigma {
        found.say(sigma > 0.1 * fx.min(fy), &key("sigma"), || {
            format!("{sigma} px, at a focal length of {fx} px, says nothing of a place")
        });
        found.say(sigma < 1e-3, &key("sigma"), || {
            format!("{sigma:e} px is finer than any image; metres? It is in pixels")
        });
    }
    let away = norm(&camera.position);
    found.say(away > 100.0, &key("position"), || {
        format!("camera {name} is {away} m from the origin: millimetres, {} m?", rounded(1e-3 * away))
    });
}

/// More than half a turn; more than a whole one is refused when the scene is read.
fn of_angle(angle: Option<f64>, path: &str, found: &mut Found) {
    if let Some(angle) = angle {
        found.say(angle.abs() > 3.2, path, || {
            format!("{angle} rad is more than half a turn; degrees, {:.4} rad?", angle.to_radians())
        });
    }
}

/// The attractors of Lorenz's models are some tens (1963) and ten (1996) wide, and their times are 1.
fn of_components(model: &Model, scene: &Scene, found: &mut Found) {
    let (width, longest) = match model {
        Model::Lorenz63(_) => (50.0, 0.1),
        Model::Lorenz96(_) => (30.0, 0.2),
        _ => return,
    };
    if let Some(step) = scene.time.step {
        found.say(step > longest, "time.step", || {
            format!("{step} is too long a step for this model: 0.01 to {} is usual", 0.5 * longest)
        });
    }
    let sigma = match &scene.observations {
        Observations::Synthetic(keys) => keys.sigma,
        Observations::File(keys) => keys.sigma,
    };
    if let Some(sigma) = sigma {
        found.say(sigma > width, "observations.sigma", || {
            format!("{sigma} is more than the model ever moves ({width} at most): nothing is learnt")
        });
    }
}

/// From the middle of a section to its outside \[m\]; 0 where the section does not say.
fn thickness(section: &Section) -> f64 {
    match section {
        Section::Circle { radius } => *radius,
        Section::Ellipse { semi_axes } => semi_axes[0].max(semi_axes[1]),
        Section::Rectangle { width, height } => 0.5 * width.max(*height),
        Section::Stiffness { .. } => 0.0,
    }
}

/// Mass per length \[kg/m\].
pub(super) fn line_mass(rod: &RodModel) -> f64 {
    match &rod.section {
        Section::Stiffness { mass_per_length, .. } => *mass_per_length,
        section => rod.material.as_ref().map_or(0.0, |m| m.density) * area(section),
    }
}

/// Stretching stiffness EA \[N\].
pub(super) fn axial_stiffness(rod: &RodModel) -> f64 {
    match &rod.section {
        Section::Stiffness { ea, .. } => *ea,
        section => rod.material.as_ref().map_or(0.0, |m| m.youngs_modulus) * area(section),
    }
}

/// Area of a section \[m²\]; 0 where the section does not say.
fn area(section: &Section) -> f64 {
    match section {
        Section::Circle { radius } => std::f64::consts::PI * radius * radius,
        Section::Ellipse { semi_axes: [a, b] } => std::f64::consts::PI * a * b,
        Section::Rectangle { width, height } => width * height,
        Section::Stiffness { .. } => 0.0,
    }
}

fn norm(v: &[f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}
