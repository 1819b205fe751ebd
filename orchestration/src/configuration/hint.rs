//! Proposes the nearest known name for an unknown one, by Levenshtein distance.

/// Adds "did you mean …?" to a message about an unknown field, when one of the expected names is close to it.
pub fn with_hint(message: &str) -> String {
    let names: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
    let unknown = message.starts_with("unknown field") || message.starts_with("unknown variant");
    let (Some((wrong, expected)), true) = (names.split_first(), unknown) else { return message.to_owned() };
    let nearest = expected.iter().min_by_key(|name| distance(wrong, name));
    match nearest {
        Some(name) if distance(wrong, name) <= 1 + wrong.len() / 3 => {
            format!("{message}; did you mean `{name}`?")
        }
        _ => message.to_owned(),
    }
}

/// Levenshtein distance: insertions, deletions and replacements that make `b` of `a`.
fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, from) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, to) in b.iter().enumerate() {
            let replaced = diagonal + usize::from(from != *to);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_count_edits() {
        assert_eq!(distance("cell", "cell"), 0);
        assert_eq!(distance("cel", "cell"), 1);
        assert_eq!(distance("strategie", "strategy"), 2);
        assert_eq!(distance("", "abc"), 3);
    }

    #[test]
    fn only_near_names_are_proposed() {
        let message = "unknown field `cel`, expected one of `cell`, `hit`";
        assert!(with_hint(message).ends_with("did you mean `cell`?"));
        let far = "unknown field `zebra`, expected one of `cell`, `hit`";
        assert_eq!(with_hint(far), far);
        assert_eq!(with_hint("invalid type"), "invalid type");
    }
}
