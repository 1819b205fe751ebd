//! Switches by which a test takes a protection away, to see that its loss is noticed. Only builds with debug assertions have them.

/// Whether a test has requested this failure, to see that what is thereby broken is noticed: a protection that can be taken away shows
/// that the check behind it is one.
#[doc(hidden)]
#[inline]
pub fn failpoint(_what: &str) -> bool {
    #[cfg(debug_assertions)]
    return words().iter().any(|word| word == _what);
    #[cfg(not(debug_assertions))]
    false
}

/// The word behind `what:`, when a test has requested it.
#[doc(hidden)]
#[inline]
pub fn failpoint_value(_what: &str) -> Option<&'static str> {
    #[cfg(debug_assertions)]
    return words().iter().find_map(|word| word.strip_prefix(_what)?.strip_prefix(':'));
    #[cfg(not(debug_assertions))]
    None
}

/// The words that the environment of a set has for its tests.
#[cfg(debug_assertions)]
fn words() -> &'static [String] {
    static WORDS: std::sync::OnceLock<Vec<String>> = std::sync::OnceLock::new();
    WORDS.get_or_init(|| {
        let list = std::env::var("FLOCKSLAM_FAILPOINTS").unwrap_or_default();
        list.split(',').filter(|word| !word.is_empty()).map(str::to_owned).collect()
    })
}
