//! An adaptive binary range coder (Martin 1979; the form with carry propagation and shift-updated probabilities is that of
//! LZMA): bits go in with a probability each, bytes come out near the entropy.

/// Bits of a probability.
const SCALE: u32 = 16;
/// A probability moves by this power of ½ of its distance with each bit.
const RATE: u32 = 4;
/// Below this range a byte is moved out.
const RANGE_MIN: u32 = 1 << 24;

/// How likely the next bit of its kind is 0; it learns from each bit.
#[derive(Clone, Copy, Debug)]
pub struct Likelihood(u16);

impl Default for Likelihood {
    fn default() -> Self {
        Self(1 << (SCALE - 1))
    }
}

impl Likelihood {
    /// The part of `range` that belongs to 0; never nothing and never all.
    #[inline]
    fn share(self, range: u32) -> u32 {
        (range >> SCALE) * u32::from(self.0)
    }

    #[inline]
    fn learn(&mut self, bit: bool) {
        if bit {
            self.0 -= self.0 >> RATE;
        } else {
            self.0 += (u16::MAX - self.0) >> RATE;
        }
    }
}

/// Takes bits.
#[derive(Debug)]
pub struct RangeEncoder {
    low: u64,
    range: u32,
    held: u8,
    /// Bytes not yet written: the held one, and those of 0xff behind it that a carry would change.
    waiting: usize,
    out: Vec<u8>,
    /// Bytes that were there before.
    before: usize,
}

/// A coder of bits in either direction: one model serves both.
pub trait BinaryCoder {
    /// Writes `bit` and gives it back, or gives the bit that is read.
    fn code(&mut self, likelihood: &mut Likelihood, bit: bool) -> bool;
}

impl RangeEncoder {
    /// Continues `out`.
    pub fn new(out: Vec<u8>) -> Self {
        Self { low: 0, range: u32::MAX, held: 0, waiting: 1, before: out.len(), out }
    }

    #[inline]
    fn put(&mut self, likelihood: &mut Likelihood, bit: bool) {
        let share = likelihood.share(self.range);
        if bit {
            self.low += u64::from(share);
            self.range -= share;
        } else {
            self.range = share;
        }
        likelihood.learn(bit);
        while self.range < RANGE_MIN {
            self.range <<= 8;
            self.shift();
        }
    }

    /// Moves the highest byte of `low` out, once no carry can reach it any more.
    fn shift(&mut self) {
        let carry = (self.low >> 32) as u8;
        if self.low < 0xff00_0000 || carry > 0 {
            self.out.push(self.held.wrapping_add(carry));
            self.out.extend(std::iter::repeat_n(0xffu8.wrapping_add(carry), self.waiting - 1));
            self.waiting = 0;
            self.held = (self.low >> 24) as u8;
        }
        self.waiting += 1;
        self.low = (self.low & 0x00ff_ffff) << 8;
    }

    /// Everything, to the last bit.
    pub fn finish(mut self) -> Vec<u8> {
        (0..5).for_each(|_| self.shift());
        // The reader takes what is missing for zeros.
        while self.out.len() > self.before && self.out.last() == Some(&0) {
            self.out.pop();
        }
        self.out
    }
}

/// Gives the bits back. Behind the end of its bytes it reads zeros: the reader must know the number of bits.
#[derive(Debug)]
pub struct RangeDecoder<'a> {
    code: u32,
    range: u32,
    bytes: std::slice::Iter<'a, u8>,
}

impl<'a> RangeDecoder<'a> {
    /// Reads what [`RangeEncoder`] wrote.
    pub fn new(bytes: &'a [u8]) -> Self {
        let mut decoder = Self { code: 0, range: u32::MAX, bytes: bytes.iter() };
        // The first is the encoder's empty hand.
        (0..5).for_each(|_| decoder.take());
        decoder
    }

    /// Bytes that were not needed.
    pub fn left(&self) -> usize {
        self.bytes.len()
    }

    #[inline]
    fn get(&mut self, likelihood: &mut Likelihood) -> bool {
        let share = likelihood.share(self.range);
        let bit = self.code >= share;
        if bit {
            self.code -= share;
            self.range -= share;
        } else {
            self.range = share;
        }
        likelihood.learn(bit);
        while self.range < RANGE_MIN {
            self.range <<= 8;
            self.take();
        }
        bit
    }

    #[inline]
    fn take(&mut self) {
        self.code = self.code << 8 | u32::from(self.bytes.next().copied().unwrap_or(0));
    }
}

impl BinaryCoder for RangeEncoder {
    #[inline]
    fn code(&mut self, likelihood: &mut Likelihood, bit: bool) -> bool {
        self.put(likelihood, bit);
        bit
    }
}

impl BinaryCoder for RangeDecoder<'_> {
    #[inline]
    fn code(&mut self, likelihood: &mut Likelihood, _: bool) -> bool {
        self.get(likelihood)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn bits_come_back(bits in proptest::collection::vec((0usize..3, 0u8..8), 0..3000)) {
            // Kinds of bits from even to nearly always the same.
            let bits: Vec<(usize, bool)> = bits.into_iter().map(|(kind, n)| (kind, n < [4, 1, 0][kind])).collect();
            let mut encoder = RangeEncoder::new(vec![7, 0]);
            let mut kinds = [Likelihood::default(); 3];
            bits.iter().for_each(|(kind, bit)| encoder.put(&mut kinds[*kind], *bit));
            let bytes = encoder.finish();
            let mut decoder = RangeDecoder::new(&bytes[2..]);
            let mut kinds = [Likelihood::default(); 3];
            for (kind, bit) in bits {
                prop_assert_eq!(decoder.get(&mut kinds[kind]), bit);
            }
        }

        #[test]
        fn any_bytes_decode_to_bits_that_round_trip(bytes in proptest::collection::vec(any::<u8>(), 0..40)) {
            let read = |bytes: &[u8]| -> Vec<bool> {
                let (mut decoder, mut likelihood) = (RangeDecoder::new(bytes), Likelihood::default());
                (0..1000).map(|_| decoder.get(&mut likelihood)).collect()
            };
            let bits = read(&bytes);
            let (mut encoder, mut likelihood) = (RangeEncoder::new(Vec::new()), Likelihood::default());
            bits.iter().for_each(|bit| encoder.put(&mut likelihood, *bit));
            prop_assert_eq!(read(&encoder.finish()), bits);
        }
    }

    #[test]
    fn what_is_expected_costs_little() {
        let (mut encoder, mut likelihood) = (RangeEncoder::new(Vec::new()), Likelihood::default());
        (0..10_000).for_each(|i| encoder.put(&mut likelihood, i % 100 == 0));
        let bits = 8 * encoder.finish().len();
        // The entropy is 808 bits.
        assert!((800..1300).contains(&bits), "{bits}");
    }
}
