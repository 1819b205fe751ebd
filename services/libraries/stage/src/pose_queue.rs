//! Poses that wait for their scans, in order and without duplicates.

use crate::StageError;
use flockslam_bus::Subscriber;
use flockslam_messages::PoseEstimate;
use std::collections::VecDeque;

/// Poses in the order of their scans, each once.
pub struct PoseQueue {
    subscriber: Subscriber<PoseEstimate>,
    waiting: VecDeque<PoseEstimate>,
    next: u64,
}

impl PoseQueue {
    /// Poses with a sequence below `next` are duplicates.
    pub fn new(subscriber: Subscriber<PoseEstimate>, next: u64) -> Self {
        Self { subscriber, waiting: VecDeque::with_capacity(256), next }
    }

    /// Takes in what has arrived.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn drain(&mut self) -> Result<(), StageError> {
        while let Some(pose) = self.subscriber.receive()? {
            if pose.id.sequence >= self.next {
                self.next = pose.id.sequence + 1;
                self.waiting.push_back(*pose);
            }
        }
        Ok(())
    }

    /// The oldest pose that waits.
    pub fn front(&self) -> Option<&PoseEstimate> {
        self.waiting.front()
    }

    /// Takes the oldest pose.
    pub fn pop(&mut self) -> Option<PoseEstimate> {
        self.waiting.pop_front()
    }
}
