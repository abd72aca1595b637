//! Suggests a pipeline for a log.

use std::fmt::{self, Write as _};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use dataset::FULL_RING_DEG;
use ingest::{Content, HORIZONTAL_LASER, MessageType, Survey, TopicSurvey};

/// The suggested topics.
pub(crate) struct Suggestion<'a> {
    pub(crate) lidar: Option<&'a TopicSurvey>,
    pose: Option<&'a TopicSurvey>,
    /// Wheel odometry and an IMU, if the log has no poses or the track width is given.
    wheels: Option<(&'a TopicSurvey, Option<&'a TopicSurvey>)>,
    track_m: Option<f64>,
    /// Two frames connected by transforms, if the log has no poses.
    frames: Option<SuggestedFrames>,
    /// A topic of packets without a complete revolution.
    lidar_without_revolution: Option<&'a TopicSurvey>,
}

impl<'a> Suggestion<'a> {
    /// Selects the topics. Packets are preferred to clouds, and clouds to planar scans. Of the pose
    /// topics with movement, the one with the most messages is selected.
    pub(crate) fn of(survey: &'a Survey, track_m: Option<f64>) -> Self {
        let rank = |topic: &TopicSurvey| match &topic.content {
            Content::Packets(packets) if packets.is_hdl32e && packets.n_revolutions > 0 => 3,
            Content::Clouds(clouds) if !clouds.rings.is_empty() => 2,
            Content::Scans(_) => 1,
            _ => 0,
        };
        let moves = |topic: &TopicSurvey| match &topic.content {
            Content::Poses(poses) => poses.path_m > 0.0,
            _ => false,
        };
        let lidars = survey.topics.iter().filter(|topic| rank(topic) > 0);
        let poses = survey.topics.iter().filter(|topic| moves(topic));
        let is_one_of = |topic: &TopicSurvey, types: &[MessageType]| {
            let name = topic.schema.rsplit('/').next().unwrap_or_default();
            topic.n_messages > 0 && types.iter().any(|of| of.name() == name)
        };
        let with_most_messages = |types: &[MessageType]| {
            let topics = survey.topics.iter().rev().filter(|topic| is_one_of(topic, types));
            topics.max_by_key(|topic| topic.n_messages)
        };
        // Satellite fixes have no heading and need an origin. They are the last choice.
        let pose = poses
            .rev()
            .max_by_key(|topic| (!is_one_of(topic, &[MessageType::NavSatFix]), topic.n_messages));
        // Wheel joints are preferred to the odometry that a driver computes from them.
        let wheels = ingest::WHEEL_TYPES.iter().find_map(|of| with_most_messages(&[*of]));
        let imu = with_most_messages(&ingest::IMU_TYPES);
        let is_wanted = pose.is_none() || track_m.is_some();
        let frames = SuggestedFrames::of(survey).filter(|_| pose.is_none() && track_m.is_none());
        Self {
            // Of topics with equal numbers, the first by name.
            lidar: lidars.rev().max_by_key(|topic| (rank(topic), topic.n_messages)),
            pose: pose.filter(|_| track_m.is_none() || wheels.is_none()),
            wheels: wheels.filter(|_| is_wanted && frames.is_none()).map(|wheels| (wheels, imu)),
            track_m,
            frames,
            lidar_without_revolution: survey.topics.iter().find(
                |topic| matches!(&topic.content, Content::Packets(packets) if packets.n_revolutions == 0),
            ),
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
            missing.push(format!(
                "the track width of the wheels of topic `{}`, which could give poses; measure it and pass it with --track-m",
                wheels.topic
            ));
        } else if self.pose.is_none() && self.wheels.is_none() && self.frames.is_none() {
            let names = ingest::POSE_TYPES.map(MessageType::name).join(", ");
            missing.push(format!(
                "a pose topic with movement (one of {names}); without poses, scans can be ingested but not labelled"
            ));
        }
        missing
    }

    /// Whether the suggested pipeline has poses.
    pub(crate) fn has_poses(&self) -> bool {
        self.pose.is_some()
            || self.frames.is_some()
            || (self.wheels.is_some() && self.track_m.is_some())
    }

    /// The text of the pipeline file. The path of the log is relative to the folder `from`, or
    /// absolute without it.
    pub(crate) fn pipeline(
        &self,
        lidar: &TopicSurvey,
        log: &Path,
        from: Option<&Path>,
    ) -> Result<String> {
        let found = |path: &Path| {
            path.canonicalize().with_context(|| format!("cannot find {}", path.display()))
        };
        let log = match from {
            Some(folder) if folder.as_os_str().is_empty() => {
                relative(&found(log)?, &found(Path::new("."))?)
            }
            Some(folder) => relative(&found(log)?, &found(folder)?),
            None => found(log)?,
        };
        let mut text = format!("[ingest]\nlogs = [{:?}]\n", log.display().to_string());
        self.write_poses(&mut text)?;
        write_lidar(&mut text, lidar)?;
        Ok(text)
    }

    /// Writes the options of the poses.
    fn write_poses(&self, text: &mut String) -> fmt::Result {
        match (self.pose, self.wheels) {
            (Some(pose), _) => writeln!(text, "pose.topic = {:?}", pose.topic)?,
            (None, Some((wheels, imu))) => {
                writeln!(text, "\n[ingest.pose]\nwheels = {:?}", wheels.topic)?;
                if let Some(imu) = imu {
                    writeln!(text, "imu = {:?}", imu.topic)?;
                }
                match self.track_m {
                    Some(track_m) => writeln!(text, "track_m = {track_m:?}")?,
                    None => writeln!(
                        text,
                        "# track_m = 0.5   # measure it: distance between the contact points of the wheels [m]"
                    )?,
                }
            }
            (None, None) => match &self.frames {
                Some(SuggestedFrames { parent, child, topics }) => writeln!(
                    text,
                    "\n[ingest.pose.frames]\nparent = {parent:?}\nchild = {child:?}\ntopics = {topics:?}"
                )?,
                None => writeln!(
                    text,
                    "# pose.topic = \"...\"   # the log has no poses; without poses, scans cannot be labelled"
                )?,
            },
        }
        Ok(())
    }
}

/// Writes the options of the lidar, and those of the labels that depend on it.
fn write_lidar(text: &mut String, lidar: &TopicSurvey) -> fmt::Result {
    writeln!(text, "\n[ingest.lidar]\ntopic = {:?}", lidar.topic)?;
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
            if scans.coverage_deg < f64::from(FULL_RING_DEG) {
                writeln!(
                    text,
                    "\n[label]\npositive_heading_deg = 45.0   # the scanner covers less than a full circle"
                )?;
            }
        }
        _ => {}
    }
    Ok(())
}

/// Two frames that are connected by transforms.
struct SuggestedFrames {
    parent: String,
    child: String,
    topics: Vec<String>,
}

impl SuggestedFrames {
    /// The parent is a frame `map`, `world` or `odom` (REP 105) that has no parent itself. The child is
    /// a frame of the lidar, or the base frame of the robot if there is none.
    fn of(survey: &Survey) -> Option<Self> {
        let of_topic = |topic: &'_ TopicSurvey| match &topic.content {
            Content::Transforms(transforms) => transforms.clone(),
            _ => Vec::new(),
        };
        let transforms: Vec<_> = survey.topics.iter().flat_map(of_topic).collect();
        let bare = |frame: &str| frame.trim_start_matches('/').to_owned();
        let ends_with = |frame: &str, name: &str| {
            frame
                .strip_suffix(name)
                .is_some_and(|before| before.is_empty() || before.ends_with('/'))
        };
        let is_root = |frame: &str| transforms.iter().all(|t| bare(&t.child) != frame);
        let mut roots: Vec<String> = transforms.iter().map(|t| bare(&t.parent)).collect();
        roots.retain(|frame| is_root(frame));
        let parent = ["map", "world", "odom"]
            .into_iter()
            .find_map(|name| roots.iter().find(|frame| ends_with(frame, name)))?
            .clone();
        // The descendants of the parent, in breadth-first order.
        let mut below = vec![parent.clone()];
        let mut k = 0;
        while let Some(frame) = below.get(k).cloned() {
            let children =
                transforms.iter().filter(|t| bare(&t.parent) == frame).map(|t| bare(&t.child));
            let new: Vec<_> = children.filter(|child| !below.contains(child)).collect();
            below.extend(new);
            k += 1;
        }
        let named = |names: &[&str]| {
            below[1..].iter().find(|frame| names.iter().any(|name| frame.contains(name)))
        };
        let child =
            named(&["velodyne", "lidar", "laser"]).or_else(|| named(&["base_link", "base"]))?;
        let has_transforms = |topic: &&TopicSurvey| !of_topic(topic).is_empty();
        let topics = survey.topics.iter().filter(has_transforms).map(|topic| topic.topic.clone());
        Some(Self { parent, child: child.clone(), topics: topics.collect() })
    }
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
    use ingest::TransformSurvey;

    fn topic(name: &str, schema: &str, n_messages: u64, content: Content) -> TopicSurvey {
        let (topic, schema, encoding) = (name.to_owned(), schema.to_owned(), "cdr".to_owned());
        TopicSurvey { topic, schema, encoding, n_messages, rate_hz: None, content }
    }

    #[test]
    fn frames_are_suggested_from_the_map_to_the_lidar() {
        let transform = |parent: &str, child: &str| TransformSurvey {
            parent: parent.to_owned(),
            child: child.to_owned(),
            n_samples: 9,
        };
        let moving =
            Content::Transforms(vec![transform("/map", "odom"), transform("odom", "base_link")]);
        let fixed = Content::Transforms(vec![
            transform("base_link", "mast"),
            transform("mast", "velodyne_top"),
        ]);
        let of = |topics: Vec<TopicSurvey>| Survey { topics, ..Survey::default() };
        let tf = |name: &str, content| topic(name, "tf2_msgs/msg/TFMessage", 9, content);
        let survey = of(vec![tf("/tf", moving.clone()), tf("/tf_static", fixed.clone())]);
        let frames = SuggestedFrames::of(&survey).unwrap();
        assert_eq!((&*frames.parent, &*frames.child), ("map", "velodyne_top"));
        assert_eq!(frames.topics, ["/tf", "/tf_static"]);
        let frames = SuggestedFrames::of(&of(vec![tf("/tf", moving)])).unwrap();
        assert_eq!(frames.child, "base_link");
        // Static transforms alone do not connect the robot to a map.
        assert!(SuggestedFrames::of(&of(vec![tf("/tf_static", fixed)])).is_none());
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
            let text = suggestion.pipeline(suggestion.lidar.unwrap(), &log, None).unwrap();
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
        assert!(missing.is_empty() && text.contains("pose.topic = \"/odom\""), "{text}");
        assert!(written(&survey, Some(0.4)).2.contains("wheels = \"/joints\""));
    }

    #[test]
    fn the_path_of_the_log_is_relative_to_the_pipeline_file() {
        let relative = |path, folder| relative(Path::new(path), Path::new(folder));
        assert_eq!(relative("/data/logs/a.mcap", "/data/pipelines"), Path::new("../logs/a.mcap"));
        assert_eq!(relative("/data/a.mcap", "/data"), Path::new("a.mcap"));
        assert_eq!(relative("/x/a.mcap", "/data/p"), Path::new("../../x/a.mcap"));
    }
}
