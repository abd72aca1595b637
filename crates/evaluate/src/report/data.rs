//! The data behind the numbers: losses, notes, inputs and options.

use std::collections::BTreeMap;

use maud::{Markup, html};

use super::{Fact, messages};
use crate::Input;

/// With more logs than this, their keyframes and digests are folded.
const LOGS_SHOWN: usize = 10;

pub(super) fn section(input: &Input<'_>, digests: &[Fact], options: &[Fact]) -> Markup {
    let mut keyframes: BTreeMap<&str, usize> = BTreeMap::new();
    for keyframe in input.keyframes {
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
            (messages::tables(input.losses, input.not_evaluated.iter().chain(input.notes)))
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
