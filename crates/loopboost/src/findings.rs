//! What a command left out and what it remarks: collected, ordered and printed.

use std::collections::BTreeMap;

use dataset::{Losses, Note, Severity};

/// Losses and notes of a command.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Findings {
    pub(crate) losses: Losses,
    pub(crate) notes: Vec<Note>,
}

/// Lines that are printed per code of a note.
const MAX_LINES_PER_CODE: usize = 3;

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
        self.lines_from(Severity::Info)
    }

    /// The lines of at least this severity.
    pub(crate) fn lines_from(&self, least: Severity) -> Vec<String> {
        let mut lines = self.losses.lines();
        lines.extend(self.note_lines());
        lines.retain(|(severity, _)| least <= *severity);
        // Stable: losses before notes, in their order.
        lines.sort_by_key(|(severity, _)| std::cmp::Reverse(*severity));
        lines.into_iter().map(|(_, line)| line).collect()
    }

    /// The number of losses and notes of a severity: a loss of several logs is one, and every note is
    /// one.
    pub(crate) fn count(&self, severity: Severity) -> usize {
        let losses = self.losses.sentences().into_iter().map(|(kind, _)| kind.severity());
        let severities = losses.chain(self.notes.iter().map(Note::severity));
        severities.filter(|of| *of == severity).count()
    }

    fn note_lines(&self) -> Vec<(Severity, String)> {
        let mut n_by_code: BTreeMap<&str, usize> = BTreeMap::new();
        let mut lines = Vec::new();
        for note in &self.notes {
            let n = n_by_code.entry(note.code()).or_default();
            *n += 1;
            if *n <= MAX_LINES_PER_CODE {
                lines.push((note.severity(), note.line()));
            }
        }
        for (code, n) in n_by_code {
            let more = n.saturating_sub(MAX_LINES_PER_CODE);
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

/// An error of a stage, and the losses and notes of the stages before it.
pub(crate) struct Failure {
    pub(crate) error: anyhow::Error,
    pub(crate) before: Findings,
}

impl From<anyhow::Error> for Failure {
    fn from(error: anyhow::Error) -> Self {
        Self { error, before: Findings::default() }
    }
}

impl From<Losses> for Findings {
    fn from(losses: Losses) -> Self {
        Self { losses, notes: Vec::new() }
    }
}

#[cfg(test)]
mod tests {
    use dataset::{Loss, LossKind, NoteKind, Subject};

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
        findings.losses.add(LossKind::DatagramsToOtherPorts { ports: "2369: 1".to_owned() }, 1);
        let stamps = NoteKind::StampSteps { n_steps: 1, largest_s: 0.5 };
        findings.notes.push(Note::new(stamps, Subject::log("d")));
        let lines = findings.lines();
        let starts = [
            "warning[duplicate_packets]: 8 duplicate packets (topic `/velodyne_packets`) in 4 logs (`a`, `b`, `c`, ...)",
            "warning[stamp_steps]: ",
            "info[datagrams_to_other_ports]: 1 UDP datagram to other ports (2369: 1)",
            "info[partial_revolutions]: ",
            "info[partial_revolutions]: ",
            "info[partial_revolutions]: ",
            "info[partial_revolutions]: and 1 more like this",
        ];
        assert_eq!(lines.len(), starts.len(), "{lines:#?}");
        for (line, start) in lines.iter().zip(starts) {
            assert!(line.starts_with(start), "{line}");
        }
        assert_eq!(findings.count(Severity::Warning), 2);
        let warnings = findings.warnings();
        let expected = [("duplicate_packets".to_owned(), 8), ("stamp_steps".to_owned(), 1)].into();
        assert_eq!(warnings, expected);
    }
}
