//! `subsample`: scans and poses -> keyframes.
//!
//! A keyframe is a scan whose straight-line distance from the last one kept reaches
//! `spacing_m`, or, where that is asked for, whose heading has turned by `turn_deg` since. Path
//! length would count the jitter of a robot that stands still.

use std::sync::Arc;

use dataset::{Dropped, Keyframe, Pose2, ScanId, Trajectory};
use serde::{Deserialize, Serialize};

/// The section `[subsample]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "SubsampleOptions"))]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Straight-line distance from one keyframe to the next \[m\].
    pub spacing_m: f64,
    /// A scan is kept too once the heading has turned by this much since the last one kept \[deg\]:
    /// for a scanner that sees less than a full circle. Default: turns alone keep none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub turn_deg: Option<f64>,
    /// A scan whose pose would be interpolated between two poses farther apart in time than this
    /// is dropped and counted \[s\]. A scan at the very stamp of a pose needs no second one.
    pub max_pose_gap_secs: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self { spacing_m: 0.5, turn_deg: None, max_pose_gap_secs: 2.0 }
    }
}

impl Options {
    /// Refuses values out of range.
    pub fn check(&self) -> Result<(), SubsampleError> {
        let (spacing, gap) = (self.spacing_m, self.max_pose_gap_secs);
        check_option("spacing_m", spacing, 0.0 < spacing, "more than 0")?;
        if let Some(turn) = self.turn_deg {
            let good = 0.0 < turn && turn <= 180.0;
            check_option("turn_deg", turn, good, "more than 0 and at most 180")?;
        }
        check_option("max_pose_gap_secs", gap, 0.0 <= gap, "0 or more")
    }
}

/// What a keyframe can be made of: a scan without its points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// Number of the scan in its log.
    pub scan: u32,
    /// When the scan's first beam fired \[ns since the epoch\].
    pub stamp_ns: i64,
    /// Angle swept by the scan \[deg\].
    pub coverage_deg: f32,
    /// Whether features can be computed from it.
    pub usable: bool,
}

/// Why a log gives no keyframes.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum SubsampleError {
    /// There is not one pose.
    #[error("log `{log}` has no poses: set `ingest.pose.topic` to its pose topic")]
    NoPoses {
        /// The log.
        log: Arc<str>,
    },
    /// There is nowhere to keep a second scan.
    #[error(
        "log `{log}`: its {n_poses} poses stay within {farthest_m:.3} m of the first, less than `subsample.spacing_m` ({spacing_m}); check that the pose topic tells where the robot is and not where a sensor sits on it, or leave the log out of `ingest.logs`"
    )]
    NeverMoves {
        /// The log.
        log: Arc<str>,
        /// Poses in the log.
        n_poses: usize,
        /// Largest distance from the first pose \[m\].
        farthest_m: f64,
        /// [`Options::spacing_m`].
        spacing_m: f64,
    },
    /// Scans and poses do not meet.
    #[error(
        "log `{log}`: none of its {n_scans} scans could be kept ({dropped}); check that the stamps of lidar and poses are of one clock, `subsample.max_pose_gap_secs`, and the lidar's range limits"
    )]
    NoKeyframes {
        /// The log.
        log: Arc<str>,
        /// Scans in the log.
        n_scans: usize,
        /// Reasons and counts.
        dropped: Dropped,
    },
    /// An option out of range.
    #[error("`subsample.{key}` is {found}, expected {expected}")]
    Option {
        /// The option.
        key: &'static str,
        /// Its value.
        found: f64,
        /// What it must be.
        expected: &'static str,
    },
}

/// Keeps a scan every `spacing_m` along one log.
///
/// Scans are taken in order of their stamps: logs exist in which stamps step back. Scans without
/// a pose are dropped; so are scans that no feature can be computed from, where they would have
/// become keyframes, and the next scan takes their place.
pub fn subsample(
    options: &Options,
    log: &Arc<str>,
    site: &Arc<str>,
    candidates: &[Candidate],
    trajectory: &Trajectory,
) -> Result<(Vec<Keyframe>, Dropped), SubsampleError> {
    options.check()?;
    check_moves(options, log, trajectory)?;
    let turn_rad = options.turn_deg.map_or(f64::INFINITY, f64::to_radians);
    let max_gap_ns = (options.max_pose_gap_secs * 1e9) as i64;

    let mut in_time: Vec<&Candidate> = candidates.iter().collect();
    in_time.sort_by_key(|candidate| (candidate.stamp_ns, candidate.scan));
    let mut keyframes: Vec<Keyframe> = Vec::new();
    let mut dropped = Dropped::default();
    for candidate in in_time {
        let stamped = match trajectory.stamped_pose_at(candidate.stamp_ns, max_gap_ns) {
            Ok(stamped) => stamped,
            Err(why) => {
                dropped.add(format!("scans {why}"), 1);
                continue;
            }
        };
        let travelled_m = match keyframes.last() {
            None => 0.0,
            Some(last) => {
                let moved_m = last.pose.distance_m(&stamped.pose);
                let turned_rad = last.pose.heading_difference_rad(&stamped.pose);
                if moved_m < options.spacing_m && turned_rad < turn_rad {
                    continue;
                }
                last.travel_m + moved_m
            }
        };
        if !candidate.usable {
            dropped.add("scans with fewer than 3 returns or all on one line", 1);
            continue;
        }
        keyframes.push(Keyframe {
            id: ScanId { log: log.clone(), scan: candidate.scan },
            site: site.clone(),
            stamp_ns: candidate.stamp_ns,
            pose: stamped.pose,
            covariance: stamped.covariance,
            travel_m: travelled_m,
            coverage_deg: candidate.coverage_deg,
        });
    }
    if keyframes.is_empty() {
        let n_scans = candidates.len();
        return Err(SubsampleError::NoKeyframes { log: log.clone(), n_scans, dropped });
    }
    Ok((keyframes, dropped))
}

/// Refuses a log whose poses are all at one place; turned there is moved, where turns are asked for.
fn check_moves(
    options: &Options,
    log: &Arc<str>,
    trajectory: &Trajectory,
) -> Result<(), SubsampleError> {
    let Some(first) = trajectory.poses().first() else {
        return Err(SubsampleError::NoPoses { log: log.clone() });
    };
    let largest = |of: fn(&Pose2, &Pose2) -> f64| {
        trajectory.poses().iter().map(|p| of(&first.pose, &p.pose)).fold(0.0, f64::max)
    };
    let farthest_m = largest(Pose2::distance_m);
    let turns =
        options.turn_deg.is_some_and(|t| t.to_radians() <= largest(Pose2::heading_difference_rad));
    if options.spacing_m <= farthest_m || turns {
        return Ok(());
    }
    let n_poses = trajectory.poses().len();
    let spacing_m = options.spacing_m;
    Err(SubsampleError::NeverMoves { log: log.clone(), n_poses, farthest_m, spacing_m })
}

fn check_option(
    key: &'static str,
    found: f64,
    good: bool,
    expected: &'static str,
) -> Result<(), SubsampleError> {
    if good && found.is_finite() {
        Ok(())
    } else {
        Err(SubsampleError::Option { key, found, expected })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dataset::StampedPose;

    /// A robot that is at `x_m[k]` at second `k`, and a scan every half second.
    fn check(x_m: &[f64], unusable: &[u32], expected: &[(u32, f64)]) -> Dropped {
        let poses = x_m.iter().zip(0..).map(|(&x_m, k)| {
            StampedPose::new(k * 1_000_000_000, Pose2 { x_m, ..Pose2::default() })
        });
        let (trajectory, _) = Trajectory::new(poses.collect());
        let candidates: Vec<_> = (0..2 * x_m.len() as u32 - 1)
            .map(|scan| Candidate {
                scan,
                stamp_ns: i64::from(scan) * 500_000_000,
                coverage_deg: 359.8,
                usable: !unusable.contains(&scan),
            })
            .collect();
        let (keyframes, dropped) = subsample(
            &Options::default(),
            &"drive".into(),
            &"site".into(),
            &candidates,
            &trajectory,
        )
        .unwrap();
        let found: Vec<_> = keyframes.iter().map(|k| (k.id.scan, k.travel_m)).collect();
        assert_eq!(found, expected);
        dropped
    }

    #[test]
    fn a_scan_each_half_metre() {
        // 0.25 m from one scan to the next: every second scan.
        check(&[0.0, 0.5, 1.0, 1.5], &[], &[(0, 0.0), (2, 0.5), (4, 1.0), (6, 1.5)]);
        // 0.375 m: 0.75 m is reached first.
        check(&[0.0, 0.75, 1.5], &[], &[(0, 0.0), (2, 0.75), (4, 1.5)]);
    }

    #[test]
    fn jitter_at_standstill_keeps_one_scan() {
        check(&[0.0, 0.2, 0.0, 0.2, 0.0, 0.2, 1.2], &[], &[(0, 0.0), (11, 0.7), (12, 1.2)]);
    }

    /// Poses each second and a scan at each, turned by 30 deg between.
    fn turning(x_m: &[f64], turn_deg: Option<f64>) -> Result<Vec<u32>, SubsampleError> {
        let poses = x_m.iter().zip(0..).map(|(&x_m, k)| {
            let heading_rad = dataset::wrap_angle((30.0 * k as f64).to_radians());
            let pose = Pose2 { x_m, y_m: 0.0, heading_rad };
            StampedPose { covariance: Some([k as f64; 6]), ..StampedPose::new(k, pose) }
        });
        let (trajectory, _) = Trajectory::new(poses.collect());
        let candidates: Vec<_> = (0..x_m.len() as u32)
            .map(|scan| {
                let stamp_ns = i64::from(scan);
                Candidate { scan, stamp_ns, coverage_deg: 180.0, usable: true }
            })
            .collect();
        let options = Options { turn_deg, ..Options::default() };
        let (log, site) = ("drive".into(), "site".into());
        let (keyframes, _) = subsample(&options, &log, &site, &candidates, &trajectory)?;
        for keyframe in &keyframes {
            assert_eq!(keyframe.covariance, Some([f64::from(keyframe.id.scan); 6]));
        }
        Ok(keyframes.iter().map(|k| k.id.scan).collect())
    }

    #[test]
    fn turns_keep_scans_where_asked_for() {
        let ways = [0.0, 0.1, 0.2, 0.3, 0.9, 1.0];
        assert_eq!(turning(&ways, None).unwrap(), [0, 4]);
        // 30 deg a scan: 50 deg is passed by the second; the way is reached at scan 4 too.
        assert_eq!(turning(&ways, Some(50.0)).unwrap(), [0, 2, 4]);
        assert_eq!(turning(&ways, Some(20.0)).unwrap(), [0, 1, 2, 3, 4, 5]);
        // On the spot, all around and past the seam.
        assert_eq!(turning(&[0.0; 14], Some(89.0)).unwrap(), [0, 3, 6, 9, 12]);
    }

    #[test]
    fn a_log_that_never_moves_is_an_error() {
        let error = turning(&[0.0, 0.25, -0.125], None).unwrap_err();
        assert_eq!(
            error.to_string(),
            "log `drive`: its 3 poses stay within 0.250 m of the first, less than \
             `subsample.spacing_m` (0.5); check that the pose topic tells where the robot is and not \
             where a sensor sits on it, or leave the log out of `ingest.logs`"
        );
        assert!(turning(&[0.0, 0.0, 0.0], Some(61.0)).is_err());
    }

    #[test]
    fn the_next_scan_takes_the_place_of_an_unusable_one() {
        // Scan 3 would be the second keyframe; scan 4 is, 0.75 m from the first.
        let expected = [(1, 0.0), (4, 0.75), (6, 1.25)];
        let dropped = check(&[0.0, 0.5, 1.0, 1.5], &[0, 3], &expected);
        assert_eq!(dropped.to_string(), "2 scans with fewer than 3 returns or all on one line");
    }

    #[test]
    fn scans_without_a_pose_are_counted_by_reason() {
        let pose = |s: i64| {
            let pose = Pose2 { x_m: 0.04 * s as f64, ..Pose2::default() };
            StampedPose::new(s * 1_000_000_000, pose)
        };
        let (trajectory, _) = Trajectory::new(vec![pose(10), pose(11), pose(23)]);
        let candidate = |scan: u32, s: i64| Candidate {
            scan,
            stamp_ns: s * 1_000_000_000,
            coverage_deg: 180.0,
            usable: true,
        };
        let run = |stamps: &[i64]| {
            let candidates: Vec<_> =
                stamps.iter().zip(0..).map(|(&s, k)| candidate(k, s)).collect();
            subsample(&Options::default(), &"a".into(), &"a".into(), &candidates, &trajectory)
        };
        let (keyframes, dropped) = run(&[9, 10, 15, 16, 11, 24]).unwrap();
        assert_eq!(keyframes.len(), 1);
        assert_eq!(
            dropped.to_string(),
            "1 scans after the last pose, 1 scans before the first pose, 2 scans in a gap between poses"
        );
        assert!(matches!(run(&[1, 2]), Err(SubsampleError::NoKeyframes { n_scans: 2, .. })));
        // Stamps that step back are taken in order of time.
        let (keyframes, _) = run(&[11, 10]).unwrap();
        assert_eq!(keyframes[0].id.scan, 1);
    }

    #[test]
    fn options_out_of_range_are_named() {
        let options = Options { spacing_m: 0.0, ..Options::default() };
        let error =
            subsample(&options, &"a".into(), &"a".into(), &[], &Trajectory::default()).unwrap_err();
        assert_eq!(error.to_string(), "`subsample.spacing_m` is 0, expected more than 0");
        let error =
            subsample(&Options::default(), &"a".into(), &"a".into(), &[], &Trajectory::default())
                .unwrap_err();
        assert!(matches!(error, SubsampleError::NoPoses { .. }));
    }
}
