//! How good a trajectory is: against relations between pairs of its poses, or against the whole true trajectory.

mod relations;
mod spread;
mod text;
mod truth;

pub use relations::{Relation, RelationGroup, RelationsReport, evaluate_relations, parse_relations};
pub use spread::Spread;
pub use text::{EvaluationError, parse_tum};
pub use truth::{TruthErrors, TruthReport, evaluate_truth};
