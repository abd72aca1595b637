use std::collections::HashSet;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Result;
use dataset::tables::{Provenance, read_keyframes, write_odometry, write_registered};
use dataset::{Note, NoteKind, Pose2, RangeLimits, RegisteredScan, ScanId, Subject};
use model::OdometryNoise;
use rayon::prelude::*;
use register::{
    OdometryModel, OdometryScan, RegisterOptions, is_decided, register_drive, scans_to_register,
};

use crate::drives::{
    DEGENERATE_RATIO, PosedScan, posed_scans, registration_limits, upper_triangle,
};
use crate::findings::Findings;
use crate::logs::LogFile;
use crate::partitions::remove_other_logs;
use crate::run::{Done, Run, Task};
use crate::scan_cache::ScanCache;
use crate::stage::{Artifact, Stage};
use crate::summary::Summary;

/// Scans and poses -> registered/LOG.parquet, odometry/LOG.parquet
///
/// Each segment of a log is registered by itself. Where the scans suddenly show another place, a new segment begins.
pub(crate) fn run(run: &Run) -> Result<Findings> {
    let findings = of_logs(run, &run.ingested_logs()?)?;
    remove_other_logs(run, Artifact::Odometry)?;
    Ok(findings)
}

/// The registered scans of logs.
pub(crate) fn of_logs(run: &Run, logs: &[LogFile]) -> Result<Findings> {
    let tasks: Vec<Task> =
        logs.iter().map(|log| run.task_of_log(Stage::Register, &log.name)).collect();
    // Enough for all threads to be busy most of the time, and few enough that little is lost if the run is killed.
    run.tasks(&tasks, 8 * rayon::current_num_threads(), |pending| {
        let of_pending: Vec<_> = pending.iter().map(|(k, from)| (&logs[*k], from)).collect();
        register(run, &of_pending)
    })
}

fn register(run: &Run, logs: &[(&LogFile, &Provenance)]) -> Result<Vec<Done>> {
    let mut segments = Vec::new();
    let mut keyframes: HashSet<ScanId> = HashSet::new();
    for (log, _) in logs {
        let (of_log, _) = read_keyframes(&run.path_of_log(Artifact::Keyframes, &log.name))?;
        keyframes.extend(of_log.into_iter().map(|keyframe| keyframe.id));
        segments.extend(Segment::of_log(run, log)?);
    }
    // A short drive is one stretch, which keeps a single thread busy, so drives are registered in parallel.
    let options = &run.config.register;
    let cache = &run.scan_cache;
    let register = |segment: &Segment| segment.register(cache, options, &keyframes);
    let registered: Vec<RegisteredSegment> =
        segments.par_iter().map(register).collect::<Result<_>>()?;
    cache.check()?;
    let breaks: Vec<(RegisteredScan, usize)> =
        registered.iter().flat_map(RegisteredSegment::breaks).collect();
    let mut registered = registered.into_iter().flat_map(|segment| segment.rows).peekable();

    let mut all = Vec::new();
    for (log, provenance) in logs {
        let mut rows = Vec::new();
        while let Some(row) = registered.next_if(|row| row.id.log == log.name) {
            rows.push(row);
        }
        split(&mut rows, &breaks);
        let mut done = Done::default();
        done.notes.extend(notes(run, log, &rows));
        done.notes.extend(other_places(log, &breaks));
        done.notes.extend(odometry_bias(run, log, &rows));
        done.summaries.push(summary(log, &rows));
        let provenance = Provenance { notes: done.notes.clone(), ..(*provenance).clone() };
        done.outputs = [Artifact::Registered, Artifact::Odometry]
            .map(|artifact| run.path_of_log(artifact, &log.name))
            .to_vec();
        write_registered(&done.outputs[0], &provenance, &rows)?;
        rows.retain(|row| row.is_keyframe);
        write_odometry(&done.outputs[1], &provenance, &rows)?;
        all.push(done);
    }
    Ok(all)
}

/// A continuous piece of a log, before its registration.
struct Segment {
    log: Arc<str>,
    /// The table of the scans of the log.
    table: PathBuf,
    /// The scans that can be used, with their poses.
    scans: Vec<PosedScan>,
    limits: RangeLimits,
    noise: OdometryNoise,
}

impl Segment {
    fn of_log(run: &Run, log: &LogFile) -> Result<Vec<Self>> {
        let limits = registration_limits(&run.config, &log.name)?;
        let segments = posed_scans(run, &log.name)?.into_iter().map(|mut scans| {
            scans.retain(|scan| scan.is_usable);
            Self {
                log: log.name.clone(),
                table: run.scans(&log.name),
                scans,
                limits,
                noise: run.detector().odometry,
            }
        });
        Ok(segments.filter(|segment| !segment.scans.is_empty()).collect())
    }

    fn register(
        &self,
        cache: &Arc<ScanCache>,
        options: &RegisterOptions,
        keyframes: &HashSet<ScanId>,
    ) -> Result<RegisteredSegment> {
        let id = |scan: u32| ScanId { log: self.log.clone(), scan };
        let of_segment = self.scans.iter().map(|posed| OdometryScan {
            odometry: posed.odometry.pose,
            coverage_deg: posed.coverage_deg,
            is_keyframe: keyframes.contains(&id(posed.scan)),
        });
        let of_segment: Vec<OdometryScan> = of_segment.collect();
        let chosen = scans_to_register(&of_segment, options);
        let numbers: Vec<u32> = chosen.iter().map(|&k| self.scans[k].scan).collect();
        let odometry: Vec<Pose2> = chosen.iter().map(|&k| of_segment[k].odometry).collect();
        let scans = cache.open(&self.table, &numbers, self.limits)?;
        let registered = register_drive(&scans, &odometry, &self.noise, &options.matcher);

        let (mut travel_m, mut last) = (0.0, None);
        let rows = registered.iter().zip(chosen).map(|(registered, chosen)| {
            let (from, posed) = (&of_segment[chosen], &self.scans[chosen]);
            travel_m += last.map_or(0.0, |last| from.odometry.distance_m(&last));
            last = Some(from.odometry);
            let weakness = registered.weakness.map(|weakness| weakness.ratio);
            RegisteredScan {
                id: id(posed.scan),
                stamp_ns: posed.odometry.stamp_ns,
                pose: registered.pose,
                covariance: registered.covariance.as_ref().map(upper_triangle),
                odometry: from.odometry,
                near_share: registered.near_share,
                weakness,
                is_degenerate: weakness.is_some_and(|ratio| ratio < DEGENERATE_RATIO),
                is_keyframe: from.is_keyframe,
                segment: posed.odometry.segment,
                travel_m,
            }
        });
        let rows = rows.collect();
        let of_break = registered.iter().enumerate().filter(|(_, scan)| scan.is_break);
        // Also those that cannot be used.
        let number = |k: usize| numbers[k] as usize;
        let n_since = |k: usize| number(k).saturating_sub(number(k - 1) + 1);
        Ok(RegisteredSegment { rows, breaks: of_break.map(|(k, _)| (k, n_since(k))).collect() })
    }
}

/// The registered scans of a segment.
struct RegisteredSegment {
    rows: Vec<RegisteredScan>,
    /// The rows from which on the scans show another place, each with the number of scans between it and the row
    /// before.
    breaks: Vec<(usize, usize)>,
}

impl RegisteredSegment {
    fn breaks(&self) -> impl Iterator<Item = (RegisteredScan, usize)> + '_ {
        self.breaks.iter().map(|&(k, n_between)| (self.rows[k].clone(), n_between))
    }
}

/// Begins a new segment with each of the breaks.
fn split(rows: &mut [RegisteredScan], breaks: &[(RegisteredScan, usize)]) {
    let breaks: HashSet<&ScanId> = breaks.iter().map(|(row, _)| &row.id).collect();
    let (mut n_breaks, mut from_m, mut last) = (0, 0.0, None);
    for row in rows {
        if last != Some(row.segment) {
            (from_m, last) = (0.0, Some(row.segment));
        }
        if breaks.contains(&row.id) {
            (n_breaks, from_m) = (n_breaks + 1, row.travel_m);
        }
        row.segment += n_breaks;
        row.travel_m -= from_m;
    }
}

/// A remark about scans of a log that show another place than those before.
fn other_places(log: &LogFile, breaks: &[(RegisteredScan, usize)]) -> Option<Note> {
    let of_log: Vec<_> = breaks.iter().filter(|(row, _)| row.id.log == log.name).collect();
    let (first, _) = of_log.first()?;
    let kind = NoteKind::ScansOfAnotherPlace {
        n_times: of_log.len() as u64,
        n_between: of_log.iter().map(|(_, n_between)| *n_between as u64).sum(),
        first_secs: first.stamp_ns as f64 * 1e-9,
        travel_m: first.travel_m,
    };
    Some(Note::new(kind, Subject::log(&*log.name)))
}

/// A scan is matched poorly if less than this share of its points is near a point of the last metres.
/// Scans of a robot that drives into unknown space have 0.7 and more.
const POOR_NEAR_SHARE: f64 = 0.5;
/// Poor matches over less than this path are not reported \[m\]: the map has caught up by then.
const MIN_POOR_M: f64 = 5.0;

/// Remarks about short segments, and about stretches in which scans were matched poorly.
fn notes(run: &Run, log: &LogFile, rows: &[RegisteredScan]) -> Vec<Note> {
    let min_path_m = run.config.detection().min_path_m;
    let segments: Vec<_> = rows.chunk_by(|a, b| a.segment == b.segment).collect();
    let length_m = |rows: &[RegisteredScan]| rows.last().map_or(0.0, |row| row.travel_m);
    let n_short = segments.iter().filter(|rows| length_m(rows) < min_path_m).count() as u64;
    let mut poor_m = Vec::new();
    for rows in segments {
        let is_poor = |row: &RegisteredScan| row.near_share < POOR_NEAR_SHARE;
        let stretches = rows.chunk_by(|a, b| is_poor(a) == is_poor(b));
        poor_m.extend(stretches.filter(|rows| is_poor(&rows[0])).filter_map(|rows| {
            let length_m = rows[rows.len() - 1].travel_m - rows[0].travel_m;
            (MIN_POOR_M <= length_m).then_some(length_m)
        }));
    }
    let short =
        (0 < n_short).then_some(NoteKind::ShortSegments { n_segments: n_short, min_path_m });
    let poor = (!poor_m.is_empty()).then(|| NoteKind::PoorScanMatching {
        n_stretches: poor_m.len() as u64,
        length_m: poor_m.iter().sum(),
        near_share: POOR_NEAR_SHARE,
    });
    let of_log = |kind| Note::new(kind, Subject::log(&*log.name));
    short.into_iter().chain(poor).map(of_log).collect()
}

/// Smaller systematic errors of the odometry are not reported: share of the path, share of a turn, and
/// turn per metre.
const MAX_SCALE_ERROR: f64 = 0.05;
const MAX_TURN_SCALE_ERROR: f64 = 0.1;
const MAX_TURN_DEG_PER_M: f64 = 2.0;

/// The largest systematic error of the odometry in a segment of the log, if it is worth a remark.
fn odometry_bias(run: &Run, log: &LogFile, rows: &[RegisteredScan]) -> Option<Note> {
    let of_segment = |rows: &[RegisteredScan]| {
        let odometry: Vec<Pose2> = rows.iter().map(|row| row.odometry).collect();
        let poses: Vec<Pose2> = rows.iter().map(|row| row.pose).collect();
        let is_decided: Vec<bool> =
            rows.iter().map(|row| is_decided(row.near_share, row.weakness)).collect();
        OdometryModel::of_drive(&odometry, &poses, &is_decided, &run.detector().odometry)
    };
    let size = |model: &OdometryModel| {
        let turn_deg_per_m = model.turn_rad_per_m.to_degrees();
        ((model.scale - 1.0).abs() / MAX_SCALE_ERROR)
            .max((model.turn_scale - 1.0).abs() / MAX_TURN_SCALE_ERROR)
            .max(turn_deg_per_m.abs() / MAX_TURN_DEG_PER_M)
    };
    let models = rows.chunk_by(|a, b| a.segment == b.segment).map(of_segment);
    let largest = models.max_by(|a, b| size(a).total_cmp(&size(b)))?;
    let kind = NoteKind::OdometryBias {
        scale: largest.scale,
        turn_scale: largest.turn_scale,
        turn_deg_per_m: largest.turn_rad_per_m.to_degrees(),
    };
    (1.0 < size(&largest)).then(|| Note::new(kind, Subject::log(&*log.name)))
}

fn summary(log: &LogFile, rows: &[RegisteredScan]) -> Summary {
    let segments = rows.chunk_by(|a, b| a.segment == b.segment);
    Summary::Registered {
        log: log.name.to_string(),
        n_scans: rows.len() as u64,
        n_degenerate: rows.iter().filter(|row| row.is_degenerate).count() as u64,
        length_m: segments.map(|rows| rows[rows.len() - 1].travel_m).sum(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(scan: u32, segment: u32, travel_m: f64) -> RegisteredScan {
        RegisteredScan {
            id: ScanId { log: "monday".into(), scan },
            stamp_ns: i64::from(scan),
            pose: Pose2::default(),
            covariance: None,
            odometry: Pose2::default(),
            near_share: 1.0,
            weakness: None,
            is_degenerate: false,
            is_keyframe: true,
            segment,
            travel_m,
        }
    }

    /// A log in two segments. The first one has two breaks.
    #[test]
    fn segments_are_split_and_numbered_in_order() {
        let mut rows: Vec<RegisteredScan> = (0..6).map(|k| row(k, 0, f64::from(k))).collect();
        rows.extend((6..8).map(|k| row(k, 1, f64::from(k - 6))));
        let breaks = [(rows[2].clone(), 0), (rows[5].clone(), 3)];
        split(&mut rows, &breaks);
        let found: Vec<(u32, f64)> = rows.iter().map(|row| (row.segment, row.travel_m)).collect();
        let expected =
            [(0, 0.0), (0, 1.0), (1, 0.0), (1, 1.0), (1, 2.0), (2, 0.0), (3, 0.0), (3, 1.0)];
        assert_eq!(found, expected);
    }
}
