//! The fields of a serialized message, one after the other: as ROS 1 writes them, or in CDR (OMG DDSI-RTPS 2.3, section 10), as ROS 2 does.

/// Why a message does not match its type.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MessageProblem {
    /// It ends too early, or its length is larger than its content.
    #[error("the message breaks off")]
    BreaksOff,
    /// Its encoding is none that is known.
    #[error("the message begins with an unknown encoding")]
    UnknownEncoding,
    /// More beams than are taken.
    #[error("the scan claims to have more than 10 million beams")]
    TooManyBeams,
    /// An angle, a limit, a pose or a rate is not finite.
    #[error("an angle, a limit, a pose or a rate is not finite")]
    NotFinite,
    /// A cloud of points without places.
    #[error("the points of the cloud have no fields x, y and z of 32 or 64 bits")]
    NoPlaces,
}

/// How the fields of a message lie in its bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wire {
    /// Little endian, without gaps; a header begins with a sequence number.
    Ros1,
    /// Aligned to the size of each number, behind four bytes that name the order of bytes.
    Cdr,
    /// As messages lie on the bus of this build.
    Bus,
}

/// Fields of a message, read in order.
pub(crate) struct Fields<'a> {
    bytes: &'a [u8],
    at: usize,
    wire: Wire,
    big_endian: bool,
}

impl<'a> Fields<'a> {
    pub fn new(bytes: &'a [u8], wire: Wire) -> Result<Self, MessageProblem> {
        let whole = Self { bytes, at: 0, wire, big_endian: false };
        if wire != Wire::Cdr {
            return Ok(whole);
        }
        let (head, bytes) = bytes.split_first_chunk::<4>().ok_or(MessageProblem::BreaksOff)?;
        match head[..2] {
            [0, order @ (0 | 1)] => Ok(Self { bytes, big_endian: order == 0, ..whole }),
            _ => Err(MessageProblem::UnknownEncoding),
        }
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], MessageProblem> {
        let end = self.at.checked_add(count).ok_or(MessageProblem::BreaksOff)?;
        let taken = self.bytes.get(self.at..end).ok_or(MessageProblem::BreaksOff)?;
        self.at = end;
        Ok(taken)
    }

    fn number<const N: usize>(&mut self) -> Result<[u8; N], MessageProblem> {
        self.align(N);
        let mut bytes: [u8; N] = self.take(N)?.try_into().expect("so many were taken");
        if self.big_endian {
            bytes.reverse();
        }
        Ok(bytes)
    }

    fn align(&mut self, size: usize) {
        if self.wire == Wire::Cdr {
            self.at = self.at.next_multiple_of(size);
        }
    }

    /// Whether a byte is not 0.
    pub fn flag(&mut self) -> Result<bool, MessageProblem> {
        Ok(self.u8()? != 0)
    }

    pub fn u8(&mut self) -> Result<u8, MessageProblem> {
        Ok(u8::from_le_bytes(self.number()?))
    }

    /// The bytes of a `uint8[]`.
    pub fn bytes(&mut self) -> Result<&'a [u8], MessageProblem> {
        let count = self.u32()? as usize;
        self.take(count)
    }

    pub fn u32(&mut self) -> Result<u32, MessageProblem> {
        Ok(u32::from_le_bytes(self.number()?))
    }

    pub fn f32(&mut self) -> Result<f32, MessageProblem> {
        Ok(f32::from_le_bytes(self.number()?))
    }

    /// So many numbers of 32 bits, one after the other.
    pub fn f32s<const N: usize>(&mut self) -> Result<[f32; N], MessageProblem> {
        self.align(4);
        let bytes = self.take(4 * N)?.as_chunks().0;
        Ok(std::array::from_fn(|at| match self.big_endian {
            true => f32::from_be_bytes(bytes[at]),
            false => f32::from_le_bytes(bytes[at]),
        }))
    }

    /// So many numbers of 64 bits, one after the other.
    pub fn f64s<const N: usize>(&mut self) -> Result<[f64; N], MessageProblem> {
        self.align(8);
        let bytes = self.take(8 * N)?.as_chunks().0;
        Ok(std::array::from_fn(|at| match self.big_endian {
            true => f64::from_be_bytes(bytes[at]),
            false => f64::from_le_bytes(bytes[at]),
        }))
    }

    /// A text; what is not UTF-8 in it is replaced.
    pub fn text(&mut self) -> Result<String, MessageProblem> {
        let length = self.u32()? as usize;
        let bytes = self.take(length)?;
        let bytes = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        Ok(match std::str::from_utf8(bytes) {
            Ok(text) => text.to_owned(),
            Err(_) => String::from_utf8_lossy(bytes).into_owned(),
        })
    }

    /// A `std_msgs/Header`: its stamp, nanoseconds, and its frame.
    pub fn header(&mut self) -> Result<(i64, String), MessageProblem> {
        if self.wire == Wire::Ros1 {
            self.u32()?;
        }
        let seconds = self.u32()?;
        // In ROS 1 the seconds have no sign.
        let seconds =
            if self.wire == Wire::Ros1 { i64::from(seconds) } else { i64::from(seconds.cast_signed()) };
        let nanoseconds = i64::from(self.u32()?);
        Ok((seconds * 1_000_000_000 + nanoseconds, self.text()?))
    }

    /// Behind so many numbers of 32 bits.
    pub fn skip_floats(&mut self, count: usize) -> Result<(), MessageProblem> {
        self.align(4);
        self.take(count.checked_mul(4).ok_or(MessageProblem::BreaksOff)?).map(drop)
    }

    /// The numbers of a `float32[]`, behind those that are there already.
    pub fn floats(&mut self, numbers: &mut Vec<f32>) -> Result<usize, MessageProblem> {
        let count = self.u32()? as usize;
        let bytes = self.take(count.checked_mul(4).ok_or(MessageProblem::BreaksOff)?)?;
        let (fours, _) = bytes.as_chunks::<4>();
        if self.big_endian {
            numbers.extend(fours.iter().map(|four| f32::from_be_bytes(*four)));
        } else {
            numbers.extend(fours.iter().map(|four| f32::from_le_bytes(*four)));
        }
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_cdr_are_aligned_and_have_either_order() {
        // An octet that a text of one letter ends with, then three bytes of padding, then eight-byte alignment.
        let little =
            [&[0u8, 1, 0, 0][..], &2u32.to_le_bytes(), b"a\0", &[0; 2], &7.5f64.to_le_bytes()].concat();
        let mut fields = Fields::new(&little, Wire::Cdr).unwrap();
        assert_eq!((fields.text().unwrap().as_str(), fields.f64s().unwrap()), ("a", [7.5]));
        let big = [&[0u8, 0, 0, 0][..], &1u32.to_be_bytes(), &2.5f32.to_be_bytes()].concat();
        let mut numbers = Vec::new();
        assert_eq!(Fields::new(&big, Wire::Cdr).unwrap().floats(&mut numbers), Ok(1));
        assert_eq!(numbers, [2.5]);
        assert_eq!(Fields::new(&[7, 7, 0, 0], Wire::Cdr).err(), Some(MessageProblem::UnknownEncoding));
        assert_eq!(Fields::new(&[0, 1], Wire::Cdr).err(), Some(MessageProblem::BreaksOff));
    }

    #[test]
    fn a_claim_to_be_long_takes_no_memory() {
        let claim = u32::MAX.to_le_bytes();
        let mut numbers = Vec::new();
        let mut fields = Fields::new(&claim, Wire::Ros1).unwrap();
        assert_eq!(fields.floats(&mut numbers), Err(MessageProblem::BreaksOff));
        assert_eq!(numbers.capacity(), 0);
    }
}
