//! Findings of a robot that are not published to its flock yet.

use flockslam_loop_closure::closure::Closure;
use flockslam_records::Stretch;

/// A loop among a robot's own nodes, which are named by the sequences of their scans.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OwnLoop {
    /// Node that it starts from.
    pub from: u64,
    /// Node that it leads to.
    pub to: u64,
    /// The measured motion and how it was found; its numbers of nodes mean nothing here.
    pub closure: Closure,
}

/// Findings since the last publication.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Findings {
    /// New nodes, in order.
    pub stretches: Vec<Stretch>,
    /// New loops among published nodes.
    pub loops: Vec<OwnLoop>,
}
