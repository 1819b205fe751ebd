//! Publishers, subscribers, queries and liveliness over a session of zenoh. The only crate that knows zenoh.

mod session_configuration;
mod zenoh_session;

pub use session_configuration::SessionConfiguration;
pub use zenoh_session::{
    Announcement, Delivery, Publication, Question, ReceivedMessage, Session, SessionError, Subscription,
};
