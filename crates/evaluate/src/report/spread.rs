//! Where the labelled pairs are.

use dataset::NEIGHBOUR_GAP_M;
use maud::{Markup, html};

use crate::spread::Spread;
use crate::text::{percent, thousands};
use crate::{Evaluation, Input};

pub(super) fn section(input: &Input<'_>, evaluation: &Evaluation) -> Markup {
    html! {
        section {
            h2 { "Labelled pairs" }
            @for sentence in input.label_basis { p { "Basis: " (sentence) "." } }
            p {
                "A place is a square of ground " (input.place_m) "\u{a0}m wide. A pair counts for the place of the scan whose place has more scans. "
                "The more places the pairs are from, the more likely the results hold elsewhere. "
                code { "label.max_place_share" } " limits the share of one place."
            }
            div class="scroll" {
                table {
                    thead { tr {
                        th { "class" } th { "pairs" } th { "places" }
                        th { "effective places" small { "as diverse as this many places with equal numbers of pairs" } }
                        th { "largest share of a place" } th class="text" { "where" }
                        th { "neighbours along the path" small { "less than " (NEIGHBOUR_GAP_M) "\u{a0}m of path between the scans" } }
                    } }
                    tbody { @for spread in &evaluation.spreads { (row(spread)) } }
                }
            }
        }
    }
}

fn row(spread: &Spread) -> Markup {
    let name = if spread.class == "positive" { "matches" } else { "non-matches" };
    let [x_m, y_m] = spread.centre_m;
    html! {
        tr {
            th { (name) } td { (thousands(spread.n_pairs as u64)) }
            td { (thousands(spread.n_places as u64)) } td { (format!("{:.0}", spread.effective_places)) }
            td { (percent(spread.largest_share)) }
            td class="text" { (spread.site) " at (" (x_m) ", " (y_m) ")\u{a0}m" }
            td { (percent(spread.neighbour_share)) }
        }
    }
}
