//! Checks that the logs of a site can share a map frame.

use std::collections::BTreeMap;

use dataset::{NoteKind, Pose2, Trajectory};

use crate::pose_choice::is_odometry_frame;

/// A first pose this close to the origin is at the origin \[m\]. Odometry starts at exactly 0; a
/// recording that starts while the robot sets off misses a fraction of a second, which is 0.1 m at
/// 0.5 m/s and 0.2 s.
const AT_ORIGIN_M: f64 = 0.1;

/// The start of the trajectory of a log.
pub(crate) struct Start {
    log: String,
    frame_id: Option<String>,
    first: Pose2,
}

impl Start {
    /// The start of a trajectory; `None` if it is empty.
    pub(crate) fn of(log: &str, trajectory: &Trajectory) -> Option<Self> {
        let first = trajectory.poses().first()?.pose;
        let frame_id = trajectory.frame_id().map(str::to_owned);
        Some(Self { log: log.to_owned(), frame_id, first })
    }
}

/// Remarks about sites of two logs or more: about poses in a frame of odometry, or else about logs that
/// all start at the origin. Each of these logs probably has a map frame of its own.
///
/// A robot that is localised in a shared map and always starts at its origin, such as a dock, is also
/// reported if its first pose is within [`AT_ORIGIN_M`] in every log.
pub(crate) fn unshared_frames(sites: &BTreeMap<String, Vec<Start>>) -> Vec<NoteKind> {
    let mut notes = Vec::new();
    for (site, starts) in sites.iter().filter(|(_, starts)| 1 < starts.len()) {
        let mut of_odometry: BTreeMap<&str, Vec<String>> = BTreeMap::new();
        for Start { log, frame_id, .. } in starts {
            if let Some(frame) = frame_id.as_deref().filter(|frame| is_odometry_frame(frame)) {
                of_odometry.entry(frame).or_default().push(log.clone());
            }
        }
        let farthest_m = starts
            .iter()
            .map(|start| start.first.distance_m(&Pose2::default()))
            .fold(0.0, f64::max);
        if of_odometry.is_empty() && farthest_m <= AT_ORIGIN_M {
            let logs = starts.iter().map(|start| start.log.clone()).collect();
            notes.push(NoteKind::SiteStartsAtOrigin { site: site.clone(), logs, farthest_m });
        }
        notes.extend(of_odometry.into_iter().map(|(frame, logs)| {
            let (site, frame) = (site.clone(), frame.to_owned());
            NoteKind::SiteInOdometryFrame { site, frame, logs }
        }));
    }
    notes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn codes(starts: &[(&str, Option<&str>, f64)]) -> Vec<&'static str> {
        let start = |&(log, frame, x_m): &(&str, Option<&str>, f64)| Start {
            log: log.to_owned(),
            frame_id: frame.map(str::to_owned),
            first: Pose2 { x_m, ..Pose2::default() },
        };
        let site = starts.iter().map(start).collect();
        let notes = unshared_frames(&[("north".to_owned(), site)].into());
        notes.iter().map(NoteKind::code).collect()
    }

    #[test]
    fn logs_of_one_site_in_frames_of_odometry_are_reported() {
        for frame in ["odom", "robot1/odom", "/ns/Odom", "odom_combined", "vio_odom"] {
            let both = [("a", Some(frame), 3.0), ("b", Some(frame), 0.0)];
            assert_eq!(codes(&both), ["site_in_odometry_frame"], "{frame}");
        }
        // One log in a frame of odometry is enough; two frames give two remarks.
        let mixed = [("a", Some("map"), 0.0), ("b", Some("odom"), 0.0)];
        assert_eq!(codes(&mixed), ["site_in_odometry_frame"]);
        let robots = [("a", Some("r1/odom"), 0.0), ("b", Some("r2/odom"), 0.0)];
        assert_eq!(codes(&robots).len(), 2);
        // A single log cannot share its frame with another.
        assert!(codes(&[("a", Some("odom"), 0.0)]).is_empty());
    }

    #[test]
    fn logs_that_all_start_at_the_origin_are_reported() {
        let start = |x_m| [("a", Some("map"), 0.0), ("b", None, x_m)];
        assert_eq!(codes(&start(0.09)), ["site_starts_at_origin"]);
        assert!(codes(&start(0.11)).is_empty());
    }
}
