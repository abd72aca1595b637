//! Gives a scan the log time of its message.

use crate::deskew::timed_scan::TimedScan;
use crate::stamp::Stamp;

/// Sets the stamp of a scan so that its last return has the log time. A message is recorded after its
/// last return was measured. Without the times of the returns, the stamp is the log time.
pub(crate) fn restamp(mut timed: TimedScan, log_ns: u64) -> TimedScan {
    let last_ns = timed.times_ns.iter().max().copied().unwrap_or(0);
    timed.scan.stamp_ns = Stamp::Log.select(0, log_ns).saturating_sub(last_ns);
    timed
}

#[cfg(test)]
mod tests {
    use super::*;
    use dataset::Scan;

    #[test]
    fn the_last_return_has_the_log_time() {
        let scan = Scan { stamp_ns: 7, ..Scan::default() };
        let timed = TimedScan { scan, times_ns: vec![0, 30, 100] };
        assert_eq!(restamp(timed.clone(), 1000).scan.stamp_ns, 900);
        assert_eq!(restamp(TimedScan { times_ns: vec![], ..timed }, 1000).scan.stamp_ns, 1000);
    }
}
