//! Tries the suggested pipeline of `inspect` on the log: what would `ingest` and `subsample` report?

use std::sync::Arc;

use anyhow::{Context, Result};
use dataset::{Keyframe, NoteKind, Scan, StampedPose, Subject};
use ingest::{IngestError, Ingested, Log, Options, PoseOptions, Survey, WheelError};
use subsample::Candidate;

use crate::config::Config;
use crate::findings::Findings;
use crate::label_choice::LabelChoice;
use crate::run::progress_bar;
use crate::stage::Stage;
use crate::stages::featurize::check_one_kind_of_scan;

/// What the first stages make of a log. Nothing is written.
#[derive(Default)]
pub(crate) struct Trial {
    /// The poses of the lidar.
    pub(crate) poses: Vec<StampedPose>,
    /// The keyframes. Empty without poses.
    pub(crate) keyframes: Vec<Keyframe>,
    /// The label rules that suit the keyframes.
    labels: Option<LabelChoice>,
    /// The losses and notes of the stages.
    findings: Findings,
    /// The stage that failed, and why.
    refusal: Option<(Stage, anyhow::Error)>,
    /// The topics that were read.
    topics: Vec<String>,
}

impl Trial {
    /// Ingests a drive with a pipeline and selects its keyframes. Scans are not kept.
    ///
    /// If the pipeline lacks the track width or the radius of the wheels, the wheels are read with
    /// guesses: joints and stamps can be checked without them.
    pub(crate) fn run(name: &str, logs: &[Log], pipeline: &str) -> Result<Self> {
        let config: Config =
            toml::from_str(pipeline).context("cannot parse the suggested pipeline")?;
        let options = config.for_log(name)?;
        let options = Options { lidar: options.lidar, pose: options.pose };
        let Some(guessed) = options.pose.as_ref().and_then(with_guessed_wheels) else {
            return Self::of_options(name, logs, &config, &options);
        };
        let guessed = Options { pose: Some(guessed), ..options.clone() };
        let mut trial = Self::of_options(name, logs, &config, &guessed)?;
        if trial.refusal.as_ref().is_some_and(|(_, error)| depends_on_wheel_size(error)) {
            let scans_alone = Options { pose: None, ..options };
            trial = Self::of_options(name, logs, &config, &scans_alone)?;
        }
        trial.findings.notes.retain(|note| !SIZE_NOTES.contains(&note.code()));
        // The scale of these poses is a guess.
        (trial.poses, trial.keyframes, trial.labels) = Default::default();
        Ok(trial)
    }

    fn of_options(name: &str, logs: &[Log], config: &Config, options: &Options) -> Result<Self> {
        let mut trial = Self { topics: topics(options), ..Self::default() };
        let mut candidates = Vec::new();
        let n_bytes = logs.iter().map(Log::n_bytes).sum();
        let progress = progress_bar(n_bytes, format!("try {name}"), true);
        let ingested = ingest::ingest(
            &logs.iter().collect::<Vec<_>>(),
            options,
            |scans| {
                add_candidates(&scans, &mut candidates);
                anyhow::Ok(())
            },
            |position| progress.set_position(position),
        );
        progress.finish_and_clear();
        let Ingested { trajectory, losses, notes, .. } = match ingested {
            Ok(ingested) => ingested,
            Err(error) => {
                trial.refusal = Some((Stage::Ingest, error));
                return Ok(trial);
            }
        };
        trial.findings = Findings { losses, notes };
        if options.pose.is_some() {
            let log: Arc<str> = name.into();
            match subsample::subsample(&config.subsample, &log, &log, &candidates, &trajectory) {
                Ok((keyframes, losses)) => {
                    if let Err(error) = check_one_kind_of_scan(&keyframes) {
                        trial.refusal = Some((Stage::Featurize, error));
                    }
                    let labels = LabelChoice::of(config.seed, &keyframes);
                    trial.findings.losses.merge(losses);
                    trial.labels = Some(labels);
                    trial.keyframes = keyframes;
                }
                Err(error) => trial.refusal = Some((Stage::Subsample, error.into())),
            }
        }
        trial.poses = trajectory.poses().to_vec();
        Ok(trial)
    }

    /// Why `run` would refuse the pipeline.
    pub(crate) fn refusal(&self) -> Option<String> {
        let (stage, error) = self.refusal.as_ref()?;
        Some(format!("`{stage}` fails: {error:#}"))
    }

    /// Why `run` would refuse the pipeline for this log alone. Other logs of the site can help.
    pub(crate) fn too_few_pairs(&self) -> Option<String> {
        let refusal = self.labels.as_ref()?.refusal.as_ref()?;
        Some(format!("`label` fails for this log alone: {refusal}"))
    }

    /// The label rules that suit the keyframes.
    pub(crate) fn labels(&self, coverage_deg: Option<f64>) -> LabelChoice {
        self.labels.clone().unwrap_or_else(|| LabelChoice::without_keyframes(coverage_deg))
    }

    /// What the survey and the trial found.
    ///
    /// The trial knows more about the topics that it reads than the survey, unless it failed: it
    /// replaces what the survey counted there. Both see damage of the file: it is counted once.
    pub(crate) fn findings_with(&self, survey: &Survey) -> Findings {
        let was_read = |subject: &Subject| {
            let topic = subject.topic.as_ref();
            self.refusal.is_none() && topic.is_some_and(|topic| self.topics.contains(topic))
        };
        let mut all = self.findings.clone();
        for (loss, n) in survey.losses.iter().filter(|(loss, _)| !was_read(&loss.subject)) {
            let counted = self.findings.losses.iter().find(|(other, _)| *other == loss);
            all.losses.add(loss.clone(), n.saturating_sub(counted.map_or(0, |(_, n)| n)));
        }
        if let Some((stage, error)) = &self.refusal {
            let (stage, error) = (stage.to_string(), format!("{error:#}"));
            all.notes.push(NoteKind::PipelineRefused { stage, error }.into());
        }
        all
    }
}

/// Track width of a guess \[m\]; robots have 0.2 to 3 m.
const GUESSED_TRACK_M: f64 = 0.5;
/// Radius of the wheels of a guess \[m\]: the numbers of joints in m/s do not change with it.
const GUESSED_RADIUS_M: f64 = 1.0;
/// Notes that depend on the size of the wheels or the track.
const SIZE_NOTES: [&str; 8] = [
    "poses_fused",
    "wheel_unit_confirmed",
    "turn_ratio",
    "wheel_slip",
    "mostly_slip",
    "headings_used",
    "headings_contradict",
    "calibration_deviates",
];

/// The options with a guess of the track width, and with a radius of the wheels, if they are not set.
/// `None` if the track width is set, or the poses do not come from wheels.
fn with_guessed_wheels(pose: &PoseOptions) -> Option<PoseOptions> {
    if pose.wheels.is_none() || pose.track_m.is_some() {
        return None;
    }
    let is_unit_known = pose.wheel_radius_m.is_some() || pose.wheel_speed_unit.is_some();
    let wheel_radius_m = match is_unit_known {
        true => pose.wheel_radius_m,
        false => Some(GUESSED_RADIUS_M),
    };
    Some(PoseOptions {
        track_m: Some(GUESSED_TRACK_M),
        wheel_radius_m,
        // The guess makes most robots faster than they are.
        max_speed_m_s: f64::INFINITY,
        ..pose.clone()
    })
}

/// Whether an error can come from the guess: gyroscope and wheels turn alike, but not by the same
/// amount. The ratio is 1 for wheels with a radius of 1 m and a track of 0.5 m. It is 0.008 for a
/// radius of 0.05 m and a track of 3 m, and 6 for speeds in m/s and a track of 3 m.
fn depends_on_wheel_size(error: &anyhow::Error) -> bool {
    match error.downcast_ref::<IngestError>() {
        Some(IngestError::Wheels { source, .. }) => match source {
            WheelError::Unrelated { ratio, correlation, .. } => {
                0.5 <= *correlation && 0.005 <= *ratio && *ratio <= 10.0
            }
            WheelError::UnknownUnit { .. } => true,
            _ => false,
        },
        // Label rules and keyframes need the right scale.
        Some(_) => false,
        None => true,
    }
}

/// The topics that `ingest` reads.
pub(crate) fn topics(options: &Options) -> Vec<String> {
    let mut topics = vec![options.lidar.topic.clone()];
    if let Some(pose) = &options.pose {
        topics.extend([&pose.topic, &pose.imu].into_iter().flatten().cloned());
        topics.extend(pose.wheels.iter().map(|wheels| wheels.topic.clone()));
        topics.extend(pose.frames.iter().flat_map(|frames| frames.topics.clone()));
    }
    topics
}

fn add_candidates(scans: &[Scan], candidates: &mut Vec<Candidate>) {
    let first = candidates.len() as u32;
    candidates.extend(scans.iter().zip(first..).map(|(scan, number)| Candidate {
        scan: number,
        stamp_ns: scan.stamp_ns,
        coverage_deg: scan.coverage_deg,
        usable: scan.check_usable().is_ok(),
    }));
}
