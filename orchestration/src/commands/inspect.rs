//! `flockslam inspect`: what is in a recording, what would be read of it, and what it lacks.

use super::{CommandError, print};
use crate::arguments::InspectArgs;
use crate::configuration::Configuration;
use flockslam_lidar_ingest::process::{Inspection, LidarSummary, TopicSummary, TransformSummary, inspect};
use std::fmt::Write;

/// More transforms than these are only counted: the whole shall fit on a screen.
const TRANSFORMS_SHOWN: usize = 12;

/// Runs the command.
///
/// # Errors
/// When the recording cannot be opened, or the configuration is not usable.
pub fn run(args: &InspectArgs) -> Result<(), CommandError> {
    let given = &args.configuration;
    let assignments: Vec<String> =
        given.assignments.iter().cloned().chain(args.topics.assignments()).collect();
    let configuration = Configuration::load(given.profile, given.config.as_deref(), &assignments)?;
    let found =
        inspect(&args.recording, &configuration.lidar_ingest, args.learn_mask).map_err(CommandError::user)?;
    if args.json {
        let json = serde_json::to_string_pretty(&found).map_err(CommandError::failed)?;
        print(&format!("{json}\n"));
    } else {
        print(&screen(&found));
    }
    Ok(())
}

/// The whole as text.
fn screen(found: &Inspection) -> String {
    let mut text = String::new();
    let files = if found.files == 1 { String::new() } else { format!(" in {} files", found.files) };
    let megabytes = found.bytes as f64 * 1e-6;
    let _ = writeln!(
        text,
        "{}: {megabytes:.1} MB{files}, {:.1} s from {:.3} on",
        found.name, found.duration_s, found.begins_s
    );
    if let Some(reason) = &found.cut_short {
        let _ = writeln!(text, "{reason}: read up to where it ends");
    }
    topics(&mut text, &found.topics);
    for (number, lidar) in found.lidars.iter().enumerate().filter(|(_, lidar)| lidar.scans > 0) {
        let _ = writeln!(text, "lidar {number}: {}", sentence(lidar));
    }
    let odometry = found.odometry.as_ref().filter(|_| found.odometry_share > 0.0);
    if let Some(source) = odometry {
        let _ = writeln!(text, "odometry: {source}, for {:.1} % of the scans", 100.0 * found.odometry_share);
    }
    if found.gyro_share > 0.0 {
        let _ = writeln!(text, "heading of a gyroscope: for {:.1} % of the scans", 100.0 * found.gyro_share);
    }
    if !found.transforms.is_empty() {
        let one = |link: &TransformSummary| {
            format!("{} → {}{}", link.parent, link.child, if link.is_static { " (static)" } else { "" })
        };
        let shown: Vec<String> = found.transforms.iter().take(TRANSFORMS_SHOWN).map(one).collect();
        let more = found.transforms.len() - shown.len();
        let more = if more > 0 { format!(" and {more} more") } else { String::new() };
        let _ = writeln!(text, "transforms: {}{more}", shown.join(", "));
    }
    for (reason, count) in &found.rejected {
        let _ = writeln!(text, "left out: {count} ({reason})");
    }
    if let Some(boxes) = &found.self_mask {
        let one = |[x, to_x, y, to_y]: &[f64; 4]| format!("[{x:.2}, {to_x:.2}, {y:.2}, {to_y:.2}]");
        let boxes: Vec<String> = boxes.iter().map(one).collect();
        let _ = match boxes.as_slice() {
            [] => writeln!(text, "self_mask: nothing of the robot is seen"),
            boxes => writeln!(text, "self_mask: --set 'lidar_ingest.self_mask=[{}]'", boxes.join(", ")),
        };
    }
    for lack in &found.lacks {
        let _ = writeln!(text, "lacks: {lack}");
    }
    text
}

fn topics(text: &mut String, topics: &[TopicSummary]) {
    let width = |of: fn(&TopicSummary) -> &str| topics.iter().map(|topic| of(topic).len()).max().unwrap_or(0);
    let (names, types) = (width(|topic| &topic.name), width(|topic| &topic.type_name));
    for topic in topics {
        let times = match (topic.rate_hz, topic.longest_gap_s) {
            (Some(rate_hz), Some(gap_s)) => format!("{rate_hz:8.2} Hz, at most {gap_s:6.2} s apart"),
            _ => " ".repeat(34),
        };
        let used = topic.used_as.as_ref().map(|used| format!("  used: {used}")).unwrap_or_default();
        let line =
            format!("  {:names$}  {:types$} {:8} {times}{used}", topic.name, topic.type_name, topic.messages);
        let _ = writeln!(text, "{}", line.trim_end());
    }
}

fn sentence(lidar: &LidarSummary) -> String {
    let LidarSummary { topic, scans, beams: [least, greatest], field_of_view_deg, range_m, returns, .. } =
        lidar;
    let beams = if least == greatest { least.to_string() } else { format!("{least} to {greatest}") };
    let sweep =
        if lidar.sweep_s == 0.0 { String::new() } else { format!(" within {:.0} ms", 1e3 * lidar.sweep_s) };
    let [x_m, y_m, heading_deg] = lidar.base_from_laser;
    let clockwise = if lidar.clockwise { ", angles clockwise" } else { "" };
    format!(
        "{scans} scans of {topic}, {beams} beams over {field_of_view_deg:.1}°{sweep}, {:.2} to {:.1} m, {:.0} % return; at x {x_m:.3} m, \
         y {y_m:.3} m, heading {heading_deg:.1}°{clockwise}",
        range_m[0],
        range_m[1],
        100.0 * returns
    )
}
