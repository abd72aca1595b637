//! The evidence that no wrong candidate has.

use std::cmp::Ordering;

use model::{Detector, DetectorPart, StrongLimits};

use super::{Judged, NotFitted};

/// With fewer wrong candidates, nothing is known about how much evidence a wrong one can have.
const MIN_WRONG: usize = 25;
const MIN_RIGHT: usize = 25;
/// A wrong candidate must miss one of the limits by this much. Two candidates of one place differ by
/// about as much.
const MARGIN: f64 = 0.02;
/// Limits that fewer of the right candidates reach are useless: no closure would reach them in most
/// logs. Then the wrong candidates with the most evidence are tolerated, as few as possible.
const LEAST_SHARE: f64 = 0.1;
/// The limits are multiples of this.
const STEP: f64 = 0.01;

/// Fits the limits: those that the largest share of the right candidates reaches, and no wrong one. They
/// are never laxer than the starting values. Candidates in corridors do not count: their position along
/// the corridor is not known, so that a closure of the right place can be wrong.
pub(super) fn fit(logs: &[Vec<Judged<'_>>]) -> Result<StrongLimits, NotFitted> {
    let all: Vec<&Judged<'_>> = logs.iter().flatten().filter(|c| !c.is_degenerate()).collect();
    let n_right = all.iter().filter(|c| c.is_right).count();
    let n_wrong = all.len() - n_right;
    if n_right < MIN_RIGHT || n_wrong < MIN_WRONG {
        return Err(NotFitted {
            part: DetectorPart::Strong,
            found: format!("{n_right} right and {n_wrong} wrong candidates outside corridors"),
            expected: format!("{MIN_RIGHT} or more right and {MIN_WRONG} or more wrong ones"),
        });
    }
    let choices: Vec<Choice> = limits().map(|limits| Choice::new(limits, &all)).collect();
    let fewest_wrong = choices
        .iter()
        .filter(|choice| LEAST_SHARE <= choice.share)
        .map(|choice| choice.n_wrong)
        .min()
        .unwrap_or(0);
    let best = choices
        .into_iter()
        .filter(|choice| choice.n_wrong <= fewest_wrong)
        .reduce(|best, next| if best.compare(&next).is_lt() { next } else { best });
    Ok(best.map_or_else(|| Detector::starting_values().strong, |choice| choice.limits))
}

/// All limits that are considered.
fn limits() -> impl Iterator<Item = StrongLimits> {
    let start = Detector::starting_values().strong;
    // Multiples of 0.01 as the nearest number to what is written, such as 0.57.
    let multiple = |k: f64| (k * STEP * 100.0).round() / 100.0;
    let [least, most] = [start.known_overlap, 0.98].map(|v| (v / STEP).round() as i32);
    let conflicts = (start.conflict / STEP).round() as i32;
    (least..=most).flat_map(move |k| {
        (1..=conflicts).map(move |c| StrongLimits {
            known_overlap: multiple(f64::from(k)),
            conflict: multiple(f64::from(c)),
        })
    })
}

struct Choice {
    limits: StrongLimits,
    /// Share of the right candidates within the limits.
    share: f64,
    /// Wrong candidates within the limits or closer to them than the margin.
    n_wrong: usize,
}

impl Choice {
    /// By share. Of equal shares, the limits that accept the larger range of evidence are better: right
    /// candidates of other buildings will have other evidence.
    fn compare(&self, other: &Self) -> Ordering {
        let area = |limits: &StrongLimits| (1.0 - limits.known_overlap) * limits.conflict;
        let by_area = || area(&self.limits).total_cmp(&area(&other.limits));
        self.share.total_cmp(&other.share).then_with(by_area)
    }

    fn new(limits: StrongLimits, candidates: &[&Judged<'_>]) -> Self {
        let wide = StrongLimits {
            known_overlap: limits.known_overlap - MARGIN,
            conflict: limits.conflict + MARGIN,
        };
        let (mut reached, mut right, mut n_wrong) = (0.0, 0.0, 0);
        for candidate in candidates {
            let evidence = &candidate.found.evidence;
            if candidate.is_right {
                right += candidate.weight;
                reached += if limits.accept(evidence) { candidate.weight } else { 0.0 };
            } else if wide.accept(evidence) {
                n_wrong += 1;
            }
        }
        Self { limits, share: reached / right, n_wrong }
    }
}
