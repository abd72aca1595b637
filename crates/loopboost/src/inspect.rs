//! `inspect`: what a log holds and which pipeline would fit it.

use std::path::Path;

use anyhow::{Context, Result};
use dataset::Dropped;
use ingest::{Channel, LIDAR_TYPES, Log, MessageType, POSE_TYPES};

pub(crate) fn inspect(path: &Path) -> Result<Dropped> {
    let log = Log::open(path)?;
    let contents = log.contents();
    out!("{}: {} bytes", path.display(), log.bytes().len());
    let seconds = contents.time_range_ns.map(|(start, end)| end.saturating_sub(start) as f64 / 1e9);
    if let Some(seconds) = seconds {
        out!("duration {seconds:.1} s");
    }
    for channel in contents.channels.values() {
        let count = channel.n_messages.map_or("? messages".to_owned(), |n| format!("{n} messages"));
        let rate = match (channel.n_messages, seconds) {
            (Some(n), Some(seconds)) if seconds > 0.0 && n > 1 => {
                format!(", {:.2} Hz", n as f64 / seconds)
            }
            _ => String::new(),
        };
        out!("  {:<24} {} ({count}{rate})", channel.topic, channel.describe());
    }
    // Of the topics that would do, the one with the most messages.
    let fitting = |types: &[MessageType]| {
        contents
            .channels
            .values()
            .filter(|channel| channel.n_messages != Some(0))
            .filter(|channel| channel.message_type().is_some_and(|t| types.contains(&t)))
            .max_by_key(|channel| channel.n_messages)
    };
    match fitting(&LIDAR_TYPES) {
        None => {
            let names = LIDAR_TYPES.map(MessageType::name).join(" or ");
            out!("\nno topic that scans could come from: expected {names} as cdr or ros1");
        }
        Some(lidar) => print_pipeline(path, lidar, fitting(&POSE_TYPES))?,
    }
    Ok(contents.dropped)
}

fn print_pipeline(path: &Path, lidar: &Channel, pose: Option<&Channel>) -> Result<()> {
    let path = path.canonicalize().with_context(|| format!("cannot find {}", path.display()))?;
    out!("\na pipeline that would fit:\n");
    out!("[ingest]\nlogs = [{:?}]", path.display().to_string());
    match pose {
        Some(pose) => out!("pose.topic = {:?}", pose.topic),
        None => out!("# no pose topic: scans can be ingested, but not labelled"),
    }
    out!("\n[ingest.lidar]\ntopic = {:?}", lidar.topic);
    if lidar.message_type() == Some(MessageType::LaserScan) {
        out!("range_min_m = 0.1   # of the scanner");
        out!("range_max_m = 50.0");
        out!(
            "\n[label]\npositive_heading_deg = 45.0   # counts for scanners that see less than 355 deg"
        );
    }
    Ok(())
}
