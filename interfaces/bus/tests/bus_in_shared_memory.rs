//! The bus over real shared memory. One test function: a process belongs to one set only, so all parts use the same set, one
//! after the other.

use flockslam_bus::{Bus, BusError, Capacity, RuntimeDir, RuntimeError, Topic, Wake};
use flockslam_messages::{Layout, Message, PoseEstimate, Progress, ScanBuffer, TileMessage};
use std::time::Duration;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

const CAPACITY: Capacity = Capacity { window: 8, replicas: 1, live_tiles: 64 };

#[test]
fn a_set_carries_scans_tiles_and_notifications_refuses_other_builds_and_leaves_nothing() {
    let name = format!("bus-test-{}", std::process::id());
    let runtime = RuntimeDir::create(&name).unwrap();
    assert!(matches!(RuntimeDir::create(&name), Err(RuntimeError::Running(_))));
    let host = Bus::host(&runtime, CAPACITY).unwrap();
    let member = join(&runtime, "member");

    scans_of_any_number_of_beams_arrive_whole(&runtime, &host, &member);
    readers_that_lag_differently_never_stop_the_publisher_of_scans(&host, &member, 100);
    readers_that_lag_differently_never_stop_the_publisher_of_scans(&host, &member, 70_000);
    a_held_tile_outlives_its_publisher(&host, &member);
    an_event_carries_the_kind_of_its_notification(&host, &member);
    a_full_queue_keeps_the_newest(&host, &member);
    builds_that_disagree_refuse_each_other(&host, &join(&runtime, "other-build"));

    drop((member, host));
    let path = runtime.path().to_owned();
    drop(runtime);
    assert!(!path.exists());
    let left = std::fs::read_dir("/dev/shm").unwrap().filter_map(|e| e.ok()).map(|e| e.file_name());
    assert_eq!(left.filter(|n| n.to_string_lossy().contains(&name)).count(), 0);
}

fn join(runtime: &RuntimeDir, name: &str) -> Bus {
    Bus::join(&RuntimeDir::open(runtime.path()).unwrap(), name, CAPACITY).unwrap()
}

fn scans_of_any_number_of_beams_arrive_whole(runtime: &RuntimeDir, host: &Bus, member: &Bus) {
    let (scans, reader) = (member.scan_publisher().unwrap(), host.scan_subscriber().unwrap());
    for beams in [0, 1, 180, 5000, 70_000, 10_000_000] {
        let scan = ScanBuffer::from_ranges(&vec![2.5; beams], 0.0, 0.01);
        scans.send(scan.view().unwrap()).unwrap();
        let sample = reader.receive().unwrap().expect("the scan has arrived");
        assert_eq!(sample.view().unwrap().len(), beams);
        assert!(sample.view().unwrap().ranges().iter().all(|r| *r == 2.5));
    }
    assert!(reader.receive().unwrap().is_none());
    assert!(runtime.occupied_bytes() > 40_000_000, "ten million beams lie in shared memory");
}

/// Both processes of each stage, and three outside readers, hold as many scans as they may, none the same as another's.
fn readers_that_lag_differently_never_stop_the_publisher_of_scans(host: &Bus, member: &Bus, beams: usize) {
    let (stages, outside) = (6 * 2, 3);
    let scans = member.scan_publisher().unwrap();
    let readers: Vec<_> = (0..stages + outside).map(|_| host.scan_subscriber().unwrap()).collect();
    let scan = ScanBuffer::from_ranges(&vec![2.5; beams], 0.0, 0.01);
    let mut held = Vec::new();
    for reader in &readers {
        // Where a reader may hold no more, `receive` fails.
        loop {
            scans.send(scan.view().unwrap()).unwrap();
            let Ok(sample) = reader.receive() else { break };
            held.push(sample.expect("the scan has arrived"));
        }
    }
    assert!(held.len() >= 3 * readers.len(), "{} scans are held", held.len());
    drop(held);
    scans.send(scan.view().unwrap()).unwrap();
}

fn a_held_tile_outlives_its_publisher(host: &Bus, member: &Bus) {
    let (tiles, reader) =
        (member.publisher::<TileMessage>().unwrap(), host.subscriber::<TileMessage>().unwrap());
    tiles.send_with(|tile| tile.tile.score[17] = 9).unwrap();
    let held = reader.receive().unwrap().unwrap();
    drop(tiles);
    assert_eq!(held.tile.score[17], 9);
}

fn an_event_carries_the_kind_of_its_notification(host: &Bus, member: &Bus) {
    let (listener, notifier) = (host.listener("mapper").unwrap(), member.notifier("mapper").unwrap());
    assert_eq!(listener.wait(Duration::from_millis(1)).unwrap(), Wake::TimedOut);
    notifier.announce();
    assert_eq!(listener.wait(Duration::from_secs(5)).unwrap(), Wake::Announced);
    notifier.notify();
    notifier.announce();
    notifier.notify();
    assert_eq!(listener.wait(Duration::from_secs(5)).unwrap(), Wake::Notified);
    assert!(matches!(host.listener("nobody"), Err(BusError::Open { .. })));
}

/// The newest data wins and no process blocks.
fn a_full_queue_keeps_the_newest(host: &Bus, member: &Bus) {
    let (poses, reader) = (member.publisher().unwrap(), host.subscriber::<PoseEstimate>().unwrap());
    for submap in 0..100 {
        poses.send(&PoseEstimate { submap, ..PoseEstimate::default() }).unwrap();
    }
    let mut received = Vec::new();
    while let Some(pose) = reader.receive().unwrap() {
        received.push(pose.submap);
    }
    assert_eq!(received, (84..100).collect::<Vec<_>>());
}

/// Another layout or version is refused with a message that says what to do.
fn builds_that_disagree_refuse_each_other(host: &Bus, member: &Bus) {
    let text = refusal::<OtherProgress>(member);
    assert!(text.starts_with("topic progress was created by another build of flockslam"), "{text}");
    assert!(
        text.contains(&format!("{:016x}", OtherProgress::HASH)) && text.contains("flockslam/progress/v1"),
        "{text}"
    );
    assert!(text.contains("start all of its processes from one executable"), "{text}");
    let text = refusal::<LaterProgress>(member);
    assert!(text.contains("flockslam/progress/v2"), "{text}");
    // Processes with the same layout are not disturbed.
    let (publisher, subscriber) = (member.publisher().unwrap(), host.subscriber::<Progress>().unwrap());
    publisher.send(&Progress { stage: 1, replica: 0, done: 7 }).unwrap();
    assert_eq!(subscriber.receive().unwrap().unwrap().done, 7);
}

fn refusal<T: Topic>(bus: &Bus) -> String {
    let refused =
        [bus.subscriber::<T>().err(), bus.publisher::<T>().err()].map(|error| error.expect("it is refused"));
    assert!(refused.iter().all(|error| matches!(error, BusError::Disagree { .. })), "{refused:?}");
    refused[0].to_string()
}

/// [`Progress`] as another build has it: two fields have changed places, which neither size nor version tells.
#[repr(C)]
#[derive(Clone, Copy, Debug, FromBytes, IntoBytes, Immutable, KnownLayout)]
struct OtherProgress {
    replica: u32,
    stage: u32,
    done: u64,
}

impl Layout for OtherProgress {
    const HASH: u64 = !Progress::HASH;
}
impl Message for OtherProgress {
    const TYPE_NAME: &'static str = Progress::TYPE_NAME;
}
impl Topic for OtherProgress {
    const NAME: &'static str = Progress::NAME;
}

/// A later version of [`Progress`], with a field more.
#[repr(C)]
#[derive(Clone, Copy, Debug, FromBytes, IntoBytes, Immutable, KnownLayout)]
struct LaterProgress {
    stage: u32,
    replica: u32,
    done: u64,
    ahead: u64,
}

impl Layout for LaterProgress {
    const HASH: u64 = Progress::HASH ^ 1;
}
impl Message for LaterProgress {
    const TYPE_NAME: &'static str = "flockslam/progress/v2";
}
impl Topic for LaterProgress {
    const NAME: &'static str = Progress::NAME;
}
