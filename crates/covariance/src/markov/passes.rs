//! The sweep backward that meets the places without error, and the filter forward.

use super::Place;
use super::motion::Motion;
use super::triangle::{Square, forward, lower, times};
use crate::error::Error;

/// A place of the line, free or known.
#[derive(Clone, Copy)]
struct Stop {
    s: f64,
    is_known: bool,
    /// Its index among the free places.
    index: usize,
}

/// What places without error further on say of z here: R z + noise = 0, noise ~ N(0, N Nᵀ).
#[derive(Default)]
struct Ahead {
    rows: Vec<[f64; 3]>,
    /// N, a lower triangle.
    noise: Vec<Vec<f64>>,
}

/// From one stop to the next: T, and a triangular root of the covariance of the noise.
struct Way {
    transition: Square,
    noise: Square,
}

const ONE: Square = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// T and g of every free place, for σ = 1.
pub(super) fn places(motion: &Motion, free: &[f64], known: &[f64]) -> Result<Vec<Place>, Error> {
    let stops = stops(free, known)?;
    let ways = ways(motion, &stops);
    Ok(filter(motion.states, &stops, &ways))
}

/// All places in the order of the line, up to the last known one behind which nothing is free.
fn stops(free: &[f64], known: &[f64]) -> Result<Vec<Stop>, Error> {
    for (i, pair) in free.windows(2).enumerate() {
        if !(pair[1] > pair[0]) {
            return Err(Error::Places { index: i + 1, place: pair[1], before: pair[0] });
        }
    }
    let at = |is_known| move |(index, &s): (usize, &f64)| Stop { s, is_known, index };
    let mut stops: Vec<Stop> =
        free.iter().enumerate().map(at(false)).chain(known.iter().enumerate().map(at(true))).collect();
    if let Some(bad) = stops.iter().find(|stop| !stop.s.is_finite()) {
        return Err(Error::Places { index: bad.index, place: bad.s, before: f64::NEG_INFINITY });
    }
    stops.sort_by(|a, b| a.s.total_cmp(&b.s));
    match stops.windows(2).find(|pair| !(pair[1].s > pair[0].s)) {
        Some(pair) => Err(Error::Places { index: pair[1].index, place: pair[1].s, before: pair[0].s }),
        None => Ok(stops),
    }
}

/// The ways to every stop, the first from nowhere, of the field that is zero at all known places.
fn ways(motion: &Motion, stops: &[Stop]) -> Vec<Way> {
    let mut ahead = Ahead::default();
    let mut ways: Vec<Way> = Vec::with_capacity(stops.len());
    for (k, stop) in stops.iter().enumerate().rev() {
        if stop.is_known {
            ahead.know_here();
        }
        let way = match k.checked_sub(1) {
            None => Way { transition: Square::default(), noise: motion.stationary },
            Some(before) => {
                let a = motion.rate * (stop.s - stops[before].s);
                Way { transition: motion.transition(a), noise: motion.noise(a) }
            }
        };
        let (mut way, before) = ahead.pass(motion.states, &way);
        if stop.is_known {
            way.transition[0] = [0.0; 3];
            way.noise[0] = [0.0; 3];
        }
        ways.push(way);
        ahead = before;
    }
    ways.reverse();
    ways
}

impl Ahead {
    /// f = 0 here, exactly. Its row comes first, so that the triangle begins with what is exact.
    fn know_here(&mut self) {
        self.rows.insert(0, [1.0, 0.0, 0.0]);
        self.noise.iter_mut().for_each(|row| row.insert(0, 0.0));
        self.noise.insert(0, vec![0.0; self.rows.len()]);
    }

    /// The way to here of the field that goes through what is ahead, and what is ahead of its beginning:
    /// with the triangle
    ///
    /// ```text
    /// [N  R Q^½]    [X  0 ]
    /// [0    Q^½] →  [Y  Q̃^½]      T = Φ − Y X⁻¹ R Φ,  R ← R Φ,  N ← X
    /// ```
    fn pass(&self, states: usize, way: &Way) -> (Way, Ahead) {
        let p = self.rows.len();
        if p == 0 {
            return (Way { ..*way }, Ahead::default());
        }
        let noise = |r: &[f64; 3], j: usize| (0..states).map(|k| r[k] * way.noise[k][j]).sum::<f64>();
        let mut joined: Vec<Vec<f64>> = Vec::with_capacity(p + states);
        for (r, n) in self.rows.iter().zip(&self.noise) {
            joined.push(n.iter().copied().chain((0..states).map(|j| noise(r, j))).collect());
        }
        joined.extend((0..states).map(|i| [vec![0.0; p], way.noise[i][..states].to_vec()].concat()));
        lower(&mut joined);
        let x: Vec<Vec<f64>> = joined[..p].iter().map(|row| row[..p].to_vec()).collect();
        let moved: Vec<[f64; 3]> =
            self.rows.iter().map(|r| super::triangle::transpose_product(&way.transition, *r)).collect();
        // X⁻¹ R Φ, column by column.
        let columns: Vec<Vec<f64>> = (0..states)
            .map(|j| {
                let mut column: Vec<f64> = moved.iter().map(|r| r[j]).collect();
                forward(&x, &mut column);
                column
            })
            .collect();
        let mut through = Way { transition: way.transition, noise: Square::default() };
        for i in 0..states {
            let y = &joined[p + i];
            for (j, column) in columns.iter().enumerate() {
                through.transition[i][j] -= y[..p].iter().zip(column).map(|(y, c)| y * c).sum::<f64>();
                through.noise[i][j] = y[p + j];
            }
        }
        let before = match p <= states {
            true => Ahead { rows: moved, noise: x },
            false => Ahead::in_few_rows(columns),
        };
        (through, before)
    }

    /// The same information in as many rows as states, A given by its columns with noise of variance 1:
    /// AᵀA = L Lᵀ, R = Lᵀ, N = 1.
    fn in_few_rows(mut columns: Vec<Vec<f64>>) -> Ahead {
        lower(&mut columns);
        let states = columns.len();
        let entry = |i: usize, j: usize| if j < states { columns[j][i] } else { 0.0 };
        let unit = |i: usize| (0..states).map(|j| if i == j { 1.0 } else { 0.0 }).collect();
        Ahead {
            rows: (0..states).map(|i| std::array::from_fn(|j| entry(i, j))).collect(),
            noise: (0..states).map(unit).collect(),
        }
    }
}

/// The Kalman filter that sees every free value: the first column of the triangle of the prediction is the
/// gain, the others are what stays unknown.
fn filter(states: usize, stops: &[Stop], ways: &[Way]) -> Vec<Place> {
    let mut unknown: Vec<Vec<f64>> = vec![Vec::new(); states];
    let mut transition = ONE;
    let mut places = Vec::new();
    for (stop, way) in stops.iter().zip(ways) {
        let mut joined: Vec<Vec<f64>> = (0..states)
            .map(|i| {
                let moved = |j: usize| (0..states).map(|k| way.transition[i][k] * unknown[k][j]).sum();
                let width = unknown[0].len();
                (0..width).map(moved).chain(way.noise[i][..states].iter().copied()).collect()
            })
            .collect();
        transition = times(&way.transition, &transition);
        if stop.is_known {
            lower(&mut joined[1..]);
            joined[0] = vec![0.0; states - 1];
            unknown = joined;
            continue;
        }
        lower(&mut joined);
        let mut gain = [0.0; 3];
        for (gain, row) in gain.iter_mut().zip(&joined) {
            *gain = row[0];
        }
        unknown = joined.iter().map(|row| row[1..].to_vec()).collect();
        places.push(Place { transition, gain });
        transition = ONE;
    }
    places
}
