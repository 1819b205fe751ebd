//! The services by which other nodes read and change the parameters of a node.

use crate::messages::{
    AnyValue, DescribeParameters, DescribeParametersResponse, GetParameterTypes, GetParameterTypesResponse,
    GetParameters, GetParametersResponse, ListParameters, ListParametersRequest, ListParametersResponse,
    ListParametersResult, NamedValue, ParameterDescriptor, ParameterEvent, RosService, SetParameters,
    SetParametersAtomically, SetParametersAtomicallyResponse, SetParametersResponse, SetParametersResult,
    Time,
};
use crate::sender_clock::sender_clock_ns;
use crate::{Node, Parameter, ParameterValue, Publisher, QualityOfService, RosError};
use std::sync::{Arc, Mutex};

/// Changes that may wait, as every node of ROS has it.
const EVENTS_KEPT: usize = 1000;

/// The parameters of a node.
struct Parameters {
    declared: Mutex<Vec<Parameter>>,
    node: String,
    events: Publisher<ParameterEvent>,
}

/// Offers the parameters of a node.
///
/// # Errors
/// When the network refuses.
pub fn offer_parameters(node: &mut Node, declared: Vec<Parameter>) -> Result<(), RosError> {
    let events = node.publisher("/parameter_events", QualityOfService::Reliable { depth: EVENTS_KEPT })?;
    let parameters = Arc::new(Parameters { declared: Mutex::new(declared), node: node.full_name(), events });
    let mut offer = Offer { node, parameters };
    offer.service::<GetParameters>("~/get_parameters", |of, request| GetParametersResponse {
        values: of.values(&request.names),
    })?;
    offer.service::<GetParameterTypes>("~/get_parameter_types", |of, request| GetParameterTypesResponse {
        types: of.values(&request.names).into_iter().map(|value| value.kind).collect(),
    })?;
    offer.service::<SetParameters>("~/set_parameters", |of, request| SetParametersResponse {
        results: request.parameters.iter().map(|parameter| of.set(parameter)).collect(),
    })?;
    offer.service::<SetParametersAtomically>("~/set_parameters_atomically", |of, request| {
        SetParametersAtomicallyResponse { result: of.set_all(&request.parameters) }
    })?;
    offer.service::<ListParameters>("~/list_parameters", |of, request| ListParametersResponse {
        result: of.list(&request),
    })?;
    offer.service::<DescribeParameters>("~/describe_parameters", |of, request| DescribeParametersResponse {
        descriptors: request.names.into_iter().map(|name| of.describe(name)).collect(),
    })
}

struct Offer<'n> {
    node: &'n mut Node,
    parameters: Arc<Parameters>,
}

impl Offer<'_> {
    fn service<S: RosService>(
        &mut self,
        name: &str,
        answer: impl Fn(&Parameters, S::Request) -> S::Response + Send + 'static,
    ) -> Result<(), RosError> {
        let parameters = Arc::clone(&self.parameters);
        self.node.serve::<S>(name, move |call| call.answer.send(answer(&parameters, call.request)))
    }
}

impl Parameters {
    fn find<T>(&self, name: &str, read: impl FnOnce(&mut Parameter) -> T) -> Option<T> {
        let mut declared = self.declared.lock().expect("no thread panics with it");
        declared.iter_mut().find(|known| known.name == name).map(read)
    }

    fn values(&self, names: &[String]) -> Vec<AnyValue> {
        let value = |name: &String| self.find(name, |known| AnyValue::from(&known.value));
        names.iter().map(|name| value(name).unwrap_or_default()).collect()
    }

    fn set(&self, asked: &NamedValue) -> SetParametersResult {
        let name = &asked.name;
        let changed = self
            .find(name, |known| {
                let value = asked.value.value().ok_or("a value of this type has no meaning here")?;
                let change = known
                    .change
                    .as_ref()
                    .ok_or_else(|| format!("{name} cannot be changed while the node runs"))?;
                change(&value)?;
                // A whole number stands for a number; the type stays.
                known.value = match (&known.value, value.number()) {
                    (ParameterValue::Double(_), Some(number)) => ParameterValue::Double(number),
                    _ => value,
                };
                Ok(AnyValue::from(&known.value))
            })
            .unwrap_or_else(|| Err(format!("{name} is not a parameter of this node")));
        match changed {
            Ok(value) => {
                self.events.send(ParameterEvent {
                    stamp: Time::from_ns(sender_clock_ns()),
                    node: self.node.clone(),
                    changed_parameters: vec![NamedValue { name: name.clone(), value }],
                    ..ParameterEvent::default()
                });
                SetParametersResult { successful: true, reason: String::new() }
            }
            Err(reason) => SetParametersResult { successful: false, reason },
        }
    }

    /// All of them, or none: what was changed before a refusal gets its old value.
    fn set_all(&self, asked: &[NamedValue]) -> SetParametersResult {
        let mut before = Vec::new();
        for parameter in asked {
            let old = self.find(&parameter.name, |known| AnyValue::from(&known.value));
            let result = self.set(parameter);
            if !result.successful {
                for parameter in before.iter().rev() {
                    self.set(parameter);
                }
                return result;
            }
            before.extend(old.map(|value| NamedValue { name: parameter.name.clone(), value }));
        }
        SetParametersResult { successful: true, reason: String::new() }
    }

    /// Names here have one part.
    fn list(&self, request: &ListParametersRequest) -> ListParametersResult {
        let declared = self.declared.lock().expect("no thread panics with it");
        let is_requested = |name: &String| request.prefixes.is_empty() || request.prefixes.contains(name);
        let names = declared.iter().map(|known| known.name.clone()).filter(is_requested).collect();
        ListParametersResult { names, prefixes: Vec::new() }
    }

    fn describe(&self, name: String) -> ParameterDescriptor {
        let known = self.find(&name, |known| (AnyValue::from(&known.value).kind, known.change.is_none()));
        let (kind, read_only) = known.unwrap_or_default();
        ParameterDescriptor { name, kind, read_only, ..ParameterDescriptor::default() }
    }
}
