//! Loop closures: what was found, what each stage loses, and how the map changes.

use maud::{Markup, html};

use super::figure;
use crate::detection::{
    AgainstTruth, Calibration, DOUBTFUL_DEG, DOUBTFUL_M, Drive, DriveMeasures, FALSE_DEG, FALSE_M,
    FoundClosure, NEAR_PATH_M, PLACE_M, PoseSource, REVISIT_M, REVISIT_PATH_M, RIGHT_DEG, RIGHT_M,
    Revisits, SiteMeasures,
};
use crate::figures::{ClosureSketches, DriveSketch, Figure, Overlay, drive_name, overlay_id};
use crate::text::{NO_VALUE, optional_percent, thousands};

/// Nothing without drives.
pub(super) fn section(
    drives: &[Drive<'_>],
    measures: &[DriveMeasures],
    sites: &[SiteMeasures],
    sketches: &ClosureSketches,
    figures: &[Figure],
) -> Markup {
    if drives.is_empty() {
        return html! {};
    }
    let has_truth = measures.iter().any(|m| m.truth.is_some());
    html! {
        section {
            h2 { "Loop closures" }
            (answer(measures))
            (counts(measures))
            @if has_truth {
                h3 { "Errors of accepted closures and of trajectories" }
                (errors(measures))
                h3 { "Revisits after each stage" }
                (losses(measures))
            } @else {
                p class="note" { "There is no ground truth: errors are not known. Set " code { "[evaluate] truth" } " to the topic of a better source of poses to measure them." }
            }
            @if !sites.is_empty() {
                h3 { "Maps of several drives" }
                (self::sites(sites))
            }
            @if !sketches.maps.is_empty() {
                div class="figures" { @for (n, map) in (1..).zip(&sketches.maps) {
                    (figure(figures, &format!("joined-{n}"), &html! {
                        b { "Map " (map.map) } ": " (names(map.drives.iter().map(|&k| &measures[k])))
                        ", with the scans at the optimized poses."
                    }))
                } }
            }
            @for sketch in &sketches.drives {
                (drive(&drives[sketch.drive], &measures[sketch.drive], sketch, figures))
            }
            @if sketches.drives.len() < drives.len() {
                p class="note" { "Maps of the " (sketches.drives.len()) " longest drives. The numbers of all " (drives.len()) " drives are in the tables above." }
            }
            div class="figures" {
                (figure(figures, "candidates", &html! {
                    "Candidates of " code { "detect" } ": precision against recall over their confidence. Right candidates count as positive, false ones as negative."
                }))
            }
        }
    }
}

/// The names of drives.
fn names<'a>(drives: impl Iterator<Item = &'a DriveMeasures>) -> String {
    drives.map(drive_name).collect::<Vec<_>>().join(", ")
}

/// The result in one paragraph.
fn answer(measures: &[DriveMeasures]) -> Markup {
    let sum = |of: &dyn Fn(&DriveMeasures) -> usize| measures.iter().map(of).sum::<usize>();
    let of_truth =
        |of: fn(&AgainstTruth) -> usize| sum(&|m: &DriveMeasures| m.truth.as_ref().map_or(0, of));
    let n_judged = of_truth(|t| t.closures.n_judged);
    let n_revisits = of_truth(|t| t.revisits.all.n);
    let n_rejected = sum(&|m| m.rejected.iter().map(|r| r.n).sum());
    html! {
        p class="headline" {
            b { (thousands(sum(&|m| m.n_accepted) as u64)) } " loop closures are accepted in "
            @match measures.len() { 1 => { "1 drive" } n => { (n) " drives" } }
            " and " (thousands(n_rejected as u64)) " rejected."
            @if 0 < n_judged {
                " Of " (thousands(n_judged as u64)) " accepted closures with ground truth, "
                b { (of_truth(|t| t.closures.n_false_by_pose)) } " are false."
            }
            @if 0 < n_revisits {
                " " b { (optional_percent(Some(of_truth(|t| t.revisits.all.n_closed) as f64 / n_revisits as f64))) }
                " of " (thousands(n_revisits as u64)) " revisits are closed."
            }
        }
    }
}

/// Candidates and closures of each drive.
fn counts(measures: &[DriveMeasures]) -> Markup {
    let mut reasons: Vec<&str> =
        measures.iter().flat_map(|m| m.rejected.iter().map(|r| &*r.reason)).collect();
    reasons.sort_unstable();
    reasons.dedup();
    let rejected = |m: &DriveMeasures, reason: &str| {
        m.rejected.iter().find(|r| r.reason == reason).map_or(0, |r| r.n)
    };
    html! {
        div class="scroll" {
            table {
                thead { tr {
                    th { "drive" } th { "keyframes" } th { "path" } th { "candidates" } th { "accepted" }
                    @for reason in &reasons { th { "rejected" small { (reason) } } }
                } }
                tbody { @for m in measures { tr {
                    th { (drive_name(m)) }
                    td { (thousands(m.n_keyframes as u64)) }
                    td { (thousands(m.path_m.round() as u64)) "\u{a0}m" }
                    td { (thousands(m.n_candidates as u64)) }
                    td { (thousands(m.n_accepted as u64)) }
                    @for reason in &reasons { td { (thousands(rejected(m, reason) as u64)) } }
                } } }
            }
        }
    }
}

/// The maps of sites with several drives, and the closures between the drives.
fn sites(sites: &[SiteMeasures]) -> Markup {
    html! {
        div class="scroll" {
            table {
                thead { tr {
                    th { "site" } th { "drives" } th { "accepted" small { "between drives" } }
                    th { "rejected" } th { "false" small { "beyond " (FALSE_M) "\u{a0}m or " (FALSE_DEG) "\u{a0}deg" } }
                    th { "error" small { "median" } } th { "revisits closed" small { "of an earlier drive" } }
                    th { "maps" small { "logs; ATE after one alignment" } }
                } }
                tbody { @for site in sites { tr {
                    th { (site.site) } td { (site.n_drives) }
                    td { (thousands(site.n_accepted as u64)) } td { (thousands(site.n_rejected as u64)) }
                    @match site.truth {
                        Some(truth) => {
                            td class=[(truth.n_false > 0).then_some("bad")] { (truth.n_false) " of " (truth.n_judged) }
                            td { (metres(truth.median_m)) }
                            td { (truth.n_closed) " of " (truth.n_revisits) }
                        }
                        None => { td { (NO_VALUE) } td { (NO_VALUE) } td { (NO_VALUE) } }
                    }
                    td { @for map in &site.maps {
                        div { (map.logs.join(", ")) ": " (metres(map.ate_rmse_m)) }
                    } }
                } } }
            }
        }
    }
}

fn errors(measures: &[DriveMeasures]) -> Markup {
    html! {
        div class="scroll" {
            table {
                thead { tr {
                    th { "drive" }
                    th { "false" small { "beyond " (FALSE_M) "\u{a0}m or " (FALSE_DEG) "\u{a0}deg" } }
                    @for metres in PLACE_M { th { "beyond " (metres) "\u{a0}m" small { "true distance of the scans" } } }
                    th { "error" small { "median" } } th { "error" small { "90\u{a0}%" } }
                    th { "NEES" small { "3 is right; 95\u{a0}% bounds" } }
                    @for source in PoseSource::ALL { th { "ATE" small { (crate::figures::source_name(source)) } } }
                } }
                tbody { @for m in measures { @if let Some(truth) = &m.truth { tr {
                    @let closures = &truth.closures;
                    th { (drive_name(m)) }
                    td class=[(closures.n_false_by_pose > 0).then_some("bad")] { (closures.n_false_by_pose) " of " (closures.n_judged) }
                    @for n in closures.n_false_by_place { td { (n) } }
                    td { (error(closures.median_m, closures.median_deg)) }
                    td { (error(closures.p90_m, closures.p90_deg)) }
                    td { (nees(truth.closure_calibration.as_ref())) }
                    @for trajectory in &truth.trajectories {
                        td { (metres(trajectory.ate_rmse_m)) small { (thousands(trajectory.n_poses as u64)) " poses" } }
                    }
                } } } }
            }
        }
        p class="note" {
            "ATE: root mean square distance to the true positions after alignment, at the scans with a measured true pose. "
            @let n_doubtful: usize = measures.iter().filter_map(|m| m.truth.as_ref()).map(|t| t.n_doubtful).sum();
            @if 0 < n_doubtful {
                (n_doubtful) " true poses contradict scan matching by more than " (DOUBTFUL_M) "\u{a0}m or " (DOUBTFUL_DEG)
                "\u{a0}deg, both before and after; closures are not compared with them. With them, "
                (measures.iter().filter_map(|m| m.truth.as_ref()).map(|t| t.n_false_with_doubtful).sum::<usize>()) " closures would be false. "
            }
            "NEES: mean squared error, normalized by the covariance. Above its bounds, covariances are too small. The factor is by how much. "
            "All numbers are in " code { "evaluation/detection.parquet" } ", every closure is in " code { "evaluation/closure_errors.parquet" } "."
        }
    }
}

fn error(position_m: Option<f64>, heading_deg: Option<f64>) -> Markup {
    html! {
        (metres(position_m))
        @if let Some(deg) = heading_deg { small { (format!("{deg:.2}")) "\u{a0}deg" } }
    }
}

fn metres(value: Option<f64>) -> String {
    value.map_or_else(|| NO_VALUE.to_owned(), |value| format!("{value:.3}\u{a0}m"))
}

fn nees(calibration: Option<&Calibration>) -> Markup {
    html! {
        @match calibration {
            Some(c) => {
                (format!("{:.2}", c.mean))
                small { (format!("{:.2} to {:.2}", c.low, c.high)) }
                small { (format!("factor {:.2}", c.factor)) }
            }
            None => { (NO_VALUE) }
        }
    }
}

/// How many revisits each stage reaches.
fn losses(measures: &[DriveMeasures]) -> Markup {
    let rows: Vec<(String, &Revisits)> = measures
        .iter()
        .filter_map(|m| Some((drive_name(m), &m.truth.as_ref()?.revisits)))
        .collect();
    html! {
        div class="scroll" {
            table {
                thead { tr {
                    th { "drive" } th { "revisits" } th { "retrieved" } th { "right pose" small { "among the candidates" } }
                    th { "kept" small { "candidate accepted" } } th { "closed nearby" } th { "closed" }
                    th { "recall" }
                } }
                tbody { @for (name, revisits) in &rows {
                    @for (direction, counts) in [
                        ("", &revisits.all),
                        ("same direction", &revisits.same_direction),
                        ("opposite direction", &revisits.opposite_direction),
                    ] {
                        @if direction.is_empty() || (0 < counts.n && counts.n < revisits.all.n) { tr {
                            th class=[(!direction.is_empty()).then_some("part")] { @if direction.is_empty() { (name) } @else { (direction) } }
                            td { (counts.n) } td { (counts.n_retrieved) } td { (counts.n_proposed) }
                            td { (counts.n_kept) } td { (counts.n_closed_nearby) } td { (counts.n_closed) }
                            td { (optional_percent(counts.recall())) }
                        } }
                    }
                } }
            }
        }
        p class="note" {
            "A revisit is a keyframe with an earlier one within " (REVISIT_M) "\u{a0}m and at least " (REVISIT_PATH_M)
            "\u{a0}m of path before. It is closed if a closure of this keyframe is accepted that is within "
            (RIGHT_M) "\u{a0}m and " (RIGHT_DEG) "\u{a0}deg of the truth. The columns from \u{201c}retrieved\u{201d} to \u{201c}closed nearby\u{201d} also count "
            "what a stage finds within " (NEAR_PATH_M) "\u{a0}m of path, because " code { "detect" } " compares places a few metres apart. "
            "Opposite direction: all earlier headings are more than 90\u{a0}deg apart. All revisits are in " code { "evaluation/revisits.parquet" } "."
        }
    }
}

/// The figures of one drive.
fn drive(
    drive: &Drive<'_>,
    measures: &DriveMeasures,
    sketch: &DriveSketch,
    figures: &[Figure],
) -> Markup {
    let n = sketch.drive + 1;
    let of =
        if measures.truth.is_some() { "Errors" } else { "Differences from the optimized poses" };
    html! {
        h3 { (drive_name(measures)) }
        (maps(n, measures, figures))
        div class="figures" {
            @for quantity in ["m", "deg"] {
                (figure(figures, &format!("drift-{quantity}-{n}"), &html! {
                    (of) " of relative poses against path length: " @if quantity == "m" { "position" } @else { "heading" } "."
                }))
            }
        }
        div class="pairs" {
            @for overlay in &sketch.overlays {
                (figure(figures, &overlay_id(sketch, overlay), &evidence(drive, measures, overlay)))
            }
        }
    }
}

/// The map before and after, with a switch for the rejected closures.
fn maps(n: usize, measures: &DriveMeasures, figures: &[Figure]) -> Markup {
    let n_rejected: usize = measures.rejected.iter().map(|r| r.n).sum();
    let switch = format!("rejected-{n}");
    html! {
        @if 0 < n_rejected {
            input type="checkbox" class="switch" id=(switch);
            label for=(switch) { " show " (thousands(n_rejected as u64)) " rejected closures" }
        }
        div class="figures" {
            (figure(figures, &format!("before-{n}"), &html! {
                b { "Before" } ": scans at the poses of odometry. Accepted closures join scans that show the same place."
            }))
            (figure(figures, &format!("after-{n}"), &html! {
                b { "After" } ": scans at the optimized poses, with the same closures."
            }))
        }
    }
}

/// The caption of an overlay.
fn evidence(drive: &Drive<'_>, measures: &DriveMeasures, overlay: &Overlay) -> Markup {
    let closure: &FoundClosure<'_> = &drive.closures[overlay.closure];
    let e = &closure.evidence;
    let judged = measures.truth.as_ref().and_then(|t| t.judged[overlay.closure]);
    html! {
        b { (overlay.kind.title()) }
        @if let Some(reason) = closure.rejected { ": " code { (reason) } }
        br;
        "confidence " (format!("{:.3}", closure.confidence))
        ", overlap " (format!("{:.2}", e.overlap))
        ", of known space " (format!("{:.2}", e.known_overlap))
        ", conflict " (format!("{:.2}", e.conflict))
        ", margin " (format!("{:.2}", e.margin))
        @if let Some(classifier) = e.classifier { ", classifier " (format!("{classifier:+.2}")) }
        @if e.is_degenerate { ", degenerate" }
        @if let Some(judged) = judged {
            br;
            "error " (format!("{:.2}", judged.error_m)) "\u{a0}m and "
            (format!("{:.1}", judged.error_rad.to_degrees())) "\u{a0}deg, true distance "
            (format!("{:.1}", judged.distance_m)) "\u{a0}m"
        }
    }
}
