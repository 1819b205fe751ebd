//! How good a trajectory is: against relations between pairs of its poses, or against the whole true trajectory.

mod relations;
mod spread;
mod text;
mod truth_errors;

pub use relations::{Relation, RelationGroup, RelationsReport, evaluate_relations, parse_relations};
pub use spread::Spread;
pub use text::{EvaluationError, parse_tum};
pub use truth_errors::{TruthErrors, TruthReport, evaluate_truth};
