//! Scan matching along a drive, in stretches that are matched in parallel.

use std::f64::consts::PI;
use std::ops::Range;

use dataset::Pose2;
use nalgebra::Matrix3;
use rayon::prelude::*;

use crate::align::Weakness;
use crate::matcher::{Matched, MatcherOptions, ScanMatcher};
use crate::points::Points;
use crate::source::ScanSource;

/// Number of scans of a stretch.
const STRETCH: usize = 512;
/// A stretch is matched from so many lengths of the matcher's target before it, so that its first scan has a whole
/// target.
const LEAD: f64 = 1.5;
/// The points of this many scans are read at a time: scans that are close in time are stored together.
const SCANS_AT_ONCE: usize = 64;

/// Matches each scan of a drive with those of the last metres. `odometry` has the pose of the lidar at each scan, and
/// `path_m` the path up to it. `matcher` makes a matcher without scans.
///
/// The stretches and what they are matched from depend on the drive alone, so that the result is the same for any number
/// of threads. Each stretch is put to the one before it with the scans that both contain.
pub(crate) fn match_drive(
    scans: &dyn ScanSource,
    odometry: &[Pose2],
    path_m: &[f64],
    options: &MatcherOptions,
    matcher: &(dyn Fn() -> ScanMatcher + Sync),
) -> Vec<Matched> {
    let starts: Vec<usize> = (0..odometry.len()).step_by(STRETCH).collect();
    let with_leads: Vec<(usize, Range<usize>)> = starts
        .iter()
        .map(|&start| (start, lead(path_m, start, options)..(start + STRETCH).min(odometry.len())))
        .collect();
    let stretches: Vec<Vec<Matched>> = with_leads
        .par_iter()
        .with_max_len(1)
        .map(|(_, range)| match_stretch(scans, odometry, range.clone(), matcher()))
        .collect();
    let mut matched: Vec<Matched> = Vec::with_capacity(odometry.len());
    for ((start, range), stretch) in with_leads.iter().zip(stretches) {
        let n_lead = start - range.start;
        let (common, rest) = stretch.split_at(n_lead);
        let placed = map_from_stretch(&matched[range.start..*start], common);
        matched.extend(rest.iter().map(|scan| moved(scan, &placed)));
    }
    matched
}

/// The first scan that a stretch is matched from.
fn lead(path_m: &[f64], start: usize, options: &MatcherOptions) -> usize {
    let from_m = path_m[start] - LEAD * options.target_path_m;
    let most = (LEAD * f64::from(options.max_keyframes)).ceil() as usize;
    let first = path_m[..start].partition_point(|&m| m < from_m);
    // At least two scans, also after a jump of the odometry: without a common scan, the stretch could not be placed.
    first.max(start.saturating_sub(most)).min(start.saturating_sub(2))
}

/// Matches consecutive scans, one after the other.
fn match_stretch(
    scans: &dyn ScanSource,
    odometry: &[Pose2],
    range: Range<usize>,
    mut matcher: ScanMatcher,
) -> Vec<Matched> {
    let mut matched = Vec::with_capacity(range.len());
    for first in range.clone().step_by(SCANS_AT_ONCE) {
        let block = first..(first + SCANS_AT_ONCE).min(range.end);
        let points: Vec<Points> = block.clone().map(|k| scans.scan(k).points().clone()).collect();
        let of_block = points.into_iter().zip(&odometry[block]);
        matched.extend(of_block.map(|(points, odometry)| matcher.add(points, odometry)));
    }
    matched
}

/// Where a stretch lies in the map, from the same scans in both: the median of what the later half of them says about
/// the last one. The earlier ones had a smaller target in the stretch.
fn map_from_stretch(in_map: &[Matched], in_stretch: &[Matched]) -> Pose2 {
    let (Some(map_from_last), Some(stretch_from_last)) = (in_map.last(), in_stretch.last()) else {
        return Pose2::default();
    };
    let (map_from_last, stretch_from_last) = (map_from_last.pose, stretch_from_last.pose);
    let half = in_map.len() / 2;
    let off: Vec<Pose2> = in_map[half..]
        .iter()
        .zip(&in_stretch[half..])
        .map(|(map, stretch)| {
            map_from_last.inverse() * map.pose * stretch.pose.inverse() * stretch_from_last
        })
        .collect();
    let median = |of: fn(&Pose2) -> f64| {
        let mut values: Vec<f64> = off.iter().map(of).collect();
        let middle = values.len() / 2;
        *values.select_nth_unstable_by(middle, f64::total_cmp).1
    };
    let off = Pose2 {
        x_m: median(|off| off.x_m),
        y_m: median(|off| off.y_m),
        heading_rad: median(|off| off.heading_rad),
    };
    map_from_last * off * stretch_from_last.inverse()
}

/// A matched scan in the frame of the map.
fn moved(scan: &Matched, map_from_stretch: &Pose2) -> Matched {
    let turn_rad = map_from_stretch.heading_rad;
    let (sin, cos) = libm::sincos(turn_rad);
    let turn = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
    Matched {
        pose: *map_from_stretch * scan.pose,
        covariance: scan.covariance.map(|covariance| turn * covariance * turn.transpose()),
        weakness: scan.weakness.map(|weakness| Weakness {
            direction_rad: (weakness.direction_rad + turn_rad).rem_euclid(PI),
            ..weakness
        }),
        ..*scan
    }
}

#[cfg(test)]
mod tests {
    use dataset::{RangeLimits, Scan, SplitMix64};

    use super::*;
    use crate::points::length;
    use crate::source::HeldScans;
    use model::Detector;

    fn pose(x_m: f64, y_m: f64, heading_rad: f64) -> Pose2 {
        Pose2 { x_m, y_m, heading_rad }
    }

    fn matched(pose: Pose2) -> Matched {
        Matched { pose, covariance: None, near_share: 1.0, weakness: None, is_used: true }
    }

    /// A stretch with a frame of its own, whose first scans are off, and so is one of the others.
    #[test]
    fn most_of_the_common_scans_say_where_a_stretch_lies() {
        let expected = pose(40.0, -7.0, 2.5);
        let in_stretch: Vec<Matched> =
            (0..11).map(|k| matched(pose(0.4 * f64::from(k), 0.1, 0.02))).collect();
        let mut in_map: Vec<Matched> =
            in_stretch.iter().map(|scan| matched(expected * scan.pose)).collect();
        for k in [0, 1, 2, 3, 4, 8] {
            in_map[k].pose = in_map[k].pose * pose(0.5, 0.0, 0.1);
        }
        let off = expected.inverse() * map_from_stretch(&in_map, &in_stretch);
        assert!(length([off.x_m, off.y_m]) < 1e-9 && off.heading_rad.abs() < 1e-9, "{off:?}");
        // The first stretch has no scans in common with another one.
        assert_eq!(map_from_stretch(&[], &[]), Pose2::default());
    }

    /// A corridor along x in a stretch that is turned by 120 deg in the map.
    #[test]
    fn covariance_and_weakness_turn_with_the_stretch() {
        let turn_rad = 2.0 * PI / 3.0;
        let scan = Matched {
            covariance: Some(Matrix3::from_diagonal(&[0.04, 0.0001, 0.01].into())),
            weakness: Some(Weakness { ratio: 0.01, direction_rad: 2.0 }),
            ..matched(pose(1.0, 0.0, 0.0))
        };
        let found = moved(&scan, &pose(5.0, 6.0, turn_rad));
        let (sin, cos) = turn_rad.sin_cos();
        assert!((found.pose.x_m - (5.0 + cos)).abs() < 1e-12);
        assert!((found.pose.y_m - (6.0 + sin)).abs() < 1e-12);
        let covariance = found.covariance.unwrap();
        assert!((covariance[(0, 0)] - (0.04 * cos * cos + 0.0001 * sin * sin)).abs() < 1e-12);
        assert!((covariance[(0, 1)] - (0.04 - 0.0001) * sin * cos).abs() < 1e-12);
        assert!((covariance[(2, 2)] - 0.01).abs() < 1e-12);
        let weakness = found.weakness.unwrap();
        assert!((weakness.direction_rad - (2.0 + turn_rad - PI)).abs() < 1e-12);
    }

    /// 12 m before a stretch; 90 scans if the robot stands or turns; the whole drive near its start.
    #[test]
    fn a_stretch_starts_with_a_whole_target() {
        let options = MatcherOptions::default();
        let path_m: Vec<f64> = (0..2000).map(|k| 0.5 * f64::from(k)).collect();
        assert_eq!(lead(&path_m, 512, &options), 512 - 24);
        assert_eq!(lead(&path_m, 0, &options), 0);
        assert_eq!(lead(&path_m, 10, &options), 0);
        assert_eq!(lead(&[0.0; 2000], 512, &options), 512 - 90);
        // The odometry jumps by 50 m at the start of the stretch.
        let with_jump: Vec<f64> =
            path_m.iter().enumerate().map(|(k, m)| if k < 512 { *m } else { m + 50.0 }).collect();
        assert_eq!(lead(&with_jump, 512, &options), 510);
    }

    /// A scan of 360 beams in a room of 14 m by 10 m around the origin.
    fn scan_of_room(map_from_lidar: &Pose2) -> Scan {
        let mut scan = Scan { coverage_deg: 360.0, ..Scan::default() };
        for k in 0..360 {
            let bearing_rad = f64::from(k).to_radians();
            let (sin, cos) = (map_from_lidar.heading_rad + bearing_rad).sin_cos();
            let to_wall = |from: f64, along: f64, half: f64| (half * along.signum() - from) / along;
            let range_m =
                to_wall(map_from_lidar.x_m, cos, 7.0).min(to_wall(map_from_lidar.y_m, sin, 5.0));
            scan.x_m.push((range_m * bearing_rad.cos()) as f32);
            scan.y_m.push((range_m * bearing_rad.sin()) as f32);
        }
        scan
    }

    /// A robot drives in circles, and its odometry turns by chance. The second stretch starts with the wrong
    /// heading, and is put to the first one.
    #[test]
    fn consecutive_stretches_have_no_gap() {
        let mut random = SplitMix64::new(5);
        let step = pose(0.2, 0.0, 0.1);
        let (mut truth, mut odometry) = (vec![pose(0.0, -2.0, 0.0)], vec![pose(0.0, -2.0, 0.0)]);
        for k in 1..600 {
            let turn = pose(0.0, 0.0, 0.04 * (random.unit() - 0.5));
            truth.push(truth[k - 1] * step);
            odometry.push(odometry[k - 1] * step * turn);
        }
        let limits = RangeLimits { min_m: 0.1, max_m: 25.0 };
        let scans = HeldScans::new(truth.iter().map(scan_of_room), limits);
        let path_m: Vec<f64> = (0..600).map(|k| 0.2 * f64::from(k)).collect();
        let options = MatcherOptions::default();
        let matcher = || ScanMatcher::new(options, Detector::starting_values().odometry);
        let matched = match_drive(&scans, &odometry, &path_m, &options, &matcher);
        let off = |poses: &dyn Fn(usize) -> Pose2| {
            let relative =
                |poses: &dyn Fn(usize) -> Pose2| poses(STRETCH - 5).inverse() * poses(STRETCH + 5);
            let off = relative(&|k| truth[k]).inverse() * relative(poses);
            length([off.x_m, off.y_m]) + off.heading_rad.abs()
        };
        assert!(off(&|k| matched[k].pose) < 0.02, "{}", off(&|k| matched[k].pose));
        let turned = odometry[STRETCH].heading_difference_rad(&matched[STRETCH].pose);
        assert!(0.05 < turned, "the drift would not show: {turned}");
    }
}
