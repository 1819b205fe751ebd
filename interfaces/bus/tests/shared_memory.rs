//! The bus over real shared memory. One test function: a process belongs to one set only.

use flockslam_bus::{Bus, BusError, Capacity, RuntimeDir, RuntimeError, Wake};
use flockslam_messages::{PoseEstimate, ScanBuffer, TileMessage};
use std::time::Duration;

#[test]
fn a_set_carries_scans_tiles_and_rings_and_leaves_nothing() {
    let name = format!("bus-test-{}", std::process::id());
    let runtime = RuntimeDir::create(&name).unwrap();
    assert!(matches!(RuntimeDir::create(&name), Err(RuntimeError::Running(_))));
    let capacity = Capacity { window: 8, replicas: 1, live_tiles: 64 };
    let host = Bus::host(&runtime, capacity).unwrap();
    let member = Bus::join(&RuntimeDir::open(runtime.path()).unwrap(), "member", capacity).unwrap();

    let (scans, reader) = (member.scan_publisher().unwrap(), host.scan_subscriber().unwrap());
    for beams in [0, 1, 180, 5000, 70_000, 10_000_000] {
        let scan = ScanBuffer::from_ranges(&vec![2.5; beams], 0.0, 0.01);
        scans.send(scan.view().unwrap()).unwrap();
        let sample = reader.receive().unwrap().expect("the scan has arrived");
        assert_eq!(sample.view().unwrap().len(), beams);
        assert!(sample.view().unwrap().ranges().iter().all(|r| *r == 2.5));
    }
    assert!(reader.receive().unwrap().is_none());

    let (tiles, tile_reader) =
        (member.publisher::<TileMessage>().unwrap(), host.subscriber::<TileMessage>().unwrap());
    tiles.send_with(|tile| tile.tile.score[17] = 9).unwrap();
    let held = tile_reader.receive().unwrap().unwrap();
    drop(tiles);
    assert_eq!(held.tile.score[17], 9, "a held tile outlives its publisher");

    let (listener, ringer) = (host.listener("mapper").unwrap(), member.ringer("mapper").unwrap());
    assert_eq!(listener.wait(Duration::from_millis(1)).unwrap(), Wake::TimedOut);
    ringer.announce();
    assert_eq!(listener.wait(Duration::from_secs(5)).unwrap(), Wake::Announced);
    ringer.ring();
    ringer.announce();
    ringer.ring();
    assert_eq!(listener.wait(Duration::from_secs(5)).unwrap(), Wake::Rung);

    // Overflow: the newest data wins and nobody blocks.
    let (poses, pose_reader) = (member.publisher().unwrap(), host.subscriber::<PoseEstimate>().unwrap());
    for submap in 0..100 {
        poses.send(&PoseEstimate { submap, ..PoseEstimate::default() }).unwrap();
    }
    let mut received = Vec::new();
    while let Some(pose) = pose_reader.receive().unwrap() {
        received.push(pose.submap);
    }
    assert_eq!(received, (84..100).collect::<Vec<_>>());

    assert!(runtime.occupied_bytes() > 40_000_000, "ten million beams lie in shared memory");
    assert!(matches!(host.listener("nobody"), Err(BusError::Open { .. })));
    drop((scans, reader, held, tile_reader, listener, ringer, poses, pose_reader, member, host));
    let path = runtime.path().to_owned();
    drop(runtime);
    assert!(!path.exists());
    let left = std::fs::read_dir("/dev/shm").unwrap().filter_map(|e| e.ok()).map(|e| e.file_name());
    assert_eq!(left.filter(|n| n.to_string_lossy().contains(&name)).count(), 0);
}
