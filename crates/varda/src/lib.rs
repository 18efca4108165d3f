//! Scenes, twin experiments and reports for variational data assimilation.
