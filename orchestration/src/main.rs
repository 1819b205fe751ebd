//! The `flockslam` executable.
fn main() {}
