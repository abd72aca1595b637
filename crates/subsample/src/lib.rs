//! `subsample`: scans and poses -> keyframes.
//!
//! The first usable scan of a log is a keyframe. A later scan becomes a keyframe when its
//! straight-line distance from the last keyframe is at least `spacing_m`. If `turn_deg` is set, a
//! heading change of at least `turn_deg` since the last keyframe is enough too. The distance is not
//! the path length, because path length grows with the jitter of a robot that stands still.
//!
//! A trajectory can have several segments, because its poses jump or its clock steps. No pose is
//! interpolated and no path is counted between two segments. If the poses of a segment are in another
//! frame than those before, its first usable scan is a keyframe.
//!
//! ```
//! use dataset::{Pose2, StampedPose, Trajectory};
//! use subsample::{Candidate, Options, subsample};
//!
//! // A robot that drives 1 m/s along x for 2 s, and a scan every 0.25 s.
//! let pose = |second: i64| {
//!     let pose = Pose2 { x_m: second as f64, y_m: 0.0, heading_rad: 0.0 };
//!     StampedPose::new(second * 1_000_000_000, pose)
//! };
//! let (trajectory, _) = Trajectory::new(vec![pose(0), pose(1), pose(2)]);
//! let scans: Vec<Candidate> = (0..9)
//!     .map(|scan| Candidate {
//!         scan,
//!         stamp_ns: i64::from(scan) * 250_000_000,
//!         coverage_deg: 360.0,
//!         usable: true,
//!     })
//!     .collect();
//!
//! let options = Options { spacing_m: 0.5, ..Options::default() };
//! let (keyframes, losses) =
//!     subsample(&options, &"drive".into(), &"campus".into(), &scans, &trajectory)?;
//! let kept: Vec<u32> = keyframes.iter().map(|keyframe| keyframe.id.scan).collect();
//! assert_eq!(kept, [0, 2, 4, 6, 8]);
//! assert!(losses.is_empty());
//! # Ok::<(), subsample::SubsampleError>(())
//! ```

use std::collections::BTreeMap;
use std::sync::Arc;

use dataset::{
    FULL_RING_DEG, Keyframe, LossKind, Losses, NoPose, OutOfRange, Pose2, ScanId, Trajectory,
};
use serde::{Deserialize, Serialize};

/// The section `[subsample]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "SubsampleOptions"))]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Least straight-line distance from one keyframe to the next \[m\].
    pub spacing_m: f64,
    /// Also keep a scan when the heading has changed by this much since the last keyframe \[deg\].
    /// Useful for a scanner that sees less than a full circle. Not set by default: a change of
    /// heading alone keeps no scan.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub turn_deg: Option<f64>,
    /// Largest time between two poses to interpolate between \[s\]. A scan in a longer gap is
    /// dropped and counted. A scan with exactly the stamp of a pose needs no interpolation.
    pub max_pose_gap_secs: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self { spacing_m: 0.5, turn_deg: None, max_pose_gap_secs: 2.0 }
    }
}

impl Options {
    /// Checks that every value is in range.
    pub fn check(&self) -> Result<(), OutOfRange> {
        let (spacing, gap) = (self.spacing_m, self.max_pose_gap_secs);
        check_option("spacing_m", spacing, 0.0 < spacing, "more than 0")?;
        if let Some(turn) = self.turn_deg {
            let is_in_range = 0.0 < turn && turn <= 180.0;
            check_option("turn_deg", turn, is_in_range, "more than 0 and at most 180")?;
        }
        check_option("max_pose_gap_secs", gap, 0.0 <= gap, "0 or more")
    }
}

/// A scan without its points, which may become a keyframe.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// Number of the scan in its log.
    pub scan: u32,
    /// When the scan's first beam fired \[ns since the epoch\].
    pub stamp_ns: i64,
    /// Angle covered by the scan \[deg\].
    pub coverage_deg: f32,
    /// Whether features can be computed from the scan.
    pub usable: bool,
}

/// Why a log has no keyframes.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum SubsampleError {
    /// The log has no poses.
    #[error("log `{log}` has no poses: set `ingest.pose.topic` to its pose topic")]
    NoPoses {
        /// The log.
        log: Arc<str>,
    },
    /// The robot never moves far enough for a second keyframe.
    #[error(
        "log `{log}`: its {n_poses} poses stay within {farthest_m:.3} m of the first, less than `subsample.spacing_m` ({spacing_m}); check that the pose topic contains the pose of the robot and not the mounting pose of a sensor, or leave the log out of `ingest.logs`"
    )]
    NeverMoves {
        /// The log.
        log: Arc<str>,
        /// Number of poses in the log.
        n_poses: usize,
        /// Largest distance from the first pose \[m\].
        farthest_m: f64,
        /// [`Options::spacing_m`].
        spacing_m: f64,
    },
    /// No scan has a pose and is usable.
    #[error(
        "log `{log}`: none of its {n_scans} scans could be kept ({losses}); check that lidar and poses are stamped by the same clock, and check `subsample.max_pose_gap_secs` and the lidar's range limits"
    )]
    NoKeyframes {
        /// The log.
        log: Arc<str>,
        /// Number of scans in the log.
        n_scans: usize,
        /// What was dropped, with counts.
        losses: Losses,
    },
    /// An option is out of range.
    #[error(transparent)]
    OutOfRange(#[from] OutOfRange),
}

impl SubsampleError {
    /// A stable name of an error of one log, for programs. `None` if the error is not about the log.
    pub fn code(&self) -> Option<&'static str> {
        match self {
            Self::NoPoses { .. } => Some("log_without_poses"),
            Self::NeverMoves { .. } => Some("never_moves"),
            Self::NoKeyframes { .. } => Some("no_keyframes"),
            Self::OutOfRange(_) => None,
        }
    }
}

/// Selects the keyframes of one log, and counts what was dropped.
///
/// Scans are visited in the order of their stamps, because stamps can go back in time in a log. A
/// scan without a pose is dropped. If a scan is due to become a keyframe but is not usable, it is
/// dropped and the next usable scan becomes the keyframe. If nine of ten scans cover a full circle, those that do not
/// are not usable: the recording began within a revolution, or packets are missing. Their features could not be
/// compared with those of the others.
///
/// Fails when an option is out of range, when there are no poses, when the robot never moves far
/// enough, or when no scan could be kept.
pub fn subsample(
    options: &Options,
    log: &Arc<str>,
    site: &Arc<str>,
    candidates: &[Candidate],
    trajectory: &Trajectory,
) -> Result<(Vec<Keyframe>, Losses), SubsampleError> {
    options.check()?;
    check_moves(options, log, trajectory)?;
    let turn_rad = options.turn_deg.map_or(f64::INFINITY, f64::to_radians);
    let max_gap_ns = (options.max_pose_gap_secs * 1e9) as i64;

    let mut by_stamp: Vec<&Candidate> = candidates.iter().collect();
    by_stamp.sort_by_key(|candidate| (candidate.stamp_ns, candidate.scan));
    let usable = || candidates.iter().filter(|scan| scan.usable);
    let n_full = usable().filter(|scan| FULL_RING_DEG <= scan.coverage_deg).count();
    let needs_full = MOST * usable().count() as f64 <= n_full as f64;
    let mut keyframes: Vec<Keyframe> = Vec::new();
    let mut losses = Losses::default();
    for candidate in by_stamp {
        let stamped = match trajectory.stamped_pose_at(candidate.stamp_ns, max_gap_ns) {
            Ok(stamped) => stamped,
            Err(why) => {
                losses.add(loss_kind(why), 1);
                continue;
            }
        };
        let travel_m = match keyframes.last() {
            None => 0.0,
            // The distance to a pose in another frame is not known.
            Some(last) if last.frame != stamped.frame => last.travel_m,
            Some(last) => {
                let moved_m = last.pose.distance_m(&stamped.pose);
                let turned_rad = last.pose.heading_difference_rad(&stamped.pose);
                if moved_m < options.spacing_m && turned_rad < turn_rad {
                    continue;
                }
                if last.segment == stamped.segment {
                    last.travel_m + moved_m
                } else {
                    last.travel_m
                }
            }
        };
        if !candidate.usable {
            losses.add(LossKind::UnusableScans, 1);
            continue;
        }
        if needs_full && candidate.coverage_deg < FULL_RING_DEG {
            losses.add(LossKind::PartialScans, 1);
            continue;
        }
        keyframes.push(Keyframe {
            id: ScanId { log: log.clone(), scan: candidate.scan },
            site: site.clone(),
            stamp_ns: candidate.stamp_ns,
            pose: stamped.pose,
            covariance: stamped.covariance,
            z_m: stamped.z_m,
            segment: stamped.segment,
            frame: stamped.frame,
            map: None,
            travel_m,
            coverage_deg: candidate.coverage_deg,
        });
    }
    if keyframes.is_empty() {
        let n_scans = candidates.len();
        return Err(SubsampleError::NoKeyframes { log: log.clone(), n_scans, losses });
    }
    Ok((keyframes, losses))
}

/// With this share of full circles, the other scans of a log are exceptions.
const MOST: f64 = 0.9;

/// Checks that some pose is `spacing_m` away from the first one of its frame, or turned from it by
/// `turn_deg` if that option is set.
fn check_moves(
    options: &Options,
    log: &Arc<str>,
    trajectory: &Trajectory,
) -> Result<(), SubsampleError> {
    if trajectory.poses().is_empty() {
        return Err(SubsampleError::NoPoses { log: log.clone() });
    }
    let mut firsts: BTreeMap<u32, Pose2> = BTreeMap::new();
    for p in trajectory.poses() {
        firsts.entry(p.frame).or_insert(p.pose);
    }
    let largest = |of: fn(&Pose2, &Pose2) -> f64| {
        trajectory.poses().iter().map(|p| of(&firsts[&p.frame], &p.pose)).fold(0.0, f64::max)
    };
    let farthest_m = largest(Pose2::distance_m);
    let turns_enough =
        options.turn_deg.is_some_and(|t| t.to_radians() <= largest(Pose2::heading_difference_rad));
    if options.spacing_m <= farthest_m || turns_enough {
        return Ok(());
    }
    let n_poses = trajectory.poses().len();
    let spacing_m = options.spacing_m;
    Err(SubsampleError::NeverMoves { log: log.clone(), n_poses, farthest_m, spacing_m })
}

/// The loss of a scan without a pose.
fn loss_kind(why: NoPose) -> LossKind {
    match why {
        NoPose::BeforeFirst => LossKind::ScansBeforePoses,
        NoPose::AfterLast => LossKind::ScansAfterPoses,
        NoPose::Gap => LossKind::ScansInPoseGap,
        NoPose::BetweenSegments => LossKind::ScansBetweenSegments,
    }
}

fn check_option(
    key: &str,
    found: f64,
    is_in_range: bool,
    expected: &str,
) -> Result<(), OutOfRange> {
    if is_in_range && found.is_finite() {
        Ok(())
    } else {
        Err(OutOfRange::new(format!("subsample.{key}"), found, expected))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dataset::StampedPose;

    /// Checks the scan numbers and travelled distances of the keyframes. The robot is at `x_m[k]` at
    /// second `k`, and there is a scan every half second.
    fn check(x_m: &[f64], unusable: &[u32], expected: &[(u32, f64)]) -> Losses {
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
        let (keyframes, losses) = subsample(
            &Options::default(),
            &"drive".into(),
            &"site".into(),
            &candidates,
            &trajectory,
        )
        .unwrap();
        let found: Vec<_> = keyframes.iter().map(|k| (k.id.scan, k.travel_m)).collect();
        assert_eq!(found, expected);
        losses
    }

    #[test]
    fn a_keyframe_is_kept_every_half_metre() {
        // 0.25 m from one scan to the next: every second scan.
        check(&[0.0, 0.5, 1.0, 1.5], &[], &[(0, 0.0), (2, 0.5), (4, 1.0), (6, 1.5)]);
        // 0.375 m from one scan to the next: the second scan, at 0.75 m, is the first past 0.5 m.
        check(&[0.0, 0.75, 1.5], &[], &[(0, 0.0), (2, 0.75), (4, 1.5)]);
    }

    /// The robot drives 0.5 m per scan. Scans 0 and 10 of 20 have another coverage than the others.
    #[test]
    fn partial_scans_are_not_used_among_full_circles() {
        let keyframes_of = |coverage_deg: f32, odd_deg: f32| {
            let poses = (0..20).map(|k| {
                let pose = Pose2 { x_m: 0.5 * k as f64, ..Pose2::default() };
                StampedPose::new(k * 1_000_000_000, pose)
            });
            let (trajectory, _) = Trajectory::new(poses.collect());
            let candidate = |scan: u32| Candidate {
                scan,
                stamp_ns: i64::from(scan) * 1_000_000_000,
                coverage_deg: if scan.is_multiple_of(10) { odd_deg } else { coverage_deg },
                usable: true,
            };
            let candidates: Vec<_> = (0..20).map(candidate).collect();
            let (log, site) = ("drive".into(), "site".into());
            let options = Options::default();
            let (keyframes, losses) =
                subsample(&options, &log, &site, &candidates, &trajectory).unwrap();
            (keyframes.iter().map(|k| k.id.scan).collect::<Vec<_>>(), losses.total())
        };
        let without: Vec<u32> = (0..20).filter(|scan| scan % 10 != 0).collect();
        assert_eq!(keyframes_of(360.0, 118.0), (without, 2));
        // Otherwise, whether the scans can be used together is decided later.
        for (usual_deg, odd_deg) in [(180.0, 118.0), (180.0, 360.0)] {
            assert_eq!(keyframes_of(usual_deg, odd_deg), ((0..20).collect(), 0));
        }
    }

    #[test]
    fn jitter_of_a_robot_that_stands_still_keeps_one_scan() {
        check(&[0.0, 0.2, 0.0, 0.2, 0.0, 0.2, 1.2], &[], &[(0, 0.0), (11, 0.7), (12, 1.2)]);
    }

    /// Numbers of the kept scans. There is a scan at each pose, and the heading changes by 30 deg
    /// from one pose to the next.
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
    fn heading_changes_keep_scans_if_turn_deg_is_set() {
        let x_m = [0.0, 0.1, 0.2, 0.3, 0.9, 1.0];
        assert_eq!(turning(&x_m, None).unwrap(), [0, 4]);
        // 30 deg per scan: every second scan is past 50 deg. Scan 4 is past the spacing too.
        assert_eq!(turning(&x_m, Some(50.0)).unwrap(), [0, 2, 4]);
        assert_eq!(turning(&x_m, Some(20.0)).unwrap(), [0, 1, 2, 3, 4, 5]);
        // Turning on the spot by more than a full circle.
        assert_eq!(turning(&[0.0; 14], Some(89.0)).unwrap(), [0, 3, 6, 9, 12]);
    }

    #[test]
    fn a_robot_that_never_moves_is_an_error() {
        let error = turning(&[0.0, 0.25, -0.125], None).unwrap_err();
        assert_eq!(
            error.to_string(),
            "log `drive`: its 3 poses stay within 0.250 m of the first, less than \
             `subsample.spacing_m` (0.5); check that the pose topic contains the pose of the robot \
             and not the mounting pose of a sensor, or leave the log out of `ingest.logs`"
        );
        assert!(turning(&[0.0, 0.0, 0.0], Some(61.0)).is_err());
    }

    #[test]
    fn the_next_usable_scan_replaces_an_unusable_keyframe() {
        // Scan 3 would be the second keyframe, but it is not usable. Scan 4 is kept, 0.75 m from the
        // first.
        let expected = [(1, 0.0), (4, 0.75), (6, 1.25)];
        let losses = check(&[0.0, 0.5, 1.0, 1.5], &[0, 3], &expected);
        let expected = "2 scans with fewer than 3 returns or all returns on one line";
        assert_eq!(losses.to_string(), expected);
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
        let (keyframes, losses) = run(&[9, 10, 15, 16, 11, 24]).unwrap();
        assert_eq!(keyframes.len(), 1);
        assert_eq!(
            losses.to_string(),
            "1 scan before the first pose, 1 scan after the last pose, 2 scans in a gap between poses"
        );
        assert!(matches!(run(&[1, 2]), Err(SubsampleError::NoKeyframes { n_scans: 2, .. })));
        // Scans are visited in the order of their stamps.
        let (keyframes, _) = run(&[11, 10]).unwrap();
        assert_eq!(keyframes[0].id.scan, 1);
    }

    /// The robot drives 1 m/s along x. From second 3 on, its poses are 100 m further. The scan at 2.5 s
    /// lies between the segments. In a new frame, the scan at 3 s is a keyframe, although it would also
    /// be one because of the distance; in the same frame, the poses at 3 s are 0.2 m from the last
    /// keyframe, so it is not.
    #[test]
    fn no_path_is_counted_and_no_pose_interpolated_between_segments() {
        let run = |jump_m: f64, frame: u32| {
            let pose = |s: i64| {
                let is_after = 3 <= s;
                let x_m = s as f64 + if is_after { jump_m } else { 0.0 };
                StampedPose {
                    z_m: Some(0.5 * s as f64),
                    segment: u32::from(is_after),
                    frame: if is_after { frame } else { 0 },
                    ..StampedPose::new(s * 1_000_000_000, Pose2 { x_m, ..Pose2::default() })
                }
            };
            let (trajectory, _) = Trajectory::new((0..6).map(pose).collect());
            let candidates: Vec<_> = (0..11)
                .map(|scan| Candidate {
                    scan,
                    stamp_ns: i64::from(scan) * 500_000_000,
                    coverage_deg: 360.0,
                    usable: true,
                })
                .collect();
            let options = Options { spacing_m: 0.9, ..Options::default() };
            let (log, site) = ("a".into(), "a".into());
            let (keyframes, losses) =
                subsample(&options, &log, &site, &candidates, &trajectory).unwrap();
            assert_eq!(
                losses.to_string(),
                "1 scan between two segments of the trajectory (the poses jump or the clock steps there)"
            );
            for k in &keyframes {
                assert_eq!(k.z_m, Some(0.25 * f64::from(k.id.scan)));
                assert_eq!(k.segment, u32::from(6 <= k.id.scan));
            }
            keyframes.iter().map(|k| (k.id.scan, k.travel_m, k.frame)).collect::<Vec<_>>()
        };
        let before = [(0, 0.0, 0), (2, 1.0, 0), (4, 2.0, 0)];
        let after = |rest: &[(u32, f64, u32)]| [&before[..], rest].concat();
        assert_eq!(run(100.0, 1), after(&[(6, 2.0, 1), (8, 3.0, 1), (10, 4.0, 1)]));
        assert_eq!(run(-0.8, 1), after(&[(6, 2.0, 1), (8, 3.0, 1), (10, 4.0, 1)]));
        // x is 2.2 m at 3 s, and 3.2 m at 4 s.
        assert_eq!(run(-0.8, 0)[3].0, 8);
        assert!((run(-0.8, 0)[3].1 - 2.0).abs() < 1e-12 && run(-0.8, 0)[4].0 == 10);
    }

    #[test]
    fn an_option_out_of_range_is_reported_by_name() {
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
