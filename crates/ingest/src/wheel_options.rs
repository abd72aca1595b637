//! The options for wheels: their topic, their joints, and the unit of their speed.

use serde::{Deserialize, Serialize};

/// The topic with wheel speeds, and the joints of the wheels if their names do not show them: a topic,
/// or a table with `topic`, `left` and `right`.
///
/// ```toml
/// wheels = "/joint_states"
/// wheels = { topic = "/joint_states", left = ["drive_1"], right = ["drive_2"] }
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(from = "TopicOrTable", into = "TopicOrTable")]
pub struct WheelsTopic {
    /// The topic.
    pub topic: String,
    /// Names of the joints of the wheels on the left. Without them, the names of the joints are
    /// searched for wheels.
    pub left: Vec<String>,
    /// Names of the joints of the wheels on the right.
    pub right: Vec<String>,
}

impl WheelsTopic {
    /// Whether the joints are named.
    pub fn names_joints(&self) -> bool {
        !self.left.is_empty() || !self.right.is_empty()
    }

    /// What is wrong with the names of the joints, if anything is.
    pub(crate) fn fault(&self) -> Option<String> {
        if self.names_joints() && (self.left.is_empty() || self.right.is_empty()) {
            return Some("joints on one side only".to_owned());
        }
        let both = self.left.iter().find(|joint| self.right.contains(joint));
        both.map(|joint| format!("the joint `{joint}` on both sides"))
    }
}

impl<T: Into<String>> From<T> for WheelsTopic {
    fn from(topic: T) -> Self {
        Self { topic: topic.into(), ..Self::default() }
    }
}

/// A topic, or a table with a topic and the joints of the wheels.
#[derive(Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(
    untagged,
    deny_unknown_fields,
    expecting = "expected a topic, or a table `{ topic = \"...\", left = [\"...\"], right = [\"...\"] }`"
)]
enum TopicOrTable {
    /// The topic.
    Topic(String),
    /// The topic and its joints.
    Table {
        /// The topic.
        topic: String,
        /// Names of the joints of the wheels on the left.
        #[serde(default)]
        left: Vec<String>,
        /// Names of the joints of the wheels on the right.
        #[serde(default)]
        right: Vec<String>,
    },
}

impl From<TopicOrTable> for WheelsTopic {
    fn from(text: TopicOrTable) -> Self {
        match text {
            TopicOrTable::Topic(topic) => Self::from(topic),
            TopicOrTable::Table { topic, left, right } => Self { topic, left, right },
        }
    }
}

impl From<WheelsTopic> for TopicOrTable {
    fn from(WheelsTopic { topic, left, right }: WheelsTopic) -> Self {
        match left.is_empty() && right.is_empty() {
            true => Self::Topic(topic),
            false => Self::Table { topic, left, right },
        }
    }
}

/// The unit of the joint velocities.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum WheelSpeedUnit {
    /// Metres per second along the ground. Positions are in metres.
    #[serde(rename = "m/s")]
    MetresPerSecond,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wheels_are_a_topic_or_a_table() {
        #[derive(Debug, PartialEq, Serialize, Deserialize)]
        struct Section {
            wheels: WheelsTopic,
        }
        let read = |text: &str| serde_json::from_str::<Section>(text);
        let topic = read(r#"{"wheels":"/joints"}"#).unwrap();
        assert_eq!(topic.wheels, WheelsTopic::from("/joints"));
        assert_eq!(serde_json::to_string(&topic).unwrap(), r#"{"wheels":"/joints"}"#);
        let text = r#"{"wheels":{"topic":"/joints","left":["a"],"right":["b"]}}"#;
        let table = read(text).unwrap();
        assert_eq!((table.wheels.left[0].as_str(), table.wheels.right[0].as_str()), ("a", "b"));
        assert_eq!(serde_json::to_string(&table).unwrap(), text);
        let error = read(r#"{"wheels":{"topic":"/joints","lefts":["a"]}}"#).unwrap_err();
        assert!(error.to_string().contains("expected a topic, or a table"), "{error}");
    }

    #[test]
    fn named_joints_must_be_on_both_sides_and_on_one_each() {
        let fault = |left: &[&str], right: &[&str]| {
            let names = |side: &[&str]| side.iter().map(|&s| s.to_owned()).collect();
            WheelsTopic { topic: String::new(), left: names(left), right: names(right) }.fault()
        };
        assert_eq!(fault(&[], &[]), None);
        assert_eq!(fault(&["a", "b"], &["c"]), None);
        assert_eq!(fault(&["a"], &[]).as_deref(), Some("joints on one side only"));
        assert_eq!(fault(&["a"], &["a"]).as_deref(), Some("the joint `a` on both sides"));
    }
}
