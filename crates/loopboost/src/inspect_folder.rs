//! `inspect` of a folder with several drives: what each contains, and one pipeline for all that fit.

use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow};
use dataset::{Keyframe, Losses, Note, NoteKind, Subject};
use ingest::{Log, Survey, survey};
use serde_json::{Value, json};

use crate::findings::Findings;
use crate::label_choice::LabelChoice;
use crate::logs::LogFile;
use crate::run::progress_bar;
use crate::stages::ingest::open;
use crate::suggest::{Suggestion, write_suggestion};
use crate::trial::Trial;

/// What is wanted of a folder.
pub(crate) struct Wanted<'a> {
    pub(crate) folder: &'a Path,
    /// Where the suggested pipeline is written.
    pub(crate) write: Option<&'a Path>,
    pub(crate) track_m: Option<f64>,
    pub(crate) as_json: bool,
}

/// A drive of the folder.
struct Drive {
    log: LogFile,
    /// What it contains, or why it cannot be read.
    content: Result<Content, String>,
}

struct Content {
    survey: Survey,
    trial: Trial,
    findings: Findings,
    missing: Vec<String>,
    /// The options of the suggested pipeline, with their sections, without the logs. Empty without a lidar.
    options: Vec<String>,
}

impl Content {
    fn of(log: &LogFile, track_m: Option<f64>) -> Result<Self> {
        let (logs, survey) = surveyed(log)?;
        let suggestion = Suggestion::of(&survey, track_m);
        let labels = LabelChoice::without_keyframes(suggestion.coverage_deg());
        let pipeline = suggestion
            .lidar
            .map(|lidar| suggestion.pipeline(lidar, &[log.paths[0].clone()], None, &labels));
        let pipeline = pipeline.transpose()?;
        let trial = match &pipeline {
            Some(pipeline) => Trial::run(&log.name, &logs, pipeline)?,
            None => Trial::default(),
        };
        let options = pipeline.map(|text| ingest_options(&text)).transpose()?;
        let mut findings = trial.findings_with(&survey);
        findings.notes.extend(suggestion.disagreements());
        findings.notes.extend(suggestion.needed_options());
        let missing = suggestion.missing();
        Ok(Self { survey, trial, findings, missing, options: options.unwrap_or_default() })
    }

    /// Whether the drive alone could be run.
    fn is_complete(&self) -> bool {
        !self.options.is_empty() && self.missing.is_empty() && self.trial.refusal().is_none()
    }
}

/// The files of a drive, and what they contain.
pub(crate) fn surveyed(drive: &LogFile) -> Result<(Vec<Log>, Survey)> {
    let (logs, lost) = open(drive)?;
    let n_bytes = logs.iter().map(Log::n_bytes).sum();
    let progress = progress_bar(n_bytes, format!("inspect {}", drive.name), true);
    let mut survey = survey(&logs.iter().collect::<Vec<_>>(), |done| progress.set_position(done));
    progress.finish_and_clear();
    logs.iter().try_for_each(Log::check_unchanged)?;
    survey.losses.merge(lost);
    Ok((logs, survey))
}

/// The options of the section `[ingest]` of a pipeline, except the logs: `ingest.pose.topic = "/pose"`.
fn ingest_options(pipeline: &str) -> Result<Vec<String>> {
    fn visit(name: &str, value: &toml::Value, options: &mut Vec<String>) {
        match value {
            toml::Value::Table(table) => {
                table
                    .iter()
                    .for_each(|(key, value)| visit(&format!("{name}.{key}"), value, options));
            }
            value if name != "ingest.logs" => options.push(format!("{name} = {value}")),
            _ => {}
        }
    }
    let table: toml::Table = toml::from_str(pipeline)?;
    let mut options = Vec::new();
    if let Some(ingest) = table.get("ingest") {
        visit("ingest", ingest, &mut options);
    }
    Ok(options)
}

/// Describes the drives of a folder, and suggests a pipeline for those that have the same topics.
pub(crate) fn inspect_folder(wanted: &Wanted<'_>, logs: Vec<LogFile>) -> Result<Findings> {
    let drives: Vec<Drive> = logs
        .into_iter()
        .map(|log| {
            let content = Content::of(&log, wanted.track_m).map_err(|error| format!("{error:#}"));
            Drive { log, content }
        })
        .collect();
    let used = most_frequent(&drives);
    let misfits: Vec<Option<String>> = drives.iter().map(|drive| misfit(drive, used)).collect();
    let (pipeline, too_few_pairs) = match used {
        Some(used) => {
            let (pipeline, too_few_pairs) = pipeline(wanted, &drives, used, &misfits)?;
            (Some(pipeline), too_few_pairs)
        }
        None => (None, None),
    };
    let findings = findings(&drives, &misfits);
    let n_fit = misfits.iter().filter(|misfit| misfit.is_none()).count();
    if wanted.as_json {
        let all = json!({
            "folder": wanted.folder,
            "drives": drives.iter().zip(&misfits).map(as_json).collect::<Vec<_>>(),
            "losses": findings.losses, "notes": findings.notes, "too_few_pairs": too_few_pairs,
            "pipeline": pipeline,
        });
        out!("{}", serde_json::to_string_pretty(&all)?);
    } else {
        describe(wanted.folder, &drives, &misfits);
        too_few_pairs.iter().for_each(|why| out!("refused: {why}"));
        if let Some(pipeline) = pipeline.as_ref().filter(|_| wanted.write.is_none()) {
            out!(
                "\nsuggested pipeline for {n_fit} of {} drives (save it with --write FILE.toml):\n",
                drives.len()
            );
            out!("{}", pipeline.trim_end());
        }
    }
    if let Some(file) = wanted.write {
        let pipeline = pipeline.ok_or_else(|| {
            anyhow!(
                "cannot suggest a pipeline for {}: no drive can be run",
                wanted.folder.display()
            )
        })?;
        write_suggestion(file, &pipeline)?;
        let file = file.display();
        match too_few_pairs {
            Some(why) => eprintln!("wrote {file}; {why}"),
            None => eprintln!("wrote {file}; next: loopboost run {file} --out DIR"),
        }
    }
    Ok(findings)
}

/// The drive whose options most drives have, of those that could be run. Of equally frequent ones, the first.
fn most_frequent(drives: &[Drive]) -> Option<&Content> {
    let complete =
        || drives.iter().filter_map(|d| d.content.as_ref().ok()).filter(|c| c.is_complete());
    let n_same =
        |content: &Content| complete().filter(|other| other.options == content.options).count();
    complete().fold(None, |best: Option<&Content>, next| match best {
        Some(best) if n_same(next) <= n_same(best) => Some(best),
        _ => Some(next),
    })
}

/// Why the pipeline with these options does not fit a drive.
fn misfit(drive: &Drive, used: Option<&Content>) -> Option<String> {
    let content = match &drive.content {
        Ok(content) => content,
        Err(error) => return Some(error.clone()),
    };
    if !content.missing.is_empty() {
        return Some(format!("missing: {}", content.missing.join("; ")));
    }
    if let Some(refusal) = content.trial.refusal() {
        return Some(refusal);
    }
    let used = used?;
    let others = content.options.iter().filter(|option| !used.options.contains(option));
    let others: Vec<&str> = others.map(String::as_str).collect();
    let lacking = used.options.iter().filter(|option| !content.options.contains(option));
    let lacking: Vec<&str> = lacking.map(String::as_str).collect();
    let part = |what: &str, options: &[&str]| {
        (!options.is_empty()).then(|| format!("{what} {}", options.join(", ")))
    };
    let parts = [part("needs", &others), part("does not need", &lacking)];
    let parts: Vec<String> = parts.into_iter().flatten().collect();
    (!parts.is_empty()).then(|| parts.join(", and "))
}

/// The pipeline for the drives that fit, and why `label` would refuse it.
fn pipeline(
    wanted: &Wanted<'_>,
    drives: &[Drive],
    used: &Content,
    misfits: &[Option<String>],
) -> Result<(String, Option<String>)> {
    let fits = || drives.iter().zip(misfits).filter(|(_, misfit)| misfit.is_none());
    let contents = || fits().filter_map(|(drive, _)| drive.content.as_ref().ok());
    let logs: Vec<PathBuf> = match misfits.iter().all(Option::is_none) {
        true => vec![wanted.folder.to_owned()],
        false => fits().map(|(drive, _)| place(&drive.log)).collect(),
    };
    let keyframes: Vec<Keyframe> =
        contents().flat_map(|content| content.trial.keyframes.iter().cloned()).collect();
    let suggestion = Suggestion::of(&used.survey, wanted.track_m);
    let labels = match keyframes.is_empty() {
        true => LabelChoice::without_keyframes(suggestion.coverage_deg()),
        false => LabelChoice::of(crate::config::default_seed(), &keyframes),
    };
    let lidar = suggestion.lidar.ok_or_else(|| anyhow!("the drive has no lidar"))?;
    let from = wanted.write.and_then(Path::parent);
    let refusal = labels.refusal.as_ref();
    let too_few_pairs = refusal.map(|why| format!("`label` fails for these drives alone: {why}"));
    Ok((suggestion.pipeline(lidar, &logs, from, &labels)?, too_few_pairs))
}

/// The file of a drive, or the folder of a split one.
fn place(log: &LogFile) -> PathBuf {
    let first = &log.paths[0];
    match (log.paths.len(), first.parent()) {
        (2.., Some(folder)) => folder.to_owned(),
        _ => first.clone(),
    }
}

/// What was found in each drive, and which drives do not fit.
fn findings(drives: &[Drive], misfits: &[Option<String>]) -> Findings {
    let mut all = Findings::default();
    for (drive, misfit) in drives.iter().zip(misfits) {
        let name = &*drive.log.name;
        if let Some(difference) = misfit {
            let kind = NoteKind::DriveDiffers { difference: difference.clone() };
            all.notes.push(Note::new(kind, Subject::log(name)));
        }
        let Ok(content) = &drive.content else { continue };
        let Findings { losses, notes } = content.findings.clone();
        let losses: Losses = losses.in_log(name);
        all.losses.merge(losses);
        let of_log = |note: Note| Note { subject: note.subject.clone().in_log(name), ..note };
        all.notes.extend(notes.into_iter().map(of_log));
    }
    all
}

/// Path of the keyframes \[m\], and their number.
fn path(content: &Content) -> (f64, usize) {
    let keyframes = &content.trial.keyframes;
    (keyframes.last().map_or(0.0, |last| last.travel_m), keyframes.len())
}

fn describe(folder: &Path, drives: &[Drive], misfits: &[Option<String>]) {
    let surveys = || drives.iter().filter_map(|drive| drive.content.as_ref().ok());
    let n_bytes: u64 = surveys().map(|content| content.survey.n_bytes).sum();
    let seconds: f64 = surveys().map(|content| content.survey.duration_s()).sum();
    out!(
        "{}: {} drives, {:.1} MB, {seconds:.1} s\n",
        folder.display(),
        drives.len(),
        n_bytes as f64 * 1e-6
    );
    for (drive, misfit) in drives.iter().zip(misfits) {
        let measured = match &drive.content {
            Ok(content) => {
                let (path_m, n_keyframes) = path(content);
                let seconds = content.survey.duration_s();
                format!("{seconds:.1} s, path of {path_m:.1} m, {n_keyframes} keyframes")
            }
            Err(_) => "not read".to_owned(),
        };
        let fits = match misfit {
            None => "fits".to_owned(),
            Some(misfit) => format!("does not fit: {misfit}"),
        };
        out!("{}: {measured}; {fits}", drive.log.name);
    }
}

fn as_json((drive, misfit): (&Drive, &Option<String>)) -> Value {
    let files: Vec<String> =
        drive.log.paths.iter().map(|path| path.display().to_string()).collect();
    match &drive.content {
        Ok(content) => {
            let (path_m, n_keyframes) = path(content);
            json!({
                "log": drive.log.name, "files": files, "survey": content.survey, "path_m": path_m,
                "n_keyframes": n_keyframes, "missing": content.missing,
                "refused": content.trial.refusal(), "does_not_fit": misfit,
            })
        }
        Err(error) => json!({
            "log": drive.log.name, "files": files, "error": error, "does_not_fit": misfit,
        }),
    }
}
