//! A root of a covariance with no more columns than rows (faer's QR decomposition).

use crate::dense::View;
use crate::interrupt::apart;
use crate::{Error, clear_upper_registers};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::qr::no_pivoting::factor::{qr_in_place, qr_in_place_scratch, recommended_block_size};
use faer::{Mat, MatMut, Par};

/// A root with n columns: L, lower triangular, with L Lᵀ = W Wᵀ, from W of n rows and more columns;
/// Rᵀ of Wᵀ = Q R. It keeps the digits that the product W Wᵀ would lose. Both by columns; a W of n
/// columns or fewer is given back.
///
/// ```
/// // (3, 4) is as (5)
/// let l = varda_linalg::shorter_root(1, &[3.0, 4.0])?;
/// assert!(l.len() == 1 && (l[0].abs() - 5.0).abs() < 1e-14);
/// # Ok::<(), varda_linalg::Error>(())
/// ```
///
/// # Errors
/// [`Error::Eigen`] for entries that are not finite; [`Error::Interrupted`].
///
/// # Panics
/// If `columns` is not made of columns of length n.
pub fn shorter_root(n: usize, columns: &[f64]) -> Result<Vec<f64>, Error> {
    assert!(columns.len().is_multiple_of(n.max(1)), "a column has {n} values");
    let count = columns.len() / n.max(1);
    if count <= n {
        return Ok(columns.to_vec());
    }
    if !columns.iter().all(|w| w.is_finite()) {
        return Err(Error::Eigen { dim: n });
    }
    apart(n, columns, move |columns| {
        let mut transpose = View::new(columns, n, count).transpose().to_matrix().into_columns();
        let block = recommended_block_size::<f64>(count, n);
        let mut coefficients = Mat::zeros(block, n);
        let scratch = qr_in_place_scratch::<f64>(count, n, block, Par::Seq, Default::default());
        let mut scratch = MemBuffer::new(scratch);
        qr_in_place(
            MatMut::from_column_major_slice_mut(&mut transpose, count, n),
            coefficients.as_mut(),
            Par::Seq,
            MemStack::new(&mut scratch),
            Default::default(),
        );
        clear_upper_registers();
        let mut root = vec![0.0; n * n];
        for j in 0..n {
            for i in j..n {
                root[i + j * n] = transpose[j + i * count];
            }
        }
        Ok(root)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dense::gram;

    #[test]
    fn it_is_a_root_of_the_same_matrix() {
        for (n, count) in [(1_usize, 5), (4, 9), (30, 31), (40, 200)] {
            // the second half of the rows repeats the first: a matrix of half the rank
            let entry = |i: usize, j: usize| (1.7_f64 * (i % n.div_ceil(2)) as f64 + 0.9 * j as f64).sin();
            let w: Vec<f64> = (0..n * count).map(|ij| entry(ij % n, ij / n)).collect();
            let (mut of_w, mut of_l) = (vec![0.0; n * n], vec![0.0; n * n]);
            gram(View::new(&w, n, count), &mut of_w);
            let root = shorter_root(n, &w).unwrap();
            assert_eq!(root.len(), n * n);
            gram(View::new(&root, n, n), &mut of_l);
            for (a, b) in of_w.iter().zip(&of_l) {
                assert!((a - b).abs() <= 1e-14 * count as f64, "{n} {count}: {a} {b}");
            }
            assert!((1..n).all(|j| root[j * n..j * n + j].iter().all(|l| *l == 0.0)));
        }
        assert_eq!(shorter_root(2, &[1.0, 2.0]).unwrap(), [1.0, 2.0]);
        assert!(shorter_root(1, &[f64::NAN, 1.0]).is_err());
    }
}
