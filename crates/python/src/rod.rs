//! The rod of a scene: its shape at rest, its elastic energy and the derivatives of that.

use numpy::PyReadonlyArray1;
use pyo3::prelude::*;
use varda::scene::SceneFile;
use varda::setup::Inputs;
use varda_linalg::interrupt;
use varda_rod::{Framed, Vector3, derivatives, energy};

use crate::error::raised;
use crate::outcome::array;
use crate::scene::Source;
use crate::signals::{Leave, listening};

/// The rod of a scene.
#[pyclass(frozen)]
pub(crate) struct Rod {
    file: SceneFile,
    rod: varda_rod::Rod,
}

/// Vertices and angles as plain numbers.
type Numbers<'py> = PyReadonlyArray1<'py, f64>;

#[pymethods]
impl Rod {
    #[new]
    fn new(source: Source, overrides: Vec<String>) -> PyResult<Rod> {
        let file = source.open(&overrides)?.as_one_window();
        let inputs = Inputs::for_simulation(&file).map_err(raised)?;
        let Some(system) = inputs.system.rod() else {
            return Err(raised(file.invalid("model.kind", "this model is no rod")));
        };
        let rod = system.parts.rod.clone();
        Ok(Rod { file, rod })
    }

    /// Arc lengths [m] and masses [kg] of the vertices.
    fn vertices<'py>(&self, py: Python<'py>) -> PyResult<[Bound<'py, PyAny>; 2]> {
        let (s, m) = (self.rod.arc_lengths(), self.rod.masses.clone());
        let shape = [s.len()];
        Ok([array(py, s, &shape)?, array(py, m, &shape)?])
    }

    /// Vertices and angles at rest, supports where they are at the start of the window.
    fn at_rest<'py>(&self, py: Python<'py>) -> PyResult<[Bound<'py, PyAny>; 2]> {
        let file = self.file.clone();
        let rest = listening(py, Leave::Yes, move |ends| {
            interrupt::within(ends, || {
                let inputs = Inputs::for_simulation(&file)?;
                let rest = inputs.system.rod().map(|rod| rod.parts.at_rest(inputs.grid.start));
                rest.unwrap_or_else(|| Err(file.invalid("model.kind", "this model is no rod")))
            })
        })?;
        let n = rest.vertices.len();
        let places = rest.vertices.iter().flat_map(|v| [v.x, v.y, v.z]).collect();
        Ok([array(py, places, &[n, 3])?, array(py, rest.theta, &[n - 1])?])
    }

    /// E_ε, E_κ, E_τ [J] at the vertices, with frames that are free of twist where the vertices are `at`.
    fn energy(
        &self,
        at: Numbers,
        director: Option<[f64; 3]>,
        vertices: Numbers,
        theta: Numbers,
    ) -> PyResult<[f64; 3]> {
        let frames = Frames::new(&at, director)?;
        let found =
            energy(&self.rod, &frames.with(theta.as_slice()?), &points(&vertices)?, theta.as_slice()?);
        let e = found.map_err(|e| raised(e.into()))?;
        Ok([e.stretch, e.bend, e.twist])
    }

    /// ∂E/∂(x, θ) and ∂²E/∂(x, θ)² at the vertices, frames free of twist there.
    fn derivatives<'py>(
        &self,
        py: Python<'py>,
        director: Option<[f64; 3]>,
        vertices: Numbers,
        theta: Numbers,
    ) -> PyResult<[Bound<'py, PyAny>; 2]> {
        let frames = Frames::new(&vertices, director)?;
        let found = derivatives(&self.rod, &frames.with(theta.as_slice()?));
        let d = found.map_err(|e| raised(e.into()))?;
        let n = d.gradient.len();
        Ok([array(py, d.gradient, &[n])?, array(py, d.hessian, &[n, n])?])
    }
}

/// Frames without twist along some vertices.
struct Frames {
    vertices: Vec<Vector3<f64>>,
    directors: Vec<Vector3<f64>>,
    no_twist: Vec<f64>,
}

impl Frames {
    /// From the director of the first edge, carried from edge to edge by parallel transport; some
    /// perpendicular one where none is given.
    fn new(vertices: &Numbers, director: Option<[f64; 3]>) -> PyResult<Frames> {
        let vertices = points(vertices)?;
        let tangents: Vec<Vector3<f64>> = vertices.windows(2).map(|x| (x[1] - x[0]).normalize()).collect();
        let mut directors: Vec<Vector3<f64>> = Vec::new();
        for (e, t) in tangents.iter().enumerate() {
            let d = match directors.last() {
                Some(d) => {
                    let (b, c) = (tangents[e - 1].cross(t), tangents[e - 1].dot(t));
                    d + b.cross(d) + b.cross(&b.cross(d)) / (1.0 + c)
                }
                None => {
                    let axis = t.iamin();
                    let any = Vector3::from_fn(|i, _| f64::from(u8::from(i == axis)));
                    let given = director.map_or(any, Vector3::from);
                    (given - t * t.dot(&given)).normalize()
                }
            };
            directors.push(d);
        }
        let no_twist = vec![0.0; directors.len().saturating_sub(1)];
        Ok(Frames { vertices, directors, no_twist })
    }

    fn with<'a>(&'a self, theta: &'a [f64]) -> Framed<'a> {
        Framed {
            vertices: &self.vertices,
            directors: &self.directors,
            reference_twist: &self.no_twist,
            theta,
        }
    }
}

fn points(numbers: &Numbers) -> PyResult<Vec<Vector3<f64>>> {
    let points = numbers.as_slice()?.chunks_exact(3);
    Ok(points.map(|p| Vector3::new(p[0], p[1], p[2])).collect())
}
