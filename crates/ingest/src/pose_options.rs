//! Where poses come from.

use dataset::Pose2;
use serde::{Deserialize, Serialize};

/// Where poses come from; the section `[ingest.pose]`: a `topic` that has them, `frames` between
/// which transforms lead, or `wheels` and `imu`, from which they are made.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct PoseOptions {
    /// Topic with `PoseStamped`, `PoseWithCovarianceStamped`, `Odometry`, `foxglove.PoseInFrame` or
    /// `NavSatFix` messages; the schema tells which.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub topic: Option<String>,
    /// Two frames, of whose transforms (`TFMessage`, `foxglove.FrameTransform`) poses are made.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<Frames>,
    /// Where fixes of a satellite receiver are counted from; without it from the log's first fix,
    /// in a map frame of its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub origin: Option<Origin>,
    /// Poses that would take a faster robot are reported \[m/s\].
    pub max_speed_m_s: f64,
    /// Topic with the speeds of the wheels, `JointState` (names with `left` and `right` in them), or
    /// with `Odometry`, whose twist is taken.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wheels: Option<String>,
    /// Topic with `Imu` messages.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub imu: Option<String>,
    /// Distance between the contact points of the left and the right wheel \[m\].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub track_m: Option<f64>,
    /// Radius of the wheels, where a `JointState` tells their angles \[m\]; without it positions are
    /// in m and velocities in m/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wheel_radius_m: Option<f64>,
    /// Whether headings of the `Imu` messages' orientation are used, which need not be those of the
    /// map: their offset is estimated.
    pub use_heading: bool,
    /// Pose at the first reading of the wheels; without it the log has a map frame of its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start: Option<PlanarPose>,
    /// What is known of the robot and its sensors.
    pub fuse: fuse::Options,
}

impl Default for PoseOptions {
    fn default() -> Self {
        Self {
            topic: None,
            frames: None,
            origin: None,
            max_speed_m_s: 15.0,
            wheels: None,
            imu: None,
            track_m: None,
            wheel_radius_m: None,
            use_heading: true,
            start: None,
            fuse: fuse::Options::default(),
        }
    }
}

/// A pose in a plane: of a robot in the site's map frame, or of a sensor on the robot.
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
    pub(crate) fn pose(&self) -> Pose2 {
        Pose2 { x_m: self.x_m, y_m: self.y_m, heading_rad: self.heading_deg.to_radians() }
    }

    /// A value that is not finite, and its key.
    pub(crate) fn not_finite(&self) -> Option<(&'static str, f64)> {
        let values = [("x_m", self.x_m), ("y_m", self.y_m), ("heading_deg", self.heading_deg)];
        values.into_iter().find(|(_, value)| !value.is_finite())
    }
}

/// Frames of a robot, by the names that transforms give them (REP 105).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Frames {
    /// The frame of the map, such as `map` or `odom`.
    pub parent: String,
    /// The frame that moves in it: the lidar's, or the robot's, on which `ingest.lidar.mount` places
    /// the lidar.
    pub child: String,
    /// The topics that have the transforms, of those there are.
    #[serde(default = "Frames::default_topics")]
    pub topics: Vec<String>,
}

impl Frames {
    fn default_topics() -> Vec<String> {
        vec!["/tf".to_owned(), "/tf_static".to_owned()]
    }
}

/// A point on the earth (WGS 84), the origin of a map frame whose x points east and y north.
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
    /// Poses of a topic that has them.
    pub fn of_topic(topic: impl Into<String>) -> Self {
        Self { topic: Some(topic.into()), ..Self::default() }
    }

    /// Whether the poses are in a map frame of the log's own: where its wheels were first read.
    pub fn is_own_frame(&self) -> bool {
        self.wheels.is_some() && self.start.is_none()
    }

    /// Refuses contradictions and values out of range.
    pub fn check(&self) -> Result<(), PoseOptionError> {
        let fail = |detail: String| Err(PoseOptionError { detail });
        let is_given = [
            ("topic", self.topic.is_some()),
            ("frames", self.frames.is_some()),
            ("wheels", self.wheels.is_some()),
        ];
        let given: Vec<_> =
            is_given.into_iter().filter(|(_, is)| *is).map(|(key, _)| key).collect();
        let [source] = given.as_slice() else {
            let found = match given.as_slice() {
                [] => "none of them".to_owned(),
                several => format!("`{}`", several.join("` and `")),
            };
            return fail(format!("names {found}, expected one of `topic`, `frames` and `wheels`"));
        };
        if self.imu.is_some() && *source != "wheels" {
            return fail(format!(
                "names `{source}` and `imu`, expected poses or what they are made from (`wheels` and `imu`)"
            ));
        }
        if self.origin.is_some() && *source != "topic" {
            return fail(format!(
                "names `{source}` and `origin`, which is for a `topic` of satellite fixes"
            ));
        }
        if self.max_speed_m_s.is_nan() || self.max_speed_m_s <= 0.0 {
            return fail(format!(
                "has `max_speed_m_s` {}, expected more than 0",
                self.max_speed_m_s
            ));
        }
        if let Some(origin) = &self.origin
            && !(origin.latitude_deg.abs() <= 90.0
                && origin.longitude_deg.abs() <= 360.0
                && origin.altitude_m.is_finite())
        {
            return fail("has an `origin` that is no place on the earth: latitude -90 to 90, longitude -180 to 180 deg".to_owned());
        }
        if let Some(frames) = &self.frames {
            return match frames.parent.trim_start_matches('/')
                == frames.child.trim_start_matches('/')
            {
                true => fail(format!("has `frames` from `{}` to itself", frames.parent)),
                false if frames.topics.is_empty() => {
                    fail("has `frames` without `topics`".to_owned())
                }
                false => Ok(()),
            };
        }
        if self.topic.is_some() {
            return Ok(());
        }
        if self.track_m.is_none() {
            return fail(
                "names `wheels` without `track_m`, the distance between the wheels in m".to_owned(),
            );
        }
        if let Some(radius_m) = self.wheel_radius_m
            && !(radius_m.is_finite() && 0.0 < radius_m)
        {
            return fail(format!("has `wheel_radius_m` {radius_m}, expected more than 0"));
        }
        if let Some((key, found)) = self.start.and_then(|start| start.not_finite()) {
            return fail(format!("has `start.{key}` {found}, expected a finite number"));
        }
        self.fuse_options().check().map_err(|e| PoseOptionError { detail: format!("has {e}") })
    }

    /// The options of the fusion, with the track.
    pub(crate) fn fuse_options(&self) -> fuse::Options {
        fuse::Options { track_m: self.track_m.unwrap_or_default(), ..self.fuse.clone() }
    }
}

/// Options that do not go together, or one out of range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("`ingest.pose` {detail}")]
pub struct PoseOptionError {
    detail: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_come_from_one_place() {
        let wheels = PoseOptions {
            wheels: Some("/wheels".to_owned()),
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
        for (options, says) in [
            (PoseOptions::default(), "names none of them"),
            (
                PoseOptions { topic: Some("/pose".to_owned()), ..wheels.clone() },
                "`topic` and `wheels`",
            ),
            (PoseOptions { frames: frames("a", "b"), ..wheels.clone() }, "`frames` and `wheels`"),
            (PoseOptions { frames: frames("/a", "a"), ..PoseOptions::default() }, "to itself"),
            (PoseOptions { origin: Some(pole), ..wheels.clone() }, "`wheels` and `origin`"),
            (
                PoseOptions { origin: Some(beyond), ..PoseOptions::of_topic("/fix") },
                "no place on the earth",
            ),
            (PoseOptions { max_speed_m_s: 0.0, ..wheels.clone() }, "`max_speed_m_s` 0"),
            (PoseOptions { track_m: None, ..wheels.clone() }, "without `track_m`"),
            (PoseOptions { track_m: Some(-1.0), ..wheels.clone() }, "track_m"),
        ] {
            let message = options.check().unwrap_err().to_string();
            assert!(message.contains(says), "{message}");
        }
    }
}
