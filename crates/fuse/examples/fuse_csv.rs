//! Fuses wheel and IMU samples from CSV files and prints the path as CSV.
//!
//! `cargo run --release -p fuse --example fuse_csv -- WHEELS.csv IMU.csv track_m=0.5 [KEY=VALUE..]`
//!
//! Columns of WHEELS.csv: stamp [ns], left and right speed [m/s]. Columns of IMU.csv: stamp [ns], yaw
//! rate [rad/s] and optionally heading [rad]. Columns of the path: stamp [ns], x, y [m], heading
//! [rad], and the upper triangle of their covariance. The report is printed to stderr. With `none`
//! instead of IMU.csv, the result is plain wheel odometry.

#![allow(clippy::print_stdout, reason = "an example prints its results")]

use std::collections::BTreeMap;
use std::error::Error;

use fuse::{ImuSample, Options, WheelSample, fuse};

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [wheels, imu, settings @ ..] = &args[..] else {
        return Err("expected WHEELS.csv IMU.csv track_m=0.5 [KEY=VALUE..]".into());
    };
    let wheels: Vec<WheelSample> = rows(wheels)?
        .into_iter()
        .map(|(stamp_ns, v)| WheelSample { stamp_ns, left_m_s: v[0], right_m_s: v[1] })
        .collect();
    let imu: Vec<ImuSample> = match imu.as_str() {
        "none" => Vec::new(),
        path => rows(path)?
            .into_iter()
            .map(|(stamp_ns, v)| ImuSample {
                stamp_ns,
                yaw_rate_rad_s: v[0],
                heading_rad: v.get(1).copied(),
            })
            .collect(),
    };
    let fused = fuse(&options(settings)?, &wheels, &imu, None, None)?;
    eprintln!("{:#?}", fused.report);
    for pose in fused.poses {
        let (p, c) = (pose.pose, pose.covariance.map(|v| v.to_string()).join(","));
        println!("{},{},{},{},{c}", pose.stamp_ns, p.x_m, p.y_m, p.heading_rad);
    }
    Ok(())
}

/// The stamp \[ns\] and the values of a line.
type Row = (i64, Vec<f64>);

fn rows(path: &str) -> Result<Vec<Row>, Box<dyn Error>> {
    let text = std::fs::read_to_string(path)?;
    text.lines()
        .map(|line| {
            let (stamp, values) = line.split_once(',').ok_or("expected two or more columns")?;
            let values: Result<_, _> = values.split(',').map(str::parse).collect();
            Ok((stamp.parse()?, values?))
        })
        .collect()
}

/// The default options, changed by the settings.
fn options(settings: &[String]) -> Result<Options, Box<dyn Error>> {
    let mut values: BTreeMap<String, serde_json::Value> =
        serde_json::from_value(serde_json::to_value(Options::default())?)?;
    let mut track_m = 0.0;
    for setting in settings {
        let (key, value) = setting.split_once('=').ok_or("expected KEY=VALUE")?;
        if key == "track_m" {
            track_m = value.parse()?;
            continue;
        }
        values.insert(key.to_owned(), serde_json::from_str(value)?);
    }
    let options: Options = serde_json::from_value(serde_json::to_value(values)?)?;
    Ok(Options { track_m, ..options })
}
