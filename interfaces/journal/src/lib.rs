//! The only writer of durable state: whole files that are replaced atomically, and journals of checksummed records.
//!
//! A process may be killed at any instant and a disk may lose power: what is read back afterwards is the old or the
//! new file, and all records of a journal up to the last whole one.

mod format;
mod growing_file;
mod journal_error;
mod record_reader;
mod refusal;
mod replace;
mod writer;

pub use format::{PARTS_MAX, RECORD_BYTES_MAX, VERSION};
pub use growing_file::GrowingFile;
pub use journal_error::JournalError;
pub use record_reader::{Ending, Record, RecordReader};
pub use refusal::{Refusal, is_durable};
pub use replace::{Durability, remove_leftovers, replace_file, replace_file_by, replace_file_by_parts};
pub use writer::RecordWriter;
