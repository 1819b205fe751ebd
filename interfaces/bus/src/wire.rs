use flockslam_messages::Message;
use iceoryx2::prelude::ZeroCopySend;

/// Lets a message cross iceoryx2 under its own versioned name.
#[repr(transparent)]
#[derive(Clone, Copy, Debug)]
pub struct Wire<T>(pub T);

// SAFETY: `Message` demands plain data: zerocopy proves that there is no padding, no pointer and no invalid byte
// pattern, and messages are `#[repr(C)]`. The name carries the version; the layout hash is checked at opening.
unsafe impl<T: Message + core::fmt::Debug> ZeroCopySend for Wire<T> {
    unsafe fn type_name() -> &'static str {
        T::TYPE_NAME
    }
}

impl<T: Message> Default for Wire<T> {
    fn default() -> Self {
        Self(T::new_zeroed())
    }
}

/// Views a slice of wrapped messages as the messages themselves.
pub fn unwrap_slice<T>(slice: &[Wire<T>]) -> &[T] {
    // SAFETY: `Wire` is `repr(transparent)` over T: same layout, same lifetime.
    unsafe { core::slice::from_raw_parts(slice.as_ptr().cast(), slice.len()) }
}

/// As [`unwrap_slice`], writable.
pub fn unwrap_slice_mut<T>(slice: &mut [Wire<T>]) -> &mut [T] {
    // SAFETY: as above, and the exclusive borrow is passed on.
    unsafe { core::slice::from_raw_parts_mut(slice.as_mut_ptr().cast(), slice.len()) }
}
