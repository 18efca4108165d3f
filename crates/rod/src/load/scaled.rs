//! A share of a load, on the way to all of it.

use std::ops::Range;
use std::sync::Arc;

use super::{EdgeLoad, EdgeMotion, Load};

/// A load times a factor.
pub(crate) struct Scaled {
    pub(crate) load: Arc<dyn Load>,
    pub(crate) factor: f64,
}

impl Load for Scaled {
    fn has_potential(&self) -> bool {
        self.load.has_potential()
    }

    fn edges(&self, segments: usize) -> Range<usize> {
        self.load.edges(segments)
    }

    fn uses_directors(&self) -> bool {
        self.load.uses_directors()
    }

    fn has_moment(&self) -> bool {
        self.load.has_moment()
    }

    fn on_edge(&self, motion: &EdgeMotion) -> EdgeLoad {
        self.load.on_edge(motion).times(self.factor)
    }
}
