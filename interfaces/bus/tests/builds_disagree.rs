//! Two builds with different layouts of one message refuse each other. A test of its own: a process belongs to one
//! set only.

use flockslam_bus::{Bus, BusError, Capacity, RuntimeDir, Topic};
use flockslam_messages::{Layout, Message, Progress};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

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

fn refusal<T: Topic>(bus: &Bus) -> String {
    let refused =
        [bus.subscriber::<T>().err(), bus.publisher::<T>().err()].map(|error| error.expect("it is refused"));
    assert!(refused.iter().all(|error| matches!(error, BusError::Disagree { .. })), "{refused:?}");
    refused[0].to_string()
}

#[test]
fn another_layout_or_version_is_refused_with_what_to_do() {
    let runtime = RuntimeDir::create(&format!("disagree-{}", std::process::id())).unwrap();
    let capacity = Capacity { window: 4, replicas: 1, live_tiles: 16 };
    let host = Bus::host(&runtime, capacity).unwrap();
    let member = Bus::join(&RuntimeDir::open(runtime.path()).unwrap(), "other-build", capacity).unwrap();
    let told = refusal::<OtherProgress>(&member);
    println!("{told}");
    assert!(told.starts_with("topic progress was created by another build of flockslam"), "{told}");
    assert!(
        told.contains(&format!("{:016x}", OtherProgress::HASH)) && told.contains("flockslam/progress/v1")
    );
    assert!(told.contains("start all of its processes from one executable"), "{told}");
    let told = refusal::<LaterProgress>(&member);
    println!("{told}");
    assert!(told.contains("flockslam/progress/v2"), "{told}");
    // Who has the same layout is not disturbed by that.
    let (publisher, subscriber) = (member.publisher().unwrap(), host.subscriber::<Progress>().unwrap());
    publisher.send(&Progress { stage: 1, replica: 0, done: 7 }).unwrap();
    assert_eq!(subscriber.receive().unwrap().unwrap().done, 7);
}
