//! The data behind the numbers: losses, notes, inputs and options.

use std::collections::BTreeMap;

use dataset::{Keyframe, Losses, Note};
use maud::{Markup, html};

use super::{Fact, messages};

/// With more logs than this, their keyframes and digests are folded.
const LOGS_SHOWN: usize = 10;

pub(super) fn section<'a>(
    all: &[Keyframe],
    losses: &Losses,
    notes: impl Iterator<Item = &'a Note>,
    (digests, options): (&[Fact], &[Fact]),
) -> Markup {
    let mut keyframes: BTreeMap<&str, usize> = BTreeMap::new();
    for keyframe in all {
        *keyframes.entry(&keyframe.id.log).or_default() += 1;
    }
    let inputs = html! {
        div class="scroll" {
            table class="facts" {
                tbody {
                    @for (log, n) in &keyframes { tr { th { (log) } td class="text" { (n) " keyframes" } } }
                    (rows(digests))
                }
            }
        }
    };
    html! {
        section {
            h2 { "Data and options" }
            (messages::tables(losses, notes))
            h3 { "Inputs" }
            @if LOGS_SHOWN < keyframes.len() {
                details { summary { (keyframes.len()) " logs" } (inputs) }
            } @else {
                (inputs)
            }
            h3 { "Options" }
            div class="scroll" { table class="facts" { tbody { (rows(options)) } } }
        }
    }
}

fn rows(facts: &[Fact]) -> Markup {
    html! {
        @for fact in facts { tr { th { (fact.name) } td class="text" { code { (fact.value) } } } }
    }
}
