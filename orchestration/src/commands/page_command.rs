//! `flockslam page`: the live page of a running set.

use super::CommandError;
use super::control_command::choose;
use super::stage::die_with;
use crate::arguments::PageArgs;
use crate::supervisor::{Reply, Request, SetFile, ask};
use flockslam_bus::RuntimeDir;
use flockslam_page::{Health, PageError, Place, Service, SetAccess, Settings};
use flockslam_stage::Mode;
use std::path::{Path, PathBuf};

/// The page yields to everything else.
const NICENESS: i32 = 15;

/// Serves the page until the set ends.
///
/// # Errors
/// When there is no such set, or the address is not to be had.
pub fn run(args: &PageArgs) -> Result<(), CommandError> {
    flockslam_telemetry::init_tracing("page");
    let set_dir = match &args.set_dir {
        Some(set_dir) => set_dir.clone(),
        None => RuntimeDir::path_of(&choose(&args.robot)?),
    };
    if args.parent.is_some() {
        if !die_with(args.parent) {
            return Ok(());
        }
        let _ = rustix::process::setpriority_process(None, NICENESS);
    }
    let runtime = RuntimeDir::open(&set_dir).map_err(CommandError::user)?;
    let set = SetFile::read(&runtime.configuration()).map_err(CommandError::failed)?;
    if set.options.mode == Mode::Exact {
        // Asking for tiles would be a message more than the run has without a page.
        return Err(CommandError::user("an exact replay is not watched: run it with --live or --rate"));
    }
    let settings = &set.configuration.page;
    let listen = args.listen.unwrap_or(settings.listen);
    let guard = Settings { listen, ..settings.clone() }.guard(&host_name()).map_err(CommandError::user)?;
    let place = Place {
        set_dir,
        robot: runtime.name().to_owned(),
        version: crate::VERSION.to_owned(),
        capacity: set.options.capacity(),
        optimises: set.configuration.sync_manager.enabled,
        cell_size_m: set.configuration.mapper.cell_size_m,
        can_save: settings.save_dir.is_some(),
    };
    let access = Supervisor {
        robot: runtime.name().to_owned(),
        socket: runtime.control_socket(),
        save_dir: settings.save_dir.clone(),
    };
    let service = Service { listen, guard, waits_for_port: args.parent.is_some() };
    let served = flockslam_page::serve(place, service, Box::new(access), |address| {
        eprintln!("flockslam: live page at http://{address}/");
    });
    served.map_err(|error| match error {
        PageError::Listen(..) => CommandError::user(error),
        PageError::System(_) => CommandError::failed(error),
    })
}

fn host_name() -> String {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname");
    name.map(|name| name.trim().to_owned()).unwrap_or_default()
}

/// The supervisor of a set, asked over its control socket.
struct Supervisor {
    robot: String,
    socket: PathBuf,
    save_dir: Option<PathBuf>,
}

impl Supervisor {
    fn order(&self, request: &Request) -> Result<Reply, String> {
        match ask(&self.socket, request).map_err(|error| error.to_string())? {
            Reply::Refused(reason) => Err(reason),
            reply => Ok(reply),
        }
    }
}

impl SetAccess for Supervisor {
    fn health(&self) -> Result<Health, String> {
        let Reply::Status(status) = self.order(&Request::Status)? else {
            return Err("the set answered something else".to_owned());
        };
        let status = serde_json::to_value(&status).map_err(|error| error.to_string())?;
        serde_json::from_value(status).map_err(|error| error.to_string())
    }

    fn restart(&self, stage: &str) -> Result<(), String> {
        self.order(&Request::Restart(stage.to_owned())).map(drop)
    }

    fn pause(&self, rests: bool) -> Result<(), String> {
        self.order(&Request::Pause(rests)).map(drop)
    }

    fn localize(&self, localizes: bool) -> Result<(), String> {
        self.order(&Request::Localize(localizes)).map(drop)
    }

    fn save(&self) -> Result<String, String> {
        let save_dir = self.save_dir.as_deref().ok_or("no page.save_dir is set")?;
        let directory = free_name(save_dir, &self.robot);
        self.order(&Request::Save(directory.clone()))?;
        Ok(directory.display().to_string())
    }

    fn is_alive(&self) -> bool {
        RuntimeDir::running().contains(&self.robot)
    }
}

/// A name in a directory that nothing has yet.
fn free_name(directory: &Path, robot: &str) -> PathBuf {
    let directory = std::path::absolute(directory).unwrap_or_else(|_| directory.to_owned());
    let name = |number: u32| directory.join(format!("{robot}-{number:03}"));
    (1..).map(name).find(|path| !path.exists()).expect("a directory is finite")
}
