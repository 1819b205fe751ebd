//! `flockslam top`: how a running set is, live in a terminal. What is shown is a pure function of the metrics pages that were read.

mod page;
mod state;
mod view;

pub use page::{MetricsPage, Sample};
pub use state::{RobotFigures, StageFigures, TopState};
pub use view::draw;
