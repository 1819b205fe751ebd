//! What makes a type a message: plain data with a versioned name and a hash of its layout (FNV-1a). The macro `message!`
//! declares the types of all other modules.

use flockslam_evidence::{PackedCell, Tile, TileKey};
use flockslam_geometry::{Covariance, Point, Pose, Twist};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// A type whose memory layout has a fingerprint: names, types, offsets and sizes of all fields, all the way down.
pub trait Layout {
    /// FNV-1a hash over the layout.
    const HASH: u64;
}

/// A payload that may cross a process boundary.
///
/// The zerocopy bounds make the compiler prove that it is plain data without padding, valid for any bytes.
pub trait Message:
    Layout + Copy + FromBytes + IntoBytes + Immutable + KnownLayout + Send + Sync + 'static
{
    /// Name and version, for example `flockslam/pose/v1`.
    const TYPE_NAME: &'static str;
}

const FNV_OFFSET: u64 = 0xcbf2_9ce4_8422_2325;
const FNV_PRIME: u64 = 0x0000_0100_0000_01b3;

/// Adds the bytes of `text` to a running FNV-1a hash.
pub(crate) const fn hash_text(mut hash: u64, text: &str) -> u64 {
    let bytes = text.as_bytes();
    let mut i = 0;
    while i < bytes.len() {
        hash = (hash ^ bytes[i] as u64).wrapping_mul(FNV_PRIME);
        i += 1;
    }
    hash
}

/// Adds the eight bytes of `number` to a running FNV-1a hash.
pub(crate) const fn hash_number(mut hash: u64, number: u64) -> u64 {
    let mut i = 0;
    while i < 8 {
        hash = (hash ^ ((number >> (8 * i)) & 0xff)).wrapping_mul(FNV_PRIME);
        i += 1;
    }
    hash
}

macro_rules! layout_of_primitive {
    ($($t:ty),*) => { $(impl Layout for $t {
        const HASH: u64 = hash_number(hash_text(FNV_OFFSET, stringify!($t)), size_of::<$t>() as u64);
    })* };
}
layout_of_primitive!(u8, u16, u32, u64, i32, i64, f32, f64);

impl<T: Layout, const N: usize> Layout for [T; N] {
    const HASH: u64 = hash_number(hash_number(hash_text(FNV_OFFSET, "array"), N as u64), T::HASH);
}

/// Fingerprints a struct by listing its fields.
macro_rules! layout_of_struct {
    ($name:ident { $($field:ident : $t:ty),* $(,)? }) => {
        impl $crate::message::Layout for $name {
            const HASH: u64 = {
                let mut hash = $crate::message::hash_text(0xcbf2_9ce4_8422_2325, stringify!($name));
                $(
                    hash = $crate::message::hash_text(hash, stringify!($field));
                    hash = $crate::message::hash_number(hash, core::mem::offset_of!($name, $field) as u64);
                    hash = $crate::message::hash_number(hash, <$t as $crate::message::Layout>::HASH);
                )*
                $crate::message::hash_number(hash, size_of::<$name>() as u64)
            };
        }
    };
}
pub(crate) use layout_of_struct;

layout_of_struct!(Pose { x_m: f64, y_m: f64, heading_rad: f64 });
layout_of_struct!(Point { x_m: f64, y_m: f64 });
layout_of_struct!(Twist { x_m_s: f64, y_m_s: f64, turn_rad_s: f64 });
layout_of_struct!(Covariance { xx: f64, xy: f64, xt: f64, yy: f64, yt: f64, tt: f64 });
layout_of_struct!(PackedCell { occupied: u16, free: u16 });
layout_of_struct!(TileKey { x: i32, y: i32 });
layout_of_struct!(Tile {
    cells: [PackedCell; flockslam_evidence::TILE_CELLS],
    score: [u16; flockslam_evidence::TILE_CELLS],
    score_half: [u16; flockslam_evidence::TILE_CELLS / 4],
    score_quarter: [u16; flockslam_evidence::TILE_CELLS / 16],
});

/// Declares a payload: `#[repr(C)]`, plain data, with version and layout fingerprint.
macro_rules! message {
    ($(#[$doc:meta])* pub struct $name:ident = $type_name:literal {
        $($(#[$field_doc:meta])* pub $field:ident : $t:ty),* $(,)?
    }) => {
        $(#[$doc])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, PartialEq, zerocopy::FromBytes, zerocopy::IntoBytes, zerocopy::Immutable,
            zerocopy::KnownLayout)]
        pub struct $name { $($(#[$field_doc])* pub $field: $t),* }

        $crate::message::layout_of_struct!($name { $($field: $t),* });

        impl $crate::message::Message for $name { const TYPE_NAME: &'static str = $type_name; }

        impl Default for $name {
            fn default() -> Self { <Self as zerocopy::FromZeros>::new_zeroed() }
        }
    };
}
pub(crate) use message;

impl Message for f32 {
    const TYPE_NAME: &'static str = "f32";
}
impl Message for u32 {
    const TYPE_NAME: &'static str = "u32";
}

#[cfg(test)]
mod tests {
    use super::*;

    #[repr(C)]
    struct First {
        near: u32,
        far: u32,
    }
    layout_of_struct!(First { near: u32, far: u32 });

    mod reordered {
        #[repr(C)]
        pub struct First {
            pub far: u32,
            pub near: u32,
        }
        crate::message::layout_of_struct!(First { far: u32, near: u32 });
    }

    #[test]
    fn a_reordered_struct_of_the_same_size_has_another_fingerprint() {
        assert_eq!(size_of::<First>(), size_of::<reordered::First>());
        assert_ne!(First::HASH, reordered::First::HASH);
        assert_ne!(<[u16; 4]>::HASH, <[u16; 5]>::HASH);
    }
}
