//! Linear algebra on slices: dense, band and sparse factorizations, eigenvalues, Krylov methods.

#![forbid(unsafe_code)]
