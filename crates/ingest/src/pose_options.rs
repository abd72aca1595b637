//! The options for poses.

use dataset::{OutOfRange, Pose2};
use serde::{Deserialize, Serialize};

use crate::stamp::Stamp;
use crate::time_unit::TimeUnit;
use crate::wheel_options::{WheelSpeedUnit, WheelsTopic};

/// Where poses come from: the section `[ingest.pose]`.
///
/// Set one of `topic` (a topic with poses), `frames` (two frames connected by transforms), `file` (a
/// trajectory from another program), `wheels` (with `imu`: poses are fused) and `run` (the map of a finished
/// run).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct PoseOptions {
    /// Topic with `PoseStamped`, `PoseWithCovarianceStamped`, `Odometry`, `foxglove.PoseInFrame` or
    /// `NavSatFix` messages. The schema of the topic selects the decoder.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub topic: Option<String>,
    /// The frame whose messages are used, if several publishers use one topic: `header.frame_id`, or, for
    /// poses, the `child_frame_id` of `Odometry`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame_id: Option<String>,
    /// The time of a message that is used: `header`, the stamp in its header, or `log`, the time at
    /// which it was recorded. Use `log` if the stamps are 0 or wrong.
    pub stamp: Stamp,
    /// Two frames. Poses are made from the transforms between them (`TFMessage`,
    /// `foxglove.FrameTransform`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<Frames>,
    /// Text file with the poses of the robot, from another program: TUM (`stamp x y z qx qy qz qw`, with
    /// or without covariance), or stamps and KITTI matrices. The path is relative to the pipeline file,
    /// and `{log}` stands for the name of the log. The map frame is that of the file: give `site` only
    /// to logs whose files share one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// Unit of the stamps in `file`: `s`, `ms`, `us` or `ns`.
    pub file_time_unit: TimeUnit,
    /// Folder of a finished run that found loop closures in the same logs. Its optimized poses are used, and
    /// its scans. Logs in one map of the run share a frame, whatever their `site`. The path is relative to
    /// the pipeline file. All logs with this key name the same run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub run: Option<String>,
    /// Origin of the map frame for satellite fixes. Without it, the first fix of the log is the origin
    /// of a map frame of this log alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub origin: Option<Origin>,
    /// Maximum speed of the robot \[m/s\]. Poses that need a higher speed are reported.
    pub max_speed_m_s: f64,
    /// Where the poses are after a jump: `new_frame`, in a frame of their own without a known relation to
    /// the poses before, or `same_frame`, in the same map, for example after a correction of a
    /// localiser. Satellite fixes are always in the same frame.
    pub jumps: Jumps,
    /// Topic with wheel speeds: `JointState`, or the twist of `Odometry`. The driven wheels of a `JointState`
    /// are found by the names of the joints, which contain `wheel` and a side, or are named:
    /// `wheels = { topic = "/joint_states", left = ["..."], right = ["..."] }`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wheels: Option<WheelsTopic>,
    /// Topic with `Imu` messages.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub imu: Option<String>,
    /// The frame (`header.frame_id`) of the `Imu` messages that are used, if several IMUs use one topic.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub imu_frame_id: Option<String>,
    /// Track width: distance between the contact points of the left and the right wheel \[m\].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub track_m: Option<f64>,
    /// Radius of the wheels \[m\]. `JointState` messages contain rad and rad/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wheel_radius_m: Option<f64>,
    /// Set to `m/s` if the `JointState` messages contain m and m/s instead. Without this and
    /// `wheel_radius_m`, m/s must be confirmed by the gyroscope.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wheel_speed_unit: Option<WheelSpeedUnit>,
    /// Factor for the angular velocity of the `Imu` messages, which is in rad/s and counter-clockwise:
    /// 0.0174533 if it is in deg/s, -1 if the gyroscope turns clockwise.
    pub gyro_scale: f64,
    /// Whether to use the headings in the orientation of the `Imu` messages. Their offset to the map is
    /// estimated.
    pub use_heading: bool,
    /// Pose at the first wheel reading. Without it, the poses are in a map frame of this log alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start: Option<PlanarPose>,
    /// Properties of the robot and its sensors.
    pub fuse: fuse::Options,
}

impl Default for PoseOptions {
    fn default() -> Self {
        Self {
            topic: None,
            frame_id: None,
            stamp: Stamp::Header,
            frames: None,
            file: None,
            file_time_unit: TimeUnit::S,
            run: None,
            origin: None,
            max_speed_m_s: 15.0,
            jumps: Jumps::NewFrame,
            wheels: None,
            imu: None,
            imu_frame_id: None,
            track_m: None,
            wheel_radius_m: None,
            wheel_speed_unit: None,
            gyro_scale: 1.0,
            use_heading: true,
            start: None,
            fuse: fuse::Options::default(),
        }
    }
}

/// Where the poses are after a jump.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Jumps {
    /// In a frame of their own: their relation to the poses before the jump is not known.
    #[default]
    NewFrame,
    /// In the frame of the poses before the jump.
    SameFrame,
}

/// A pose in the plane: of the robot in the map frame of the site, or of a sensor on the robot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PlanarPose {
    /// \[m\]
    pub x_m: f64,
    /// \[m\]
    pub y_m: f64,
    /// Counter-clockwise from x \[deg\].
    pub heading_deg: f64,
}

impl PlanarPose {
    /// The pose in metres and radians.
    pub fn pose(&self) -> Pose2 {
        Pose2 { x_m: self.x_m, y_m: self.y_m, heading_rad: self.heading_deg.to_radians() }
    }

    /// The key and value of a value that is not finite.
    pub fn not_finite(&self) -> Option<(&'static str, f64)> {
        let values = [("x_m", self.x_m), ("y_m", self.y_m), ("heading_deg", self.heading_deg)];
        values.into_iter().find(|(_, value)| !value.is_finite())
    }
}

/// Two coordinate frames, by their names in the transforms (REP 105).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Frames {
    /// The frame of the map, such as `map` or `odom`.
    pub parent: String,
    /// The frame that moves: that of the lidar, or that of the robot with `ingest.lidar.mount` set.
    pub child: String,
    /// The topics with transforms. Topics that do not exist are ignored if at least one does.
    #[serde(default = "Frames::default_topics")]
    pub topics: Vec<String>,
}

impl Frames {
    fn default_topics() -> Vec<String> {
        vec!["/tf".to_owned(), "/tf_static".to_owned()]
    }
}

/// A point on the earth (WGS 84): the origin of a map frame with x pointing east and y north.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Origin {
    /// North positive \[deg\].
    pub latitude_deg: f64,
    /// East positive \[deg\].
    pub longitude_deg: f64,
    /// Height above the ellipsoid \[m\].
    #[serde(default)]
    pub altitude_m: f64,
}

impl PoseOptions {
    /// Options for a topic with poses.
    pub fn of_topic(topic: impl Into<String>) -> Self {
        Self { topic: Some(topic.into()), ..Self::default() }
    }

    /// The path of [`Self::file`] for a log.
    pub fn file_of(&self, log: &str) -> Option<String> {
        self.file.as_ref().map(|file| file.replace("{log}", log))
    }

    /// Whether the poses are in a map frame of this log alone, starting at the first wheel reading.
    pub fn is_own_frame(&self) -> bool {
        self.wheels.is_some() && self.start.is_none()
    }

    /// Checks that the options do not contradict each other and are in range.
    pub fn check(&self) -> Result<(), PoseOptionError> {
        let sources = [
            ("topic", self.topic.is_some()),
            ("frames", self.frames.is_some()),
            ("file", self.file.is_some()),
            ("wheels", self.wheels.is_some()),
            ("run", self.run.is_some()),
        ];
        let set: Vec<_> = sources.into_iter().filter(|(_, is_set)| *is_set).map(|s| s.0).collect();
        let &[used] = set.as_slice() else {
            let found = match set.as_slice() {
                [] => "none of them".to_owned(),
                several => format!("`{}`", several.join("` and `")),
            };
            return Err(PoseOptionError::NotOneSource { found });
        };
        if self.imu.is_some() && used != "wheels" {
            return Err(PoseOptionError::ImuWithoutWheels { used });
        }
        if self.origin.is_some() && used != "topic" {
            return Err(PoseOptionError::OriginWithoutTopic { used });
        }
        if self.frame_id.is_some() && !["topic", "wheels"].contains(&used) {
            return Err(PoseOptionError::FrameIdWithoutTopic { used });
        }
        if self.max_speed_m_s.is_nan() || self.max_speed_m_s <= 0.0 {
            return out_of_range("max_speed_m_s", self.max_speed_m_s, "more than 0");
        }
        if let Some(origin) = &self.origin {
            origin.check("ingest.pose")?;
        }
        if let Some(frames) = &self.frames {
            return frames.check();
        }
        match self.wheels {
            None => Ok(()),
            Some(_) => self.check_wheels(),
        }
    }

    fn check_wheels(&self) -> Result<(), PoseOptionError> {
        if self.track_m.is_none() {
            return Err(PoseOptionError::NoTrackWidth);
        }
        if let Some(radius_m) = self.wheel_radius_m
            && !(radius_m.is_finite() && 0.0 < radius_m)
        {
            return out_of_range("wheel_radius_m", radius_m, "more than 0");
        }
        if self.wheel_radius_m.is_some() && self.wheel_speed_unit.is_some() {
            return Err(PoseOptionError::RadiusAndUnit);
        }
        if let Some(fault) = self.wheels.as_ref().and_then(WheelsTopic::fault) {
            return Err(PoseOptionError::WheelJoints { fault });
        }
        if !(self.gyro_scale.is_finite() && self.gyro_scale != 0.0) {
            return out_of_range("gyro_scale", self.gyro_scale, "a finite number other than 0");
        }
        if let Some((key, found)) = self.start.and_then(|start| start.not_finite()) {
            return out_of_range(&format!("start.{key}"), found, "a finite number");
        }
        self.fuse_options().check().map_err(|error| {
            let section = if error.key == "track_m" { "ingest.pose" } else { "ingest.pose.fuse" };
            OutOfRange { key: format!("{section}.{}", error.key), ..error }.into()
        })
    }

    /// The options of the fusion, with the track width.
    pub(crate) fn fuse_options(&self) -> fuse::Options {
        fuse::Options { track_m: self.track_m.unwrap_or_default(), ..self.fuse.clone() }
    }
}

impl Frames {
    fn check(&self) -> Result<(), PoseOptionError> {
        if self.parent.trim_start_matches('/') == self.child.trim_start_matches('/') {
            return Err(PoseOptionError::SameFrame { frame: self.parent.clone() });
        }
        match self.topics.is_empty() {
            true => Err(PoseOptionError::NoFrameTopics),
            false => Ok(()),
        }
    }
}

impl Origin {
    /// Checks that the origin is on the earth. `section` is where the options name it.
    pub fn check(&self, section: &str) -> Result<(), OutOfRange> {
        let fail = |key: &str, found: f64, expected: &str| {
            Err(OutOfRange::new(format!("{section}.origin.{key}"), found, expected))
        };
        if !(-90.0..=90.0).contains(&self.latitude_deg) {
            return fail("latitude_deg", self.latitude_deg, "-90 to 90");
        }
        if !(-360.0..=360.0).contains(&self.longitude_deg) {
            return fail("longitude_deg", self.longitude_deg, "-360 to 360");
        }
        match self.altitude_m.is_finite() {
            true => Ok(()),
            false => fail("altitude_m", self.altitude_m, "a finite number"),
        }
    }
}

fn out_of_range(key: &str, found: f64, expected: &str) -> Result<(), PoseOptionError> {
    Err(OutOfRange::new(format!("ingest.pose.{key}"), found, expected).into())
}

/// Options that contradict each other, or one out of range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PoseOptionError {
    /// No source of poses is set, or several are.
    #[error(
        "`ingest.pose` sets {found}, expected one of `topic`, `frames`, `file`, `wheels` and `run`"
    )]
    NotOneSource {
        /// What is set.
        found: String,
    },
    /// `imu` is set without `wheels`.
    #[error(
        "`ingest.pose` sets `{used}` and `imu`, but `imu` is only used with `wheels`; remove one of them"
    )]
    ImuWithoutWheels {
        /// The source of poses.
        used: &'static str,
    },
    /// `origin` is set without `topic`.
    #[error(
        "`ingest.pose` sets `{used}` and `origin`, but `origin` is only used with a `topic` of satellite fixes; remove one of them"
    )]
    OriginWithoutTopic {
        /// The source of poses.
        used: &'static str,
    },
    /// `frame_id` is set without `topic` or `wheels`.
    #[error(
        "`ingest.pose` sets `{used}` and `frame_id`, but `frame_id` is only used with `topic` or `wheels`; remove one of them"
    )]
    FrameIdWithoutTopic {
        /// The source of poses.
        used: &'static str,
    },
    /// Parent and child are the same frame.
    #[error("`ingest.pose.frames` has parent and child `{frame}`, expected two different frames")]
    SameFrame {
        /// The frame.
        frame: String,
    },
    /// `frames` has no topics.
    #[error("`ingest.pose.frames.topics` is empty, expected the topics with transforms")]
    NoFrameTopics,
    /// `wheels` is set without `track_m`.
    #[error(
        "`ingest.pose` sets `wheels` without `track_m`; set it to the distance between the left and the right wheel [m]"
    )]
    NoTrackWidth,
    /// Two units of the wheels are stated.
    #[error(
        "`ingest.pose` sets `wheel_radius_m` and `wheel_speed_unit`; set `wheel_radius_m` if the joints are in rad and rad/s, or `wheel_speed_unit` if they are in m and m/s"
    )]
    RadiusAndUnit,
    /// The joints of the wheels are named wrongly.
    #[error(
        "`ingest.pose.wheels` names {fault}; set `left` and `right` to the joints of the wheels on each side"
    )]
    WheelJoints {
        /// What is wrong.
        fault: String,
    },
    /// An option is out of range.
    #[error(transparent)]
    OutOfRange(#[from] OutOfRange),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exactly_one_source_of_poses_must_be_set() {
        let wheels = PoseOptions {
            wheels: Some("/wheels".into()),
            track_m: Some(0.5),
            ..PoseOptions::default()
        };
        let frames = |parent: &str, child: &str| {
            let (parent, child) = (parent.to_owned(), child.to_owned());
            Some(Frames { parent, child, topics: Frames::default_topics() })
        };
        let pole = Origin { latitude_deg: 90.0, longitude_deg: 0.0, altitude_m: 0.0 };
        let beyond = Origin { latitude_deg: 90.5, ..pole };
        assert_eq!(PoseOptions::of_topic("/pose").check(), Ok(()));
        let of_frames = PoseOptions { frames: frames("map", "base"), ..PoseOptions::default() };
        assert_eq!(of_frames.check(), Ok(()));
        assert_eq!(wheels.check(), Ok(()));
        for (options, expected) in [
            (PoseOptions::default(), "sets none of them"),
            (
                PoseOptions { topic: Some("/pose".to_owned()), ..wheels.clone() },
                "`topic` and `wheels`",
            ),
            (PoseOptions { frames: frames("a", "b"), ..wheels.clone() }, "`frames` and `wheels`"),
            (
                PoseOptions { frames: frames("/a", "a"), ..PoseOptions::default() },
                "parent and child `/a`",
            ),
            (PoseOptions { origin: Some(pole), ..wheels.clone() }, "`wheels` and `origin`"),
            (
                PoseOptions {
                    frame_id: Some("odom".to_owned()),
                    frames: frames("a", "b"),
                    ..PoseOptions::default()
                },
                "`frames` and `frame_id`",
            ),
            (
                PoseOptions { origin: Some(beyond), ..PoseOptions::of_topic("/fix") },
                "`ingest.pose.origin.latitude_deg` is 90.5, expected -90 to 90",
            ),
            (
                PoseOptions { max_speed_m_s: 0.0, ..wheels.clone() },
                "`ingest.pose.max_speed_m_s` is 0, expected more than 0",
            ),
            (PoseOptions { track_m: None, ..wheels.clone() }, "without `track_m`"),
            (
                PoseOptions { track_m: Some(-1.0), ..wheels.clone() },
                "`ingest.pose.track_m` is -1, expected more than 0",
            ),
        ] {
            let message = options.check().unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }
}
