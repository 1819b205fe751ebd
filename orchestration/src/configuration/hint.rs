//! Proposes the nearest known name for an unknown one.

use strsim::levenshtein;

/// Adds "did you mean …?" to a message about an unknown field, when one of the expected names is close to it.
pub fn with_hint(message: &str) -> String {
    let names: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
    let unknown = message.starts_with("unknown field") || message.starts_with("unknown variant");
    let (Some((wrong, expected)), true) = (names.split_first(), unknown) else { return message.to_owned() };
    let nearest = expected.iter().min_by_key(|name| levenshtein(wrong, name));
    match nearest {
        Some(name) if levenshtein(wrong, name) <= 1 + wrong.len() / 3 => {
            format!("{message}; did you mean `{name}`?")
        }
        _ => message.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_near_names_are_proposed() {
        let message = "unknown field `cel`, expected one of `cell`, `hit`";
        assert!(with_hint(message).ends_with("did you mean `cell`?"));
        let far = "unknown field `zebra`, expected one of `cell`, `hit`";
        assert_eq!(with_hint(far), far);
        assert_eq!(with_hint("invalid type"), "invalid type");
    }
}
