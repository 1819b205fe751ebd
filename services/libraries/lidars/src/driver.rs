//! What every family of lidars is to its caller.

use crate::{Counts, Device, Turn};

/// Requests of a driver to the line of its lidar.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Act {
    /// Send these bytes.
    Send(Vec<u8>),
    /// Set the line DTR, which switches the motor of some models.
    SetDtr(bool),
}

/// A decoder of what a lidar sends, and the requests that start it.
pub trait Driver: Send {
    /// What is to be done next; asked again until nothing is left, and after every read. `now_ns` is of a clock that goes forward only.
    fn act(&mut self, now_ns: i64) -> Option<Act>;

    /// Takes bytes that had arrived at `arrival_ns` and gives out the turns that are complete with them. Stamps of turns are in
    /// the clock of `arrival_ns`.
    fn take(&mut self, bytes: &[u8], arrival_ns: i64, give: &mut dyn FnMut(&Turn));

    /// What the lidar has reported so far.
    fn device(&self) -> &Device;

    /// What was met so far.
    fn counts(&self) -> Counts;
}
