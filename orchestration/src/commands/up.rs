//! `flockslam up`: a process set that runs until it is stopped.

use super::CommandError;
use super::localisation_map;
use super::mode_order::ModeChange;
use super::run::{Finished, count_interrupts, points, prepare_directory, write_outputs};
use super::run_services::start_page;
use crate::arguments::UpArgs;
use crate::configuration::Configuration;
use crate::outputs::write_trajectory;
use crate::ros_bridge::check_arguments;
use crate::state_directory::spill_directory;
use crate::store::{Findings, MapHead, MapSaver, Mirror, SavedMap, StoreError};
use crate::supervisor::{
    ControlSocket, MetricsService, Order, ProcessSet, Reply, Request, ServiceManager, SetDescription,
    SetError, SetEvent, SetFile, SideProcess, is_of_graph, known_stage,
};
use flockslam_bus::RuntimeDir;
use flockslam_results::SetMode;
use flockslam_stage::{MemoryUse, Mode};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// The supervisor checks its processes at least this often; the end of one wakes it at once.
const LOOK: Duration = Duration::from_millis(50);
/// At the end the disk is waited for no longer than this: all in all it shall take less than 2 s.
const LAST_SAVE_LIMIT: Duration = Duration::from_millis(1200);

/// Runs the command: until SIGTERM, `flockslam down`, or the end of the source.
///
/// # Errors
/// When the description or the map is not usable, or the set cannot be kept running.
pub fn run(args: &UpArgs) -> Result<(), CommandError> {
    flockslam_telemetry::init_tracing("supervisor");
    let interrupts = count_interrupts()?;
    let description = SetDescription::read(&args.set)?;
    args.out.as_deref().map(prepare_directory).transpose()?;
    let started = Instant::now();
    let mut live = LiveSet::start(args, &description)?;
    let control = ControlSocket::open(&live.set.runtime().control_socket()).map_err(CommandError::failed)?;
    let _metrics = MetricsService::start(&live.set, description.metrics_port).map_err(CommandError::user)?;
    let has_ended = live.attend(&control, &interrupts)?;
    live.stop_and_save();
    match &args.out {
        Some(out) if has_ended => {
            let finished = Finished {
                set: &live.set,
                started,
                shared_memory_bytes: live.set.runtime().occupied_bytes(),
                own_memory: MemoryUse::of_this_process(),
                source: args.set.display().to_string(),
                configuration: live.set.configuration().clone(),
            };
            let truth = write_outputs(out, &finished)?.truth;
            // A simulation knows it.
            truth.map_or(Ok(()), |truth| {
                write_trajectory(&out.join("truth.tum"), &points(&truth)).map_err(CommandError::failed)
            })
        }
        _ => Ok(()),
    }
}

/// A set, what runs beside it, and the saver of its map.
struct LiveSet {
    page: Option<SideProcess>,
    ros: Option<SideProcess>,
    set: ProcessSet,
    saver: Option<MapSaver>,
    mode: ModeChange,
    head: MapHead,
}

impl LiveSet {
    fn start(args: &UpArgs, description: &SetDescription) -> Result<Self, CommandError> {
        let mut configuration = description.configuration(&args.assignments)?;
        let mut ros_arguments = ros_arguments(args, description)?;
        let head = MapHead::of_this_build(&description.robot, configuration.mapper.cell_size_m);
        let known = args.localize.as_ref().or(description.localize.as_ref());
        let known_map = match known {
            Some(path) if is_of_graph(path) => {
                let arguments = ros_arguments.as_mut().ok_or_else(no_graph)?;
                arguments.extend(["-p", "use_map_topic:=true"].map(str::to_owned));
                Some(localisation_map::awaited())
            }
            known => known.map(|path| localisation_map::read(path)).transpose()?,
        };
        let map = args.map.as_ref().or(description.map.as_ref()).map(|directory| SavedMap::at(directory));
        if let (Some(_), Some(kept)) = (&known, &map) {
            let kept = kept.directory().display();
            return Err(CommandError::user(format!("a set that localizes makes no map to keep in {kept}")));
        }
        let beside = map.as_ref().map(SavedMap::directory);
        let spill_dir = spill_directory(configuration.set.spill_dir.as_deref(), beside);
        let (runtime, taken_over) = RuntimeDir::create_or_take_over(&description.robot, spill_dir.as_deref())
            .map_err(CommandError::user)?;
        if let (Some(map), "") = (&map, &*configuration.sync_manager.flock.key_file.to_string_lossy()) {
            // Whose records go with the map stays who it is.
            configuration.sync_manager.flock.key_file = map.directory().join("flock.key");
        }
        let taken_over = taken_over && localisation_map::fits_killed_set(&runtime, known_map.as_ref())?;
        let extendable = known.map(|path| localisation_map::extendable(path, &head));
        let begins_with = map.as_ref().or(extendable.as_ref().and_then(|saved| saved.as_ref().ok()));
        let first_sequence = match begins_with {
            _ if taken_over => first_of_killed_set(&runtime, &configuration)?,
            Some(saved) if saved.exists() => {
                let findings = restore(saved, &runtime, &head).map_err(CommandError::user)?;
                if map.is_some() {
                    saved.set_damage_aside(&findings).map_err(CommandError::failed)?;
                }
                findings.next_sequence
            }
            _ => 0,
        };
        let mut options = configuration.stage_options(Mode::Live);
        options.first_sequence = first_sequence;
        let begun = SetMode {
            localizes: known_map.is_some(),
            fixed: extendable.and_then(Result::err),
            given: known_map.is_some(),
            changed: false,
        };
        let left = SetMode::read(&runtime.results()).filter(|_| taken_over);
        if let Some(map) = known_map.as_ref().filter(|_| !taken_over) {
            localisation_map::put(map, &runtime)?;
        }
        let mode = left.unwrap_or(begun);
        mode.write(&runtime.results()).map_err(CommandError::failed)?;
        options.localizes = mode.localizes;
        let task = description.source();
        let file = SetFile {
            version: crate::VERSION.to_owned(),
            options,
            source: task.source,
            rate: task.rate,
            world: task.world,
            configuration,
        };
        flockslam_telemetry::log_into_set(runtime.path());
        let mut set = ProcessSet::start(runtime, file, description.supervision())?;
        // From here on only an end in good order removes what the set knows.
        set.wipe_at_end(false);
        let saver = map.map(|map| keep(map, &set, &head, description.save_every_s)).transpose()?;
        let page = start_page(&set)?;
        let ros = ros_arguments.map(|arguments| SideProcess::start("ros", set.runtime().path(), &arguments));
        let ros = ros.transpose().map_err(CommandError::failed)?;
        Ok(Self { page, ros, set, saver, mode: ModeChange::default(), head })
    }

    /// Watches over the set until it shall stop; true when its source has ended and its results are stored.
    fn attend(&mut self, control: &ControlSocket, interrupts: &AtomicUsize) -> Result<bool, CommandError> {
        let mut manager = ServiceManager::from_environment();
        manager.ready();
        loop {
            if self.set.watch(LOOK)? == SetEvent::Finished {
                return Ok(true);
            }
            manager.alive();
            self.mode.advance(&mut self.set, self.saver.as_ref());
            self.page.iter_mut().chain(&mut self.ros).for_each(SideProcess::look_after);
            let unsaved = self.saver.as_ref().is_some_and(|saver| saver.status().problem.is_some());
            self.set.metrics().set_not_durable(unsaved || self.set.not_durable().is_some());
            let mut ends = interrupts.load(Ordering::Relaxed) > 0;
            while let Some(order) = control.next() {
                ends |= order.request == Request::Down;
                self.obey(order);
            }
            if ends {
                manager.stopping();
                return Ok(false);
            }
        }
    }

    fn obey(&mut self, order: Order) {
        let outcome = match order.request.clone() {
            Request::Status => {
                let mut status = self.set.status();
                status.saved = self.saver.as_ref().map(MapSaver::status);
                self.mode.report(&mut status.mode);
                return order.answer(Reply::Status(Box::new(status)));
            }
            Request::Down => Ok(()),
            Request::Restart(name) => known_stage(&name).and_then(|stage| {
                let any = self.set.restart(stage);
                any.then_some(()).ok_or_else(|| format!("no process of {name} runs just now"))
            }),
            Request::Scale(name, replicas) => {
                known_stage(&name).and_then(|stage| self.set.scale(stage, replicas))
            }
            Request::Pause(rests) => self.set.pause(rests),
            Request::Log(stage, filter) => self.set.log(&stage, &filter),
            Request::Save(directory) => return self.save_copy(&directory, order),
            Request::Load(directory) => self.load(&directory),
            Request::Reset => self.reset(),
            Request::Relocalize(near) => self.set.relocalize(near),
            Request::Localize(true) => {
                self.mode.localize(&self.set, |map| mirror(&self.set, map, &self.head))
            }
            Request::Localize(false) => self.mode.map(&mut self.set),
        };
        order.answer(outcome.map_or_else(Reply::Refused, |()| Reply::Done));
    }

    /// Saves into a directory of the user's choice; the set is not held up meanwhile.
    fn save_copy(&self, directory: &Path, order: Order) {
        let mut mirror = mirror(&self.set, SavedMap::at(directory), &self.head);
        std::thread::spawn(move || {
            let saved = mirror.bring_up();
            order.answer(saved.map_or_else(|error| Reply::Refused(error.to_string()), |()| Reply::Done));
        });
    }

    /// The map of a set that keeps it on disk is not given up for another one.
    fn refuse_kept(&self) -> Result<(), String> {
        self.saver.as_ref().map_or(Ok(()), |saver| {
            let own = saver.status().directory;
            Err(format!("this set keeps its map in {own}: stop it and start it with another --map"))
        })
    }

    /// Drops the map and begins a new one.
    fn reset(&mut self) -> Result<(), String> {
        self.refuse_kept()?;
        if self.set.localizes() {
            return Err(
                "this set localizes in a known map, which stays: relocalize looks for the robot anew"
                    .to_owned(),
            );
        }
        let reset: Result<(), CommandError> = self.set.begin_anew(|_| Ok(0));
        self.page.iter_mut().for_each(SideProcess::restart);
        reset.map_err(|error| error.to_string())
    }

    fn load(&mut self, directory: &Path) -> Result<(), String> {
        self.refuse_kept()?;
        if self.set.localizes() {
            return self.localize_in(directory);
        }
        let map = SavedMap::at(directory);
        let head = &self.head;
        // What is refused leaves the set as it is.
        let fits = MapHead::read(directory).and_then(|found| found.fits(directory, head));
        fits.map_err(|error| error.to_string())?;
        let loaded: Result<(), CommandError> = self.set.begin_anew(|runtime| {
            let findings = restore(&map, runtime, head).map_err(CommandError::user)?;
            Ok(findings.next_sequence)
        });
        self.page.iter_mut().for_each(SideProcess::restart);
        loaded.map_err(|error| error.to_string())
    }

    /// Localizes in another map.
    fn localize_in(&mut self, path: &Path) -> Result<(), String> {
        let map = localisation_map::read(path).map_err(|error| error.to_string())?;
        if localisation_map::is_known(self.set.runtime(), &map) {
            return Ok(());
        }
        let (saved, head) = (localisation_map::extendable(path, &self.head), &self.head);
        let begun: Result<(), CommandError> = self.set.begin_anew(|runtime| {
            localisation_map::put(&map, runtime)?;
            let findings = saved.as_ref().ok().map(|saved| restore(saved, runtime, head));
            let findings = findings.transpose().map_err(CommandError::user)?;
            let mode = SetMode {
                localizes: true,
                fixed: saved.as_ref().err().cloned(),
                given: true,
                changed: false,
            };
            mode.write(&runtime.results()).map_err(CommandError::failed)?;
            Ok(findings.map_or(0, |findings| findings.next_sequence))
        });
        self.page.iter_mut().for_each(SideProcess::restart);
        begun.map_err(|error| error.to_string())
    }

    fn stop_and_save(&mut self) {
        (self.page, self.ros) = (None, None);
        // Nothing is accepted any more once the stages have ended, so that what is saved then is everything.
        self.set.stop();
        if let Some(saver) = &self.saver
            && !saver.save_now(LAST_SAVE_LIMIT)
        {
            tracing::error!(
                "the map could not be saved at the end: it stays in memory for the next set of this name"
            );
            return;
        }
        self.set.wipe_at_end(true);
    }
}

fn no_graph() -> CommandError {
    CommandError::user(
        "localize = \"ros\" needs the graph that publishes the map: add [ros] to the set, or --ros-args",
    )
}

/// The arguments of the bridge to a ROS graph, when the set has one. A mistake is reported now, not by a process in the background.
fn ros_arguments(args: &UpArgs, description: &SetDescription) -> Result<Option<Vec<String>>, CommandError> {
    let described = description.ros.as_ref().map(|ros| ros.args.clone());
    let given = [described.clone().unwrap_or_default(), args.ros_args.clone()].concat();
    if described.is_none() && args.ros_args.is_empty() {
        return Ok(None);
    }
    check_arguments(&given).map_err(CommandError::user)?;
    Ok(Some([vec!["--ros-args".to_owned()], given].concat()))
}

/// Puts what is good of a saved map into the directory of a set.
fn restore(map: &SavedMap, runtime: &RuntimeDir, head: &MapHead) -> Result<Findings, StoreError> {
    let findings = map.restore(runtime, head)?;
    for problem in &findings.problems {
        tracing::warn!(problem, "the saved map is damaged; what is good of it is used");
    }
    Ok(findings)
}

fn mirror(set: &ProcessSet, map: SavedMap, head: &MapHead) -> Mirror {
    let runtime = set.runtime();
    Mirror::new(&runtime.journal(), &runtime.submaps(), &runtime.results(), map, head.clone())
}

fn keep(map: SavedMap, set: &ProcessSet, head: &MapHead, every_s: f64) -> Result<MapSaver, CommandError> {
    let directory = map.directory().to_owned();
    let period = Duration::from_secs_f64(every_s);
    MapSaver::start(mirror(set, map, head), directory, period).map_err(CommandError::failed)
}

/// Where the session of a killed set began, when this one can go on with it.
fn first_of_killed_set(runtime: &RuntimeDir, present: &Configuration) -> Result<u64, CommandError> {
    let mut left = SetFile::read(&runtime.configuration()).map_err(SetError::from)?;
    // How many processes made it is of no account.
    left.configuration.mapper.replicas = present.mapper.replicas;
    if left.configuration.mapper == present.mapper {
        return Ok(left.options.first_sequence);
    }
    Err(CommandError::user(format!(
        "{}: a killed set left a map made with other settings of [mapper]; start it with those, or remove the directory",
        runtime.path().display()
    )))
}
