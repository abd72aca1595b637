//! Where most references agree with a map as a whole, and what is wrong if they do not.

use dataset::{Pose2, wrap_angle};
use register::Drive;

use crate::reference::Reference;

/// References that contradict a map as a whole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contradiction {
    /// Number of references.
    pub n_references: usize,
    /// Median distance between measured and estimated positions where they fit best \[m\].
    pub median_m: f64,
    /// Median of the stated standard deviations in each direction \[m\].
    pub stated_std_m: f64,
    /// What explains it.
    pub cause: Cause,
}

/// What explains that references contradict a map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Cause {
    /// They fit if they are mirrored: x and y are exchanged, or one axis is reversed.
    Mirrored,
    /// They fit if the map is larger by this factor.
    Scaled(f64),
    /// They fit if they are of a later time by so many seconds.
    Delayed(f64),
    /// They fit at another place of their frame than that of the map, this far away.
    Moved {
        /// \[m\]
        distance_m: f64,
        /// \[rad\]
        turn_rad: f64,
    },
    /// They fit roughly, but their errors are larger than they state.
    Understated,
    /// Nothing of this.
    Unknown,
}

/// References and the map that they are compared with.
pub(crate) struct Fitted<'a> {
    pub(crate) drive: &'a Drive,
    pub(crate) references: &'a [Reference],
    /// Poses of all scans.
    pub(crate) poses: &'a [Pose2],
    /// Times of all scans \[ns\].
    pub(crate) stamps_ns: &'a [i64],
}

/// References that hypotheses are made of, and those that they are judged by. They are spread evenly.
const N_HYPOTHESES: usize = 48;
const N_JUDGED: usize = 256;
/// Consecutive matches closer than this are one, by the poses of the map \[m\].
const STOP_M: f64 = 0.5;
/// An explanation must reduce the median distance to this share of it.
const EXPLAINED_SHARE: f64 = 0.25;
/// A delay must leave this share of the references within their drive.
const MIN_DELAYED_SHARE: f64 = 0.75;
/// Delays that are tried: up to this many seconds, in steps of `DELAY_STEP_SECS`.
const MAX_DELAY_SECS: f64 = 60.0;
const DELAY_STEP_SECS: f64 = 0.5;
/// References fit roughly if their median distance is at most this share of the extent of the measured positions
/// (root mean square distance from their mean).
const ROUGH_SHARE: f64 = 0.1;

/// An estimated point and its measured pose.
#[derive(Debug, Clone, Copy)]
struct Match {
    at: Pose2,
    measured: Pose2,
    has_heading: bool,
    std_m: f64,
}

/// Where matches fit best.
#[derive(Debug, Clone, Copy)]
struct Fit {
    map_from_before: Pose2,
    scale: f64,
    /// Median distance in standard deviations.
    median: f64,
}

impl Fitted<'_> {
    /// The motion of the map as a whole after which half of the references are nearest to it: the least median of
    /// squares (Rousseeuw 1984, "Least median of squares regression"), over the motions that two positions or
    /// one pose give.
    pub(crate) fn best(&self) -> Pose2 {
        fit(&self.matches(), false).map_from_before
    }

    /// What is wrong with references that do not fit. `stays` says whether the map cannot be moved as a whole.
    pub(crate) fn contradiction(&self, stays: bool) -> Contradiction {
        let matches = self.matches();
        let free = fit(&matches, false);
        let at_rest = Fit { map_from_before: Pose2::default(), scale: 1.0, ..free };
        let plain =
            if stays { Fit { median: at_rest.median_of(&matches), ..at_rest } } else { free };
        let cause = self.cause(&matches, &plain, &free, stays);
        let mut distances: Vec<f64> = matches.iter().map(|m| plain.distance_m(m)).collect();
        let mut stds: Vec<f64> = matches.iter().map(|m| m.std_m).collect();
        Contradiction {
            n_references: matches.len(),
            median_m: median(&mut distances),
            stated_std_m: median(&mut stds),
            cause,
        }
    }

    fn cause(&self, matches: &[Match], plain: &Fit, free: &Fit, stays: bool) -> Cause {
        if stays && free.median < EXPLAINED_SHARE * plain.median {
            let Pose2 { x_m, y_m, heading_rad } = free.map_from_before;
            let distance_m = libm::hypot(x_m, y_m);
            return Cause::Moved { distance_m, turn_rad: heading_rad.abs() };
        }
        let mirrored: Vec<Match> = matches.iter().map(Match::mirrored).collect();
        let scaled = fit(matches, true);
        let mut explained = vec![
            (fit(&mirrored, false).median, Cause::Mirrored),
            (scaled.median, Cause::Scaled(scaled.scale)),
        ];
        let n_steps = (MAX_DELAY_SECS / DELAY_STEP_SECS) as i64;
        for step in (-n_steps..=n_steps).filter(|step| *step != 0) {
            let delay_secs = step as f64 * DELAY_STEP_SECS;
            let delayed = self.delayed(delay_secs);
            if MIN_DELAYED_SHARE * matches.len() as f64 <= delayed.len() as f64 {
                explained.push((fit(&delayed, false).median, Cause::Delayed(delay_secs)));
            }
        }
        let best = explained.into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, cause)) = best.filter(|(median, _)| *median < EXPLAINED_SHARE * free.median)
        {
            return cause;
        }
        let mut distances: Vec<f64> = matches.iter().map(|m| plain.distance_m(m)).collect();
        match median(&mut distances) <= ROUGH_SHARE * extent_m(matches) {
            true => Cause::Understated,
            false => Cause::Unknown,
        }
    }

    fn matches(&self) -> Vec<Match> {
        self.references.iter().map(|r| Match::new(r, r.point(self.poses))).collect()
    }

    /// The matches if the references are of a later time by `delay_secs`. Those outside of their drive are left
    /// out.
    fn delayed(&self, delay_secs: f64) -> Vec<Match> {
        let parts = self.drive.parts();
        let at = |reference: &Reference| {
            let of_drive = &parts[self.drive.part_of(reference.scan)];
            let stamps_ns = &self.stamps_ns[of_drive.clone()];
            let stamp_ns = reference.stamp_ns.saturating_add((delay_secs * 1e9) as i64);
            let after = stamps_ns.partition_point(|&other| other <= stamp_ns);
            let (last, next) =
                (after.checked_sub(1)?, Some(after).filter(|&k| k < stamps_ns.len())?);
            let share =
                (stamp_ns - stamps_ns[last]) as f64 / (stamps_ns[next] - stamps_ns[last]) as f64;
            let [from, to] = [last, next].map(|k| self.poses[of_drive.start + k]);
            // The way since the scan is left out.
            Some(Match::new(reference, from.towards(&to, share)))
        };
        self.references.iter().filter_map(at).collect()
    }
}

impl Match {
    fn new(reference: &Reference, at: Pose2) -> Self {
        let std_m = reference.variance_m2().sqrt();
        Self { at, measured: reference.measured, has_heading: reference.has_heading, std_m }
    }

    /// With the y axis of the measured positions reversed.
    fn mirrored(&self) -> Self {
        let Pose2 { x_m, y_m, heading_rad } = self.measured;
        Self { measured: Pose2 { x_m, y_m: -y_m, heading_rad: -heading_rad }, ..*self }
    }
}

impl Fit {
    fn distance_m(&self, of: &Match) -> f64 {
        let Pose2 { x_m, y_m, heading_rad } = of.at;
        let scaled = Pose2 { x_m: self.scale * x_m, y_m: self.scale * y_m, heading_rad };
        (self.map_from_before * scaled).distance_m(&of.measured)
    }

    /// Median distance in standard deviations.
    fn median_of(&self, matches: &[Match]) -> f64 {
        let mut distances: Vec<f64> =
            spread(matches, N_JUDGED).iter().map(|m| self.distance_m(m) / m.std_m).collect();
        median(&mut distances)
    }
}

/// Where most matches fit, with or without a change of the scale of the map.
fn fit(matches: &[Match], is_scaled: bool) -> Fit {
    let matches = without_stops(matches);
    let some = spread(&matches, N_HYPOTHESES);
    let judged = spread(&matches, N_JUDGED);
    let of_poses =
        some.iter().filter(|m| m.has_heading).map(|m| (m.measured * m.at.inverse(), 1.0));
    let pairs =
        some.iter().enumerate().flat_map(|(k, a)| some[k + 1..].iter().map(move |b| (a, b)));
    let of_pairs = pairs.filter_map(|(a, b)| of_pair(a, b, is_scaled));
    let at_rest = Fit { map_from_before: Pose2::default(), scale: 1.0, median: f64::INFINITY };
    of_poses.chain(of_pairs).fold(at_rest, |best, (map_from_before, scale)| {
        let found = Fit { map_from_before, scale, median: 0.0 };
        let median = found.median_of(&judged);
        if median < best.median { Fit { median, ..found } } else { best }
    })
}

/// The motion that puts the middle of two points onto the middle of their measured positions, in the same
/// direction.
fn of_pair(a: &Match, b: &Match, is_scaled: bool) -> Option<(Pose2, f64)> {
    let way = |from: &Pose2, to: &Pose2| [to.x_m - from.x_m, to.y_m - from.y_m];
    let [before, after] = [way(&a.at, &b.at), way(&a.measured, &b.measured)];
    let length_m = |way: [f64; 2]| libm::hypot(way[0], way[1]);
    if length_m(before) <= 0.0 || length_m(after) <= 0.0 {
        return None;
    }
    let scale = if is_scaled { length_m(after) / length_m(before) } else { 1.0 };
    let direction_rad = |way: [f64; 2]| libm::atan2(way[1], way[0]);
    let heading_rad = wrap_angle(direction_rad(after) - direction_rad(before));
    let middle = |a: &Pose2, b: &Pose2, factor: f64| Pose2 {
        x_m: factor * f64::midpoint(a.x_m, b.x_m),
        y_m: factor * f64::midpoint(a.y_m, b.y_m),
        heading_rad: 0.0,
    };
    let turned = Pose2 { x_m: 0.0, y_m: 0.0, heading_rad } * middle(&a.at, &b.at, scale);
    let to = middle(&a.measured, &b.measured, 1.0);
    Some((Pose2 { x_m: to.x_m - turned.x_m, y_m: to.y_m - turned.y_m, heading_rad }, scale))
}

/// Root mean square distance of the measured positions from their mean \[m\].
fn extent_m(matches: &[Match]) -> f64 {
    let n = matches.len() as f64;
    let mean = |value: &dyn Fn(&Match) -> f64| matches.iter().map(value).sum::<f64>() / n;
    let [x_m, y_m] = [mean(&|m| m.measured.x_m), mean(&|m| m.measured.y_m)];
    let squared = |m: &Match| (m.measured.x_m - x_m).powi(2) + (m.measured.y_m - y_m).powi(2);
    mean(&squared).sqrt()
}

/// The matches without those of a robot that stands still, which would outvote the others: every direction of the map
/// fits them.
fn without_stops(matches: &[Match]) -> Vec<Match> {
    let mut moving: Vec<Match> = Vec::new();
    for of_point in matches {
        if moving.last().is_none_or(|last| STOP_M <= last.at.distance_m(&of_point.at)) {
            moving.push(*of_point);
        }
    }
    moving
}

/// At most `n` of some matches, at even distances.
fn spread(matches: &[Match], n: usize) -> Vec<Match> {
    let step = matches.len().div_ceil(n).max(1);
    matches.iter().step_by(step).copied().collect()
}

/// The upper median; 0 of nothing.
fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The robot stands still for nearly all measurements. Every direction of the map fits those.
    #[test]
    fn a_stop_does_not_decide_the_direction() {
        let map_from_before = Pose2 { x_m: 40.0, y_m: -7.0, heading_rad: 1.2 };
        let of_point = |x_m: f64, y_m: f64, error_m: f64| {
            let at = Pose2 { x_m, y_m, ..Pose2::default() };
            let measured = map_from_before * at;
            let measured = Pose2 { y_m: measured.y_m + error_m, heading_rad: 0.0, ..measured };
            Match { at, measured, has_heading: false, std_m: 0.1 }
        };
        // The pose of the stop is known to millimetres, so that two measurements of it have a direction.
        let of_stop = |k: i32| {
            let [x_m, y_m] = [k % 5, k % 3].map(|step| 0.002 * f64::from(step));
            of_point(x_m, y_m, 0.01 * f64::from(k % 7 - 3))
        };
        let mut matches: Vec<Match> = (0..3000).map(of_stop).collect();
        matches.extend((1..=30).map(|k| of_point(2.0 * f64::from(k), 0.0, 0.0)));
        let found = fit(&matches, false).map_from_before;
        assert!(wrap_angle(found.heading_rad - 1.2).abs() < 0.01, "{found:?}");
    }
}
