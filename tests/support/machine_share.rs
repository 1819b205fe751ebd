//! Shares of the machine: a test whose sets compute all the time takes half of it, one whose set mostly waits for its next scan a
//! sixth. So many tests run at once, and none starves another. Whichever fits into what is free begins: one that waits for a part is
//! overtaken by smaller ones, one that needs the whole machine by all others. So little of the machine is idle while something ends.

use std::cell::RefCell;
use std::sync::{Condvar, Mutex};

/// The whole machine, in shares.
const WHOLE: u32 = 6;
const HALF: u32 = 3;

/// Those that wait for a part of the same size, in the order of coming: a test that waits for the run of another must not overtake it.
#[derive(Clone, Copy)]
struct Line {
    next: u64,
    served: u64,
}

struct Queue {
    free: u32,
    /// By the size of the part.
    lines: [Line; WHOLE as usize + 1],
}

impl Queue {
    /// Whether it is the turn of who has this ticket for such a part.
    fn serves(&self, shares: u32, ticket: u64) -> bool {
        let mut parts = self.lines[..WHOLE as usize].iter();
        let is_last = shares < WHOLE || parts.all(|line| line.served == line.next);
        self.lines[shares as usize].served == ticket && self.free >= shares && is_last
    }
}

static QUEUE: Mutex<Queue> =
    Mutex::new(Queue { free: WHOLE, lines: [Line { next: 0, served: 0 }; WHOLE as usize + 1] });
static CHANGED: Condvar = Condvar::new();

/// Given back when the test's thread ends.
struct Share(u32);

thread_local! {
    static SHARE: RefCell<Option<Share>> = const { RefCell::new(None) };
}

impl Share {
    fn wait_for(shares: u32) -> Self {
        let mut queue = QUEUE.lock().unwrap();
        let line = shares as usize;
        let ticket = queue.lines[line].next;
        queue.lines[line].next += 1;
        while !queue.serves(shares, ticket) {
            queue = CHANGED.wait(queue).unwrap();
        }
        queue.lines[line].served += 1;
        queue.free -= shares;
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

/// At the start of a test: its set has a few scans a second to handle and mostly waits.
pub fn mostly_waits() {
    take(1);
}

/// At the start of a test: what it measures suffers from whatever runs beside it, or it makes others suffer.
pub fn alone() {
    take(WHOLE);
}

/// What a test takes with its first set, if it has said nothing.
pub fn computes() {
    take(HALF);
}
