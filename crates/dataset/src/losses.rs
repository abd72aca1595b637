//! What a stage left out: coded, counted, and with a sentence for people.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

use crate::loss_kind::LossKind;
use crate::{Severity, Subject};

/// One kind of loss of one subject.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Loss {
    /// What was left out, and why.
    #[serde(flatten)]
    pub kind: LossKind,
    /// Where.
    #[serde(flatten)]
    pub subject: Subject,
}

impl Loss {
    /// A loss about a subject.
    pub fn new(kind: LossKind, subject: Subject) -> Self {
        Self { kind, subject }
    }

    /// The sentence for `n` of it: `3 duplicate packets (topic `/velodyne_packets`)`.
    pub fn sentence(&self, n: u64) -> String {
        Counted { loss: self, n }.to_string()
    }
}

impl From<LossKind> for Loss {
    fn from(kind: LossKind) -> Self {
        Self { kind, subject: Subject::default() }
    }
}

struct Counted<'a> {
    loss: &'a Loss,
    n: u64,
}

impl fmt::Display for Counted<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ", self.n)?;
        self.loss.kind.write(f, if self.n == 1 { "" } else { "s" })?;
        match self.loss.subject == Subject::default() {
            true => Ok(()),
            false => write!(f, " ({})", self.loss.subject),
        }
    }
}

/// What was left out, counted by kind and subject.
///
/// In JSON it is a list with one object per entry: `code`, the arguments of the kind, the parts of
/// the subject, and `n`.
///
/// ```
/// use dataset::{LossKind, Losses};
///
/// let mut losses = Losses::default();
/// losses.add(LossKind::DuplicatePackets, 3);
/// losses.add(LossKind::DuplicatePackets, 1);
/// assert_eq!(losses.count("duplicate_packets"), 4);
/// assert_eq!(losses.to_string(), "4 duplicate packets");
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(from = "Vec<Entry>", into = "Vec<Entry>")]
pub struct Losses(BTreeMap<Loss, u64>);

#[derive(Serialize, Deserialize)]
struct Entry {
    #[serde(flatten)]
    loss: Loss,
    n: u64,
}

impl Losses {
    /// Counts `n` more of a loss; 0 adds nothing.
    pub fn add(&mut self, loss: impl Into<Loss>, n: u64) {
        if n > 0 {
            *self.0.entry(loss.into()).or_default() += n;
        }
    }

    /// Adds all counts of another.
    pub fn merge(&mut self, other: Self) {
        for (loss, n) in other.0 {
            self.add(loss, n);
        }
    }

    /// Whether nothing was left out.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Losses and their counts, in order of the kinds.
    pub fn iter(&self) -> impl Iterator<Item = (&Loss, u64)> {
        self.0.iter().map(|(loss, &n)| (loss, n))
    }

    /// The sum of the counts of a code.
    pub fn count(&self, code: &str) -> u64 {
        self.iter().filter(|(loss, _)| loss.kind.code() == code).map(|(_, n)| n).sum()
    }

    /// The sum of all counts.
    pub fn total(&self) -> u64 {
        self.0.values().sum()
    }

    /// The sentences as lines of output, with severity and code.
    pub fn lines(&self) -> Vec<(Severity, String)> {
        let line = |(kind, sentence): (LossKind, String)| {
            let (severity, code) = (kind.severity(), kind.code());
            (severity, format!("{severity}[{code}]: {sentence}"))
        };
        self.sentences().into_iter().map(line).collect()
    }

    /// The sentences, with their kinds. A loss of several logs gives one sentence, which names the
    /// first of them.
    ///
    /// ```
    /// use dataset::{Loss, LossKind, Losses, Subject};
    ///
    /// let mut losses = Losses::default();
    /// losses.add(Loss::new(LossKind::DuplicatePackets, Subject::log("monday")), 3);
    /// losses.add(Loss::new(LossKind::DuplicatePackets, Subject::log("tuesday")), 4);
    /// let (_, sentence) = &losses.sentences()[0];
    /// assert_eq!(sentence, "7 duplicate packets in 2 logs (`monday`, `tuesday`)");
    /// ```
    pub fn sentences(&self) -> Vec<(LossKind, String)> {
        let mut over_logs: BTreeMap<Loss, (u64, Vec<&str>)> = BTreeMap::new();
        for (loss, n) in self.iter() {
            let subject = Subject { log: None, ..loss.subject.clone() };
            let (total, logs) = over_logs.entry(Loss::new(loss.kind.clone(), subject)).or_default();
            *total += n;
            logs.extend(loss.subject.log.as_deref());
        }
        let sentence = |(loss, (n, logs)): (Loss, (u64, Vec<&str>))| {
            let sentence = match logs.as_slice() {
                [] => loss.sentence(n),
                [log] => Loss::new(loss.kind.clone(), loss.subject.in_log(*log)).sentence(n),
                logs => format!("{} in {}", loss.sentence(n), named(logs)),
            };
            (loss.kind, sentence)
        };
        over_logs.into_iter().map(sentence).collect()
    }

    /// The same losses, all of one log.
    #[must_use]
    pub fn in_log(self, log: &str) -> Self {
        let mut losses = Self::default();
        for (Loss { kind, subject }, n) in self.0 {
            losses.add(Loss::new(kind, subject.in_log(log)), n);
        }
        losses
    }

    /// The same losses; those without a topic become losses of this one.
    #[must_use]
    pub fn on_topic(self, topic: &str) -> Self {
        let mut losses = Self::default();
        for (Loss { kind, mut subject }, n) in self.0 {
            subject.topic.get_or_insert_with(|| topic.to_owned());
            losses.add(Loss::new(kind, subject), n);
        }
        losses
    }
}

/// Logs that are named in a sentence.
const MAX_NAMED: usize = 3;

/// ``5 logs (`a`, `b`, `c`, ...)``
fn named(logs: &[&str]) -> String {
    let names: Vec<String> = logs.iter().take(MAX_NAMED).map(|log| format!("`{log}`")).collect();
    let more = if MAX_NAMED < logs.len() { ", ..." } else { "" };
    format!("{} logs ({}{more})", logs.len(), names.join(", "))
}

/// The sentences, separated by commas.
impl fmt::Display for Losses {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (k, (loss, n)) in self.iter().enumerate() {
            let separator = if k == 0 { "" } else { ", " };
            write!(f, "{separator}{}", Counted { loss, n })?;
        }
        Ok(())
    }
}

impl From<Vec<Entry>> for Losses {
    fn from(entries: Vec<Entry>) -> Self {
        let mut losses = Self::default();
        for Entry { loss, n } in entries {
            losses.add(loss, n);
        }
        losses
    }
}

impl From<Losses> for Vec<Entry> {
    fn from(losses: Losses) -> Self {
        losses.0.into_iter().map(|(loss, n)| Entry { loss, n }).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_keeps_codes_arguments_subjects_and_counts() {
        let mut losses = Losses::default();
        let kind = LossKind::UndecodableMessages {
            message_type: "LaserScan".to_owned(),
            fault: "too_short".to_owned(),
        };
        losses.add(Loss::new(kind, Subject::topic("/scan").in_log("monday")), 2);
        losses.add(LossKind::DuplicatePackets, 1);
        let json = serde_json::to_value(&losses).unwrap();
        assert_eq!(
            json,
            serde_json::json!([
                {
                    "code": "undecodable_messages", "message_type": "LaserScan",
                    "fault": "too_short", "log": "monday", "topic": "/scan", "n": 2
                },
                { "code": "duplicate_packets", "n": 1 }
            ])
        );
        assert_eq!(serde_json::from_value::<Losses>(json).unwrap(), losses);
        assert_eq!(
            losses.to_string(),
            "2 messages that could not be decoded as LaserScan (too_short) (log `monday`, topic \
             `/scan`), 1 duplicate packet"
        );
    }

    #[test]
    fn codes_are_unique_and_snake_case() {
        let mut codes = LossKind::CODES.to_vec();
        codes.extend(crate::NoteKind::CODES);
        for code in &codes {
            assert!(code.chars().all(|c| c.is_ascii_lowercase() || c == '_'), "{code}");
        }
        let n = codes.len();
        codes.sort_unstable();
        codes.dedup();
        assert_eq!(codes.len(), n);
    }
}
