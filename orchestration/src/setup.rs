//! The way to a first set: answers go in, the text of its description comes out. What is asked can be given as options.

mod questions;
mod scan_picture;
mod set_answers;

pub use questions::{NoTerminal, Questions, SetupError, TerminalQuestions};
pub use scan_picture::scan_picture;
pub use set_answers::{AnsweredLidar, Mounting, SetAnswers, SetupMode, set_name};
