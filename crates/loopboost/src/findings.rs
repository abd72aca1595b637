//! What a command left out and what it remarks: collected, ordered and printed.

use std::collections::BTreeMap;

use dataset::{Loss, Losses, Note, Severity, Subject};

/// Losses and notes of a command.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Findings {
    pub(crate) losses: Losses,
    pub(crate) notes: Vec<Note>,
}

/// Logs that are named in one line, and lines that are printed per code of a note.
const MAX_NAMED: usize = 3;

impl Findings {
    pub(crate) fn merge(&mut self, other: Self) {
        self.losses.merge(other.losses);
        self.notes.extend(other.notes);
    }

    /// Codes and counts of everything that needs attention. A note counts once.
    pub(crate) fn warnings(&self) -> BTreeMap<String, u64> {
        let mut warnings = BTreeMap::new();
        for (loss, n) in self.losses.iter() {
            if Severity::Warning <= loss.kind.severity() {
                *warnings.entry(loss.kind.code().to_owned()).or_default() += n;
            }
        }
        for note in &self.notes {
            if Severity::Warning <= note.severity() {
                *warnings.entry(note.code().to_owned()).or_default() += 1;
            }
        }
        warnings
    }

    /// One line per loss and note, the most severe first, with severity and code.
    ///
    /// A loss of several logs is one line. Of many notes with one code the first few are printed;
    /// `run.json` has them all.
    pub(crate) fn lines(&self) -> Vec<String> {
        let mut lines: Vec<(Severity, String)> = self.loss_lines();
        lines.extend(self.note_lines());
        // Stable: losses before notes, in their order.
        lines.sort_by_key(|(severity, _)| std::cmp::Reverse(*severity));
        lines.into_iter().map(|(_, line)| line).collect()
    }

    fn loss_lines(&self) -> Vec<(Severity, String)> {
        let mut by_kind: BTreeMap<Loss, (u64, Vec<&str>)> = BTreeMap::new();
        for (loss, n) in self.losses.iter() {
            let of_all_logs = Loss {
                kind: loss.kind.clone(),
                subject: Subject { log: None, ..loss.subject.clone() },
            };
            let (total, logs) = by_kind.entry(of_all_logs).or_default();
            *total += n;
            logs.extend(loss.subject.log.as_deref());
        }
        let line = |(loss, (n, logs)): (Loss, (u64, Vec<&str>))| {
            let (severity, code) = (loss.kind.severity(), loss.kind.code());
            let sentence = match logs.as_slice() {
                [] => loss.sentence(n),
                [log] => Loss::new(loss.kind, loss.subject.in_log(*log)).sentence(n),
                logs => format!("{} in {}", loss.sentence(n), named(logs)),
            };
            (severity, format!("{severity}[{code}]: {sentence}"))
        };
        by_kind.into_iter().map(line).collect()
    }

    fn note_lines(&self) -> Vec<(Severity, String)> {
        let mut n_by_code: BTreeMap<&str, usize> = BTreeMap::new();
        let mut lines = Vec::new();
        for note in &self.notes {
            let (severity, code) = (note.severity(), note.code());
            let n = n_by_code.entry(code).or_default();
            *n += 1;
            if *n <= MAX_NAMED {
                lines.push((severity, format!("{severity}[{code}]: {note}")));
            }
        }
        for (code, n) in n_by_code {
            let more = n.saturating_sub(MAX_NAMED);
            if let Some(note) = self.notes.iter().find(|note| note.code() == code && 0 < more) {
                let severity = note.severity();
                lines.push((
                    severity,
                    format!("{severity}[{code}]: and {more} more like this (see run.json)"),
                ));
            }
        }
        lines
    }
}

/// "5 logs (`a`, `b`, `c`, ...)"
fn named(logs: &[&str]) -> String {
    let names: Vec<String> = logs.iter().take(MAX_NAMED).map(|log| format!("`{log}`")).collect();
    let more = if MAX_NAMED < logs.len() { ", ..." } else { "" };
    format!("{} logs ({}{more})", logs.len(), names.join(", "))
}

impl From<Losses> for Findings {
    fn from(losses: Losses) -> Self {
        Self { losses, notes: Vec::new() }
    }
}

#[cfg(test)]
mod tests {
    use dataset::{LossKind, NoteKind};

    use super::*;

    #[test]
    fn warnings_come_first_and_a_loss_of_many_logs_is_one_line() {
        let mut findings = Findings::default();
        for log in ["a", "b", "c", "d"] {
            let subject = Subject::topic("/velodyne_packets").in_log(log);
            findings.losses.add(Loss::new(LossKind::DuplicatePackets, subject.clone()), 2);
            findings
                .notes
                .push(Note::new(NoteKind::PartialRevolutions { n_revolutions: 2 }, subject));
        }
        findings.losses.add(LossKind::DatagramsToOtherPorts, 1);
        let stamps = NoteKind::StampSteps { n_steps: 1, largest_s: 0.5 };
        findings.notes.push(Note::new(stamps, Subject::log("d")));
        let lines = findings.lines();
        let starts = [
            "warning[duplicate_packets]: 8 duplicate packets (topic `/velodyne_packets`) in 4 logs (`a`, `b`, `c`, ...)",
            "warning[stamp_steps]: ",
            "info[datagrams_to_other_ports]: 1 UDP datagram to other ports",
            "info[partial_revolutions]: ",
            "info[partial_revolutions]: ",
            "info[partial_revolutions]: ",
            "info[partial_revolutions]: and 1 more like this",
        ];
        assert_eq!(lines.len(), starts.len(), "{lines:#?}");
        for (line, start) in lines.iter().zip(starts) {
            assert!(line.starts_with(start), "{line}");
        }
        let warnings = findings.warnings();
        let expected = [("duplicate_packets".to_owned(), 8), ("stamp_steps".to_owned(), 1)].into();
        assert_eq!(warnings, expected);
    }
}
