//! What changed between two runs.

use maud::{Markup, html};

use super::{figure, messages};
use crate::comparison::{
    ChangeOfClosure, ComparedClosures, ComparedLabels, Comparison, Motion, Origin, Presence,
    ReasonCount,
};
use crate::figures::Figure;
use crate::text::{NO_VALUE, thousands};

/// Closures of a kind in the table of changed closures. All are in the output of `--json`.
const MAX_ROWS: usize = 30;

/// Whether something changed, and what.
pub(super) fn answer(of: &Comparison) -> Markup {
    let notes = of.notes();
    html! {
        p class="headline" {
            @if of.is_changed() {
                b { "Changed: " }
                (thousands(of.closures.n_lost as u64)) " closures lost, "
                (thousands(of.closures.n_gained as u64)) " gained, "
                (thousands(of.closures.n_moved as u64)) " of " (thousands(of.closures.n_kept as u64)) " moved."
                @if let Some(largest_m) = of.trajectories.iter().map(|t| t.max_m).reduce(f64::max) {
                    " Optimized poses differ by up to " (format!("{largest_m:.3}")) "\u{a0}m."
                }
            } @else {
                b { "Nothing changed" } " beyond the tolerances: "
                (thousands(of.closures.n_kept as u64)) " closures in both runs."
            }
        }
        @if !notes.is_empty() { div class="warnings" { (messages::notes(notes.iter())) } }
        div class="scroll" { table {
            thead { tr { th { "run" } th class="text" { "folder" } th { "program" } th { "seed" } } }
            tbody { @for (side, run) in [("A", &of.a), ("B", &of.b)] { tr {
                th { (side) } td class="text" { (run.folder) } td { (run.program_version) } td { (run.seed) }
            } } }
        } }
    }
}

/// All differences.
pub(super) fn section(of: &Comparison, figures: &[(usize, Figure)]) -> Markup {
    html! {
        section { h2 { "Logs and maps" } (logs(of)) }
        section { h2 { "Loop closures" } (closures(&of.closures)) (changed_closures(&of.closures)) }
        section {
            h2 { "Trajectories" }
            (trajectories(of))
            div class="figures" { @for (k, drawn) in figures {
                @let trajectory = &of.trajectories[*k];
                (figure(std::slice::from_ref(drawn), &drawn.id, &html! {
                    b { (trajectory.logs.join(", ")) } ": map " (trajectory.map_b) " of B, aligned with map " (trajectory.map_a)
                    " of A. Lost and moved closures are drawn at the poses of A, gained ones at the poses of B. "
                    "The circle marks the largest difference, " (format!("{:.3}", trajectory.max_m)) "\u{a0}m."
                }))
            } }
        }
        section { h2 { "Labels" } (labels(of)) }
        section { h2 { "Origins" } (origins(&of.origins)) (tolerances(of)) }
    }
}

fn logs(of: &Comparison) -> Markup {
    html! {
        div class="scroll" { table {
            thead { tr {
                th { "log" } th { "in" } th { "keyframes" small { "A" } } th { "keyframes" small { "B" } }
                th { "in both" } th { "other stamps" small { "same number" } } th { "maps" small { "A" } } th { "maps" small { "B" } }
            } }
            tbody { @for log in &of.logs { tr {
                th { (log.log) }
                td class=[(log.presence != Presence::Both).then_some("bad")] {
                    @match log.presence { Presence::Both => "A and B", Presence::OnlyA => "A only", Presence::OnlyB => "B only" }
                }
                @for n in [log.n_keyframes_a, log.n_keyframes_b, log.n_common_keyframes] { td { (thousands(n as u64)) } }
                td class=[(0 < log.n_other_stamps).then_some("bad")] { (thousands(log.n_other_stamps as u64)) }
                td { (log.n_maps_a) } td class=[(log.n_maps_a != log.n_maps_b).then_some("bad")] { (log.n_maps_b) }
            } } }
        } }
        @for (side, pairs) in [("A", &of.maps.joined_only_in_a), ("B", &of.maps.joined_only_in_b)] {
            @if !pairs.is_empty() {
                p { "In one map in " (side) " only: "
                    @for (k, [first, second]) in pairs.iter().enumerate() { @if 0 < k { ", " } code { (first) } " and " code { (second) } }
                    "."
                }
            }
        }
    }
}

fn closures(of: &ComparedClosures) -> Markup {
    let rows = [
        ("accepted closures", [of.n_a, of.n_b, of.n_kept, of.n_lost, of.n_gained]),
        (
            "keyframes with a closure",
            [
                of.n_closed_keyframes_a,
                of.n_closed_keyframes_b,
                of.n_closed_keyframes_a - of.n_closed_keyframes_only_a,
                of.n_closed_keyframes_only_a,
                of.n_closed_keyframes_only_b,
            ],
        ),
    ];
    html! {
        div class="scroll" { table {
            thead { tr { th { "" } th { "A" } th { "B" } th { "kept" } th { "lost" } th { "gained" } } }
            tbody { @for (name, numbers) in rows { tr { th { (name) } @for n in numbers { td { (thousands(n as u64)) } } } } }
        } }
        @if let Some(kept) = &of.kept { (motion(kept)) }
        @for (what, counts, side) in [("Lost", &of.lost, "B"), ("Gained", &of.gained, "A")] {
            @if !counts.is_empty() { p { (what) ", by the reason in " (side) ": " (reasons(counts)) "." } }
        }
        @for (side, n) in [("A", of.n_with_logs_only_in_a), ("B", of.n_with_logs_only_in_b)] {
            @if 0 < n { p { (thousands(n as u64)) " closures of " (side) " are with logs that only " (side) " has." } }
        }
        p class="note" {
            "A closure is a pair of scans. A keyframe has a closure if at least one accepted closure joins it with another one; "
            "only keyframes of both runs are counted. Standard deviations are those of the closure in A."
        }
    }
}

fn reasons(counts: &[ReasonCount]) -> Markup {
    html! {
        @for (k, count) in counts.iter().enumerate() {
            @if 0 < k { ", " } (thousands(count.n as u64)) " " code { (count.reason) }
        }
    }
}

fn motion(kept: &Motion) -> Markup {
    let std = |value: Option<f64>| value.map_or(NO_VALUE.to_owned(), |std| format!("{std:.2}"));
    html! {
        div class="scroll" { table {
            thead { tr { th { "motion of kept closures" } th { "shift" } th { "turn" } th { "standard deviations" } } }
            tbody {
                tr { th { "median" } td { (format!("{:.4}", kept.median_m)) "\u{a0}m" } td { (format!("{:.3}", kept.median_deg)) "\u{a0}deg" } td { (std(kept.median_std)) } }
                tr { th { "largest" } td { (format!("{:.4}", kept.max_m)) "\u{a0}m" } td { (format!("{:.3}", kept.max_deg)) "\u{a0}deg" } td { (std(kept.max_std)) } }
            }
        } }
    }
}

/// The first changed closures of each kind.
fn changed_closures(of: &ComparedClosures) -> Markup {
    let kinds = of.changes.chunk_by(|a, b| a.change == b.change);
    html! {
        @for changes in kinds {
            @let name = match changes[0].change {
                ChangeOfClosure::Lost => "lost",
                ChangeOfClosure::Gained => "gained",
                ChangeOfClosure::Moved => "moved",
            };
            details {
                summary { (thousands(changes.len() as u64)) " " (name) @if changes.len() == 1 { " closure" } @else { " closures" }
                    @if MAX_ROWS < changes.len() { ", the first " (MAX_ROWS) }
                }
                div class="scroll" { table {
                    thead { tr { th { "query" } th { "reference" } th { "reason" } th { "shift" } th { "turn" } th { "standard deviations" } } }
                    tbody { @for change in changes.iter().take(MAX_ROWS) { tr {
                        th { (change.query_log) " " (change.query_scan) }
                        td { (change.reference_log) " " (change.reference_scan) }
                        td { (change.reason.as_deref().unwrap_or(NO_VALUE)) }
                        td { (optional(change.shift_m, 4, "m")) } td { (optional(change.turn_deg, 3, "deg")) } td { (optional(change.shift_std, 2, "")) }
                    } } }
                } }
            }
        }
    }
}

fn optional(value: Option<f64>, decimals: usize, unit: &str) -> String {
    value.map_or(NO_VALUE.to_owned(), |value| format!("{value:.decimals$}\u{a0}{unit}"))
}

fn trajectories(of: &Comparison) -> Markup {
    html! {
        div class="scroll" { table {
            thead { tr {
                th { "logs" } th { "map" small { "A, B" } } th { "scans" } th { "distance" small { "median" } } th { "distance" small { "largest" } }
                th { "turn" small { "median" } } th { "turn" small { "largest" } } th { "largest distance" }
            } }
            tbody { @for t in &of.trajectories { tr {
                th { (t.logs.join(", ")) }
                td { (t.map_a) ", " (t.map_b) } td { (thousands(t.n_scans as u64)) }
                td { (format!("{:.4}", t.median_m)) "\u{a0}m" }
                td class=[(of.tolerances.max_shift_m < t.max_m).then_some("bad")] { (format!("{:.4}", t.max_m)) "\u{a0}m" }
                td { (format!("{:.3}", t.median_deg)) "\u{a0}deg" }
                td class=[(of.tolerances.max_turn_deg < t.max_deg).then_some("bad")] { (format!("{:.3}", t.max_deg)) "\u{a0}deg" }
                td { "near scan " (t.farthest.keyframe) small { (t.farthest.log) ", path " (format!("{:.0}", t.farthest.travel_m)) "\u{a0}m" } }
            } } }
        } }
        p class="note" {
            "Distances between the optimized positions of each scan, after the shift and turn of B that makes their squares least. "
            "A row with several logs aligns a whole map; the other rows align one log alone."
        }
    }
}

fn labels(of: &Comparison) -> Markup {
    let of_pairs = |l: &ComparedLabels| {
        [l.n_a, l.n_b, l.n_common, l.n_positive_to_negative, l.n_negative_to_positive]
    };
    let places = &of.places;
    let of_places =
        [places.n_a, places.n_b, places.n_a - places.n_only_a, places.n_only_a, places.n_only_b];
    let row = |name: Markup, numbers: [usize; 5]| {
        html! { tr { th { (name) } @for n in numbers { td { (thousands(n as u64)) } } } }
    };
    html! {
        div class="scroll" { table {
            thead { tr { th { "" } th { "A" } th { "B" } th { "both" } th { "no longer positive" } th { "newly positive" } } }
            tbody {
                @if let Some(labels) = &of.labels { (row(html! { "labelled pairs" }, of_pairs(labels))) }
                (row(html! { "keyframe pairs within " (of.place_rule.positive_radius_m) "\u{a0}m" }, of_places))
            }
        } }
        @if of.labels.is_none() { p class="note" { "One of the runs has no labelled pairs. Places are compared by the optimized poses." } }
        @if 0 < places.n_in_two_maps || places.farthest_m.is_some() {
            p { "Of the pairs at the same place in one run only, " (thousands(places.n_in_two_maps as u64)) " are in two maps in the other run"
                @if let Some(farthest_m) = places.farthest_m { ", and the others are up to " (format!("{farthest_m:.2}")) "\u{a0}m apart there" }
                "."
            }
        }
    }
}

fn origins(origins: &[Origin]) -> Markup {
    let text = |value: &Option<String>| value.clone().unwrap_or_else(|| NO_VALUE.to_owned());
    html! {
        @if origins.is_empty() {
            p { "Both runs were made from the same files, with the same options, seed and version of the program." }
        } @else {
            div class="scroll" { table class="facts" {
                thead { tr { th { "table" } th class="text" { "what differs" } th class="text" { "A" } th class="text" { "B" } } }
                tbody { @for origin in origins { tr {
                    th { (origin.table) } td class="text" { (origin.key) }
                    td class="text" { code { (text(&origin.a)) } } td class="text" { code { (text(&origin.b)) } }
                } } }
            } }
        }
    }
}

fn tolerances(of: &Comparison) -> Markup {
    let t = &of.tolerances;
    html! {
        p class="note" {
            "Tolerances: " (t.max_shift_m) "\u{a0}m, " (t.max_turn_deg) "\u{a0}deg, " (t.max_lost) " lost and " (t.max_gained)
            " gained closures, " (t.max_flips) " pairs with another label or place"
            @if t.allow_new_logs { ", new logs allowed" } "."
        }
    }
}
