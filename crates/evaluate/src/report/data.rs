//! The data behind the numbers: losses, notes, inputs and options.

use std::collections::BTreeMap;

use maud::{Markup, html};

use super::{Fact, messages};
use crate::Input;

pub(super) fn section(input: &Input<'_>, facts: &[Fact]) -> Markup {
    let mut keyframes: BTreeMap<&str, usize> = BTreeMap::new();
    for keyframe in input.keyframes {
        *keyframes.entry(&keyframe.id.log).or_default() += 1;
    }
    html! {
        section {
            h2 { "Data and options" }
            (messages::tables(input.losses, input.not_evaluated.iter().chain(input.notes)))
            h3 { "Inputs and options" }
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
