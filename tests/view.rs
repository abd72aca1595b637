//! `view`: the overlay for Foxglove and the map for `map_server`, of a simulated drive.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::BufReader;
use std::path::Path;
use std::process::Command;

use dataset::tables::{
    read_closures, read_poses, read_registered, read_trajectory, write_closures,
};
use dataset::{JudgedClosure, Pose2, ScanId};
use messages::{Source, read_point_cloud, read_transforms};
use serde_json::Value;
use simulate::{Campus, Point, SENSOR_HEIGHT_M, Segment};

use crate::detection::{new_drive, run_stages};
use crate::require::{mcap_command, python_with};
use crate::simulation::check_with_doctor;
use crate::support::{Workplace, loopboost, loopboost_with_threads, root};

/// A message of an overlay.
struct Message {
    topic: String,
    schema: String,
    stamp_ns: u64,
    bytes: Vec<u8>,
}

impl Message {
    fn json(&self) -> Value {
        serde_json::from_slice(&self.bytes).unwrap()
    }

    fn source(&self) -> Source {
        Source::new(&self.schema, "json").unwrap()
    }
}

/// The messages of an overlay. Each contains the fields that its JSON Schema requires.
fn messages(path: &Path) -> Vec<Message> {
    let bytes = fs::read(path).unwrap();
    let mut found = Vec::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let schema = message.channel.schema.clone().unwrap();
        assert_eq!((&*schema.encoding, &*message.channel.message_encoding), ("jsonschema", "json"));
        let message = Message {
            topic: message.channel.topic.clone(),
            schema: schema.name.clone(),
            stamp_ns: message.log_time,
            bytes: message.data.to_vec(),
        };
        check_fields(&serde_json::from_slice(&schema.data).unwrap(), &message.json());
        found.push(message);
    }
    assert!(found.is_sorted_by_key(|message| message.stamp_ns));
    found
}

/// Checks types and required fields of a value.
fn check_fields(schema: &Value, value: &Value) {
    let is_right = match schema["type"].as_str().unwrap() {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "boolean" => value.is_boolean(),
        "integer" => value.is_i64(),
        "number" => value.is_number(),
        other => panic!("unknown type {other}"),
    };
    assert!(is_right, "{value} is not of {schema}");
    for item in value.as_array().into_iter().flatten() {
        check_fields(&schema["items"], item);
    }
    for name in schema["required"].as_array().into_iter().flatten() {
        let name = name.as_str().unwrap();
        check_fields(&schema["properties"][name], &value[name]);
    }
}

/// A line of a scene.
struct Entity {
    points_m: Vec<[f64; 2]>,
    metadata: BTreeMap<String, String>,
}

/// The entities of a topic by id.
fn entities(messages: &[Message], topic: &str) -> BTreeMap<String, Entity> {
    let mut found = BTreeMap::new();
    for message in messages.iter().filter(|message| message.topic == topic) {
        assert_eq!(message.schema, "foxglove.SceneUpdate");
        for entity in message.json()["entities"].as_array().unwrap() {
            let number = |value: &Value| value.as_f64().unwrap();
            let points = entity["lines"][0]["points"].as_array().unwrap();
            let points_m = points.iter().map(|p| [number(&p["x"]), number(&p["y"])]).collect();
            let text = |value: &Value| value.as_str().unwrap().to_owned();
            let metadata = entity["metadata"].as_array().unwrap();
            let metadata = metadata.iter().map(|m| (text(&m["key"]), text(&m["value"]))).collect();
            let id = text(&entity["id"]);
            let entity = Entity { points_m, metadata };
            assert!(found.insert(id.clone(), entity).is_none(), "two entities {id}");
        }
    }
    found
}

/// Every closure has a line between the optimized poses of its keyframes, on the topic that it belongs
/// to, with its reason.
fn check_closures(run: &Path, messages: &[Message]) {
    let (closures, _) = read_closures(&run.join("closures.parquet")).unwrap();
    let (keyframes, _) = read_trajectory(&run.join("trajectory.parquet")).unwrap();
    let poses: BTreeMap<&ScanId, &Pose2> = keyframes.iter().map(|k| (&k.id, &k.pose)).collect();
    let mut topics = ["accepted", "rejected"]
        .map(|topic| entities(messages, &format!("/loopboost/closures/{topic}")));
    let n_accepted = closures.iter().filter(|closure| closure.is_accepted()).count();
    assert_eq!(topics.each_ref().map(BTreeMap::len), [n_accepted, closures.len() - n_accepted]);
    assert!(0 < n_accepted && n_accepted < closures.len());
    for (row, JudgedClosure { closure, rejected }) in closures.iter().enumerate() {
        let topic = usize::from(rejected.is_some());
        let Entity { points_m, metadata } =
            topics[topic].remove(&format!("closure {row}")).unwrap();
        let ends = [&closure.query, &closure.reference].map(|id| [poses[id].x_m, poses[id].y_m]);
        assert_eq!(points_m, ends);
        assert_eq!(metadata.get("reason"), rejected.as_ref());
        assert_eq!(metadata["confidence"], closure.confidence.to_string());
    }
    let ellipses = entities(messages, "/loopboost/covariances");
    assert_eq!(ellipses.len(), keyframes.len());
    for keyframe in &keyframes {
        let id = format!("{}, scan {}", keyframe.id.log, keyframe.id.scan);
        let [xx, xy, _, yy, ..] = keyframe.covariance.unwrap();
        for [x, y] in ellipses[&id].points_m.iter().filter(|_| 0.0 < xx) {
            // The squared Mahalanobis distance of each point: d^T C^-1 d.
            let (dx, dy) = (x - keyframe.pose.x_m, y - keyframe.pose.y_m);
            let squared = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy);
            assert!((squared - 5.991).abs() < 1e-3, "{id}: {squared}");
        }
    }
}

/// The transforms, trajectories and submaps.
fn check_poses(run: &Path, log: &str, lidar_frame: &str, messages: &[Message]) {
    let (poses, _) = read_poses(&run.join(format!("trajectory/{log}.parquet"))).unwrap();
    let poses = poses.poses();
    let of = |topic: &str| {
        let topic = format!("/loopboost/{topic}");
        messages.iter().filter(move |message| message.topic == topic)
    };
    assert_eq!(of("tf").count(), poses.len());
    for (message, pose) in of("tf").zip(poses) {
        let [transform] = &read_transforms(message.source(), &message.bytes).unwrap()[..] else {
            panic!("one transform per message")
        };
        assert_eq!((transform.stamp_ns, message.stamp_ns as i64), (pose.stamp_ns, pose.stamp_ns));
        assert_eq!((&*transform.parent, &*transform.child), ("loopboost_map_0", lidar_frame));
        assert_eq!(transform.translation, [pose.pose.x_m, pose.pose.y_m, 0.0]);
        let [_, _, z, w] = transform.rotation;
        let turned_rad = dataset::wrap_angle(2.0 * z.atan2(w) - pose.pose.heading_rad);
        assert!(turned_rad.abs() < 1e-12);
    }

    let (registered, _) = read_registered(&run.join(format!("registered/{log}.parquet"))).unwrap();
    for (topic, n) in [
        ("odometry", registered.len()),
        ("scan_matching", registered.len()),
        ("optimized", poses.len()),
    ] {
        let found: Vec<Value> = of(&format!("trajectory/{topic}")).map(Message::json).collect();
        assert_eq!(found.len(), 1);
        let found = found[0]["poses"].as_array().unwrap();
        assert_eq!(found.len(), n, "{topic}");
        let start = &found[0]["position"];
        let first = poses[0].pose;
        let position = Pose2 {
            x_m: start["x"].as_f64().unwrap(),
            y_m: start["y"].as_f64().unwrap(),
            heading_rad: 0.0,
        };
        assert!(position.distance_m(&first) < 1e-9, "{topic} starts at the first optimized pose");
    }

    let stamps: BTreeSet<i64> = registered.iter().map(|row| row.stamp_ns).collect();
    let clouds: Vec<_> =
        of("submaps").map(|m| read_point_cloud(m.source(), &m.bytes).unwrap()).collect();
    // A submap for every 5 m of 330 m.
    assert!((60..=72).contains(&clouds.len()), "{} submaps", clouds.len());
    for cloud in &clouds {
        assert!(stamps.contains(&cloud.stamp_ns) && 50 < cloud.width, "{} points", cloud.width);
    }
}

/// A map as `map_server` reads it.
struct MapImage {
    resolution_m: f64,
    origin_m: [f64; 2],
    width: usize,
    pixels: Vec<u8>,
}

impl MapImage {
    fn load(yaml: &Path) -> Self {
        let text = fs::read_to_string(yaml).unwrap();
        let values: BTreeMap<&str, &str> =
            text.lines().map(|line| line.split_once(": ").unwrap()).collect();
        let expected = [
            ("mode", "trinary"),
            ("negate", "0"),
            ("occupied_thresh", "0.65"),
            ("free_thresh", "0.196"),
        ];
        assert!(expected.iter().all(|(key, value)| values[key] == *value), "{text}");
        let origin = values["origin"].trim_start_matches('[').trim_end_matches(']');
        let origin: Vec<f64> = origin.split(", ").map(|v| v.parse().unwrap()).collect();
        assert_eq!((origin.len(), origin[2]), (3, 0.0));
        let file = fs::File::open(yaml.with_file_name(values["image"])).unwrap();
        let mut reader = png::Decoder::new(BufReader::new(file)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        assert_eq!(info.color_type, png::ColorType::Grayscale);
        Self {
            resolution_m: values["resolution"].parse().unwrap(),
            origin_m: [origin[0], origin[1]],
            width: info.width as usize,
            pixels,
        }
    }

    /// The centre of a pixel. The first row has the largest y.
    fn centre(&self, pixel: usize) -> Pose2 {
        let row = self.pixels.len() / self.width - 1 - pixel / self.width;
        let along =
            |k: usize, axis: usize| self.origin_m[axis] + (k as f64 + 0.5) * self.resolution_m;
        Pose2 { x_m: along(pixel % self.width, 0), y_m: along(row, 1), heading_rad: 0.0 }
    }

    fn at(&self, pose: &Pose2) -> u8 {
        let square = |v: f64, axis: usize| ((v - self.origin_m[axis]) / self.resolution_m) as usize;
        let row = self.pixels.len() / self.width - 1 - square(pose.y_m, 1);
        self.pixels[row * self.width + square(pose.x_m, 0)]
    }
}

/// Compares the map with the simulator. The map frame starts at the first pose, so the trajectory is laid
/// over the true poses first.
fn check_map(pipeline: &str, run: &Path, yaml: &Path) {
    let pipeline: toml::Table = pipeline.parse().unwrap();
    let options = pipeline["simulate"].clone().try_into().unwrap();
    let seed = pipeline["seed"].as_integer().unwrap() as u64;
    let campus = Campus::new(&options, seed).unwrap();
    let drive = campus.drive(0);
    let (keyframes, _) = read_trajectory(&run.join("trajectory.parquet")).unwrap();
    let found: Vec<Pose2> = keyframes.iter().map(|k| k.pose).collect();
    let truth: Vec<Pose2> = keyframes.iter().map(|k| drive.pose_at(k.stamp_ns)).collect();
    let truth_from_map = evaluate::detection::align(&truth, &found).unwrap().truth_from_estimate;

    let map = MapImage::load(yaml);
    assert_eq!(map.resolution_m, 0.05);
    let n_free = found.iter().filter(|pose| map.at(pose) == 254).count();
    println!("{n_free} of {} keyframes are in free space", found.len());
    assert!(0.99 * found.len() as f64 <= n_free as f64);

    let walls: Vec<Segment> = drive
        .surfaces()
        .iter()
        .filter(|s| s.z_low_m <= SENSOR_HEIGHT_M && SENSOR_HEIGHT_M <= s.z_high_m)
        .map(|surface| surface.segment)
        .collect();
    let occupied = (0..map.pixels.len()).filter(|&pixel| map.pixels[pixel] == 0);
    let mut distances_m: Vec<f64> = occupied
        .map(|pixel| {
            let Pose2 { x_m, y_m, .. } = truth_from_map * map.centre(pixel);
            let to_walls = walls.iter().map(|wall| wall.distance_m(Point::new(x_m, y_m)));
            to_walls.fold(f64::INFINITY, f64::min)
        })
        .collect();
    distances_m.sort_by(f64::total_cmp);
    let n = distances_m.len();
    let mean_m = distances_m.iter().sum::<f64>() / n as f64;
    println!(
        "{n} occupied squares: mean distance to the walls {mean_m:.3} m, median {:.3} m, 99 % {:.3} m",
        distances_m[n / 2],
        distances_m[n * 99 / 100]
    );
    // 330 m of corridor with walls on both sides: 13,200 squares of 0.05 m without doors and rooms.
    assert!(10_000 < n && mean_m < 0.1, "{n} occupied squares, {mean_m} m from the walls");
}

#[test]
fn the_overlay_and_the_map_show_what_the_tables_contain() {
    let workplace = Workplace::new(&new_drive());
    run_stages(&workplace, "out", 2);
    let run = workplace.path("out");
    let view = |out: &str, threads| {
        let (run, out) = (run.to_str().unwrap(), workplace.path(out));
        let args = ["view", run, "--out", out.to_str().unwrap(), "--lidar-frame", "velodyne"];
        loopboost_with_threads(&args, threads).expect(0);
    };
    view("view", 1);
    let files = workplace.files("view");
    let names: Vec<&str> = files.keys().map(String::as_str).collect();
    assert_eq!(names, ["friday/layout.json", "friday/overlay.mcap", "map_0.png", "map_0.yaml"]);
    view("again", 8);
    assert!(files == workplace.files("again"), "the bytes depend on the number of threads");

    let overlay = workplace.path("view/friday/overlay.mcap");
    let found = messages(&overlay);
    check_closures(&run, &found);
    check_poses(&run, "friday", "velodyne", &found);
    let layout: Value = serde_json::from_slice(&files["friday/layout.json"]).unwrap();
    let panel = &layout["configById"][layout["layout"].as_str().unwrap()];
    assert_eq!(panel["followTf"], "loopboost_map_0");
    let topics: BTreeSet<&str> = found.iter().map(|message| &*message.topic).collect();
    for topic in panel["topics"].as_object().unwrap().keys() {
        assert!(topics.contains(&**topic), "the layout shows {topic}, which is not in the overlay");
    }
    let page = fs::read_to_string(root().join("docs/viewing.md")).unwrap();
    for topic in topics {
        assert!(page.contains(&format!("| `{topic}` |")), "docs/viewing.md does not list {topic}");
    }
    check_map(&new_drive(), &run, &workplace.path("view/map_0.yaml"));

    if let Some(mcap) = mcap_command() {
        check_with_doctor(&mcap, &overlay);
    }
    check_with_foxglove_schemas(&run, &workplace.path("view"));
}

/// Foxglove's schemas for Python read the overlay back. They find every closure of the table and no other, so
/// the check fails for a table with one closure less, with one more, or with another reason.
fn check_with_foxglove_schemas(run: &Path, view: &Path) {
    let modules = ["mcap", "foxglove_schemas_protobuf", "pyarrow"];
    let Some(python) = python_with(&modules) else { return };
    let check = || {
        let script = root().join("tests/peers/overlay.py");
        let output = Command::new(&python).arg("-B").arg(script).args([run, view]).output();
        let output = output.unwrap();
        let printed = [output.stdout, output.stderr].concat();
        (output.status.success(), String::from_utf8(printed).unwrap())
    };
    let (is_right, printed) = check();
    assert!(is_right, "{printed}");
    println!("{printed}");
    let path = run.join("closures.parquet");
    let (closures, provenance) = read_closures(&path).unwrap();
    let n = closures.len();
    let mut other_reason = closures.clone();
    let rejected = other_reason.iter_mut().find_map(|closure| closure.rejected.as_mut()).unwrap();
    rejected.push_str("_now");
    let one_more = [&closures[..], &closures[n - 1..]].concat();
    for (rows, fault) in [
        (&closures[..n - 1], "lines that are not in closures.parquet".to_owned()),
        (&one_more[..], format!("no line for row {n} of closures.parquet")),
        (&other_reason[..], "_now".to_owned()),
    ] {
        write_closures(&path, &provenance, rows).unwrap();
        let (is_right, printed) = check();
        assert!(!is_right && printed.contains(&fault), "{printed}");
    }
}

#[test]
fn a_folder_without_closures_is_an_error_that_names_the_command() {
    let workplace = Workplace::new("");
    let (run, out) = (workplace.path("run"), workplace.path("view"));
    loopboost(&["view", run.to_str().unwrap(), "--out", out.to_str().unwrap()])
        .expect(1)
        .says(&["closures.parquet does not exist", "loopboost optimize"]);
    assert!(!out.exists());
}
