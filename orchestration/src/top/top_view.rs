//! Draws a [`TopState`] on a terminal: three lines on the robot, a table with one row for each stage, and a sparkline of latencies.

use super::{RobotFigures, StageFigures, TopState};
use flockslam_geometry::elementary::ln;
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Cell, Paragraph, Row, Table};
use std::collections::VecDeque;

const BARS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
const COLUMNS: [(&str, u16); 11] = [
    ("stage", 18),
    ("state", 9),
    ("scans/s", 8),
    ("median", 8),
    ("99 %", 8),
    ("waiting", 7),
    ("dropped", 12),
    ("restarts", 8),
    ("hangs", 5),
    ("cpu", 6),
    ("memory", 8),
];

/// Draws the state of a set.
pub fn draw(frame: &mut Frame<'_>, state: &TopState) {
    let heights = [3, state.stages.len() as u16 + 2, 1].map(Constraint::Length);
    let [head, table, foot] = Layout::vertical(heights).areas(frame.area());
    frame.render_widget(Paragraph::new(header(state)), head);
    let widths = COLUMNS.iter().map(|(_, width)| Constraint::Length(*width)).chain([Constraint::Min(10)]);
    let titles = COLUMNS.iter().map(|(title, _)| *title).chain(["scan to output"]);
    // What is left beside the other columns and the blanks between them.
    let used: u16 = COLUMNS.iter().map(|(_, width)| width + 1).sum();
    let spark_width = usize::from(table.width.saturating_sub(used)).max(10);
    let rows = state.stages.iter().map(|stage| row(stage, spark_width));
    let bold = Style::new().add_modifier(Modifier::BOLD);
    frame.render_widget(Table::new(rows, widths).header(Row::new(titles).style(bold)), table);
    frame.render_widget(Paragraph::new("q quits"), foot);
}

fn header(state: &TopState) -> Vec<Line<'_>> {
    let RobotFigures { qualities, score, closures, submaps, area_m2, shared_memory_bytes, not_durable } =
        &state.figures;
    let condition = match (state.answers, *not_durable) {
        (false, _) => Span::styled("does not answer", alarm()),
        (true, true) => Span::styled("NOT DURABLE: the map cannot be saved", alarm()),
        (true, false) => Span::raw("answers"),
    };
    let name = Span::styled(format!("{} ", state.robot), Style::new().add_modifier(Modifier::BOLD));
    let [tracking, degraded, lost] = qualities;
    let [tried, accepted, revoked] = closures;
    vec![
        Line::from(vec![name, condition]),
        Line::from(format!(
            "poses: {tracking:.0} tracking, {degraded:.0} degraded, {lost:.0} lost since the last look; score {}",
            score.map_or("-".to_owned(), |score| format!("{score:.2}"))
        )),
        Line::from(format!(
            "map: {area_m2:.0} m², {submaps:.0} submaps; closures: {tried:.0} tried, {accepted:.0} accepted, {revoked:.0} revoked; \
             shared memory {}",
            bytes(*shared_memory_bytes)
        )),
    ]
}

fn row(stage: &StageFigures, spark_width: usize) -> Row<'_> {
    let (condition, style) = match (stage.degraded, stage.up) {
        (true, _) => ("DEGRADED", alarm()),
        (false, false) => ("down", alarm()),
        (false, true) if stage.silent_s > 1.0 => ("silent", alarm()),
        (false, true) => ("running", Style::new()),
    };
    let (median, p99) = match stage.latency_s {
        Some((median_s, p99_s)) => (seconds(median_s), seconds(p99_s)),
        None => ("-".to_owned(), "-".to_owned()),
    };
    let (dropped, lately) = stage.dropped;
    let dropped = if lately > 0.0 { format!("{dropped:.0} +{lately:.0}") } else { format!("{dropped:.0}") };
    Row::new([
        Cell::from(stage.name.as_str()),
        Cell::from(condition).style(style),
        Cell::from(format!("{:.1}", stage.rate_hz)),
        Cell::from(median),
        Cell::from(p99),
        Cell::from(format!("{:.0}", stage.waiting)),
        Cell::from(dropped),
        Cell::from(format!("{:.0}", stage.restarts)),
        Cell::from(format!("{:.0}", stage.hangs)),
        Cell::from(format!("{:.1} %", 100.0 * stage.cpu)),
        Cell::from(bytes(stage.memory_bytes)),
        Cell::from(sparkline(&stage.history_s, spark_width)),
    ])
}

fn alarm() -> Style {
    Style::new().fg(Color::Red).add_modifier(Modifier::BOLD)
}

/// The last `width` values as bars, a blank where there is none, between the smallest and the greatest of them by their logarithm:
/// latencies differ by factors. Steady values are low bars.
fn sparkline(history: &VecDeque<Option<f64>>, width: usize) -> String {
    let shown: Vec<_> = history.iter().skip(history.len().saturating_sub(width)).copied().collect();
    let logarithm = |value: f64| ln(value.max(1e-9));
    let logarithms = || shown.iter().flatten().map(|value| logarithm(*value));
    let low = logarithms().fold(f64::INFINITY, f64::min);
    // Anything below a factor of two looks level.
    let span = (logarithms().fold(f64::NEG_INFINITY, f64::max) - low).max(std::f64::consts::LN_2);
    let bar = |value: f64| {
        let place = (logarithm(value) - low) / span * (BARS.len() - 1) as f64;
        BARS[(place.round() as usize).min(BARS.len() - 1)]
    };
    shown.iter().map(|value| value.map_or(' ', bar)).collect()
}

fn seconds(value_s: f64) -> String {
    match value_s {
        v if v < 1e-3 => format!("{:.0} µs", 1e6 * v),
        v if v < 1.0 => format!("{:.1} ms", 1e3 * v),
        v => format!("{v:.2} s"),
    }
}

fn bytes(value: f64) -> String {
    match value {
        v if v < 1024.0 * 1024.0 => format!("{:.0} KiB", v / 1024.0),
        v => format!("{:.1} MiB", v / (1024.0 * 1024.0)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    fn shown(state: &TopState, width: u16) -> Vec<String> {
        let mut terminal = Terminal::new(TestBackend::new(width, 14)).unwrap();
        terminal.draw(|frame| draw(frame, state)).unwrap();
        let buffer = terminal.backend().buffer().clone();
        let line = |y| (0..width).map(|x| buffer[(x, y)].symbol()).collect::<String>();
        (0..14).map(line).collect()
    }

    fn state() -> TopState {
        let mut state = TopState::new("r1");
        state.answers = true;
        state.figures.score = Some(0.87);
        state.figures.area_m2 = 1234.0;
        let stage = |name: &str| StageFigures { name: name.to_owned(), up: true, ..StageFigures::default() };
        state.stages = vec![stage("lidar-ingest"), stage("scan-matcher"), stage("mapper")];
        state.stages[1].rate_hz = 10.0;
        state.stages[1].latency_s = Some((350e-6, 0.0021));
        state.stages[1].history_s = [Some(1e-4), None, Some(1.5e-3), Some(1e-2)].into();
        state.stages[1].dropped = (12.0, 3.0);
        state.stages[2].up = false;
        state.stages[2].restarts = 4.0;
        state
    }

    #[test]
    fn stages_latencies_drops_and_restarts_are_shown() {
        let lines = shown(&state(), 140);
        assert!(lines[0].starts_with("r1 answers"), "{}", lines[0]);
        assert!(lines[1].contains("score 0.87") && lines[2].contains("1234 m²"), "{lines:?}");
        let line = |name: &str| lines.iter().find(|line| line.starts_with(name)).unwrap();
        for word in ["running", "10.0", "350 µs", "2.1 ms", "12 +3", "▁ ▅█"] {
            assert!(line("scan-matcher").contains(word), "{word}: {}", line("scan-matcher"));
        }
        assert!(line("mapper").contains("down") && line("mapper").contains(" 4 "), "{}", line("mapper"));
        assert!(lines.iter().any(|line| line.starts_with("q quits")));
    }

    #[test]
    fn a_set_that_does_not_answer_and_narrow_terminals_are_no_problem() {
        let mut silent = state();
        silent.answers = false;
        assert!(shown(&silent, 100)[0].starts_with("r1 does not answer"));
        for width in [1, 20, 60] {
            shown(&state(), width);
        }
        assert_eq!(sparkline(&VecDeque::new(), 10), "");
        assert_eq!(sparkline(&[Some(1.0), Some(1.1), Some(1.0)].into(), 2), "▂▁");
    }
}
