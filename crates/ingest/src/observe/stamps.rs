//! Compares the stamps of a topic with the log times of its messages.
//!
//! The log time is when the recorder received a message. It follows the stamp by the delay of driver
//! and transport. The least delay is nearly constant, so a lasting change shows that a clock was set.
//! The delay itself is only known up to the difference of the two clocks: a log that was played and
//! recorded again has stamps that are years older than its log times.

use std::collections::VecDeque;

/// Messages within this time are summarized by the one with the least delay \[ns\]. A recorder that
/// catches up after a pause writes many late messages at once.
const BUCKET_NS: u64 = 100_000_000;
/// A delay that returns to its earlier value within this time is a busy host, not a step \[ns\].
const LASTING_NS: u64 = 10_000_000_000;
/// Number of buckets before and after a step, at least.
const MIN_BUCKETS: usize = 3;
/// Smallest step that is reported \[ns\]. `ntpd` steps a clock that is wrong by more than 0.128 s, and
/// corrects smaller errors by changing its rate. The delay of a busy host can change by as much, so
/// the limit is twice that.
const MIN_STEP_NS: i64 = 256_000_000;
/// A message that is earlier than a message before it by up to this time is late, not stamped by a clock
/// that was set \[ns\]. The order of poses has the same limit.
const LATE_NS: i64 = 100_000_000;
/// A message that is earlier than a message before it starts a step back if this many messages in a
/// row are. Threads and networks exchange neighbours, but not more.
const MIN_MESSAGES_BACK: u64 = 3;

/// A clock is set a few times in a drive at most. With more steps back than this, and with one in fewer
/// than this number of messages, the stamps are irregular: the scanner of the Intel lab log has 324 in
/// 13 631 messages, of up to 0.9 s.
const MAX_STEPS_BACK: usize = 8;
const MIN_MESSAGES_PER_STEP: u64 = 100;

/// Compares stamps with log times, message by message.
#[derive(Debug, Clone, Default)]
pub(crate) struct StampObserver {
    n_messages: u64,
    /// Number of messages with the stamp of the message before.
    n_equal: u64,
    /// Number of single messages that are earlier than a message before them.
    n_out_of_order: u64,
    first: Option<(i64, u64)>,
    last: Option<(i64, u64)>,
    /// The latest stamp since the last step back \[ns\].
    latest_ns: i64,
    /// Stamp, log time and number of the messages in a row that are before the latest stamp.
    behind: Option<(i64, u64, u64)>,
    steps_back: Vec<StampStep>,
    buckets: Vec<Bucket>,
}

/// A step of the clock that stamps the messages.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct StampStep {
    /// Log time of the first message after the step \[ns\].
    pub(crate) log_ns: u64,
    /// Size of the step; negative if the clock was set back \[ns\].
    pub(crate) step_ns: i64,
}

/// Successive messages.
#[derive(Debug, Clone, Copy)]
struct Bucket {
    /// Log time of the first message \[ns\].
    log_ns: u64,
    /// Least log time minus stamp \[ns\].
    delay_ns: i64,
}

impl StampObserver {
    /// Adds the next message of the topic.
    pub(crate) fn add(&mut self, stamp_ns: i64, log_ns: u64) {
        self.n_messages += 1;
        self.add_order(stamp_ns, log_ns);
        let delay_ns = (log_ns as i64).saturating_sub(stamp_ns);
        match self.buckets.last_mut() {
            Some(bucket) if log_ns.abs_diff(bucket.log_ns) < BUCKET_NS => {
                bucket.delay_ns = bucket.delay_ns.min(delay_ns);
            }
            _ => self.buckets.push(Bucket { log_ns, delay_ns }),
        }
        self.first.get_or_insert((stamp_ns, log_ns));
        self.last = Some((stamp_ns, log_ns));
    }

    fn add_order(&mut self, stamp_ns: i64, log_ns: u64) {
        if self.last.is_some_and(|(last_ns, _)| last_ns == stamp_ns) {
            self.n_equal += 1;
            return;
        }
        if self.last.is_none() || self.latest_ns < stamp_ns {
            self.n_out_of_order += self.behind.take().map_or(0, |(_, _, n)| n);
            self.latest_ns = stamp_ns;
            return;
        }
        if self.latest_ns.saturating_sub(stamp_ns) <= LATE_NS {
            self.n_out_of_order += 1;
            return;
        }
        let (from_ns, from_log_ns, n) = self.behind.unwrap_or((stamp_ns, log_ns, 0));
        self.behind = Some((from_ns, from_log_ns, n + 1));
        if n + 1 == MIN_MESSAGES_BACK {
            let step_ns = from_ns.saturating_sub(self.latest_ns);
            self.steps_back.push(StampStep { log_ns: from_log_ns, step_ns });
            self.behind = None;
            self.latest_ns = stamp_ns;
        }
    }

    pub(crate) fn n_messages(&self) -> u64 {
        self.n_messages
    }

    /// Mean time between messages, by the log \[s\]. `None` for less than three messages.
    pub(crate) fn period_s(&self) -> Option<f64> {
        let ((_, first_ns), (_, last_ns)) = (self.first?, self.last?);
        let n_steps = self.n_messages.checked_sub(1).filter(|&n| MIN_MESSAGES_BACK <= n + 1)?;
        Some(last_ns.abs_diff(first_ns) as f64 * 1e-9 / n_steps as f64).filter(|s| 0.0 < *s)
    }

    /// Number of messages with the stamp of the message before.
    pub(crate) fn n_equal(&self) -> u64 {
        self.n_equal
    }

    /// Number of single messages that are earlier than a message before them.
    pub(crate) fn n_out_of_order(&self) -> u64 {
        let irregular = if self.is_irregular() { self.steps_back.len() } else { 0 };
        self.n_out_of_order + self.behind.map_or(0, |(_, _, n)| n) + irregular as u64
    }

    /// Whether the stamps step back so often that no clock was set.
    fn is_irregular(&self) -> bool {
        let n_steps = self.steps_back.len();
        MAX_STEPS_BACK < n_steps && self.n_messages < MIN_MESSAGES_PER_STEP * n_steps as u64
    }

    /// The stamp, if three messages or more have the same one, although the log time advances \[ns\].
    pub(crate) fn only_stamp_ns(&self) -> Option<i64> {
        let is_only = MIN_MESSAGES_BACK <= self.n_messages && self.n_equal + 1 == self.n_messages;
        let ((stamp_ns, first_ns), (_, last_ns)) = (self.first?, self.last?);
        (is_only && BUCKET_NS <= last_ns.abs_diff(first_ns)).then_some(stamp_ns)
    }

    /// The places where the stamps step back, in the order of the log. There, several messages in a
    /// row are earlier than a message before them.
    pub(crate) fn steps_back(&self) -> &[StampStep] {
        if self.is_irregular() { &[] } else { &self.steps_back }
    }

    /// Log time minus stamp \[s\]: the median over the log of the least delay in 0.1 s. `None` if the
    /// log times do not advance, or there are fewer than three messages.
    pub(crate) fn delay_s(&self) -> Option<f64> {
        let ((_, first_ns), (_, last_ns)) = (self.first?, self.last?);
        if first_ns == last_ns || self.n_messages < MIN_MESSAGES_BACK {
            return None;
        }
        let mut delays: Vec<i64> = self.buckets.iter().map(|bucket| bucket.delay_ns).collect();
        delays.sort_unstable();
        Some(delays[delays.len() / 2] as f64 * 1e-9)
    }

    /// The lasting changes of log time minus stamp of more than 0.256 s, in the order of the log. A
    /// step is positive if the clock of the stamps was set forward.
    pub(crate) fn steps_against_log(&self) -> Vec<StampStep> {
        let buckets = &self.buckets;
        let least_before = window_minima(buckets.iter().copied());
        let mut least_from = window_minima(buckets.iter().rev().copied());
        least_from.reverse();
        let last = buckets.len().saturating_sub(MIN_BUCKETS);
        (MIN_BUCKETS..=last)
            .filter(|&k| k < buckets.len())
            .filter_map(|k| {
                let change_ns = least_from[k].saturating_sub(least_before[k - 1]);
                let at_once_ns = buckets[k].delay_ns.saturating_sub(buckets[k - 1].delay_ns);
                let is_sudden = change_ns.saturating_abs() / 2 < at_once_ns.saturating_abs()
                    && (change_ns < 0) == (at_once_ns < 0);
                let is_step = MIN_STEP_NS < change_ns.saturating_abs() && is_sudden;
                let step_ns = change_ns.saturating_neg();
                is_step.then_some(StampStep { log_ns: buckets[k].log_ns, step_ns })
            })
            .collect()
    }
}

/// For each bucket, the least delay of the buckets from 10 s before it to the bucket itself, and of
/// three buckets at least \[ns\].
fn window_minima(buckets: impl Iterator<Item = Bucket>) -> Vec<i64> {
    // The candidates ascend in delay: a bucket with a higher delay than a later one is never the least.
    let mut candidates: VecDeque<(usize, Bucket)> = VecDeque::new();
    buckets
        .enumerate()
        .map(|(k, bucket)| {
            while candidates.back().is_some_and(|(_, last)| bucket.delay_ns <= last.delay_ns) {
                candidates.pop_back();
            }
            candidates.push_back((k, bucket));
            while let Some((index, oldest)) = candidates.front()
                && index + MIN_BUCKETS <= k
                && LASTING_NS < bucket.log_ns.abs_diff(oldest.log_ns)
            {
                candidates.pop_front();
            }
            candidates.front().map_or(bucket.delay_ns, |(_, least)| least.delay_ns)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: i64 = 1_000_000_000;

    /// Messages at `period_s`. `stamp_s` gives the stamp of a message by its true time.
    fn observe(n: u64, period_s: f64, stamp_s: impl Fn(u64, f64) -> f64) -> StampObserver {
        let mut observer = StampObserver::default();
        for k in 0..n {
            let true_s = 1000.0 + k as f64 * period_s;
            let stamp_ns = (stamp_s(k, true_s) * 1e9).round() as i64;
            observer.add(stamp_ns, ((true_s + 0.02) * 1e9).round() as u64);
        }
        observer
    }

    #[test]
    fn a_constant_offset_is_no_step() {
        for offset_s in [0.0, 18.0, -3600.0, -4e8] {
            let observer = observe(100, 0.1, |_, t| t + offset_s);
            assert!((observer.delay_s().unwrap() - 0.02 + offset_s).abs() < 1e-6);
            assert!(observer.steps_against_log().is_empty() && observer.steps_back().is_empty());
            assert_eq!((observer.n_out_of_order(), observer.only_stamp_ns()), (0, None));
        }
    }

    #[test]
    fn steps_of_the_clock_are_found_at_any_rate() {
        for (period_s, step_s) in [(0.1, -3.0), (0.1, 0.5), (0.01, 18.0), (1.0, -0.4), (5.0, -40.0)]
        {
            let observer = observe(80, period_s, |k, t| if k < 40 { t } else { t + step_s });
            let steps = observer.steps_against_log();
            assert_eq!(steps.len(), 1, "{period_s} {step_s} {steps:?}");
            assert!((steps[0].step_ns as f64 * 1e-9 - step_s).abs() < 1e-6);
            let at_s = steps[0].log_ns as f64 * 1e-9;
            assert!((at_s - 1000.02 - 40.0 * period_s).abs() < 0.11, "{at_s}");
            let is_back = step_s < -period_s;
            assert_eq!(observer.steps_back().len(), usize::from(is_back), "{period_s} {step_s}");
        }
    }

    #[test]
    fn the_size_of_a_step_back_is_measured_from_the_latest_stamp() {
        let observer = observe(80, 0.1, |k, t| if k < 40 { t } else { t - 3.0 });
        // From 1003.9 s to 1001.0 s.
        assert_eq!(
            observer.steps_back(),
            [StampStep { log_ns: 1_004_020_000_000, step_ns: -29 * S / 10 }]
        );
    }

    /// A recorder that pauses for 4 s writes 40 messages at once. A queue that fills and empties
    /// delays messages by up to 1 s, and for less than 10 s.
    #[test]
    fn a_busy_recorder_is_no_step() {
        let mut paused = StampObserver::default();
        let mut queued = StampObserver::default();
        for k in 0..400i64 {
            let stamp_ns = 1000 * S + k * S / 10;
            let log_ns = if (100..140).contains(&k) { 1014 * S + k } else { stamp_ns + 1 };
            paused.add(stamp_ns, log_ns as u64);
            let delay_ns = if (100..180).contains(&k) { S } else { 1 };
            queued.add(stamp_ns, (stamp_ns + delay_ns) as u64);
        }
        assert!(paused.steps_against_log().is_empty() && queued.steps_against_log().is_empty());
    }

    /// A simulation at a third of the speed of the clock on the wall.
    #[test]
    fn a_clock_of_another_rate_is_no_step() {
        let observer = observe(600, 0.1, |_, t| (t - 1000.0) / 3.0);
        assert!(observer.steps_against_log().is_empty());
    }

    #[test]
    fn exchanged_neighbours_are_out_of_order_and_no_step() {
        let observer = observe(100, 0.1, |k, t| match k % 10 {
            4 => t + 0.1,
            5 => t - 0.1,
            _ => t,
        });
        assert_eq!(observer.n_out_of_order(), 10);
        assert!(observer.steps_back().is_empty() && observer.steps_against_log().is_empty());
    }

    /// A second node on the topic, whose messages are 9 ms later than those of the first.
    #[test]
    fn messages_that_are_a_little_late_are_no_step() {
        let observer = observe(3000, 0.002, |k, t| if k % 125 == 0 { t } else { t - 0.009 });
        assert!(observer.steps_back().is_empty() && observer.steps_against_log().is_empty());
        assert!(observer.n_out_of_order() > 80, "{}", observer.n_out_of_order());
    }

    /// Every 20th message comes with two others, 0.5 s late.
    #[test]
    fn irregular_stamps_are_out_of_order_and_no_step() {
        let observer = observe(1000, 0.1, |k, t| if k % 20 < 3 { t - 0.5 } else { t });
        assert!(observer.steps_back().is_empty());
        assert_eq!(observer.n_out_of_order(), 49);
    }

    #[test]
    fn a_clock_that_stands_still_is_seen() {
        assert_eq!(observe(40, 0.1, |_, _| 77.0).only_stamp_ns(), Some(77 * S));
        assert_eq!(observe(2, 0.1, |_, _| 77.0).only_stamp_ns(), None);
        let coarse = observe(40, 0.1, |_, t| t.floor());
        assert_eq!((coarse.only_stamp_ns(), coarse.n_equal()), (None, 36));
        assert_eq!(StampObserver::default().delay_s(), None);
    }
}
