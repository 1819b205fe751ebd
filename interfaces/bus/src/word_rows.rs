//! Messages as rows of words, and back.
//!
//! A plain message fills words from the first on. A message with a slice has the number of its elements in the first word, then
//! its header, then the elements.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// A row of words: what every message is in memory.
pub type Words = [u64];

const WORD_BYTES: usize = size_of::<u64>();

/// Whether a type may begin at any word.
const fn fits<T>() -> bool {
    align_of::<T>() <= align_of::<u64>()
}

/// Words that a type fills.
pub const fn words_of<T>() -> usize {
    size_of::<T>().div_ceil(WORD_BYTES)
}

/// Words of a header with so many elements.
pub const fn words_of_slice<H, E>(elements: usize) -> usize {
    1 + words_of::<H>() + (elements * size_of::<E>()).div_ceil(WORD_BYTES)
}

/// The message in a row of words; `None` when the row is too short.
pub fn plain<T: FromBytes + KnownLayout + Immutable>(words: &Words) -> Option<&T> {
    const { assert!(fits::<T>()) };
    Some(T::ref_from_prefix(words.as_bytes()).ok()?.0)
}

/// As [`plain`], to be written.
pub fn plain_mut<T: FromBytes + IntoBytes + KnownLayout>(words: &mut Words) -> Option<&mut T> {
    const { assert!(fits::<T>()) };
    Some(T::mut_from_prefix(words.as_mut_bytes()).ok()?.0)
}

/// The header and the elements in a row of words; `None` when the row is shorter than its first word says.
pub fn slice<H, E>(words: &Words) -> Option<(&H, &[E])>
where
    H: FromBytes + KnownLayout + Immutable,
    E: FromBytes + Immutable,
{
    const { assert!(fits::<H>() && fits::<E>()) };
    let (count, words) = words.split_first()?;
    let (header, elements) = words.split_at_checked(words_of::<H>())?;
    let count = usize::try_from(*count).ok()?;
    let elements = <[E]>::ref_from_prefix_with_elems(elements.as_bytes(), count).ok()?.0;
    Some((plain(header)?, elements))
}

/// Writes a header and the number of its elements; the elements, to be written, or `None` when the row is too short.
pub fn slice_mut<'w, H, E>(words: &'w mut Words, header: &H, count: usize) -> Option<&'w mut [E]>
where
    H: FromBytes + IntoBytes + KnownLayout + Copy,
    E: FromBytes + IntoBytes + Immutable,
{
    const { assert!(fits::<H>() && fits::<E>()) };
    let (first, words) = words.split_first_mut()?;
    let (place, elements) = words.split_at_mut_checked(words_of::<H>())?;
    *first = count as u64;
    *plain_mut(place)? = *header;
    Some(<[E]>::mut_from_prefix_with_elems(elements.as_mut_bytes(), count).ok()?.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slice_of_any_length_round_trips() {
        for count in [0_usize, 1, 2, 3, 1000] {
            let mut words = vec![0; words_of_slice::<[u32; 3], f32>(count)];
            let elements: Vec<f32> = (0..count).map(|i| i as f32).collect();
            slice_mut::<[u32; 3], f32>(&mut words, &[7, 8, 9], count).unwrap().copy_from_slice(&elements);
            assert_eq!(slice::<[u32; 3], f32>(&words), Some((&[7, 8, 9], elements.as_slice())));
        }
    }

    #[test]
    fn a_row_that_is_too_short_is_no_message() {
        assert!(plain::<[u64; 3]>(&[1, 2]).is_none());
        assert_eq!(plain::<[u64; 2]>(&[1, 2]), Some(&[1, 2]));
        // Two elements of a word each are declared, one is there.
        assert!(slice::<u64, u64>(&[2, 0, 5]).is_none());
        assert!(slice::<u64, u64>(&[u64::MAX, 0, 5]).is_none());
        assert!(slice::<u64, u64>(&[]).is_none());
    }
}
