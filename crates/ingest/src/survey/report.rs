//! The result of a survey.

use dataset::{Losses, Trajectory};
use messages::hdl32e::{self, HORIZONTAL_LASER, LASERS};
use serde::Serialize;

/// The content of a drive.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Survey {
    /// Total size of the files \[bytes\].
    pub n_bytes: u64,
    /// Log time of the first and the last message \[ns since the epoch\].
    pub time_range_ns: Option<(u64, u64)>,
    /// The topics, by name. A topic with channels of several types has one entry for each type.
    pub topics: Vec<TopicSurvey>,
    /// Data that cannot be used.
    pub losses: Losses,
}

impl Survey {
    /// Time from the first message to the last \[s\].
    pub fn duration_s(&self) -> f64 {
        self.time_range_ns.map_or(0.0, |(first, last)| last.saturating_sub(first) as f64 * 1e-9)
    }
}

/// The content of a topic.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TopicSurvey {
    /// The topic.
    pub topic: String,
    /// Name of the schema, empty if there is none.
    pub schema: String,
    /// Message encoding.
    pub encoding: String,
    /// Number of messages.
    pub n_messages: u64,
    /// Mean message rate \[Hz\].
    pub rate_hz: Option<f64>,
    /// The frames in the headers of the messages, in order of their names. Empty for types without a
    /// header.
    pub frames: Vec<FrameSurvey>,
    /// The stamps in the headers of the messages.
    pub stamps: StampSurvey,
    /// Summary of the messages.
    pub content: Content,
}

/// The messages of a topic in one frame.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct FrameSurvey {
    /// The frame of the data, `header.frame_id`. Empty if the messages do not name it.
    pub frame_id: String,
    /// The frame that moves, for `Odometry`; empty otherwise.
    pub child_frame_id: String,
    /// Number of messages.
    pub n_messages: u64,
}

/// The stamps in the headers of a topic. All is empty for transforms, which have their own stamps.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct StampSurvey {
    /// Log time minus stamp \[s\]: the median over the log of the least delay in 0.1 s.
    pub delay_s: Option<f64>,
    /// Number of messages with the stamp 0.
    pub n_unstamped: u64,
    /// Number of messages with the stamp of the message before.
    pub n_equal: u64,
    /// Number of messages with a stamp that is not 0.
    pub n_stamped: u64,
    /// The steps of the stamps back, and against the log times \[s\].
    pub steps_s: Vec<f64>,
}

impl StampSurvey {
    /// Whether log times must be used, because all stamps are 0 or equal.
    pub fn needs_log_times(&self) -> bool {
        match self.n_stamped {
            0 => 0 < self.n_unstamped,
            n => 3 <= n && self.n_equal + 1 == n,
        }
    }

    /// What a person should know, one fact per line.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        if let Some(delay_s) = self.delay_s {
            let side = if delay_s < 0.0 { "after" } else { "before" };
            lines.push(format!("stamped {:.3} s {side} the log time", delay_s.abs()));
        }
        if 0 < self.n_unstamped {
            let n = self.n_stamped + self.n_unstamped;
            lines.push(format!("{} of {n} stamps are 0", self.n_unstamped));
        }
        if 0 < self.n_equal {
            lines.push(format!(
                "{} of {} stamps are equal to the stamp before",
                self.n_equal, self.n_stamped
            ));
        }
        if let Some(largest) =
            self.steps_s.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs()))
        {
            let times = match self.steps_s.len() {
                1 => "once".to_owned(),
                n => format!("{n} times"),
            };
            lines.push(format!("the clock of the stamps steps {times}, by up to {largest:+.2} s"));
        }
        lines
    }
}

/// Summary of the messages of a topic.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Content {
    /// Packets of a Velodyne.
    Packets(PacketsSurvey),
    /// Planar scans.
    Scans(ScansSurvey),
    /// Point clouds.
    Clouds(CloudsSurvey),
    /// Poses.
    Poses(PosesSurvey),
    /// Transforms between frames, in order of the frame names.
    Transforms(Vec<TransformSurvey>),
    /// Joints.
    Joints(JointsSurvey),
    /// Anything else.
    Other,
}

/// Packets of a Velodyne.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PacketsSurvey {
    /// Name of the sensor.
    pub sensor: String,
    /// Whether the sensor is supported. For other sensors, only the number of packets is known.
    pub is_hdl32e: bool,
    /// Return mode, if the packets contain it.
    pub return_mode: Option<&'static str>,
    /// Number of packets.
    pub n_packets: u64,
    /// Number of missing packets.
    pub n_missing: u64,
    /// Number of late packets. They are put back in order.
    pub n_late: u64,
    /// Number of packets with the same stamp as the packet before, although the device clock advanced.
    /// All packets of a message share one stamp then.
    pub n_same_stamp: u64,
    /// Number of steps of the stamps against the device clock.
    pub n_stamp_steps: u64,
    /// The largest step \[s\].
    pub largest_stamp_step_s: f64,
    /// Number of complete revolutions.
    pub n_revolutions: usize,
    /// Median rotation rate \[Hz\].
    pub spin_hz: Option<f64>,
    /// Share of the firings with a return, for each laser in firing order, `(32,)`.
    pub return_share: Vec<f64>,
    /// Lasers without any return, in firing order, such as "3, 11-13".
    pub dead_lasers: String,
    /// The device clock compared with the stamps.
    pub clock: ClockSurvey,
}

impl PacketsSurvey {
    pub(crate) fn of_other_sensor(sensor: String, n_packets: u64) -> Self {
        Self {
            sensor,
            is_hdl32e: false,
            return_mode: None,
            n_packets,
            n_missing: 0,
            n_late: 0,
            n_same_stamp: 0,
            n_stamp_steps: 0,
            largest_stamp_step_s: 0.0,
            n_revolutions: 0,
            spin_hz: None,
            return_share: Vec::new(),
            dead_lasers: String::new(),
            clock: ClockSurvey::Still,
        }
    }

    /// Whether the packets of a message share one stamp, so that the device clock is more precise.
    pub fn is_stamped_by_message(&self) -> bool {
        self.n_packets < 2 * self.n_same_stamp
    }

    /// If the horizontal laser has no returns: the laser with returns that is nearest to it.
    pub fn stand_in(&self) -> Option<usize> {
        let has_returns = |laser: &usize| self.return_share.get(*laser).is_some_and(|&s| s > 0.0);
        if has_returns(&HORIZONTAL_LASER) {
            return None;
        }
        let slant = |laser: &usize| hdl32e::ELEVATION_DEG[*laser].abs();
        (0..LASERS).filter(has_returns).min_by(|a, b| slant(a).total_cmp(&slant(b)))
    }
}

/// The device clock compared with the stamps.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ClockSurvey {
    /// The device clock stands still.
    Still,
    /// The device clock agrees with the host clock to within 2 s.
    OnTime {
        /// Stamps minus device clock \[s\].
        offset_s: f64,
    },
    /// The device clock is not related to the host clock.
    FreeRunning {
        /// Stamps minus device clock, past the hour \[s\].
        offset_s: f64,
    },
}

/// Planar scans.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct ScansSurvey {
    /// Minimum and maximum number of beams.
    pub n_beams: (usize, usize),
    /// Angle covered by the beams \[deg\].
    pub coverage_deg: f64,
    /// Minimum and maximum range in the messages \[m\].
    pub range_m: (f32, f32),
}

/// Point clouds.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct CloudsSurvey {
    /// The rings and their elevations \[deg\].
    pub rings: Vec<(u32, f64)>,
    /// The field with the times of the points, its unit, and what they count from.
    pub point_times: String,
}

/// Poses.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct PosesSurvey {
    /// Path length \[m\].
    pub path_m: f64,
    /// Longest time between two poses \[s\].
    pub widest_gap_s: f64,
    /// Extent along x and y \[m\].
    pub extent_m: (f64, f64),
    /// Number of continuous pieces: 1 unless poses jump.
    pub n_segments: u32,
    /// Jumps and steps of the clock, one sentence each.
    pub remarks: Vec<String>,
    /// The poses.
    #[serde(skip)]
    pub trajectory: Trajectory,
}

/// Joints.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct JointsSurvey {
    /// All joints of the topic, in alphabetical order.
    pub joints: Vec<String>,
    /// The joints that are used as wheels on the left, if there are wheels on both sides.
    pub left: Vec<String>,
    /// The same on the right.
    pub right: Vec<String>,
}

/// One transform of a topic.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TransformSurvey {
    /// The parent frame.
    pub parent: String,
    /// The child frame.
    pub child: String,
    /// Number of samples.
    pub n_samples: u64,
    /// Whether all samples are equal: the frames do not move against each other.
    pub is_constant: bool,
}
