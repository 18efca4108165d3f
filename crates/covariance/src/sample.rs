//! Draws from N(0, B).

use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::operator::Covariance;

/// A draw from N(0, B): B^{1/2} ξ with ξ of `root_dim` independent standard normals from the caller's
/// generator.
///
/// The same generator state gives the same draw: use one stream per purpose, and record its seed.
pub fn sample<R: Rng + ?Sized>(covariance: &(impl Covariance + ?Sized), rng: &mut R) -> Vec<f64> {
    let xi: Vec<f64> = (0..covariance.root_dim()).map(|_| StandardNormal.sample(rng)).collect();
    let mut x = vec![0.0; covariance.dim()];
    covariance.root(&xi, &mut x);
    x
}
