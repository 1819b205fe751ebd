//! `flockslam ros`: a running set as a node of a ROS 2 graph.

use super::CommandError;
use super::control_command::choose;
use super::stage::die_with;
use crate::arguments::RosArgs;
use crate::ros_bridge::{BridgeError, BridgeSet, run_bridge};
use crate::supervisor::SetFile;
use crate::time_slice;
use flockslam_bus::RuntimeDir;
use flockslam_lidar_ingest::process::{SCAN_SOCKET, Source};
use flockslam_results::SetMode;
use flockslam_stage::Mode;

/// Transforms are awaited; hostile traffic shall not keep the stages from their work: it yields to them, and to nobody else.
const NICENESS: i32 = -5;

/// Runs the bridge until the set ends.
///
/// # Errors
/// When there is no such set, an argument has no sense, or the graph cannot be joined.
pub fn run(args: &RosArgs) -> Result<(), CommandError> {
    flockslam_telemetry::init_tracing("ros");
    let set_dir = match &args.set_dir {
        Some(set_dir) => set_dir.clone(),
        None => RuntimeDir::path_of(&choose(&args.robot)?),
    };
    if args.parent.is_some() {
        if !die_with(args.parent) {
            return Ok(());
        }
        flockslam_telemetry::log_into_set(&set_dir);
        // Where that is not allowed, it runs like any process.
        let _ = rustix::process::setpriority_process(None, NICENESS);
        let _ = time_slice::set(None, time_slice::SHORT);
    }
    let runtime = RuntimeDir::open(&set_dir).map_err(CommandError::user)?;
    let set = SetFile::read(&runtime.configuration()).map_err(CommandError::failed)?;
    if set.options.mode == Mode::Exact {
        // Asking for tiles would be a message more than the run has without a bridge.
        return Err(CommandError::user(
            "an exact replay is no node of a graph: run it with --live or --rate",
        ));
    }
    let scan_socket = match set.source {
        Source::Scans(Some(path)) => path,
        _ => set_dir.join(SCAN_SOCKET),
    };
    let localizes = set.options.localizes;
    let bridge = BridgeSet {
        // What the graph was offered when the set began stays, whatever mode the set is in when this process starts again.
        is_map_given: SetMode::read(&runtime.results()).map_or(localizes, |mode| mode.given),
        runtime,
        capacity: set.options.capacity(),
        optimises: set.configuration.sync_manager.enabled,
        localizes,
        cell_size_m: set.configuration.mapper.cell_size_m,
        scan_socket,
    };
    run_bridge(&bridge, &args.ros_args).map_err(|error| match error {
        BridgeError::Ros(_) | BridgeError::Parameter { .. } => CommandError::user(error),
        BridgeError::Bus(_) | BridgeError::System(_) => CommandError::failed(error),
    })
}
