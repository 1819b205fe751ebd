//! A scan as text, for a terminal that is only written to.

use crate::lidar_view::{LidarPicture, draw};
use ratatui::Terminal;
use ratatui::backend::TestBackend;

/// Characters of the picture.
const COLUMNS: u16 = 72;
const ROWS: u16 = 26;

/// Draws the last scan: ahead is up, left is left, the lidar in the middle.
pub fn scan_picture(picture: &LidarPicture) -> String {
    let mut terminal = Terminal::new(TestBackend::new(COLUMNS, ROWS)).expect("memory takes any picture");
    terminal.draw(|frame| draw(frame, picture)).expect("memory takes any picture");
    let buffer = terminal.backend().buffer();
    let mut text = String::new();
    // The last line names keys that have no effect here.
    for row in 0..ROWS - 1 {
        let line: String = (0..COLUMNS).map(|column| buffer[(column, row)].symbol()).collect();
        text.push_str(line.trim_end());
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_messages::ScanBuffer;

    #[test]
    fn a_picture_without_a_scan_has_a_text() {
        let mut picture = LidarPicture::default();
        picture.show(&ScanBuffer::default());
        let text = scan_picture(&picture);
        assert_eq!(text.lines().count(), usize::from(ROWS) - 1);
        assert!(text.starts_with("no scan yet") || text.starts_with("turn 1"), "{text}");
    }
}
