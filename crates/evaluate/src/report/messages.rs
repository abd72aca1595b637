//! Losses and notes of the run.

use std::cmp::Reverse;

use dataset::{Losses, Note, Severity};
use maud::{Markup, html};

/// Codes of warnings listed at the top; the others are folded.
const WARNINGS_SHOWN: usize = 10;

/// Messages of one code listed in full; the others are folded.
const SENTENCES_SHOWN: usize = 2;

/// A loss or a note, as shown in the report.
struct Message {
    severity: Severity,
    code: &'static str,
    sentence: String,
}

/// The messages of one code.
struct Group {
    severity: Severity,
    code: &'static str,
    sentences: Vec<String>,
}

/// The warnings at the top of the report, by code.
pub(super) fn warnings<'a>(losses: &Losses, notes: impl Iterator<Item = &'a Note>) -> Markup {
    let mut warnings = loss_messages(losses);
    warnings.extend(note_messages(notes));
    warnings.retain(|message| Severity::Warning <= message.severity);
    let n_warnings = warnings.len();
    let groups = by_code(warnings);
    let (shown, folded) = groups.split_at(WARNINGS_SHOWN.min(groups.len()));
    let n_folded: usize = folded.iter().map(|group| group.sentences.len()).sum();
    html! {
        @match n_warnings {
            0 => { p class="note" { "No warnings." } }
            n => {
                div class="warnings" {
                    p {
                        b { "This run has " (n) @if n == 1 { " warning." } @else { " warnings." } }
                        " The list of codes in " code { "docs/messages.md" } " gives cause and remedy."
                    }
                    (list(shown))
                    @if !folded.is_empty() { details { summary { (n_folded) " more" } (list(folded)) } }
                }
            }
        }
    }
}

/// Notes as a list, by code.
pub(super) fn notes<'a>(notes: impl Iterator<Item = &'a Note>) -> Markup {
    list(&by_code(note_messages(notes)))
}

fn list(groups: &[Group]) -> Markup {
    html! {
        ul { @for group in groups { li { (sentences(group)) " " code class="code" { (group.code) } } } }
    }
}

/// The first sentences of a code, one below the other, and the others folded.
fn sentences(group: &Group) -> Markup {
    let (shown, folded) = group.sentences.split_at(SENTENCES_SHOWN.min(group.sentences.len()));
    html! {
        @for (k, sentence) in shown.iter().enumerate() { @if k > 0 { br; } (with_code(sentence)) }
        @if !folded.is_empty() {
            details {
                summary { (folded.len()) " more like this" }
                @for (k, sentence) in folded.iter().enumerate() { @if k > 0 { br; } (with_code(sentence)) }
            }
        }
    }
}

/// The tables of all losses, with their counts, and of all notes.
pub(super) fn tables<'a>(losses: &Losses, notes: impl Iterator<Item = &'a Note>) -> Markup {
    html! {
        h3 { "Left out" }
        (table(loss_messages(losses), "Nothing was left out."))
        h3 { "Notes" }
        (table(note_messages(notes), "There are no notes."))
    }
}

/// One row for each code, the most severe first.
fn table(messages: Vec<Message>, if_empty: &str) -> Markup {
    if messages.is_empty() {
        return html! { p { (if_empty) } };
    }
    html! {
        div class="scroll" {
            table class="facts" {
                thead { tr { th { "code" } th class="text" { "severity" } th class="text" { "message" } } }
                tbody { @for group in by_code(messages) { tr {
                    th { code { (group.code) } }
                    td class="text" { (group.severity) }
                    td class="text" { (sentences(&group)) }
                } } }
            }
        }
    }
}

/// Messages by code, the most severe first; codes of equal severity in order of appearance.
fn by_code(messages: Vec<Message>) -> Vec<Group> {
    let mut groups: Vec<Group> = Vec::new();
    for Message { severity, code, sentence } in messages {
        match groups.iter_mut().find(|group| group.code == code) {
            Some(group) => group.sentences.push(sentence),
            None => groups.push(Group { severity, code, sentences: vec![sentence] }),
        }
    }
    groups.sort_by_key(|group| Reverse(group.severity));
    groups
}

/// One message for each loss; the same loss in several logs gives one message.
fn loss_messages(losses: &Losses) -> Vec<Message> {
    losses
        .sentences()
        .into_iter()
        .map(|(kind, sentence)| Message { severity: kind.severity(), code: kind.code(), sentence })
        .collect()
}

fn note_messages<'a>(notes: impl Iterator<Item = &'a Note>) -> Vec<Message> {
    notes
        .map(|note| Message {
            severity: note.severity(),
            code: note.code(),
            sentence: note.to_string(),
        })
        .collect()
}

/// A sentence with the parts between backticks as code.
pub(super) fn with_code(sentence: &str) -> Markup {
    html! {
        @for (k, part) in sentence.split('`').enumerate() {
            @if k % 2 == 1 { code { (part) } } @else { (part) }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dataset::{Loss, LossKind, NoteKind, Subject};

    fn losses() -> Losses {
        let mut losses = Losses::default();
        losses.add(LossKind::SupersededFile { used: "a.csv".to_owned() }, 1);
        losses.add(Loss::new(LossKind::DuplicatePackets, Subject::log("monday")), 3);
        losses
    }

    fn notes() -> Vec<Note> {
        vec![
            Note::new(NoteKind::DeskewOff, Subject::log("monday")),
            Note::new(NoteKind::SeveralSensors, Subject::topic("/<lidar>")),
        ]
    }

    #[test]
    fn the_top_lists_warnings_and_omits_infos() {
        let html = warnings(&losses(), notes().iter()).into_string();
        assert!(html.contains("This run has 2 warnings"), "{html}");
        let start = "<li>3 duplicate packets (log <code>monday</code>) ";
        assert!(html.contains(start) && html.contains(">duplicate_packets</code>"), "{html}");
        assert!(html.contains("(topic <code>/&lt;lidar&gt;</code>) "), "{html}");
        assert!(html.contains(">several_sensors</code>"), "{html}");
        assert!(!html.contains("deskew_off") && !html.contains("superseded_file"), "{html}");
    }

    #[test]
    fn the_same_loss_in_several_logs_is_one_warning() {
        let mut losses = losses();
        losses.add(Loss::new(LossKind::DuplicatePackets, Subject::log("tuesday")), 4);
        let html = warnings(&losses, [].iter()).into_string();
        assert!(html.contains("This run has 1 warning.</b>"), "{html}");
        assert!(html.contains("7 duplicate packets in 2 logs"), "{html}");
    }

    /// A code is one row or one item, with two of its sentences; the others are folded.
    #[test]
    fn messages_of_one_code_are_one_row() {
        let notes: Vec<Note> = (0..12)
            .map(|k| Note::new(NoteKind::SeveralSensors, Subject::topic(format!("/{k}"))))
            .collect();
        let html = warnings(&Losses::default(), notes.iter()).into_string();
        assert!(html.contains("This run has 12 warnings"), "{html}");
        let table = tables(&Losses::default(), notes.iter()).into_string();
        for html in [html, table] {
            assert_eq!(html.matches(">several_sensors</code>").count(), 1, "{html}");
            assert!(html.contains("<summary>10 more like this</summary>"), "{html}");
            assert!(html.contains("<code>/11</code>"), "{html}");
        }
    }

    #[test]
    fn more_than_ten_codes_of_warnings_are_folded() {
        let mut losses = Losses::default();
        for kind in [
            LossKind::TruncatedFile,
            LossKind::DamagedSummary,
            LossKind::ContradictoryIndex,
            LossKind::BytesBetweenChunks,
            LossKind::UnknownRecords,
            LossKind::MalformedRecords,
            LossKind::MisplacedRecords,
            LossKind::MalformedChunks,
            LossKind::ChunkLengthMismatch,
            LossKind::ChunkCrcMismatch,
            LossKind::TruncatedChunks,
            LossKind::UndefinedChannel,
        ] {
            losses.add(kind, 1);
        }
        let html = warnings(&losses, [].iter()).into_string();
        assert!(html.contains("This run has 12 warnings"), "{html}");
        assert!(html.contains("<summary>2 more</summary>"), "{html}");
    }

    #[test]
    fn without_warnings_the_top_states_that() {
        let html = warnings(&Losses::default(), notes()[..1].iter()).into_string();
        assert_eq!(html, "<p class=\"note\">No warnings.</p>");
    }

    #[test]
    fn the_tables_list_every_code_with_the_most_severe_first() {
        let html = tables(&losses(), notes().iter()).into_string();
        let position = |code: &str| html.find(&format!("<code>{code}</code>")).expect(code);
        assert!(position("duplicate_packets") < position("superseded_file"));
        assert!(position("several_sensors") < position("deskew_off"));
    }

    #[test]
    fn empty_tables_state_that_nothing_was_left_out() {
        let html = tables(&Losses::default(), [].iter()).into_string();
        assert!(html.contains("Nothing was left out.") && html.contains("There are no notes."));
    }
}
