//! Watches the messages of a drive, and reports what contradicts itself.

use std::path::Path;

use dataset::{Loss, LossKind, Losses, Note, NoteKind, Subject};

use crate::drive::topic::Topic;
use crate::error::IngestError;
use crate::observe::frames::without_slash;
use crate::observe::stamps::{StampObserver, StampStep};
use crate::observe::topic::{TopicObserver, TopicPiece};
use crate::options::Options;
use crate::scan::beam::{is_cloud, is_packet};
use crate::scan::cloud_frame::FrameName;
use crate::scan::decode::LidarPiece;
use crate::scan::point_time::PointTimeFound;
use crate::stamp::Stamp;

/// Delays of two topics that differ by more than this come from two clocks \[s\]. Messages are recorded
/// within a fraction of a second; only the slowest of localisers take longer.
const MAX_DELAY_DIFFERENCE_S: f64 = 1.0;
/// A message cannot be recorded before it was stamped. Clocks that are synchronised with NTP over a
/// network differ by less than this \[s\].
const MAX_EARLY_S: f64 = 0.1;

/// Steps of two topics that differ by less than this are one step of one clock \[ns\].
const MAX_STEP_DIFFERENCE_NS: u64 = 256_000_000;

const LIDAR_STAMP: &str = "ingest.lidar.stamp";
const POSE_STAMP: &str = "ingest.pose.stamp";

/// What the messages of a drive show.
#[derive(Default)]
pub(crate) struct Observers {
    lidar: TopicObserver,
    /// In the order of the pose topics.
    poses: Vec<TopicObserver>,
    readings: LidarPiece,
}

/// The topics and options of the observed messages.
pub(crate) struct Observed<'a> {
    pub(crate) path: &'a Path,
    pub(crate) lidar: &'a Topic,
    pub(crate) pose_topics: &'a [&'a Topic],
    pub(crate) options: &'a Options,
    pub(crate) point_time: PointTimeFound,
}

impl Observers {
    /// Adds what the next piece shows.
    pub(crate) fn add(&mut self, mut lidar: LidarPiece, poses: Vec<TopicPiece>) {
        self.lidar.add(std::mem::take(&mut lidar.seen));
        self.readings.merge_readings(lidar);
        self.poses.resize_with(self.poses.len().max(poses.len()), TopicObserver::default);
        self.poses.iter_mut().zip(poses).for_each(|(all, piece)| all.add(piece));
    }

    /// Reports what is wrong with the messages. The error is the first contradiction that makes the
    /// scans or poses wrong.
    pub(crate) fn report(
        &self,
        of: &Observed<'_>,
        losses: &mut Losses,
        notes: &mut Vec<Note>,
    ) -> Result<(), IngestError> {
        self.check_frames(of, notes)?;
        self.check_stamps(of, notes)?;
        self.check_readings(of, losses, notes)?;
        self.check_sensor_frame(of, notes)
    }

    /// Checks that the messages of the lidar have one frame, or that the options select one.
    fn check_frames(&self, of: &Observed<'_>, notes: &mut Vec<Note>) -> Result<(), IngestError> {
        const OPTION: &str = "ingest.lidar.frame_id";
        let counts = &self.lidar.frames;
        let (path, topic) = (of.path.to_owned(), of.lidar.name.clone());
        let frames = counts.describe();
        match &of.options.lidar.frame_id {
            Some(requested) if counts.count(without_slash(requested)) == 0 => {
                let frames = if frames.is_empty() { "none".to_owned() } else { frames };
                let requested = requested.clone();
                Err(IngestError::FrameNotOnTopic { path, topic, requested, frames, option: OPTION })
            }
            Some(requested) => {
                let others = counts.without(without_slash(requested));
                if 0 < others.len() {
                    let frames = others.describe();
                    notes.push(of.on_lidar(NoteKind::OtherFrames { frames }));
                }
                Ok(())
            }
            None if 1 < counts.len() => {
                Err(IngestError::SeveralFrames { path, topic, frames, option: OPTION })
            }
            None => Ok(()),
        }
    }

    fn check_stamps(&self, of: &Observed<'_>, notes: &mut Vec<Note>) -> Result<(), IngestError> {
        let pose_stamp = of.options.pose.as_ref().map_or(Stamp::Header, |pose| pose.stamp);
        if !of.lidar.any(is_packet) {
            check_topic_stamps(of, of.lidar, &self.lidar, of.options.lidar.stamp, LIDAR_STAMP)?;
        }
        for (topic, observer) in of.pose_topics.iter().zip(&self.poses) {
            check_topic_stamps(of, topic, observer, pose_stamp, POSE_STAMP)?;
        }
        // The stamps of packets are compared with the device clock when revolutions are made.
        let is_lidar_compared = of.options.lidar.stamp == Stamp::Header && !of.lidar.any(is_packet);
        let is_shared = is_lidar_compared && pose_stamp == Stamp::Header && self.steps_are_shared();
        if is_lidar_compared {
            let stamps = &self.lidar.stamps;
            let kinds = step_notes(stamps, LIDAR_STAMP, is_shared).into_iter();
            notes.extend(kinds.map(|kind| of.on_lidar(kind)));
            notes.extend(order_notes(stamps).into_iter().map(|kind| of.on_lidar(kind)));
        }
        for (topic, observer) in of.pose_topics.iter().zip(&self.poses) {
            if pose_stamp == Stamp::Header {
                let kinds = step_notes(&observer.stamps, POSE_STAMP, is_shared).into_iter();
                notes.extend(kinds.map(|kind| Note::new(kind, Subject::topic(&topic.name))));
            }
            let lidar_delay_s = delay_s(&self.lidar.stamps, of.options.lidar.stamp);
            let delays = lidar_delay_s.zip(delay_s(&observer.stamps, pose_stamp));
            notes.extend(delays.filter(|&(lidar, pose)| are_of_two_clocks(lidar, pose)).map(
                |(delay_s, other_delay_s)| {
                    let other = topic.name.clone();
                    of.on_lidar(NoteKind::StampOffsetsDiffer { other, delay_s, other_delay_s })
                },
            ));
        }
        Ok(())
    }

    /// Whether the stamps of lidar and poses step against the log times by the same amounts at the same
    /// times. They have one clock then, for example that of a simulation that was paused.
    fn steps_are_shared(&self) -> bool {
        let of_lidar = self.lidar.stamps.steps_against_log();
        let slack_ns = |other: &StampObserver| {
            let periods_s = self.lidar.stamps.period_s().zip(other.period_s());
            1_000_000_000 + periods_s.map_or(0, |(a, b)| ((a + b) * 1e9) as u64)
        };
        let is_same = |a: &StampStep, b: &StampStep, slack_ns: u64| {
            a.step_ns.abs_diff(b.step_ns) < MAX_STEP_DIFFERENCE_NS
                && a.log_ns.abs_diff(b.log_ns) <= slack_ns
        };
        let is_shared_with = |other: &TopicObserver| {
            let of_other = other.stamps.steps_against_log();
            let slack_ns = slack_ns(&other.stamps);
            of_lidar.len() == of_other.len()
                && of_lidar.iter().zip(&of_other).all(|(a, b)| is_same(a, b, slack_ns))
        };
        !self.poses.is_empty() && self.poses.iter().all(is_shared_with)
    }

    /// Checks the angles, ranges and times of planar scans, and the ranges and times of clouds.
    fn check_readings(
        &self,
        of: &Observed<'_>,
        losses: &mut Losses,
        notes: &mut Vec<Note>,
    ) -> Result<(), IngestError> {
        if let Some((n, example)) = self.readings.contradictory.clone() {
            let kind = LossKind::ContradictoryAngles { example };
            losses.add(Loss::new(kind, Subject::topic(&of.lidar.name)), n);
        }
        let options = &of.options.lidar;
        let of_cloud = match self.readings.n_points {
            (n @ 1.., 0) => Some(format!(
                "none of the {n} points of the ring is within {} to {} m (`ingest.lidar.range_min_m` and `range_max_m`)",
                options.range_min_m, options.range_max_m
            )),
            _ => None,
        };
        if let Some(evidence) = self.readings.readings.fault(options).or(of_cloud) {
            let (path, topic) = (of.path.to_owned(), of.lidar.name.clone());
            return Err(IngestError::NoReturns { path, topic, evidence });
        }
        let period_s = self.lidar.stamps.period_s();
        let kinds = self.readings.readings.notes(period_s).into_iter();
        notes.extend(kinds.map(|kind| of.on_lidar(kind)));
        notes.extend(of.point_time.note().map(|kind| of.on_lidar(kind)));
        Ok(())
    }

    /// Checks that the messages of the lidar are in the frame of the sensor.
    fn check_sensor_frame(
        &self,
        of: &Observed<'_>,
        notes: &mut Vec<Note>,
    ) -> Result<(), IngestError> {
        let selected = of.options.lidar.frame_id.as_deref().map(without_slash);
        let Some(frame_id) = selected.or_else(|| self.lidar.frames.names().next()) else {
            return Ok(());
        };
        let parent = of.options.pose.as_ref().and_then(|pose| pose.frames.as_ref());
        let parent = parent.map(|frames| without_slash(&frames.parent));
        let of_poses = self.poses.iter().flat_map(|poses| poses.frames.names());
        // The frame of an IMU or of wheels is that of a sensor.
        let are_poses = of.options.pose.as_ref().is_some_and(|pose| pose.topic.is_some());
        let of_poses = of_poses.filter(|_| are_poses);
        let name = FrameName::of(frame_id, of_poses.chain(parent));
        if of.lidar.any(is_cloud) {
            return self.check_cloud_frame(of, frame_id, name, notes);
        }
        if name == FrameName::Fixed {
            let evidence = "this frame does not move with the robot, and planar scans do not show what they are seen from: check the driver".to_owned();
            let frame_id = frame_id.to_owned();
            notes.push(of.on_lidar(NoteKind::LidarFrameDoubtful { frame_id, evidence }));
        }
        Ok(())
    }
    /// Checks by the rings that clouds are in the frame of the sensor.
    fn check_cloud_frame(
        &self,
        of: &Observed<'_>,
        frame_id: &str,
        name: FrameName,
        notes: &mut Vec<Note>,
    ) -> Result<(), IngestError> {
        let cones = &self.readings.cones;
        let (path, topic, frame_id) =
            (of.path.to_owned(), of.lidar.name.clone(), frame_id.to_owned());
        if let Some(evidence) = cones.fault(name) {
            return Err(IngestError::NotInSensorFrame { path, topic, frame_id, evidence });
        }
        let evidence = match (name, cones.confirms_sensor()) {
            (FrameName::Fixed, false) => {
                let evidence = "this frame does not move with the lidar, and the rings do not show that the points are seen from its origin".to_owned();
                return Err(IngestError::NotInSensorFrame { path, topic, frame_id, evidence });
            }
            (FrameName::Fixed, true) => {
                "the rings are cones around its origin, so it was taken as the frame of the sensor"
            }
            (FrameName::Poses, false) => {
                "it is the frame of the poses, and the rings do not show that the points are seen from its origin"
            }
            _ => return Ok(()),
        };
        let evidence = evidence.to_owned();
        notes.push(of.on_lidar(NoteKind::LidarFrameDoubtful { frame_id, evidence }));
        Ok(())
    }
}

impl Observed<'_> {
    fn on_lidar(&self, kind: NoteKind) -> Note {
        Note::new(kind, Subject::topic(&self.lidar.name))
    }
}

/// Checks that the stamps that are used are not all 0, nor all equal.
fn check_topic_stamps(
    of: &Observed<'_>,
    topic: &Topic,
    observer: &TopicObserver,
    stamp: Stamp,
    option: &'static str,
) -> Result<(), IngestError> {
    let stamps = &observer.stamps;
    let stamp_ns = match stamps.n_messages() {
        0 => (0 < observer.n_unstamped).then_some(0),
        _ => stamps.only_stamp_ns(),
    };
    match stamp_ns {
        Some(stamp_ns) if stamp == Stamp::Header => Err(IngestError::NoStamps {
            path: of.path.to_owned(),
            topic: topic.name.clone(),
            n_messages: stamps.n_messages() + observer.n_unstamped,
            stamp_ns,
            option,
        }),
        _ => Ok(()),
    }
}

/// Notes about a clock that was set during the drive. Steps against the log times that all topics share
/// do no harm.
fn step_notes(stamps: &StampObserver, option: &str, is_shared: bool) -> Vec<NoteKind> {
    let option = option.to_owned();
    let against_log = stamps.steps_against_log();
    let back = stamps.steps_back();
    let largest_s = |steps: &mut dyn Iterator<Item = i64>| {
        steps.max_by_key(|ns| ns.saturating_abs()).unwrap_or(0) as f64 * 1e-9
    };
    if let Some(first) = back.first() {
        let n_steps = back.len() as u64;
        let with_log = against_log.is_empty();
        let mut sizes = back.iter().chain(&against_log).map(|s| s.step_ns.min(0));
        let largest_s = largest_s(&mut sizes).abs();
        let log_ns = first.log_ns;
        return vec![NoteKind::StampsStepBack { n_steps, largest_s, log_ns, with_log, option }];
    }
    match against_log.first().filter(|_| !is_shared) {
        None => Vec::new(),
        Some(first) => {
            let n_steps = against_log.len() as u64;
            let largest_s = largest_s(&mut against_log.iter().map(|step| step.step_ns));
            let log_ns = first.log_ns;
            vec![NoteKind::StampsStepAgainstLog { n_steps, largest_s, log_ns, option }]
        }
    }
}

/// Notes about the order of the messages of the lidar.
fn order_notes(stamps: &StampObserver) -> Vec<NoteKind> {
    let mut notes = Vec::new();
    if let n_messages @ 1.. = stamps.n_out_of_order() {
        notes.push(NoteKind::MessagesOutOfOrder { n_messages });
    }
    if let n_equal @ 1.. = stamps.n_equal() {
        let (n_messages, option) = (stamps.n_messages(), LIDAR_STAMP.to_owned());
        notes.push(NoteKind::EqualStamps { n_equal, n_messages, option });
    }
    notes
}

/// Log time minus the time that is used \[s\]. `None` if it is not known, or not constant.
fn delay_s(stamps: &StampObserver, stamp: Stamp) -> Option<f64> {
    let delay_s = stamps.delay_s().filter(|_| stamps.only_stamp_ns().is_none())?;
    match stamp {
        Stamp::Log => Some(0.0),
        Stamp::Header => stamps.steps_against_log().is_empty().then_some(delay_s),
    }
}

/// Whether two topics with these delays are stamped by two clocks.
fn are_of_two_clocks(a_s: f64, b_s: f64) -> bool {
    let is_early = |early: f64, other: f64| early < -MAX_EARLY_S && -MAX_EARLY_S / 2.0 < other;
    MAX_DELAY_DIFFERENCE_S < (a_s - b_s).abs() || is_early(a_s, b_s) || is_early(b_s, a_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delays_show_two_clocks() {
        // Both in time, both delayed, both from a log that was played again, and a slow localiser.
        for (a, b) in [(0.01, 0.12), (0.3, 0.9), (4e8, 4e8 + 0.2), (0.0, 0.0), (0.02, -0.04)] {
            assert!(!are_of_two_clocks(a, b) && !are_of_two_clocks(b, a), "{a} {b}");
        }
        // Leap seconds, a time zone, and a clock that is ahead of the recorder.
        for (a, b) in [(18.02, 0.02), (-3599.9, 0.1), (-0.4, 0.02), (1.6, 0.1), (4e8, 0.0)] {
            assert!(are_of_two_clocks(a, b) && are_of_two_clocks(b, a), "{a} {b}");
        }
    }

    fn stamps(n: i64, stamp_ns: impl Fn(i64) -> i64, log_ns: impl Fn(i64) -> i64) -> StampObserver {
        let mut observer = StampObserver::default();
        (0..n).for_each(|k| observer.add(stamp_ns(k), log_ns(k) as u64));
        observer
    }

    const S: i64 = 1_000_000_000;

    /// A simulation is paused for 30 s, while the log times go on.
    #[test]
    fn a_pause_of_one_clock_is_no_step() {
        let at = |k: i64| 100 * S + k * S / 10;
        let log = |k: i64| at(k) + if 40 <= k { 30 * S } else { 0 };
        let observed = |poses: StampObserver| Observers {
            lidar: TopicObserver { stamps: stamps(80, at, log), ..Default::default() },
            poses: vec![TopicObserver { stamps: poses, ..Default::default() }],
            ..Default::default()
        };
        assert!(observed(stamps(80, at, log)).steps_are_shared());
        assert!(!observed(stamps(80, at, at)).steps_are_shared());
        assert!(
            !observed(stamps(80, at, |k| at(k) + if 40 <= k { 3 * S } else { 0 }))
                .steps_are_shared()
        );
        assert_eq!(step_notes(&stamps(80, at, log), "o", true), []);
        assert_eq!(step_notes(&stamps(80, at, log), "o", false).len(), 1);
    }

    #[test]
    fn one_note_describes_a_step() {
        let at = |k: i64| 100 * S + k * S / 10;
        let back = |k: i64| at(k) - if 40 <= k { 3 * S } else { 0 };
        let notes = step_notes(&stamps(80, back, at), "ingest.lidar.stamp", false);
        let [note @ NoteKind::StampsStepBack { n_steps: 1, with_log: false, .. }] = &notes[..]
        else {
            panic!("{notes:?}")
        };
        let text = note.to_string();
        assert!(text.starts_with("the stamps step back by up to 3.00 s, once, first at"), "{text}");
        assert!(text.contains("set `ingest.lidar.stamp = \"log\"`"), "{text}");

        let notes = step_notes(&stamps(80, back, back), "o", false);
        assert!(
            matches!(notes[..], [NoteKind::StampsStepBack { with_log: true, .. }]),
            "{notes:?}"
        );

        let ahead = |k: i64| at(k) + if 40 <= k { 18 * S } else { 0 };
        let notes = step_notes(&stamps(80, ahead, at), "o", false);
        let [NoteKind::StampsStepAgainstLog { largest_s, .. }] = notes[..] else {
            panic!("{notes:?}")
        };
        assert!((largest_s - 18.0).abs() < 1e-9);
    }
}
