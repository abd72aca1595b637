//! The motion measurements of a log -> the trajectory of the lidar.
//!
//! The poses are read from a topic, looked up in the transforms, computed from satellite fixes, or
//! fused from wheels and an IMU.

use dataset::{Loss, LossKind, Losses, Note, NoteKind, Pose2, StampedPose, Subject, Trajectory};

use crate::error::IngestError;
use crate::pose::chain::ChainPoses;
use crate::pose::frame_names::FrameNames;
use crate::pose::frames::{LookupError, TransformHistory};
use crate::pose::fusion::{FusedTopics, fused_poses};
use crate::pose::gnss;
use crate::pose::readings::MotionReadings;
use crate::pose::segments::{SegmentOptions, segments};
use crate::pose::topics::PoseTopics;
use crate::pose_options::{Frames, Jumps, Origin, PoseOptions};

/// The source of the poses of a drive.
pub(crate) struct PoseSource<'a> {
    /// The drive in error messages.
    pub(crate) path: &'a std::path::Path,
    pub(crate) topics: &'a PoseTopics,
    pub(crate) options: &'a PoseOptions,
    /// The pose of the lidar on the robot.
    pub(crate) base_from_lidar: Pose2,
    /// Whether the options say that the lidar is mounted upside down.
    pub(crate) upside_down: bool,
}

/// Computes the trajectory of the lidar. Adds data that was left out to `losses` and remarks to
/// `notes`.
pub(crate) fn trajectory(
    mut readings: MotionReadings,
    source: &PoseSource<'_>,
    losses: &mut Losses,
    notes: &mut Vec<Note>,
) -> Result<Trajectory, IngestError> {
    let options = source.options;
    let main_topic = &source.topics.main().name;
    let names = std::mem::take(&mut readings.frame_names);
    let mut repeated_ns = Vec::new();
    let mut same_frame = options.jumps == Jumps::SameFrame;
    let is_fixes = !readings.fixes.is_empty();
    let robot_poses = match (source.topics, &options.frames) {
        (PoseTopics::Frames(_), Some(frames)) => {
            let found =
                source.poses_from_transforms(&mut readings.transforms, frames, losses, notes)?;
            repeated_ns = found.repeated_ns;
            found.poses
        }
        (PoseTopics::Wheels { imu, .. }, _) => {
            let imu = imu.as_ref().map(|imu| imu.name.as_str());
            let topics = FusedTopics { path: source.path, wheels: main_topic, imu };
            fused_poses(&readings, &topics, options, losses, notes)?
        }
        _ => match readings.fixes.first() {
            Some((first, _)) => {
                let origin = options.origin.unwrap_or(gnss::origin(first));
                notes.push(note_of_fixes(readings.fixes.len(), &origin).into());
                // All fixes are on the same earth.
                same_frame = true;
                gnss::poses(&readings.fixes, &origin)
            }
            None => readings.poses,
        },
    };
    source.check_frames(&names, &robot_poses, losses, notes)?;
    let segment_options = SegmentOptions { max_speed_m_s: options.max_speed_m_s, same_frame };
    let mut segmented = segments(robot_poses, &segment_options, repeated_ns);
    losses.merge(std::mem::take(&mut segmented.losses).on_topic(main_topic));
    if let Some((n_contradictory, n_poses)) = segmented.contradiction() {
        return Err(source.contradictory(n_contradictory, n_poses));
    }
    let on_topic = |kind| Note::new(kind, Subject::topic(main_topic));
    notes.extend(std::mem::take(&mut segmented.notes).into_iter().map(on_topic));
    if is_fixes {
        gnss::set_courses(&mut segmented.poses);
    }
    let robot_poses = segmented.poses.into_iter();
    let lidar_poses =
        robot_poses.map(|robot| lidar_pose(&robot, &source.base_from_lidar)).collect();
    let (trajectory, _) = Trajectory::new(lidar_poses);
    if trajectory.poses().is_empty() {
        return Err(source.no_poses(losses));
    }
    let frame_id = match &options.frames {
        Some(frames) => Some(frames.parent.trim_start_matches('/').to_owned()),
        // The frame of a fix is that of the antenna.
        None if is_fixes => None,
        None => names.first(),
    };
    Ok(trajectory.in_frame(frame_id))
}

impl PoseSource<'_> {
    /// Poses of the child frame in the parent frame.
    fn poses_from_transforms(
        &self,
        transforms: &mut TransformHistory,
        frames: &Frames,
        losses: &mut Losses,
        notes: &mut Vec<Note>,
    ) -> Result<ChainPoses, IngestError> {
        let Frames { parent, child, .. } = frames;
        losses.merge(transforms.losses());
        let found = transforms
            .poses(parent, child, self.upside_down)
            .map_err(|error| self.no_frames(error, frames, transforms))?;
        notes.extend(transforms.notes().map(Note::from));
        let subject = || Subject::transform(parent, child);
        losses.add(Loss::new(LossKind::PosesWithoutTransform, subject()), found.n_unknown);
        losses.add(Loss::new(LossKind::PosesAtRepeatedTimes, subject()), found.n_repeated);
        notes.extend(found.clock_note.clone().map(|kind| Note::new(kind, subject())));
        Ok(found)
    }

    /// Checks that the poses come from one publisher.
    fn check_frames(
        &self,
        names: &FrameNames,
        poses: &[StampedPose],
        losses: &Losses,
        notes: &mut Vec<Note>,
    ) -> Result<(), IngestError> {
        let topic = || self.topics.main().name.clone();
        let n_other = names.n_not_selected();
        if poses.is_empty() {
            return match &self.options.frame_id {
                Some(selected) if 0 < n_other => Err(IngestError::NoPoseFrame {
                    path: self.path.to_owned(),
                    topic: topic(),
                    selected: selected.clone(),
                    frames: names.list(),
                }),
                _ => Err(self.no_poses(losses)),
            };
        }
        if FrameNames::are_mixed(poses) {
            return Err(IngestError::SeveralPoseFrames {
                path: self.path.to_owned(),
                topic: topic(),
                frames: names.list(),
            });
        }
        let frames = names.list();
        let found = [
            (1 < names.len(), NoteKind::PoseFrameChanges { frames: frames.clone() }),
            (0 < n_other, NoteKind::PoseFrameSelected { n_other, frames }),
        ];
        let found = found.into_iter().filter(|(is_found, _)| *is_found);
        notes.extend(found.map(|(_, kind)| Note::new(kind, Subject::topic(topic()))));
        Ok(())
    }

    fn contradictory(&self, n_contradictory: usize, n_poses: usize) -> IngestError {
        let topic = self.topics.main().name.clone();
        IngestError::ContradictoryPoses {
            path: self.path.to_owned(),
            topic,
            n_contradictory,
            n_poses,
        }
    }

    fn no_poses(&self, losses: &Losses) -> IngestError {
        let topic = self.topics.main().name.clone();
        IngestError::NoPoses { path: self.path.to_owned(), topic, losses: losses.clone() }
    }

    fn no_frames(
        &self,
        source: LookupError,
        frames: &Frames,
        transforms: &TransformHistory,
    ) -> IngestError {
        let names: Vec<String> =
            transforms.frame_names().iter().map(|name| format!("`{name}`")).collect();
        let dropped = transforms.losses();
        IngestError::NoFrames {
            path: self.path.to_owned(),
            parent: frames.parent.clone(),
            child: frames.child.clone(),
            found: match names.as_slice() {
                [] => "no readable transforms".to_owned(),
                names => format!("the frames {}", names.join(", ")),
            },
            losses: dropped,
            source,
        }
    }
}

/// The pose of the lidar, `map_from_lidar = map_from_base * base_from_lidar`, with its covariance.
///
/// With the mount (mx, my) and c, s the cosine and sine of the heading, the position of the lidar
/// is (x + c mx - s my, y + s mx + c my). The covariance is propagated to first order.
fn lidar_pose(map_from_base: &StampedPose, base_from_lidar: &Pose2) -> StampedPose {
    let map_from_lidar = map_from_base.pose * *base_from_lidar;
    let [dx, dy] =
        [map_from_lidar.x_m - map_from_base.pose.x_m, map_from_lidar.y_m - map_from_base.pose.y_m];
    // Derivatives of the position of the lidar with respect to the heading of the robot.
    let [a, b] = [-dy, dx];
    let covariance = map_from_base.covariance.map(|[xx, xy, xh, yy, yh, hh]| {
        [
            xx + 2.0 * a * xh + a * a * hh,
            xy + b * xh + a * yh + a * b * hh,
            xh + a * hh,
            yy + 2.0 * b * yh + b * b * hh,
            yh + b * hh,
            hh,
        ]
    });
    StampedPose { pose: map_from_lidar, covariance, ..*map_from_base }
}

fn note_of_fixes(n_fixes: usize, origin: &Origin) -> NoteKind {
    NoteKind::PosesFromFixes {
        n_fixes: n_fixes as u64,
        latitude_deg: origin.latitude_deg,
        longitude_deg: origin.longitude_deg,
        altitude_m: origin.altitude_m,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A lidar 2 m in front of a robot with heading 90 deg: an error of the heading of 0.1 rad
    /// moves the lidar by 0.2 m along -x. With independent standard deviations of 0.3 m, 0.4 m and
    /// 0.1 rad, the variance of x is 0.09 + 0.04.
    #[test]
    fn the_covariance_of_the_lidar_includes_the_heading_error() {
        let heading_rad = std::f64::consts::FRAC_PI_2;
        let robot = StampedPose {
            covariance: Some([0.09, 0.0, 0.0, 0.16, 0.0, 0.01]),
            ..StampedPose::new(5, Pose2 { x_m: 7.0, y_m: 8.0, heading_rad })
        };
        let lidar = lidar_pose(&robot, &Pose2 { x_m: 2.0, y_m: 0.0, heading_rad: 0.0 });
        assert!((lidar.pose.x_m - 7.0).abs() < 1e-12 && (lidar.pose.y_m - 10.0).abs() < 1e-12);
        let expected = [0.13, 0.0, -0.02, 0.16, 0.0, 0.01];
        for (found, expected) in lidar.covariance.unwrap().iter().zip(expected) {
            assert!((found - expected).abs() < 1e-12, "{:?}", lidar.covariance);
        }
    }
}
