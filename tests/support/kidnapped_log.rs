//! A benchmark log with a kidnapped robot.

use flockslam_geometry::Pose;
use std::fmt::Write;
use std::path::Path;

/// The k-th of eight places at which a log of so many scans is cut: a tenth of them is left out.
pub fn cut_at(k: usize, scans: usize) -> (usize, usize) {
    let left_out = scans / 10;
    let first = (scans * k / 9).min(scans - left_out - 1);
    (first, first + left_out)
}

/// The log without the scans between the first, whose place the second takes, while odometry notices nothing.
pub fn kidnapped(log: &Path, (first, second): (usize, usize)) -> String {
    let text = String::from_utf8_lossy(&std::fs::read(log).unwrap()).into_owned();
    let scans: Vec<&str> = text.lines().filter(|line| line.starts_with("FLASER ")).collect();
    let (before, after) = (odometry(scans[first - 1]), odometry(scans[second]));
    let change = before * after.inverse();
    let mut out = String::new();
    scans[..first].iter().for_each(|line| writeln!(out, "{line}").unwrap());
    for line in &scans[second..] {
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let ranges = 2 + words[1].parse::<usize>().unwrap();
        let at = |i: usize| Pose::new(number(words[i]), number(words[i + 1]), number(words[i + 2]));
        out.push_str(&words[..ranges].join(" "));
        for pose in [change * at(ranges), change * at(ranges + 3)] {
            write!(out, " {:.6} {:.6} {:.6}", pose.x_m, pose.y_m, pose.heading_rad).unwrap();
        }
        writeln!(out, " {}", words[ranges + 6..].join(" ")).unwrap();
    }
    out
}

fn number(word: &str) -> f64 {
    word.parse().unwrap()
}

/// Pose by odometry in a FLASER line.
fn odometry(line: &str) -> Pose {
    let words: Vec<&str> = line.split_ascii_whitespace().collect();
    let place = 5 + words[1].parse::<usize>().unwrap();
    Pose::new(number(words[place]), number(words[place + 1]), number(words[place + 2]))
}
