//! A clamp at one time, and how far it turns from one time to another.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Vector3};

use crate::Error;
use crate::geometry::{Turn, perpendicular, signed_angle};
use crate::rotation::exponential;
use crate::scalar::{length, unit};
use crate::support::{Clamp, ClampAt};

/// Position, tangent and director of a clamp at one time.
pub(crate) struct ClampFrame {
    pub(crate) at: ClampAt,
    pub(crate) position: Vector3<f64>,
    pub(crate) tangent: Vector3<f64>,
    pub(crate) director: Vector3<f64>,
    /// Turns that are in the director.
    pub(crate) turns: f64,
    /// The axes (m₁, m₂, t) before these and before what a parameter turns them by.
    pub(crate) axes: Matrix3<f64>,
}

impl Clamp {
    pub(crate) fn frame(&self, t: f64) -> Result<ClampFrame, Error> {
        self.frame_turned(t, &Vector3::zeros())
    }

    /// The same, turned by a rotation vector in its own axes.
    pub(crate) fn frame_turned(&self, t: f64, turn: &Vector3<f64>) -> Result<ClampFrame, Error> {
        let bad = |what, index| Error::NonFinite { what, index };
        let position = self.position.at(t);
        let tangent = self.tangent.at(t);
        let director = self.director.at(t);
        let size = length(&tangent);
        if !(size > 0.0 && size.is_finite()) {
            return Err(bad("a clamp's tangent, component", 0));
        }
        let mut tangent = tangent / size;
        let across = director - tangent * director.dot(&tangent);
        if !(length(&across) > 1e-9 * length(&director)) {
            return Err(Error::Value {
                field: "a clamp's director",
                value: length(&across),
                expected: "a direction not along its tangent",
            });
        }
        if !position.iter().all(|p| p.is_finite()) {
            return Err(bad("a clamp's position, component", 0));
        }
        let mut director = unit(&across);
        let axes = Matrix3::from_columns(&[director, tangent.cross(&director), tangent]);
        if *turn != Vector3::zeros() {
            let turned = axes * exponential(turn);
            (director, tangent) = (turned.column(0).into_owned(), turned.column(2).into_owned());
        }
        let turns = self.turns_at(t);
        if !turns.is_finite() {
            return Err(bad("a clamp's turns, component", 0));
        }
        if turns != 0.0 {
            let (sin, cos) = (TAU * turns).sin_cos();
            director = director * cos + tangent.cross(&director) * sin;
        }
        Ok(ClampFrame { at: self.at, position, tangent, director, turns, axes })
    }
}

impl ClampFrame {
    /// How far a clamp turned about its tangent since it had another frame \[rad\]: whole turns where it
    /// says them; with the times of the two.
    pub(crate) fn turned_since(&self, a: &ClampFrame, [from, to]: [f64; 2]) -> Result<f64, Error> {
        let b = self;
        let said = TAU * (b.turns - a.turns);
        let over = |_| Error::ClampTurns { turn: std::f64::consts::PI, from, to };
        let turn = Turn::between(&a.tangent, &b.tangent, 0).map_err(over)?;
        let carried = perpendicular(&turn.transport(&b.tangent, &a.director), &b.tangent);
        let angle = signed_angle(&carried, &b.director, &b.tangent);
        Ok(angle + TAU * ((said - angle) / TAU).round())
    }
}
