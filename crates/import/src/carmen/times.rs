//! Checks whether the times of a log can be used, and stamps messages.
//!
//! Corrected logs are often published without times (all zero), and some loggers wrote a counter that
//! wraps around. Such times do not relate a scan to its pose, but the line does.

/// A time that is earlier by more than this than a time before it is not in order \[ns\]. Loggers write buffers
/// of several sensors one after the other: in the log `intel-lab`, scans step back by up to 0.9 s. The
/// smallest counter that wraps in practice, milliseconds in 16 bits, steps back by 65 s.
pub(super) const MAX_STEP_BACK_NS: i64 = 10_000_000_000;
/// If at most this share of the times is out of range or out of order, these lines are dropped and counted. Otherwise
/// the clock of the log is not usable.
const MAX_DROPPED_SHARE: f64 = 0.01;
/// If more than this share of the scans has the time of the previous scan, the times do not advance
/// with the scans. A healthy sensor has a new time for each scan. In the log `austin-aces`, 0.4 % of
/// the odometry repeats a time.
const MAX_REPEATED_SHARE: f64 = 0.1;
/// Time from one scan to the next if messages are stamped by line \[ns\]: about the rate of a SICK LMS
/// at 38400 baud, the usual scanner of CARMEN.
const SCAN_PERIOD_NS: i64 = 200_000_000;
/// The first time that a ROS message cannot contain \[ns\]: its seconds are a signed 32-bit number.
const END_NS: i64 = i32::MAX as i64 * 1_000_000_000;

/// What is known about the times of one kind of line.
#[derive(Debug, Clone, Default)]
pub(super) struct Times {
    pub n: u64,
    n_zero: u64,
    n_negative: u64,
    n_too_late: u64,
    n_repeated: u64,
    previous_ns: Option<i64>,
    latest_ns: i64,
    n_stepped_back: u64,
    largest_step_back_ns: i64,
}

impl Times {
    pub fn add(&mut self, stamp_ns: i64) {
        self.n += 1;
        self.n_zero += u64::from(stamp_ns == 0);
        self.n_negative += u64::from(stamp_ns < 0);
        self.n_too_late += u64::from(END_NS <= stamp_ns);
        if !(0..END_NS).contains(&stamp_ns) {
            return;
        }
        if let Some(previous_ns) = self.previous_ns {
            self.n_repeated += u64::from(previous_ns == stamp_ns);
            self.n_stepped_back += u64::from(MAX_STEP_BACK_NS < self.latest_ns - stamp_ns);
            self.largest_step_back_ns = self.largest_step_back_ns.max(self.latest_ns - stamp_ns);
        }
        self.previous_ns = Some(stamp_ns);
        self.latest_ns = self.latest_ns.max(stamp_ns);
    }

    /// Why these times cannot be used.
    pub fn fault(&self) -> Option<String> {
        let exceeds = |n: u64, share: f64| share * (self.n as f64) < n as f64;
        if 1 < self.n_zero && exceeds(self.n_zero, MAX_REPEATED_SHARE) {
            return Some(format!("{} of them are 0", self.n_zero));
        }
        if exceeds(self.n_negative, MAX_DROPPED_SHARE) {
            return Some(format!("{} of them are negative", self.n_negative));
        }
        if exceeds(self.n_too_late, MAX_DROPPED_SHARE) {
            return Some(format!("{} of them are after 2037", self.n_too_late));
        }
        if exceeds(self.n_stepped_back, MAX_DROPPED_SHARE) {
            let secs = self.largest_step_back_ns as f64 * 1e-9;
            return Some(format!("they step back by up to {secs:.1} s"));
        }
        if exceeds(self.n_repeated, MAX_REPEATED_SHARE) {
            return Some(format!("{} of them repeat the time of the line before", self.n_repeated));
        }
        None
    }
}

/// Gives each message its stamp.
#[derive(Debug, Clone)]
pub(super) enum Clock {
    /// The time of the line.
    Recorded,
    /// The number of the message.
    Line { next_ns: i64, step_ns: i64 },
}

impl Clock {
    /// Stamps by line, `SCAN_PERIOD_NS` from scan to scan on average.
    pub fn by_line(after_ns: i64, n_scans: u64, n_lines: u64) -> Self {
        let period_ns = i128::from(SCAN_PERIOD_NS) * i128::from(n_scans.max(1));
        let step_ns = i64::try_from(period_ns / i128::from(n_lines.max(1))).unwrap_or(i64::MAX);
        let step_ns = step_ns.max(1);
        Self::Line { next_ns: after_ns.saturating_add(step_ns), step_ns }
    }

    /// The stamp of the next message, whose line has the time `recorded_ns`.
    pub fn stamp_ns(&mut self, recorded_ns: i64) -> i64 {
        match self {
            Self::Recorded => recorded_ns,
            Self::Line { next_ns, step_ns } => {
                let stamp_ns = *next_ns;
                *next_ns = next_ns.saturating_add(*step_ns);
                stamp_ns
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(times_s: impl IntoIterator<Item = f64>) -> Option<String> {
        let mut times = Times::default();
        times_s.into_iter().for_each(|s| times.add((s * 1e9) as i64));
        times.fault()
    }

    #[test]
    fn times_that_do_not_advance_are_refused() {
        let drive = |k: u32| 100.0 + f64::from(k) * 0.2;
        assert_eq!(fault((0..200).map(drive)), None);
        assert_eq!(fault((0..40).map(|_| 0.0)).unwrap(), "40 of them are 0");
        assert_eq!(fault((0..40).map(|k| drive(k) - 102.0)).unwrap(), "10 of them are negative");
        assert_eq!(fault((0..40).map(|k| drive(k) * 1e8)).unwrap(), "40 of them are after 2037");
        // A counter that wraps after 65.536 s: from 65.4 s to 65.6 - 65.536 s.
        let wrapped = (0..400).map(|k| (f64::from(k) * 0.2) % 65.536);
        assert_eq!(fault(wrapped).unwrap(), "they step back by up to 65.3 s");
        // Whole seconds, 5 scans each.
        let coarse = (0..40).map(|k| f64::from(k / 5 + 7));
        assert_eq!(fault(coarse).unwrap(), "32 of them repeat the time of the line before");
        assert_eq!(fault([5.0; 8]).unwrap(), "7 of them repeat the time of the line before");
    }

    #[test]
    fn a_relative_clock_and_buffers_of_a_second_are_healthy() {
        assert_eq!(fault((0..10).map(|k| f64::from(k) * 0.2)), None, "starts at 0");
        assert_eq!(fault([0.0]), None);
        let buffered = (0..40u32).map(|k| f64::from(k / 5 * 5 + (4 - k % 5)) * 0.2);
        assert_eq!(fault(buffered), None);
        let one_of_200 = (0..200).map(|k| if k == 7 { -1.0 } else { f64::from(k) });
        assert_eq!(fault(one_of_200), None, "one line of 200 is dropped");
        let zero_of_200 = (0..200).map(|k| if k == 7 { 0.0 } else { 1e9 + f64::from(k) });
        assert_eq!(fault(zero_of_200), None, "one line of 200 is dropped");
    }
}
