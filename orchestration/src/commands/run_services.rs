//! What runs beside a single run: its live page, and its control socket.

use super::CommandError;
use crate::supervisor::{ControlSocket, ProcessSet, Reply, Request, SideProcess, known_stage};

/// Services of a live run: its page, and its metrics.
#[derive(Default)]
pub struct RunServices {
    page: Option<SideProcess>,
    control: Option<ControlSocket>,
}

impl RunServices {
    /// Opens the control socket and starts the page.
    pub fn start(set: &ProcessSet) -> Result<Self, CommandError> {
        let control = ControlSocket::open(&set.runtime().control_socket()).map_err(CommandError::failed)?;
        Ok(Self { page: start_page(set)?, control: Some(control) })
    }

    /// Answers, and starts the page again when it has died.
    pub fn look_after(&mut self, set: &mut ProcessSet) {
        self.page.iter_mut().for_each(SideProcess::look_after);
        while let Some(order) = self.control.as_ref().and_then(ControlSocket::next) {
            let reply = match &order.request {
                Request::Status => Reply::Status(Box::new(set.status())),
                Request::Restart(name) => match known_stage(name) {
                    Ok(stage) if set.restart(stage) => Reply::Done,
                    Ok(_) => Reply::Refused(format!("no process of {name} runs just now")),
                    Err(reason) => Reply::Refused(reason),
                },
                Request::Pause(rests) => set.pause(*rests).map_or_else(Reply::Refused, |()| Reply::Done),
                _ => Reply::Refused("this is one run: only a set of `flockslam up` can do that".to_owned()),
            };
            order.answer(reply);
        }
    }
}

/// Starts the page of a set, when it is to have one.
pub fn start_page(set: &ProcessSet) -> Result<Option<SideProcess>, CommandError> {
    let settings = &set.configuration().page;
    // A mistake is reported now, not by a process in the background.
    settings.guard("").map_err(CommandError::user)?;
    let start = || SideProcess::start("page", set.runtime().path(), &[]).map_err(CommandError::failed);
    settings.enabled.then(start).transpose()
}
