//! The map of a finished run: as a source of poses (`ingest.pose.run`), or to add drives to it
//! (`detect.maps`).

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Result, anyhow};
use dataset::tables::scans::read_scan_headers;
use dataset::tables::{read_closures, read_graph, read_poses, read_registered, read_trajectory};
use dataset::{GraphEdge, Keyframe, MapPose, Note, NoteKind, ScanId, StampedPose, Trajectory};
use label::{Measurement, PoseGraph, Vertex};
use serde_json::Value;

use crate::config::usage;
use crate::logs::LogFile;
use crate::other_run::OtherRun;
use crate::run::{Manifest, Run, changes};
use crate::stage::{Artifact, Stage};

/// What the labels of keyframes rest on.
const TABLES: [Artifact; 3] = [Artifact::Trajectory, Artifact::GraphEdges, Artifact::Closures];

/// A finished run with a map.
pub(crate) struct MapRun<'a> {
    run: &'a OtherRun,
    manifest: Manifest,
    /// The keyframes of the run.
    keyframes: Vec<MapPose>,
}

impl<'a> MapRun<'a> {
    /// Opens the run that poses are taken from; `None` if the pipeline names none. It is an error if `optimize`
    /// has not finished, or if its tables were altered since.
    pub(crate) fn open(run: &'a Run) -> Result<Option<Self>> {
        let of = |other| Self::of(other, "ingest.pose.run", |path| run.digest(path));
        run.pose_run().map(of).transpose()
    }

    /// Opens the runs whose map the logs are added to, in the same way. It is an error if the logs of the
    /// second one were not added to the map of the first one as it is now, and so on.
    pub(crate) fn known(run: &'a Run) -> Result<Vec<Self>> {
        let of = |other| Self::of(other, "detect.maps", |path| run.digest(path));
        let runs: Vec<Self> = run.known_maps().iter().map(of).collect::<Result<_>>()?;
        let Some((first, added)) = runs.split_first() else { return Ok(runs) };
        let digest = run.digest(&first.path(Artifact::Trajectory, ""))?;
        let is_added = |map: &&Self| {
            let optimized = map.manifest.tasks.get(Stage::Optimize.name());
            optimized.is_some_and(|record| record.inputs.values().any(|input| *input == digest))
        };
        if let Some(stray) = added.iter().find(|map| !is_added(map)) {
            return Err(usage(format!(
                "`detect.maps`: the logs of {} were not added to the map of {}, or that map has changed since; name the run with the map first, then runs with it in their `detect.maps`, and repeat those",
                stray.folder().display(),
                first.folder().display()
            )));
        }
        Ok(runs)
    }

    /// Opens a run, with the checks of [`MapRun::open`]. `key` is the option that names it, `digest` computes
    /// the digest of a file.
    pub(crate) fn of(
        other: &'a OtherRun,
        key: &str,
        digest: impl Fn(&Path) -> Result<String>,
    ) -> Result<Self> {
        let folder = other.folder.display();
        let remedy = "run `loopboost run` with a pipeline that has a section [detect], or `loopboost detect --model`, on these logs first";
        let manifest = Manifest::load_existing(&other.folder)
            .map_err(|error| error.context(format!("`{key}` is `{}`", other.name)))?;
        let Some(optimized) = manifest.tasks.get(Stage::Optimize.name()) else {
            return Err(anyhow!(
                "the run {folder} has no map: `optimize` has not finished in it; {remedy}"
            ));
        };
        for (name, made) in optimized.inputs.iter().chain(&optimized.outputs) {
            let path = other.folder.join(name);
            // An input from elsewhere, such as a model, is not part of the run.
            let is_of_run = Artifact::of_name(name).is_some() || path.exists();
            if is_of_run && digest(&path).ok().as_ref() != Some(made) {
                return Err(anyhow!(
                    "the run {folder} is not finished: {name} is not the file that its map was made with; repeat the command that made the run"
                ));
            }
        }
        let (keyframes, _) = read_trajectory(&other.folder.join(Artifact::Trajectory.pattern()))?;
        Ok(Self { run: other, manifest, keyframes })
    }

    pub(crate) fn folder(&self) -> &Path {
        &self.run.folder
    }

    /// The options of a task, such as `detect`. Null if the run has no such task.
    pub(crate) fn options(&self, task: &str) -> Value {
        self.manifest.tasks.get(task).map_or(Value::Null, |record| record.options.clone())
    }

    /// A file of the run.
    pub(crate) fn path(&self, artifact: Artifact, log: &str) -> PathBuf {
        self.run.folder.join(artifact.name(log))
    }

    /// The logs with keyframes in a map.
    pub(crate) fn logs(&self) -> BTreeSet<Arc<str>> {
        self.keyframes.iter().map(|keyframe| keyframe.id.log.clone()).collect()
    }

    /// The numbers of the maps.
    pub(crate) fn numbers(&self) -> BTreeSet<u32> {
        self.keyframes.iter().map(|keyframe| keyframe.map).collect()
    }

    /// The number of the map of a segment of a log.
    pub(crate) fn number(&self, log: &str, segment: u32) -> Option<u32> {
        let is_of_segment = |k: &&MapPose| *k.id.log == *log && k.segment == segment;
        self.keyframes.iter().find(is_of_segment).map(|keyframe| keyframe.map)
    }

    /// The files that the scans and poses of a log come from.
    pub(crate) fn inputs_of_log(&self, log: &str) -> Vec<PathBuf> {
        [Artifact::Scans, Artifact::ScanTrajectory, Artifact::Trajectory]
            .map(|artifact| self.path(artifact, log))
            .to_vec()
    }

    /// The files that the uncertainty of the poses comes from.
    pub(crate) fn inputs_of_graph(&self, logs: &[LogFile]) -> Vec<PathBuf> {
        let of_log = |log: &LogFile| {
            [Artifact::Registered, Artifact::ScanTrajectory].map(|a| self.path(a, &log.name))
        };
        let of_run = TABLES.map(|artifact| self.path(artifact, ""));
        logs.iter().flat_map(of_log).chain(of_run).collect()
    }

    /// The table of the scans of a log.
    pub(crate) fn scans(&self, log: &str) -> PathBuf {
        self.path(Artifact::Scans, log)
    }

    /// Checks that the run was made from the same log, with the same options for its scans.
    pub(crate) fn check_log(&self, run: &Run, log: &LogFile) -> Result<()> {
        let folder = self.run.folder.display();
        let Some(ingested) = self.manifest.tasks.get(&format!("{} {}", Stage::Ingest, log.name))
        else {
            let known: BTreeSet<&str> = self.keyframes.iter().map(|k| &*k.id.log).collect();
            let known: Vec<&str> = known.into_iter().collect();
            return Err(anyhow!(
                "the run {folder} has no log `{}`, expected one of `{}`; add the log to the pipeline of that run and run it again, or give this log another source of poses in [ingest.log.{}.pose]",
                log.name,
                known.join("`, `"),
                log.name
            ));
        };
        for path in &log.paths {
            let digest = run.digest(path)?;
            if !ingested.inputs.values().any(|known| *known == digest) {
                let known: Vec<String> = ingested
                    .inputs
                    .iter()
                    .map(|(name, known)| format!("{name}: {known}"))
                    .collect();
                return Err(anyhow!(
                    "{} is not the log `{}` of the run {folder}: its BLAKE3 digest is {digest}, expected one of the digests of the run ({}); use the same file, or make the run again",
                    path.display(),
                    log.name,
                    known.join(", ")
                ));
            }
        }
        let lidar = serde_json::to_value(run.config.for_log(&log.name)?.lidar)?;
        let differing = changes(&ingested.options["lidar"], &lidar);
        if !differing.is_empty() {
            return Err(anyhow!(
                "log `{}`: the run {folder} has other scans than this pipeline: `ingest.lidar` differs ({}); set the same options as in the pipeline of that run",
                log.name,
                differing.join(", ")
            ));
        }
        Ok(())
    }

    /// The optimized pose at every scan of a log. The frame of a pose is the number of its map.
    pub(crate) fn trajectory(&self, log: &str) -> Result<Trajectory> {
        let path = self.path(Artifact::ScanTrajectory, log);
        let (optimized, _) = read_poses(&path)?;
        let (headers, _) = read_scan_headers(&self.scans(log))?;
        let stamps: BTreeSet<i64> = headers.iter().map(|header| header.stamp_ns).collect();
        if let Some(stray) = optimized.poses().iter().find(|pose| !stamps.contains(&pose.stamp_ns))
        {
            return Err(anyhow!(
                "{} has a pose at {} ns, where log `{log}` has no scan; repeat the command that made the run",
                path.display(),
                stray.stamp_ns
            ));
        }
        let maps: BTreeMap<u32, u32> = self
            .keyframes
            .iter()
            .filter(|keyframe| &*keyframe.id.log == log)
            .map(|keyframe| (keyframe.segment, keyframe.map))
            .collect();
        // A segment without keyframes is in no map.
        let in_map = |pose: &StampedPose| {
            let frame = *maps.get(&pose.segment)?;
            Some(StampedPose { frame, covariance: None, ..*pose })
        };
        Ok(Trajectory::new(optimized.poses().iter().filter_map(in_map).collect()).0)
    }

    /// The measurements that the poses of keyframes rest on. A keyframe without a vertex of its own is between
    /// two scans that have one.
    pub(crate) fn graph(&self, keyframes: &[Keyframe]) -> Result<PoseGraph> {
        let (edges, _) = read_graph(&self.path(Artifact::GraphEdges, ""))?;
        let mut vertices = Vertices::new(&edges);
        for keyframe in &self.keyframes {
            vertices.set_covariance(keyframe);
        }
        let mut of_keyframes = Vec::with_capacity(keyframes.len());
        for of_log in keyframes.chunk_by(|a, b| a.id.log == b.id.log) {
            let log = &*of_log[0].id.log;
            if of_log[0].map.is_none() {
                of_keyframes.extend(of_log.iter().map(|_| None));
                continue;
            }
            let (rows, _) = read_registered(&self.path(Artifact::Registered, log))?;
            let (optimized, _) = read_poses(&self.path(Artifact::ScanTrajectory, log))?;
            let mut known: Vec<(i64, u32, usize)> = rows
                .iter()
                .filter_map(|row| {
                    Some((row.stamp_ns, row.segment, *vertices.numbers.get(&row.id)?))
                })
                .collect();
            known.sort_unstable();
            for keyframe in of_log {
                of_keyframes.push(Some(vertices.of_keyframe(keyframe, &known, &optimized)));
            }
        }
        Ok(PoseGraph::new(&vertices.vertices, &vertices.measurements, of_keyframes))
    }

    /// What the labels of keyframes rest on, one note per map.
    pub(crate) fn notes(&self, keyframes: &[Keyframe]) -> Result<Vec<Note>> {
        let (closures, _) = read_closures(&self.path(Artifact::Closures, ""))?;
        let map_of: HashMap<&ScanId, u32> =
            self.keyframes.iter().map(|keyframe| (&keyframe.id, keyframe.map)).collect();
        let mut n_closures: BTreeMap<u32, u64> = BTreeMap::new();
        for closure in closures.iter().filter(|closure| closure.is_accepted()) {
            if let Some(map) = map_of.get(&closure.closure.query) {
                *n_closures.entry(*map).or_default() += 1;
            }
        }
        let mut logs_of: BTreeMap<u32, BTreeSet<&str>> = BTreeMap::new();
        for keyframe in keyframes {
            if let Some(map) = keyframe.map {
                logs_of.entry(map).or_default().insert(&keyframe.id.log);
            }
        }
        let note = |(map, logs): (u32, BTreeSet<&str>)| {
            let run = self.run.name.clone();
            let logs = logs.into_iter().map(str::to_owned).collect();
            Note::from(match n_closures.get(&map) {
                Some(&n_closures) => NoteKind::LabelsFromMap { run, map, logs, n_closures },
                None => NoteKind::MapWithoutClosures { run, map, logs },
            })
        };
        Ok(logs_of.into_iter().map(note).collect())
    }
}

/// The vertices of a pose graph: scans of the run, and keyframes between them.
struct Vertices<'a> {
    numbers: HashMap<&'a ScanId, usize>,
    vertices: Vec<Vertex>,
    measurements: Vec<Measurement>,
    /// The covariance of the first measurement between two vertices.
    between: HashMap<(usize, usize), [f64; 6]>,
}

impl<'a> Vertices<'a> {
    fn new(edges: &'a [GraphEdge]) -> Self {
        let mut new = Self {
            numbers: HashMap::new(),
            vertices: Vec::new(),
            measurements: Vec::with_capacity(edges.len()),
            between: HashMap::new(),
        };
        for GraphEdge { reference, query, reference_from_query, covariance } in edges {
            let [a, b] = [reference, query].map(|id| {
                let next = new.numbers.len();
                *new.numbers.entry(id).or_insert(next)
            });
            new.between.entry((a, b)).or_insert(*covariance);
            let (a_from_b, covariance) = (*reference_from_query, *covariance);
            new.measurements.push(Measurement { a, b, a_from_b, covariance });
        }
        new.vertices.resize(new.numbers.len(), Vertex::default());
        new
    }

    /// Sets the covariance relative to the first pose of the map. It is 0 where it could not be computed.
    fn set_covariance(&mut self, keyframe: &MapPose) {
        if let Some(&vertex) = self.numbers.get(&keyframe.id) {
            let is_known = |covariance: &[f64; 6]| covariance.iter().any(|entry| *entry != 0.0);
            self.vertices[vertex].covariance = keyframe.covariance.filter(is_known);
        }
    }

    /// The vertex of a keyframe. `known` are the stamps, segments and vertices of the registered scans of its
    /// log, by stamp. Without a vertex of its own, the keyframe becomes a vertex between the registered
    /// scans before and after it: its errors relative to both are at most those between the two.
    fn of_keyframe(
        &mut self,
        keyframe: &Keyframe,
        known: &[(i64, u32, usize)],
        optimized: &Trajectory,
    ) -> usize {
        if let Some(&vertex) = self.numbers.get(&keyframe.id) {
            return vertex;
        }
        let vertex = self.vertices.len();
        self.vertices.push(Vertex::default());
        let after = known.partition_point(|&(stamp_ns, ..)| stamp_ns <= keyframe.stamp_ns);
        let neighbours = after.checked_sub(1).map(|k| known[k]).zip(known.get(after));
        let Some(((before_ns, before, a), &(after_ns, next, b))) = neighbours else {
            return vertex;
        };
        let covariance = self.between.get(&(a, b)).copied();
        let Some(covariance) = covariance.filter(|_| before == next && before == keyframe.segment)
        else {
            return vertex;
        };
        for (stamp_ns, other) in [(before_ns, a), (after_ns, b)] {
            if let Ok(pose) = optimized.pose_at(stamp_ns, 0) {
                let a_from_b = pose.inverse() * keyframe.pose;
                self.measurements.push(Measurement { a: other, b: vertex, a_from_b, covariance });
            }
        }
        vertex
    }
}
