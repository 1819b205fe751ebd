//! Room in shared memory. Objects get their memory when they are made, so that no later write faults; what they may not have is an
//! error with its reason.
//!
//! A file on tmpfs has a size but no memory until it is written, and a write for which there is no memory kills the process with
//! SIGBUS. iceoryx2 0.10 sizes its objects by `ftruncate` and offers no other way, so that call is replaced here.

use rustix::fs::{FallocateFlags, FsWord, fallocate, fstat, fstatfs, ftruncate as cut, statvfs};
use rustix::io::Errno;
use rustix::mm::{Advice, madvise};
use std::cell::Cell;
use std::collections::BTreeMap;
use std::ffi::c_int;
use std::fmt;
use std::os::fd::BorrowedFd;

/// Where shared memory is.
pub(crate) const SHARED_MEMORY: &str = "/dev/shm";
/// Objects up to this size get all their memory when they are made, bytes. Larger ones get so much, and the rest message by message.
pub(crate) const WHOLE_MAX_BYTES: u64 = 2 << 20;
/// `f_type` of a tmpfs.
const TMPFS: FsWord = 0x0102_1994;

thread_local! {
    /// What a larger object that this thread makes gets at first, bytes.
    static FIRST_BYTES: Cell<u64> = const { Cell::new(WHOLE_MAX_BYTES) };
    /// An object of so many bytes was refused for want of memory, and nobody has been informed yet.
    static REFUSED_BYTES: Cell<Option<u64>> = const { Cell::new(None) };
}

/// Memory of the file system of shared memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Room {
    /// All of it, bytes.
    pub total_bytes: u64,
    /// Bytes of messages without a reader.
    pub free_bytes: u64,
}

impl Room {
    /// Of shared memory, as it is now; `None` when the system does not tell, or sets no limit.
    pub fn now() -> Option<Self> {
        let found = statvfs(SHARED_MEMORY).ok()?;
        let bytes = |blocks: u64| blocks.saturating_mul(found.f_frsize);
        let room = Self { total_bytes: bytes(found.f_blocks), free_bytes: bytes(found.f_bavail) };
        (room.total_bytes > 0).then_some(room)
    }
}

impl fmt::Display for Room {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (total, free) = (Megabytes(self.total_bytes), Megabytes(self.free_bytes));
        write!(f, "{SHARED_MEMORY} has {total}, {free} of it free")
    }
}

/// Bytes, for people.
#[derive(Clone, Copy, Debug)]
pub struct Megabytes(pub u64);

impl fmt::Display for Megabytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // As `df` and `--shm-size` count.
        write!(f, "{:.1} MB", self.0 as f64 / f64::from(1 << 20))
    }
}

/// Lets large objects that `make` makes in this thread have so much memory at first, bytes.
pub(crate) fn with_first_bytes<T>(bytes: u64, make: impl FnOnce() -> T) -> T {
    let before = FIRST_BYTES.replace(bytes);
    let made = make();
    FIRST_BYTES.set(before);
    made
}

/// Whether this thread was refused memory for an object since the last call: its size, bytes.
pub(crate) fn take_refused_bytes() -> Option<u64> {
    REFUSED_BYTES.take()
}

/// Gives the memory of a message to be written its pages; false when there are none. Costs a microsecond where they are there.
pub(crate) fn give_pages<T>(memory: &mut [T]) -> bool {
    let page = rustix::param::page_size();
    let range = memory.as_mut_ptr_range();
    let begin = range.start.addr() / page * page;
    let bytes = range.end.addr() - begin;
    let start = range.start.with_addr(begin).cast();
    // SAFETY: the pages lie in one mapping, that of the message, and populating them changes no byte of them.
    match unsafe { madvise(start, bytes, Advice::LinuxPopulateWrite) } {
        // Kernels before 5.14 cannot tell.
        Ok(()) | Err(Errno::INVAL) => true,
        Err(_) => false,
    }
}

/// The pages that the messages of one sender have got so far: those that are lent again have them already.
#[derive(Debug, Default)]
pub(crate) struct GivenPages {
    /// By address of a message's memory: how many bytes of it have pages.
    bytes: BTreeMap<usize, usize>,
    /// The longest message, bytes. For a longer one memory grows, and the old addresses mean nothing.
    longest: usize,
}

impl GivenPages {
    /// As [`give_pages`].
    pub(crate) fn give<T>(&mut self, memory: &mut [T]) -> bool {
        let (address, bytes) = (memory.as_ptr().addr(), size_of_val(memory));
        if bytes > self.longest {
            (self.longest, self.bytes) = (bytes, BTreeMap::new());
        }
        let given = self.bytes.entry(address).or_insert(0);
        if *given >= bytes {
            return true;
        }
        let has_pages = give_pages(memory);
        *given = if has_pages { bytes } else { *given };
        has_pages
    }
}

/// Gives a new file on tmpfs its size and its memory.
fn size_with_memory(file: BorrowedFd<'_>, bytes: u64) -> rustix::io::Result<()> {
    let first = if bytes <= WHOLE_MAX_BYTES { bytes } else { FIRST_BYTES.get().min(bytes) };
    let given = fallocate(file, FallocateFlags::empty(), 0, first);
    match given {
        Ok(()) if first == bytes => Ok(()),
        Ok(()) | Err(Errno::OPNOTSUPP | Errno::NOSYS) => cut(file, bytes),
        Err(error) => {
            if matches!(error, Errno::NOSPC | Errno::NOMEM) {
                REFUSED_BYTES.set(Some(first));
            }
            Err(error)
        }
    }
}

fn resize(file: BorrowedFd<'_>, bytes: u64) -> rustix::io::Result<()> {
    let is_new = fstat(file)?.st_size == 0 && bytes > 0;
    let on_tmpfs = || fstatfs(file).is_ok_and(|found| found.f_type == TMPFS);
    if is_new && on_tmpfs() { size_with_memory(file, bytes) } else { cut(file, bytes) }
}

unsafe extern "C" {
    fn __errno_location() -> *mut c_int;
}

/// In place of libc's function in every program with this crate. The standard library calls `ftruncate64`, and is not concerned.
///
/// # Safety
/// `file` is open, as libc asks for.
#[unsafe(no_mangle)]
unsafe extern "C" fn ftruncate(file: c_int, bytes: i64) -> c_int {
    let error = match u64::try_from(bytes) {
        // SAFETY: the caller lends an open descriptor for the time of this call.
        Ok(bytes) if file >= 0 => resize(unsafe { BorrowedFd::borrow_raw(file) }, bytes).err(),
        Ok(_) => Some(Errno::BADF),
        Err(_) => Some(Errno::INVAL),
    };
    let Some(error) = error else { return 0 };
    // SAFETY: libc gives the address of this thread's error number.
    unsafe { *__errno_location() = error.raw_os_error() };
    -1
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::File;
    use std::os::fd::{AsFd, AsRawFd};
    use std::os::unix::fs::MetadataExt;

    fn in_shared_memory(name: &str) -> File {
        let path = format!("{SHARED_MEMORY}/flockslam-room-{name}-{}", std::process::id());
        let file = File::create_new(&path).unwrap();
        std::fs::remove_file(path).unwrap();
        file
    }

    fn sizes(file: &File) -> (u64, u64) {
        let metadata = file.metadata().unwrap();
        (metadata.len(), metadata.blocks() * 512)
    }

    #[test]
    fn an_object_has_its_memory_when_it_is_made() {
        let file = in_shared_memory("small");
        // SAFETY: the file is open.
        assert_eq!(unsafe { ftruncate(file.as_raw_fd(), 100_000) }, 0);
        assert_eq!(sizes(&file), (100_000, 102_400));
        // SAFETY: the file is open.
        assert_eq!(unsafe { ftruncate(file.as_raw_fd(), 10) }, 0);
        assert_eq!(sizes(&file).0, 10);
        // SAFETY: a negative size is refused before anything else.
        assert_eq!(unsafe { ftruncate(file.as_raw_fd(), -1) }, -1);
        assert_eq!(std::io::Error::last_os_error().raw_os_error(), Some(Errno::INVAL.raw_os_error()));
    }

    #[test]
    fn a_large_object_has_as_much_as_is_asked_for() {
        let (large, larger) = (in_shared_memory("large"), in_shared_memory("larger"));
        resize(large.as_fd(), 1 << 30).unwrap();
        assert_eq!(sizes(&large), (1 << 30, WHOLE_MAX_BYTES));
        with_first_bytes(3 << 20, || resize(larger.as_fd(), 1 << 30)).unwrap();
        assert_eq!(sizes(&larger), (1 << 30, 3 << 20));
    }

    #[test]
    fn what_is_refused_is_reported_once() {
        let file = in_shared_memory("refused");
        let bytes = Room::now().unwrap().total_bytes + (1 << 20);
        assert!(with_first_bytes(bytes, || resize(file.as_fd(), bytes)).is_err());
        assert_eq!((take_refused_bytes(), take_refused_bytes()), (Some(bytes), None));
        assert_eq!(sizes(&file), (0, 0));
    }

    #[test]
    fn pages_of_any_memory_are_given() {
        let mut memory = vec![7_u64; 10_000];
        assert!(give_pages(&mut memory[3..9_000]));
        assert!(memory.iter().all(|word| *word == 7));
        let mut pages = GivenPages::default();
        for (range, known) in [(3..500, 1), (3..900, 1), (1000..1500, 2), (3..900, 2), (0..2000, 1)] {
            assert!(pages.give(&mut memory[range]));
            assert_eq!(pages.bytes.len(), known);
        }
    }
}
