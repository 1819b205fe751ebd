//! Draws scans of a lidar in the terminal.

use flockslam_geometry::elementary::{cos, sin};
use flockslam_messages::{ScanBuffer, ScanView};
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout};
use ratatui::style::Color;
use ratatui::symbols::Marker;
use ratatui::widgets::Paragraph;
use ratatui::widgets::canvas::{Canvas, Points};

/// What is shown at first, metres from the lidar to each side.
const REACH_M: f64 = 6.0;
/// Cells of a terminal are so much higher than wide.
const CELL_RATIO: f64 = 2.0;

/// The last scan, and what is to be said of it.
pub struct LidarPicture {
    points: Vec<(f64, f64)>,
    caption: String,
    note: String,
    turns: u64,
    last_ns: Option<i64>,
    reach_m: f64,
}

impl Default for LidarPicture {
    fn default() -> Self {
        Self {
            points: Vec::new(),
            caption: "no scan yet".to_owned(),
            note: String::new(),
            turns: 0,
            last_ns: None,
            reach_m: REACH_M,
        }
    }
}

impl LidarPicture {
    /// Shows a scan.
    pub fn show(&mut self, scan: &ScanBuffer) {
        let Ok(view) = scan.view() else { return };
        self.turns += 1;
        self.points.clear();
        let mut nearest: Option<(f64, f64)> = None;
        for beam in 0..view.len() {
            let Some(range_m) = view.valid_range_m(beam) else { continue };
            let angle_rad = view.angle_rad(beam);
            self.points.push((range_m * cos(angle_rad), range_m * sin(angle_rad)));
            if nearest.is_none_or(|(nearest_m, _)| range_m < nearest_m) {
                nearest = Some((range_m, angle_rad));
            }
        }
        self.caption = caption(self.turns, view, self.points.len(), nearest, self.rate_hz(view));
    }

    fn rate_hz(&mut self, view: ScanView<'_>) -> Option<f64> {
        let stamp_ns = view.header().times.sensor_ns;
        let last_ns = self.last_ns.replace(stamp_ns)?;
        Some(1e9 / (stamp_ns - last_ns) as f64).filter(|rate| rate.is_finite() && *rate > 0.0)
    }

    /// Says something beside the picture.
    pub fn note(&mut self, note: String) {
        self.note = note;
    }

    /// Shows so many times as much around the lidar.
    pub fn zoom(&mut self, times: f64) {
        self.reach_m = (self.reach_m * times).clamp(0.5, 100.0);
    }

    /// One line on the last scan.
    pub fn caption(&self) -> &str {
        &self.caption
    }

    /// Scans so far.
    pub fn turns(&self) -> u64 {
        self.turns
    }
}

fn caption(
    turns: u64,
    view: ScanView<'_>,
    returns: usize,
    nearest: Option<(f64, f64)>,
    rate_hz: Option<f64>,
) -> String {
    let nearest = nearest.map_or("nothing near".to_owned(), |(range_m, angle_rad)| {
        format!("nearest {range_m:.2} m at {:.0}°", angle_rad.to_degrees())
    });
    let rate = rate_hz.map_or_else(String::new, |rate_hz| format!(", {rate_hz:.1} Hz"));
    format!("turn {turns}{rate}: {} beams, {returns} returns, {nearest}", view.len())
}

/// Draws the picture: ahead is up, left is left.
pub fn draw(frame: &mut Frame<'_>, picture: &LidarPicture) {
    let heights = [Constraint::Length(2), Constraint::Min(5), Constraint::Length(1)];
    let [head, plane, foot] = Layout::vertical(heights).areas(frame.area());
    frame.render_widget(Paragraph::new(format!("{}\n{}", picture.caption, picture.note)), head);
    let aspect = f64::from(plane.width) / (CELL_RATIO * f64::from(plane.height.max(1)));
    let (reach_x_m, reach_y_m) = (picture.reach_m * aspect.max(1.0), picture.reach_m / aspect.min(1.0));
    let seen: Vec<(f64, f64)> = picture.points.iter().map(|(ahead_m, left_m)| (-left_m, *ahead_m)).collect();
    let canvas = Canvas::default()
        .marker(Marker::Braille)
        .x_bounds([-reach_x_m, reach_x_m])
        .y_bounds([-reach_y_m, reach_y_m])
        .paint(|context| {
            context.draw(&Points { coords: &seen, color: Color::White });
            context.draw(&Points { coords: &[(0.0, 0.0)], color: Color::Green });
        });
    frame.render_widget(canvas, plane);
    frame.render_widget(
        Paragraph::new("q quits, + and - zoom; the lidar is in the middle, ahead is up"),
        foot,
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    #[test]
    fn a_wall_ahead_is_drawn_above_the_middle_and_reported() {
        let ranges: Vec<f32> =
            (-30..=30).map(|degree: i32| 3.0 / (degree as f32).to_radians().cos()).collect();
        let mut scan = ScanBuffer::from_ranges(&ranges, -30f64.to_radians(), 1f64.to_radians());
        scan.header.times.sensor_ns = 1_000_000_000;
        let mut picture = LidarPicture::default();
        picture.show(&scan);
        scan.header.times.sensor_ns += 100_000_000;
        picture.show(&scan);
        assert_eq!(picture.caption(), "turn 2, 10.0 Hz: 61 beams, 61 returns, nearest 3.00 m at 0°");
        let mut terminal = Terminal::new(TestBackend::new(60, 33)).unwrap();
        terminal.draw(|frame| draw(frame, &picture)).unwrap();
        let buffer = terminal.backend().buffer();
        let dots = |rows: std::ops::Range<u16>| {
            let cells = rows.flat_map(|y| (0..60).map(move |x| (x, y)));
            cells.filter(|at| !matches!(buffer[*at].symbol(), " " | "\u{2800}")).count()
        };
        assert!(dots(3..16) > 10, "the wall");
        assert!(dots(19..32) == 0, "nothing is behind");
    }
}
