//! Several robots in one layout: what they have recorded becomes one graph, whose poses every robot works out for itself, and to the
//! same bits.
//!
//! [`Flock`] is what one robot knows and concludes: a collection of records, its own among them, and the search for places that it
//! shares with others. An [`Atlas`] is the graph that a collection describes, a [`FlockLayout`] its solution: both are functions of the
//! records alone, whatever the order in which they came.

mod atlas;
mod consistency;
mod fused;
mod inspection;
mod joint;
mod layout;
mod member;
mod news;
mod overlap;
mod resemblance;
mod rivals;
mod search;
mod start;
mod trajectory;

pub use atlas::Atlas;
pub use fused::FlockMap;
pub use inspection::Inspected;
pub use layout::{FlockLayout, PlacedNode, PlacedRecord};
pub use member::Flock;
pub use news::{News, OwnLoop};
pub use trajectory::{Carried, carried};
