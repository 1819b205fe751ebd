//! The worlds that come with the program. Each is fixed, except for the campus: what varies in it is drawn from a seed of its own.

mod campus;
mod hotel;
mod office;
mod warehouse;
mod yard;

pub(super) use campus::campus;
pub(super) use hotel::hotel;
pub(super) use office::office;
pub(super) use warehouse::warehouse;
pub(super) use yard::yard;
