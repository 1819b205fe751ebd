//! What a node keeps of the messages that it has published.

use flockslam_ros::messages::OccupancyGrid;
use flockslam_ros::{Environment, Middleware, Node, NodeIdentity, QualityOfService, Reach};
use std::time::{Duration, Instant};

/// The allocator gives memory of this size back as soon as it is free; of smaller maps it keeps free memory between others.
const MAP_MIB: usize = 33;
const MAPS: usize = 16;

fn own_memory_mib() -> usize {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("RssAnon:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<usize>().unwrap() / 1024
}

/// Without a limit RustDDS keeps 8192 messages that nobody has acknowledged: a robot whose map nobody reads would run out of memory.
#[test]
fn maps_that_nobody_reads_are_not_kept() {
    let environment = Environment {
        domain: 211,
        reach: Reach::Localhost,
        middleware: Middleware::FastDds,
        zenoh_file: String::new(),
        zenoh_overrides: String::new(),
        unhonoured: Vec::new(),
    };
    let identity = NodeIdentity { name: "mapper".to_owned(), namespace: "/".to_owned(), remaps: Vec::new() };
    let mut node = Node::open(identity, &environment, Vec::new()).unwrap();
    let maps = node.publisher::<OccupancyGrid>("map", QualityOfService::Latest).unwrap();
    let _node = node.run().unwrap();
    let before_mib = own_memory_mib();
    for _ in 0..MAPS {
        assert!(maps.send(OccupancyGrid { data: vec![7; MAP_MIB << 20], ..OccupancyGrid::default() }));
    }
    // The last five are kept.
    let most_mib = before_mib + MAPS / 2 * MAP_MIB;
    let deadline = Instant::now() + Duration::from_secs(60);
    while own_memory_mib() > most_mib {
        assert!(Instant::now() < deadline, "{} MiB, {before_mib} before", own_memory_mib());
        std::thread::sleep(Duration::from_millis(50));
    }
}
