//! How soon a thread gets a processor after it wakes: the scheduler lets a thread with a shorter slice preempt one with a longer slice.

use rustix::process::{Pid, getpriority_process};
use std::io::{Error, Result};
use std::time::Duration;

/// The slice of threads that lead from a scan to its pose: well below what the system gives other threads, some milliseconds, and above
/// what a switch costs, some microseconds.
pub const SHORT: Duration = Duration::from_micros(100);

/// Sets the slice of a thread, and of the threads and processes that it starts from then on. `None` is the thread that calls. Zero is what
/// the system gives by default. The thread's niceness stays; its policy is then that of any process (`SCHED_OTHER`).
///
/// # Errors
/// When there is no such thread, or the system refuses. Before Linux 6.12 the slice has no effect.
pub fn set(thread: Option<Pid>, slice: Duration) -> Result<()> {
    let attributes = libc::sched_attr {
        size: size_of::<libc::sched_attr>() as u32,
        sched_policy: libc::SCHED_OTHER as u32,
        sched_flags: 0,
        sched_nice: getpriority_process(thread)?,
        sched_priority: 0,
        sched_runtime: slice.as_nanos() as u64,
        sched_deadline: 0,
        sched_period: 0,
    };
    // SAFETY: the call reads `size` bytes of the attributes, and writes nothing.
    let answer =
        unsafe { libc::syscall(libc::SYS_sched_setattr, Pid::as_raw(thread), &raw const attributes, 0_u32) };
    if answer == 0 { Ok(()) } else { Err(Error::last_os_error()) }
}
