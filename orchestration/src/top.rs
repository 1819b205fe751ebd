//! `flockslam top`: how a running set is, live in a terminal. What is shown is a pure function of the metrics pages that were read.

mod metrics_text;
mod top_state;
mod top_view;

pub use metrics_text::{MetricsPage, Sample};
pub use top_state::{RobotFigures, StageFigures, TopState};
pub use top_view::draw;
