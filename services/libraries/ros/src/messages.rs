//! The messages and services that are supported here, field by field as their definitions have them.

mod common_types;
mod diagnostic_types;
mod initial_pose;
mod lifecycle_types;
mod map_types;
mod marker_types;
mod parameter_types;
mod sensor_types;
mod service_types;
mod transform_types;

pub use common_types::*;
pub use diagnostic_types::*;
pub use initial_pose::InitialPose;
pub use lifecycle_types::*;
pub use map_types::*;
pub use marker_types::*;
pub use parameter_types::*;
pub use sensor_types::*;
pub use service_types::*;
pub use transform_types::*;

use serde::Serialize;
use serde::de::DeserializeOwned;

/// A message with the name of its type.
pub trait RosMessage: Serialize + DeserializeOwned + Send + Sync + 'static {
    /// Package and name.
    const TYPE: (&'static str, &'static str);
}

/// A service with the name of its type.
pub trait RosService: 'static {
    /// Package and name.
    const TYPE: (&'static str, &'static str);
    /// The request.
    type Request: ros2_client::Message + Clone + Send + Sync;
    /// What is answered.
    type Response: ros2_client::Message + Send + Sync;
}

/// Defines a message: its fields in the order of its definition.
macro_rules! message {
    ($(#[$doc:meta])* $name:ident = $package:literal { $($(#[$field_doc:meta])* $field:ident: $type:ty),* $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
        pub struct $name {
            $($(#[$field_doc])* pub $field: $type),*
        }

        impl crate::messages::RosMessage for $name {
            const TYPE: (&'static str, &'static str) = ($package, stringify!($name));
        }

        impl ros2_client::Message for $name {}
    };
}

/// Defines a service. A part without fields has one byte, as in ROS.
macro_rules! service {
    (
        $(#[$doc:meta])* $name:ident = $package:literal / $type:literal,
        $request:ident { $($(#[$request_doc:meta])* $request_field:ident: $request_type:ty),* $(,)? },
        $response:ident { $($(#[$response_doc:meta])* $response_field:ident: $response_type:ty),* $(,)? }
    ) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug)]
        pub enum $name {}

        #[doc = concat!("Request of [`", stringify!($name), "`].")]
        #[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
        pub struct $request {
            $($(#[$request_doc])* pub $request_field: $request_type),*
        }

        #[doc = concat!("Response of [`", stringify!($name), "`].")]
        #[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
        pub struct $response {
            $($(#[$response_doc])* pub $response_field: $response_type),*
        }

        impl ros2_client::Message for $request {}
        impl ros2_client::Message for $response {}

        impl crate::messages::RosService for $name {
            const TYPE: (&'static str, &'static str) = ($package, $type);
            type Request = $request;
            type Response = $response;
        }
    };
}

pub(crate) use {message, service};
