//! The absolute references of a site: fixes and poses of its logs and of files, as measurements of scans.

use std::path::PathBuf;

use anyhow::{Context, Result};
use dataset::tables::read_poses;
use dataset::{Losses, Note, NoteKind, Pose2, StampedPose, Subject, Trajectory};
use ingest::{Fix, IngestError, Log, Origin, ReferenceMessages, read_references};
use nalgebra::Matrix3;
use optimize::{Reference, n_correlated};

use crate::config::usage;
use crate::drives::{RegisteredDrive, matrix};
use crate::logs::{LogFile, file_name};
use crate::reference_file::{self, Surveyed};
use crate::reference_options::ReferenceOptions;
use crate::run::{Run, missing_log};
use crate::site_drives::SiteDrives;
use crate::stages::ingest::open;

/// Standard deviation of a fix without a covariance in each direction \[m\]: the GPS Standard Positioning Service
/// Performance Standard (5th edition, 2020, table 3.8-3) promises a horizontal error of 8 m or less in 95 % of all
/// cases, which is 2.45 standard deviations of a circular error.
const FIX_STD_M: f64 = 3.3;
/// Standard deviation that is added to all \[m\]: the odometry between two scans is interpolated.
const LEAST_STD_M: f64 = 0.01;
/// The same for headings \[rad\].
const LEAST_STD_RAD: f64 = 1e-3;
/// A larger standard deviation of a heading means that it is not known \[rad\].
const MAX_HEADING_STD_RAD: f64 = 1.0;

/// The references of the drives of a site.
#[derive(Debug, Default)]
pub(crate) struct SiteReferences {
    /// The origin of their frame, if there is one on the earth.
    pub(crate) origin: Option<Origin>,
    /// For each drive of the site. Those of the known map have none.
    pub(crate) of_drives: Vec<Vec<DriveReference>>,
    pub(crate) losses: Losses,
    pub(crate) notes: Vec<Note>,
}

/// A reference to a scan of a drive.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DriveReference {
    /// Number of the entry of `optimize.references`.
    pub(crate) source: usize,
    pub(crate) reference: Reference,
}

/// What a source gives for a log.
struct OfLog<'a> {
    log: &'a LogFile,
    source: usize,
    values: Values,
    lidar_from_point: Pose2,
}

enum Values {
    Fixes(Vec<Fix>),
    Poses(Vec<Measured>),
}

/// A measured pose in the frame of the references.
#[derive(Debug, Clone, Copy)]
struct Measured {
    stamp_ns: i64,
    pose: Pose2,
    has_heading: bool,
    covariance: Matrix3<f64>,
}

/// The files that the references of a run are read from.
pub(crate) fn inputs(run: &Run) -> Result<Vec<PathBuf>> {
    let mut inputs = Vec::new();
    for log in run.ingested_logs()? {
        for options in &run.config.optimize.references {
            match file_of(run, options, &log) {
                Some(path) => inputs.extend(Some(path).filter(|path| path.exists())),
                None => inputs.extend(log.paths.clone()),
            }
        }
    }
    inputs.sort();
    inputs.dedup();
    Ok(inputs)
}

impl SiteReferences {
    /// Reads the references of the logs of a site.
    pub(crate) fn read(run: &Run, site: &SiteDrives) -> Result<Self> {
        let options = &run.config.optimize.references;
        let mut read = Self { of_drives: vec![Vec::new(); site.drives.len()], ..Self::default() };
        let mut of_logs = Vec::new();
        for log in &site.logs {
            for (source, options) in options.iter().enumerate() {
                let found = match &options.topic {
                    Some(_) => read.of_topic(run, log, options)?,
                    None => read.of_file(run, log, options)?,
                };
                of_logs.extend(found.map(|(values, lidar_from_point)| OfLog {
                    log,
                    source,
                    values,
                    lidar_from_point,
                }));
            }
        }
        read.origin = origin(run, site, &of_logs)?;
        for of_log in of_logs {
            read.add(run, site, &options[of_log.source], of_log)?;
        }
        Ok(read)
    }

    fn of_topic(
        &mut self,
        run: &Run,
        log: &LogFile,
        options: &ReferenceOptions,
    ) -> Result<Option<(Values, Pose2)>> {
        let Some(topic) = options.of_topic() else { return Ok(None) };
        if let Some(missing) = log.paths.iter().find(|path| !path.exists()) {
            return Err(missing_log(missing));
        }
        let lidar = run.config.for_log(&log.name)?.lidar;
        // Losses of the files were counted when the scans were read.
        let (logs, _) = open(log)?;
        let subject = Subject::topic(&topic.topic).in_log(&*log.name);
        let read = match read_references(&logs.iter().collect::<Vec<&Log>>(), &lidar, &topic) {
            Ok(read) => read,
            Err(error @ (IngestError::NoTopic { .. } | IngestError::NoPoses { .. })) => {
                let reason = error.to_string();
                self.notes.push(Note::new(NoteKind::LogWithoutReferences { reason }, subject));
                return Ok(None);
            }
            Err(error) => return Err(error.into()),
        };
        let ReferenceMessages { fixes, poses, lidar_from_point, is_point_known, losses, notes } =
            read;
        self.losses.merge(losses.in_log(&log.name));
        self.notes.extend(notes.into_iter().map(|note| {
            let subject = note.subject.in_log(&*log.name);
            Note { subject, ..note }
        }));
        if !is_point_known {
            self.notes.push(Note::new(NoteKind::ReferencePointUnknown, subject));
        }
        let values = match fixes.is_empty() {
            false => Values::Fixes(fixes),
            true => Values::Poses(of_poses(&poses, options, &log.name)?),
        };
        Ok(Some((values, lidar_from_point)))
    }

    fn of_file(
        &mut self,
        run: &Run,
        log: &LogFile,
        options: &ReferenceOptions,
    ) -> Result<Option<(Values, Pose2)>> {
        let Some(path) = file_of(run, options, log) else { return Ok(None) };
        let subject = Subject::file(file_name(&path)).in_log(&*log.name);
        let is_of_log = options.file.as_ref().is_some_and(|file| file.contains("{log}"));
        if is_of_log && !path.exists() {
            let reason = format!("{} does not exist", path.display());
            self.notes.push(Note::new(NoteKind::LogWithoutReferences { reason }, subject));
            return Ok(None);
        }
        let rows = reference_file::read(&path)?;
        let n_logs = run.ingested_logs()?.len();
        if !is_of_log && 1 < n_logs && rows.iter().any(|row| row.log.is_none()) {
            return Err(usage(format!(
                "{}: rows without a log, but the run has {n_logs} logs; add a column `log`, or use `{{log}}` in the name of the file",
                path.display()
            )));
        }
        self.note_other_logs(run, log, &rows, &subject)?;
        let is_wanted = |row: &&Surveyed| row.log.as_deref().is_none_or(|name| *name == *log.name);
        let measured: Vec<Measured> = rows
            .iter()
            .filter(is_wanted)
            .map(|row| of_row(row, options, &path.display().to_string()))
            .collect::<Result<_>>()?;
        if measured.is_empty() {
            let reason = format!("{} has no row of this log", path.display());
            self.notes.push(Note::new(NoteKind::LogWithoutReferences { reason }, subject));
            return Ok(None);
        }
        let mount = options.mount.map_or(Pose2::default(), |mount| mount.pose());
        let lidar = run.config.for_log(&log.name)?.lidar.mount;
        let base_from_lidar = lidar.map_or(Pose2::default(), |mount| mount.pose());
        Ok(Some((Values::Poses(measured), base_from_lidar.inverse() * mount)))
    }

    /// Says once per file that rows are of logs that the run does not have.
    fn note_other_logs(
        &mut self,
        run: &Run,
        log: &LogFile,
        rows: &[Surveyed],
        subject: &Subject,
    ) -> Result<()> {
        let logs = run.ingested_logs()?;
        if logs.first().is_none_or(|first| first.name != log.name) {
            return Ok(());
        }
        let is_other = |name: &&str| logs.iter().all(|log| *log.name != **name);
        let others: Vec<&str> =
            rows.iter().filter_map(|row| row.log.as_deref()).filter(is_other).collect();
        if let Some(first) = others.first() {
            let kind = NoteKind::ReferencesOfOtherLogs {
                n_references: others.len() as u64,
                example: (*first).to_owned(),
            };
            self.notes.push(Note::new(kind, subject.clone()));
        }
        Ok(())
    }

    /// Adds the references of a source to the drives of a log.
    fn add(
        &mut self,
        run: &Run,
        site: &SiteDrives,
        options: &ReferenceOptions,
        of_log: OfLog<'_>,
    ) -> Result<()> {
        let OfLog { log, source, values, lidar_from_point } = of_log;
        let mut measured = match (values, &self.origin) {
            (Values::Poses(measured), _) => measured,
            (Values::Fixes(fixes), Some(origin)) => {
                fixes.iter().map(|fix| of_fix(fix, origin, options)).collect()
            }
            (Values::Fixes(_), None) => return Ok(()),
        };
        measured.sort_by_key(|measured| measured.stamp_ns);
        let stamps_ns: Vec<i64> = measured.iter().map(|measured| measured.stamp_ns).collect();
        let n_correlated = n_correlated(&stamps_ns, options.correlation_secs());
        let (odometry, _) = read_poses(&run.poses(&log.name))?;
        let max_gap_ns = (run.config.subsample.max_pose_gap_secs * 1e9) as i64;
        let mut n_outside = 0;
        for (measured, n_correlated) in measured.iter().zip(n_correlated) {
            let at = site.drives.iter().enumerate().skip(site.n_known()).find_map(|(k, drive)| {
                let is_of_log = drive.log() == Some(&log.name);
                let scan = is_of_log.then(|| scan_at(drive, measured.stamp_ns))??;
                Some((k, scan, way_since(drive, scan, measured.stamp_ns, &odometry, max_gap_ns)?))
            });
            let Some((drive, scan, scan_from_lidar)) = at else {
                n_outside += 1;
                continue;
            };
            let Measured { stamp_ns, pose, has_heading, covariance } = *measured;
            let reference = Reference {
                stamp_ns,
                scan,
                scan_from_point: scan_from_lidar * lidar_from_point,
                measured: pose,
                has_heading,
                covariance,
                n_correlated,
            };
            self.of_drives[drive].push(DriveReference { source, reference });
        }
        if 0 < n_outside {
            let kind = match n_outside < measured.len() {
                true => NoteKind::ReferencesOutsideDrive {
                    n_outside: n_outside as u64,
                    n_references: measured.len() as u64,
                },
                false => NoteKind::LogWithoutReferences { reason: outside(site, log, &stamps_ns) },
            };
            self.notes.push(Note::new(kind, subject_of(options, &log.name)));
        }
        Ok(())
    }
}

/// The subject of notes about the references of a log.
pub(crate) fn subject_of(options: &ReferenceOptions, log: &str) -> Subject {
    let of_source = match options.topic {
        Some(_) => Subject::topic(options.name()),
        None => Subject::file(file_name(&PathBuf::from(options.name().replace("{log}", log)))),
    };
    of_source.in_log(log)
}

fn file_of(run: &Run, options: &ReferenceOptions, log: &LogFile) -> Option<PathBuf> {
    let file = options.file.as_ref()?.replace("{log}", &log.name);
    Some(run.config.beside_pipeline(&file))
}

/// The origin of the pipeline, or that of the known map, or the first fix.
fn origin(run: &Run, site: &SiteDrives, of_logs: &[OfLog<'_>]) -> Result<Option<Origin>> {
    let set = run.config.optimize.origin;
    let known = site.known_frame.and_then(|(_, origin)| origin);
    if let (Some(set), Some(known)) = (set, known)
        && set != known
    {
        return Err(usage(format!(
            "`optimize.origin` is latitude {}, longitude {}, altitude {}, but that of the map in `detect.maps` is latitude {}, longitude {}, altitude {}; remove `optimize.origin`",
            set.latitude_deg,
            set.longitude_deg,
            set.altitude_m,
            known.latitude_deg,
            known.longitude_deg,
            known.altitude_m
        )));
    }
    let first = of_logs.iter().find_map(|of_log| match &of_log.values {
        Values::Fixes(fixes) => fixes.first(),
        Values::Poses(_) => None,
    });
    if let (Some(_), Some((number, None)), None) = (first, site.known_frame, set) {
        return Err(usage(format!(
            "map {number} of `detect.maps` is in the frame of surveyed poses, whose place on the earth is not known, so that satellite fixes cannot be used; set `optimize.origin` to the origin of that frame, or remove the topic of fixes from `optimize.references`"
        )));
    }
    let of_fix = |fix: &Fix| {
        let altitude_m =
            if fix.position.altitude_m.is_finite() { fix.position.altitude_m } else { 0.0 };
        Origin { altitude_m, ..fix.position }
    };
    Ok(set.or(known).or(first.map(of_fix)))
}

fn of_fix(fix: &Fix, origin: &Origin, options: &ReferenceOptions) -> Measured {
    let of_std = |std_m: f64| [std_m * std_m, 0.0, std_m * std_m];
    let [xx, xy, yy] = match options.std_m {
        Some(std_m) => of_std(std_m),
        None => fix.covariance.unwrap_or(of_std(FIX_STD_M)),
    };
    Measured {
        stamp_ns: fix.stamp_ns,
        pose: fix.east_north(origin),
        has_heading: false,
        covariance: with_least([xx, xy, 0.0, yy, 0.0, 1.0]),
    }
}

fn of_poses(poses: &[StampedPose], options: &ReferenceOptions, log: &str) -> Result<Vec<Measured>> {
    let of_pose = |pose: &StampedPose| {
        let stated = pose.covariance.filter(is_covariance);
        let covariance = of_stds(stated, options.std_m, options.std_deg.map(f64::to_radians))
            .with_context(|| {
                format!(
                    "log `{log}`: a message of topic `{}` at {} ns has no valid covariance; set `std_m` in its entry of `optimize.references`",
                    options.name(),
                    pose.stamp_ns
                )
            })
            .map_err(usage)?;
        Ok(Measured { stamp_ns: pose.stamp_ns, pose: pose.pose, ..covariance })
    };
    poses.iter().map(of_pose).collect()
}

fn of_row(row: &Surveyed, options: &ReferenceOptions, file: &str) -> Result<Measured> {
    let std_rad = row.std_rad.or(options.std_deg.map(f64::to_radians));
    let std_rad = std_rad.filter(|_| row.has_heading);
    if row.has_heading && std_rad.is_none() {
        return Err(usage(format!(
            "{file}: the row of {} ns has a heading, but no `std_rad`; add the column, set `std_deg` in the entry of `optimize.references`, or remove the heading",
            row.stamp_ns
        )));
    }
    let covariance = of_stds(None, row.std_m.or(options.std_m), std_rad)
        .with_context(|| {
            format!(
                "{file}: the row of {} ns has no `std_m`; add the column, or set `std_m` in the entry of `optimize.references`",
                row.stamp_ns
            )
        })
        .map_err(usage)?;
    Ok(Measured { stamp_ns: row.stamp_ns, pose: row.pose, ..covariance })
}

/// The covariance from the stated one and the standard deviations that replace it, for a pose that is still missing.
/// `None` if that of the position is not known.
fn of_stds(stated: Option<[f64; 6]>, std_m: Option<f64>, std_rad: Option<f64>) -> Option<Measured> {
    let [mut xx, mut xy, mut xh, mut yy, mut yh, mut hh] = stated.unwrap_or_default();
    if let Some(std_m) = std_m {
        [xx, xy, xh, yy, yh] = [std_m * std_m, 0.0, 0.0, std_m * std_m, 0.0];
    } else if stated.is_none() {
        return None;
    }
    if let Some(std_rad) = std_rad {
        [xh, yh, hh] = [0.0, 0.0, std_rad * std_rad];
    }
    let has_heading = 0.0 < hh && hh <= MAX_HEADING_STD_RAD * MAX_HEADING_STD_RAD;
    if !has_heading {
        [xh, yh, hh] = [0.0, 0.0, 1.0];
    }
    let covariance = with_least([xx, xy, xh, yy, yh, hh]);
    Some(Measured { stamp_ns: 0, pose: Pose2::default(), has_heading, covariance })
}

/// Whether the position of a covariance is known, and the whole is a covariance.
fn is_covariance(covariance: &[f64; 6]) -> bool {
    let [xx, xy, _, yy, _, hh] = *covariance;
    // Without a variance, the heading is not known.
    let known = if 0.0 < hh { *covariance } else { [xx, xy, 0.0, yy, 0.0, 1.0] };
    0.0 < xx && 0.0 < yy && matrix(known).cholesky().is_some()
}

fn with_least(covariance: [f64; 6]) -> Matrix3<f64> {
    let least = LEAST_STD_M * LEAST_STD_M;
    let of_heading = LEAST_STD_RAD * LEAST_STD_RAD;
    matrix(covariance) + Matrix3::from_diagonal(&nalgebra::Vector3::new(least, least, of_heading))
}

/// The last registered scan at or before a time; `None` outside of the drive.
fn scan_at(drive: &RegisteredDrive, stamp_ns: i64) -> Option<usize> {
    let after = drive.rows.partition_point(|row| row.stamp_ns <= stamp_ns);
    let last = after.checked_sub(1)?;
    (after < drive.rows.len() || drive.rows[last].stamp_ns == stamp_ns).then_some(last)
}

/// The way of the lidar since a scan, by the odometry.
fn way_since(
    drive: &RegisteredDrive,
    scan: usize,
    stamp_ns: i64,
    odometry: &Trajectory,
    max_gap_ns: i64,
) -> Option<Pose2> {
    let pose = odometry.pose_at(stamp_ns, max_gap_ns).ok()?;
    Some(drive.rows[scan].odometry.inverse() * pose)
}

/// Says that no reference is within the time of a log.
fn outside(site: &SiteDrives, log: &LogFile, stamps_ns: &[i64]) -> String {
    let secs = |ns: i64| ns as f64 * 1e-9;
    let rows = || {
        let drives = site.drives.iter().skip(site.n_known());
        drives.filter(|drive| drive.log() == Some(&log.name)).flat_map(|drive| &drive.rows)
    };
    let [first, last] = [rows().next(), rows().last()].map(|row| row.map_or(0, |r| r.stamp_ns));
    let [from, to] =
        [stamps_ns.first(), stamps_ns.last()].map(|ns| ns.copied().unwrap_or_default());
    format!(
        "none of the {} references is within the time of the scans: the references are from {:.3} to {:.3} s, the scans from {:.3} to {:.3} s; check the clocks and that the references are of this log",
        stamps_ns.len(),
        secs(from),
        secs(to),
        secs(first),
        secs(last)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The variances of 0.01 m and 0.001 rad are added.
    #[test]
    fn stated_errors_are_replaced_by_those_of_the_options() {
        let stated = Some([0.25, 0.1, 0.01, 0.36, 0.02, 0.04]);
        let kept = of_stds(stated, None, None).unwrap();
        assert!(kept.has_heading);
        assert!((kept.covariance[(0, 0)] - 0.2501).abs() < 1e-12);
        assert_eq!(kept.covariance[(0, 1)], 0.1);
        assert!((kept.covariance[(2, 2)] - 0.040_001).abs() < 1e-12);
        let replaced = of_stds(stated, Some(2.0), None).unwrap();
        assert!((replaced.covariance[(1, 1)] - 4.0001).abs() < 1e-12);
        assert_eq!((replaced.covariance[(0, 1)], replaced.covariance[(0, 2)]), (0.0, 0.0));
        assert_eq!(of_stds(None, Some(2.0), None).map(|found| found.has_heading), Some(false));
        assert_eq!(of_stds(None, Some(2.0), Some(0.1)).map(|found| found.has_heading), Some(true));
        // A heading that can be anything is not known, and a position without a standard deviation is not used.
        let vague = Some([0.25, 0.0, 0.0, 0.25, 0.0, 9.9]);
        assert_eq!(of_stds(vague, None, None).map(|found| found.has_heading), Some(false));
        assert!(of_stds(None, None, Some(0.1)).is_none());
    }

    #[test]
    fn zeros_are_not_a_covariance() {
        assert!(!is_covariance(&[0.0; 6]));
        assert!(is_covariance(&[0.25, 0.1, 0.01, 0.36, 0.02, 0.04]));
        // Without a heading.
        assert!(is_covariance(&[0.25, 0.1, 0.0, 0.36, 0.0, 0.0]));
        assert!(is_covariance(&[0.25, 0.1, 0.0, 0.36, 0.0, -1.0]));
        assert!(!is_covariance(&[0.25, 0.5, 0.0, 0.25, 0.0, 0.04]));
    }
}
