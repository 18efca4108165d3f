//! Covariances of an ensemble: localized sample covariance, and its hybrid with a static one.

use crate::error::Error;
use crate::input::check_lengths;
use crate::kernel::Taper;
use crate::operator::Covariance;
use crate::truncated::Truncated;
use varda_linalg::{axpy, dot_in_lanes};

/// The localized covariance of an ensemble of N members (Schur product, Houtekamer and Mitchell 2001):
///
/// ```text
/// B_e = C ∘ (X Xᵀ),   X = [x₁ − x̄, …, x_N − x̄] / √(N−1)
/// C = Σ_j c_j c_jᵀ   (r columns)
/// ```
///
/// Its square root is the modulated ensemble (Bishop, Whitaker and Lei 2017): the N r columns x_i ∘ c_j, so
/// that
///
/// ```text
/// B_e^{1/2} v = Σ_i x_i ∘ (C^{1/2} v_i),   v = [v₁, …, v_N],   v_i of length r,
/// ```
///
/// the control vector of Lorenc (2003). Nothing of size n × N r is formed: a root costs n N r operations,
/// the memory is n (N + r) numbers. Without localization r = 1 and C is all ones.
///
/// ```
/// use varda_covariance::{Covariance, Ensemble, Localization};
///
/// // members (1, 0) and (3, 2)
/// let b = Ensemble::new(&[1.0, 0.0, 3.0, 2.0], Localization::none(2))?;
/// let mut column = [0.0; 2];
/// b.apply(&[1.0, 0.0], &mut column);
/// assert_eq!(column, [2.0, 2.0]);
/// # Ok::<(), varda_covariance::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Ensemble {
    n: usize,
    /// X row by row: the N values of one component together.
    rows: Vec<f64>,
    members: usize,
    mean: Vec<f64>,
    localization: Localization,
}

/// A correlation matrix C that multiplies a sample covariance element by element, by a root of r columns.
///
/// Its rows are scaled to unit length after truncation: C has a diagonal of exactly ones up to rounding, and
/// localization leaves variances alone.
#[derive(Debug, Clone)]
pub struct Localization {
    n: usize,
    rank: usize,
    /// C^{1/2} row by row.
    rows: Vec<f64>,
}

/// B = β_s² B_s + β_e² B_e (Hamill and Snyder 2000), with the root [β_s U_s, β_e U_e] (Lorenc 2003): v
/// is that of the static part followed by that of the ensemble.
///
/// A weight of zero leaves the other part alone: its share of v then has no effect.
///
/// ```
/// use varda_covariance::{Covariance, Diagonal, Ensemble, Hybrid, Localization};
///
/// let climate = Diagonal::uniform(2, 3.0)?;
/// let ensemble = Ensemble::new(&[1.0, 0.0, 3.0, 2.0], Localization::none(2))?;
/// let b = Hybrid::new(&climate, 1.0, ensemble, 0.5)?;
/// let mut variance = [0.0; 2];
/// b.variance(&mut variance);
/// assert_eq!(variance, [9.5, 9.5]);
/// # Ok::<(), varda_covariance::Error>(())
/// ```
#[derive(Clone)]
pub struct Hybrid<'a> {
    static_part: &'a dyn Covariance,
    static_weight: f64,
    ensemble: Ensemble,
    ensemble_weight: f64,
}

impl Localization {
    /// C = 1: no localization, for vectors of length n.
    pub fn none(n: usize) -> Self {
        Self { n, rank: 1, rows: vec![1.0; n] }
    }

    /// r, the number of columns of the root.
    pub fn rank(&self) -> usize {
        self.rank
    }

    /// Row p of the root C^{1/2}: C(p, q) = row(p) · row(q).
    ///
    /// # Panics
    ///
    /// If p ≥ n.
    pub fn row(&self, p: usize) -> &[f64] {
        &self.rows[p * self.rank..][..self.rank]
    }
}

impl Localization {
    /// From a symmetric positive semidefinite n × n matrix with a positive diagonal, row by row: its eigen
    /// root ([`Truncated::eigen`]) of the eigenvalues above `tolerance` times the largest, rows scaled to
    /// unit length.
    ///
    /// # Errors
    ///
    /// Those of [`Truncated::eigen`]; [`Error::Parameter`] for a component of which the truncation leaves
    /// nothing.
    pub fn new(n: usize, matrix: &[f64], tolerance: f64) -> Result<Self, Error> {
        let root = Truncated::eigen(n, matrix, tolerance)?;
        let rank = root.root_dim();
        let (mut unit, mut column) = (vec![0.0; rank], vec![0.0; n]);
        let mut rows = vec![0.0; n * rank];
        for j in 0..rank {
            unit[j] = 1.0;
            root.root(&unit, &mut column);
            unit[j] = 0.0;
            column.iter().enumerate().for_each(|(p, c)| rows[p * rank + j] = *c);
        }
        for row in rows.chunks_exact_mut(rank) {
            let length = dot_in_lanes(row, row).sqrt();
            if !(length > 1e-8) {
                return Err(Error::Parameter {
                    what: "what a truncated localization leaves of a component",
                    value: length,
                    range: "above 0: lower the truncation tolerance",
                });
            }
            row.iter_mut().for_each(|c| *c /= length);
        }
        Ok(Self { n, rank, rows })
    }

    /// C(i, j) = t(d(i, j)) with a taper t of the distance d between the places of components i and j
    /// (`distance(i, j)` is asked for j ≤ i; components at one place have the distance 0).
    ///
    /// # Errors
    ///
    /// As [`new`](Self::new): a taper that is no covariance for this distance (see [`Taper`]) is found out
    /// here.
    pub fn by_distance(
        taper: Taper,
        n: usize,
        distance: impl Fn(usize, usize) -> f64,
        tolerance: f64,
    ) -> Result<Self, Error> {
        let mut matrix = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..=i {
                let value = taper.at(distance(i, j));
                matrix[i * n + j] = value;
                matrix[j * n + i] = value;
            }
        }
        Self::new(n, &matrix, tolerance)
    }
}

impl Ensemble {
    /// From members given one after the other, each of length n = that of the localization.
    ///
    /// # Errors
    ///
    /// [`Error::Size`] for fewer than two members or a broken one, [`Error::NonFinite`] (row: the component,
    /// column: the member) for a value that is not finite.
    pub fn new(members: &[f64], localization: Localization) -> Result<Self, Error> {
        let n = localization.n;
        let count = members.len() / n.max(1);
        if count < 2 || count * n != members.len() {
            let expected = n * count.max(2);
            return Err(Error::Size { what: "an ensemble", expected, found: members.len() });
        }
        let mut mean = vec![0.0; n];
        members.chunks_exact(n).for_each(|x| axpy(1.0 / count as f64, x, &mut mean));
        let scale = 1.0 / ((count - 1) as f64).sqrt();
        let columns: Vec<f64> =
            members.chunks_exact(n).flat_map(|x| x.iter().zip(&mean).map(|(x, m)| scale * (x - m))).collect();
        Ok(Self { mean, ..Self::from_perturbations(&columns, localization)? })
    }

    /// From the columns of X themselves, one after the other, already scaled (B_e = C ∘ (X Xᵀ)), about a
    /// mean of zero. They need not sum to zero: any square root will do, of a propagated posterior for
    /// example.
    ///
    /// # Errors
    ///
    /// As [`new`](Self::new), one column being enough.
    pub fn from_perturbations(columns: &[f64], localization: Localization) -> Result<Self, Error> {
        let n = localization.n;
        let members = columns.len() / n.max(1);
        if members == 0 || members * n != columns.len() {
            let expected = n * members.max(1);
            return Err(Error::Size { what: "an ensemble", expected, found: columns.len() });
        }
        if let Some(at) = columns.iter().position(|x| !x.is_finite()) {
            return Err(Error::NonFinite { row: at % n, column: at / n, value: columns[at] });
        }
        for p in 0..n {
            let variance: f64 = columns.iter().skip(p).step_by(n).map(|x| x * x).sum();
            if !variance.is_finite() {
                return Err(Error::NonFinite { row: p, column: p, value: variance });
            }
        }
        let rows = (0..n).flat_map(|p| (0..members).map(move |i| columns[i * n + p])).collect();
        Ok(Self { n, rows, members, mean: vec![0.0; n], localization })
    }

    /// N, the number of members.
    pub fn members(&self) -> usize {
        self.members
    }

    /// x̄; zero for an ensemble made of perturbations.
    pub fn mean(&self) -> &[f64] {
        &self.mean
    }

    /// C.
    pub fn localization(&self) -> &Localization {
        &self.localization
    }

    /// Column i of X, the scaled perturbation of member i.
    ///
    /// # Panics
    ///
    /// If there is no such member, or `x` is not of length n.
    pub fn perturbation(&self, i: usize, x: &mut [f64]) {
        assert!(i < self.members, "member {i} of {}", self.members);
        assert_eq!(x.len(), self.n, "length of a perturbation");
        x.iter_mut().zip(self.rows.chunks_exact(self.members)).for_each(|(x, row)| *x = row[i]);
    }

    /// x += w B_e^{1/2} v.
    fn root_add(&self, w: f64, v: &[f64], x: &mut [f64]) {
        let rank = self.localization.rank;
        for (p, (x, row)) in x.iter_mut().zip(self.rows.chunks_exact(self.members)).enumerate() {
            let c = self.localization.row(p);
            *x += w * row
                .iter()
                .zip(v.chunks_exact(rank))
                .map(|(x_i, v_i)| x_i * dot_in_lanes(c, v_i))
                .sum::<f64>();
        }
    }

    /// v = w (B_e^{1/2})ᵀ x.
    fn scaled_root_transpose(&self, w: f64, x: &[f64], v: &mut [f64]) {
        let rank = self.localization.rank;
        v.fill(0.0);
        for (p, (x, row)) in x.iter().zip(self.rows.chunks_exact(self.members)).enumerate() {
            let c = self.localization.row(p);
            for (x_i, v_i) in row.iter().zip(v.chunks_exact_mut(rank)) {
                axpy(w * x_i * x, c, v_i);
            }
        }
    }

    /// y += w B_e x, entry by entry of B_e: n² (N + r) operations.
    fn apply_add(&self, w: f64, x: &[f64], y: &mut [f64]) {
        let row = |p: usize| &self.rows[p * self.members..][..self.members];
        for (p, y) in y.iter_mut().enumerate() {
            let c = self.localization.row(p);
            let entry = |q: usize| dot_in_lanes(row(p), row(q)) * dot_in_lanes(c, self.localization.row(q));
            *y += w * x.iter().enumerate().map(|(q, x)| entry(q) * x).sum::<f64>();
        }
    }

    /// variance += w diag B_e.
    fn variance_add(&self, w: f64, variance: &mut [f64]) {
        for (p, (variance, row)) in variance.iter_mut().zip(self.rows.chunks_exact(self.members)).enumerate()
        {
            let c = self.localization.row(p);
            *variance += w * dot_in_lanes(row, row) * dot_in_lanes(c, c);
        }
    }
}

impl Covariance for Ensemble {
    fn dim(&self) -> usize {
        self.n
    }

    fn root_dim(&self) -> usize {
        self.members * self.localization.rank
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        check_lengths(x, self.n, y, self.n);
        y.fill(0.0);
        self.apply_add(1.0, x, y);
    }

    fn root(&self, v: &[f64], x: &mut [f64]) {
        check_lengths(v, self.root_dim(), x, self.n);
        x.fill(0.0);
        self.root_add(1.0, v, x);
    }

    fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
        check_lengths(x, self.n, v, self.root_dim());
        self.scaled_root_transpose(1.0, x, v);
    }

    fn variance(&self, variance: &mut [f64]) {
        assert_eq!(variance.len(), self.n, "length of the variance");
        variance.fill(0.0);
        self.variance_add(1.0, variance);
    }
}

impl<'a> Hybrid<'a> {
    /// β_s² `static_part` + β_e² `ensemble`; the weights are β_s and β_e.
    ///
    /// # Errors
    ///
    /// [`Error::Size`] for parts of different size; [`Error::Parameter`] for a weight that is negative or not
    /// finite; [`Error::Zero`] for two weights of zero.
    pub fn new(
        static_part: &'a dyn Covariance,
        static_weight: f64,
        ensemble: Ensemble,
        ensemble_weight: f64,
    ) -> Result<Self, Error> {
        if static_part.dim() != ensemble.dim() {
            let (expected, found) = (static_part.dim(), ensemble.dim());
            return Err(Error::Size { what: "the ensemble part", expected, found });
        }
        for (what, value) in
            [("weight of the static part", static_weight), ("weight of the ensemble", ensemble_weight)]
        {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(Error::Parameter { what, value, range: "at least 0" });
            }
        }
        if static_weight == 0.0 && ensemble_weight == 0.0 {
            return Err(Error::Zero);
        }
        Ok(Self { static_part, static_weight, ensemble, ensemble_weight })
    }

    /// B_s.
    pub fn static_part(&self) -> &'a dyn Covariance {
        self.static_part
    }

    /// β_s.
    pub fn static_weight(&self) -> f64 {
        self.static_weight
    }

    /// The ensemble of B_e.
    pub fn ensemble(&self) -> &Ensemble {
        &self.ensemble
    }

    /// β_e.
    pub fn ensemble_weight(&self) -> f64 {
        self.ensemble_weight
    }
}

impl Covariance for Hybrid<'_> {
    fn dim(&self) -> usize {
        self.ensemble.n
    }

    fn root_dim(&self) -> usize {
        self.static_part.root_dim() + self.ensemble.root_dim()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        check_lengths(x, self.dim(), y, self.dim());
        self.static_part.apply(x, y);
        y.iter_mut().for_each(|y| *y *= self.static_weight * self.static_weight);
        self.ensemble.apply_add(self.ensemble_weight * self.ensemble_weight, x, y);
    }

    fn root(&self, v: &[f64], x: &mut [f64]) {
        check_lengths(v, self.root_dim(), x, self.dim());
        let (v_s, v_e) = v.split_at(self.static_part.root_dim());
        self.static_part.root(v_s, x);
        x.iter_mut().for_each(|x| *x *= self.static_weight);
        self.ensemble.root_add(self.ensemble_weight, v_e, x);
    }

    fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
        check_lengths(x, self.dim(), v, self.root_dim());
        let (v_s, v_e) = v.split_at_mut(self.static_part.root_dim());
        self.static_part.root_transpose(x, v_s);
        v_s.iter_mut().for_each(|v| *v *= self.static_weight);
        self.ensemble.scaled_root_transpose(self.ensemble_weight, x, v_e);
    }

    fn variance(&self, variance: &mut [f64]) {
        self.static_part.variance(variance);
        variance.iter_mut().for_each(|s| *s *= self.static_weight * self.static_weight);
        self.ensemble.variance_add(self.ensemble_weight * self.ensemble_weight, variance);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Dense, Diagonal};

    #[test]
    fn two_members_by_hand() {
        // Members (1, 0) and (3, 2): mean (2, 1), X = [(−1, −1), (1, 1)], X Xᵀ all twos.
        let b = Ensemble::new(&[1.0, 0.0, 3.0, 2.0], Localization::none(2)).unwrap();
        assert_eq!(b.mean(), [2.0, 1.0]);
        let mut out = [0.0; 2];
        b.apply(&[1.0, 0.0], &mut out);
        assert_eq!(out, [2.0, 2.0]);
        b.perturbation(0, &mut out);
        assert_eq!(out, [-1.0, -1.0]);

        // C = [[1, ½], [½, 1]] halves the covariance between the two, and leaves the variances.
        let c = Localization::new(2, &[1.0, 0.5, 0.5, 1.0], 0.0).unwrap();
        let b = Ensemble::new(&[1.0, 0.0, 3.0, 2.0], c).unwrap();
        b.apply(&[1.0, 0.0], &mut out);
        assert!((out[0] - 2.0).abs() < 1e-15 && (out[1] - 1.0).abs() < 1e-15, "{out:?}");
    }

    #[test]
    fn root_and_product_agree_and_localization_keeps_variances() {
        let n = 12;
        let ring = |i: usize, j: usize| (i.abs_diff(j)).min(n - i.abs_diff(j)) as f64;
        let members: Vec<f64> = (0..5 * n).map(|k| ((k * k) as f64 * 0.37).sin()).collect();
        let taper = Taper::GaspariCohn { support: 6.0 };
        let truncated = Localization::by_distance(taper, n, ring, 0.05).unwrap();
        assert!(truncated.rank() < n);
        let plain = Ensemble::new(&members, Localization::none(n)).unwrap();
        let localized = Ensemble::new(&members, truncated).unwrap();
        let static_part =
            Dense::new(n, &(0..n * n).map(|k| if k % (n + 1) == 0 { 2.0 } else { 0.1 }).collect::<Vec<_>>())
                .unwrap();
        let hybrid = Hybrid::new(&static_part, 0.6, localized.clone(), 0.8).unwrap();
        let (mut expected, mut variance) = (vec![0.0; n], vec![0.0; n]);
        plain.variance(&mut expected);
        localized.variance(&mut variance);
        for (a, b) in variance.iter().zip(&expected) {
            assert!((a - b).abs() <= 1e-14, "{a} {b}");
        }
        for b in [&plain as &dyn Covariance, &localized, &hybrid] {
            // B x = U (Uᵀ x), and the diagonal is that of B.
            let x: Vec<f64> = (0..n).map(|i| (i as f64).cos()).collect();
            let (mut v, mut y, mut z) = (vec![0.0; b.root_dim()], vec![0.0; n], vec![0.0; n]);
            b.root_transpose(&x, &mut v);
            b.root(&v, &mut y);
            b.apply(&x, &mut z);
            assert!(y.iter().zip(&z).all(|(y, z)| (y - z).abs() <= 1e-13), "{y:?} {z:?}");
            b.variance(&mut variance);
            for p in 0..n {
                let unit: Vec<f64> = (0..n).map(|q| f64::from(p == q)).collect();
                b.apply(&unit, &mut z);
                assert!((z[p] - variance[p]).abs() <= 1e-14);
            }
        }
        // Beyond the support only the static part correlates (truncation leaves a little).
        let mut column = vec![0.0; n];
        let unit: Vec<f64> = (0..n).map(|q| f64::from(q == 0)).collect();
        localized.apply(&unit, &mut column);
        plain.apply(&unit, &mut expected);
        assert!(column[6].abs() < 0.1 * expected[6].abs(), "{} {}", column[6], expected[6]);
    }

    #[test]
    fn weights_zero_and_one_are_the_pure_parts() {
        let static_part = Diagonal::uniform(2, 3.0).unwrap();
        let ensemble = Ensemble::new(&[1.0, 0.0, 3.0, 2.0], Localization::none(2)).unwrap();
        let (mut a, mut b) = ([0.0; 2], [0.0; 2]);
        for (weights, pure) in [((1.0, 0.0), &static_part as &dyn Covariance), ((0.0, 1.0), &ensemble)] {
            let hybrid = Hybrid::new(&static_part, weights.0, ensemble.clone(), weights.1).unwrap();
            hybrid.apply(&[0.3, -2.0], &mut a);
            pure.apply(&[0.3, -2.0], &mut b);
            assert_eq!(a, b);
        }
    }

    #[test]
    fn bad_ensembles_are_typed_errors() {
        let none = || Localization::none(2);
        assert!(matches!(Ensemble::new(&[1.0, 2.0], none()), Err(Error::Size { expected: 4, .. })));
        assert!(matches!(Ensemble::new(&[1.0, 2.0, 3.0, 4.0, 5.0], none()), Err(Error::Size { .. })));
        assert!(matches!(
            Ensemble::new(&[1.0, 2.0, 3.0, f64::NAN], none()),
            Err(Error::NonFinite { row: 1, .. })
        ));
        assert!(matches!(Ensemble::from_perturbations(&[], none()), Err(Error::Size { .. })));
        // Indefinite on a ring of three with these distances: no covariance.
        let wild = Localization::new(3, &[1.0, 0.9, -0.9, 0.9, 1.0, 0.9, -0.9, 0.9, 1.0], 0.0);
        assert!(matches!(wild, Err(Error::NotPositiveSemidefinite { .. })));
        let (b, e) =
            (Diagonal::uniform(3, 1.0).unwrap(), Ensemble::new(&[1.0, 2.0, 3.0, 4.0], none()).unwrap());
        assert!(matches!(Hybrid::new(&b, 1.0, e.clone(), 1.0), Err(Error::Size { .. })));
        let b = Diagonal::uniform(2, 1.0).unwrap();
        assert!(matches!(Hybrid::new(&b, -1.0, e.clone(), 1.0), Err(Error::Parameter { .. })));
        assert!(matches!(Hybrid::new(&b, 0.0, e, 0.0), Err(Error::Zero)));
    }
}
