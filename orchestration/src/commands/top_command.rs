//! `flockslam top`: how a set is, live in a terminal.

use super::CommandError;
use super::control_command::choose;
use crate::arguments::RobotArgs;
use crate::supervisor::set_metrics_socket;
use crate::top::{TopState, draw};
use flockslam_bus::RuntimeDir;
use flockslam_telemetry::scrape;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};
use std::io::{self, IsTerminal};
use std::time::{Duration, Instant};

const PERIOD: Duration = Duration::from_secs(1);
const ANSWER_LIMIT: Duration = Duration::from_secs(1);

/// Shows a running set until `q` is pressed.
///
/// # Errors
/// When there is no such set, or no terminal to show it in.
pub fn run(args: &RobotArgs) -> Result<(), CommandError> {
    let robot = choose(args)?;
    if !io::stdout().is_terminal() {
        return Err(CommandError::user(
            "top shows itself in a terminal; for programs there is status --json",
        ));
    }
    let mut terminal = ratatui::try_init().map_err(CommandError::failed)?;
    let shown = show(&mut terminal, &robot);
    ratatui::restore();
    shown.map_err(CommandError::failed)
}

fn show(terminal: &mut ratatui::DefaultTerminal, robot: &str) -> io::Result<()> {
    let socket = set_metrics_socket(&RuntimeDir::path_of(robot));
    let (mut state, started) = (TopState::new(robot), Instant::now());
    loop {
        let looked = Instant::now();
        state.look(started.elapsed().as_secs_f64(), scrape(&socket, ANSWER_LIMIT).ok().as_deref());
        terminal.draw(|frame| draw(frame, &state))?;
        while let Some(left) = PERIOD.checked_sub(looked.elapsed()) {
            if !event::poll(left)? {
                break;
            }
            match event::read()? {
                Event::Key(key) if key.kind == KeyEventKind::Press && ends(key.code, key.modifiers) => {
                    return Ok(());
                }
                Event::Resize(..) => {
                    terminal.draw(|frame| draw(frame, &state))?;
                }
                _ => {}
            }
        }
    }
}

fn ends(code: KeyCode, modifiers: KeyModifiers) -> bool {
    matches!(code, KeyCode::Char('q') | KeyCode::Esc)
        || (code == KeyCode::Char('c') && modifiers.contains(KeyModifiers::CONTROL))
}
