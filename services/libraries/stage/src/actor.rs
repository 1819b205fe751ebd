//! The loop of every stage: work while there is work, sleep on the event, refresh ten times a second.

use crate::{StageContext, StageError};
use flockslam_bus::{Listener, Wake, half_made_publishers};
use flockslam_messages::Stage;
use std::num::NonZeroU64;
use std::time::Duration;

/// A stage as its loop sees it.
pub trait Actor {
    /// Handles all that waits and can be handled now; true when anything was done.
    ///
    /// # Errors
    /// When the stage cannot go on.
    fn advance(&mut self, context: &mut StageContext) -> Result<bool, StageError>;

    /// Called about ten times a second: connect to late readers, repeat what they need to know.
    ///
    /// # Errors
    /// When the stage cannot go on.
    fn refresh(&mut self, context: &mut StageContext) -> Result<(), StageError>;

    /// Whether the stage waits for something, so that a deadline may pass without a notification.
    fn waits(&self) -> bool {
        false
    }

    /// The longest sleep that is allowed at `now_ns` (a deadline, the next paced scan).
    fn wait_max(&self, _now_ns: u64) -> Duration {
        if self.waits() { WAITING } else { REFRESH }
    }

    /// Scans that the stage holds and has not handled yet.
    fn waiting(&self) -> usize {
        0
    }

    /// Called once before the process ends in good order.
    ///
    /// # Errors
    /// When something could not be saved.
    fn close(&mut self, _context: &mut StageContext) -> Result<(), StageError> {
        Ok(())
    }
}

const REFRESH: Duration = Duration::from_millis(100);
const REFRESH_NS: u64 = REFRESH.as_nanos() as u64;
/// A stage that waits for something checks its deadline this often.
const WAITING: Duration = Duration::from_millis(5);
/// Housekeeping waits until the stage has had nothing to do for so long, nanoseconds: right after its work the next stages want the
/// processors for the same scan.
const QUIET_NS: u64 = 2_000_000;
/// After so long without work, nanoseconds …
const RESTING_NS: u64 = 1_000_000_000;
/// … it looks only so often.
const RESTING: Duration = Duration::from_millis(300);
/// A stage waits awake for an announced message, at most so long: going to sleep and waking up takes a processor longer than
/// the matching of a scan.
const AWAKE_NS: u64 = 1_000_000;

/// How long one short sleep of such a wait takes …
const ASIDE: Duration = Duration::from_micros(20);
/// … and its timer slack, nanoseconds: the default of Linux adds 50 µs.
const TIMER_SLACK_NS: NonZeroU64 = NonZeroU64::MIN;

/// Runs a stage until its stop is requested: work while there is work, sleep on the event while there is none.
///
/// # Errors
/// The error that the actor could not recover from.
pub fn run(context: &mut StageContext, actor: &mut dyn Actor, event: &Listener) -> Result<(), StageError> {
    let loops = loops_after(context.stage);
    let (mut refreshed_ns, mut worked_ns, mut poll_until_ns) = (0, 0, 0);
    // Without it waiting takes longer, and nothing else changes.
    let _ = rustix::thread::set_current_timer_slack(Some(TIMER_SLACK_NS));
    context.ready();
    while !context.stop.is_set() {
        let idle = !actor.advance(context)?;
        context.metrics.waiting(actor.waiting());
        if loops.is_some_and(|scans| context.metrics.handled_count() >= scans) {
            loop_once(context);
        }
        let now_ns = context.now_ns();
        if !idle {
            worked_ns = now_ns;
        }
        let until_quiet = Duration::from_nanos((worked_ns + QUIET_NS).saturating_sub(now_ns));
        let is_quiet = until_quiet.is_zero();
        let since_refresh_ns = now_ns.saturating_sub(refreshed_ns);
        // A stage that is never quiet is refreshed half as often.
        if since_refresh_ns >= if is_quiet { REFRESH_NS } else { 2 * REFRESH_NS } {
            refreshed_ns = now_ns;
            context.alive();
            if half_made_publishers() > 0 {
                context.report.count("half-made-publishers", half_made_publishers());
            }
            actor.refresh(context)?;
        }
        context.report.write_sometimes(now_ns, is_quiet);
        if !idle {
            poll_until_ns = 0;
            continue;
        }
        if now_ns < poll_until_ns {
            // The process that sends it may wait for this very processor.
            step_aside();
            continue;
        }
        let wait_max = actor.wait_max(now_ns);
        // A stage that has been idle for a while is woken by its event.
        let rests = now_ns.saturating_sub(worked_ns) > RESTING_NS && wait_max >= REFRESH;
        let wait_max = if rests { RESTING } else { wait_max.min(REFRESH) };
        let wait_max = if is_quiet { wait_max } else { wait_max.min(until_quiet) };
        if event.wait(wait_max)? == Wake::Announced {
            poll_until_ns = context.now_ns() + AWAKE_NS;
        }
    }
    actor.close(context)?;
    context.report.write();
    Ok(())
}

/// Leaves the processor to other processes for a moment.
///
/// It does not yield: a yield gives the processor to any thread that waits for it, also one of the lowest priority, up to the
/// next tick of the scheduler, four milliseconds later. A thread that sleeps gets the processor back when it wakes up.
pub fn step_aside() {
    std::thread::sleep(ASIDE);
}

/// The first process of a set that calls this never returns.
fn loop_once(context: &StageContext) {
    if std::fs::File::create_new(context.status_dir.join("endless-loop")).is_ok() {
        loop {
            std::hint::spin_loop();
        }
    }
}

/// A test may want a stage to hang in an endless loop after so many scans.
fn loops_after(stage: Stage) -> Option<u64> {
    let (name, scans) = flockslam_telemetry::failpoint_value("endless-loop")?.split_once('@')?;
    scans.parse().ok().filter(|_| name == stage.name())
}
