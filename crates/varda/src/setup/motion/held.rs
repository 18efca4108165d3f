//! A support, and the recorded body that carries it.

use std::sync::Arc;

use varda_rod::{Motion, RecordedMotion, RecordedRotation, Vector3};

/// A support: where it is and how it is turned. Keys that the motion says are absent.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Held {
    pub(crate) position: Option<[f64; 3]>,
    pub(crate) tangent: Option<[f64; 3]>,
    pub(crate) director: Option<[f64; 3]>,
}

/// Place, tangent and director of a support as they move.
pub(crate) struct Moving {
    pub(crate) place: Arc<dyn Motion>,
    pub(crate) tangent: Arc<dyn Motion>,
    pub(crate) director: Arc<dyn Motion>,
}

/// A body that moves, and the support on it, in the body's axes.
pub(super) struct Carried {
    pub(super) place: RecordedMotion,
    pub(super) rotation: RecordedRotation,
    pub(super) offset: Vector3<f64>,
    pub(super) tangent: Vector3<f64>,
    pub(super) director: Vector3<f64>,
}

impl Carried {
    /// The support where its own keys have it at model time 0.
    pub(super) fn from_time_zero(place: RecordedMotion, rotation: RecordedRotation, held: Held) -> Carried {
        let Held { position, tangent, director } = held;
        let own = |v: Option<[f64; 3]>| Vector3::from(v.unwrap_or_default());
        let back = rotation.at(0.0).inverse();
        let offset = back * (own(position) - place.at(0.0));
        Carried { offset, tangent: back * own(tangent), director: back * own(director), place, rotation }
    }

    /// The offset in the support's axes (m₁, m₂, t).
    pub(super) fn arm(&self) -> Vector3<f64> {
        let tangent = self.tangent.normalize();
        let m1 = (self.director - tangent * tangent.dot(&self.director)).normalize();
        Vector3::new(m1.dot(&self.offset), tangent.cross(&m1).dot(&self.offset), tangent.dot(&self.offset))
    }
}

impl From<Carried> for Moving {
    fn from(carried: Carried) -> Moving {
        let Carried { place, rotation, offset, tangent, director } = carried;
        let rotation = Arc::new(rotation);
        let turned = |own: Vector3<f64>| -> Arc<dyn Motion> {
            let rotation = Arc::clone(&rotation);
            Arc::new(move |t: f64| rotation.at(t) * own)
        };
        let (tangent, director) = (turned(tangent), turned(director));
        Moving { place: Arc::new(move |t: f64| place.at(t) + rotation.at(t) * offset), tangent, director }
    }
}
