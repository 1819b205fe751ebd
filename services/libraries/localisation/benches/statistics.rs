//! Prints what searches find at unknown starts.
use flockslam_evidence::CellState;
use flockslam_geometry::Point;
use flockslam_localisation::*;
use flockslam_messages::ScanBuffer;
use flockslam_loop_closure::scans::{ScanStore, Velocity};
use flockslam_registration::cloud::Placement;

fn main() {
    let a: Vec<String> = std::env::args().filter(|a| a != "--bench").collect();
    let yaml = std::fs::read_to_string(&a[1]).unwrap();
    let line = |k: &str| yaml.lines().find_map(|l| l.strip_prefix(k)).unwrap().trim().to_owned();
    let res: f64 = line("resolution:").parse().unwrap();
    let o: Vec<f64> = line("origin:").trim_matches(['[', ']']).split(',').map(|v| v.trim().parse().unwrap()).collect();
    let img = image::open(std::path::Path::new(&a[1]).parent().unwrap().join(line("image:").trim_matches('"'))).unwrap().into_luma8();
    let mut map = KnownMap::of_width(img.width() as usize, res, Point::new(o[0], o[1]));
    for y in (0..img.height()).rev() {
        map.push_row((0..img.width()).map(|x| match img.get_pixel(x, y).0[0] { 254.. => CellState::Free, 0..=90 => CellState::Occupied, _ => CellState::Unknown }));
    }
    let t = std::time::Instant::now();
    let s = Surroundings::new(map.measured());
    eprintln!("map {} m2 loaded {:?}", s.map().known_area_m2(), t.elapsed());
    let log = std::fs::read_to_string(&a[2]).unwrap();
    let traj: Vec<Placement> = std::fs::read_to_string(&a[3]).unwrap().lines().filter(|l| !l.starts_with('#')).map(|l| {
        let v: Vec<f64> = l.split_whitespace().map(|w| w.parse().unwrap()).collect();
        Placement::new(v[1], v[2], 2.0 * v[6].atan2(v[7]))
    }).collect();
    let mut store = ScanStore::default();
    let mut scans = Vec::new();
    for l in log.lines().filter(|l| l.starts_with("FLASER ")) {
        let w: Vec<&str> = l.split_whitespace().collect();
        let n: usize = w[1].parse().unwrap();
        let r: Vec<f32> = w[2..2 + n].iter().map(|w| w.parse().unwrap()).collect();
        let step = 180.0 / if n % 2 == 1 { n - 1 } else { n } as f64;
        let mut scan = ScanBuffer::from_ranges(&r, (-90f64).to_radians(), step.to_radians());
        scan.header.range_max_m = 49.9;
        let v: Vec<f64> = w[2 + n..8 + n].iter().map(|w| w.parse().unwrap()).collect();
        let (lz, rb) = (flockslam_geometry::Pose::new(v[0], v[1], v[2]), flockslam_geometry::Pose::new(v[3], v[4], v[5]));
        scan.header.base_from_laser = rb.to(lz);
        scans.push(store.keep(scan.view().unwrap(), Velocity::default(), &[], false));
    }
    eprintln!("{} scans {} poses", scans.len(), traj.len());
    let half = scans.len() / 2;
    let starts: usize = a[4].parse().unwrap();
    let mut l = Localizer::new(s);
    let (mut found_m, mut falsely, mut never, mut unmapped) = (Vec::new(), 0, 0, 0);
    let (mut slowest, mut errors) = (0f64, Vec::new());
    for k in 0..starts {
        let first = half + (scans.len() - half - 10) * k / starts;
        l.odometry_breaks();
        let at_random = Placement::new(3.0, -7.0, 0.1 * k as f64);
        let mut last: Option<Placement> = None;
        let (mut travel, mut mapped, mut done, mut after) = (0.0, 0.0, false, 0);
        for i in first..scans.len() {
            let p = traj[i];
            if last.is_some_and(|l| l.distance_m(&p) < 0.3 && l.turn_rad(&p) < 0.35) { continue }
            let way = last.map_or(0.0, |l| l.distance_m(&p));
            travel += way;
            if l.surroundings().map().at(p.x_m, p.y_m).state == CellState::Free { mapped += way }
            last = Some(p);
            let t = std::time::Instant::now();
            let b = l.see(at_random.compose(p), store.points(scans[i])).clone();
            slowest = slowest.max(t.elapsed().as_secs_f64());
            if a.len() > 5 && !done {
                println!("{k} {travel:.1} {:?} {}", b.knowledge, b.hypotheses.iter().take(3).map(|h| format!("[{:.2} off {:.2} e {:.2} c {:.2}]", h.weight, h.map_from_base.distance_m(&p), h.agreement.explained, h.agreement.contradicted)).collect::<String>());
            }
            if b.knowledge == Knowledge::Localized {
                let at = b.hypotheses[0].map_from_base;
                let off = at.distance_m(&p);
                if !done {
                    done = true;
                    found_m.push(mapped);
                    if off > 0.5 || at.turn_rad(&p) > 0.15 { falsely += 1; println!("FALSE start {k} scan {i} travel {travel:.1} off {off:.2} {b:?}"); break; }
                } else {
                    errors.push(off);
                    after += 1;
                    if off > 0.5 { falsely += 1; println!("OFF start {k} scan {i} travel {travel:.1} off {off:.2} {b:?}"); break; }
                }
                if after > 60 { break }
            } else if done { println!("LOST start {k} scan {i} {travel:.1}"); break }
            if travel > 40.0 { break }
        }
        if !done { if mapped < 5.0 { unmapped += 1 } else { never += 1; println!("never {k} first {first} travel {travel:.1} mapped {mapped:.1}") } }
    }
    found_m.sort_by(|a, b| a.total_cmp(b));
    errors.sort_by(|a, b| a.total_cmp(b));
    let q = |v: &Vec<f64>, s: f64| v.get((s * v.len() as f64) as usize).copied().unwrap_or(f64::NAN);
    println!("{starts} starts: found {} p50 {:.1} p95 {:.1} max {:.1} m mapped; false {falsely}, never {never}, unmapped {unmapped}; slowest {slowest:.2} s; after: median {:.3} p95 {:.3} m", found_m.len(), q(&found_m, 0.5), q(&found_m, 0.95), found_m.last().unwrap_or(&0.0), q(&errors, 0.5), q(&errors, 0.95));
}
