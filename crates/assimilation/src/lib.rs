//! Variational data assimilation.
