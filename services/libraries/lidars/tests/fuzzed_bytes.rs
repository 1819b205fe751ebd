//! Ten million bytes for each family: garbage, damaged packets and good ones in turns. No decoder panics, and each finds every good
//! packet behind garbage.

#![allow(clippy::disallowed_methods, reason = "no result depends on it")]

use flockslam_lidars::encoders::ld06_encoder::Ld06Encoder;
use flockslam_lidars::encoders::rplidar_encoder::RplidarEncoder;
use flockslam_lidars::encoders::sick_tim_encoder::SickTimEncoder;
use flockslam_lidars::encoders::urg_encoder::UrgEncoder;
use flockslam_lidars::encoders::ydlidar_encoder::YdlidarEncoder;
use flockslam_lidars::{Act, Driver, Family};
use flockslam_random::Random;

const BYTES: usize = 10_000_000;
/// A packet whose start is in the garbage may still be waited for.
const PENDING_MAX: u64 = 1;

fn world(angle_rad: f64) -> f64 {
    3.0 + 2.0 * angle_rad.sin()
}

/// Lets a lidar answer until its driver has no further request.
fn start(driver: &mut dyn Driver, answer: impl Fn(&[u8]) -> Vec<u8>) {
    for step in 0..1000 {
        while let Some(act) = driver.act(step * 10_000_000) {
            if let Act::Send(request) = act {
                driver.take(&answer(&request), step * 10_000_000, &mut |_| ());
            }
        }
    }
}

/// Feeds a driver with garbage, damaged packets and whole turns of good ones.
fn feed(name: &str, driver: &mut dyn Driver, packets: &mut dyn FnMut() -> Vec<Vec<u8>>) {
    let mut random = Random::new(21, name);
    let (mut fed, mut turns) = (0, 0u64);
    while fed < BYTES {
        let mut stream = Vec::new();
        match random.below(3) {
            0 => stream.extend((0..random.below(4000)).map(|_| random.next_u64() as u8)),
            1 => {
                // Parts of packets, with changed bytes: what looks most like one.
                for packet in packets() {
                    let mut packet = packet[..1 + random.below(packet.len())].to_vec();
                    let at = random.below(packet.len());
                    packet[at] ^= 1 << random.below(8);
                    stream.extend(packet);
                }
            }
            _ => stream.extend(vec![[0x54, 0xAA, 0xA5, b'M', 2][random.below(5)]; random.below(300)]),
        }
        // Turns of good packets behind it: more than any packet is long.
        let good: Vec<_> = (0..3).flat_map(|_| packets()).collect();
        driver.take(&stream, fed as i64, &mut |_| turns += 1);
        let before = driver.counts().packets;
        let good_bytes = good.concat();
        let chunk = 1 + random.below(700);
        for bytes in good_bytes.chunks(chunk) {
            driver.take(bytes, fed as i64, &mut |turn| {
                assert!(
                    turn.ranges_m.iter().chain(&turn.angles_rad).chain(&turn.times_s).all(|v| v.is_finite())
                );
                turns += 1;
            });
        }
        let found = driver.counts().packets - before;
        assert!(found + PENDING_MAX >= good.len() as u64, "{name}: {found} of {}", good.len());
        fed += stream.len() + good_bytes.len();
    }
    assert!(turns > 100, "{name}: only {turns} turns");
    println!("{name}: {fed} bytes, {turns} turns, {:?}", driver.counts());
}

#[test]
fn ld06_survives_and_finds_every_packet_again() {
    let mut encoder = Ld06Encoder::new(10.0);
    feed("ld06", &mut *Family::Ld06.driver(None, None), &mut || encoder.turn(&world));
}

#[test]
fn rplidar_survives_and_finds_every_packet_again_in_each_form() {
    for answer_type in 0x81..=0x86 {
        let mut encoder = RplidarEncoder::new(answer_type, 10.0);
        let mut driver = Family::Rplidar.driver(None, None);
        start(&mut *driver, |request| encoder.answer(request));
        feed(&format!("rplidar {answer_type:#x}"), &mut *driver, &mut || encoder.turn(&world));
    }
}

#[test]
fn ydlidar_survives_and_finds_every_packet_again() {
    for (model, point_length) in [("X4", 2), ("T-mini Plus", 3)] {
        let mut encoder = YdlidarEncoder::new(model, point_length, 8.0);
        feed(model, &mut *Family::Ydlidar.driver(Some(model), None), &mut || encoder.turn(&world));
    }
}

#[test]
fn urg_survives_and_finds_every_block_again() {
    let mut encoder = UrgEncoder::new();
    let mut driver = Family::Urg.driver(None, None);
    start(&mut *driver, |request| encoder.answer(request));
    feed("urg", &mut *driver, &mut || encoder.turn(&world));
}

#[test]
fn sick_tim_survives_and_finds_every_telegram_again() {
    let mut encoder = SickTimEncoder::new();
    feed("sick-tim", &mut *Family::SickTim.driver(None, None), &mut || encoder.turn(&world));
}
