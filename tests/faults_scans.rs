//! Faults of scans: stamps, frames and angles. The exit code and the message name the cause.

use std::f64::consts::PI;
use std::fs;

use crate::made::{Message, Schema, log};
use crate::support::{Finished, Workplace, loopboost};
use crate::wire::{Encoding, RosMessage};

const START_NS: i64 = 1_700_000_000_000_000_000;

const PIPELINE: &str = r#"
[ingest]
logs = ["drive.mcap"]
pose.topic = "/pose"
lidar.topic = "/scan"
"#;

/// What differs from a healthy scan.
#[derive(Clone, Copy)]
struct Fault {
    /// Header stamp of scan `k` at a time \[ns\].
    stamp_ns: fn(usize, i64) -> i64,
    frame: fn(usize) -> &'static str,
    /// The stated angle of the last beam \[rad\].
    angle_max: f32,
}

const INCREMENT: f32 = (PI / 30.0) as f32;

const HEALTHY: Fault = Fault {
    stamp_ns: |_, at_ns| at_ns,
    frame: |_| "laser",
    angle_max: -PI as f32 + 59.0 * INCREMENT,
};

/// A scan and a pose every 0.1 s, recorded when they are measured.
fn drive(fault: Fault, encoding: Encoding) -> Workplace {
    let header = |stamp_ns, frame: &str| {
        let message = RosMessage::new(encoding);
        let message = if encoding == Encoding::Ros1 { message.u32(0) } else { message };
        message.time(stamp_ns).string(frame)
    };
    let messages = (0..80).flat_map(|k| {
        let at_ns = START_NS + k as i64 * 100_000_000;
        let x_m = 0.1 * k as f64;
        let pose = header(at_ns, "map").f64s(&[x_m, 0.0, 0.0]).f64s(&[0.0, 0.0, 0.0, 1.0]);
        let ranges: Vec<f32> = (0..60).map(|beam| 4.0 + ((beam * 7 + k) % 11) as f32).collect();
        let scan = header((fault.stamp_ns)(k, at_ns), (fault.frame)(k))
            .f32(-PI as f32)
            .f32(fault.angle_max)
            .f32(INCREMENT)
            .f32(0.0)
            .f32(0.1)
            .f32(0.1)
            .f32(60.0)
            .f32_sequence(&ranges)
            .f32_sequence(&[]);
        let message =
            |topic, type_name, data| Message { topic, type_name, encoding, stamp_ns: at_ns, data };
        [
            message("/pose", "geometry_msgs/PoseStamped", pose.finish()),
            message("/scan", "sensor_msgs/LaserScan", scan.finish()),
        ]
    });
    let workplace = Workplace::new(PIPELINE);
    let bytes = log(&messages.collect::<Vec<_>>(), Schema::Empty);
    fs::write(workplace.path("drive.mcap"), bytes).unwrap();
    workplace
}

fn ingest(workplace: &Workplace, options: &[&str]) -> Finished {
    let args: Vec<&str> = options.iter().flat_map(|option| ["--set", *option]).collect();
    workplace.command("ingest", "out", &args)
}

fn inspect(workplace: &Workplace) -> Finished {
    loopboost(&["inspect", workplace.path("drive.mcap").to_str().unwrap()])
}

#[test]
fn a_healthy_log_has_no_warning_and_inspect_shows_frames_and_delays() {
    for encoding in [Encoding::Cdr, Encoding::Ros1] {
        let workplace = drive(HEALTHY, encoding);
        ingest(&workplace, &[]).expect(0);
        let finished = inspect(&workplace);
        for line in
            ["frame `map`\n  stamped 0.000 s before", "frame `laser`\n  stamped 0.000 s before"]
        {
            assert!(finished.stdout.contains(line), "{}", finished.stdout);
        }
    }
}

#[test]
fn missing_stamps_are_refused_and_inspect_suggests_log_times() {
    for encoding in [Encoding::Cdr, Encoding::Ros1] {
        let workplace = drive(Fault { stamp_ns: |_, _| 0, ..HEALTHY }, encoding);
        ingest(&workplace, &[]).expect(1).says(&[
            "all 80 messages of topic `/scan` have the stamp 0 ns",
            "set `ingest.lidar.stamp = \"log\"`",
        ]);
        let by_log = ingest(&workplace, &["ingest.lidar.stamp=log"]).expect(0);
        assert!(by_log.stdout.contains("80 scans"), "{}", by_log.stdout);
        let finished = inspect(&workplace).expect(3);
        let stdout = finished.stdout.clone();
        finished.says(&[
            "warning[option_needed]: the suggested pipeline sets `ingest.lidar.stamp = \"log\"`",
        ]);
        assert!(stdout.contains("80 of 80 stamps are 0"), "{stdout}");
        assert!(stdout.contains("stamp = \"log\""), "{stdout}");
    }
}

#[test]
fn a_clock_that_is_set_back_gives_a_warning() {
    let stamp_ns = |k, at_ns| if k < 40 { at_ns } else { at_ns - 3_000_000_000 };
    let workplace = drive(Fault { stamp_ns, ..HEALTHY }, Encoding::Cdr);
    let texts = ["warning[stamps_step_back]", "by up to 3.00 s, once", "topic `/scan`"];
    ingest(&workplace, &[]).expect(3).says(&texts);
    inspect(&workplace).expect(3).says(&texts);
}

#[test]
fn one_of_two_frames_is_suggested_and_must_be_selected() {
    let frame = |k| if k % 4 == 0 { "rear" } else { "front" };
    let workplace = drive(Fault { frame, ..HEALTHY }, Encoding::Cdr);
    let frames = ["`front` (60 messages), `rear` (20 messages)", "`ingest.lidar.frame_id`"];
    ingest(&workplace, &[]).expect(1).says(&frames);
    let finished = ingest(&workplace, &["ingest.lidar.frame_id=rear"]).expect(0);
    assert!(finished.stdout.contains("20 scans"), "{}", finished.stdout);
    let finished = inspect(&workplace).expect(3);
    let stdout = finished.stdout.clone();
    finished.says(&[
        "warning[option_needed]: the suggested pipeline sets `ingest.lidar.frame_id = \"front\"`",
    ]);
    for line in [
        "frame `front` (60 messages); frame `rear` (20 messages)",
        "frame_id = \"front\"   # the topic also has `rear` (20 messages)",
    ] {
        assert!(stdout.contains(line), "{stdout}");
    }
}

#[test]
fn contradictory_angles_are_refused_with_their_numbers() {
    let workplace = drive(Fault { angle_max: 0.5, ..HEALTHY }, Encoding::Cdr);
    let texts = ["80 planar scans with contradictory angles", "angle_max is 28.65 deg"];
    ingest(&workplace, &[]).expect(1).says(&texts);
    inspect(&workplace).expect(3).says(&texts);
}
