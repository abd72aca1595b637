//! A point cloud with a ring field -> the scan of one ring.
//!
//! A cloud is what a driver made of a turn: it is taken as it is, one scan a message.

use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};

use dataset::{FULL_RING_DEG, Scan};
use messages::{Column, MessageError, PointCloud, Source, read_point_cloud};

use crate::deskew::motion::TimedScan;
use crate::options::LidarOptions;

/// A ring is found by elevation where its beam is no farther from it than this \[deg\]: half a step
/// of an HDL-32E, a little more.
pub(crate) const MAX_ELEVATION_ERROR_DEG: f64 = 0.7;
/// Points nearer than this tell no elevation \[m\]: they are of the robot.
const NEAR_M: f64 = 0.5;
/// A step back of up to this is jitter of the encoder, or the other return of one firing \[rad\].
const JITTER_RAD: f64 = 10.0 * PI / 180.0;
/// Points in firing order hardly ever lie so far from the next; points in no order do half of the
/// time \[rad\].
const WIDE_RAD: f64 = PI / 2.0;
/// Share of such steps from which points are in no order, where there are not too few to tell.
const MAX_WIDE_SHARE: f64 = 0.1;
const FEW_STEPS: usize = 20;
/// What a sum of some thousand steps may be off by \[rad\].
const ROUNDING_RAD: f64 = 1e-9;

/// A point's time is no farther from the header's stamp than this \[ns\]: a turn takes 0.2 s at
/// most, drivers stamp its start or its end.
const MAX_FROM_HEADER_NS: i64 = 1_000_000_000;

/// The fields of a cloud that are read.
struct Fields<'a> {
    x: Column<'a>,
    y: Column<'a>,
    z: Column<'a>,
    ring: Column<'a>,
    time: Option<Time<'a>>,
}

/// A field that tells when a point was measured.
struct Time<'a> {
    column: Column<'a>,
    /// Nanoseconds in a count of it.
    ns: f64,
    /// Whether it counts from the epoch and not from the header's stamp.
    absolute: bool,
}

impl<'a> Fields<'a> {
    fn of(cloud: &'a PointCloud<'_>) -> messages::Result<Self> {
        let column = |name: &str| {
            cloud.column(name).ok_or_else(|| MessageError::NoField {
                field: name.to_owned(),
                found: cloud.fields.iter().map(|field| field.name.clone()).collect(),
            })
        };
        // velodyne_pointcloud: `time`, seconds from the stamp; Ouster: `t`, nanoseconds from the
        // stamp; Hesai and Robosense: `timestamp`, seconds since the epoch.
        let time = [("time", 1e9, false), ("t", 1.0, false), ("timestamp", 1e9, true)]
            .into_iter()
            .find_map(|(name, ns, absolute)| {
                Some(Time { column: cloud.column(name)?, ns, absolute })
            });
        let (x, y, z) = (column("x")?, column("y")?, column("z")?);
        Ok(Self { x, y, z, ring: column("ring")?, time })
    }

    /// A point that is a return: x, y \[m\] and range \[m\].
    fn point(&self, k: usize) -> Option<[f64; 3]> {
        let (x, y, z) = (self.x.get(k), self.y.get(k), self.z.get(k));
        let range = (x * x + y * y + z * z).sqrt();
        (range.is_finite() && 0.0 < range).then_some([x, y, range])
    }

    /// When a point was measured \[ns since the epoch\]; none where its time is of another clock
    /// than the header's, or in other units.
    fn stamp_ns(&self, header_ns: i64, k: usize) -> Option<i64> {
        let Some(time) = &self.time else { return Some(header_ns) };
        let ns = (time.column.get(k) * time.ns).round();
        let stamp_ns = if time.absolute { ns as i64 } else { header_ns.saturating_add(ns as i64) };
        let is_near = stamp_ns.saturating_sub(header_ns).saturating_abs() <= MAX_FROM_HEADER_NS;
        (ns.is_finite() && is_near).then_some(stamp_ns)
    }
}

/// Elevations of the points of each ring, of some clouds.
#[derive(Debug, Default)]
pub(crate) struct Rings {
    elevations_deg: BTreeMap<u32, Vec<f64>>,
    n_clouds: usize,
}

/// Clouds that tell the elevations of the rings.
const CLOUDS: usize = 10;
/// Points that tell the elevation of a ring.
const POINTS: usize = 10_000;

impl Rings {
    /// Whether the ring that the options ask for is among those of 10 clouds; or, where these have
    /// no return of it, of 20, of 40 and so on.
    pub(crate) fn is_enough(&self, options: &LidarOptions) -> bool {
        let is_time =
            self.n_clouds.is_multiple_of(CLOUDS) && (self.n_clouds / CLOUDS).is_power_of_two();
        options.laser.is_some() || is_time && self.choose(options).is_ok()
    }

    /// Adds a cloud's points.
    pub(crate) fn add(&mut self, source: Source, data: &[u8]) -> messages::Result<()> {
        let cloud = read_point_cloud(source, data)?;
        let fields = Fields::of(&cloud)?;
        self.n_clouds += 1;
        for k in 0..fields.ring.len() {
            let Some([x, y, range]) = fields.point(k) else { continue };
            if NEAR_M <= range {
                let of_ring = self.elevations_deg.entry(fields.ring.get(k) as u32).or_default();
                if of_ring.len() < POINTS {
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
        for (ring, elevations) in other.elevations_deg {
            let of_ring = self.elevations_deg.entry(ring).or_default();
            of_ring.extend(elevations.into_iter().take(POINTS - of_ring.len()));
        }
    }

    /// Rings and the elevation of their beams \[deg\], the median of their points'.
    pub(crate) fn medians(&self) -> Vec<(u32, f64)> {
        let median = |elevations: &Vec<f64>| {
            let mut sorted = elevations.clone();
            sorted.sort_by(f64::total_cmp);
            sorted[sorted.len() / 2]
        };
        self.elevations_deg.iter().map(|(&ring, elevations)| (ring, median(elevations))).collect()
    }

    /// The ring that the options ask for, none without a cloud; the error says what was asked for and what there is.
    pub(crate) fn choose(&self, options: &LidarOptions) -> Result<Option<u32>, (String, String)> {
        if self.n_clouds == 0 {
            return Ok(None);
        }
        let medians = self.medians();
        let found = || match medians.as_slice() {
            [] => "no ring, since no point is a return".to_owned(),
            some => {
                let list: Vec<_> =
                    some.iter().map(|(ring, deg)| format!("{ring} at {deg:.2} deg")).collect();
                format!("the rings {}", list.join(", "))
            }
        };
        if let Some(laser) = options.laser {
            let asked = format!("laser {laser} (which counts in packets; clouds count in rings)");
            return Err((asked, found()));
        }
        if let Some(ring) = options.ring {
            let is_there = medians.iter().any(|&(other, _)| other == ring);
            return is_there.then_some(Some(ring)).ok_or_else(|| (format!("ring {ring}"), found()));
        }
        let target = options.elevation_deg.unwrap_or(0.0);
        medians
            .iter()
            .map(|&(ring, deg)| (ring, (deg - target).abs()))
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .filter(|&(_, error)| error <= MAX_ELEVATION_ERROR_DEG)
            .map(|(ring, _)| Some(ring))
            .ok_or_else(|| (format!("a beam at {target:.2} deg"), found()))
    }
}

/// A scan, and what was wrong with its cloud.
pub(crate) struct FromCloud {
    pub(crate) scan: TimedScan,
    /// The points were in no order, and were sorted.
    pub(crate) is_sorted: bool,
    /// Returns beyond one turn, which are left out.
    pub(crate) n_beyond: u64,
    /// The points' times are of another clock; the header's stamp was taken.
    pub(crate) is_of_other_clock: bool,
}

/// Takes the scan of one ring.
pub(crate) fn scan(
    source: Source,
    data: &[u8],
    ring: u32,
    options: &LidarOptions,
) -> messages::Result<FromCloud> {
    let cloud = read_point_cloud(source, data)?;
    let fields = Fields::of(&cloud)?;
    let ring = f64::from(ring);
    let of_ring: Vec<usize> =
        (0..fields.ring.len()).filter(|&k| fields.ring.get(k) == ring).collect();
    // Before any choice by range: what was swept does not depend on it.
    let mut points: Vec<(f64, [f64; 3], usize)> = of_ring
        .iter()
        .filter_map(|&k| Some((fields.point(k)?, k)))
        .map(|(point, k)| (libm::atan2(point[1], point[0]), point, k))
        .collect();
    let mut sweep = Sweep::of(&points.iter().map(|(azimuth, ..)| *azimuth));
    let is_sorted = !sweep.is_ordered;
    if is_sorted {
        // Clockwise from straight ahead, as the sensor turns.
        points.sort_by(|a, b| (-a.0).rem_euclid(TAU).total_cmp(&(-b.0).rem_euclid(TAU)));
        sweep = Sweep::of(&points.iter().map(|(azimuth, ..)| *azimuth));
    }
    let mut swept = sweep.reached_rad.last().copied().unwrap_or(0.0);
    if swept.to_degrees() < f64::from(FULL_RING_DEG) {
        // Where the turn was cut this ring had no return; another may have.
        swept = swept.max(widest_sweep_rad(&fields));
    }
    // A driver may put more than a turn into a cloud; a scan is one.
    let n_in_revolution =
        sweep.reached_rad.partition_point(|&reached| reached < TAU - ROUNDING_RAD);
    let n_beyond = points.len() - n_in_revolution;
    points.truncate(n_in_revolution);
    if n_beyond > 0 {
        swept = sweep.reached_rad[n_in_revolution - 1];
    }
    // Compared as f32, which clouds are made of, so that a point at a limit is within it.
    let limits = options.range_min_m as f32..=options.range_max_m as f32;
    let side = if options.upside_down { -1.0 } else { 1.0 };
    points.retain(|(_, [_, _, range], _)| limits.contains(&(*range as f32)));
    let (x_m, y_m) = points.iter().map(|(_, [x, y, _], _)| (*x as f32, (side * y) as f32)).unzip();
    let stamp_ns = match of_ring.first() {
        Some(&k) => fields.stamp_ns(cloud.stamp_ns, k),
        None => Some(cloud.stamp_ns),
    };
    let is_of_other_clock = stamp_ns.is_none();
    let stamp_ns = stamp_ns.unwrap_or(cloud.stamp_ns);
    let times_ns = match fields.time.is_some() && !is_of_other_clock {
        true => points
            .iter()
            .map(|&(_, _, k)| fields.stamp_ns(cloud.stamp_ns, k).map(|ns| ns - stamp_ns))
            .collect::<Option<_>>(),
        false => None,
    };
    let scan = Scan { stamp_ns, x_m, y_m, coverage_deg: swept.to_degrees() as f32, hole_deg: 0.0 };
    let n_beyond = n_beyond as u64;
    let scan = TimedScan { scan, times_ns: times_ns.unwrap_or_default() };
    Ok(FromCloud { scan, is_sorted, n_beyond, is_of_other_clock })
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

/// How azimuths follow each other.
struct Sweep {
    /// Angle from the first azimuth to each, in the direction of turning, gaps included \[rad\];
    /// never less than the one before.
    reached_rad: Vec<f64>,
    /// The points are in the order of firing.
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
        let n_wide = steps.clone().filter(|step| WIDE_RAD < step.abs()).count();
        let n_steps = steps.clone().count();
        let mut at = 0.0f64;
        let reached = steps.map(|step| {
            // A gap of more than half a turn is no step back.
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
            is_ordered: n_steps < FEW_STEPS || n_wide as f64 <= MAX_WIDE_SHARE * n_steps as f64,
        }
    }
}
