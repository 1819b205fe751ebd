//! Shares of the machine: a test whose sets compute all the time takes half of it, one whose set mostly waits for its next scan a
//! sixth. So many tests run at once, and none starves another.

use std::cell::RefCell;
use std::sync::{Condvar, Mutex};

/// The whole machine, in shares.
const WHOLE: u32 = 6;
const HALF: u32 = 3;

/// Who waits is served in the order of coming.
struct Queue {
    free: u32,
    next: u64,
    served: u64,
}

static QUEUE: Mutex<Queue> = Mutex::new(Queue { free: WHOLE, next: 0, served: 0 });
static CHANGED: Condvar = Condvar::new();

/// Given back when the test's thread ends.
struct Share(u32);

thread_local! {
    static SHARE: RefCell<Option<Share>> = const { RefCell::new(None) };
}

impl Share {
    fn wait_for(shares: u32) -> Self {
        let mut queue = QUEUE.lock().unwrap();
        let ticket = queue.next;
        queue.next += 1;
        while queue.served != ticket || queue.free < shares {
            queue = CHANGED.wait(queue).unwrap();
        }
        queue.free -= shares;
        queue.served += 1;
        CHANGED.notify_all();
        Self(shares)
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        if let Ok(mut queue) = QUEUE.lock() {
            queue.free += self.0;
        }
        CHANGED.notify_all();
    }
}

fn take(shares: u32) {
    SHARE.with_borrow_mut(|share| {
        share.get_or_insert_with(|| Share::wait_for(shares));
    });
}

/// At the beginning of a test: its set has a few scans a second to handle and mostly waits.
pub fn mostly_waits() {
    take(1);
}

/// At the beginning of a test: what it measures suffers from whatever runs beside it, or it makes others suffer.
pub fn alone() {
    take(WHOLE);
}

/// What a test takes with its first set, if it has said nothing.
pub fn computes() {
    take(HALF);
}
