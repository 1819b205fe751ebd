//! Exact labels of simulated beams.

/// What a beam of a simulated scan ended on. It is known to tests and measurements alone: no message carries it.
///
/// In ascending order of how much it is not part of the world: a false range between two surfaces has the greater label.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum BeamLabel {
    /// The beam did not come back.
    NoReturn,
    /// The world itself.
    Static,
    /// Something that stands, but not always: a closed door, a pallet.
    Changed,
    /// A person who walks, or stands for a moment.
    MotionState,
}
