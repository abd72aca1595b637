//! Why wheels and IMU give no poses.

use dataset::Losses;

/// Why wheels and IMU give no poses that can be trusted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum WheelError {
    /// No message has wheels.
    #[error(
        "no message has wheel joints on both sides{}; name the joints: `ingest.pose.wheels = {{ topic = \"...\", left = [\"...\"], right = [\"...\"] }}`",
        in_parentheses(losses)
    )]
    NoWheels {
        /// The messages that were dropped.
        losses: Losses,
    },
    /// The positions of the joints are wrapped, and the wheels turn too far between two messages.
    #[error(
        "the positions of the wheel joints are wrapped to one turn, and change by up to {found_rad:.1} rad from one message to the next ({period_s:.3} s later): near pi the direction of a wheel is not known. Record the joint velocities, or positions that are not wrapped, or record more often"
    )]
    AmbiguousPositions {
        /// The largest step \[rad\].
        found_rad: f64,
        /// Median time between two messages \[s\].
        period_s: f64,
    },
    /// The wheels on one side do not move.
    #[error(
        "the wheels on the {side} stand still while those on the other side move by {path:.1} (m, or rad without a wheel radius): an encoder probably does not count. Name other joints in `ingest.pose.wheels`, or use another source of poses"
    )]
    StuckWheel {
        /// `left` or `right`.
        side: &'static str,
        /// Path of the other side, in both directions \[m\].
        path: f64,
    },
    /// The unit of the joint velocities is not known.
    #[error(
        "the unit of the wheel joints is not known: ROS defines rad and rad/s, and `ingest.pose.wheel_radius_m` is not set{}. Set `ingest.pose.wheel_radius_m`, or `ingest.pose.wheel_speed_unit = \"m/s\"` if the log contains m and m/s",
        hint(*gyro_ratio)
    )]
    UnknownUnit {
        /// Turns of the gyroscope over turns of the wheels, if both are known.
        gyro_ratio: Option<f64>,
    },
    /// The base moves sideways.
    #[error(
        "the twist is sideways: its root mean square is {forward_m_s:.2} m/s along x and {sideways_m_s:.2} m/s along y of {frame}, expected almost 0 along y. {}; set `ingest.pose.topic` to this topic to use its poses instead",
        match is_frame_known {
            true => "The base moves sideways, and poses are only fused for bases that move along x",
            false => "The base moves sideways, or the twist is in another frame, and the poses in the messages do not show which",
        }
    )]
    Sideways {
        /// Along the x axis \[m/s\].
        forward_m_s: f64,
        /// Along the y axis \[m/s\].
        sideways_m_s: f64,
        /// The frame of the twist.
        frame: String,
        /// Whether the poses show that the twist is in this frame.
        is_frame_known: bool,
    },
    /// The yaw rate of the twist contradicts the headings of the poses.
    #[error(
        "{}. Set `ingest.pose.topic` to this topic to use its poses instead",
        match ratio.is_finite() {
            true => format!("the headings of the poses turn {ratio:.3} times as much as `twist.angular.z` of the same messages, expected 1: the yaw rate has another sign or unit"),
            false => "`twist.angular.z` is 0 in all messages, but the headings of their poses turn: the driver does not write the yaw rate".to_owned(),
        }
    )]
    TwistTurns {
        /// Turns of the poses over turns by the twist; infinite if the twist does not turn.
        ratio: f64,
    },
    /// Odometry of several frames is on one topic.
    #[error(
        "the odometry comes from several publishers, with the frames {frames}; set `ingest.pose.frame_id` to the frame to use, or `ingest.pose.wheels` to another topic"
    )]
    SeveralFrames {
        /// The frames with their counts.
        frames: String,
    },
    /// Several IMUs use one topic.
    #[error(
        "topic `{imu}` has the messages of several IMUs, with the frames {frames}; set `ingest.pose.imu_frame_id` to the frame to use"
    )]
    SeveralImus {
        /// The topic of the IMU.
        imu: String,
        /// The frames with their counts.
        frames: String,
    },
    /// Gyroscope and wheels turn in opposite senses.
    #[error(
        "gyroscope (topic `{imu}`) and wheels turn in opposite senses: the gyroscope turns {ratio:.2} times as much as the wheels, expected 1. Either the z axis of the gyroscope is reversed, or the left and right wheels are exchanged, or the wheels count backward. Set `ingest.pose.gyro_scale = -1` for a reversed gyroscope, name the wheels with `ingest.pose.wheels.left` and `right`, or remove `ingest.pose.imu`"
    )]
    OppositeTurns {
        /// The topic of the IMU.
        imu: String,
        /// Turns of the gyroscope over turns of the wheels.
        ratio: f64,
    },
    /// The gyroscope measures deg/s.
    #[error(
        "the gyroscope (topic `{imu}`) turns {ratio:.1} times as much as the wheels, expected 1: 57.3 is the ratio of deg/s to rad/s. Set `ingest.pose.gyro_scale = 0.0174533` if it measures deg/s, or remove `ingest.pose.imu`"
    )]
    GyroInDegrees {
        /// The topic of the IMU.
        imu: String,
        /// Turns of the gyroscope over turns of the wheels.
        ratio: f64,
    },
    /// The gyroscope does not turn.
    #[error(
        "the gyroscope (topic `{imu}`) turns {ratio:.3} times as much as the wheels, expected 1: it turns by {gyro_rad:.2} rad in {secs:.0} s, and the wheels by {wheels_rad:.2} rad. The gyroscope is dead, or its driver does not write the rate. Remove `ingest.pose.imu` to use the wheels alone"
    )]
    DeadGyro {
        /// The topic of the IMU.
        imu: String,
        /// Turns of the gyroscope over turns of the wheels.
        ratio: f64,
        /// Turns of the gyroscope to both sides \[rad\].
        gyro_rad: f64,
        /// Turns of the wheels to both sides \[rad\].
        wheels_rad: f64,
        /// Time in which both were compared \[s\].
        secs: f64,
    },
    /// Gyroscope and wheels are not related.
    #[error(
        "gyroscope (topic `{imu}`) and wheels contradict each other: the gyroscope turns {ratio:.2} times as much as the wheels, with a correlation of {correlation:.2}, expected 1 and 1. {}",
        match is_one_reversed {
            true => "If one wheel counts backward, they agree: correct the sign of one encoder, or use another source of poses",
            false => "Check the unit and the axes of the gyroscope, the joints of the wheels, `ingest.pose.track_m` and `wheel_radius_m`, and that both topics have stamps of one clock",
        }
    )]
    Unrelated {
        /// The topic of the IMU.
        imu: String,
        /// Turns of the gyroscope over turns of the wheels.
        ratio: f64,
        /// Correlation of the turns, -1 to 1.
        correlation: f64,
        /// Whether they agree if one wheel counts backward.
        is_one_reversed: bool,
    },
}

impl WheelError {
    /// A stable name of the error, for programs.
    pub fn code(&self) -> &'static str {
        match self {
            Self::NoWheels { .. } => "no_wheels",
            Self::AmbiguousPositions { .. } => "ambiguous_wheel_positions",
            Self::StuckWheel { .. } => "stuck_wheel",
            Self::UnknownUnit { .. } => "unknown_wheel_unit",
            Self::Sideways { .. } => "sideways_twist",
            Self::TwistTurns { .. } => "twist_turn_contradicts_poses",
            Self::SeveralFrames { .. } => "several_odometry_frames",
            Self::SeveralImus { .. } => "several_imus",
            Self::OppositeTurns { .. } => "opposite_turns",
            Self::GyroInDegrees { .. } => "gyro_in_degrees",
            Self::DeadGyro { .. } => "dead_gyro",
            Self::Unrelated { .. } => "unrelated_turns",
        }
    }
}

/// What the gyroscope says about the unit.
fn hint(gyro_ratio: Option<f64>) -> String {
    match gyro_ratio {
        Some(ratio) if 0.005 < ratio && ratio < 0.75 => format!(
            ". The gyroscope turns {ratio:.3} times as much as wheels in m/s would: with wheels of a radius of {ratio:.3} m the two agree"
        ),
        Some(ratio) => {
            format!(". The gyroscope turns {ratio:.3} times as much as wheels in m/s would")
        }
        None => String::new(),
    }
}

fn in_parentheses(losses: &Losses) -> String {
    match losses.is_empty() {
        true => String::new(),
        false => format!(" (dropped: {losses})"),
    }
}
