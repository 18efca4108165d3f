//! Matrices of no unknowns.

use varda_linalg::dense::{Cholesky, View, gram, product};
use varda_linalg::sparse::{self, Ordering};
use varda_linalg::{Eigen, LinearSolver, Structure, eigenvalues};

#[test]
fn every_solver_takes_a_matrix_of_no_unknowns() {
    for structure in [
        Structure::SymmetricBand { half_bandwidth: 2 },
        Structure::Band { half_bandwidth: 2 },
        Structure::Dense,
        Structure::from_pairs(0, []).unwrap(),
    ] {
        let mut solver = LinearSolver::new(0, &structure);
        let mut factor = solver.empty_factor();
        assert_eq!(solver.factor(&[], &mut factor), Ok(0), "{structure:?}");
        solver.solve(&factor, &mut []);
        solver.solve_transpose(&factor, &mut []);
        assert!(structure.colouring(0).is_empty());
    }
}

#[test]
fn factors_eigenvalues_and_products_of_nothing() {
    Cholesky::well_determined(0, &[]).unwrap().solve_columns(&mut []);
    let sparse = sparse::Cholesky::new(0, &Structure::Dense, &[], Ordering::Natural).unwrap();
    assert!(sparse.inverse_diagonal().is_empty());
    assert!(eigenvalues(0, &[]).unwrap().is_empty() && Eigen::new(0, &[]).unwrap().vectors.is_empty());
    product(View::new(&[], 0, 3), View::new(&[0.0; 6], 3, 2), &mut []);
    gram(View::new(&[], 0, 0), &mut []);
    let mut zeros = [f64::NAN; 4];
    product(View::new(&[], 2, 0), View::new(&[], 0, 2), &mut zeros);
    assert_eq!(zeros, [0.0; 4]);
}
