//! The thread that reads the bus while a browser shows the page. It leaves the bus some time after the last browser has disconnected.

use crate::session::Session;
use crate::shared_view::{Place, Shared};
use std::thread;
use std::time::{Duration, Instant};

/// Time between two frames.
const PERIOD: Duration = Duration::from_millis(100);
/// Period of the check for a browser while there is none.
const PERIOD_IDLE: Duration = Duration::from_millis(200);
/// The bus is left so long after the last browser has gone: it may have been reloaded.
const LINGER: Duration = Duration::from_secs(20);
/// After an error the bus is joined again after this.
const PAUSE: Duration = Duration::from_secs(1);

/// Watches the bus while a browser shows the page, until the set ends.
pub fn watch_bus(place: &Place, shared: &Shared) {
    let mut session: Option<Session> = None;
    let mut last_seen = Instant::now();
    while !shared.has_ended() {
        let began = Instant::now();
        if shared.viewers() > 0 {
            last_seen = began;
        }
        if shared.viewers() == 0 && last_seen.elapsed() > LINGER {
            session = None;
            thread::sleep(PERIOD_IDLE);
            continue;
        }
        if shared.viewers() > 0 || session.is_some() {
            session = look(session, place, shared);
        }
        shared.tick();
        let period = if session.is_some() { PERIOD } else { PERIOD_IDLE };
        thread::sleep(period.saturating_sub(began.elapsed()));
    }
}

fn look(session: Option<Session>, place: &Place, shared: &Shared) -> Option<Session> {
    let opened = match session {
        Some(session) => Ok(session),
        None => {
            shared.view().begin_anew();
            Session::open(place)
        }
    };
    match opened.and_then(|mut session| session.tick(shared).map(|()| session)) {
        Ok(session) => Some(session),
        Err(error) => {
            tracing::warn!(%error, "the page cannot read the bus");
            thread::sleep(PAUSE);
            None
        }
    }
}
