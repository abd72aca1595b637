//! `inspect`: what a log holds and which pipeline would fit it.

use std::path::Path;

use anyhow::Result;
use dataset::Dropped;
use ingest::{Channel, Log};

/// Types that `ingest` takes scans from, then poses.
const LIDARS: [&str; 2] = ["VelodyneScan", "LaserScan"];
const POSES: [&str; 2] = ["PoseStamped", "Odometry"];

pub(crate) fn inspect(path: &Path) -> Result<Dropped> {
    let log = Log::open(path)?;
    let contents = log.contents();
    println!("{}: {} bytes", path.display(), log.bytes().len());
    let seconds = contents.time_range_ns.map(|(start, end)| end.saturating_sub(start) as f64 / 1e9);
    if let Some(seconds) = seconds {
        println!("duration {seconds:.1} s");
    }
    for channel in contents.channels.values() {
        let count = channel.n_messages.map_or("? messages".to_owned(), |n| format!("{n} messages"));
        let rate = match (channel.n_messages, seconds) {
            (Some(n), Some(seconds)) if seconds > 0.0 && n > 1 => {
                format!(", {:.2} Hz", (n - 1) as f64 / seconds)
            }
            _ => String::new(),
        };
        println!("  {:<24} {} ({count}{rate})", channel.topic, channel.describe());
    }
    let first = |types: &[&str]| {
        types.iter().find_map(|wanted| {
            contents.channels.values().find(|channel| type_name(channel) == *wanted)
        })
    };
    match (first(&LIDARS), first(&POSES)) {
        (None, _) => println!("no topic that scans could come from ({})", LIDARS.join(", ")),
        (Some(lidar), pose) => {
            println!("\na pipeline that would fit:\n");
            println!("[ingest]\nlogs = [{:?}]", path.display().to_string());
            println!("lidar.topic = {:?}", lidar.topic);
            match pose {
                Some(pose) => println!("pose.topic = {:?}", pose.topic),
                None => println!("# no pose topic: scans can be ingested, but not labelled"),
            }
        }
    }
    Ok(contents.dropped)
}

fn type_name(channel: &Channel) -> &str {
    channel.schema.rsplit('/').next().unwrap_or_default()
}
