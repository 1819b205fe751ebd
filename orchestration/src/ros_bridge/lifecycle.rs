//! The states of a managed node and the transitions between them. Pure.

use flockslam_ros::messages::{State, Transition, TransitionDescription};
use serde::{Deserialize, Serialize};

/// The state of a managed node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NodeState {
    /// It does nothing.
    Unconfigured,
    /// It is ready.
    Inactive,
    /// It works.
    Active,
    /// It never works again.
    Finalized,
}

/// A transition that was made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Made {
    /// Number and name.
    pub transition: (u8, &'static str),
    /// Where it began.
    pub from: NodeState,
    /// Where it ended.
    pub to: NodeState,
}

use NodeState::{Active, Finalized, Inactive, Unconfigured};

/// Numbers and names are those of `lifecycle_msgs/Transition`.
const TRANSITIONS: [Made; 7] = [
    Made { transition: (1, "configure"), from: Unconfigured, to: Inactive },
    Made { transition: (2, "cleanup"), from: Inactive, to: Unconfigured },
    Made { transition: (3, "activate"), from: Inactive, to: Active },
    Made { transition: (4, "deactivate"), from: Active, to: Inactive },
    Made { transition: (5, "shutdown"), from: Unconfigured, to: Finalized },
    Made { transition: (6, "shutdown"), from: Inactive, to: Finalized },
    Made { transition: (7, "shutdown"), from: Active, to: Finalized },
];

impl NodeState {
    const ALL: [NodeState; 4] = [Unconfigured, Inactive, Active, Finalized];

    /// As a message.
    pub fn message(self) -> State {
        let (id, label) = match self {
            Unconfigured => (1, "unconfigured"),
            Inactive => (2, "inactive"),
            Active => (3, "active"),
            Finalized => (4, "finalized"),
        };
        State { id, label: label.to_owned() }
    }

    /// All states, as messages.
    pub fn messages() -> Vec<State> {
        Self::ALL.map(Self::message).into()
    }

    /// The transition that is requested by its number, or else by its name; `None` when it does not begin in this state.
    pub fn transition(self, asked: &Transition) -> Option<Made> {
        let by_name = asked.id == 0 && !asked.label.is_empty();
        let is_requested = |made: &Made| {
            if by_name { made.transition.1 == asked.label } else { made.transition.0 == asked.id }
        };
        TRANSITIONS.into_iter().find(|made| made.from == self && is_requested(made))
    }

    /// The transitions that begin in this state, as messages.
    pub fn available(self) -> Vec<TransitionDescription> {
        TRANSITIONS.into_iter().filter(|made| made.from == self).map(Made::message).collect()
    }

    /// All transitions, as messages.
    pub fn graph() -> Vec<TransitionDescription> {
        TRANSITIONS.into_iter().map(Made::message).collect()
    }
}

impl Made {
    /// As a message.
    pub fn message(self) -> TransitionDescription {
        let (id, label) = self.transition;
        TransitionDescription {
            transition: Transition { id, label: label.to_owned() },
            start_state: self.from.message(),
            goal_state: self.to.message(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn by_number(id: u8) -> Transition {
        Transition { id, label: String::new() }
    }

    #[test]
    fn a_manager_takes_a_node_up_and_down() {
        let mut state = Unconfigured;
        for (id, expected) in [(1, Inactive), (3, Active), (4, Inactive), (2, Unconfigured), (5, Finalized)] {
            state = state.transition(&by_number(id)).unwrap().to;
            assert_eq!(state, expected);
        }
        assert!(Finalized.available().is_empty());
    }

    #[test]
    fn a_transition_begins_in_its_state_only_and_may_be_named() {
        for (state, id) in [(Unconfigured, 3), (Active, 1), (Inactive, 1), (Finalized, 5), (Active, 99)] {
            assert_eq!(state.transition(&by_number(id)), None, "{state:?} {id}");
        }
        let named = Transition { id: 0, label: "shutdown".to_owned() };
        assert_eq!(Active.transition(&named).unwrap().transition, (7, "shutdown"));
        assert_eq!(Inactive.available().len(), 3);
        assert_eq!(NodeState::graph().len(), 7);
        let ids: Vec<_> = NodeState::messages().into_iter().map(|state| state.id).collect();
        assert_eq!(ids, [1, 2, 3, 4]);
    }
}
