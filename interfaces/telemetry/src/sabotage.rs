//! Switches by which a test takes a protection away, to see that its loss is noticed.

use std::sync::OnceLock;

/// A list of words in the environment of a set, for its own tests alone.
const VARIABLE: &str = "FLOCKSLAM_SABOTAGE";

/// Whether a test wants to have this done, to see that what is thereby broken is noticed: a protection that can be taken away shows
/// that the check behind it is one. Never set in operation.
#[doc(hidden)]
pub fn is_sabotaged(what: &str) -> bool {
    words().iter().any(|word| word == what)
}

/// The word behind `what:`, when a test wants it.
#[doc(hidden)]
pub fn sabotage(what: &str) -> Option<&'static str> {
    words().iter().find_map(|word| word.strip_prefix(what)?.strip_prefix(':'))
}

fn words() -> &'static [String] {
    static WORDS: OnceLock<Vec<String>> = OnceLock::new();
    WORDS.get_or_init(|| {
        let list = std::env::var(VARIABLE).unwrap_or_default();
        list.split(',').filter(|word| !word.is_empty()).map(str::to_owned).collect()
    })
}
