//! Extracts the scan of one ring from a point cloud with a ring field.
//!
//! A driver makes one cloud from one revolution, so each message gives one scan.

use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};

use dataset::{FULL_RING_DEG, Scan};
use messages::{Column, MessageError, PointCloud, Source, read_point_cloud};

use crate::deskew::timed_scan::TimedScan;
use crate::error::BeamNotFound;
use crate::options::LidarOptions;
use crate::scan::cloud_frame::ConeCheck;
use crate::scan::point_time::{PointTime, PointTimeFound, PointTimes};
use crate::stamp::Stamp;

/// A beam matches a requested elevation if it differs by at most this \[deg\]. It is slightly more than
/// half the angle between two beams of an HDL-32E.
pub(crate) const MAX_ELEVATION_ERROR_DEG: f64 = 0.7;
/// Nearer points are not used to measure elevations, because they can be part of the robot \[m\].
const MIN_RANGE_M: f64 = 0.5;
/// A backward step up to this size is encoder jitter, or the second return of a firing \[rad\].
const JITTER_RAD: f64 = 10.0 * PI / 180.0;
/// Size of a wide step \[rad\]. Points in firing order almost never have one. Points in random order
/// have one half of the time.
const WIDE_STEP_RAD: f64 = PI / 2.0;
/// Points with a larger share of wide steps are not in firing order.
const MAX_WIDE_SHARE: f64 = 0.1;
/// With fewer steps than this, points are taken to be in firing order.
const MIN_STEPS: usize = 20;
/// Rounding error of a sum of some thousand steps \[rad\].
const ROUNDING_RAD: f64 = 1e-9;

/// Maximum difference between the time of a point and the stamp in the header \[ns\]. A revolution
/// takes at most 0.2 s, and drivers stamp its start or its end.
const MAX_FROM_HEADER_NS: i64 = 1_000_000_000;

/// The fields of a cloud that are used.
struct Fields<'a> {
    x: Column<'a>,
    y: Column<'a>,
    z: Column<'a>,
    ring: Column<'a>,
    time: Option<Time<'a>>,
}

/// A field with the times of the points.
struct Time<'a> {
    column: Column<'a>,
    /// Unit of the field \[ns\].
    ns: f64,
    /// Whether times count from the epoch, not from the stamp in the header.
    absolute: bool,
}

impl<'a> Fields<'a> {
    fn of(cloud: &'a PointCloud<'_>, time: &PointTimeFound) -> messages::Result<Self> {
        let column = |name: &str| {
            cloud.column(name).ok_or_else(|| MessageError::NoField {
                field: name.to_owned(),
                found: cloud.fields.iter().map(|field| field.name.clone()).collect(),
            })
        };
        let time = match *time {
            PointTimeFound::Known(PointTime { field, unit, is_absolute }) => {
                let column = cloud.column(field);
                column.map(|column| Time { column, ns: unit.ns(), absolute: is_absolute })
            }
            _ => None,
        };
        let (x, y, z) = (column("x")?, column("y")?, column("z")?);
        Ok(Self { x, y, z, ring: column("ring")?, time })
    }

    /// x, y and range of a point \[m\]. `None` if the point is not a return.
    fn point(&self, k: usize) -> Option<[f64; 3]> {
        let (x, y, z) = (self.x.get(k), self.y.get(k), self.z.get(k));
        let range = (x * x + y * y + z * z).sqrt();
        (range.is_finite() && 0.0 < range).then_some([x, y, range])
    }

    /// The time of a point \[ns since the epoch\]. `None` if it is too far from the stamp in the header,
    /// because it comes from another clock.
    fn stamp_ns(&self, header_ns: i64, k: usize) -> Option<i64> {
        let Some(time) = &self.time else { return Some(header_ns) };
        let ns = (time.column.get(k) * time.ns).round();
        let stamp_ns = if time.absolute { ns as i64 } else { header_ns.saturating_add(ns as i64) };
        let is_near = stamp_ns.saturating_sub(header_ns).saturating_abs() <= MAX_FROM_HEADER_NS;
        (ns.is_finite() && is_near).then_some(stamp_ns)
    }

    /// The time of the first point of the scan, which is the stamp of the scan, and the times of the
    /// kept points relative to it \[ns\]. The stamp is `None` if the times come from another clock than
    /// the stamp in the header. The times are empty if they are not known.
    ///
    /// If log times are used, the stamp in the header does not matter: the times count from the first
    /// point.
    fn times_ns(
        &self,
        cloud: &PointCloud<'_>,
        first: Option<usize>,
        kept: impl Iterator<Item = usize>,
        stamp: Stamp,
    ) -> (Option<i64>, Vec<i64>) {
        let (Some(first), Some(time)) = (first, &self.time) else {
            return (Some(cloud.stamp_ns), Vec::new());
        };
        if stamp == Stamp::Log {
            let from_first = |k| ((time.column.get(k) - time.column.get(first)) * time.ns).round();
            let is_near = |ns: &f64| ns.abs() <= MAX_FROM_HEADER_NS as f64;
            let times: Option<Vec<i64>> =
                kept.map(|k| Some(from_first(k)).filter(is_near).map(|ns| ns as i64)).collect();
            return (Some(cloud.stamp_ns), times.unwrap_or_default());
        }
        let Some(stamp_ns) = self.stamp_ns(cloud.stamp_ns, first) else {
            return (None, Vec::new());
        };
        let times: Option<Vec<i64>> =
            kept.map(|k| self.stamp_ns(cloud.stamp_ns, k).map(|ns| ns - stamp_ns)).collect();
        (Some(stamp_ns), times.unwrap_or_default())
    }
}

/// Elevations of the points of each ring, and the times of the points, from several clouds.
#[derive(Debug, Default)]
pub(crate) struct Rings {
    elevations_deg: BTreeMap<u32, Vec<f64>>,
    times: PointTimes,
    n_clouds: usize,
}

/// Number of clouds used to measure the elevations of the rings.
const N_CLOUDS: usize = 10;
/// Maximum number of points used to measure the elevation of a ring.
const MAX_POINTS: usize = 10_000;

impl Rings {
    /// Whether the clouds so far contain the ring that the options select. This is checked after 10, 20,
    /// 40, ... clouds.
    pub(crate) fn is_enough(&self, options: &LidarOptions) -> bool {
        let is_due =
            self.n_clouds.is_multiple_of(N_CLOUDS) && (self.n_clouds / N_CLOUDS).is_power_of_two();
        options.laser.is_some() || is_due && self.choose(options).is_ok()
    }

    /// Adds the points of a cloud.
    pub(crate) fn add(&mut self, source: Source, data: &[u8]) -> messages::Result<()> {
        let cloud = read_point_cloud(source, data)?;
        let fields = Fields::of(&cloud, &PointTimeFound::None)?;
        self.n_clouds += 1;
        let returns = (0..fields.ring.len()).filter_map(|k| {
            let [x, y, _] = fields.point(k)?;
            Some((k, x, y))
        });
        self.times.add(&cloud, returns);
        for k in 0..fields.ring.len() {
            let Some([x, y, range]) = fields.point(k) else { continue };
            if MIN_RANGE_M <= range {
                let of_ring = self.elevations_deg.entry(fields.ring.get(k) as u32).or_default();
                if of_ring.len() < MAX_POINTS {
                    let elevation = libm::atan2(fields.z.get(k), (x * x + y * y).sqrt());
                    of_ring.push(elevation.to_degrees());
                }
            }
        }
        Ok(())
    }

    /// Adds the points of other clouds.
    pub(crate) fn merge(&mut self, other: Self) {
        self.n_clouds += other.n_clouds;
        self.times.merge(other.times);
        for (ring, elevations) in other.elevations_deg {
            let of_ring = self.elevations_deg.entry(ring).or_default();
            of_ring.extend(elevations.into_iter().take(MAX_POINTS - of_ring.len()));
        }
    }

    /// How the points state their times.
    pub(crate) fn point_time(&self) -> PointTimeFound {
        self.times.found()
    }

    /// The rings and their elevations \[deg\]: the median over the points of each ring.
    pub(crate) fn medians(&self) -> Vec<(u32, f64)> {
        let median = |elevations: &Vec<f64>| {
            let mut sorted = elevations.clone();
            sorted.sort_by(f64::total_cmp);
            sorted[sorted.len() / 2]
        };
        self.elevations_deg.iter().map(|(&ring, elevations)| (ring, median(elevations))).collect()
    }

    /// The ring that the options select. `None` without clouds.
    pub(crate) fn choose(&self, options: &LidarOptions) -> Result<Option<u32>, BeamNotFound> {
        if self.n_clouds == 0 {
            return Ok(None);
        }
        let medians = self.medians();
        let not_found = |requested: String| {
            let available = match medians.as_slice() {
                [] => "no rings, because no point is a return".to_owned(),
                some => {
                    let list: Vec<_> =
                        some.iter().map(|(ring, deg)| format!("{ring} at {deg:.2} deg")).collect();
                    format!("rings {}", list.join(", "))
                }
            };
            BeamNotFound { requested, available }
        };
        if let Some(laser) = options.laser {
            return Err(not_found(format!("laser {laser} (only packets have lasers)")));
        }
        if let Some(ring) = options.ring {
            let exists = medians.iter().any(|&(other, _)| other == ring);
            return exists.then_some(Some(ring)).ok_or_else(|| not_found(format!("ring {ring}")));
        }
        let target = options.elevation_deg.unwrap_or(0.0);
        medians
            .iter()
            .map(|&(ring, deg)| (ring, (deg - target).abs()))
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .filter(|&(_, error)| error <= MAX_ELEVATION_ERROR_DEG)
            .map(|(ring, _)| Some(ring))
            .ok_or_else(|| not_found(format!("beam at {target:.2} deg")))
    }
}

/// A scan, and what was irregular in its cloud.
pub(crate) struct FromCloud {
    pub(crate) scan: TimedScan,
    /// Whether the points were not in firing order and were sorted.
    pub(crate) is_sorted: bool,
    /// Number of returns after the first revolution, which are dropped.
    pub(crate) n_beyond: u64,
    /// Whether the times of the points come from another clock, so that the stamp in the header was
    /// used.
    pub(crate) is_of_other_clock: bool,
    /// Number of points of the ring with a positive finite range.
    pub(crate) n_points: u64,
}

/// Adds the rings of a cloud to the check of its frame.
pub(crate) fn check_frame(
    source: Source,
    data: &[u8],
    check: &mut ConeCheck,
) -> messages::Result<()> {
    let cloud = read_point_cloud(source, data)?;
    let fields = Fields::of(&cloud, &PointTimeFound::None)?;
    check.add(fields.ring.len(), |k| {
        let [x, y, range] = fields.point(k).filter(|[.., range]| MIN_RANGE_M <= *range)?;
        let elevation = libm::atan2(fields.z.get(k), (x * x + y * y).sqrt());
        Some((fields.ring.get(k) as u32, elevation, range))
    });
    Ok(())
}

/// Extracts the scan of one ring. `time` is how the points state their times.
pub(crate) fn scan(
    source: Source,
    data: &[u8],
    ring: u32,
    time: &PointTimeFound,
    options: &LidarOptions,
) -> messages::Result<FromCloud> {
    let cloud = read_point_cloud(source, data)?;
    let fields = Fields::of(&cloud, time)?;
    let ring = f64::from(ring);
    let of_ring: Vec<usize> =
        (0..fields.ring.len()).filter(|&k| fields.ring.get(k) == ring).collect();
    // The swept angle does not depend on the range limits, so they are applied later.
    let mut points: Vec<(f64, [f64; 3], usize)> = of_ring
        .iter()
        .filter_map(|&k| Some((fields.point(k)?, k)))
        .map(|(point, k)| (libm::atan2(point[1], point[0]), point, k))
        .collect();
    let mut sweep = Sweep::of(&points.iter().map(|(azimuth, ..)| *azimuth));
    let is_sorted = !sweep.is_ordered;
    if is_sorted {
        // Clockwise from straight ahead, as the sensor spins.
        points.sort_by(|a, b| (-a.0).rem_euclid(TAU).total_cmp(&(-b.0).rem_euclid(TAU)));
        sweep = Sweep::of(&points.iter().map(|(azimuth, ..)| *azimuth));
    }
    let mut swept = sweep.reached_rad.last().copied().unwrap_or(0.0);
    if swept.to_degrees() < f64::from(FULL_RING_DEG) {
        // If this ring has no return where the revolution starts and ends, another ring can have one.
        swept = swept.max(widest_sweep_rad(&fields));
    }
    // A driver can put more than one revolution into a cloud. A scan is one revolution.
    let n_in_revolution =
        sweep.reached_rad.partition_point(|&reached| reached < TAU - ROUNDING_RAD);
    let n_beyond = points.len() - n_in_revolution;
    points.truncate(n_in_revolution);
    if n_beyond > 0 {
        swept = sweep.reached_rad[n_in_revolution - 1];
    }
    // Compare as f32, the type of the fields, so a point exactly at a limit is kept.
    let limits = options.range_min_m as f32..=options.range_max_m as f32;
    let n_points = points.len() as u64;
    let side = if options.upside_down { -1.0 } else { 1.0 };
    points.retain(|(_, [_, _, range], _)| limits.contains(&(*range as f32)));
    let (x_m, y_m) = points.iter().map(|(_, [x, y, _], _)| (*x as f32, (side * y) as f32)).unzip();
    let first = of_ring.first().copied();
    let kept = points.iter().map(|&(_, _, k)| k);
    let (stamp_ns, times_ns) = fields.times_ns(&cloud, first, kept, options.stamp);
    let is_of_other_clock = stamp_ns.is_none();
    let stamp_ns = stamp_ns.unwrap_or(cloud.stamp_ns);
    let scan = Scan { stamp_ns, x_m, y_m, coverage_deg: swept.to_degrees() as f32, hole_deg: 0.0 };
    let n_beyond = n_beyond as u64;
    let scan = TimedScan { scan, times_ns };
    Ok(FromCloud { scan, is_sorted, n_beyond, is_of_other_clock, n_points })
}

/// The widest sweep of any ring whose points are in order.
fn widest_sweep_rad(fields: &Fields<'_>) -> f64 {
    let mut azimuths: BTreeMap<u32, Vec<f64>> = BTreeMap::new();
    for k in 0..fields.ring.len() {
        if let Some([x, y, _]) = fields.point(k) {
            azimuths.entry(fields.ring.get(k) as u32).or_default().push(libm::atan2(y, x));
        }
    }
    let sweeps = azimuths.into_values().map(|azimuths| Sweep::of(&azimuths.into_iter()));
    sweeps
        .filter(|sweep| sweep.is_ordered)
        .filter_map(|sweep| sweep.reached_rad.last().copied())
        .fold(0.0, f64::max)
}

/// The order and extent of a sequence of azimuths.
struct Sweep {
    /// Angle from the first azimuth to each azimuth in the direction of rotation, including gaps
    /// \[rad\]. It never decreases.
    reached_rad: Vec<f64>,
    /// Whether the points are in firing order.
    is_ordered: bool,
}

impl Sweep {
    fn of(azimuths: &(impl Iterator<Item = f64> + Clone)) -> Self {
        let steps = azimuths.clone().zip(azimuths.clone().skip(1)).map(|(from, to)| {
            let step = (to - from).rem_euclid(TAU);
            if PI < step { step - TAU } else { step }
        });
        let n_left = steps.clone().filter(|step| 0.0 < *step).count();
        let n_right = steps.clone().filter(|step| *step < 0.0).count();
        let side = if n_right < n_left { 1.0 } else { -1.0 };
        let n_wide = steps.clone().filter(|step| WIDE_STEP_RAD < step.abs()).count();
        let n_steps = steps.clone().count();
        let mut at = 0.0f64;
        let reached = steps.map(|step| {
            // A gap of more than half a revolution is not a backward step.
            let ahead = (side * step).rem_euclid(TAU);
            at += if TAU - JITTER_RAD < ahead { ahead - TAU } else { ahead };
            at
        });
        let mut furthest = 0.0f64;
        let reached_rad = azimuths.clone().take(1).map(|_| 0.0).chain(reached);
        Self {
            reached_rad: reached_rad
                .map(|reached| {
                    furthest = furthest.max(reached);
                    furthest
                })
                .collect(),
            is_ordered: n_steps < MIN_STEPS || n_wide as f64 <= MAX_WIDE_SHARE * n_steps as f64,
        }
    }
}
