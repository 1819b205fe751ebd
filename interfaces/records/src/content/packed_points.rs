//! Points of scans in few bytes: neighbours in a scan lie side by side or go on as they did.

use crate::RecordError;
use flockslam_evidence::range_coder::{BinaryCoder, Likelihood, RangeDecoder, RangeEncoder};

/// Unit of a transmitted coordinate, millimetres: far below the noise of a lidar.
pub const POINT_UNIT_MM: i16 = 4;
/// Farthest coordinate that fits, in units.
const UNITS_MAX: i32 = 8191;
/// Number of sizes of differences that are coded differently: bits of the greatest, and none.
const SIZES: usize = 20;
/// Bits of a difference that are learned, the highest first; lower ones are noise.
const LEARNED: usize = 2;

/// A point as it is sent: coordinates in millimetres, multiples of `POINT_UNIT_MM`.
pub fn rounded([x_mm, y_mm]: [i16; 2]) -> [i16; 2] {
    [x_mm, y_mm].map(|value| in_units(value) as i16 * POINT_UNIT_MM)
}

fn in_units(value_mm: i16) -> i32 {
    let unit = i32::from(POINT_UNIT_MM);
    (i32::from(value_mm) + unit / 2).div_euclid(unit).clamp(-UNITS_MAX, UNITS_MAX)
}

/// The bytes of these points, all of them in one piece.
pub fn encode<'a>(scans: impl Iterator<Item = &'a [[i16; 2]]>) -> Vec<u8> {
    let (mut coder, mut model) = (RangeEncoder::new(Vec::new()), Model::default());
    for scan in scans {
        model.begin();
        for point in scan {
            let _ = model.code(&mut coder, point.map(in_units));
        }
    }
    coder.finish()
}

/// Reads scans of so many points each.
pub fn decode(bytes: &[u8], counts: &[usize]) -> Result<Vec<Vec<[i16; 2]>>, RecordError> {
    let (mut coder, mut model) = (RangeDecoder::new(bytes), Model::default());
    let mut scans = Vec::with_capacity(counts.len());
    for count in counts {
        model.begin();
        let mut points = Vec::with_capacity(*count);
        for _ in 0..*count {
            let point = model.code(&mut coder, [0; 2]).ok_or(RecordError::Malformed("a point"))?;
            points.push(point.map(|value| value as i16 * POINT_UNIT_MM));
        }
        scans.push(points);
    }
    // Zeros at the end are never written, so that the same points have the same bytes.
    match (coder.left(), bytes.last()) {
        (0, None | Some(1..)) => Ok(scans),
        _ => Err(RecordError::Malformed("points")),
    }
}

/// What is learned of points while they are coded. Points go on as the two before them did; how far off that is along the beam, the
/// longer coordinate tells of the shorter one.
#[derive(Default)]
struct Model {
    last: [i32; 2],
    before: [i32; 2],
    longer: Differences,
    shorter: Differences,
}

/// Differences of one kind.
struct Differences {
    /// Size of the last one.
    size: usize,
    /// Is it larger than this size, by that of the last one.
    is_larger: Box<[[Likelihood; SIZES]; SIZES]>,
    is_negative: [Likelihood; SIZES],
    bits: [[Likelihood; LEARNED]; SIZES],
    noise: Likelihood,
}

impl Default for Differences {
    fn default() -> Self {
        Self {
            size: 0,
            is_larger: Box::new([[Likelihood::default(); SIZES]; SIZES]),
            is_negative: [Likelihood::default(); SIZES],
            bits: [[Likelihood::default(); LEARNED]; SIZES],
            noise: Likelihood::default(),
        }
    }
}

impl Model {
    /// A new scan: what was learned stays.
    fn begin(&mut self) {
        (self.last, self.before) = ([0; 2], [0; 2]);
        (self.longer.size, self.shorter.size) = (0, 0);
    }

    /// Writes a point, or gives the one that is read; `None` for one that cannot be.
    fn code(&mut self, coder: &mut impl BinaryCoder, point: [i32; 2]) -> Option<[i32; 2]> {
        let guess: [i32; 2] = std::array::from_fn(|axis| 2 * self.last[axis] - self.before[axis]);
        let long = usize::from(guess[0].abs() < guess[1].abs());
        let short = 1 - long;
        let mut coded = guess;
        let off = self.longer.code(coder, point[long] - guess[long]);
        coded[long] += off;
        let fits = |value: i32| (-UNITS_MAX..=UNITS_MAX).contains(&value);
        if !fits(coded[long]) {
            return None;
        }
        // The beam is as steep as the guess.
        coded[short] += if guess[long] == 0 { 0 } else { off * guess[short] / guess[long] };
        coded[short] += self.shorter.code(coder, point[short] - coded[short]);
        (self.before, self.last) = (self.last, coded);
        fits(coded[short]).then_some(coded)
    }
}

impl Differences {
    /// Writes a difference, or gives the one that is read.
    fn code(&mut self, coder: &mut impl BinaryCoder, difference: i32) -> i32 {
        let wanted = (32 - difference.unsigned_abs().leading_zeros()) as usize;
        let mut size = 0;
        while size < SIZES - 1 && coder.code(&mut self.is_larger[self.size][size], wanted > size) {
            size += 1;
        }
        self.size = size;
        if size == 0 {
            return 0;
        }
        let is_negative = coder.code(&mut self.is_negative[size], difference < 0);
        let mut amount = 1u32;
        for place in (0..size - 1).rev() {
            let bit = difference.unsigned_abs() >> place & 1 == 1;
            let depth = size - 2 - place;
            let likelihood = self.bits[size].get_mut(depth).unwrap_or(&mut self.noise);
            amount = amount << 1 | u32::from(coder.code(likelihood, bit));
        }
        if is_negative { -(amount as i32) } else { amount as i32 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn points_come_back_rounded(
            scans in proptest::collection::vec(proptest::collection::vec(any::<[i16; 2]>(), 0..40), 0..6)
        ) {
            let bytes = encode(scans.iter().map(Vec::as_slice));
            let counts: Vec<usize> = scans.iter().map(Vec::len).collect();
            let expected: Vec<Vec<_>> =
                scans.iter().map(|scan| scan.iter().map(|point| rounded(*point)).collect()).collect();
            prop_assert_eq!(decode(&bytes, &counts).unwrap(), expected);
        }

        #[test]
        fn any_bytes_are_rejected_or_points_that_round_trip(
            bytes in proptest::collection::vec(any::<u8>(), 0..80), count in 0usize..200
        ) {
            if let Ok(scans) = decode(&bytes, &[count, 3]) {
                prop_assert_eq!((scans.len(), scans[0].len(), scans[1].len()), (2, count, 3));
                let again = encode(scans.iter().map(Vec::as_slice));
                prop_assert_eq!(decode(&again, &[count, 3]), Ok(scans));
            }
        }
    }

    #[test]
    fn a_wall_takes_about_a_byte_a_point() {
        // Seen from 3 m away in steps of half a degree, with noise of a centimetre.
        let noise = |i: i32| f64::from(i * 7919 % 41 - 20) * 0.5;
        let wall = |i: i32| {
            let angle = f64::from(i - 90) * 0.5f64.to_radians();
            let range_mm = 3000.0 / angle.cos() + noise(i);
            [(range_mm * angle.cos()) as i16, (range_mm * angle.sin()) as i16]
        };
        let scan: Vec<[i16; 2]> = (0..180).map(wall).collect();
        let bytes = encode(std::iter::repeat_n(scan.as_slice(), 10));
        assert!(bytes.len() < 10 * 180 * 5 / 4, "{} bytes", bytes.len());
    }
}
