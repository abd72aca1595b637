//! Remarks about the data and the run: coded, with typed arguments, and with a sentence for people.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::note_kind::NoteKind;
use crate::{Severity, Subject};

/// A remark or a warning about one subject.
///
/// In JSON it is one object: `code`, the arguments of the kind, and the parts of the subject.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Note {
    /// What there is to say.
    #[serde(flatten)]
    pub kind: NoteKind,
    /// What it is about.
    #[serde(flatten)]
    pub subject: Subject,
}

impl Note {
    /// A note about a subject.
    pub fn new(kind: NoteKind, subject: Subject) -> Self {
        Self { kind, subject }
    }

    /// The stable name.
    pub fn code(&self) -> &'static str {
        self.kind.code()
    }

    /// How much attention it needs.
    pub fn severity(&self) -> Severity {
        self.kind.severity()
    }

    /// The note as a line of output, with severity and code.
    pub fn line(&self) -> String {
        format!("{}[{}]: {self}", self.severity(), self.code())
    }
}

impl NoteKind {
    /// The grouping that was not evaluated, by name; `None` for notes about something else.
    pub fn grouping(&self) -> Option<&str> {
        match self {
            Self::TooFewGroups { grouping, .. }
            | Self::TwoGroups { grouping, .. }
            | Self::TooFewPairsForFolds { grouping, .. }
            | Self::OneClassLeft { grouping, .. }
            | Self::GroupingNotTrainable { grouping } => Some(grouping),
            _ => None,
        }
    }
}

impl From<NoteKind> for Note {
    fn from(kind: NoteKind) -> Self {
        Self { kind, subject: Subject::default() }
    }
}

impl fmt::Display for NoteKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.write(f, "")
    }
}

/// The sentence, and what it is about in parentheses.
impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.kind.fmt(f)?;
        match self.subject == Subject::default() {
            true => Ok(()),
            false => write!(f, " ({})", self.subject),
        }
    }
}
