//! Absolute references of maps: satellite fixes and surveyed positions, through the whole program.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs;
use std::sync::Arc;

use dataset::tables::{read_closures, read_poses, read_trajectory};
use dataset::{MapPose, Pose2, SplitMix64, Trajectory};
use messages::{
    Encoding, MessageType, NavSatFix, Source, Transform, read_pose_and_covariance, ros,
};

use crate::detection::ODOMETRY;
use crate::support::{Workplace, loopboost};

const SIMULATE: &str = r#"
name = "days"
seed = 7
[simulate]
logs = ["day-1", "day-2"]
buildings = 1
length_m = 200.0
people = 2
"#;

fn pipeline(logs: &[&str], more: &str) -> String {
    let logs: Vec<String> = logs.iter().map(|log| format!("{log}.mcap")).collect();
    format!(
        "name = \"site\"\nseed = 7\n[ingest]\nsite = \"north\"\nlogs = {logs:?}\n{ODOMETRY}[train]\nlearners = []\n[evaluate]\ntruth = {{ topic = \"/ground_truth\" }}\n{more}"
    )
}

/// The origin of the true map frame on the earth.
const ORIGIN: [f64; 2] = [42.29, -83.71];
/// Metres per degree of latitude and longitude there (radii of curvature of WGS 84).
const METRES_PER_DEG: [f64; 2] = [111_068.0, 82_464.0];
/// The antenna on the robot.
const ANTENNA: Pose2 = Pose2 { x_m: -0.6, y_m: 0.4, heading_rad: 0.0 };
/// Each fix is off by about as much in each direction, with errors that last 30 s.
const FIX_STD_M: f64 = 0.3;

/// How the fixes of a topic are made of the true positions of the antenna.
struct Fixes {
    topic: &'static str,
    /// Moved east \[m\].
    east_m: f64,
    /// Whether north and east are exchanged.
    is_swapped: bool,
    /// Whether all fixes for 20 s are reflected to a place 30 m away.
    has_multipath: bool,
}

fn fixes(topic: &'static str) -> Fixes {
    Fixes { topic, east_m: 0.0, is_swapped: false, has_multipath: false }
}

fn gaussian(random: &mut SplitMix64) -> f64 {
    (0..12).map(|_| random.unit()).sum::<f64>() - 6.0
}

impl Fixes {
    /// A fix every 0.2 s.
    fn messages(&self, truth: &[(i64, Pose2)]) -> Vec<(&'static str, &'static str, i64, Vec<u8>)> {
        // Each day has errors of its own.
        let mut random = SplitMix64::new(truth[0].0 as u64);
        // The errors of two fixes have the correlation exp(-0.2 / 30).
        let decay = (-0.2f64 / 30.0).exp();
        let [mut north_m, mut east_m] = [0.0; 2].map(|_: f64| FIX_STD_M * gaussian(&mut random));
        let mut messages = Vec::new();
        for (k, (stamp_ns, robot)) in truth.iter().step_by(4).enumerate() {
            for error in [&mut north_m, &mut east_m] {
                let fresh = FIX_STD_M * (1.0 - decay * decay).sqrt();
                *error = decay * *error + fresh * gaussian(&mut random);
            }
            let at = *robot * ANTENNA;
            let mut position = [at.y_m + north_m, at.x_m + east_m + self.east_m];
            if self.has_multipath && (150..250).contains(&k) {
                position[0] += 30.0;
            }
            if self.is_swapped {
                position.reverse();
            }
            let [latitude_deg, longitude_deg] =
                std::array::from_fn(|k| ORIGIN[k] + position[k] / METRES_PER_DEG[k]);
            let mut covariance = [0.0; 9];
            for k in [0, 4, 8] {
                covariance[k] = FIX_STD_M * FIX_STD_M;
            }
            let fix = NavSatFix {
                stamp_ns: *stamp_ns,
                status: 0,
                latitude_deg,
                longitude_deg,
                altitude_m: 0.0,
                covariance,
            };
            let data = ros::write_nav_sat_fix(Encoding::Cdr, "gps", &fix);
            messages.push((self.topic, "sensor_msgs/msg/NavSatFix", *stamp_ns, data));
        }
        messages
    }
}

/// The true poses of the robot in a simulated log.
fn truth_of(log: &[u8]) -> Vec<(i64, Pose2)> {
    let mut truth = Vec::new();
    for message in mcap::MessageStream::new(log).unwrap() {
        let message = message.unwrap();
        if message.channel.topic == "/ground_truth" {
            let encoding = match &*message.channel.message_encoding {
                "cdr" => Encoding::Cdr,
                _ => Encoding::Ros1,
            };
            let source = Source { message_type: MessageType::PoseStamped, encoding };
            let (pose, _) = read_pose_and_covariance(source, &message.data).unwrap();
            let [_, _, z, w] = pose.orientation;
            let heading_rad = 2.0 * z.atan2(w);
            let [x_m, y_m, _] = pose.position;
            truth.push((pose.stamp_ns, Pose2 { x_m, y_m, heading_rad }));
        }
    }
    truth
}

/// Adds messages to a log: topic, type, stamp and data. The static transform of the antenna is one of them.
fn with_messages(log: &[u8], more: Vec<(&'static str, &'static str, i64, Vec<u8>)>) -> Vec<u8> {
    let mut writer = mcap::Writer::new(std::io::Cursor::new(Vec::new())).unwrap();
    for message in mcap::MessageStream::new(log).unwrap() {
        writer.write(&message.unwrap()).unwrap();
    }
    let mut channels: BTreeMap<&str, Arc<mcap::Channel<'_>>> = BTreeMap::new();
    for (topic, type_name, stamp_ns, data) in more {
        let id = 1000 + channels.len() as u16;
        let channel = channels.entry(topic).or_insert_with(|| {
            let schema = mcap::Schema {
                id,
                name: type_name.to_owned(),
                encoding: "ros2msg".to_owned(),
                data: Cow::Borrowed(b""),
            };
            Arc::new(mcap::Channel {
                id,
                topic: topic.to_owned(),
                schema: Some(Arc::new(schema)),
                message_encoding: "cdr".to_owned(),
                metadata: BTreeMap::new(),
            })
        });
        let (channel, stamp_ns) = (channel.clone(), stamp_ns as u64);
        let message = mcap::Message {
            channel,
            sequence: 0,
            log_time: stamp_ns,
            publish_time: stamp_ns,
            data: Cow::Owned(data),
        };
        writer.write(&message).unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

/// The simulated log with fixes on several topics, and the place of the antenna.
fn add_fixes(workplace: &Workplace, log: &str, topics: &[Fixes]) {
    let simulated = fs::read(workplace.path(&format!("sim/logs/{log}.mcap"))).unwrap();
    let truth = truth_of(&simulated);
    assert!(1000 < truth.len(), "{}", truth.len());
    let antenna = Transform {
        stamp_ns: truth[0].0,
        parent: "base_link".to_owned(),
        child: "gps".to_owned(),
        translation: [ANTENNA.x_m, ANTENNA.y_m, 1.2],
        rotation: [0.0, 0.0, 0.0, 1.0],
    };
    let data = ros::write_tf(Encoding::Cdr, &[antenna]);
    let mut more = vec![("/tf_static", "tf2_msgs/msg/TFMessage", truth[0].0, data)];
    more.extend(topics.iter().flat_map(|fixes| fixes.messages(&truth)));
    fs::write(workplace.path(&format!("{log}.mcap")), with_messages(&simulated, more)).unwrap();
}

fn two_days() -> Workplace {
    let workplace = Workplace::new(SIMULATE);
    workplace.command("simulate", "sim", &[]).expect(0);
    let multipath = |topic| Fixes { has_multipath: true, ..fixes(topic) };
    let swapped = Fixes { is_swapped: true, ..fixes("/gps/swapped") };
    add_fixes(&workplace, "day-1", &[multipath("/gps/fix"), fixes("/gps/home"), swapped]);
    let far = Fixes { east_m: 1000.0, ..fixes("/gps/far") };
    add_fixes(&workplace, "day-2", &[fixes("/gps/fix"), far]);
    workplace
}

fn keyframes(workplace: &Workplace, out: &str) -> Vec<MapPose> {
    read_trajectory(&workplace.path(&format!("{out}/trajectory.parquet"))).unwrap().0
}

fn truth(workplace: &Workplace, out: &str, log: &str) -> Trajectory {
    read_poses(&workplace.path(&format!("{out}/truth/{log}.parquet"))).unwrap().0
}

/// The mean and the largest distance of the keyframes of a log from the truth, which is moved east \[m\]. They are not
/// aligned.
fn errors_m(workplace: &Workplace, out: &str, log: &str, east_m: f64) -> (f64, f64) {
    let truth = truth(workplace, out, log);
    let of_log = keyframes(workplace, out);
    let of_log = of_log.iter().filter(|keyframe| *keyframe.id.log == *log);
    let errors: Vec<f64> = of_log
        .filter_map(|keyframe| {
            let known = truth.pose_at(keyframe.stamp_ns, 100_000_000).ok()?;
            Some(Pose2 { x_m: known.x_m + east_m, ..known }.distance_m(&keyframe.pose))
        })
        .collect();
    assert!(100 < errors.len(), "{}", errors.len());
    let largest = errors.iter().copied().fold(0.0, f64::max);
    (errors.iter().sum::<f64>() / errors.len() as f64, largest)
}

/// Accepted and rejected closures between the days, with the reasons of the latter.
fn between(workplace: &Workplace, out: &str) -> (usize, BTreeMap<String, usize>) {
    let path = workplace.path(&format!("{out}/closures.parquet"));
    let (mut n_accepted, mut rejected) = (0, BTreeMap::new());
    for judged in read_closures(&path).unwrap().0 {
        if judged.closure.query.log != judged.closure.reference.log {
            match judged.rejected {
                None => n_accepted += 1,
                Some(reason) => *rejected.entry(reason).or_default() += 1,
            }
        }
    }
    (n_accepted, rejected)
}

const ORIGIN_SET: &str =
    "optimize.origin={ latitude_deg = 42.29, longitude_deg = -83.71, altitude_m = 0.0 }";

fn note(workplace: &Workplace, out: &str, code: &str) -> serde_json::Value {
    let text = fs::read_to_string(workplace.path(&format!("{out}/run.json"))).unwrap();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    let notes = json["tasks"]["optimize"]["notes"].as_array().unwrap();
    let is_code = |note: &&serde_json::Value| note.to_string().contains(code);
    notes.iter().find(is_code).unwrap_or_else(|| panic!("no {code} in {notes:?}")).clone()
}

#[test]
fn references_place_maps_and_tell_equal_places_apart() {
    let workplace = two_days();
    let both = pipeline(&["day-1", "day-2"], "[detect]\n[optimize]\nevery_scan = false\n");
    fs::write(workplace.path("drive.toml"), both).unwrap();
    let run = |command: &str, references: &str| {
        let references = format!("optimize.references={references}");
        workplace.command(command, "out", &["--set", &references, "--set", ORIGIN_SET])
    };

    // Both days are in the frame of the fixes, which is that of the truth. Those that are reflected are left out.
    let made = run("run", r#"[{ topic = "/gps/fix" }]"#).expect(3).says(&[
        "info[map_georeferenced]",
        "x east and y north of latitude 42.29 deg, longitude -83.71 deg, altitude 0 m",
        "info[references_used]",
    ]);
    assert!(made.stdout.contains("day-1: "), "{}", made.stdout);
    assert!(made.stdout.contains("references of /gps/fix agree"), "{}", made.stdout);
    assert!(!made.stderr.contains("reference_point_unknown"), "{}", made.stderr);
    assert!(!made.stderr.contains("error["), "{}", made.stderr);
    for day in ["day-1", "day-2"] {
        let (mean_m, largest_m) = errors_m(&workplace, "out", day, 0.0);
        assert!(mean_m < 0.7 && largest_m < 1.2, "{day}: {mean_m} {largest_m}");
    }
    let used = note(&workplace, "out", "references_used");
    let text = used.to_string();
    let (_, rest) = text.split_once("\"n_outliers\":").unwrap();
    // 100 are reflected; 1 % of the others are beyond the limit by chance.
    let digits: String = rest.chars().take_while(char::is_ascii_digit).collect();
    let n_outliers: u64 = digits.parse().unwrap();
    assert!((90..130).contains(&n_outliers), "{used}");
    let (n_joined, _) = between(&workplace, "out");
    assert!(100 < n_joined, "{n_joined}");
    let report = fs::read_to_string(workplace.path("out/report.html")).unwrap();
    assert!(report.contains("references_used"), "the report has the residuals");

    // The same building at a place 1 km away: nothing joins the days, and they are in one frame.
    let apart = r#"[{ topic = "/gps/home" }, { topic = "/gps/far" }]"#;
    run("optimize", apart).expect(3).says(&[
        "info[maps_linked_by_references]",
        "day-1 | day-2",
        "warning[closures_far_by_references]",
        "warning[log_without_references]",
    ]);
    let (n_accepted, rejected) = between(&workplace, "out");
    assert_eq!(n_accepted, 0);
    assert!(10 < rejected["far_by_references"], "{rejected:?}");
    assert!(keyframes(&workplace, "out").iter().all(|keyframe| keyframe.map == 0));
    let (mean_m, _) = errors_m(&workplace, "out", "day-2", 1000.0);
    assert!(mean_m < 1.0, "{mean_m}");

    // North and east are exchanged: the map stays in the frame of the odometry.
    let swapped = run("optimize", r#"[{ topic = "/gps/swapped" }]"#).expect(3);
    let swapped = swapped.says(&["error[references_contradict]", "use x east and y north"]);
    assert!(!swapped.stderr.contains("map_georeferenced"), "{}", swapped.stderr);
    assert!(keyframes(&workplace, "out")[0].pose.distance_m(&Pose2::default()) < 1.0);
    check_surveyed(&workplace);
}

/// Two surveyed positions decide, one does not, and a pose without a standard deviation is refused.
fn check_surveyed(workplace: &Workplace) {
    let run = |references: &str| {
        let references = format!("optimize.references={references}");
        workplace.command("optimize", "out", &["--set", &references])
    };
    let truth = truth(workplace, "out", "day-1");
    let poses = truth.poses();
    let farthest = |a: &&dataset::StampedPose, b: &&dataset::StampedPose| {
        let distance_m = |pose: &dataset::StampedPose| poses[100].pose.distance_m(&pose.pose);
        distance_m(a).total_cmp(&distance_m(b))
    };
    let far = poses[100..poses.len() - 100].iter().max_by(farthest).unwrap();
    let row = |at: &dataset::StampedPose| {
        format!("day-1,{},{},{},0.02\n", at.stamp_ns, at.pose.x_m, at.pose.y_m)
    };
    let header = "log,stamp_ns,x_m,y_m,std_m\n";
    let surveyed = workplace.path("survey.csv");
    fs::write(&surveyed, format!("{header}{}{}", row(&poses[100]), row(far))).unwrap();
    run(r#"[{ file = "survey.csv" }]"#).expect(3).says(&["that of the surveyed poses"]);
    for day in ["day-1", "day-2"] {
        let (_, largest_m) = errors_m(workplace, "out", day, 0.0);
        assert!(largest_m < 0.5, "{day}: {largest_m}");
    }
    fs::write(&surveyed, format!("{header}{}", row(&poses[100]))).unwrap();
    let one = run(r#"[{ file = "survey.csv" }]"#).expect(3);
    one.says(&["warning[references_do_not_decide]", "positions at one place"]);
    fs::write(&surveyed, format!("{header}day-1,5,1.0,2.0,x\n")).unwrap();
    run(r#"[{ file = "survey.csv" }]"#).expect(1).says(&["survey.csv:2: `std_m` is `x`"]);
    run(r#"[{ topic = "/ground_truth" }]"#).expect(2).says(&["set `std_m` in its entry"]);
    run(r#"[{ topic = "/ground_truth", std_m = 0.1, std_deg = 1.0 }]"#).expect(3);
    let (_, largest_m) = errors_m(workplace, "out", "day-1", 0.0);
    assert!(largest_m < 0.2, "{largest_m}");
    run("[{ topic = \"/a\", file = \"b\" }]").expect(2).says(&["both `topic` and `file`"]);
}

/// The frame of an earlier map is that of drives that are added to it, with or without fixes of their own.
#[test]
fn a_drive_added_to_a_map_is_in_its_frame() {
    let workplace = two_days();
    let references = "[optimize]\nevery_scan = false\nreferences = [{ topic = \"/gps/fix\" }]\n";
    let write = |name: &str, log: &str, more: &str| {
        fs::write(workplace.path(name), pipeline(&[log], &format!("{more}{references}"))).unwrap();
    };
    let run = |pipeline: &str, out: &str, more: &[&str]| {
        let args = [workplace.path(pipeline), workplace.path(out)];
        let [file, folder] = args.map(|path| path.to_str().unwrap().to_owned());
        loopboost(&[&["run", &file, "--out", &folder], more].concat())
    };
    write("first.toml", "day-1", "[detect]\n");
    run("first.toml", "first", &[]).expect(3).says(&["info[map_georeferenced]"]);
    write("second.toml", "day-2", "[detect]\nmaps = [\"first\"]\n");
    run("second.toml", "second", &[]).expect(3).says(&["info[map_georeferenced]"]);
    let [first, second] = ["first", "second"].map(|out| note(&workplace, out, "map_georeferenced"));
    let origin = |note: &serde_json::Value| {
        let text = note.to_string();
        let at = text.find("latitude_deg").unwrap();
        text[at..].chars().take_while(|c| *c != ',').collect::<String>()
    };
    assert_eq!(origin(&first), origin(&second));
    assert!(100 < between(&workplace, "second").0);
    // The origin is the first fix, and both days are moved by as much.
    let moved = |out: &str, log: &str| {
        let truth = truth(&workplace, out, log);
        let keyframe = &keyframes(&workplace, out)[50];
        let known = truth.pose_at(keyframe.stamp_ns, 100_000_000).unwrap();
        [keyframe.pose.x_m - known.x_m, keyframe.pose.y_m - known.y_m]
    };
    let [a, b] = [moved("first", "day-1"), moved("second", "day-2")];
    assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 1.0, "{a:?} {b:?}");
    let other = "optimize.origin={ latitude_deg = 42.0, longitude_deg = -83.0 }";
    run("second.toml", "second", &["--set", other]).expect(2).says(&["remove `optimize.origin`"]);
}
