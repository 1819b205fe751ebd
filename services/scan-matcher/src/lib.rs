//! A scan and a grid become a pose.
