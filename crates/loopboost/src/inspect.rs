//! `inspect`: what a log holds, what is wrong with it, and which pipeline would fit it.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow};
use dataset::Dropped;
use ingest::{ClockSurvey, Content, HORIZONTAL_LASER, PacketsSurvey, Survey, TopicSurvey, survey};
use serde_json::json;

use crate::fit::Fit;
use crate::logs::{self, LogFile};
use crate::plot;
use crate::run::progress_bar;
use crate::stages::ingest::open;

/// What `inspect` is asked for besides a word on the log.
#[derive(clap::Args)]
pub(crate) struct InspectArgs {
    /// An MCAP log, or a folder with one drive that was split into several
    log: PathBuf,
    /// Write the pipeline to a new file
    #[arg(long, value_name = "FILE.toml")]
    write: Option<PathBuf>,
    /// Draw the path that the pipeline gives: poses, how well they are known, and the scans kept
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
    /// Make the poses of wheels that are this far apart, in m, and of the imu, even where the log has
    /// poses
    #[arg(long, value_name = "METRES")]
    track_m: Option<f64>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Prints what a log holds; writes a pipeline for it and draws its path if asked to.
pub(crate) fn inspect(args: &InspectArgs) -> Result<Dropped> {
    let InspectArgs { log: path, write, plot, track_m, json: as_json } = args;
    let (write, as_json) = (write.as_deref(), *as_json);
    let drive = drive(path)?;
    let (logs, lost) = open(&drive)?;
    let n_bytes: usize = logs.iter().map(|log| log.bytes().len()).sum();
    let progress = progress_bar(n_bytes as u64, format!("inspect {}", drive.name), true);
    let mut survey = survey(&logs.iter().collect::<Vec<_>>(), |done| progress.set_position(done));
    progress.finish_and_clear();
    survey.losses.merge(lost);
    let fit = Fit::of(&survey, *track_m);
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
    if let Some(file) = plot {
        match &pipeline {
            Some(pipeline) if fit.has_poses() => {
                let notes = plot::plot(file, &drive.name, &logs, pipeline)?;
                notes.iter().for_each(|note| eprintln!("{}: {note}", drive.name));
                eprintln!("drew {}", file.display());
            }
            _ => {
                let missing = missing.join("; ");
                return Err(anyhow!("{}: no path to draw: {missing}", path.display()));
            }
        }
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
    Ok(survey.losses.into())
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
            Content::Transforms(transforms) => {
                for told in transforms {
                    out!("  {} -> {}, told {} times", told.parent, told.child, told.n_samples);
                }
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
        packets.n_revolutions
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
