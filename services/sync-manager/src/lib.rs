//! Submaps become constraints, one consistent layout and a fused map.
