//! Developer commands: `cargo xtask verify`.
fn main() {}
