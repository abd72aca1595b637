//! Finds out how the points of a cloud state their times: field, unit, and what they count from.
//!
//! Drivers do not agree on any of these, and the field does not state its unit. The length of a revolution
//! shows it: the units are a factor of 1000 apart, and lidars rotate 2 to 50 times per second.

use std::collections::BTreeMap;

use dataset::NoteKind;
use messages::{Column, PointCloud};

/// The unit of a time field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum TimeUnit {
    Seconds,
    Milliseconds,
    Microseconds,
    Nanoseconds,
}

impl TimeUnit {
    const ALL: [Self; 4] =
        [Self::Seconds, Self::Milliseconds, Self::Microseconds, Self::Nanoseconds];

    /// The unit \[ns\].
    pub(crate) fn ns(self) -> f64 {
        match self {
            Self::Seconds => 1e9,
            Self::Milliseconds => 1e6,
            Self::Microseconds => 1e3,
            Self::Nanoseconds => 1.0,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Seconds => "seconds",
            Self::Milliseconds => "milliseconds",
            Self::Microseconds => "microseconds",
            Self::Nanoseconds => "nanoseconds",
        }
    }
}

/// The names of time fields, with the unit that their drivers use, and whether they count from the
/// epoch. The data decides; a field that is read as its driver intends needs no remark.
const FIELDS: [(&str, TimeUnit, bool); 11] = [
    // velodyne_pointcloud
    ("time", TimeUnit::Seconds, false),
    // Ouster
    ("t", TimeUnit::Nanoseconds, false),
    // Hesai, RoboSense
    ("timestamp", TimeUnit::Seconds, true),
    // Livox
    ("offset_time", TimeUnit::Nanoseconds, false),
    ("time_offset", TimeUnit::Nanoseconds, false),
    ("time_stamp", TimeUnit::Seconds, true),
    ("timeStamp", TimeUnit::Seconds, true),
    ("t_offset", TimeUnit::Nanoseconds, false),
    ("point_time", TimeUnit::Seconds, false),
    ("t_us", TimeUnit::Microseconds, false),
    ("time_us", TimeUnit::Microseconds, false),
];

/// A revolution takes about this time, if the log does not show how long \[s\]. Nearly all lidars rotate
/// 10 or 20 times per second.
const USUAL_REVOLUTION_S: f64 = 0.1;
/// Times between two clouds that can be the time of a revolution \[s\]. A slower topic leaves out
/// revolutions, or its clouds are the sum of several.
const REVOLUTION_S: (f64, f64) = (0.015, 0.5);
/// Largest ratio between the time in the cloud and the expected time: half of the way to the next unit.
const MAX_RATIO: f64 = 31.6;
/// Width of the sectors that the coverage of a cloud is measured by \[deg\].
const SECTOR_DEG: f64 = 10.0;

/// The time field of a cloud.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TimeField<'a> {
    pub(crate) name: &'static str,
    pub(crate) column: Column<'a>,
}

impl<'a> TimeField<'a> {
    /// The first field of a known name.
    pub(crate) fn of(cloud: &'a PointCloud<'_>) -> Option<Self> {
        FIELDS.iter().find_map(|&(name, ..)| Some(TimeField { name, column: cloud.column(name)? }))
    }
}

/// How the points of the clouds of a topic state their times.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PointTime {
    pub(crate) field: &'static str,
    pub(crate) unit: TimeUnit,
    /// Whether the times count from the epoch, not from the stamp in the header.
    pub(crate) is_absolute: bool,
}

/// What the time field of the clouds shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum PointTimeFound {
    /// The clouds have no field with times, or all times of each cloud are equal.
    None,
    /// The times can be used.
    Known(PointTime),
    /// The times fit no unit.
    Implausible {
        /// The field.
        field: &'static str,
        /// From the first point of a cloud to the last, in the unknown unit.
        span: f64,
        /// Expected \[s\].
        expected_s: f64,
    },
}

/// What one cloud shows.
#[derive(Debug, Clone, Copy)]
struct CloudTimes {
    field: &'static str,
    header_ns: i64,
    /// Least and largest time, in the unknown unit.
    range: (f64, f64),
    /// Share of a revolution that the points cover, 0 to 1.
    coverage: f64,
}

/// Collects what the clouds of a topic show, in the order of the log.
#[derive(Debug, Clone, Default)]
pub(crate) struct PointTimes {
    clouds: Vec<CloudTimes>,
}

impl PointTimes {
    /// Adds a cloud. `returns` are the index, x and y of its returns.
    pub(crate) fn add(
        &mut self,
        cloud: &PointCloud<'_>,
        returns: impl Iterator<Item = (usize, f64, f64)>,
    ) {
        let Some(field) = TimeField::of(cloud) else { return };
        let mut range = (f64::INFINITY, f64::NEG_INFINITY);
        let mut sectors = 0u64;
        for (k, x, y) in returns {
            let time = field.column.get(k);
            if time.is_finite() {
                range = (range.0.min(time), range.1.max(time));
                let sector = libm::atan2(y, x).to_degrees().rem_euclid(360.0) / SECTOR_DEG;
                sectors |= 1 << (sector as u32).min(63);
            }
        }
        if range.0 <= range.1 {
            let coverage = f64::from(sectors.count_ones()) * SECTOR_DEG / 360.0;
            let header_ns = cloud.stamp_ns;
            self.clouds.push(CloudTimes { field: field.name, header_ns, range, coverage });
        }
    }

    pub(crate) fn merge(&mut self, later: Self) {
        self.clouds.extend(later.clouds);
    }

    /// The time of a revolution: the median time between clouds \[s\].
    fn revolution_s(&self) -> f64 {
        let steps = self
            .clouds
            .windows(2)
            .map(|pair| (pair[1].header_ns.saturating_sub(pair[0].header_ns)) as f64 * 1e-9);
        let mut steps: Vec<f64> = steps.collect();
        steps.sort_by(f64::total_cmp);
        let median = steps.get(steps.len() / 2).copied();
        median
            .filter(|s| (REVOLUTION_S.0..=REVOLUTION_S.1).contains(s))
            .unwrap_or(USUAL_REVOLUTION_S)
    }

    /// Field, unit and reference of the point times: those that most clouds fit.
    pub(crate) fn found(&self) -> PointTimeFound {
        let revolution_s = self.revolution_s();
        let mut votes: BTreeMap<(&'static str, Option<TimeUnit>), Vec<CloudTimes>> =
            BTreeMap::new();
        for cloud in self.clouds.iter().filter(|cloud| cloud.range.0 < cloud.range.1) {
            let unit = cloud.unit(revolution_s);
            votes.entry((cloud.field, unit)).or_default().push(*cloud);
        }
        // Of several with as many votes, the first in order is used.
        let most = votes.iter().rev().max_by_key(|(_, clouds)| clouds.len());
        match most {
            None => PointTimeFound::None,
            Some((&(field, Some(unit)), clouds)) => {
                let is_absolute = is_absolute(clouds, unit);
                PointTimeFound::Known(PointTime { field, unit, is_absolute })
            }
            Some((&(field, None), clouds)) => PointTimeFound::Implausible {
                field,
                span: clouds[0].range.1 - clouds[0].range.0,
                expected_s: clouds[0].coverage * revolution_s,
            },
        }
    }
}

impl CloudTimes {
    /// The unit in which the cloud takes the time of its part of a revolution, or `None`.
    fn unit(&self, revolution_s: f64) -> Option<TimeUnit> {
        let span = self.range.1 - self.range.0;
        let expected_ns = self.coverage * revolution_s * 1e9;
        let ratio = |unit: &TimeUnit| {
            let ratio = span * unit.ns() / expected_ns;
            ratio.max(1.0 / ratio)
        };
        let nearest = TimeUnit::ALL.into_iter().min_by(|a, b| ratio(a).total_cmp(&ratio(b)));
        nearest.filter(|unit| ratio(unit) <= MAX_RATIO)
    }
}

/// Whether the times are nearer to the stamps of the clouds than to 0.
fn is_absolute(clouds: &[CloudTimes], unit: TimeUnit) -> bool {
    let sum = |from: fn(&CloudTimes) -> f64| -> f64 {
        clouds.iter().map(|cloud| (cloud.range.0 * unit.ns() - from(cloud)).abs()).sum()
    };
    sum(|cloud| cloud.header_ns as f64) < sum(|_| 0.0)
}

impl PointTimeFound {
    /// A remark, if the field is not read as its driver usually means it.
    pub(crate) fn note(&self) -> Option<NoteKind> {
        match *self {
            Self::None => None,
            Self::Known(PointTime { field, unit, is_absolute }) => {
                let is_usual = FIELDS.contains(&(field, unit, is_absolute));
                let from = if is_absolute { "the epoch" } else { "the stamp of the cloud" };
                (!is_usual).then(|| NoteKind::PointTimeUnit {
                    field: field.to_owned(),
                    unit: unit.name().to_owned(),
                    from: from.to_owned(),
                })
            }
            Self::Implausible { field, span, expected_s } => {
                Some(NoteKind::PointTimesImplausible { field: field.to_owned(), span, expected_s })
            }
        }
    }

    /// One line for `inspect`.
    pub(crate) fn describe(&self) -> String {
        match *self {
            Self::None => "no point times".to_owned(),
            Self::Known(PointTime { field, unit, is_absolute }) => {
                let from = if is_absolute { "the epoch" } else { "the stamp" };
                format!("point times in `{field}`: {} since {from}", unit.name())
            }
            Self::Implausible { field, span, expected_s } => format!(
                "point times in `{field}` span {span}, which is in no unit the expected {expected_s:.3} s"
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::{PointField, Scalar};

    const HEADER_S: f64 = 1_700_000_000.0;

    /// A cloud with one point per degree, and a time that grows by `span` over the revolution.
    fn cloud(header_ns: i64, field: &str, first: f64, span: f64, n: usize) -> PointCloud<'static> {
        let mut data = Vec::new();
        for k in 0..n {
            let (y, x) = (-(k as f64)).to_radians().sin_cos();
            let time = first + span * k as f64 / 359.0;
            [x * 5.0, y * 5.0, time].iter().for_each(|v| data.extend(v.to_le_bytes()));
        }
        let fields = ["x", "y", field].into_iter().enumerate();
        let fields = fields.map(|(k, name)| PointField {
            name: name.to_owned(),
            offset: 8 * k,
            kind: Scalar::F64,
        });
        PointCloud {
            stamp_ns: header_ns,
            width: n,
            height: 1,
            point_step: 24,
            row_step: 24 * n,
            big_endian: false,
            fields: fields.collect(),
            data: data.into(),
        }
    }

    fn found(
        period_s: f64,
        field: &str,
        n_points: usize,
        times: impl Fn(f64) -> (f64, f64),
    ) -> PointTimeFound {
        let mut observer = PointTimes::default();
        for k in 0..5 {
            let header_s = HEADER_S + period_s * f64::from(k);
            let header_ns = (header_s * 1e9) as i64;
            let (first, span) = times(header_s);
            let cloud = cloud(header_ns, field, first, span, n_points);
            let (x, y) = (cloud.column("x").unwrap(), cloud.column("y").unwrap());
            observer.add(&cloud, (0..n_points).map(|k| (k, x.get(k), y.get(k))));
        }
        observer.found()
    }

    #[test]
    fn the_length_of_a_revolution_shows_the_unit() {
        for (field, unit, is_absolute) in [
            ("time", TimeUnit::Seconds, false),
            ("t", TimeUnit::Nanoseconds, false),
            ("t", TimeUnit::Microseconds, false),
            ("timestamp", TimeUnit::Seconds, true),
            ("timestamp", TimeUnit::Nanoseconds, true),
            ("timestamp", TimeUnit::Microseconds, false),
            ("offset_time", TimeUnit::Nanoseconds, false),
            ("time", TimeUnit::Milliseconds, false),
        ] {
            let name = field;
            for (period_s, n_points) in [(0.1, 360), (0.05, 360), (0.2, 360), (1.0, 360), (0.1, 90)]
            {
                // A topic with a cloud every second leaves out revolutions of 0.1 s.
                let turn_s = if period_s == 1.0 { 0.1 } else { period_s };
                let per_s = 1e9 / unit.ns();
                let found = found(period_s, field, n_points, |header_s| {
                    (if is_absolute { header_s * per_s } else { 0.0 }, turn_s * per_s)
                });
                let PointTimeFound::Known(time) = found else { panic!("{found:?}") };
                assert_eq!((time.field, time.unit, time.is_absolute), (name, unit, is_absolute));
            }
        }
    }

    #[test]
    fn times_before_the_stamp_are_relative() {
        let found = found(0.1, "time", 360, |_| (-0.1, 0.1));
        let expected = PointTime { field: "time", unit: TimeUnit::Seconds, is_absolute: false };
        assert_eq!(found, PointTimeFound::Known(expected));
        assert_eq!(found.note(), None, "velodyne_pointcloud writes these times");
    }

    #[test]
    fn times_that_are_equal_or_fit_no_unit_are_not_used() {
        assert_eq!(found(0.1, "t", 360, |_| (0.0, 0.0)), PointTimeFound::None);
        assert_eq!(found(0.1, "intensity", 360, |_| (0.0, 1.0)), PointTimeFound::None);
        let hours = found(0.1, "time", 360, |_| (0.0, 1e12));
        assert!(matches!(hours, PointTimeFound::Implausible { .. }), "{hours:?}");
        assert!(hours.note().is_some());
    }
}
