//! The in-memory twin: topics between threads of one process, over crossbeam channels.

use crossbeam::channel::{self, Receiver, Sender};
use std::any::Any;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

/// All topics and bells of one in-memory set.
#[derive(Clone, Default)]
pub struct MemoryBus {
    topics: Arc<Mutex<BTreeMap<String, Box<dyn Any + Send>>>>,
}

/// One topic: every subscriber has a channel of its own.
pub struct MemoryTopic<P> {
    subscribers: Arc<Mutex<Vec<Sender<Arc<P>>>>>,
}

impl<P> Clone for MemoryTopic<P> {
    fn clone(&self) -> Self {
        Self { subscribers: Arc::clone(&self.subscribers) }
    }
}

impl<P: Send + Sync + 'static> MemoryTopic<P> {
    /// Hands `payload` to every subscriber.
    pub fn send(&self, payload: P) {
        let payload = Arc::new(payload);
        let mut subscribers = self.subscribers.lock().expect("no thread panics while it holds a topic");
        subscribers.retain(|subscriber| subscriber.send(Arc::clone(&payload)).is_ok());
    }

    /// A new subscriber: it sees what is sent from now on.
    pub fn subscribe(&self) -> Receiver<Arc<P>> {
        let (sender, receiver) = channel::unbounded();
        self.subscribers.lock().expect("no thread panics while it holds a topic").push(sender);
        receiver
    }
}

/// A bell between threads.
#[derive(Clone, Default)]
pub struct MemoryBell {
    listeners: Arc<Mutex<Vec<Sender<()>>>>,
}

impl MemoryBell {
    /// Wakes every listener; rings coalesce.
    pub fn ring(&self) {
        for listener in self.listeners.lock().expect("no thread panics while it holds a bell").iter() {
            let _ = listener.try_send(());
        }
    }

    /// A new listener.
    pub fn listen(&self) -> Receiver<()> {
        let (sender, receiver) = channel::bounded(1);
        self.listeners.lock().expect("no thread panics while it holds a bell").push(sender);
        receiver
    }
}

impl MemoryBus {
    /// The topic of this name, created at first use.
    pub fn topic<P: Send + Sync + 'static>(&self, name: &str) -> MemoryTopic<P> {
        self.entry(name, || MemoryTopic { subscribers: Arc::default() })
    }

    /// The bell of this name, created at first use.
    pub fn bell(&self, name: &str) -> MemoryBell {
        self.entry(&format!("bell/{name}"), MemoryBell::default)
    }

    fn entry<E: Clone + Send + 'static>(&self, name: &str, create: impl FnOnce() -> E) -> E {
        let mut topics = self.topics.lock().expect("no thread panics while it holds the directory");
        let entry = topics.entry(name.to_owned()).or_insert_with(|| Box::new(create()));
        entry.downcast_ref::<E>().expect("a name stands for one type").clone()
    }
}
