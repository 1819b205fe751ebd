//! Fitting clouds of points to submaps: branch and bound, point-to-line refinement.
