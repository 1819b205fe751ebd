//! A session: messages, questions and announcements by key.

use crate::SessionConfiguration;
use std::borrow::Cow;
use std::time::Duration;
use zenoh::Wait;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::qos::{CongestionControl, Reliability};
use zenoh::query::{Query, Queryable};
use zenoh::sample::{Locality, Sample, SampleKind};
use zenoh_ext::{
    AdvancedPublisher, AdvancedPublisherBuilderExt, AdvancedSubscriber, AdvancedSubscriberBuilderExt,
    CacheConfig, HistoryConfig, MissDetectionConfig, RecoveryConfig,
};

/// A query for kept messages of a publisher is answered within this time.
const KEPT_TIMEOUT: Duration = Duration::from_secs(60);

/// Message of zenoh for a rejected configuration.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{0}")]
pub struct SessionError(pub(crate) String);

impl From<zenoh::Error> for SessionError {
    fn from(error: zenoh::Error) -> Self {
        Self(error.to_string())
    }
}

/// How messages go out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Delivery {
    /// Over links that have both, by one that loses nothing.
    pub is_reliable: bool,
    /// Number of the last messages that are kept for late subscribers; 0 for none.
    pub kept: usize,
}

/// A session. What it has declared ends with what was returned for it.
#[derive(Debug)]
pub struct Session(zenoh::Session);

/// A message that was received.
#[derive(Debug)]
pub struct ReceivedMessage<'s>(&'s Sample);

/// A query, and the channel for its answer.
#[derive(Debug)]
pub struct Question(Query);

/// Messages are received as long as this exists.
pub struct Subscription {
    _declared: Declared,
}

#[allow(dead_code, reason = "what is received ends with what stands in it")]
enum Declared {
    Plain(Subscriber<()>),
    Kept(AdvancedSubscriber<()>),
    Questions(Queryable<()>),
}

/// Sends to one key.
pub struct Publication(AdvancedPublisher<'static>);

/// Others see its key as long as this is, and the session can be reached.
#[derive(Debug)]
pub struct Announcement {
    _token: LivelinessToken,
}

impl ReceivedMessage<'_> {
    /// Its key.
    pub fn key(&self) -> &str {
        self.0.key_expr().as_str()
    }

    /// How long it is.
    pub fn length(&self) -> usize {
        self.0.payload().len()
    }

    /// Its message.
    pub fn bytes(&self) -> Cow<'_, [u8]> {
        self.0.payload().to_bytes()
    }

    /// What stands beside it.
    pub fn attachment(&self) -> Option<Cow<'_, [u8]>> {
        self.0.attachment().map(zenoh::bytes::ZBytes::to_bytes)
    }
}

impl Question {
    /// Its message.
    pub fn bytes(&self) -> Cow<'_, [u8]> {
        self.0.payload().map(zenoh::bytes::ZBytes::to_bytes).unwrap_or_default()
    }

    /// What stands beside it.
    pub fn attachment(&self) -> Option<Cow<'_, [u8]>> {
        self.0.attachment().map(zenoh::bytes::ZBytes::to_bytes)
    }

    /// Answers it.
    ///
    /// # Errors
    /// When zenoh refuses.
    pub fn answer(self, bytes: Vec<u8>, attachment: Vec<u8>) -> Result<(), SessionError> {
        let key = self.0.key_expr().clone();
        Ok(self.0.reply(key, bytes).attachment(attachment).wait()?)
    }
}

impl Publication {
    /// Sends a message, with something beside it.
    ///
    /// # Errors
    /// When zenoh refuses.
    pub fn send(&self, bytes: Vec<u8>, attachment: Vec<u8>) -> Result<(), SessionError> {
        Ok(self.0.put(bytes).attachment(attachment).wait()?)
    }
}

impl Session {
    /// Opens a session.
    ///
    /// # Errors
    /// When the network cannot be opened.
    pub fn open(configuration: SessionConfiguration) -> Result<Self, SessionError> {
        Ok(Self(zenoh::open(configuration.into_inner()).wait()?))
    }

    /// What it is called.
    pub fn id(&self) -> String {
        self.0.zid().to_string()
    }

    /// Whether another session or a router is connected.
    pub fn is_connected(&self) -> bool {
        let info = self.0.info();
        info.routers_zid().wait().next().is_some() || info.peers_zid().wait().next().is_some()
    }

    /// Sends one message. It is dropped when there is no room on its way.
    ///
    /// # Errors
    /// When zenoh refuses.
    pub fn put(&self, key: String, bytes: Vec<u8>) -> Result<(), SessionError> {
        Ok(self.0.put(key, bytes).congestion_control(CongestionControl::Drop).wait()?)
    }

    /// Sends to a key from now on.
    ///
    /// # Errors
    /// When zenoh refuses.
    pub fn publish(&self, key: String, delivery: Delivery) -> Result<Publication, SessionError> {
        let reliability = if delivery.is_reliable { Reliability::Reliable } else { Reliability::BestEffort };
        let publisher = self
            .0
            .declare_publisher(key)
            .congestion_control(CongestionControl::Drop)
            .reliability(reliability)
            .advanced();
        let publisher = match delivery.kept {
            0 => publisher,
            kept => publisher
                .publisher_detection()
                .cache(CacheConfig::default().max_samples(kept))
                .sample_miss_detection(MissDetectionConfig::default()),
        };
        Ok(Publication(publisher.wait()?))
    }

    /// Subscribes to what other sessions send to a key, on zenoh's own threads.
    ///
    /// # Errors
    /// When zenoh refuses.
    pub fn subscribe(
        &self,
        key: String,
        mut handle: impl FnMut(&ReceivedMessage<'_>) + Send + Sync + 'static,
    ) -> Result<Subscription, SessionError> {
        let subscriber = self.0.declare_subscriber(key).allowed_origin(Locality::Remote);
        let subscriber = subscriber.callback_mut(move |sample| handle(&ReceivedMessage(&sample))).wait()?;
        Ok(Subscription { _declared: Declared::Plain(subscriber) })
    }

    /// As [`Self::subscribe`], and first as many of the messages that publishers have kept.
    ///
    /// # Errors
    /// When zenoh refuses.
    pub fn subscribe_with_history(
        &self,
        key: String,
        kept: usize,
        mut handle: impl FnMut(&ReceivedMessage<'_>) + Send + Sync + 'static,
    ) -> Result<Subscription, SessionError> {
        let subscriber = self.0.declare_subscriber(key).allowed_origin(Locality::Remote);
        let subscriber = subscriber
            .callback_mut(move |sample| handle(&ReceivedMessage(&sample)))
            .advanced()
            .history(HistoryConfig::default().detect_late_publishers().max_samples(kept))
            .recovery(RecoveryConfig::default().heartbeat())
            .query_timeout(KEPT_TIMEOUT)
            .subscriber_detection()
            .wait()?;
        Ok(Subscription { _declared: Declared::Kept(subscriber) })
    }

    /// Answers questions to a key. They are taken on zenoh's own threads, and may be answered at any time.
    ///
    /// # Errors
    /// When zenoh refuses.
    pub fn take_questions(
        &self,
        key: String,
        mut take: impl FnMut(Question) + Send + Sync + 'static,
    ) -> Result<Subscription, SessionError> {
        let queryable = self.0.declare_queryable(key).complete(true);
        let queryable = queryable.callback_mut(move |query| take(Question(query))).wait()?;
        Ok(Subscription { _declared: Declared::Questions(queryable) })
    }

    /// Announces a key.
    ///
    /// # Errors
    /// When zenoh refuses.
    pub fn announce(&self, key: String) -> Result<Announcement, SessionError> {
        Ok(Announcement { _token: self.0.liveliness().declare_token(key).wait()? })
    }

    /// Subscribes to announcements of keys, also those of before: `note` gets the key and whether it is announced or no more.
    ///
    /// # Errors
    /// When zenoh refuses.
    pub fn subscribe_to_announcements(
        &self,
        key: String,
        mut note: impl FnMut(&str, bool) + Send + Sync + 'static,
    ) -> Result<Subscription, SessionError> {
        let subscriber = self.0.liveliness().declare_subscriber(key).history(true);
        let seen = move |sample: Sample| note(sample.key_expr().as_str(), sample.kind() == SampleKind::Put);
        Ok(Subscription { _declared: Declared::Plain(subscriber.callback_mut(seen).wait()?) })
    }
}
