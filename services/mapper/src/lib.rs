//! A scan and its pose become evidence, tiles and submaps.
