//! What the labels of a run rest on, in words.

use std::collections::BTreeMap;

use anyhow::Result;
use dataset::{Keyframe, Note, NoteKind};
use ingest::PoseOptions;

use crate::run::Run;
use crate::stage::Artifact;

/// What the labels rest on: one sentence per source of poses, in the order of the logs. The notes are those of
/// `label`, which describe maps.
pub(crate) fn label_basis(
    run: &Run,
    keyframes: &[Keyframe],
    notes: &[Note],
) -> Result<Vec<String>> {
    let of_maps = notes.iter().filter(|note| {
        matches!(note.kind, NoteKind::LabelsFromMap { .. } | NoteKind::MapWithoutClosures { .. })
    });
    let mut sentences: Vec<String> = of_maps.map(|note| note.kind.to_string()).collect();
    let mut logs_of: BTreeMap<String, Vec<&str>> = BTreeMap::new();
    for of_log in keyframes.chunk_by(|a, b| a.id.log == b.id.log) {
        let log = &*of_log[0].id.log;
        if of_log[0].map.is_some() {
            continue;
        }
        let source = match run.goal.has(Artifact::Truth) {
            true => run.config.evaluate.truth.clone().map(|pose| ("the ground truth: ", pose)),
            false => run.config.for_log(log)?.pose.map(|pose| ("", pose)),
        };
        let Some((what, pose)) = source else { continue };
        logs_of.entry(format!("{what}{}", described(&pose))).or_default().push(log);
    }
    sentences.extend(logs_of.into_iter().map(|(source, logs)| {
        let log = if logs.len() == 1 { "log" } else { "logs" };
        format!("the labels of {log} `{}` rest on {source}", logs.join("`, `"))
    }));
    Ok(sentences)
}

/// A source of poses in words.
fn described(pose: &PoseOptions) -> String {
    let topic = pose.topic.iter().map(|topic| format!("the poses of topic `{topic}`"));
    let frames = pose.frames.iter();
    let frames = frames.map(|of| format!("the transforms from `{}` to `{}`", of.parent, of.child));
    let file = pose.file.iter().map(|file| format!("the poses of the file `{file}`"));
    let wheels = pose.wheels.iter().map(|wheels| match &pose.imu {
        Some(imu) => format!("poses fused from `{}` and `{imu}`", wheels.topic),
        None => format!("poses computed from `{}`", wheels.topic),
    });
    topic.chain(frames).chain(file).chain(wheels).collect()
}
