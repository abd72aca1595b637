//! Finds planar scans whose fields contradict each other or the physics of a scanner.

use std::f64::consts::{PI, TAU};

use dataset::NoteKind;
use messages::LaserScan;

use crate::options::LidarOptions;

/// The stated angle of the last beam can differ from the other fields by two increments: drivers that
/// state the end of the range, or count beams from 1, are off by one. Drivers that round differ by less.
const MAX_INCREMENTS: f64 = 2.0;
/// Rounding of an increment to four decimals adds up to 2 deg over 360 beams \[rad\].
const MAX_ROUNDING_RAD: f64 = PI / 90.0;
/// Fastest and slowest time of a turn of the mirror \[s\]. Survey scanners turn up to 200 times per
/// second, and scanners on a servo once in a second.
const TURN_S: (f64, f64) = (0.002, 1.5);
/// The beams of a scan are measured before the next scan, with some tolerance for scans that come
/// irregularly, or that a driver cuts from a continuous stream.
const MAX_PERIODS: f64 = 1.5;
/// A planar scan with a larger median range is not in metres \[m\]. Scanners reach 30 to 80 m, and few
/// reach 250 m. Their median is far below, because most beams hit something near.
const MAX_MEDIAN_M: f64 = 150.0;

/// Why the angles of a message contradict each other, or `None`. A message with one beam cannot
/// contradict itself.
pub(crate) fn angle_fault(message: &LaserScan) -> Option<String> {
    let n_steps = message.ranges.len().checked_sub(1).filter(|&n| 0 < n)?;
    let (start, step, end) = (message.angle_min, message.angle_increment, message.last_angle());
    let span = (end - start).abs();
    let deg = |rad: f64| format!("{:.2} deg", rad.to_degrees());
    if step == 0.0 {
        return Some(format!("angle_increment is 0, but there are {} beams", n_steps + 1));
    }
    let tolerance = MAX_INCREMENTS * step.abs() + MAX_ROUNDING_RAD;
    if TAU + tolerance < span {
        let degrees = span.to_radians();
        let hint = match degrees <= TAU + tolerance.to_radians() {
            true => format!(": are the angles in degrees? That would be {span:.1} deg"),
            false => String::new(),
        };
        return Some(format!(
            "{} beams with an angle_increment of {step:.6} rad cover {:.2} turns, expected at most one{hint}",
            n_steps + 1,
            span / TAU
        ));
    }
    // A message that states no end, or the same end as start, is not a contradiction of its span.
    let stated = message.angle_max.filter(|angle| angle.is_finite())?;
    let off = stated - end;
    (tolerance < off.abs()).then(|| {
        format!(
            "angle_min {} + {n_steps} * angle_increment {} = {}, but angle_max is {}: off by {}",
            deg(start),
            deg(step),
            deg(end),
            deg(stated),
            deg(off)
        )
    })
}

/// Why the time from one beam to the next is impossible, or `None`. It gives the time of a turn of the
/// mirror.
pub(crate) fn turn_fault(message: &LaserScan) -> Option<String> {
    let increment_s = message.time_increment_s;
    let turn_s = increment_s * TAU / message.angle_increment.abs();
    let is_possible = (TURN_S.0..=TURN_S.1).contains(&turn_s);
    (!is_possible).then(|| {
        format!(
            "a time_increment of {increment_s} s between {} beams, which is {turn_s:.6} s per turn, expected {} to {} s",
            message.ranges.len(),
            TURN_S.0,
            TURN_S.1
        )
    })
}

/// Counts of the readings of planar scans.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct PlanarReadings {
    pub(crate) n_scans: u64,
    /// Number of scans whose `range_max` is not set.
    n_without_range_max: u64,
    /// Number of scans with an impossible time between beams, and the first of them.
    time_fault: Option<(u64, String)>,
    /// Number of scans with times of their beams, and the sum of the times from the first beam to the last
    /// \[s\]. The mean counts: drivers that measure the time give single scans a time that is too long.
    durations: (u64, f64),
    /// Least and largest limits of the messages \[m\].
    own_limits: Option<(f32, f32)>,
    n_readings: u64,
    /// Number of positive finite readings, by range: bucket `k` starts at 2^(k/2 - 16) m.
    n_by_range: Vec<u64>,
    /// Number of positive finite readings within the limits of the message.
    n_own: u64,
    n_returns: u64,
}

/// Number of range buckets: from 2^-16 m to 2^24 m.
const N_BUCKETS: usize = 80;

impl PlanarReadings {
    /// The range limits of a message. A maximum that is 0 or less, or NaN, is not set.
    pub(crate) fn own_limits(&mut self, message: &LaserScan) -> std::ops::Range<f32> {
        let is_set = 0.0 < message.range_max;
        self.n_without_range_max += u64::from(!is_set);
        let max = if is_set { message.range_max } else { f32::INFINITY };
        // A minimum that is NaN excludes nothing.
        let min = if message.range_min.is_nan() { 0.0 } else { message.range_min };
        let (least, largest) = self.own_limits.unwrap_or((min, max));
        self.own_limits = Some((least.min(min), largest.max(max)));
        min..max
    }

    /// Counts a scan with an impossible time between beams.
    pub(crate) fn add_time_fault(&mut self, fault: String) {
        self.time_fault.get_or_insert((0, fault)).0 += 1;
    }

    /// Adds the time from the first beam to the last \[s\].
    pub(crate) fn add_duration(&mut self, duration_s: f64) {
        self.durations.0 += 1;
        self.durations.1 += duration_s;
    }

    /// Counts a reading.
    #[inline]
    pub(crate) fn add(&mut self, range: f32, is_own: bool, is_return: bool) {
        self.n_readings += 1;
        if range.is_finite() && 0.0 < range {
            if self.n_by_range.is_empty() {
                self.n_by_range.resize(N_BUCKETS, 0);
            }
            self.n_by_range[bucket_of(range)] += 1;
            self.n_own += u64::from(is_own);
            self.n_returns += u64::from(is_return);
        }
    }

    /// Adds the counts of later messages.
    pub(crate) fn merge(&mut self, later: Self) {
        self.n_scans += later.n_scans;
        self.n_without_range_max += later.n_without_range_max;
        if let Some((n, fault)) = later.time_fault {
            self.time_fault.get_or_insert((0, fault)).0 += n;
        }
        self.durations.0 += later.durations.0;
        self.durations.1 += later.durations.1;
        self.own_limits = match (self.own_limits, later.own_limits) {
            (Some((a, b)), Some((c, d))) => Some((a.min(c), b.max(d))),
            (one, other) => one.or(other),
        };
        self.n_readings += later.n_readings;
        if self.n_by_range.len() < later.n_by_range.len() {
            self.n_by_range.resize(N_BUCKETS, 0);
        }
        self.n_by_range.iter_mut().zip(&later.n_by_range).for_each(|(a, b)| *a += b);
        self.n_own += later.n_own;
        self.n_returns += later.n_returns;
    }

    /// The median of the positive finite readings \[m\], to within a factor of 1.2.
    fn median_m(&self) -> Option<f64> {
        let n: u64 = self.n_by_range.iter().sum();
        let mut n_below = 0;
        let bucket = self.n_by_range.iter().position(|n_in| {
            n_below += n_in;
            n < 2 * n_below
        })?;
        Some(libm::exp2((bucket as f64 + 0.5) / 2.0 - 16.0))
    }

    /// Why the readings cannot be ranges in metres, or why none of them is a return. `None` if there
    /// are returns, or no readings.
    pub(crate) fn fault(&self, options: &LidarOptions) -> Option<String> {
        let n = self.n_readings;
        let median_m = match self.median_m() {
            None if n == 0 => return None,
            None => return Some(format!("none of its {n} readings is a positive finite number")),
            Some(median_m) => median_m,
        };
        let n_positive: u64 = self.n_by_range.iter().sum();
        let (min_m, max_m) = self.own_limits.unwrap_or((0.0, f32::INFINITY));
        let is_far = MAX_MEDIAN_M < median_m && median_m.is_finite();
        let hint = match (is_far, median_m / 1000.0 < options.range_max_m) {
            (true, true) => "; are they millimetres? LaserScan has metres",
            _ => "",
        };
        let readings =
            format!("{n_positive} positive readings, with a median of about {median_m:.3} m");
        if self.n_own == 0 {
            return Some(format!(
                "all {readings}, lie outside of the message's own limits, range_min {min_m} m to range_max {max_m} m{hint}"
            ));
        }
        if self.n_returns == 0 {
            return Some(format!(
                "all {readings}, lie outside of the limits, {} to {} m by `ingest.lidar.range_min_m` and `range_max_m`, and {min_m} to {max_m} m by the message{hint}",
                options.range_min_m, options.range_max_m
            ));
        }
        // Far readings beyond the limits of the message are a code for no return.
        let is_within = median_m < f64::from(max_m);
        (is_far && is_within)
            .then(|| format!("its {readings}, are too far for a planar scan{hint}"))
    }

    /// Remarks about scans that were used. `period_s` is the time between two messages.
    pub(crate) fn notes(&self, period_s: Option<f64>) -> Vec<NoteKind> {
        let mut notes = Vec::new();
        let duration_s = self.durations.1 / self.durations.0.max(1) as f64;
        if let Some(period_s) = period_s.filter(|period_s| MAX_PERIODS * period_s < duration_s) {
            notes.push(NoteKind::ScanLongerThanPeriod { duration_s, period_s });
        }
        if let n_scans @ 1.. = self.n_without_range_max {
            notes.push(NoteKind::RangeMaxUnset { n_scans });
        }
        if let Some((n_scans, example)) = self.time_fault.clone() {
            notes.push(NoteKind::TimeIncrementIgnored { n_scans, example });
        }
        notes
    }
}

/// The range bucket of a positive finite reading. The upper bits of an `f32` are its exponent and half
/// steps of it.
#[inline]
fn bucket_of(range: f32) -> usize {
    let half_octaves = (range.to_bits() >> 22) as usize;
    // The bits of 2^-16 m.
    half_octaves.saturating_sub((127 - 16) * 2).min(N_BUCKETS - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Angles in degrees.
    fn message(start: f64, step: f64, n: usize, stated_end: Option<f64>) -> LaserScan {
        LaserScan {
            stamp_ns: 0,
            angle_min: start.to_radians(),
            angle_max: stated_end.map(f64::to_radians),
            angle_increment: step.to_radians(),
            time_increment_s: 0.0,
            range_min: 0.1,
            range_max: 30.0,
            ranges: vec![1.0; n],
        }
    }

    #[test]
    fn the_angles_of_real_drivers_agree() {
        for (start, step, n, end) in [
            (-90.0, 1.0, 181, 90.0),
            (-90.0, 0.5, 361, 90.0),
            (-135.0, 0.25, 1081, 135.0),
            // Clockwise, from 135 deg to -135 deg.
            (135.0, -1.0, 271, -135.0),
            // The end of the range, not the last beam.
            (0.0, 1.0, 360, 360.0),
            (-180.0, 0.72, 500, 180.0),
            (0.0, 1.0, 361, 360.0),
            // One beam.
            (0.0, 0.0, 1, 0.0),
        ] {
            assert_eq!(
                angle_fault(&message(start, step, n, Some(end))),
                None,
                "{start} {step} {n}"
            );
            assert_eq!(angle_fault(&message(start, step, n, None)), None);
        }
        // 0.0175 rad instead of 0.017453 rad.
        let mut rounded = message(0.0, 1.0, 360, Some(359.0));
        rounded.angle_increment = 0.0175;
        assert_eq!(angle_fault(&rounded), None);
    }

    #[test]
    fn contradictory_angles_are_named_with_their_numbers() {
        let fault = |start, step, n, end| angle_fault(&message(start, step, n, Some(end))).unwrap();
        assert_eq!(
            fault(-135.0, -1.0, 271, 135.0),
            "angle_min -135.00 deg + 270 * angle_increment -1.00 deg = -405.00 deg, but angle_max is 135.00 deg: off by 540.00 deg"
        );
        assert!(fault(-135.0, 0.5, 271, 135.0).contains("off by 135.00 deg"));
        assert!(
            fault(0.0, 0.0, 271, 270.0).contains("angle_increment is 0, but there are 271 beams")
        );
        assert!(fault(0.0, 1.0, 721, 720.0).contains("cover 2.00 turns"));
        let mut in_degrees = message(0.0, 0.0, 271, None);
        (in_degrees.angle_min, in_degrees.angle_increment) = (-135.0, 1.0);
        let fault = angle_fault(&in_degrees).unwrap();
        assert!(fault.ends_with("are the angles in degrees? That would be 270.0 deg"), "{fault}");
    }

    #[test]
    fn a_turn_of_the_mirror_takes_a_possible_time() {
        // 40 Hz and 75 Hz, with beams every 0.25 and 0.5 deg.
        for (step, time_increment_s) in [(0.25, 0.025 / 1440.0), (0.5, 1.0 / 75.0 / 720.0)] {
            let message = LaserScan { time_increment_s, ..message(0.0, step, 100, None) };
            assert_eq!(turn_fault(&message), None);
        }
        // The time of a scan, milliseconds, a unit that is too small, and a negative time.
        for time_increment_s in [0.1, 0.278, 2.78e-7, -2.78e-4, f64::INFINITY] {
            let message = LaserScan { time_increment_s, ..message(0.0, 1.0, 360, None) };
            assert!(turn_fault(&message).is_some(), "{time_increment_s}");
        }
    }

    /// Readings with their own limits 0.1 to `range_max`, and with those of the options, 0.9 to 70 m.
    fn readings(ranges: &[f32], range_max: f32) -> PlanarReadings {
        let mut readings = PlanarReadings { n_scans: 1, ..PlanarReadings::default() };
        let limits = readings.own_limits(&LaserScan { range_max, ..message(0.0, 1.0, 2, None) });
        for &range in ranges {
            let is_own = limits.contains(&range);
            readings.add(range, is_own, is_own && (0.9..=70.0).contains(&range));
        }
        readings
    }

    #[test]
    fn readings_without_a_return_are_faults_and_millimetres_are_named() {
        let options = LidarOptions::default();
        let fault = |ranges: &[f32], range_max| readings(ranges, range_max).fault(&options);
        assert_eq!(fault(&[1.0, 5.0, f32::INFINITY], 30.0), None);
        assert_eq!(fault(&[], 30.0), None);
        // No return is coded as 8191 mm in most beams, as by an old SICK.
        assert_eq!(fault(&[8191.0, 8191.0, 8191.0, 5.0], 80.0), None);
        assert!(fault(&[f32::NAN, 0.0], 30.0).unwrap().contains("none of its 2 readings"));
        let text = fault(&[1500.0, 2500.0, 12_000.0], 30.0).unwrap();
        assert!(text.starts_with("all 3 positive readings"), "{text}");
        assert!(
            text.contains("range_min 0.1 m to range_max 30 m; are they millimetres?"),
            "{text}"
        );
        let text = fault(&[1500.0, 2500.0, 12_000.0], 30_000.0).unwrap();
        assert!(text.contains("0.9 to 70 m by `ingest.lidar.range_min_m`"), "{text}");
        assert!(text.contains("millimetres"), "{text}");
        // One obstacle at 60 mm is within the limits of the options.
        let text = fault(&[60.0, 2500.0, 12_000.0], 30_000.0).unwrap();
        assert!(text.contains("too far for a planar scan"), "{text}");
    }

    /// A driver that measures the time from scan to scan, on a host that was busy once.
    #[test]
    fn one_long_scan_is_no_fault() {
        let with = |long: usize| {
            let mut readings = readings(&[1.0], 30.0);
            (0..100).for_each(|k| readings.add_duration(if k < long { 0.9 } else { 0.1 }));
            readings.notes(Some(0.1))
        };
        assert_eq!(with(1), []);
        let notes = with(50);
        assert!(matches!(notes[..], [NoteKind::ScanLongerThanPeriod { .. }]), "{notes:?}");
    }

    #[test]
    fn a_scan_takes_no_longer_than_the_time_to_the_next() {
        let mut readings = readings(&[1.0], 30.0);
        readings.add_duration(0.1);
        for (period_s, n_notes) in [(None, 0), (Some(0.1), 0), (Some(0.07), 0), (Some(0.05), 1)] {
            assert_eq!(readings.notes(period_s).len(), n_notes, "{period_s:?}");
        }
    }

    #[test]
    fn a_range_max_of_zero_is_not_set() {
        for range_max in [0.0, -1.0, f32::NAN] {
            let readings = readings(&[1.0, 5.0], range_max);
            assert_eq!(readings.fault(&LidarOptions::default()), None);
            assert_eq!(readings.notes(None), [NoteKind::RangeMaxUnset { n_scans: 1 }]);
        }
    }

    #[test]
    fn the_median_is_that_of_the_bucket() {
        for (range, bucket) in [(1.0, 32), (1.4, 32), (1.6, 33), (2.0, 34), (1e-9, 0), (1e30, 79)] {
            assert_eq!(bucket_of(range), bucket, "{range}");
        }
        let mut one = readings(&[1.0, 1.1], 30.0);
        one.merge(readings(&[20.0], 30.0));
        let median = one.median_m().unwrap();
        assert!((1.0..1.5).contains(&median), "{median}");
    }
}
