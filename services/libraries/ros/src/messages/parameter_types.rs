//! The parameters of a node.

use super::{Time, message, service};
use crate::ParameterValue;
use serde::{Deserialize, Serialize};

/// `rcl_interfaces/ParameterValue`: only the field that the type names has a meaning.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AnyValue {
    /// Type: 0 for none, then boolean, integer, double, text, and arrays of bytes and of these.
    pub kind: u8,
    /// Type 1.
    pub boolean: bool,
    /// Type 2.
    pub integer: i64,
    /// Type 3.
    pub double: f64,
    /// Type 4.
    pub text: String,
    /// Type 5.
    pub bytes: Vec<u8>,
    /// Type 6.
    pub booleans: Vec<bool>,
    /// Type 7.
    pub integers: Vec<i64>,
    /// Type 8.
    pub doubles: Vec<f64>,
    /// Type 9.
    pub texts: Vec<String>,
}

impl From<&ParameterValue> for AnyValue {
    fn from(value: &ParameterValue) -> Self {
        let none = Self::default();
        match value.clone() {
            ParameterValue::Boolean(boolean) => Self { kind: 1, boolean, ..none },
            ParameterValue::Integer(integer) => Self { kind: 2, integer, ..none },
            ParameterValue::Double(double) => Self { kind: 3, double, ..none },
            ParameterValue::Text(text) => Self { kind: 4, text, ..none },
            ParameterValue::Texts(texts) => Self { kind: 9, texts, ..none },
        }
    }
}

impl AnyValue {
    /// The value, where a parameter here can have it.
    pub fn value(&self) -> Option<ParameterValue> {
        match self.kind {
            1 => Some(ParameterValue::Boolean(self.boolean)),
            2 => Some(ParameterValue::Integer(self.integer)),
            3 => Some(ParameterValue::Double(self.double)),
            4 => Some(ParameterValue::Text(self.text.clone())),
            9 => Some(ParameterValue::Texts(self.texts.clone())),
            _ => None,
        }
    }
}

/// `rcl_interfaces/Parameter`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NamedValue {
    /// Name.
    pub name: String,
    /// Value.
    pub value: AnyValue,
}

/// `rcl_interfaces/SetParametersResult`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SetParametersResult {
    /// Whether it was taken over.
    pub successful: bool,
    /// Why not.
    pub reason: String,
}

/// `rcl_interfaces/ListParametersResult`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ListParametersResult {
    /// Names.
    pub names: Vec<String>,
    /// Parts of names before a dot.
    pub prefixes: Vec<String>,
}

/// `rcl_interfaces/ParameterDescriptor`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ParameterDescriptor {
    /// Name.
    pub name: String,
    /// Type, as in [`AnyValue`].
    pub kind: u8,
    /// For people.
    pub description: String,
    /// For people.
    pub additional_constraints: String,
    /// It stays as it is.
    pub read_only: bool,
    /// Its type may change.
    pub dynamic_typing: bool,
    /// From, to, step.
    pub floating_point_range: Vec<[f64; 3]>,
    /// From, to, step.
    pub integer_range: Vec<(i64, i64, u64)>,
}

message! {
    /// `rcl_interfaces/ParameterEvent`.
    ParameterEvent = "rcl_interfaces" {
        /// When.
        stamp: Time,
        /// Full name of the node.
        node: String,
        /// Declared.
        new_parameters: Vec<NamedValue>,
        /// Changed.
        changed_parameters: Vec<NamedValue>,
        /// Gone.
        deleted_parameters: Vec<NamedValue>,
    }
}

service! {
    /// `rcl_interfaces/GetParameters`.
    GetParameters = "rcl_interfaces" / "GetParameters",
    GetParametersRequest {
        /// Which.
        names: Vec<String>,
    },
    GetParametersResponse {
        /// Their values; of type 0 for one that is not known.
        values: Vec<AnyValue>,
    }
}

service! {
    /// `rcl_interfaces/GetParameterTypes`.
    GetParameterTypes = "rcl_interfaces" / "GetParameterTypes",
    GetParameterTypesRequest {
        /// Which.
        names: Vec<String>,
    },
    GetParameterTypesResponse {
        /// Their types, as in [`AnyValue`].
        types: Vec<u8>,
    }
}

service! {
    /// `rcl_interfaces/SetParameters`.
    SetParameters = "rcl_interfaces" / "SetParameters",
    SetParametersRequest {
        /// Which, and what to.
        parameters: Vec<NamedValue>,
    },
    SetParametersResponse {
        /// Of each.
        results: Vec<SetParametersResult>,
    }
}

service! {
    /// `rcl_interfaces/SetParametersAtomically`.
    SetParametersAtomically = "rcl_interfaces" / "SetParametersAtomically",
    SetParametersAtomicallyRequest {
        /// Which, and what to.
        parameters: Vec<NamedValue>,
    },
    SetParametersAtomicallyResponse {
        /// Of all.
        result: SetParametersResult,
    }
}

service! {
    /// `rcl_interfaces/ListParameters`.
    ListParameters = "rcl_interfaces" / "ListParameters",
    ListParametersRequest {
        /// What names begin with; empty for all.
        prefixes: Vec<String>,
        /// Greatest number of parts; 0 for any.
        depth: u64,
    },
    ListParametersResponse {
        /// Found.
        result: ListParametersResult,
    }
}

service! {
    /// `rcl_interfaces/DescribeParameters`.
    DescribeParameters = "rcl_interfaces" / "DescribeParameters",
    DescribeParametersRequest {
        /// Which.
        names: Vec<String>,
    },
    DescribeParametersResponse {
        /// Of each.
        descriptors: Vec<ParameterDescriptor>,
    }
}
