//! What parameters that move supports do to one configuration, alone and two together.

use nalgebra::Vector3;

use crate::layout::Layout;
use crate::moved_increment::{Increments, TurnedClamp};
use crate::second_order::Increment;
use crate::shape::Shape;
use crate::system::System;

/// What parameters do to one configuration by moving supports; what is there is used again.
#[derive(Default)]
pub(crate) struct Together {
    /// Those that may act, and what those do that move something.
    acting: Vec<usize>,
    moved: Vec<Alone>,
    count: usize,
    work: Option<Increments>,
    /// The clamps that are turned, at the time.
    clamps: [Option<TurnedClamp>; 2],
}

/// One parameter: its increment of places and local angles, and that of the end clamp's stored angle.
pub(crate) struct Alone {
    pub(crate) parameter: usize,
    pub(crate) places: Vec<Vector3<f64>>,
    pub(crate) angles: Vec<f64>,
}

impl Alone {
    /// full += so many times the increment, in the full order.
    pub(crate) fn add_to(&self, layout: &Layout, times: f64, full: &mut [f64]) {
        for (v, place) in self.places.iter().enumerate() {
            let full = &mut full[layout.vertex(v)..][..3];
            full.iter_mut().zip(place.iter()).for_each(|(full, x)| *full += x * times);
        }
        if layout.twist {
            self.angles.iter().enumerate().for_each(|(e, angle)| full[layout.angle(e)] += angle * times);
        }
    }

    /// What acts in the full order, times the increment.
    pub(crate) fn dot(&self, layout: &Layout, on: &[f64]) -> f64 {
        in_full_dot(layout, &self.places, &self.angles, on)
    }
}

/// What acts in the full order, times an increment of places and local angles.
fn in_full_dot(layout: &Layout, places: &[Vector3<f64>], angles: &[f64], on: &[f64]) -> f64 {
    let of = |v: usize| places[v].dot(&Vector3::from_column_slice(&on[layout.vertex(v)..][..3]));
    let of_places: f64 = (0..places.len()).map(of).sum();
    match layout.twist {
        true => of_places + (0..angles.len()).map(|e| angles[e] * on[layout.angle(e)]).sum::<f64>(),
        false => of_places,
    }
}

fn turned(clamps: &[Option<TurnedClamp>; 2], end: bool) -> TurnedClamp {
    clamps[usize::from(end)].expect("a clamp that turns is one of the rod")
}

impl Together {
    /// Takes a configuration at time t.
    pub(crate) fn set(&mut self, system: &System, shape: &Shape, t: f64) {
        self.count = 0;
        if system.moves.is_empty() {
            return;
        }
        system.moves.acting(t, &mut self.acting);
        let held = [&system.supports.start, &system.supports.end];
        for ((clamp, held), end) in self.clamps.iter_mut().zip(held).zip([false, true]) {
            let placed = "supports were placed at this time";
            *clamp = held.as_ref().map(|_| system.turned_clamp(end, t).expect(placed));
        }
        let clamps = self.clamps;
        for &parameter in &self.acting {
            if self.moved.len() == self.count {
                let Increments { places, angles, .. } = Increments::of(system);
                self.moved.push(Alone { parameter, places, angles });
            }
            let moved = &mut self.moved[self.count];
            moved.parameter = parameter;
            let Alone { places, angles, .. } = moved;
            let moved = system.moved_places_by(parameter, t, places, |end| Ok(turned(&clamps, end)));
            let moved = moved.expect("supports were placed at this time");
            if system.angles_of_moved(shape, &moved, places, angles).is_some() {
                self.count += 1;
            }
        }
    }

    /// Those that move something, ascending.
    pub(crate) fn iter(&self) -> impl Iterator<Item = &Alone> {
        self.moved[..self.count].iter()
    }

    /// Calls `visit` with p, q ≤ p, places and angles of w_pq, and what both do to the end clamp's angle,
    /// of the configuration last taken.
    pub(crate) fn each_pair(
        &mut self,
        system: &System,
        (shape, t): (&Shape, f64),
        mut visit: impl FnMut([usize; 2], (&[Vector3<f64>], &[f64]), f64),
    ) {
        let Increments { places, angles, .. } = self.work.get_or_insert_with(|| Increments::of(system));
        for (i, &p) in self.acting.iter().enumerate() {
            for &q in &self.acting[..=i] {
                let clamp = |end| Ok(turned(&self.clamps, end));
                if let Some(end) = system.moved_twice(shape, ([p, q], t), (places, angles), clamp) {
                    visit([p, q], (places, angles), end);
                }
            }
        }
    }

    /// Adds `on`ᵀ w_pq, `on` in the full order, and so much of the end clamp's angle as `on_end`, to
    /// ∂²L/∂p².
    pub(crate) fn pairs_add(
        &mut self,
        system: &System,
        at: (&Shape, f64),
        (on, on_end): (&[f64], f64),
        square: &mut [f64],
    ) {
        let m = square.len().isqrt();
        self.each_pair(system, at, |[p, q], (places, angles), end| {
            let second = in_full_dot(&system.layout, places, angles, on) + on_end * end;
            square[p * m + q] += second;
            if p != q {
                square[q * m + p] += second;
            }
        });
    }
}

impl System {
    /// out += ∂²E/∂c² μ in the full order, at the present shape and stiffness.
    pub(crate) fn elastic_second_of(&self, mu: &Increment, work: &mut Increments, out: &mut [f64]) {
        let Increments { places, angles, .. } = work;
        places.iter_mut().enumerate().for_each(|(v, place)| *place = mu.place(&self.layout, v));
        angles.iter_mut().enumerate().for_each(|(e, angle)| *angle = mu.of_edge(&self.layout, e)[6]);
        self.elastic_second_add(places, angles, out);
    }
}
