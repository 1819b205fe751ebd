//! The in-memory twin: topics between threads of one process, over crossbeam channels.

use crate::BusError;
use crate::event::{Listener, Notifier, NotifyPort, WaitPort, Wake};
use crate::transport::{Held, Lender, Source, TopicSpec, Transport};
use crate::word_rows::Words;
use crossbeam::channel::{self, Receiver, Sender};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// A message that all subscribers share.
type Message = Arc<Box<Words>>;

/// All topics and events of one in-memory set, each created at first use.
#[derive(Clone, Default)]
pub struct MemoryBus {
    topics: Arc<Mutex<BTreeMap<String, MemoryTopic>>>,
    notifiers: Arc<Mutex<BTreeMap<String, MemoryEvent>>>,
}

impl MemoryBus {
    fn topic(&self, name: &str) -> MemoryTopic {
        let mut topics = self.topics.lock().expect("no thread panics while it holds the topics");
        topics.entry(name.to_owned()).or_default().clone()
    }

    fn event(&self, name: &str) -> MemoryEvent {
        let mut notifiers = self.notifiers.lock().expect("no thread panics while it holds the events");
        notifiers.entry(name.to_owned()).or_default().clone()
    }
}

impl Transport for MemoryBus {
    fn lender(&self, topic: &TopicSpec) -> Result<Box<dyn Lender>, BusError> {
        Ok(Box::new(self.topic(topic.name)))
    }

    fn source(&self, topic: &TopicSpec) -> Result<Box<dyn Source>, BusError> {
        Ok(Box::new(self.topic(topic.name).subscribe()))
    }

    fn listener(&self, name: &str) -> Result<Listener, BusError> {
        Ok(Listener::new(Box::new(self.event(name).listen())))
    }

    fn notifier(&self, name: &str) -> Result<Notifier, BusError> {
        Ok(Notifier::new(Box::new(self.event(name))))
    }

    fn for_another_thread(&self) -> Option<Box<dyn Transport + Send>> {
        Some(Box::new(self.clone()))
    }
}

/// One topic: every subscriber has a channel of its own.
#[derive(Clone, Default)]
struct MemoryTopic {
    subscribers: Arc<Mutex<Vec<Sender<Message>>>>,
}

impl MemoryTopic {
    /// A new subscriber: it receives messages that are sent from now on.
    fn subscribe(&self) -> Receiver<Message> {
        let (sender, receiver) = channel::unbounded();
        self.subscribers.lock().expect("no thread panics while it holds a topic").push(sender);
        receiver
    }
}

impl Lender for MemoryTopic {
    fn send(&self, words: usize, fill: &mut dyn FnMut(&mut Words)) -> Result<(), BusError> {
        let mut message = vec![0; words].into_boxed_slice();
        fill(&mut message);
        let message = Arc::new(message);
        let mut subscribers = self.subscribers.lock().expect("no thread panics while it holds a topic");
        subscribers.retain(|subscriber| subscriber.send(Arc::clone(&message)).is_ok());
        Ok(())
    }
}

impl Source for Receiver<Message> {
    fn receive(&self) -> Result<Option<Held>, BusError> {
        Ok(self.try_recv().ok().map(Held::Memory))
    }
}

/// An event between threads.
#[derive(Clone, Default)]
struct MemoryEvent {
    listeners: Arc<Mutex<Vec<Sender<()>>>>,
}

impl MemoryEvent {
    /// A new listener.
    fn listen(&self) -> Receiver<()> {
        let (sender, receiver) = channel::bounded(1);
        self.listeners.lock().expect("no thread panics while it holds an event").push(sender);
        receiver
    }
}

impl WaitPort for Receiver<()> {
    fn wait(&self, limit: Duration) -> Result<Wake, BusError> {
        Ok(if self.recv_timeout(limit).is_ok() { Wake::Notified } else { Wake::TimedOut })
    }
}

impl NotifyPort for MemoryEvent {
    /// Wakes every listener; notifications coalesce.
    fn notify(&self) {
        for listener in self.listeners.lock().expect("no thread panics while it holds an event").iter() {
            let _ = listener.try_send(());
        }
    }

    fn announce(&self) {
        self.notify();
    }
}
