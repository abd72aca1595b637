//! Losses and notes of the run.

use std::cmp::Reverse;

use dataset::{Losses, Note, Severity};
use maud::{Markup, html};

/// Warnings listed at the top; the others are folded.
const WARNINGS_SHOWN: usize = 10;

/// A loss or a note, as shown in the report.
struct Message {
    severity: Severity,
    code: &'static str,
    sentence: String,
}

/// The warnings at the top of the report, one line each.
pub(super) fn warnings<'a>(losses: &Losses, notes: impl Iterator<Item = &'a Note>) -> Markup {
    let mut warnings = loss_messages(losses);
    warnings.extend(note_messages(notes));
    warnings.retain(|message| Severity::Warning <= message.severity);
    warnings.sort_by_key(|message| Reverse(message.severity));
    let (shown, folded) = warnings.split_at(WARNINGS_SHOWN.min(warnings.len()));
    html! {
        @match warnings.len() {
            0 => { p class="note" { "No warnings." } }
            n => {
                div class="warnings" {
                    p {
                        b { "This run has " (n) @if n == 1 { " warning." } @else { " warnings." } }
                        " The list of codes in " code { "docs/messages.md" } " gives cause and remedy."
                    }
                    (list(shown))
                    @if !folded.is_empty() { details { summary { (folded.len()) " more" } (list(folded)) } }
                }
            }
        }
    }
}

fn list(messages: &[Message]) -> Markup {
    html! {
        ul { @for message in messages { li { (with_code(&message.sentence)) " " code class="code" { (message.code) } } } }
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

/// The messages, the most severe first.
fn table(mut messages: Vec<Message>, if_empty: &str) -> Markup {
    messages.sort_by_key(|message| Reverse(message.severity));
    if messages.is_empty() {
        return html! { p { (if_empty) } };
    }
    html! {
        div class="scroll" {
            table class="facts" {
                thead { tr { th { "code" } th class="text" { "severity" } th class="text" { "message" } } }
                tbody { @for message in messages { tr {
                    th { code { (message.code) } }
                    td class="text" { (message.severity) }
                    td class="text" { (with_code(&message.sentence)) }
                } } }
            }
        }
    }
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
fn with_code(sentence: &str) -> Markup {
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

    #[test]
    fn more_than_ten_warnings_are_folded() {
        let notes: Vec<Note> = (0..12)
            .map(|k| Note::new(NoteKind::SeveralSensors, Subject::topic(format!("/{k}"))))
            .collect();
        let html = warnings(&Losses::default(), notes.iter()).into_string();
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
