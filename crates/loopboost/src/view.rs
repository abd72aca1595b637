//! `view`: writes the results of loop detection for Foxglove and for `map_server`.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use ::view::{ClosureLine, Grid, MapPart, Overlay, PlacedScan, ViewError, layout, write_overlay};
use anyhow::{Context, Result, anyhow};
use clap::Args;
use dataset::tables::{
    TableError, digest_file, read_closures, read_poses, read_registered, read_trajectory,
    write_atomically, write_file,
};
use dataset::{JudgedClosure, MapPose, Pose2, RegisteredScan, Scan, ScanId, Trajectory};

use crate::drives::scans_of;
use crate::findings::Findings;
use crate::stage::Artifact;

#[derive(Args)]
pub(crate) struct ViewArgs {
    /// A run folder with the results of `optimize`
    run: PathBuf,
    /// The folder to write to; created if missing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The frame of the lidar, as the log names it
    #[arg(long, value_name = "FRAME", default_value = "loopboost_lidar")]
    lidar_frame: String,
}

/// The tables of a run about all logs.
struct Tables {
    closures: Vec<JudgedClosure>,
    keyframes: Vec<MapPose>,
}

impl Tables {
    fn has_log(&self, log: &str) -> bool {
        self.keyframes.iter().any(|keyframe| *keyframe.id.log == *log)
    }
}

/// The tables of a log.
struct LogTables {
    /// Optimized poses at every scan.
    trajectory: Trajectory,
    registered: Vec<RegisteredScan>,
    /// The scans of `registered`.
    scans: Vec<Scan>,
}

impl ViewArgs {
    pub(crate) fn execute(&self) -> Result<Findings> {
        let path = |artifact: Artifact, log: &str| self.run.join(artifact.name(log));
        let once = [Artifact::Closures, Artifact::Trajectory].map(|artifact| path(artifact, ""));
        let tables = Tables {
            closures: read_closures(&once[0])?.0,
            keyframes: read_trajectory(&once[1])?.0,
        };
        let mut logs: BTreeMap<Arc<str>, LogTables> = BTreeMap::new();
        for MapPose { id, .. } in &tables.keyframes {
            if !logs.contains_key(&id.log) {
                let (registered, _) = read_registered(&path(Artifact::Registered, &id.log))?;
                let numbers: Vec<u32> = registered.iter().map(|row| row.id.scan).collect();
                let scans = scans_of(&path(Artifact::Scans, &id.log), &numbers)?;
                let (trajectory, _) = read_poses(&path(Artifact::ScanTrajectory, &id.log))?;
                logs.insert(id.log.clone(), LogTables { trajectory, registered, scans });
            }
        }
        let mut in_map: BTreeMap<u32, Vec<PlacedScan<'_>>> = BTreeMap::new();
        for (log, of_log) in &logs {
            let parts = parts(&tables, log, of_log)?;
            for part in &parts {
                in_map.entry(part.map).or_default().extend(&part.scans);
            }
            let per_log = [Artifact::Registered, Artifact::ScanTrajectory, Artifact::Scans];
            let per_log = per_log.map(|artifact| path(artifact, log));
            let inputs = digests(&self.run, once.iter().chain(&per_log))?;
            self.write_log(log, &parts, &inputs)?;
        }
        for (map, scans) in &in_map {
            let grid = Grid::new(scans).with_context(|| format!("map {map}"))?;
            let image = format!("map_{map}.png");
            write_file(&self.out.join(&image), &grid.png()?)?;
            write_file(&self.out.join(format!("map_{map}.yaml")), grid.yaml(&image).as_bytes())?;
            out!("{}: {} scans", self.out.join(&image).display(), scans.len());
        }
        Ok(Findings::default())
    }

    /// Writes the overlay and the layout of a log.
    fn write_log(
        &self,
        log: &str,
        parts: &[MapPart<'_>],
        inputs: &BTreeMap<String, String>,
    ) -> Result<()> {
        let folder = self.out.join(log);
        std::fs::create_dir_all(&folder)
            .with_context(|| format!("cannot create folder {}", folder.display()))?;
        let file = folder.join("overlay.mcap");
        let overlay = Overlay { lidar_frame: &self.lidar_frame, parts, inputs };
        let summary = write_atomically(&file, |mut out: BufWriter<File>| {
            let summary = write_overlay(&mut out, &overlay)?;
            Ok::<_, WriteOverlay>((out, summary))
        })
        .map_err(|error| match error {
            WriteOverlay::View(error) => anyhow::Error::from(error).context(format!("log `{log}`")),
            WriteOverlay::Table(error) => error.into(),
        })?;
        if let Some(part) = parts.first() {
            let text = serde_json::to_string_pretty(&layout(part.map))?;
            write_file(&folder.join("layout.json"), text.as_bytes())?;
        }
        out!(
            "{}: {} accepted and {} rejected closures, {} transforms",
            file.display(),
            summary.n_accepted,
            summary.n_rejected,
            summary.n_transforms
        );
        Ok(())
    }
}

/// The parts of a log, one per segment with a keyframe.
fn parts<'a>(tables: &'a Tables, log: &str, of_log: &'a LogTables) -> Result<Vec<MapPart<'a>>> {
    let keyframe: HashMap<&ScanId, &MapPose> =
        tables.keyframes.iter().map(|keyframe| (&keyframe.id, keyframe)).collect();
    let mut parts = Vec::new();
    let segments = of_log.registered.chunk_by(|a, b| a.segment == b.segment);
    let mut scans = of_log.scans.iter();
    for rows in segments {
        let first = &rows[0];
        let keyframes: Vec<&MapPose> = tables
            .keyframes
            .iter()
            .filter(|k| *k.id.log == *log && k.segment == first.segment)
            .collect();
        let placed =
            placed(rows, &mut scans, &of_log.trajectory).with_context(|| format!("log `{log}`"))?;
        let Some(map) = keyframes.first().map(|keyframe| keyframe.map) else {
            out!("log `{log}`: segment {} has no keyframe and is not shown", first.segment);
            continue;
        };
        let in_map = |of: fn(&RegisteredScan) -> Pose2| {
            let map_from_other = placed[0].pose * of(first).inverse();
            rows.iter().map(|row| map_from_other * of(row)).collect()
        };
        let is_here = |id: &ScanId| {
            keyframe.get(id).is_some_and(|k| *k.id.log == *log && k.segment == first.segment)
        };
        let closures = (0..).zip(&tables.closures).filter(|(_, c)| is_here(&c.closure.query));
        // A log that was added to the map of another run has closures with the logs of that run.
        let leads_elsewhere = |c: &JudgedClosure| match keyframe.get(&c.closure.reference) {
            Some(reference) => !c.is_accepted() && reference.map != map,
            None => !tables.has_log(&c.closure.reference.log),
        };
        let (elsewhere, closures): (Vec<_>, Vec<_>) =
            closures.partition(|(_, c)| leads_elsewhere(c));
        if !elsewhere.is_empty() {
            out!(
                "log `{log}`: {} closures lead to other maps or runs and are not shown",
                elsewhere.len()
            );
        }
        let closures = closures.into_iter();
        let lines = closures.map(|(row, closure)| line(row, closure, map, &keyframe));
        let all_poses = of_log.trajectory.poses().iter();
        parts.push(MapPart {
            map,
            closures: lines.collect::<Result<_>>()?,
            keyframes,
            odometry: in_map(|row| row.odometry),
            scan_matching: in_map(|row| row.pose),
            scans: placed,
            poses: all_poses.filter(|pose| pose.segment == first.segment).copied().collect(),
        });
    }
    Ok(parts)
}

/// The registered scans of a segment with their optimized poses.
fn placed<'a>(
    rows: &[RegisteredScan],
    scans: &mut impl Iterator<Item = &'a Scan>,
    trajectory: &Trajectory,
) -> Result<Vec<PlacedScan<'a>>> {
    let of_row = |(row, scan): (&RegisteredScan, &'a Scan)| {
        let stamp_ns = row.stamp_ns;
        let pose = trajectory
            .pose_at(stamp_ns, 0)
            .with_context(|| format!("scan {} has no optimized pose", row.id.scan))?;
        Ok(PlacedScan { stamp_ns, pose, scan })
    };
    rows.iter().zip(scans).map(of_row).collect()
}

fn line<'a>(
    row: usize,
    closure: &'a JudgedClosure,
    map: u32,
    keyframe: &HashMap<&ScanId, &MapPose>,
) -> Result<ClosureLine<'a>> {
    let end = |id: &ScanId| {
        let found = keyframe.get(id).filter(|keyframe| keyframe.map == map);
        found.map(|keyframe| keyframe.pose).ok_or_else(|| {
            anyhow!(
                "closures.parquet: row {row}: scan {} of log `{}` is not a keyframe of map {map} in trajectory.parquet",
                id.scan,
                id.log
            )
        })
    };
    let ends = [end(&closure.closure.query)?, end(&closure.closure.reference)?];
    Ok(ClosureLine { row, closure, ends })
}

/// The digests of tables, by their names in the run folder.
fn digests<'a>(
    run: &Path,
    tables: impl Iterator<Item = &'a PathBuf>,
) -> Result<BTreeMap<String, String>> {
    tables
        .map(|path| {
            let name = path.strip_prefix(run).unwrap_or(path).to_string_lossy().into_owned();
            Ok((name, digest_file(path)?))
        })
        .collect()
}

/// What can go wrong while an overlay is written.
enum WriteOverlay {
    View(ViewError),
    Table(TableError),
}

impl From<ViewError> for WriteOverlay {
    fn from(error: ViewError) -> Self {
        Self::View(error)
    }
}

impl From<TableError> for WriteOverlay {
    fn from(error: TableError) -> Self {
        Self::Table(error)
    }
}
