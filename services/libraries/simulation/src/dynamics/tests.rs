//! Tests of simulated people, doors and pallets, and of the labels of beams that end on them.

use crate::{BeamLabel, Errors, MoverTruth, Settings, Simulation, World};
use flockslam_geometry::{Point, Pose};
use flockslam_messages::ScanBuffer;

/// An office in which everything happens.
fn with_movers() -> Settings {
    Settings { duration_s: 120.0, walkers: 8, follower: true, doors: 4, pallets: 4, ..Settings::default() }
}

struct Seen {
    scan: ScanBuffer,
    labels: Vec<BeamLabel>,
    movers: Vec<MoverTruth>,
    truth: Pose,
}

/// By a lidar without errors.
fn drive(settings: &Settings) -> Vec<Seen> {
    let (world, errors) = (World::floor_plan(), Errors::without_lidar());
    let mut simulation = Simulation::with_errors(settings, world, &errors).unwrap();
    let (mut scan, mut all) = (ScanBuffer::default(), Vec::new());
    while let Some(truth) = simulation.next_scan(&mut scan) {
        let labels = simulation.labels().to_vec();
        let movers = simulation.movers().collect();
        all.push(Seen { scan: scan.clone(), labels, movers, truth });
    }
    all
}

#[test]
fn beams_on_the_world_and_on_people_are_labelled_so_and_those_without_return_too() {
    let seen = drive(&with_movers());
    let World::FloorPlan(plan) = World::floor_plan() else { unreachable!() };
    let mut counts = [0u32; 4];
    for pair in seen.windows(2) {
        let view = pair[0].scan.view().unwrap();
        let motion = flockslam_geometry::Twist::from_motion(pair[0].truth.to(pair[1].truth), 0.1);
        for (beam, label) in pair[0].labels.iter().enumerate() {
            counts[*label as usize] += 1;
            let Some(range_m) = view.valid_range_m(beam) else {
                assert_eq!(*label, BeamLabel::NoReturn);
                continue;
            };
            let seconds = view.time_s(beam);
            let laser = pair[0].truth * motion.motion_after(seconds) * view.header().base_from_laser;
            let (sin, cos) = view.angle_rad(beam).sin_cos();
            let end = laser.apply(Point::new(range_m * cos, range_m * sin));
            let off_m = match label {
                BeamLabel::Static => plan.distance_m(end),
                BeamLabel::MotionState => off_bodies_m(&pair[0].movers, seconds, end),
                // Poses of doors and pallets are not part of the truth.
                BeamLabel::Changed => 0.0,
                BeamLabel::NoReturn => f64::INFINITY,
            };
            // The mean motion of a scan is not quite that of each of its beams.
            assert!(off_m < 0.06, "{label:?}: {off_m}");
        }
    }
    assert!(counts[1..].iter().all(|count| *count > 1000), "{counts:?}");
}

fn off_bodies_m(movers: &[MoverTruth], seconds: f64, end: Point) -> f64 {
    let off = |mover: &MoverTruth| {
        let center = Point::new(
            mover.center.x_m + seconds * mover.velocity_m_s.x_m,
            mover.center.y_m + seconds * mover.velocity_m_s.y_m,
        );
        (center.distance_m(end) - mover.radius_m).abs()
    };
    movers.iter().map(off).fold(f64::INFINITY, f64::min)
}

#[test]
fn people_walk_at_speeds_of_their_own_and_make_way_for_the_robot() {
    let seen = drive(&with_movers());
    assert!(seen.iter().all(|seen| seen.movers.len() == 9));
    let speeds = |id: usize| seen.iter().map(move |seen| seen.movers[id].velocity_m_s.norm_m());
    // Half of the time that somebody walks, which is most of it, they walk at a speed of their own.
    let mut usual: Vec<f64> = (0..8)
        .map(|id| {
            let mut walking: Vec<f64> = speeds(id).filter(|speed| *speed > 0.1).collect();
            assert!(walking.len() > 300, "{id} walked in {} scans", walking.len());
            walking.sort_by(f64::total_cmp);
            assert!(walking[walking.len() - 1] < 1.8 + 1e-9);
            walking[walking.len() / 2]
        })
        .collect();
    usual.sort_by(f64::total_cmp);
    assert!(usual[7] > usual[0] + 0.4, "{usual:?}");
    let gaps =
        seen.iter().flat_map(|seen| seen.movers.iter().map(|at| at.center.distance_m(seen.truth.position())));
    let nearest_m = gaps.fold(f64::INFINITY, f64::min);
    assert!(nearest_m > 0.35, "somebody was run into: {nearest_m} m");
    let behind = &seen[seen.len() / 2..];
    assert!(behind.iter().all(|seen| seen.movers[8].center.distance_m(seen.truth.position()) < 1.3));
}

#[test]
fn doors_and_pallets_come_and_go() {
    for settings in [Settings { doors: 4, ..still() }, Settings { pallets: 6, ..still() }] {
        let seen = drive(&settings);
        let shares: Vec<usize> = seen
            .chunks(100)
            .map(|part| {
                part.iter().flat_map(|seen| &seen.labels).filter(|l| **l == BeamLabel::Changed).count()
            })
            .collect();
        let (least, most) = (shares.iter().min().unwrap(), shares.iter().max().unwrap());
        assert!(*most > 200 && *least < most / 2, "{shares:?}");
    }
}

/// No person walks.
fn still() -> Settings {
    Settings { walkers: 0, follower: false, doors: 0, pallets: 0, ..with_movers() }
}

#[test]
fn pedestrians_occlude_the_world_and_change_nothing_else() {
    let (alone, with_movers) = (drive(&still()), drive(&with_movers()));
    for (alone, with_movers) in alone.iter().zip(&with_movers) {
        assert_eq!(alone.truth, with_movers.truth);
        for (beam, label) in with_movers.labels.iter().enumerate() {
            let (free, seen) = (alone.scan.numbers[beam], with_movers.scan.numbers[beam]);
            match label {
                BeamLabel::Static => assert_eq!(free, seen),
                BeamLabel::MotionState | BeamLabel::Changed => assert!(seen < free),
                BeamLabel::NoReturn => assert!(!seen.is_finite()),
            }
        }
    }
}
