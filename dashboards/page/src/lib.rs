//! The live page: what a browser shows of a running process set.
//!
//! It is a process of its own beside the stages and one more reader of the bus, so whatever becomes of it the robot goes on. While
//! nobody looks it reads nothing from the bus at all. What there is to see is gathered in a [`View`], ten times a second; each
//! browser has an [`Outbox`], which knows what that browser has seen and puts together what is new. A frame is made when the
//! browser has taken the ones before it, of what is then newest: a slow browser gets fewer frames, never older ones, and nothing
//! piles up.

mod bus_watch;
mod connection;
mod followed_map;
mod frame;
mod fused_picture;
mod guard;
mod health;
mod known_submap;
mod layer;
mod outbox;
mod path;
mod server;
mod session;
mod set_watch;
mod settings;
mod shade;
mod shared_view;
mod stage_latency;
mod tile_code;
mod view;

pub use followed_map::{FollowedMap, Stored, Version, version_of};
pub use guard::Guard;
pub use health::{Health, StageHealth};
pub use outbox::Outbox;
pub use path::{Path, PathPoint};
pub use server::{PageError, Service, serve};
pub use settings::{Settings, SettingsError};
pub use shared_view::{Place, SetAccess};
pub use tile_code::{decode_tile, encode_tile};
pub use view::{RobotNow, Track, View};
