//! What is put, heard, asked and announced over a session of zenoh. The only crate that knows zenoh.

mod session_configuration;
mod zenoh_session;

pub use session_configuration::SessionConfiguration;
pub use zenoh_session::{
    Announcement, Delivery, Heard, Publication, Question, Session, SessionError, Subscription,
};
