use serde::{Deserialize, Serialize};

/// What the back end can be told. The defaults are meant for any indoor robot with a 2-D lidar.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Whether poses are optimised at all; otherwise the final trajectory is the front end's.
    pub enabled: bool,
    /// Points nearer than this to the lidar are not used, metres.
    pub range_min_m: f64,
    /// Points farther than this from the lidar are not used, metres; at most 20.
    pub range_max_m: f64,
    /// A scan becomes a node of the graph after this much travel, metres …
    pub node_distance_m: f64,
    /// … or this much turning, radians.
    pub node_turn_rad: f64,
    /// Each node is matched again to this many nodes before it.
    pub chain_nodes: usize,
    /// Length of travel in a segment, the piece of the chain that closures are searched against, metres; at
    /// most 10.
    pub segment_length_m: f64,
    /// How loops are closed.
    pub closure: ClosureSettings,
    /// How many stretches through the same place, in the same direction, stay in the graph: later ones are settled relative to
    /// them, which keeps memory and work bounded in a building that is known; 0 = all stay.
    pub visits_kept: usize,
    /// How often the whole layout is measured again at the end.
    pub dense_passes: usize,
    /// How often all nodes are matched after that to the map that they make together.
    pub map_passes: u32,
    /// Each scan is placed at the end against the nodes up to this many before and after it.
    pub final_nodes: usize,
    /// A submap retires from the fused map when so many newer ones know all that it knows (98 % of it); 0 = never.
    pub retire_covered_by: usize,
    /// Whether all scans are matched once more at the end, to the map that they make together, and entered into submaps anew at the
    /// poses found: what `flockslam map --refine` does. Nothing is settled or retires in such a run.
    pub refine: bool,
    /// The robots that this one shares its map with.
    pub flock: FlockSettings,
    /// Processes of this stage: one speaks, the others know what it knows and stand by to go on in its place.
    pub replicas: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            enabled: true,
            range_min_m: 0.3,
            range_max_m: 20.0,
            node_distance_m: 0.3,
            node_turn_rad: 0.35,
            chain_nodes: 20,
            segment_length_m: 5.0,
            closure: ClosureSettings::default(),
            visits_kept: 4,
            dense_passes: 1,
            map_passes: 1,
            final_nodes: 3,
            retire_covered_by: 8,
            refine: false,
            flock: FlockSettings::default(),
            replicas: 1,
        }
    }
}

/// How loops are closed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ClosureSettings {
    /// Whether loops are closed at all.
    pub enabled: bool,
    /// A search starts after this much travel, metres.
    pub every_m: f64,
    /// Only segments that lie back at least this much travel are searched, metres.
    pub least_travel_m: f64,
    /// Most branch-and-bound searches after one closed submap.
    pub searches_per_submap: usize,
    /// Most segments tried for one query.
    pub segments_per_query: usize,
    /// Least score of a match, 0 … 1.
    pub score_min: f64,
    /// Least share of the query's points on the segment's lines after refinement.
    pub inliers_min: f64,
    /// A closure whose squared Mahalanobis error exceeds this in the solved graph does not act.
    pub chi_squared_max: f64,
}

impl Default for ClosureSettings {
    fn default() -> Self {
        Self {
            enabled: true,
            every_m: 1.5,
            least_travel_m: 15.0,
            searches_per_submap: 60,
            segments_per_query: 6,
            score_min: 0.55,
            inliers_min: 0.6,
            chi_squared_max: 16.0,
        }
    }
}

/// The robots that this one shares its map with.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FlockSettings {
    /// Name of this robot in its flock: letters, digits, `-`, `_` and `.`, at most 32; empty = it is alone and keeps no records.
    pub name: String,
}
