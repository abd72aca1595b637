//! What a survey of a drive finds.

use dataset::Dropped;
use messages::hdl32e::{self, HORIZONTAL_LASER, LASERS};
use serde::Serialize;

/// What a drive holds.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Survey {
    /// Size of its files.
    pub n_bytes: u64,
    /// Log time of the first and the last message \[ns since the epoch\].
    pub time_range_ns: Option<(u64, u64)>,
    /// Its topics, by name; one that several channels of different types carry is there as often.
    pub topics: Vec<TopicSurvey>,
    /// What is broken, by reason.
    pub dropped: Dropped,
}

impl Survey {
    /// From the first message to the last \[s\].
    pub fn duration_s(&self) -> f64 {
        self.time_range_ns.map_or(0.0, |(first, last)| last.saturating_sub(first) as f64 * 1e-9)
    }
}

/// What a topic holds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TopicSurvey {
    /// The topic.
    pub topic: String,
    /// Name of the schema; empty where there is none.
    pub schema: String,
    /// Message encoding.
    pub encoding: String,
    /// Number of messages that could be read.
    pub n_messages: u64,
    /// Messages a second, between its first and its last \[Hz\].
    pub rate_hz: Option<f64>,
    /// What its messages say.
    pub content: Content,
}

/// What the messages of a topic say.
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
    /// Transforms between frames, in order of their names.
    Transforms(Vec<TransformSurvey>),
    /// Anything else.
    Other,
}

/// Packets of a Velodyne.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PacketsSurvey {
    /// The sensor, by name.
    pub sensor: String,
    /// Whether it is the one whose packets are read; of another, only their number is known.
    pub is_hdl32e: bool,
    /// What each firing returns, where the packets say so.
    pub return_mode: Option<&'static str>,
    /// Packets there are.
    pub n_packets: u64,
    /// Packets that are missing between them.
    pub n_missing: u64,
    /// Packets that came late; they are put in order.
    pub n_late: u64,
    /// Packets with the very stamp of the one before, of a device whose clock goes on: the stamp is
    /// that of a message.
    pub n_same_stamp: u64,
    /// Steps of the stamps against the device clock.
    pub n_stamp_steps: u64,
    /// The largest of them \[s\].
    pub largest_stamp_step_s: f64,
    /// Whole turns.
    pub n_revolutions: usize,
    /// Turns a second, median \[Hz\].
    pub spin_hz: Option<f64>,
    /// Share of its firings from which each laser has a return, in firing order, `(32,)`.
    pub return_share: Vec<f64>,
    /// Lasers without any, in firing order, as "3, 11-13".
    pub dead_lasers: String,
    /// The device clock against the stamps.
    pub clock: ClockSurvey,
}

impl PacketsSurvey {
    pub(crate) fn of_another(sensor: String, n_packets: u64) -> Self {
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

    /// Whether the packets of a message have one stamp, so that the device clock tells time better.
    pub fn is_stamped_by_message(&self) -> bool {
        self.n_packets < 2 * self.n_same_stamp
    }

    /// The laser with returns that is nearest to the horizontal one, where that has none.
    pub fn stand_in(&self) -> Option<usize> {
        let has_returns = |laser: &usize| self.return_share.get(*laser).is_some_and(|&s| s > 0.0);
        if has_returns(&HORIZONTAL_LASER) {
            return None;
        }
        let slant = |laser: &usize| hdl32e::ELEVATION_DEG[*laser].abs();
        (0..LASERS).filter(has_returns).min_by(|a, b| slant(a).total_cmp(&slant(b)))
    }
}

/// The device clock against the stamps.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ClockSurvey {
    /// It stands still.
    Still,
    /// It shows the host's time past the hour, but for some seconds \[s\].
    OnTime {
        /// Stamps minus device clock \[s\].
        offset_s: f64,
    },
    /// It shows a time of its own.
    FreeRunning {
        /// Stamps minus device clock, past the hour \[s\].
        offset_s: f64,
    },
}

/// Planar scans.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct ScansSurvey {
    /// Beams of a scan, fewest and most.
    pub n_beams: (usize, usize),
    /// Angle swept \[deg\].
    pub coverage_deg: f64,
    /// Nearest and farthest range that the messages themselves take for returns \[m\].
    pub range_m: (f32, f32),
}

/// Point clouds.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct CloudsSurvey {
    /// Rings and the elevation of their beams \[deg\], of the first clouds.
    pub rings: Vec<(u32, f64)>,
}

/// Poses.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct PosesSurvey {
    /// Length of the path through them \[m\].
    pub path_m: f64,
    /// Longest time between two of them \[s\].
    pub widest_gap_s: f64,
    /// Extent along x and y \[m\].
    pub extent_m: (f64, f64),
}

/// What a topic tells of one transform.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TransformSurvey {
    /// The frame in which the child is placed.
    pub parent: String,
    /// The frame that is placed.
    pub child: String,
    /// How often it is told.
    pub n_samples: u64,
}
