//! The data behind the numbers: what was left out, inputs and options.

use std::collections::BTreeMap;

use maud::{Markup, html};

use super::Fact;
use crate::Input;

pub(super) fn section(input: &Input<'_>, facts: &[Fact]) -> Markup {
    let mut keyframes: BTreeMap<&str, usize> = BTreeMap::new();
    for keyframe in input.keyframes {
        *keyframes.entry(&keyframe.id.log).or_default() += 1;
    }
    html! {
        section {
            h2 { "Data and options" }
            @if input.losses.is_empty() {
                p { "Nothing was left out." }
            } @else {
                h3 { "Left out" }
                ul { @for (loss, n) in input.losses.iter() { li { (loss.sentence(n)) " " code { (loss.kind.code()) } } } }
            }
            @if !input.notes.is_empty() {
                h3 { "Notes" }
                ul { @for note in input.notes { li { (note) " " code { (note.code()) } } } }
            }
            div class="scroll" {
                table class="facts" {
                    tbody {
                        @for (log, n) in &keyframes { tr { th { (log) } td class="text" { (n) " keyframes" } } }
                        @for fact in facts { tr { th { (fact.name) } td class="text" { code { (fact.value) } } } }
                    }
                }
            }
        }
    }
}
