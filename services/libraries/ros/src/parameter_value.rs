//! Values of parameters.

use serde_yaml::Value;

/// The value of a parameter.
#[derive(Clone, Debug, PartialEq)]
pub enum ParameterValue {
    /// Yes or no.
    Boolean(bool),
    /// A whole number.
    Integer(i64),
    /// A number.
    Double(f64),
    /// A text.
    Text(String),
    /// Texts.
    Texts(Vec<String>),
}

impl ParameterValue {
    /// What a word on a command line or in a file of parameters stands for, by the rules of YAML; `None` for what no parameter here can be.
    pub fn from_text(text: &str) -> Option<Self> {
        serde_yaml::from_str(text).ok().and_then(|value| Self::from_yaml(&value))
    }

    pub(crate) fn from_yaml(value: &Value) -> Option<Self> {
        match value {
            Value::Bool(value) => Some(Self::Boolean(*value)),
            Value::Number(number) => {
                number.as_i64().map(Self::Integer).or_else(|| number.as_f64().map(Self::Double))
            }
            Value::String(text) => Some(Self::Text(text.clone())),
            Value::Null => Some(Self::Text(String::new())),
            Value::Sequence(values) => {
                let texts = values.iter().map(|value| value.as_str().map(str::to_owned));
                texts.collect::<Option<_>>().map(Self::Texts)
            }
            _ => None,
        }
    }

    /// The number that it is, whole ones among them.
    pub fn number(&self) -> Option<f64> {
        match self {
            Self::Double(number) => Some(*number),
            Self::Integer(number) => Some(*number as f64),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_what_yaml_says() {
        let read = |text: &str| ParameterValue::from_text(text).unwrap();
        assert_eq!(read("true"), ParameterValue::Boolean(true));
        assert_eq!(read("7"), ParameterValue::Integer(7));
        assert_eq!(read("0.05"), ParameterValue::Double(0.05));
        assert_eq!(read("odom"), ParameterValue::Text("odom".to_owned()));
        assert_eq!(read("'7'"), ParameterValue::Text("7".to_owned()));
        assert_eq!(read("[a, b]"), ParameterValue::Texts(vec!["a".to_owned(), "b".to_owned()]));
        assert_eq!(read(""), ParameterValue::Text(String::new()));
        assert_eq!(ParameterValue::from_text("{a: 1}"), None);
        assert_eq!((read("2").number(), read("x").number()), (Some(2.0), None));
    }
}
