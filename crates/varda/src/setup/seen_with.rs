//! What is observed of a state with unknown constants in it.

use varda_assimilation::{LinearObservation, ObservationOperator, Selection};
use varda_implicit::{At, ParameterPlaces, Refusal, Remembered};
use varda_rod::rotation::{exponential, left_jacobian, left_jacobian_derivative};
use varda_rod::{Marker, Markers, Sensors, Vector3};

use super::clocked::Clocked;
use super::estimate::Seeing;
use super::runs::MakeModel;

/// An operator whose sites may be put elsewhere on a rod.
pub(crate) trait Sites: ObservationOperator {
    /// Puts the sites at these places.
    fn move_to(&mut self, _markers: &[Marker]) -> Result<(), Refusal> {
        Ok(())
    }

    /// The columns ∂y/∂(s, o₁, o₂, o₃) of every site, three numbers each.
    fn by_place(&mut self, _at: At, _x: &[f64], _columns: &mut [f64]) {}

    /// The second derivatives of Σ dy·y with those places, four numbers each, and the state and the
    /// model's constants: adds those of an increment of state, constants and places to each of these.
    fn second_by_place_add(
        &mut self,
        _at: At,
        _x: &[f64],
        _by: [&[f64]; 3],
        _dy: &[f64],
        _out: [&mut [f64]; 3],
    ) {
    }

    /// Those of the model's constants that move what is observed at a given state, ascending.
    fn moving(&self) -> Vec<usize> {
        Vec::new()
    }

    /// Takes the constants of the model.
    ///
    /// # Errors
    /// Constants at which nothing can be observed.
    fn set_constants(&mut self, _p: &[f64]) -> Result<(), Refusal> {
        Ok(())
    }

    /// The columns ∂y/∂p of those.
    fn by_constants(&mut self, _at: At, _x: &[f64], _columns: &mut [f64]) {}

    /// The second derivatives of Σ dy·y with those, and the state: adds those of an increment of both to
    /// both.
    fn second_by_constants_add(
        &mut self,
        _at: At,
        _x: &[f64],
        _by: [&[f64]; 2],
        _dy: &[f64],
        _out: [&mut [f64]; 2],
    ) {
    }
}

impl Sites for Selection {}
impl Sites for LinearObservation {}

impl Sites for Markers {
    fn move_to(&mut self, markers: &[Marker]) -> Result<(), Refusal> {
        Ok(Markers::move_to(self, markers)?)
    }

    fn by_place(&mut self, at: At, x: &[f64], columns: &mut [f64]) {
        Markers::by_place(self, at, x, columns).expect("this state was observed before");
    }

    fn second_by_place_add(&mut self, at: At, x: &[f64], by: [&[f64]; 3], dy: &[f64], out: [&mut [f64]; 3]) {
        Markers::second_by_place_add(self, at, x, by, dy, out).expect("this state was observed before");
    }

    fn moving(&self) -> Vec<usize> {
        self.moving_parameters().to_vec()
    }

    fn set_constants(&mut self, p: &[f64]) -> Result<(), Refusal> {
        self.set_parameters(p);
        Ok(())
    }

    fn by_constants(&mut self, at: At, x: &[f64], columns: &mut [f64]) {
        self.by_parameters(at, x, columns).expect("this state was observed before");
    }

    fn second_by_constants_add(
        &mut self,
        at: At,
        x: &[f64],
        by: [&[f64]; 2],
        dy: &[f64],
        out: [&mut [f64]; 2],
    ) {
        self.second_with_parameters_add(at, x, by, dy, out).expect("this state was observed before");
    }
}

impl Sites for Sensors {
    fn moving(&self) -> Vec<usize> {
        (0..self.parameters()).collect()
    }

    fn set_constants(&mut self, p: &[f64]) -> Result<(), Refusal> {
        self.set_parameters(&p[..self.parameters()])
    }

    fn by_constants(&mut self, at: At, x: &[f64], columns: &mut [f64]) {
        self.by_parameters(at, x, columns).expect("this state was observed before");
    }

    fn second_by_constants_add(
        &mut self,
        at: At,
        x: &[f64],
        [dx, dp]: [&[f64]; 2],
        dy: &[f64],
        [out, out_p]: [&mut [f64]; 2],
    ) {
        let count = self.parameters();
        self.second_with_parameters_add(at, x, [dx, &dp[..count]], dy, [out, &mut out_p[..count]]);
    }
}

/// y = R(ρ) H(x) + t + b: H of a state without constants, turned by a small rotation ρ and displaced by t
/// in space, with a bias b of every row. What is not unknown is left out.
pub(crate) struct SeenWith<O> {
    places: ParameterPlaces,
    seeing: Seeing,
    /// A state without constants, and an increment of one.
    x: Vec<f64>,
    dx: Vec<f64>,
    /// H(x), or what acts on it.
    y: Vec<f64>,
    /// What acts on the values in the operator's own axes.
    back: Vec<f64>,
    /// Places of the sites in the scene, where their own are unknown; where they are; the columns of those.
    markers: Vec<Marker>,
    moved: Vec<Marker>,
    columns: Vec<f64>,
    moving: Moving,
    second: Second,
    operator: O,
}

/// Work space of second derivatives: nothing until they are asked for.
#[derive(Default)]
struct Second {
    /// What is added to a state without constants.
    out: Vec<f64>,
    /// An increment of the places of sites and what is added to them, four numbers each.
    places: Vec<f64>,
    out_places: Vec<f64>,
    /// An increment of H(x), and what acts on H(x) as its axes turn.
    moved: Vec<f64>,
    acting: Vec<f64>,
}

/// Constants of the model that move what is observed, by supports.
struct Moving {
    /// Which.
    constants: Vec<usize>,
    /// Their columns.
    columns: Remembered,
}

impl Moving {
    /// Of observations with so many rows of a state with so many numbers.
    fn of(constants: Vec<usize>, rows: usize, state: usize) -> Moving {
        let columns = Remembered::new(state, constants.len() * rows);
        Moving { constants, columns }
    }

    /// The columns at a state, and the constant of each; `find` computes them where they are not known.
    fn at(
        &mut self,
        at: At,
        x: &[f64],
        rows: usize,
        find: impl FnOnce(&mut [f64]),
    ) -> impl Iterator<Item = (usize, &[f64])> {
        let columns = self.columns.at(at, x, find);
        self.constants.iter().copied().zip(columns.chunks_exact(rows.max(1)))
    }
}

/// What an operator of a state sees of the longer one with constants in it, at these places; the operator
/// itself where there are none. `markers` are the places of the sites in the scene, read where these are
/// unknown; `models` has the rates of a state, for a recording whose clock is.
///
/// # Panics
/// If the clock is unknown and the model has no rates: [`Inputs`](super::Inputs) refuses that.
pub(crate) fn with_constants<O: Sites + 'static>(
    operator: O,
    places: Option<ParameterPlaces>,
    seeing: Seeing,
    markers: &[Marker],
    models: &MakeModel,
) -> Box<dyn ObservationOperator> {
    let Some(places) = places else { return Box::new(operator) };
    let (first, clock, known) = (places.parameters().start, seeing.clock, seeing.clock_known);
    let seen = Box::new(SeenWith::new(operator, places, seeing, markers));
    match clock {
        None => seen,
        Some(clock) => {
            let rate = models(0).rate().expect("a clock is refused without rates");
            Box::new(Clocked::new(seen, rate, first + clock, known))
        }
    }
}

impl<O: Sites> SeenWith<O> {
    /// `markers` are the places of the sites in the scene, read where these are unknown.
    fn new(operator: O, places: ParameterPlaces, seeing: Seeing, markers: &[Marker]) -> Self {
        let markers = if seeing.moves_sites() { markers.to_vec() } else { Vec::new() };
        let (own, rows) = (places.own_dim(), operator.dim());
        let (x, dx, columns) = (vec![0.0; own], vec![0.0; own], vec![0.0; 12 * markers.len()]);
        let (y, back, moved) = (vec![0.0; rows], vec![0.0; rows], markers.clone());
        let moving = Moving::of(operator.moving(), rows, places.dim());
        Self {
            places,
            seeing,
            x,
            dx,
            y,
            back,
            markers,
            moved,
            columns,
            moving,
            second: Second::default(),
            operator,
        }
    }

    /// Puts the sites, and supports, where the constants of a state have them.
    fn place_sites(&mut self, x: &[f64]) -> Result<(), Refusal> {
        if !self.moving.constants.is_empty() {
            self.operator.set_constants(&x[self.places.parameters()])?;
        }
        if self.markers.is_empty() {
            return Ok(());
        }
        let p = &x[self.places.parameters()];
        self.moved.copy_from_slice(&self.markers);
        for (i, marker) in self.moved.iter_mut().enumerate().take(self.seeing.sites) {
            marker.s += self.seeing.arc_length.map_or(0.0, |first| p[first + i]);
            for (c, offset) in marker.offset.iter_mut().enumerate() {
                *offset += self.seeing.offset.map_or(0.0, |first| p[first + 3 * i + c]);
            }
        }
        self.operator.move_to(&self.moved)
    }

    /// For each number of the places of sites: its place among the constants, its site, and which of s, o₁,
    /// o₂, o₃ it is.
    fn each_place(&self, mut visit: impl FnMut(usize, usize, usize)) {
        for i in 0..self.seeing.sites.min(self.markers.len()) {
            if let Some(first) = self.seeing.arc_length {
                visit(first + i, i, 0);
            }
            if let Some(first) = self.seeing.offset {
                (0..3).for_each(|c| visit(first + 3 * i + c, i, c + 1));
            }
        }
    }

    /// dy += what an increment of the places of sites does.
    fn by_places_add(&self, dp: &[f64], dy: &mut [f64]) {
        self.each_place(|p, i, c| {
            let column = &self.columns[12 * i + 3 * c..][..3];
            dy[3 * i..3 * i + 3].iter_mut().zip(column).for_each(|(dy, c)| *dy += c * dp[p]);
        });
    }

    /// The transpose.
    fn by_places_transpose_add(&self, dy: &[f64], dp: &mut [f64]) {
        self.each_place(|p, i, c| {
            let column = &self.columns[12 * i + 3 * c..][..3];
            dp[p] += column.iter().zip(&dy[3 * i..]).map(|(c, b)| c * b).sum::<f64>();
        });
    }

    /// The rotation vector ρ among the constants of a state or an increment.
    fn rotation(&self, x: &[f64]) -> Option<Vector3<f64>> {
        let first = self.places.parameters().start + self.seeing.rotation?;
        Some(Vector3::from_column_slice(&x[first..first + 3]))
    }

    /// Adds t and b, or their increments.
    fn displace(&self, x: &[f64], y: &mut [f64]) {
        let p = &x[self.places.parameters()];
        if let Some(first) = self.seeing.translation {
            for y in y.chunks_exact_mut(3) {
                y.iter_mut().zip(&p[first..]).for_each(|(y, t)| *y += t);
            }
        }
        for (y, constant) in y.iter_mut().zip(&*self.seeing.bias) {
            *y += constant.map_or(0.0, |constant| p[constant]);
        }
    }
}

impl<O: Sites> ObservationOperator for SeenWith<O> {
    fn dim(&self) -> usize {
        self.operator.dim()
    }

    fn state_dim(&self) -> usize {
        self.places.dim()
    }

    fn observe(&mut self, at: At, x: &[f64], y: &mut [f64]) -> Result<(), Refusal> {
        self.places.gather(x, &mut self.x);
        self.place_sites(x)?;
        self.operator.observe(at, &self.x, y)?;
        if let Some(rho) = self.rotation(x) {
            let turn = exponential(&rho);
            y.chunks_exact_mut(3).for_each(|y| set(y, turn * place(y)));
        }
        self.displace(x, y);
        Ok(())
    }

    fn tangent(&mut self, at: At, x: &[f64], dx: &[f64], dy: &mut [f64]) {
        self.places.gather(x, &mut self.x);
        self.place_sites(x).expect("this state was observed before");
        let rotation = self.rotation(x);
        if rotation.is_some() {
            self.operator.observe(at, &self.x, &mut self.y).expect("this state was observed before");
        }
        self.places.gather(dx, &mut self.dx);
        self.operator.tangent(at, &self.x, &self.dx, dy);
        if !self.markers.is_empty() {
            self.operator.by_place(at, &self.x, &mut self.columns);
            self.by_places_add(&dx[self.places.parameters()], dy);
        }
        if !self.moving.constants.is_empty() {
            let Self { operator, moving, x: own, places, .. } = self;
            let dp = &dx[places.parameters()];
            for (p, column) in moving.at(at, x, dy.len(), |into| operator.by_constants(at, own, into)) {
                dy.iter_mut().zip(column).for_each(|(dy, c)| *dy += c * dp[p]);
            }
        }
        if let (Some(rho), Some(drho)) = (rotation, self.rotation(dx)) {
            let (turn, turned) = (exponential(&rho), left_jacobian(&rho) * drho);
            for (dy, y) in dy.chunks_exact_mut(3).zip(self.y.chunks_exact(3)) {
                set(dy, turn * place(dy) + turned.cross(&(turn * place(y))));
            }
        }
        self.displace(dx, dy);
    }

    fn adjoint_add(&mut self, at: At, x: &[f64], dy: &[f64], dx: &mut [f64]) {
        let p = self.places.parameters();
        if let Some(first) = self.seeing.translation {
            for dy in dy.chunks_exact(3) {
                dx[p.start + first..].iter_mut().zip(dy).for_each(|(dt, dy)| *dt += dy);
            }
        }
        // a marker without a name has no bias
        for (dy, constant) in dy.iter().zip(&*self.seeing.bias) {
            if let Some(constant) = constant {
                dx[p.start + constant] += dy;
            }
        }
        self.places.gather(x, &mut self.x);
        self.place_sites(x).expect("this state was observed before");
        self.back.copy_from_slice(dy);
        if let Some(rho) = self.rotation(x) {
            self.operator.observe(at, &self.x, &mut self.y).expect("this state was observed before");
            let (turn, jacobian) = (exponential(&rho), left_jacobian(&rho));
            let mut sum = Vector3::zeros();
            for (back, y) in self.back.chunks_exact_mut(3).zip(self.y.chunks_exact(3)) {
                sum += (turn * place(y)).cross(&place(back));
                set(back, turn.tr_mul(&place(back)));
            }
            let first = p.start + self.seeing.rotation.expect("there is a rotation");
            let drho = jacobian.tr_mul(&sum);
            dx[first..first + 3].iter_mut().zip(drho.iter()).for_each(|(dx, d)| *dx += d);
        }
        if !self.markers.is_empty() {
            self.operator.by_place(at, &self.x, &mut self.columns);
            self.by_places_transpose_add(&self.back, &mut dx[self.places.parameters()]);
        }
        if !self.moving.constants.is_empty() {
            let Self { operator, moving, x: own, places, back, .. } = self;
            let dp = &mut dx[places.parameters()];
            for (p, column) in moving.at(at, x, back.len(), |into| operator.by_constants(at, own, into)) {
                dp[p] += column.iter().zip(&*back).map(|(c, b)| c * b).sum::<f64>();
            }
        }
        self.places.gather(dx, &mut self.dx);
        self.operator.adjoint_add(at, &self.x, &self.back, &mut self.dx);
        self.places.scatter(&self.dx, dx);
    }

    fn has_second_derivatives(&self) -> bool {
        self.operator.has_second_derivatives()
    }

    /// With f = Rᵀ dy, a = J dρ, δ(Rh) = a × Rh + R δh and m the places of sites and constants of the
    /// model that move what is observed:
    ///
    /// ```text
    /// x, m: ∂²(fᵀH)/∂(x, m)² (dx, dm) + (∂H/∂(x, m))ᵀ Rᵀ (dy × a)
    /// ρ:    dJᵀ Σ Rh × dy + Jᵀ Σ δ(Rh) × dy
    /// ```
    fn second_adjoint_add(&mut self, at: At, x: &[f64], dx: &[f64], dy: &[f64], out: &mut [f64]) {
        let constants = self.places.parameters();
        self.places.gather(x, &mut self.x);
        self.place_sites(x).expect("this state was observed before");
        self.places.gather(dx, &mut self.dx);
        let mut second = std::mem::take(&mut self.second);
        let Second { out: own, places, out_places, moved, acting } = &mut second;
        own.resize(self.dx.len(), 0.0);
        self.places.gather(out, own);
        self.back.copy_from_slice(dy);
        let turned = self.rotation(x).zip(self.rotation(dx));
        if let Some((rho, _)) = turned {
            let turn = exponential(&rho);
            self.back.chunks_exact_mut(3).for_each(|back| set(back, turn.tr_mul(&place(back))));
        }
        if self.moving.constants.is_empty() {
            self.operator.second_adjoint_add(at, &self.x, &self.dx, &self.back, own);
        } else {
            let (by, to) = ([&self.dx[..], &dx[constants.clone()]], &mut out[constants.clone()]);
            self.operator.second_by_constants_add(at, &self.x, by, &self.back, [own, to]);
        }
        if !self.markers.is_empty() {
            for zeroed in [&mut *places, out_places] {
                zeroed.clear();
                zeroed.resize(4 * self.markers.len(), 0.0);
            }
            self.each_place(|p, i, c| places[4 * i + c] = dx[constants.start + p]);
            let by = [&self.dx[..], &dx[constants.clone()], places];
            let to = [&mut own[..], &mut out[constants.clone()], out_places];
            self.operator.second_by_place_add(at, &self.x, by, &self.back, to);
            self.each_place(|p, i, c| out[constants.start + p] += out_places[4 * i + c]);
        }
        if let Some((rho, drho)) = turned {
            let (turn, jacobian) = (exponential(&rho), left_jacobian(&rho));
            let by = jacobian * drho;
            self.operator.observe(at, &self.x, &mut self.y).expect("this state was observed before");
            moved.resize(dy.len(), 0.0);
            acting.resize(dy.len(), 0.0);
            self.operator.tangent(at, &self.x, &self.dx, moved);
            if !self.markers.is_empty() {
                self.operator.by_place(at, &self.x, &mut self.columns);
                self.by_places_add(&dx[constants.clone()], moved);
            }
            let Self { operator, moving, x: own_x, .. } = self;
            if !moving.constants.is_empty() {
                let dp = &dx[constants.clone()];
                for (p, column) in moving.at(at, x, dy.len(), |into| operator.by_constants(at, own_x, into)) {
                    moved.iter_mut().zip(column).for_each(|(moved, c)| *moved += c * dp[p]);
                }
            }
            let (mut first, mut change) = (Vector3::zeros(), Vector3::zeros());
            let rows = dy.chunks_exact(3).zip(self.y.chunks_exact(3)).zip(moved.chunks_exact(3));
            for (((dy, y), moved), acting) in rows.zip(acting.chunks_exact_mut(3)) {
                let (dy, y) = (place(dy), turn * place(y));
                first += y.cross(&dy);
                change += (by.cross(&y) + turn * place(moved)).cross(&dy);
                set(acting, turn.tr_mul(&dy.cross(&by)));
            }
            self.operator.adjoint_add(at, &self.x, acting, own);
            if !self.markers.is_empty() {
                self.by_places_transpose_add(acting, &mut out[constants.clone()]);
            }
            let Self { operator, moving, x: own_x, .. } = self;
            if !moving.constants.is_empty() {
                let to = &mut out[constants.clone()];
                for (p, column) in moving.at(at, x, dy.len(), |into| operator.by_constants(at, own_x, into)) {
                    to[p] += column.iter().zip(&*acting).map(|(c, a)| c * a).sum::<f64>();
                }
            }
            let of_rho = left_jacobian_derivative(&rho, &drho).tr_mul(&first) + jacobian.tr_mul(&change);
            let at = constants.start + self.seeing.rotation.expect("there is a rotation");
            out[at..at + 3].iter_mut().zip(of_rho.iter()).for_each(|(out, d)| *out += d);
        }
        self.places.scatter(own, out);
        self.second = second;
    }
}

fn place(y: &[f64]) -> Vector3<f64> {
    Vector3::from_column_slice(y)
}

fn set(y: &mut [f64], value: Vector3<f64>) {
    y.copy_from_slice(value.as_slice());
}
