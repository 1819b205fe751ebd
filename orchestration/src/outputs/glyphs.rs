//! A dot font: digits, the full stop, and the letters of the units m and s.

/// Rows of a glyph.
pub(super) const HEIGHT: usize = 7;

/// A character as rows of dots, from above; spaces and what has no picture are blank.
pub(super) fn glyph(character: char) -> [&'static str; HEIGHT] {
    match character {
        '0' => [" ### ", "#   #", "#   #", "#   #", "#   #", "#   #", " ### "],
        '1' => [" # ", "## ", " # ", " # ", " # ", " # ", "###"],
        '2' => [" ### ", "#   #", "    #", "   # ", "  #  ", " #   ", "#####"],
        '3' => [" ### ", "#   #", "    #", "  ## ", "    #", "#   #", " ### "],
        '4' => ["   # ", "  ## ", " # # ", "#  # ", "#####", "   # ", "   # "],
        '5' => ["#####", "#    ", "#### ", "    #", "    #", "#   #", " ### "],
        '6' => [" ### ", "#    ", "#    ", "#### ", "#   #", "#   #", " ### "],
        '7' => ["#####", "    #", "   # ", "   # ", "  #  ", "  #  ", "  #  "],
        '8' => [" ### ", "#   #", "#   #", " ### ", "#   #", "#   #", " ### "],
        '9' => [" ### ", "#   #", "#   #", " ####", "    #", "    #", " ### "],
        '.' => [" ", " ", " ", " ", " ", " ", "#"],
        'm' => ["     ", "     ", "## # ", "# # #", "# # #", "# # #", "# # #"],
        's' => ["    ", "    ", " ###", "#   ", " ## ", "   #", "### "],
        _ => ["   "; HEIGHT],
    }
}

/// Dots that a text takes in width, with one dot between characters.
pub(super) fn text_width(text: &str) -> usize {
    text.chars().map(|c| glyph(c)[0].len() + 1).sum::<usize>().saturating_sub(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_rows_of_a_glyph_are_equally_wide_and_glyphs_differ() {
        let all: Vec<_> = "0123456789.ms".chars().map(glyph).collect();
        for (i, rows) in all.iter().enumerate() {
            assert!(rows.iter().all(|row| row.len() == rows[0].len()));
            assert!(all[..i].iter().all(|other| other != rows));
        }
        assert_eq!((text_width("10"), text_width("")), (9, 0));
    }
}
