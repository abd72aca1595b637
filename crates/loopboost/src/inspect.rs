//! `inspect`: describes a log, reports problems in it, and suggests a pipeline.

use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow};
use ingest::{
    ClockSurvey, Content, FrameSurvey, HORIZONTAL_LASER, JointsSurvey, PacketsSurvey, Survey,
    TopicSurvey,
};
use serde_json::json;

use crate::findings::Findings;
use crate::inspect_folder::{Wanted, inspect_folder, surveyed};
use crate::label_choice::LabelChoice;
use crate::logs::{self, LogFile};
use crate::plot;
use crate::suggest::{Suggestion, write_suggestion};
use crate::trial::Trial;

/// The arguments of `inspect`.
#[derive(clap::Args)]
pub(crate) struct InspectArgs {
    /// An MCAP log, or a folder with one drive or with several
    log: PathBuf,
    /// Write the suggested pipeline to a new file
    #[arg(long, value_name = "FILE.toml")]
    write: Option<PathBuf>,
    /// Draw the path from the suggested pipeline: poses, their uncertainty, and keyframes (one drive only)
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
    /// Fuse wheel odometry and IMU with this track width in metres, even if the log has poses
    #[arg(long, value_name = "METRES")]
    track_m: Option<f64>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Describes a log, or all drives of a folder. Writes the suggested pipeline and draws the path if requested.
///
/// The suggested pipeline is tried on the log. Everything that `ingest` and `subsample` would report
/// about it is reported.
pub(crate) fn inspect(args: &InspectArgs) -> Result<Findings> {
    let InspectArgs { log: path, write, plot, track_m, json: as_json } = args;
    let mut drives = drives(path)?;
    if 1 < drives.len() {
        return of_folder(args, drives);
    }
    let drive = drives.remove(0);
    let (logs, survey) = surveyed(&drive)?;
    let suggestion = Suggestion::of(&survey, *track_m);
    let from = write.as_deref().and_then(Path::parent);
    let with = |labels: &LabelChoice| {
        let lidar = suggestion.lidar;
        lidar
            .map(|lidar| suggestion.pipeline(lidar, std::slice::from_ref(path), from, labels))
            .transpose()
    };
    let coverage_deg = suggestion.coverage_deg();
    let trial = match with(&LabelChoice::without_keyframes(coverage_deg))? {
        Some(pipeline) => Trial::run(&drive.name, &logs, &pipeline)?,
        None => Trial::default(),
    };
    let pipeline = with(&trial.labels(coverage_deg))?;
    let (missing, refused) = (suggestion.missing(), trial.refusal());
    let mut findings = trial.findings_with(&survey);
    findings.notes.extend(suggestion.disagreements());
    findings.notes.extend(suggestion.needed_options());
    if *as_json {
        let all = json!({
            "log": path, "survey": survey, "losses": findings.losses, "notes": findings.notes,
            "missing": missing, "refused": refused, "too_few_pairs": trial.too_few_pairs(),
            "pipeline": pipeline,
        });
        out!("{}", serde_json::to_string_pretty(&all)?);
    } else {
        describe(path, &drive, &survey);
        missing.iter().for_each(|missing| out!("missing: {missing}"));
        let refusals = refused.iter().cloned().chain(trial.too_few_pairs());
        refusals.for_each(|refused| out!("refused: {refused}"));
        if let Some(pipeline) = pipeline.as_ref().filter(|_| write.is_none()) {
            print_pipeline(pipeline, &suggestion, &trial);
        }
    }
    let failed = |what: &str| match &refused {
        Some(refused) => anyhow!("cannot {what} {}: {refused}", path.display()),
        None => anyhow!("cannot {what} {}; missing: {}", path.display(), missing.join("; ")),
    };
    if let Some(file) = plot {
        if trial.poses.is_empty() || refused.is_some() {
            return Err(failed("draw the path of"));
        }
        plot::plot(file, &drive.name, &trial)?;
        eprintln!("wrote {}", file.display());
    }
    if let Some(file) = write {
        let pipeline = pipeline.filter(|_| refused.is_none());
        write_suggestion(file, &pipeline.ok_or_else(|| failed("suggest a pipeline for"))?)?;
        let file = file.display();
        match trial.too_few_pairs() {
            Some(why) => eprintln!("wrote {file}; {why}"),
            None if suggestion.has_poses() => {
                eprintln!("wrote {file}; next: loopboost run {file} --out DIR");
            }
            None => eprintln!("wrote {file}; before `loopboost run`, add what is missing"),
        }
    }
    Ok(findings)
}

/// Describes several drives. Their paths cannot be drawn together.
fn of_folder(args: &InspectArgs, drives: Vec<LogFile>) -> Result<Findings> {
    if args.plot.is_some() {
        return Err(several_drives(&args.log, &drives));
    }
    let wanted = Wanted {
        folder: &args.log,
        write: args.write.as_deref(),
        track_m: args.track_m,
        as_json: args.json,
    };
    inspect_folder(&wanted, drives)
}

/// Prints the suggested pipeline, and whether `run` would refuse it.
fn print_pipeline(pipeline: &str, suggestion: &Suggestion<'_>, trial: &Trial) {
    let remark = match trial.refusal() {
        Some(_) => "; `loopboost run` refuses it as it is",
        None if trial.too_few_pairs().is_some() => "; `loopboost run` needs more logs",
        None if suggestion.has_poses() => " (save it with --write FILE.toml)",
        None => "; before `loopboost run`, add what is missing",
    };
    out!("\nsuggested pipeline{remark}:\n");
    out!("{}", pipeline.trim_end());
}

/// The drives in a file or folder. It is an error if there are none.
fn drives(path: &Path) -> Result<Vec<LogFile>> {
    let mut drives = match path.is_dir() {
        true => logs::in_folder(path, 0)?,
        false => logs::find(Path::new(""), &path.to_string_lossy())?,
    };
    logs::name_apart(&mut drives, &[]);
    match drives.len() {
        0 => Err(match ::import::identify(path) {
            Some(known) => {
                anyhow!("{} is {}, expected MCAP; {}", path.display(), known.format, known.remedy)
            }
            None => anyhow!(
                "{} contains no *.mcap file; expected an MCAP file or a folder with the files of one drive",
                path.display()
            ),
        }),
        _ => Ok(drives),
    }
}

fn several_drives(path: &Path, drives: &[LogFile]) -> anyhow::Error {
    anyhow!(
        "{} contains {} drives, but --plot draws the path of one; choose one of: {}",
        path.display(),
        drives.len(),
        drives.iter().map(LogFile::place).collect::<Vec<_>>().join(", ")
    )
}

fn describe(path: &Path, drive: &LogFile, survey: &Survey) {
    let files = match drive.paths.len() {
        1 => String::new(),
        n => format!(" in {n} files"),
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
        out!("  {}{rate}", counted(topic.n_messages, "message"));
        if let Some(line) = frame_line(topic) {
            out!("  {line}");
        }
        topic.stamps.lines().iter().for_each(|line| out!("  {line}"));
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
                [] => out!("  no rings: the clouds have no field `ring` or no returns"),
                rings => {
                    let list = rings.iter().map(|(ring, deg)| format!("{ring} at {deg:.2}"));
                    out!("  {} rings [deg]: {}", rings.len(), list.collect::<Vec<_>>().join(", "));
                    out!("  {}", clouds.point_times);
                }
            },
            Content::Poses(poses) => {
                let (x_m, y_m) = poses.extent_m;
                if topic.n_messages == 0 {
                    continue;
                }
                out!(
                    "  path of {:.1} m within {x_m:.1} x {y_m:.1} m, longest gap between poses {:.2} s",
                    poses.path_m,
                    poses.widest_gap_s
                );
                poses.remarks.iter().for_each(|remark| out!("  {remark}"));
            }
            Content::Transforms(transforms) => {
                for of in transforms {
                    out!("  {} -> {}, {}", of.parent, of.child, counted(of.n_samples, "sample"));
                }
            }
            Content::Joints(joints) => print_joints(joints),
            Content::Other => {}
        }
    }
    out!();
}

fn print_joints(joints: &JointsSurvey) {
    match (joints.left.join(", "), joints.right.join(", ")) {
        (left, right) if !left.is_empty() => {
            out!("  {} joints; wheels: {left} (left), {right} (right)", joints.joints.len());
        }
        _ => out!(
            "  {} joints, no wheels on both sides: {}",
            joints.joints.len(),
            joints.joints.join(", ")
        ),
    }
}

fn print_packets(packets: &PacketsSurvey) {
    if !packets.is_hdl32e {
        out!(
            "  {} packets of a {} (cannot be ingested; expected an HDL-32E)",
            packets.n_packets,
            packets.sensor
        );
        return;
    }
    let mode = packets.return_mode.map_or("unknown", |mode| mode);
    let spin = packets.spin_hz.map_or("?".to_owned(), |hz| format!("{hz:.2}"));
    out!(
        "  {}, return mode {mode}, {spin} revolutions per second, {} complete revolutions",
        packets.sensor,
        packets.n_revolutions
    );
    out!(
        "  {} packets, {} missing, {} out of order",
        packets.n_packets,
        packets.n_missing,
        packets.n_late
    );
    let dead = match packets.dead_lasers.as_str() {
        "" => "all lasers have returns".to_owned(),
        dead => format!("no returns from lasers {dead}"),
    };
    if let Some(share) = packets.return_share.get(HORIZONTAL_LASER) {
        out!(
            "  {dead}; laser {HORIZONTAL_LASER} (horizontal) has returns from {:.0} % of its firings",
            share * 100.0
        );
    }
    match packets.clock {
        ClockSurvey::Still => out!("  device clock: stopped"),
        ClockSurvey::OnTime { offset_s } => {
            out!("  device clock: on GPS time, stamps {offset_s:.3} s later");
        }
        ClockSurvey::FreeRunning { offset_s } => {
            out!("  device clock: free-running, stamps minus device clock {offset_s:.1} s");
        }
    }
    if let n @ 1.. = packets.n_stamp_steps {
        let largest_s = packets.largest_stamp_step_s;
        out!("  stamps step {n} times relative to the device clock, by up to {largest_s:.2} s");
    }
    if packets.is_stamped_by_message() {
        out!("  all packets of a message have the same stamp; use the device clock");
    }
}

/// The frames of a topic. `None` if its messages name no frame.
fn frame_line(topic: &TopicSurvey) -> Option<String> {
    let name = |frame: &FrameSurvey| match (&*frame.frame_id, &*frame.child_frame_id) {
        ("", "") => "no frame".to_owned(),
        (frame, "") => format!("frame `{frame}`"),
        (frame, child) => format!("frame `{frame}`, child frame `{child}`"),
    };
    match topic.frames.as_slice() {
        [] => None,
        [one] if one.frame_id.is_empty() && one.child_frame_id.is_empty() => None,
        [one] => Some(name(one)),
        several => {
            let each = several
                .iter()
                .map(|frame| format!("{} ({})", name(frame), counted(frame.n_messages, "message")));
            Some(each.collect::<Vec<_>>().join("; "))
        }
    }
}

/// A count with its noun, in the plural unless the count is 1.
fn counted(n: u64, noun: &str) -> String {
    if n == 1 { format!("{n} {noun}") } else { format!("{n} {noun}s") }
}

fn kind(topic: &TopicSurvey) -> String {
    let schema = if topic.schema.is_empty() { "no schema" } else { &topic.schema };
    format!("{schema}, {}", topic.encoding)
}
