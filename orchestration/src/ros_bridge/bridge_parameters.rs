//! The parameters of the bridge's node: those of slam_toolbox that have a meaning here, under their names.

use super::BridgeError;
use flockslam_ros::{NodeArguments, NodeIdentity, Parameter, ParameterValue};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Parameters of slam_toolbox and Cartographer that do nothing here are named in one line; so many of them at most.
const NAMED_MAX: usize = 12;

/// The parameters of the bridge.
#[derive(Clone, Debug)]
pub struct BridgeParameters {
    /// Frame of the map.
    pub map_frame: String,
    /// Frame of odometry: its pose of the robot is read from `/tf`.
    pub odom_frame: String,
    /// Frame of the robot.
    pub base_frame: String,
    /// Topics of the lidars.
    pub scan_topics: Vec<String>,
    /// Topic of odometry, in place of `/tf`; empty for none.
    pub odom_topic: String,
    /// Topic of an IMU; empty for none.
    pub imu_topic: String,
    /// A set that localizes does so in the map of another node, and publishes none.
    pub use_map_topic: bool,
    /// Side of a cell of the map, metres.
    pub resolution_m: f64,
    /// The bridge publishes odom → robot itself: for robots without odometry.
    pub publish_odom_transform: bool,
    /// The node waits for a manager and keeps a bond with it.
    pub use_lifecycle_manager: bool,
    /// Without a manager the node is active at once.
    pub autostart: bool,
    /// Times are those of `/clock`.
    pub use_sim_time: bool,
    /// Those that may change while the node runs.
    pub live: LiveParameters,
    /// Given, and without a meaning here.
    pub unknown: Vec<String>,
}

/// Parameters that may change while the node runs, shared with the thread that receives changes.
#[derive(Clone, Debug)]
pub struct LiveParameters {
    /// The map is published at most so often, seconds.
    pub map_update_interval_s: LiveNumber,
    /// map → odom is stamped so much ahead of the newest scan, seconds.
    pub transform_timeout_s: LiveNumber,
    /// Between scans map → odom is published so often, seconds; 0 for never.
    pub transform_publish_period_s: LiveNumber,
    /// Small corrections move the robot by at most this, metres a second; 0 for any.
    pub max_correction_rate_m_s: LiveNumber,
}

/// A number that another thread may change.
#[derive(Clone, Debug)]
pub struct LiveNumber(Arc<AtomicU64>);

impl LiveNumber {
    fn new(value: f64) -> Self {
        Self(Arc::new(AtomicU64::new(value.to_bits())))
    }

    /// The value.
    pub fn get(&self) -> f64 {
        f64::from_bits(self.0.load(Ordering::Relaxed))
    }

    fn set(&self, value: f64) {
        self.0.store(value.to_bits(), Ordering::Relaxed);
    }
}

impl Default for BridgeParameters {
    fn default() -> Self {
        Self {
            map_frame: "map".to_owned(),
            odom_frame: "odom".to_owned(),
            base_frame: "base_footprint".to_owned(),
            scan_topics: vec!["scan".to_owned()],
            odom_topic: String::new(),
            imu_topic: String::new(),
            use_map_topic: false,
            resolution_m: 0.05,
            publish_odom_transform: false,
            use_lifecycle_manager: false,
            autostart: true,
            use_sim_time: false,
            live: LiveParameters {
                map_update_interval_s: LiveNumber::new(5.0),
                transform_timeout_s: LiveNumber::new(0.2),
                transform_publish_period_s: LiveNumber::new(0.05),
                max_correction_rate_m_s: LiveNumber::new(0.0),
            },
            unknown: Vec::new(),
        }
    }
}

impl BridgeParameters {
    /// The parameters that a command line gives the node.
    ///
    /// # Errors
    /// When a file cannot be used, or a value has another type.
    pub fn of(arguments: &NodeArguments, node: &NodeIdentity) -> Result<Self, BridgeError> {
        let mut parameters = Self::default();
        for (name, value) in arguments.parameters(node)? {
            parameters.set(&name, value).map_err(|reason| BridgeError::Parameter { name, reason })?;
        }
        Ok(parameters)
    }

    fn set(&mut self, name: &str, value: ParameterValue) -> Result<(), String> {
        match name {
            "map_frame" => self.map_frame = text(value)?,
            "odom_frame" => self.odom_frame = text(value)?,
            "base_frame" => self.base_frame = text(value)?,
            "scan_topic" => self.scan_topics = vec![text(value)?],
            "scan_topics" => self.scan_topics = texts(value)?,
            "odom_topic" => self.odom_topic = text(value)?,
            "imu_topic" => self.imu_topic = text(value)?,
            "use_map_topic" => self.use_map_topic = truth(value)?,
            "resolution" => self.resolution_m = within(&value, [0.01, 1.0])?,
            "publish_odom_transform" => self.publish_odom_transform = truth(value)?,
            "use_lifecycle_manager" => self.use_lifecycle_manager = truth(value)?,
            "autostart" => self.autostart = truth(value)?,
            "use_sim_time" => self.use_sim_time = truth(value)?,
            name => match self.live.find(name) {
                Some((number, range)) => number.set(within(&value, range)?),
                None => self.unknown.push(name.to_owned()),
            },
        }
        Ok(())
    }

    /// One line about the parameters that have no meaning here; `None` where there are none.
    pub fn unknown_line(&self) -> Option<String> {
        let more = self.unknown.len().saturating_sub(NAMED_MAX);
        let named = self.unknown.iter().take(NAMED_MAX).cloned().collect::<Vec<_>>().join(", ");
        let rest = if more > 0 { format!(" and {more} more") } else { String::new() };
        (!named.is_empty()).then(|| format!("parameters without a meaning here: {named}{rest}"))
    }

    /// The parameters as the node declares them.
    pub fn declared(&self) -> Vec<Parameter> {
        let fixed =
            |name: &str, value: ParameterValue| Parameter { name: name.to_owned(), value, change: None };
        let text = |name: &str, value: &str| fixed(name, ParameterValue::Text(value.to_owned()));
        let truth = |name: &str, value: bool| fixed(name, ParameterValue::Boolean(value));
        let mut declared = vec![
            text("map_frame", &self.map_frame),
            text("odom_frame", &self.odom_frame),
            text("base_frame", &self.base_frame),
            text("scan_topic", self.scan_topics.first().map_or("", String::as_str)),
            fixed("scan_topics", ParameterValue::Texts(self.scan_topics.clone())),
            text("odom_topic", &self.odom_topic),
            text("imu_topic", &self.imu_topic),
            truth("use_map_topic", self.use_map_topic),
            truth("publish_odom_transform", self.publish_odom_transform),
            truth("use_lifecycle_manager", self.use_lifecycle_manager),
            truth("autostart", self.autostart),
            truth("use_sim_time", self.use_sim_time),
            fixed("resolution", ParameterValue::Double(self.resolution_m)),
        ];
        for name in LiveParameters::NAMES {
            let (number, range) = self.live.find(name).expect("its names are known");
            let number = number.clone();
            declared.push(Parameter {
                name: name.to_owned(),
                value: ParameterValue::Double(number.get()),
                change: Some(Box::new(move |value| {
                    number.set(within(value, range)?);
                    Ok(())
                })),
            });
        }
        declared
    }
}

impl LiveParameters {
    const NAMES: [&str; 4] =
        ["map_update_interval", "transform_timeout", "transform_publish_period", "max_correction_rate"];

    /// A parameter by its name, and its least and greatest value.
    fn find(&self, name: &str) -> Option<(&LiveNumber, [f64; 2])> {
        match name {
            "map_update_interval" => Some((&self.map_update_interval_s, [0.1, 3600.0])),
            "transform_timeout" => Some((&self.transform_timeout_s, [0.0, 10.0])),
            "transform_publish_period" => Some((&self.transform_publish_period_s, [0.0, 1.0])),
            "max_correction_rate" => Some((&self.max_correction_rate_m_s, [0.0, 10.0])),
            _ => None,
        }
    }
}

fn text(value: ParameterValue) -> Result<String, String> {
    match value {
        ParameterValue::Text(text) => Ok(text),
        other => Err(format!("{other:?} is not a text")),
    }
}

fn texts(value: ParameterValue) -> Result<Vec<String>, String> {
    match value {
        ParameterValue::Texts(texts) if !texts.is_empty() => Ok(texts),
        other => Err(format!("{other:?} is not a list of texts")),
    }
}

fn truth(value: ParameterValue) -> Result<bool, String> {
    match value {
        ParameterValue::Boolean(value) => Ok(value),
        other => Err(format!("{other:?} is not true or false")),
    }
}

fn within(value: &ParameterValue, [least, greatest]: [f64; 2]) -> Result<f64, String> {
    match value.number() {
        Some(number) if (least..=greatest).contains(&number) => Ok(number),
        Some(number) => Err(format!("{number} is not between {least} and {greatest}")),
        None => Err(format!("{value:?} is not a number")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(arguments: &str) -> Result<BridgeParameters, String> {
        let arguments: Vec<String> = arguments.split(' ').map(str::to_owned).collect();
        let arguments = NodeArguments::parse(&arguments).unwrap();
        let node = NodeIdentity::new("flockslam", Vec::new()).unwrap();
        BridgeParameters::of(&arguments, &node).map_err(|error| error.to_string())
    }

    #[test]
    fn parameters_have_the_names_of_slam_toolbox() {
        let given =
            of("-p odom_frame:=r1/odom -p scan_topic:=/front -p transform_timeout:=0 -p solver_plugin:=x");
        let given = given.unwrap();
        assert_eq!((given.odom_frame.as_str(), given.scan_topics), ("r1/odom", vec!["/front".to_owned()]));
        assert_eq!(
            (given.live.transform_timeout_s.get(), given.unknown),
            (0.0, vec!["solver_plugin".to_owned()])
        );
    }

    #[test]
    fn what_has_no_sense_is_refused_with_its_name() {
        assert_eq!(
            of("-p base_frame:=3").err().unwrap(),
            "the parameter base_frame: Integer(3) is not a text"
        );
        let error = of("-p transform_timeout:=-1.0").err().unwrap();
        assert_eq!(error, "the parameter transform_timeout: -1 is not between 0 and 10");
    }

    #[test]
    fn only_some_may_change_while_the_node_runs() {
        let parameters = BridgeParameters::default();
        let declared = parameters.declared();
        let change = |name: &str| declared.iter().find(|known| known.name == name).unwrap().change.as_ref();
        assert!(change("odom_frame").is_none() && change("resolution").is_none());
        let change = change("map_update_interval").unwrap();
        change(&ParameterValue::Integer(2)).unwrap();
        assert_eq!(parameters.live.map_update_interval_s.get(), 2.0);
        assert!(change(&ParameterValue::Double(0.0)).is_err());
    }
}
