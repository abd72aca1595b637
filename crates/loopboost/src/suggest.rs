//! Suggests a pipeline for a log.

use std::collections::BTreeMap;
use std::fmt::{self, Write as _};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow};
use dataset::{Note, NoteKind, Subject};
use ingest::{Content, HORIZONTAL_LASER, MessageType, Survey, TopicSurvey};

use crate::disagreement::disagreement;
use crate::label_choice::LabelChoice;
use crate::pose_choice::{PoseCandidate, PoseSource, Quality, main_frame, pose_candidates};

/// The suggested topics.
pub(crate) struct Suggestion<'a> {
    pub(crate) lidar: Option<&'a TopicSurvey>,
    /// Sources of poses in the log, the best first. The first is suggested, unless `wheels` is.
    poses: Vec<PoseCandidate<'a>>,
    /// Wheel odometry and an IMU, if the log has no poses or the track width is given.
    wheels: Option<(&'a TopicSurvey, Option<&'a TopicSurvey>)>,
    track_m: Option<f64>,
    /// A topic of packets without a complete revolution.
    lidar_without_revolution: Option<&'a TopicSurvey>,
    /// Pose topics that do not move.
    still: Vec<&'a TopicSurvey>,
}

impl<'a> Suggestion<'a> {
    /// Selects the topics. Packets are preferred to clouds, and clouds to planar scans. Poses in a map
    /// frame are preferred to odometry ([`pose_candidates`]).
    pub(crate) fn of(survey: &'a Survey, track_m: Option<f64>) -> Self {
        let rank = |topic: &TopicSurvey| match &topic.content {
            Content::Packets(packets) if packets.is_hdl32e && packets.n_revolutions > 0 => 3,
            Content::Clouds(clouds) if !clouds.rings.is_empty() => 2,
            Content::Scans(_) => 1,
            _ => 0,
        };
        let is_still = |topic: &&TopicSurvey| match &topic.content {
            Content::Poses(poses) => poses.path_m <= 0.0 && 0 < topic.n_messages,
            _ => false,
        };
        let lidars = survey.topics.iter().filter(|topic| rank(topic) > 0);
        let is_one_of = |topic: &TopicSurvey, types: &[MessageType]| {
            let name = topic.schema.rsplit('/').next().unwrap_or_default();
            topic.n_messages > 0 && types.iter().any(|of| of.name() == name)
        };
        let with_most_messages = |types: &[MessageType]| {
            let topics = survey.topics.iter().rev().filter(|topic| is_one_of(topic, types));
            topics.max_by_key(|topic| topic.n_messages)
        };
        let poses = pose_candidates(survey);
        // Wheel joints are preferred to the odometry that a driver computes from them.
        let wheels = ingest::WHEEL_TYPES.iter().find_map(|of| with_most_messages(&[*of]));
        let imu = with_most_messages(&ingest::IMU_TYPES);
        let is_wanted = poses.is_empty() || track_m.is_some();
        Self {
            // Of topics with equal numbers, the first by name.
            lidar: lidars.rev().max_by_key(|topic| (rank(topic), topic.n_messages)),
            poses,
            wheels: wheels.filter(|_| is_wanted).map(|wheels| (wheels, imu)),
            track_m,
            lidar_without_revolution: survey.topics.iter().find(
                |topic| matches!(&topic.content, Content::Packets(packets) if packets.n_revolutions == 0),
            ),
            still: survey.topics.iter().filter(is_still).collect(),
        }
    }

    /// What the log or the options lack for a complete pipeline.
    pub(crate) fn missing(&self) -> Vec<String> {
        let mut missing = Vec::new();
        if let (None, Some(topic)) = (self.lidar, self.lidar_without_revolution) {
            missing.push(format!("complete revolutions in the packets of topic `{}`", topic.topic));
        } else if self.lidar.is_none() {
            let names = ingest::LIDAR_TYPES.map(MessageType::name).join(", ");
            missing.push(format!("a lidar topic (one of {names})"));
        }
        if let (Some((wheels, _)), None) = (self.wheels, self.track_m) {
            let radius = match wheels.content {
                Content::Joints(_) => {
                    "; set the radius of the wheels in `ingest.pose.wheel_radius_m`"
                }
                _ => "",
            };
            missing.push(format!(
                "the track width of the wheels of topic `{}`: measure it and pass it with --track-m, to get poses from the wheels{radius}",
                wheels.topic
            ));
        } else if self.poses.is_empty() && self.wheels.is_none() {
            let names = ingest::POSE_TYPES.map(MessageType::name).join(", ");
            let still = match self.still.as_slice() {
                [] => String::new(),
                [one, ..] => format!("; the poses of topic `{}` never change", one.topic),
            };
            missing.push(format!(
                "a topic with poses that move (one of {names}){still}; without poses, scans can be ingested but not labelled"
            ));
        }
        missing
    }

    /// Whether the suggested pipeline has poses.
    pub(crate) fn has_poses(&self) -> bool {
        match self.wheels {
            Some(_) => self.track_m.is_some(),
            None => !self.poses.is_empty(),
        }
    }

    /// The options without which `ingest` would refuse the log.
    pub(crate) fn needed_options(&self) -> Vec<Note> {
        let pose = self.poses.first().filter(|_| self.wheels.is_none());
        let pose = pose.and_then(|pose| match &pose.source {
            PoseSource::Topic(topic) => Some(("ingest.pose", *topic)),
            PoseSource::Frames { .. } => None,
        });
        let sections = self.lidar.map(|lidar| ("ingest.lidar", lidar)).into_iter().chain(pose);
        let of_section = |(section, topic): (&str, &TopicSurvey)| {
            let note = |key: &str, value: &str, reason: String| {
                let option = format!("{section}.{key} = {value:?}");
                Note::new(NoteKind::OptionNeeded { option, reason }, Subject::topic(&topic.topic))
            };
            let stamps = topic.stamps.needs_log_times().then(|| {
                note("stamp", "log", "all stamps in the headers are 0 or equal".to_owned())
            });
            let others = other_frames(topic);
            let frames = (!others.is_empty()).then(|| {
                let reason = format!("the topic has messages of other frames, too: {others}");
                note("frame_id", main_frame(topic), reason)
            });
            stamps.into_iter().chain(frames).collect::<Vec<_>>()
        };
        sections.flat_map(of_section).collect()
    }

    /// Whether other pose topics disagree with the suggested one.
    pub(crate) fn disagreements(&self) -> Vec<Note> {
        let of_topic = |of: &PoseCandidate<'a>| match &of.source {
            PoseSource::Topic(topic) => Some(*topic),
            PoseSource::Frames { .. } => None,
        };
        let Some(used) = self.poses.first().and_then(of_topic).filter(|_| self.wheels.is_none())
        else {
            return Vec::new();
        };
        let trajectory = |topic: &'a TopicSurvey| match &topic.content {
            Content::Poses(poses) => Some(&poses.trajectory),
            _ => None,
        };
        // Fixes are positions without headings, with an error of metres: they do not contradict.
        let others = self.poses[1..].iter().filter(|of| Quality::Fixes < of.quality);
        let others = others.filter_map(of_topic).filter_map(|other| {
            let kind = disagreement(trajectory(used)?, trajectory(other)?, &other.topic)?;
            Some(Note::new(kind, Subject::topic(&used.topic)))
        });
        others.collect()
    }

    /// The angle that planar scans of the lidar topic cover \[deg\]; `None` for other topics.
    pub(crate) fn coverage_deg(&self) -> Option<f64> {
        match &self.lidar?.content {
            Content::Scans(scans) => Some(scans.coverage_deg),
            _ => None,
        }
    }

    /// The text of the pipeline file. The paths of the logs are relative to the folder `from`, or
    /// absolute without it.
    pub(crate) fn pipeline(
        &self,
        lidar: &TopicSurvey,
        logs: &[PathBuf],
        from: Option<&Path>,
        labels: &LabelChoice,
    ) -> Result<String> {
        let found = |path: &Path| {
            path.canonicalize().with_context(|| format!("cannot find {}", path.display()))
        };
        let in_file = |log: &PathBuf| -> Result<String> {
            let log = match from {
                Some(folder) if folder.as_os_str().is_empty() => {
                    relative(&found(log)?, &found(Path::new("."))?)
                }
                Some(folder) => relative(&found(log)?, &found(folder)?),
                None => found(log)?,
            };
            Ok(format!("{:?}", log.display().to_string()))
        };
        let logs = logs.iter().map(in_file).collect::<Result<Vec<_>>>()?;
        let mut text = match &logs[..] {
            [one] => format!("[ingest]\nlogs = [{one}]\n"),
            logs => format!("[ingest]\nlogs = [\n    {},\n]\n", logs.join(",\n    ")),
        };
        self.write_poses(&mut text)?;
        write_lidar(&mut text, lidar)?;
        labels.write(&mut text)?;
        Ok(text)
    }

    /// Writes the options of the poses. Other sources are comments.
    fn write_poses(&self, text: &mut String) -> fmt::Result {
        let (used, others) = match (self.wheels, self.poses.split_first()) {
            (None, Some((used, others))) => (Some(used), others),
            _ => (None, self.poses.as_slice()),
        };
        match (used.map(|of| &of.source), self.wheels) {
            (Some(PoseSource::Topic(topic)), _) => {
                writeln!(text, "pose.topic = {:?}{}", topic.topic, comment(used))?;
                write_frame_id(text, "pose.frame_id", topic)?;
                if topic.stamps.needs_log_times() {
                    writeln!(
                        text,
                        "pose.stamp = \"log\"   # all stamps in the headers are 0 or equal"
                    )?;
                }
                write_others(text, others)?;
            }
            (Some(PoseSource::Frames { parent, child, topics }), _) => {
                write_others(text, others)?;
                writeln!(
                    text,
                    "\n[ingest.pose.frames]\nparent = {parent:?}{}\nchild = {child:?}\ntopics = {topics:?}",
                    comment(used)
                )?;
            }
            (None, Some((wheels, imu))) => {
                write_others(text, others)?;
                writeln!(text, "\n[ingest.pose]\nwheels = {:?}", wheels.topic)?;
                if let Some(imu) = imu {
                    writeln!(text, "imu = {:?}", imu.topic)?;
                }
                if matches!(wheels.content, Content::Joints(_)) {
                    writeln!(
                        text,
                        "# wheel_radius_m = 0.1   # joints are in rad/s; or wheel_speed_unit = \"m/s\""
                    )?;
                }
                match self.track_m {
                    Some(track_m) => writeln!(text, "track_m = {track_m:?}")?,
                    None => writeln!(
                        text,
                        "# track_m = 0.5   # measure it: distance between the contact points of the wheels [m]"
                    )?,
                }
            }
            (None, None) => writeln!(
                text,
                "# pose.topic = \"...\"   # the log has no poses; without poses, scans cannot be labelled"
            )?,
        }
        Ok(())
    }
}

/// Why a source of poses was chosen, or what is wrong with it.
fn comment(of: Option<&PoseCandidate<'_>>) -> String {
    of.map(|of| format!("   # {}", of.reason)).unwrap_or_default()
}

/// Writes other sources of poses as comments.
fn write_others(text: &mut String, others: &[PoseCandidate<'_>]) -> fmt::Result {
    for of in others {
        let comment = comment(Some(of));
        match &of.source {
            PoseSource::Topic(topic) => {
                writeln!(text, "# pose.topic = {:?}{comment}", topic.topic)?;
            }
            PoseSource::Frames { parent, child, topics } => writeln!(
                text,
                "# pose.frames = {{ parent = {parent:?}, child = {child:?}, topics = {topics:?} }}{comment}"
            )?,
        }
    }
    Ok(())
}

/// Selects the frame of most messages, if a topic has several. The others are a comment.
fn write_frame_id(text: &mut String, key: &str, topic: &TopicSurvey) -> fmt::Result {
    match other_frames(topic) {
        none if none.is_empty() => Ok(()),
        others => writeln!(text, "{key} = {:?}   # the topic also has {others}", main_frame(topic)),
    }
}

/// The frames of a topic that the suggested pipeline does not use, as text.
fn other_frames(topic: &TopicSurvey) -> String {
    let mut n_messages: BTreeMap<&str, u64> = BTreeMap::new();
    for frame in &topic.frames {
        *n_messages.entry(&frame.frame_id).or_default() += frame.n_messages;
    }
    let used = main_frame(topic);
    let others = n_messages
        .into_iter()
        .filter(|(frame, _)| *frame != used)
        .map(|(frame, n)| format!("`{frame}` ({n} messages)"));
    others.collect::<Vec<_>>().join(", ")
}

/// Writes the options of the lidar.
fn write_lidar(text: &mut String, lidar: &TopicSurvey) -> fmt::Result {
    writeln!(text, "\n[ingest.lidar]\ntopic = {:?}", lidar.topic)?;
    write_frame_id(text, "frame_id", lidar)?;
    if lidar.stamps.needs_log_times() {
        writeln!(text, "stamp = \"log\"   # all stamps in the headers are 0 or equal")?;
    }
    match &lidar.content {
        Content::Packets(packets) => {
            if packets.is_stamped_by_message() {
                writeln!(
                    text,
                    "clock = \"device\"   # all packets of a message have the same stamp"
                )?;
            }
            if let Some(laser) = packets.stand_in() {
                writeln!(
                    text,
                    "laser = {laser}   # the horizontal laser, {HORIZONTAL_LASER}, has no returns"
                )?;
            }
        }
        Content::Clouds(clouds) => {
            let nearest = clouds.rings.iter().min_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
            if let Some((ring, deg)) = nearest {
                writeln!(text, "ring = {ring}   # elevation {deg:.2} deg")?;
            }
        }
        Content::Scans(scans) => {
            let (near, far) = scans.range_m;
            writeln!(text, "range_min_m = {:?}", near.max(0.0))?;
            if near < far && far.is_finite() {
                writeln!(text, "range_max_m = {far:?}")?;
            }
        }
        _ => {}
    }
    Ok(())
}

/// Writes a suggested pipeline to a file that does not exist.
pub(crate) fn write_suggestion(path: &Path, text: &str) -> Result<()> {
    use std::io::Write as _;
    let mut file = std::fs::File::create_new(path).map_err(|e| match e.kind() {
        std::io::ErrorKind::AlreadyExists => {
            anyhow!("{} already exists; choose another file with --write", path.display())
        }
        _ => anyhow::Error::new(e).context(format!("cannot write {}", path.display())),
    })?;
    file.write_all(text.as_bytes()).with_context(|| format!("cannot write {}", path.display()))
}

/// A path relative to a folder. Both are absolute.
fn relative(path: &Path, folder: &Path) -> PathBuf {
    let shared = path.components().zip(folder.components()).take_while(|(a, b)| a == b).count();
    let up = folder.components().skip(shared).map(|_| "..");
    up.map(PathBuf::from)
        .chain(path.components().skip(shared).map(|c| PathBuf::from(c.as_os_str())))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    fn topic(name: &str, schema: &str, n_messages: u64, content: Content) -> TopicSurvey {
        let (topic, schema, encoding) = (name.to_owned(), schema.to_owned(), "cdr".to_owned());
        TopicSurvey {
            topic,
            schema,
            encoding,
            n_messages,
            rate_hz: None,
            frames: Vec::new(),
            stamps: Default::default(),
            content,
        }
    }

    /// The log has no poses. Its wheels and IMU give poses if the track width is given.
    #[test]
    fn wheels_and_imu_are_suggested_for_a_log_without_poses() {
        let scans = ingest::ScansSurvey { coverage_deg: 360.0, ..Default::default() };
        let topics = vec![
            topic("/imu", "sensor_msgs/msg/Imu", 100, Content::Other),
            topic("/joints", "sensor_msgs/msg/JointState", 50, Content::Other),
            topic("/odom", "nav_msgs/msg/Odometry", 500, Content::Poses(Default::default())),
            topic("/scan", "sensor_msgs/msg/LaserScan", 10, Content::Scans(scans)),
        ];
        let mut survey = Survey { topics, ..Survey::default() };
        let log = std::env::current_exe().unwrap();
        let written = |survey: &Survey, track_m| {
            let suggestion = Suggestion::of(survey, track_m);
            let labels = LabelChoice::without_keyframes(None);
            let logs = std::slice::from_ref(&log);
            let text = suggestion.pipeline(suggestion.lidar.unwrap(), logs, None, &labels).unwrap();
            (suggestion.missing(), suggestion.has_poses(), text)
        };
        let (missing, has_poses, text) = written(&survey, None);
        assert!(
            !has_poses && missing[0].contains("the track width of the wheels of topic `/joints`")
        );
        assert!(text.contains("wheels = \"/joints\"\nimu = \"/imu\"\n# track_m"), "{text}");
        let (missing, has_poses, text) = written(&survey, Some(0.4));
        assert!(has_poses && missing.is_empty(), "{missing:?}");
        assert!(text.contains("imu = \"/imu\"\ntrack_m = 0.4\n"), "{text}");
        // Poses with movement are suggested instead, unless the track width is given.
        let moving = ingest::PosesSurvey { path_m: 3.0, ..Default::default() };
        survey.topics[2].content = Content::Poses(moving);
        let (missing, _, text) = written(&survey, None);
        assert!(missing.is_empty() && text.contains("\npose.topic = \"/odom\""), "{text}");
        let (_, _, text) = written(&survey, Some(0.4));
        assert!(text.contains("wheels = \"/joints\""), "{text}");
        assert!(text.contains("# pose.topic = \"/odom\""), "{text}");
    }

    #[test]
    fn the_path_of_the_log_is_relative_to_the_pipeline_file() {
        let relative = |path, folder| relative(Path::new(path), Path::new(folder));
        assert_eq!(relative("/data/logs/a.mcap", "/data/pipelines"), Path::new("../logs/a.mcap"));
        assert_eq!(relative("/data/a.mcap", "/data"), Path::new("a.mcap"));
        assert_eq!(relative("/x/a.mcap", "/data/p"), Path::new("../../x/a.mcap"));
    }
}
