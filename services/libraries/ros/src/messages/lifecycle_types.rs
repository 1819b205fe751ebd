//! The life of a managed node, and the heartbeat that its manager listens to.

use super::{Header, message, service};
use serde::{Deserialize, Serialize};

/// `lifecycle_msgs/State`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct State {
    /// Number of the state.
    pub id: u8,
    /// Its name.
    pub label: String,
}

/// `lifecycle_msgs/Transition`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Transition {
    /// Number of the transition.
    pub id: u8,
    /// Its name.
    pub label: String,
}

/// `lifecycle_msgs/TransitionDescription`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TransitionDescription {
    /// The transition.
    pub transition: Transition,
    /// Where it begins.
    pub start_state: State,
    /// Where it ends.
    pub goal_state: State,
}

message! {
    /// `lifecycle_msgs/TransitionEvent`.
    TransitionEvent = "lifecycle_msgs" {
        /// When, nanoseconds.
        timestamp: u64,
        /// What happened.
        transition: Transition,
        /// Where it began.
        start_state: State,
        /// Where it ended.
        goal_state: State,
    }
}

service! {
    /// `lifecycle_msgs/ChangeState`.
    ChangeState = "lifecycle_msgs" / "ChangeState",
    ChangeStateRequest {
        /// By its number, or else by its name.
        transition: Transition,
    },
    ChangeStateResponse {
        /// Whether it was made.
        success: bool,
    }
}

service! {
    /// `lifecycle_msgs/GetState`.
    GetState = "lifecycle_msgs" / "GetState",
    GetStateRequest {
        /// Of no meaning.
        structure_needs_at_least_one_member: u8,
    },
    GetStateResponse {
        /// The present one.
        current_state: State,
    }
}

service! {
    /// `lifecycle_msgs/GetAvailableStates`.
    GetAvailableStates = "lifecycle_msgs" / "GetAvailableStates",
    GetAvailableStatesRequest {
        /// Of no meaning.
        structure_needs_at_least_one_member: u8,
    },
    GetAvailableStatesResponse {
        /// All.
        available_states: Vec<State>,
    }
}

service! {
    /// `lifecycle_msgs/GetAvailableTransitions`: of the present state, or all in the graph.
    GetAvailableTransitions = "lifecycle_msgs" / "GetAvailableTransitions",
    GetAvailableTransitionsRequest {
        /// Of no meaning.
        structure_needs_at_least_one_member: u8,
    },
    GetAvailableTransitionsResponse {
        /// With where they begin and end.
        available_transitions: Vec<TransitionDescription>,
    }
}

/// `bond/Status`: two sides say that they are alive.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BondStatus {
    /// When.
    pub header: Header,
    /// Of the bond.
    pub id: String,
    /// Of the side that speaks.
    pub instance_id: String,
    /// Whether it keeps the bond.
    pub active: bool,
    /// A side that was silent for so long is dead, seconds.
    pub heartbeat_timeout: f32,
    /// It speaks so often, seconds.
    pub heartbeat_period: f32,
}

impl super::RosMessage for BondStatus {
    const TYPE: (&'static str, &'static str) = ("bond", "Status");
}
