//! `inspect`: what a log holds, what is wrong with it, and which pipeline would fit it.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow};
use dataset::{Dropped, FULL_RING_DEG};
use ingest::{
    ClockSurvey, Content, HORIZONTAL_LASER, MessageType, PacketsSurvey, Survey, TopicSurvey, survey,
};
use serde_json::json;

use crate::logs::{self, LogFile};
use crate::run::progress_bar;
use crate::stages::ingest::open;

/// Prints what a log holds; writes a pipeline for it if asked to.
pub(crate) fn inspect(path: &Path, write: Option<&Path>, as_json: bool) -> Result<Dropped> {
    let drive = drive(path)?;
    let (logs, lost) = open(&drive)?;
    let n_bytes: usize = logs.iter().map(|log| log.bytes().len()).sum();
    let progress = progress_bar(n_bytes as u64, format!("inspect {}", drive.name), true);
    let mut survey = survey(&logs.iter().collect::<Vec<_>>(), |done| progress.set_position(done));
    progress.finish_and_clear();
    survey.dropped.merge(lost);
    let fit = Fit::of(&survey);
    let missing = fit.missing();
    let from = write.and_then(Path::parent);
    let pipeline = fit.lidar.map(|lidar| fit.pipeline(lidar, path, from)).transpose()?;
    if as_json {
        let all =
            json!({ "log": path, "survey": survey, "missing": missing, "pipeline": pipeline });
        out!("{}", serde_json::to_string_pretty(&all)?);
    } else {
        print(path, &drive, &survey);
        missing.iter().for_each(|missing| out!("missing: {missing}"));
    }
    match (write, pipeline) {
        (Some(file), Some(pipeline)) => {
            write_new(file, &pipeline)?;
            eprintln!("wrote {}; next: loopboost run {} --out DIR", file.display(), file.display());
        }
        (Some(_), None) => {
            return Err(anyhow!(
                "{}: no pipeline would fit: {}",
                path.display(),
                missing.join("; ")
            ));
        }
        (None, Some(pipeline)) if !as_json => {
            out!(
                "\na pipeline that would fit (--write FILE.toml writes it):\n\n{}",
                pipeline.trim_end()
            );
        }
        _ => {}
    }
    Ok(survey.dropped)
}

/// The one drive of a file or folder.
fn drive(path: &Path) -> Result<LogFile> {
    let mut drives = logs::find(Path::new(""), &path.to_string_lossy())?;
    match drives.len() {
        1 => Ok(drives.remove(0)),
        n => Err(anyhow!(
            "{} holds {n} drives; inspect one: {}",
            path.display(),
            drives.iter().map(LogFile::place).collect::<Vec<_>>().join(", ")
        )),
    }
}

fn print(path: &Path, drive: &LogFile, survey: &Survey) {
    let files = match drive.paths.len() {
        1 => String::new(),
        n => format!(" in {n} files of one drive"),
    };
    out!(
        "{}: {:.1} MB{files}, {:.1} s",
        path.display(),
        survey.n_bytes as f64 * 1e-6,
        survey.duration_s()
    );
    for topic in &survey.topics {
        let rate = topic.rate_hz.map_or(String::new(), |hz| format!(", {hz:.2} Hz"));
        out!("\n{}  {}", topic.topic, kind(topic));
        out!("  {} messages{rate}", topic.n_messages);
        match &topic.content {
            Content::Packets(packets) => print_packets(packets),
            Content::Scans(scans) => {
                let beams = match scans.n_beams {
                    (fewest, most) if fewest == most => most.to_string(),
                    (fewest, most) => format!("{fewest} to {most}"),
                };
                let (near, far) = scans.range_m;
                out!("  {beams} beams over {:.1} deg, {near} to {far} m", scans.coverage_deg);
            }
            Content::Clouds(clouds) => match clouds.rings.as_slice() {
                [] => out!("  no rings: no field `ring`, or no return"),
                rings => {
                    let list = rings.iter().map(|(ring, deg)| format!("{ring} at {deg:.2}"));
                    out!("  {} rings [deg]: {}", rings.len(), list.collect::<Vec<_>>().join(", "));
                }
            },
            Content::Poses(poses) => {
                let (x_m, y_m) = poses.extent_m;
                if topic.n_messages == 0 {
                    continue;
                }
                out!(
                    "  a path of {:.1} m within {x_m:.1} x {y_m:.1} m; at most {:.2} s between two poses",
                    poses.path_m,
                    poses.widest_gap_s
                );
            }
            Content::Other => {}
        }
    }
    out!();
}

fn print_packets(packets: &PacketsSurvey) {
    if !packets.is_hdl32e {
        out!("  {} packets of a {}, which cannot be ingested", packets.n_packets, packets.sensor);
        return;
    }
    let mode = packets.return_mode.map_or("unknown", |mode| mode);
    let spin = packets.spin_hz.map_or("?".to_owned(), |hz| format!("{hz:.2}"));
    out!(
        "  {}, return mode {mode}, {spin} turns a second, {} whole turns",
        packets.sensor,
        packets.n_turns
    );
    out!(
        "  {} packets, {} missing between them, {} late",
        packets.n_packets,
        packets.n_missing,
        packets.n_late
    );
    let dead = match packets.dead_lasers.as_str() {
        "" => "every laser has returns".to_owned(),
        dead => format!("no return from lasers {dead}"),
    };
    if let Some(share) = packets.return_share.get(HORIZONTAL_LASER) {
        out!(
            "  {dead}; laser {HORIZONTAL_LASER}, the horizontal one, returns from {:.0} % of its firings",
            share * 100.0
        );
    }
    match packets.clock {
        ClockSurvey::Still => out!("  the device clock stands still"),
        ClockSurvey::OnTime { offset_s } => {
            out!("  the device clock is on time: the stamps are {offset_s:.3} s behind it");
        }
        ClockSurvey::FreeRunning { offset_s } => {
            out!("  the device clock runs free: the stamps are {offset_s:.1} s past it");
        }
    }
    if let n @ 1.. = packets.n_stamp_steps {
        let largest_s = packets.largest_stamp_step_s;
        out!("  the stamps step {n} times against the device clock, by up to {largest_s:.2} s");
    }
    if packets.is_stamped_by_message() {
        out!("  packets of a message have one stamp: the device clock tells their time");
    }
}

fn kind(topic: &TopicSurvey) -> String {
    let schema = if topic.schema.is_empty() { "no schema" } else { &topic.schema };
    format!("{schema}, {}", topic.encoding)
}

/// The topics that a pipeline would take.
struct Fit<'a> {
    lidar: Option<&'a TopicSurvey>,
    pose: Option<&'a TopicSurvey>,
    /// A topic of packets that give no whole turn.
    lidar_without_turn: Option<&'a TopicSurvey>,
}

impl<'a> Fit<'a> {
    /// Packets rather than what a driver made of them; of poses that move, the most.
    fn of(survey: &'a Survey) -> Self {
        let rank = |topic: &TopicSurvey| match &topic.content {
            Content::Packets(packets) if packets.is_hdl32e && packets.n_turns > 0 => 3,
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
        Self {
            // Of equals the first, by name.
            lidar: lidars.rev().max_by_key(|topic| (rank(topic), topic.n_messages)),
            pose: poses.rev().max_by_key(|topic| topic.n_messages),
            lidar_without_turn: survey.topics.iter().find(
                |topic| matches!(&topic.content, Content::Packets(packets) if packets.n_turns == 0),
            ),
        }
    }

    fn missing(&self) -> Vec<String> {
        let mut missing = Vec::new();
        if let (None, Some(topic)) = (self.lidar, self.lidar_without_turn) {
            missing.push(format!("whole turns: the packets of {} give none", topic.topic));
        } else if self.lidar.is_none() {
            let names = ingest::LIDAR_TYPES.map(MessageType::name).join(", ");
            missing.push(format!("a topic that scans could come from, one of {names}"));
        }
        if self.pose.is_none() {
            let names = ingest::POSE_TYPES.map(MessageType::name).join(", ");
            missing.push(format!(
                "a topic with poses that move, one of {names}: scans can be ingested, but not labelled"
            ));
        }
        missing
    }

    /// The pipeline file; the log's path is relative to the folder `from`, where one is given.
    fn pipeline(&self, lidar: &TopicSurvey, log: &Path, from: Option<&Path>) -> Result<String> {
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
        match self.pose {
            Some(pose) => writeln!(text, "pose.topic = {:?}", pose.topic)?,
            None => writeln!(
                text,
                "# pose.topic = \"...\": the log has no poses, so that its scans cannot be labelled"
            )?,
        }
        writeln!(text, "\n[ingest.lidar]\ntopic = {:?}", lidar.topic)?;
        match &lidar.content {
            Content::Packets(packets) => {
                if packets.is_stamped_by_message() {
                    writeln!(text, "clock = \"device\"   # packets of a message have one stamp")?;
                }
                if let Some(laser) = packets.stand_in() {
                    writeln!(
                        text,
                        "laser = {laser}   # the horizontal one, {HORIZONTAL_LASER}, is dead"
                    )?;
                }
            }
            Content::Clouds(clouds) => {
                let nearest = clouds.rings.iter().min_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
                if let Some((ring, deg)) = nearest {
                    writeln!(text, "ring = {ring}   # at {deg:.2} deg")?;
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
                        "\n[label]\npositive_heading_deg = 45.0   # the scanner sees less than a full circle"
                    )?;
                }
            }
            _ => {}
        }
        Ok(text)
    }
}

/// A path as seen from a folder; both are absolute.
fn relative(path: &Path, folder: &Path) -> PathBuf {
    let shared = path.components().zip(folder.components()).take_while(|(a, b)| a == b).count();
    let up = folder.components().skip(shared).map(|_| "..");
    up.map(PathBuf::from)
        .chain(path.components().skip(shared).map(|c| PathBuf::from(c.as_os_str())))
        .collect()
}

fn write_new(path: &Path, text: &str) -> Result<()> {
    use std::io::Write as _;
    let mut file = std::fs::File::create_new(path).map_err(|e| match e.kind() {
        std::io::ErrorKind::AlreadyExists => {
            anyhow!("{} is there already; name another file with --write", path.display())
        }
        _ => anyhow!("cannot write {}: {e}", path.display()),
    })?;
    file.write_all(text.as_bytes()).with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_written_as_seen_from_the_pipeline() {
        let relative = |path, folder| relative(Path::new(path), Path::new(folder));
        assert_eq!(relative("/data/logs/a.mcap", "/data/pipelines"), Path::new("../logs/a.mcap"));
        assert_eq!(relative("/data/a.mcap", "/data"), Path::new("a.mcap"));
        assert_eq!(relative("/x/a.mcap", "/data/p"), Path::new("../../x/a.mcap"));
    }
}
