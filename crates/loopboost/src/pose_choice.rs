//! Chooses the source of poses for a suggested pipeline.
//!
//! Labels need poses that return to the same coordinates when the robot returns to the same place.
//! Poses in a map frame do; odometry drifts.

use dataset::StampedPose;
use ingest::{Content, Survey, TopicSurvey};

/// A source of poses in the log.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PoseCandidate<'a> {
    pub(crate) source: PoseSource<'a>,
    pub(crate) quality: Quality,
    /// What shows the quality, for a comment in the pipeline.
    pub(crate) reason: String,
    /// Whether the poses follow the robot, and are not a few goals or detections.
    is_dense: bool,
    n_samples: u64,
}

/// Where poses come from.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum PoseSource<'a> {
    /// A topic with poses that move.
    Topic(&'a TopicSurvey),
    /// Two frames connected by transforms.
    Frames {
        /// The frame of the map.
        parent: String,
        /// The frame of the lidar or the robot.
        child: String,
        /// The topics with transforms.
        topics: Vec<String>,
    },
}

/// How well poses are suited for labels. A later variant is better.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Quality {
    /// Not poses of the robot by their name or frame, such as goals.
    OfOther,
    /// Satellite fixes: they have no heading, and their origin must be set.
    Fixes,
    /// Odometry, which drifts.
    Drifting,
    /// Neither name nor frame shows what the poses are.
    Unknown,
    /// Poses in a map frame, or corrected poses.
    Map,
    /// Ground truth.
    Truth,
}

/// Parts of the names of topics with ground truth: of simulators and of motion capture.
const TRUTH: [&str; 8] =
    ["ground_truth", "groundtruth", "truth", "mocap", "vicon", "vrpn", "optitrack", "qualisys"];
/// Parts of the names of topics with corrected poses: of SLAM and of localisation in a map.
const CORRECTED: [&str; 9] = [
    "corrected",
    "optimi",
    "slam",
    "amcl",
    "localiz",
    "localis",
    "refined",
    "pose_graph",
    "loop_clos",
];
/// Parts of the names of topics with poses of something other than the robot.
const OF_OTHER: [&str; 12] = [
    "goal",
    "initialpose",
    "target",
    "waypoint",
    "setpoint",
    "clicked",
    "marker",
    "detect",
    "person",
    "object",
    "tag_",
    "plan",
];
/// Names of frames that the robot carries: a pose in such a frame is not the pose of the robot.
const CARRIED: [&str; 6] = ["base_link", "base_footprint", "camera", "laser", "lidar", "velodyne"];
/// Names of the frames of a map (REP 105), and of their parents.
const MAPS: [&str; 5] = ["map", "world", "earth", "utm", "enu"];

/// The sources of poses in a log, the best first. Of sources of the same quality, topics come first,
/// and those with more messages.
pub(crate) fn pose_candidates(survey: &Survey) -> Vec<PoseCandidate<'_>> {
    let mut candidates: Vec<_> = survey.topics.iter().filter_map(of_topic).collect();
    mark_sparse(&mut candidates);
    candidates.extend(of_frames(survey));
    let rank = |of: &PoseCandidate<'_>| {
        let is_topic = matches!(of.source, PoseSource::Topic(_));
        (of.is_dense && Quality::OfOther < of.quality, of.quality, is_topic, of.n_samples)
    };
    // Stable: of equal topics, the first by name.
    candidates.sort_by_key(|of| std::cmp::Reverse(rank(of)));
    candidates
}

/// Whether a topic has ground truth by its name.
pub(crate) fn is_ground_truth(topic: &str) -> bool {
    let name = topic.to_lowercase();
    TRUTH.iter().any(|part| name.contains(part))
}

/// Whether a frame is one of odometry, by the last part of its name: `odom`, `robot1/odom`,
/// `odom_combined`, `vio_odom`.
pub(crate) fn is_odometry_frame(frame_id: &str) -> bool {
    last_part(frame_id).contains("odom")
}

/// Whether a frame is that of a map, by the last part of its name: `map`, `robot1/map`, `map_utm`.
fn is_map_frame(frame_id: &str) -> bool {
    let name = last_part(frame_id);
    name.split(['_', '-']).any(|word| MAPS.contains(&word)) && !name.contains("odom")
}

fn last_part(frame_id: &str) -> String {
    frame_id.rsplit('/').next().unwrap_or_default().to_lowercase()
}

fn of_topic(topic: &TopicSurvey) -> Option<PoseCandidate<'_>> {
    let Content::Poses(poses) = &topic.content else { return None };
    if poses.path_m <= 0.0 {
        return None;
    }
    let (quality, reason) = quality_of(topic);
    Some(PoseCandidate {
        source: PoseSource::Topic(topic),
        quality,
        reason,
        is_dense: true,
        n_samples: topic.n_messages,
    })
}

/// The quality of the poses of a topic, by its name, type and frame.
fn quality_of(topic: &TopicSurvey) -> (Quality, String) {
    let name = topic.topic.to_lowercase();
    let type_name = topic.schema.rsplit(['/', '.']).next().unwrap_or_default();
    let named = |parts: &[&str]| parts.iter().any(|part| name.contains(part));
    let frame = main_frame(topic);
    let in_frame = match frame {
        "" => "its messages name no frame".to_owned(),
        frame => format!("frame `{frame}`"),
    };
    if is_ground_truth(&name) {
        return (Quality::Truth, "ground truth by its name".to_owned());
    }
    let is_carried = CARRIED.iter().any(|part| last_part(frame).contains(part));
    if named(&OF_OTHER) || is_carried {
        return (Quality::OfOther, format!("{in_frame}; not the pose of the robot by its name"));
    }
    if type_name == "NavSatFix" || named(&["gps", "gnss"]) {
        return (Quality::Fixes, "satellite positions".to_owned());
    }
    let is_corrected = named(&CORRECTED);
    if is_odometry_frame(frame) || (name.contains("odom") && !is_map_frame(frame) && !is_corrected)
    {
        return (Quality::Drifting, format!("{in_frame}; odometry drifts"));
    }
    if is_map_frame(frame) {
        return (Quality::Map, in_frame);
    }
    if is_corrected {
        return (Quality::Map, "corrected poses by its name".to_owned());
    }
    let quality = if type_name == "Odometry" { Quality::Drifting } else { Quality::Unknown };
    (quality, in_frame)
}

/// The frame of most messages of a topic.
pub(crate) fn main_frame(topic: &TopicSurvey) -> &str {
    // Of equal numbers, the first by name.
    let most = topic.frames.iter().rev().max_by_key(|frame| frame.n_messages);
    most.map_or("", |frame| &frame.frame_id)
}

/// Spacing of the poses that are counted for the density \[m\]: the default of `subsample.spacing_m`.
const SPACING_M: f64 = 0.5;
/// A topic with fewer places than this share of another topic does not follow the robot. Corrected
/// poses often exist for a part of the scans only: for 60 % of the places in the Intel lab. Goals of a
/// drive are a few.
const MIN_SHARE_OF_PLACES: f64 = 0.1;

/// Marks the topics that have poses at few places.
fn mark_sparse(candidates: &mut [PoseCandidate<'_>]) {
    let n_places = |of: &PoseCandidate<'_>| match &of.source {
        PoseSource::Topic(TopicSurvey { content: Content::Poses(poses), .. }) => {
            n_places(poses.trajectory.poses())
        }
        _ => 0,
    };
    let most = candidates.iter().map(n_places).max().unwrap_or_default();
    for of in candidates {
        of.is_dense = most as f64 * MIN_SHARE_OF_PLACES <= n_places(of) as f64;
    }
}

/// Number of poses, each at least [`SPACING_M`] from the one before.
fn n_places(poses: &[StampedPose]) -> usize {
    let Some(mut last) = poses.first() else { return 0 };
    let mut n = 1;
    for pose in poses {
        if SPACING_M <= last.pose.distance_m(&pose.pose) {
            n += 1;
            last = pose;
        }
    }
    n
}

/// The poses from the transforms, if they connect a frame `map`, `world` or `odom` (REP 105) that has
/// no parent itself with a frame of the lidar, or with the base frame of the robot if there is none.
fn of_frames(survey: &Survey) -> Option<PoseCandidate<'_>> {
    struct Link {
        parent: String,
        child: String,
        is_constant: bool,
        n_samples: u64,
    }
    let bare = |frame: &str| frame.trim_start_matches('/').to_owned();
    let transforms = |topic: &'_ TopicSurvey| match &topic.content {
        Content::Transforms(transforms) => transforms.clone(),
        _ => Vec::new(),
    };
    let links: Vec<Link> = survey
        .topics
        .iter()
        .flat_map(transforms)
        .map(|of| Link {
            parent: bare(&of.parent),
            child: bare(&of.child),
            is_constant: of.is_constant,
            n_samples: of.n_samples,
        })
        .collect();
    let mut roots: Vec<&str> = links.iter().map(|link| &*link.parent).collect();
    roots.retain(|frame| links.iter().all(|link| link.child != *frame));
    let parent = (["map", "world", "odom"].into_iter())
        .find_map(|name| roots.iter().find(|frame| last_part(frame) == name))?;
    // The descendants of the parent in breadth-first order. Each has the number of its parent in the
    // list, and its link to it.
    let mut below: Vec<(&str, Option<(usize, &Link)>)> = vec![(parent, None)];
    let mut k = 0;
    while let Some(&(frame, _)) = below.get(k) {
        for link in links.iter().filter(|link| link.parent == frame) {
            if below.iter().all(|(known, _)| *known != link.child) {
                below.push((&link.child, Some((k, link))));
            }
        }
        k += 1;
    }
    let named = |names: &[&str]| {
        let has_name = |(frame, _): &(&str, _)| names.iter().any(|name| frame.contains(name));
        below.iter().skip(1).position(has_name).map(|k| k + 1)
    };
    let child = named(&["velodyne", "lidar", "laser"]).or_else(|| named(&["base_link", "base"]))?;
    let mut chain = Vec::new();
    let mut at = child;
    while let Some((before, link)) = below[at].1 {
        chain.push(link);
        at = before;
    }
    chain.reverse();
    if chain.iter().all(|link| link.is_constant) {
        return None;
    }
    // A map frame that never moves against the odometry corrects nothing.
    let moving = chain.iter().find(|link| !link.is_constant)?;
    let drifts = is_odometry_frame(&moving.parent);
    let (quality, reason) = match drifts {
        true => (Quality::Drifting, format!("frame `{}`; odometry drifts", moving.parent)),
        false => (Quality::Map, format!("transforms from frame `{parent}`")),
    };
    let has_transforms = |topic: &&TopicSurvey| !transforms(topic).is_empty();
    let topics = survey.topics.iter().filter(has_transforms).map(|topic| topic.topic.clone());
    let (parent, child) = ((*parent).to_owned(), below[child].0.to_owned());
    let source = PoseSource::Frames { parent, child, topics: topics.collect() };
    Some(PoseCandidate { source, quality, reason, is_dense: true, n_samples: moving.n_samples })
}

#[cfg(test)]
mod tests {
    use super::*;
    use dataset::{Pose2, Trajectory};
    use ingest::{FrameSurvey, PosesSurvey, TransformSurvey};

    fn topic(name: &str, schema: &str, content: Content) -> TopicSurvey {
        let (topic, schema, encoding) = (name.to_owned(), schema.to_owned(), "cdr".to_owned());
        let (n_messages, frames) = (9, Vec::new());
        let stamps = Default::default();
        TopicSurvey { topic, schema, encoding, n_messages, rate_hz: None, frames, stamps, content }
    }

    /// A topic with poses along `path_m` metres, one every half metre.
    fn poses(name: &str, type_name: &str, frame_id: &str, path_m: f64) -> TopicSurvey {
        let pose = |k: i64| Pose2 { x_m: 0.5 * k as f64, ..Pose2::default() };
        let n = (2.0 * path_m) as i64;
        let along = (0..=n).map(|k| StampedPose::new(k * 1_000_000_000, pose(k)));
        let (trajectory, _) = Trajectory::new(along.collect());
        let content = Content::Poses(PosesSurvey { path_m, trajectory, ..Default::default() });
        let frame = FrameSurvey {
            frame_id: frame_id.to_owned(),
            child_frame_id: String::new(),
            n_messages: n as u64,
        };
        let n_messages = n as u64;
        TopicSurvey { n_messages, frames: vec![frame], ..topic(name, type_name, content) }
    }

    /// The names of the sources, the best first. Frames are named by their parent.
    fn order(topics: Vec<TopicSurvey>) -> Vec<String> {
        let survey = Survey { topics, ..Survey::default() };
        let name = |of: PoseCandidate<'_>| match of.source {
            PoseSource::Topic(topic) => topic.topic.clone(),
            PoseSource::Frames { parent, child, .. } => format!("{parent} -> {child}"),
        };
        pose_candidates(&survey).into_iter().map(name).collect()
    }

    #[test]
    fn poses_that_do_not_drift_come_first_whatever_the_number_of_messages() {
        let order = order(vec![
            poses("/fix", "sensor_msgs/msg/NavSatFix", "gps", 90.0),
            poses("/goal_pose", "geometry_msgs/msg/PoseStamped", "map", 50.0),
            poses("/localization", "nav_msgs/msg/Odometry", "r1/map", 30.0),
            poses("/odom", "nav_msgs/msg/Odometry", "odom", 80.0),
            poses("/odometry/filtered", "nav_msgs/Odometry", "r1/odom", 70.0),
            poses("/pose", "geometry_msgs/msg/PoseStamped", "", 40.0),
            poses("/robot_pose_truth", "geometry_msgs/msg/PoseStamped", "odom", 20.0),
            poses("/wheel_odom", "nav_msgs/msg/Odometry", "", 60.0),
        ]);
        let expected = [
            "/robot_pose_truth",
            "/localization",
            "/pose",
            "/odom",
            "/odometry/filtered",
            "/wheel_odom",
            "/fix",
            "/goal_pose",
        ];
        assert_eq!(order, expected);
    }

    /// A tenth of the 900 m of the odometry is 90 m.
    #[test]
    fn a_topic_with_poses_at_few_places_is_the_last_choice() {
        let slam = |path_m| poses("/slam", "geometry_msgs/msg/PoseStamped", "map", path_m);
        let odometry = || poses("/odom", "nav_msgs/msg/Odometry", "odom", 900.0);
        assert_eq!(order(vec![odometry(), slam(91.0)]), ["/slam", "/odom"]);
        assert_eq!(order(vec![odometry(), slam(80.0)]), ["/odom", "/slam"]);
    }

    fn transform(parent: &str, child: &str, is_constant: bool) -> TransformSurvey {
        let (parent, child) = (parent.to_owned(), child.to_owned());
        TransformSurvey { parent, child, n_samples: 9, is_constant }
    }

    fn tf(name: &str, transforms: Vec<TransformSurvey>) -> TopicSurvey {
        topic(name, "tf2_msgs/msg/TFMessage", Content::Transforms(transforms))
    }

    #[test]
    fn frames_are_suggested_from_the_map_to_the_lidar() {
        let moving = || {
            tf("/tf", vec![transform("/map", "odom", false), transform("odom", "base_link", false)])
        };
        let fixed = || {
            tf(
                "/tf_static",
                vec![transform("base_link", "mast", true), transform("mast", "velodyne_top", true)],
            )
        };
        assert_eq!(order(vec![moving(), fixed()]), ["map -> velodyne_top"]);
        assert_eq!(order(vec![moving()]), ["map -> base_link"]);
        // Static transforms alone do not connect the robot to a map.
        assert!(order(vec![fixed()]).is_empty());
        // Transforms from a map are preferred to odometry, but not to a topic in the map.
        let odometry = || poses("/odom", "nav_msgs/msg/Odometry", "odom", 9.0);
        assert_eq!(order(vec![odometry(), moving()]), ["map -> base_link", "/odom"]);
        let in_map = poses("/pose", "geometry_msgs/msg/PoseStamped", "map", 9.0);
        assert_eq!(order(vec![in_map, moving()]), ["/pose", "map -> base_link"]);
    }

    #[test]
    fn a_map_frame_that_never_moves_against_the_odometry_is_no_better() {
        let links = vec![transform("map", "odom", true), transform("odom", "base_link", false)];
        let survey = Survey { topics: vec![tf("/tf", links)], ..Survey::default() };
        assert_eq!(pose_candidates(&survey)[0].quality, Quality::Drifting);
    }
}
