//! Raw files of the University of Michigan North Campus Long-Term (NCLT) data set.
//!
//! Source: Carlevaris-Bianco, Ushani, Eustice, "University of Michigan North Campus long-term
//! vision and lidar dataset", IJRR 35(9), 2016, and the data set's own scripts
//! (robots.engin.umich.edu/nclt: `read_vel_hits.py`, `read_ground_truth.py`, `read_odom.py`,
//! `read_ms25.py`, `read_wheels.py`, `read_gps.py`). Times are microseconds since the epoch.
//!
//! | file | columns | written as |
//! |---|---|---|
//! | `velodyne_hits.bin` | see [`hits`] and [`hit`] | `PointCloud2`, one revolution per message |
//! | `odometry_mu_100hz.csv` | utime, x, y, z \[m\], roll, pitch, heading \[rad\] | `Odometry` |
//! | `odometry_mu.csv`, if that one is missing | the same, since the row before | `Odometry`, the sum |
//! | `wheels.csv` | utime, left, right \[m/s\] | `JointState` |
//! | `ms25.csv` | utime, magnetic field x, y, z (not used), acceleration x, y, z \[m/s²\], rates about x, y, z \[rad/s\] | `Imu` |
//! | `ms25_euler.csv` | utime, roll, pitch, heading \[rad\] | orientation of the `Imu` above |
//! | `kvh.csv` | utime, heading \[rad\] | `Imu` |
//! | `groundtruth_DATE.csv` | utime, x, y, z \[m\], roll, pitch, heading \[rad\] | `PoseStamped` |
//! | `gps.csv`, `gps_rtk.csv` | utime, mode, satellites, latitude, longitude \[rad\], altitude \[m\], track, speed | `NavSatFix` |
//!
//! In the data set, the body frame has x forward, y right, z down, and the map has x north, y east,
//! z down. In the log, body frames have x forward, y left, z up, and the map has x east, y north,
//! z up. The odometry frame, whose origin is arbitrary, changes its axes like the body frame.
//!
//! Not imported: images, `velodyne_sync/` (the same hits, moved to the times of the images), the
//! Hokuyo scanners, and the covariances.

mod hit;
mod hits;
mod revolution;
mod rings;
mod series;
mod table;

use std::path::{Path, PathBuf};

use dataset::{Loss, LossKind, Losses, Subject};

use crate::error::ImportError;
use crate::input::{Meter, bytes, file_name, read_full};
use crate::options::Topic;
use crate::record::Source;
pub(crate) use hits::is_hits;

/// The kinds of files that are imported.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Hits,
    Odometry100Hz,
    Odometry,
    Wheels,
    Ms25,
    Euler,
    Kvh,
    GroundTruth,
    Gps,
    GpsRtk,
}

/// The kind of a file, from its name.
fn kind_of_name(path: &Path) -> Option<Kind> {
    let name = path.file_name()?.to_str()?;
    Some(match name {
        "velodyne_hits.bin" => Kind::Hits,
        "odometry_mu_100hz.csv" => Kind::Odometry100Hz,
        "odometry_mu.csv" => Kind::Odometry,
        "wheels.csv" => Kind::Wheels,
        "ms25.csv" => Kind::Ms25,
        "ms25_euler.csv" => Kind::Euler,
        "kvh.csv" => Kind::Kvh,
        "gps.csv" => Kind::Gps,
        "gps_rtk.csv" => Kind::GpsRtk,
        _ if name.starts_with("groundtruth") && name.ends_with(".csv") => Kind::GroundTruth,
        _ => return None,
    })
}

/// Whether the name of a file belongs to the data set.
pub(crate) fn is_known(path: &Path) -> bool {
    kind_of_name(path).is_some()
}

/// Whether the name of a file is that of a table of the data set.
pub(crate) fn is_table(path: &Path) -> bool {
    kind_of_name(path).is_some_and(|kind| kind != Kind::Hits)
}

/// Opens a reader for each file that gives messages.
pub(crate) fn open(
    files: &[PathBuf],
    meter: &Meter,
    losses: &mut Losses,
) -> Result<Vec<Box<dyn Source>>, ImportError> {
    let mut kinds = Vec::with_capacity(files.len());
    for path in files {
        kinds.push((path, kind(path)?));
    }
    let path_of = |wanted| kinds.iter().find(|(_, kind)| *kind == wanted).map(|(path, _)| *path);
    let mut sources: Vec<Box<dyn Source>> = Vec::new();
    for &(path, kind) in &kinds {
        sources.push(match kind {
            Kind::Hits => Box::new(hits::Hits::open(path, meter)?),
            Kind::Odometry if path_of(Kind::Odometry100Hz).is_some() => {
                let used = "odometry_mu_100hz.csv".to_owned();
                losses.add(loss(path, LossKind::SupersededFile { used }), 1);
                continue;
            }
            Kind::Odometry => Box::new(series::Motions::open(path, meter)?),
            Kind::Odometry100Hz => series::odometry(path, meter)?,
            Kind::Wheels => series::wheels(path, meter)?,
            Kind::Ms25 => {
                let euler = path_of(Kind::Euler).map(PathBuf::as_path);
                Box::new(series::Ms25::open(path, euler, meter)?)
            }
            Kind::Euler => {
                if path_of(Kind::Ms25).is_none() {
                    let partner = "ms25.csv".to_owned();
                    losses.add(loss(path, LossKind::FileWithoutPartner { partner }), 1);
                }
                continue;
            }
            Kind::Kvh => Box::new(series::Kvh::open(path, meter)?),
            Kind::GroundTruth => series::ground_truth(path, meter)?,
            Kind::Gps => series::gps(path, Topic::Fix, meter)?,
            Kind::GpsRtk => series::gps(path, Topic::FixRtk, meter)?,
        });
    }
    Ok(sources)
}

fn loss(path: &Path, kind: LossKind) -> Loss {
    Loss::new(kind, Subject::file(file_name(path)))
}

/// The kind of a file, from its name, or from its content if the file was renamed.
fn kind(path: &Path) -> Result<Kind, ImportError> {
    if let Some(kind) = kind_of_name(path) {
        return Ok(kind);
    }
    let mut head = [0; 8];
    let n = read_full(&mut bytes(path, &Meter::default())?, &mut head)
        .map_err(|source| ImportError::io("read", path, source))?;
    match is_hits(&head[..n]) {
        true => Ok(Kind::Hits),
        false => Err(ImportError::unexpected(
            path,
            "byte 0",
            format!("{:02x?}", &head[..n]),
            "9c ad four times, the start of every packet of velodyne_hits.bin",
        )),
    }
}
