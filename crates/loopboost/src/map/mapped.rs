//! What `map` reads from a run folder.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use anyhow::{Result, anyhow};
use dataset::tables::{
    Provenance, digest_file, read_closures, read_pairs, read_poses, read_provenance,
    read_trajectory,
};
use dataset::{JudgedClosure, MapPose, Trajectory};
use evaluate::comparison::{ComparedRun, LabelledPair, MappedRun, Origin};
use serde_json::Value;

use crate::partitions::keyframes_in;
use crate::run::changed_values;
use crate::stage::Artifact;

/// The results of loop detection in a run folder.
pub(super) struct MappedFolder {
    folder: String,
    keyframes: Vec<MapPose>,
    closures: Vec<JudgedClosure>,
    trajectories: BTreeMap<Arc<str>, Trajectory>,
    pairs: Option<Vec<LabelledPair>>,
    /// The provenance of the tables, by their names in the run folder.
    tables: BTreeMap<String, Provenance>,
    /// The digests of the tables that are compared.
    digests: BTreeMap<String, String>,
}

/// The stages whose options influence maps and labels. Each table has those of its own stage.
const TABLES: [Artifact; 3] = [Artifact::Candidates, Artifact::Trajectory, Artifact::Pairs];

impl MappedFolder {
    pub(super) fn load(folder: &Path) -> Result<Self> {
        if !folder.is_dir() {
            return Err(anyhow!(
                "{} is not a folder; expected a run folder of `loopboost detect --model`, or of `loopboost run` with a section [detect]",
                folder.display()
            ));
        }
        let path = |artifact: Artifact, log: &str| folder.join(artifact.name(log));
        let (closures, _) = read_closures(&path(Artifact::Closures, ""))?;
        let (keyframes, _) = read_trajectory(&path(Artifact::Trajectory, ""))?;
        let mut names = vec![Artifact::Closures.name("")];
        let mut tables = BTreeMap::new();
        let mut trajectories = BTreeMap::new();
        for MapPose { id, .. } in &keyframes {
            if !trajectories.contains_key(&id.log) {
                let (trajectory, _) = read_poses(&path(Artifact::ScanTrajectory, &id.log))?;
                trajectories.insert(id.log.clone(), trajectory);
                names.push(Artifact::ScanTrajectory.name(&id.log));
                let scans = Artifact::Scans.name(&id.log);
                tables.insert(scans.clone(), read_provenance(&folder.join(&scans))?.1);
                let keyframes = Artifact::Keyframes.name(&id.log);
                let path = folder.join(&keyframes);
                if path.exists() {
                    tables.insert(keyframes.clone(), read_provenance(&path)?.1);
                    names.push(keyframes);
                }
            }
        }
        for artifact in TABLES {
            let path = path(artifact, "");
            if path.exists() {
                tables.insert(artifact.name(""), read_provenance(&path)?.1);
                names.push(artifact.name(""));
            }
        }
        let digests = names.into_iter().map(|name| {
            let digest = digest_file(&folder.join(&name))?;
            Ok((name, digest))
        });
        Ok(Self {
            folder: folder.display().to_string(),
            keyframes,
            closures,
            trajectories,
            pairs: labelled_pairs(folder)?,
            tables,
            digests: digests.collect::<Result<_>>()?,
        })
    }

    pub(super) fn run(&self) -> MappedRun<'_> {
        MappedRun {
            keyframes: &self.keyframes,
            closures: &self.closures,
            trajectories: &self.trajectories,
            pairs: self.pairs.as_deref(),
        }
    }

    pub(super) fn name(&self) -> ComparedRun {
        let made = &self.tables[&Artifact::Trajectory.name("")];
        ComparedRun {
            folder: self.folder.clone(),
            program_version: made.program_version.clone(),
            seed: made.seed.unwrap_or_default(),
        }
    }

    /// The digests of the compared tables. `side` comes before their names.
    pub(super) fn digests(&self, side: &str) -> impl Iterator<Item = (String, String)> {
        self.digests.iter().map(move |(name, digest)| (format!("{side}/{name}"), digest.clone()))
    }
}

/// The labelled pairs of a run, if it has a table of them.
fn labelled_pairs(folder: &Path) -> Result<Option<Vec<LabelledPair>>> {
    let path = folder.join(Artifact::Pairs.name(""));
    if !path.exists() {
        return Ok(None);
    }
    let keyframes = keyframes_in(folder)?;
    let (pairs, _) = read_pairs(&path, &keyframes)?;
    let named = pairs.iter().map(|pair| LabelledPair {
        scans: [pair.query, pair.reference].map(|k| keyframes[k].id.clone()),
        label: pair.label,
    });
    Ok(Some(named.collect()))
}

/// What differs in the origins of the tables that both runs have: program, seed, options, and the files
/// that are not tables of the run, such as logs. A difference of several tables is listed once, with the first
/// of them.
pub(super) fn origins(a: &MappedFolder, b: &MappedFolder) -> Vec<Origin> {
    let mut origins: Vec<Origin> = Vec::new();
    for (table, of_a) in &a.tables {
        let Some(of_b) = b.tables.get(table) else { continue };
        for (key, a, b) in differences(of_a, of_b) {
            if !origins.iter().any(|origin| origin.key == key && origin.a == a && origin.b == b) {
                origins.push(Origin { table: table.clone(), key, a, b });
            }
        }
    }
    origins
}

/// What differs in two provenances: the key, and both values.
fn differences(a: &Provenance, b: &Provenance) -> Vec<(String, Option<String>, Option<String>)> {
    let program = |of: &Provenance| Some(of.program_version.clone());
    let seed = |of: &Provenance| of.seed.map(|seed| seed.to_string());
    let mut found = vec![
        ("program_version".to_owned(), program(a), program(b)),
        ("seed".to_owned(), seed(a), seed(b)),
    ];
    let text = |value: Value| match value {
        Value::Null => None,
        Value::String(text) => Some(text),
        other => Some(other.to_string()),
    };
    let options = changed_values(&a.options, &b.options).into_iter();
    found.extend(options.map(|(key, a, b)| (key, text(a), text(b))));
    // The options contain the digest of a model.
    let is_external = |name: &&String| {
        !name.ends_with(".json")
            && Artifact::of_name(name).is_none_or(|(artifact, _)| artifact == Artifact::Log)
    };
    let names: BTreeSet<&String> =
        a.inputs.keys().chain(b.inputs.keys()).filter(is_external).collect();
    let digest = |of: &Provenance, name: &String| of.inputs.get(name).cloned();
    found.extend(names.into_iter().map(|name| (name.clone(), digest(a, name), digest(b, name))));
    found.retain(|(_, a, b)| a != b);
    found
}
