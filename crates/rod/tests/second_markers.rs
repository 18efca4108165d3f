//! Second derivatives of places of markers with parameters that move supports, and with the places of the
//! markers on the rod, against differences of the first.

mod common;

use common::rods_with_parameters::{Case, LOST, PLAIN, cases, control, step};
use common::{dot, noise, norm};
use varda_implicit::{At, ImplicitModel, Model, ObservationOperator, ParametricStep, Scheme, WithParameters};
use varda_rod::{Marker, Markers};

/// Near a clamp, between, and past the last vertex that may be held.
const PLACES: [f64; 5] = [0.02, 0.09, 0.31, 0.55, 0.97];
const AT: At = At { step: 0, time: 0.013 };

/// Markers of a rod: a point is the state, the parameters and the places (s, o₁, o₂, o₃) of each
/// marker.
struct Seen {
    markers: Markers,
    dy: Vec<f64>,
    states: usize,
    parameters: usize,
}

impl Seen {
    /// With the point.
    fn new(case: Case, off_axis: bool) -> (Seen, Vec<f64>) {
        let step = step(case, Scheme::BackwardEuler);
        let (z, parameters) = (control(&step), step.parameters());
        let p = z[z.len() - parameters..].to_vec();
        let mut model = ImplicitModel::new(WithParameters::new(step, 0), 0, 0.01);
        let mut x = vec![0.0; Model::dim(&model)];
        model.initial_state(&z, &mut x).unwrap();
        let x = model.step_mut().at(&x).unwrap().1.to_vec();
        let offset = if off_axis { [0.01, -0.02, 0.03] } else { [0.0; 3] };
        let places = PLACES.map(|s| Marker { s, offset: offset.into() });
        let mut markers = Markers::new(&model.into_inner().into_step(), &places).unwrap();
        if off_axis {
            markers = markers.with_frames();
        }
        let dy = noise(5).take(markers.dim()).collect();
        let states = x.len();
        let of_places = PLACES.iter().flat_map(|s| [*s, offset[0], offset[1], offset[2]]);
        let point = x.into_iter().chain(p).chain(of_places).collect();
        (Seen { markers, dy, states, parameters }, point)
    }

    fn parts<'a>(&self, point: &'a [f64]) -> [&'a [f64]; 3] {
        let (x, rest) = point.split_at(self.states);
        let (p, places) = rest.split_at(self.parameters);
        [x, p, places]
    }

    fn set<'a>(&mut self, point: &'a [f64]) -> &'a [f64] {
        let [x, p, places] = self.parts(point);
        self.markers.set_parameters(p);
        let of = |place: &[f64]| Marker { s: place[0], offset: [place[1], place[2], place[3]].into() };
        self.markers.move_to(&places.chunks_exact(4).map(of).collect::<Vec<_>>()).unwrap();
        x
    }

    fn gradient(&mut self, point: &[f64], off_axis: bool) -> Vec<f64> {
        let x = self.set(point);
        let Seen { markers, dy, .. } = self;
        let mut out = vec![0.0; point.len()];
        markers.adjoint_add(AT, x, dy, &mut out[..x.len()]);
        let moving = markers.moving_parameters().to_vec();
        let mut columns = vec![0.0; moving.len() * dy.len()];
        markers.by_parameters(AT, x, &mut columns).unwrap();
        for (p, column) in moving.iter().zip(columns.chunks_exact(dy.len())) {
            out[x.len() + p] = dot(column, dy);
        }
        if off_axis {
            let mut columns = vec![0.0; 4 * dy.len()];
            markers.by_place(AT, x, &mut columns).unwrap();
            let first = point.len() - 4 * PLACES.len();
            for (i, column) in columns.chunks_exact(3).enumerate() {
                out[first + i] = dot(column, &dy[3 * (i / 4)..][..3]);
            }
        }
        out
    }

    fn product(&mut self, point: &[f64], by: &[f64], off_axis: bool) -> Vec<f64> {
        let x = self.set(point);
        let [dx, dp, dplaces] = self.parts(by);
        let mut out = vec![0.0; point.len()];
        let (out_x, rest) = out.split_at_mut(self.states);
        let (out_p, out_places) = rest.split_at_mut(self.parameters);
        let Seen { markers, dy, .. } = self;
        markers.second_with_parameters_add(AT, x, [dx, dp], dy, [&mut *out_x, &mut *out_p]).unwrap();
        if off_axis {
            let to = [out_x, out_p, out_places];
            markers.second_by_place_add(AT, x, [dx, dp, dplaces], dy, to).unwrap();
        }
        out
    }
}

fn moved_cases() -> Vec<Case> {
    let ends = Case { moved: true, end: true, damping: LOST, ..PLAIN };
    let more = [
        Case { name: "moved at its end alone", curved: true, held: false, ..ends },
        Case { name: "moved at its end alone, without twist", held: false, damping: PLAIN.damping, ..ends },
    ];
    cases().into_iter().filter(|case| case.moved).chain(more).collect()
}

#[test]
fn second_derivatives_are_those_of_differences_and_symmetric() {
    for (case, off_axis) in moved_cases().into_iter().flat_map(|case| [(case, false), (case, true)]) {
        let (mut seen, point) = Seen::new(case, off_axis);
        let places = point.len() - 4 * PLACES.len();
        let scaled = |seed: usize| -> Vec<f64> {
            let scale = |i: usize| match i {
                i if i < seen.states => 0.01,
                i if i < places => 0.5,
                _ if off_axis => 0.01,
                _ => 0.0,
            };
            noise(seed).take(point.len()).enumerate().map(|(i, e)| scale(i) * e).collect()
        };
        let [a, b] = [scaled(7), scaled(8)];
        let mut difference = |h: f64| -> Vec<f64> {
            let mut at = |h: f64| {
                let there: Vec<f64> = point.iter().zip(&a).map(|(x, d)| x + h * d).collect();
                seen.gradient(&there, off_axis)
            };
            at(h).iter().zip(at(-h)).map(|(p, m)| (p - m) / (2.0 * h)).collect()
        };
        let [coarse, fine] = [difference(4e-3), difference(2e-3)];
        let best: Vec<f64> = fine.iter().zip(&coarse).map(|(f, c)| f + (f - c) / 3.0).collect();
        let [by_a, by_b] = [&a, &b].map(|by| seen.product(&point, by, off_axis));
        let off: Vec<f64> = best.iter().zip(&by_a).map(|(d, p)| d - p).collect();
        // h⁴ of differences, and rounding over h
        let error = norm(&off) / norm(&by_a);
        assert!(error <= 1e-8, "{}, off the axis {off_axis}: {error:e}", case.name);
        let gap = (dot(&by_a, &b) - dot(&by_b, &a)).abs();
        assert!(gap <= 1e-13 * norm(&by_a) * norm(&b), "{}, off the axis {off_axis}: {gap:e}", case.name);
    }
}
