//! Codes, subjects and severities of [losses](crate::Losses) and [notes](crate::Note).

use std::fmt;

use serde::{Deserialize, Serialize};

/// How much attention a loss or a note needs.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize,
)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// Good to know; the run is complete and can be trusted.
    #[default]
    Info,
    /// Data was left out, or the meaning of the data is in doubt: look before trusting the result.
    Warning,
    /// The data contradicts itself or the options.
    Error,
}

impl Severity {
    /// The name in messages and tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Info => "info",
            Self::Warning => "warning",
            Self::Error => "error",
        }
    }
}

impl fmt::Display for Severity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// What a loss or a note is about. Every part is optional.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
pub struct Subject {
    /// The log of the run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub log: Option<String>,
    /// The topic in the log.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub topic: Option<String>,
    /// The file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// The transform between two frames, as `parent -> child`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub transform: Option<String>,
}

impl Subject {
    /// A log of the run.
    pub fn log(name: impl Into<String>) -> Self {
        Self { log: Some(name.into()), ..Self::default() }
    }

    /// A topic.
    pub fn topic(name: impl Into<String>) -> Self {
        Self { topic: Some(name.into()), ..Self::default() }
    }

    /// A file.
    pub fn file(name: impl Into<String>) -> Self {
        Self { file: Some(name.into()), ..Self::default() }
    }

    /// A transform between two frames.
    pub fn transform(parent: &str, child: &str) -> Self {
        Self { transform: Some(format!("{parent} -> {child}")), ..Self::default() }
    }

    /// The same subject, in this log.
    #[must_use]
    pub fn in_log(self, name: impl Into<String>) -> Self {
        Self { log: Some(name.into()), ..self }
    }
}

/// The parts that are known, separated by commas: ``log `monday`, topic `/scan` ``. Empty where
/// nothing is known.
impl fmt::Display for Subject {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parts = [
            ("log", &self.log),
            ("topic", &self.topic),
            ("file", &self.file),
            ("transform", &self.transform),
        ];
        let known = parts.iter().filter_map(|(name, part)| Some((name, part.as_ref()?)));
        for (k, (name, part)) in known.enumerate() {
            let separator = if k == 0 { "" } else { ", " };
            write!(f, "{separator}{name} `{part}`")?;
        }
        Ok(())
    }
}

/// Declares an enum of coded messages: per variant its severity, its code, its arguments and its
/// sentence. The code is the stable name in tables and JSON; the sentence is for people only.
///
/// The identifier in parentheses is the text that makes a noun plural where the count is not 1; a
/// note has no count and never uses it.
macro_rules! codes {
    (
        $(#[$meta:meta])*
        pub enum $name:ident ($s:ident) {
            $(
                $(#[$doc:meta])*
                $severity:ident $code:tt $variant:ident
                $({ $( $(#[$field_doc:meta])* $field:ident : $type:ty ),* $(,)? })?
                => $text:literal $(, $arg:expr)* ;
            )*
        }
    ) => {
        $(#[$meta])*
        #[serde(tag = "code")]
        pub enum $name {
            $(
                $(#[$doc])*
                #[serde(rename = $code)]
                $variant $({ $( $(#[$field_doc])* $field: $type ),* })?,
            )*
        }

        impl $name {
            /// Every code, in the order of declaration.
            pub const CODES: &'static [&'static str] = &[$($code),*];

            /// Every code with the name of its severity, in the order of declaration.
            pub const SEVERITIES: &'static [(&'static str, &'static str)] =
                &[$(($code, $crate::Severity::$severity.name())),*];

            /// The stable name in tables and JSON.
            pub fn code(&self) -> &'static str {
                match self {
                    $( Self::$variant $({ $( $field: _ ),* })? => $code, )*
                }
            }

            /// How much attention it needs.
            pub fn severity(&self) -> $crate::Severity {
                match self {
                    $( Self::$variant $({ $( $field: _ ),* })? => $crate::Severity::$severity, )*
                }
            }

            #[allow(unused_variables, reason = "not every sentence uses the plural")]
            pub(crate) fn write(
                &self,
                f: &mut std::fmt::Formatter<'_>,
                $s: &'static str,
            ) -> std::fmt::Result {
                match self {
                    $( Self::$variant $({ $( $field ),* })? => write!(f, $text $(, $arg)*), )*
                }
            }
        }
    };
}

pub(crate) use codes;
