//! The error covariance R of all observations: independent rows and correlated blocks.

use crate::correlated::Correlated;
use crate::{Error, Observation};
use std::collections::BTreeMap;
use std::sync::Arc;
use varda_covariance::{CovarianceFunction, Kernel, Markov, Precision, Scaled, Taper};

/// The error covariance R of all m values of a window, by its square root: σ for independent rows, a block
/// for each observation with correlated errors and for each [`Chain`](crate::Chain).
///
/// A clone shares the blocks; take one from [`ObservationSet::errors`](crate::ObservationSet::errors) before
/// a cost borrows the set.
#[derive(Debug, Clone, Default)]
pub struct ObservationErrors {
    /// σ of independent rows, 1 of correlated ones.
    pub(crate) scale: Vec<f64>,
    /// The rows of each correlated block, in its order.
    pub(crate) blocks: Vec<(Vec<usize>, Correlated)>,
}

/// A value of a chain.
struct Link {
    place: f64,
    row: usize,
    sigma: f64,
    kernel: Kernel,
}

fn same_length(what: &'static str, expected: usize, found: usize) -> Result<(), Error> {
    if found == expected { Ok(()) } else { Err(Error::Length { what, expected, found }) }
}

impl ObservationErrors {
    /// Of observations in their order in the stacked vector.
    pub(crate) fn new(observations: &[Observation], offsets: &[usize]) -> Result<Self, Error> {
        let mut noise = Self::default();
        let mut chains: BTreeMap<usize, Vec<Link>> = BTreeMap::new();
        for (observation, &first) in observations.iter().zip(offsets) {
            let m = observation.rows.len();
            if let Some(block) = &observation.correlation {
                let r = block.covariance();
                for found in [r.dim(), r.root_dim()] {
                    same_length("the error covariance of an observation", m, found)?;
                }
                noise.scale.extend(vec![1.0; m]);
                noise.blocks.push(((first..first + m).collect(), block.clone()));
                continue;
            }
            noise.scale.extend(&observation.sigma);
            let Some(chain) = &observation.chain else { continue };
            same_length("the chain of an observation", m, chain.entries.len())?;
            for (i, &(name, place)) in chain.entries.iter().enumerate() {
                let (row, sigma, kernel) = (first + i, observation.sigma[i], chain.kernel);
                chains.entry(name).or_default().push(Link { place, row, sigma, kernel });
            }
        }
        // a chain of one value is independent
        for chain in chains.into_values().filter(|chain| chain.len() > 1) {
            noise.add_chain(chain)?;
        }
        Ok(noise)
    }

    /// The block of a chain: its root is a recursion along it.
    fn add_chain(&mut self, mut chain: Vec<Link>) -> Result<(), Error> {
        chain.sort_by(|a, b| a.place.total_cmp(&b.place));
        let kernel = chain[0].kernel;
        if chain.iter().any(|link| link.kernel != kernel) {
            return Err(Error::MixedChain);
        }
        let function = CovarianceFunction { sigma: 1.0, kernel, taper: Taper::None };
        let places: Vec<f64> = chain.iter().map(|link| link.place).collect();
        let correlation = Markov::new(&function, &places, &[])?;
        let r = Scaled::new(correlation, chain.iter().map(|link| link.sigma).collect())?;
        let rows: Vec<usize> = chain.iter().map(|link| link.row).collect();
        rows.iter().for_each(|&row| self.scale[row] = 1.0);
        self.blocks.push((rows, Correlated(Arc::new(r))));
        Ok(())
    }

    /// m.
    pub fn dim(&self) -> usize {
        self.scale.len()
    }

    /// d ← R^{1/2}ᵀ d, stacked: the inverse of what
    /// [`whiten_transpose`](crate::ObservationSet::whiten_transpose) does.
    ///
    /// # Panics
    /// If `d` is not of length `dim`.
    pub fn root_transpose(&self, d: &mut [f64]) {
        assert_eq!(d.len(), self.dim(), "length of d");
        d.iter_mut().zip(&self.scale).for_each(|(d, s)| *d *= s);
        self.through_blocks(d, |r, d, out| {
            // R^{1/2}ᵀ = R^{-1/2} R
            let mut product = vec![0.0; d.len()];
            r.apply(d, &mut product);
            r.whiten(&product, out);
        });
    }

    /// d ← R^{1/2} d, stacked: errors, where d is white noise.
    ///
    /// # Panics
    /// If `d` is not of length `dim`.
    pub fn root(&self, d: &mut [f64]) {
        assert_eq!(d.len(), self.dim(), "length of d");
        d.iter_mut().zip(&self.scale).for_each(|(d, s)| *d *= s);
        self.through_blocks(d, |r, d, out| r.root(d, out));
    }

    /// The rows of every block of d through a product with it.
    pub(crate) fn through_blocks(&self, d: &mut [f64], product: impl Fn(&dyn Precision, &[f64], &mut [f64])) {
        for (rows, block) in &self.blocks {
            let raw: Vec<f64> = rows.iter().map(|&row| d[row]).collect();
            let mut out = vec![0.0; rows.len()];
            product(block.covariance(), &raw, &mut out);
            rows.iter().zip(out).for_each(|(&row, out)| d[row] = out);
        }
    }
}
