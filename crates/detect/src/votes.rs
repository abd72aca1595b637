//! Candidate poses in the map from several positions along the path, and where they agree.

use std::collections::VecDeque;

use dataset::Pose2;

/// A pose of the local frame in a map, from one position.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Vote {
    pub(crate) map: u32,
    pub(crate) map_from_local: Pose2,
    /// Where the scans were, in the local frame.
    pub(crate) local: Pose2,
    /// See [`model::Evidence::margin`].
    pub(crate) margin: f64,
    /// Confidence of the detector, 0 to 1.
    pub(crate) confidence: f64,
}

/// The votes of one position.
struct Ballot {
    path_m: f64,
    votes: Vec<Vote>,
}

/// The votes of the last metres.
pub(crate) struct Votes {
    ballots: VecDeque<Ballot>,
    /// Confidence from which a vote speaks for a pose.
    min_confidence: f64,
}

/// Votes older than this are forgotten \[m\]. Longer than the 20 m of driving that a fix may take.
const MEMORY_M: f64 = 25.0;
/// The most positions that are remembered.
const MAX_BALLOTS: usize = 40;
/// Two votes agree if they put the place between them at the same position and heading, within this \[m\]: the
/// error of an alignment plus the drift of scan matching.
const AGREES_M: f64 = 1.0;
const AGREES_DEG: f64 = 6.0;
/// Two votes contradict each other if they differ by more than this \[m\]. Votes in between are other
/// positions along a corridor; they speak neither for nor against.
const CONTRADICTS_M: f64 = 3.0;
const CONTRADICTS_DEG: f64 = 15.0;
/// The least number of positions that agree.
const MIN_POSITIONS: usize = 4;
/// The least path from the first to the last of them \[m\].
const MIN_SPAN_M: f64 = 3.0;
/// The least path of all scans that they have seen \[m\].
const MIN_PATH_M: f64 = 9.0;
/// The least share of the positions from the first one that agrees to the last.
const MIN_SHARE: f64 = 0.6;
/// The least support. Look-alikes on the simulated campus had up to 14.
const MIN_LOG_ODDS: f64 = 18.0;
/// The most that one position counts.
const MAX_LOG_ODDS: f64 = 6.0;
/// The best rival has at most this share of the support.
const MAX_RIVAL: f64 = 0.5;

/// How two votes relate.
fn difference(a: &Vote, b: &Vote) -> (f64, f64) {
    let middle = a.local.towards(&b.local, 0.5);
    let [a, b] = [a, b].map(|vote| vote.map_from_local * middle);
    (a.distance_m(&b), a.heading_difference_rad(&b))
}

impl Vote {
    /// Whether two votes are for the same pose.
    pub(crate) fn agrees(&self, other: &Self) -> bool {
        let (off_m, off_rad) = difference(self, other);
        self.map == other.map && off_m < AGREES_M && off_rad < AGREES_DEG.to_radians()
    }
}

fn contradicts(a: &Vote, b: &Vote) -> bool {
    let (off_m, off_rad) = difference(a, b);
    a.map != b.map || CONTRADICTS_M < off_m || CONTRADICTS_DEG.to_radians() < off_rad
}

/// The log odds of a confidence.
fn log_odds(confidence: f64) -> f64 {
    libm::log(confidence / (1.0 - confidence))
}

impl Votes {
    /// No votes. From `min_confidence` on, a vote speaks for a pose.
    pub(crate) fn new(min_confidence: f64) -> Self {
        Self { ballots: VecDeque::new(), min_confidence }
    }

    /// Adds the votes of the next position.
    pub(crate) fn add(&mut self, path_m: f64, votes: Vec<Vote>) {
        self.ballots.push_back(Ballot { path_m, votes });
        let from_m = path_m - MEMORY_M;
        while MAX_BALLOTS < self.ballots.len()
            || self.ballots.front().is_some_and(|ballot| ballot.path_m < from_m)
        {
            self.ballots.pop_front();
        }
    }

    pub(crate) fn clear(&mut self) {
        self.ballots.clear();
    }

    /// The votes with the most support, each for another pose.
    pub(crate) fn leaders(&self, n: usize) -> Vec<Vote> {
        let all = self.ballots.iter().rev().flat_map(|ballot| &ballot.votes);
        let mut ranked: Vec<(f64, Vote)> = all.map(|vote| (self.support(vote), *vote)).collect();
        // Stable: of equal ones, the latest comes first.
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut leaders: Vec<Vote> = Vec::with_capacity(n);
        for (_, vote) in ranked {
            if leaders.len() < n && !leaders.iter().any(|leader| leader.agrees(&vote)) {
                leaders.push(vote);
            }
        }
        leaders
    }

    /// The vote that decides, if enough positions along enough path agree with it, and no other pose is
    /// nearly as well supported.
    pub(crate) fn winner(&self) -> Option<Vote> {
        let all = || self.ballots.iter().flat_map(|ballot| &ballot.votes);
        // Of equal ones, the latest: it needs no motion to be the pose of now.
        let (winner, support) = all().map(|vote| (*vote, self.support(vote))).fold(
            None::<(Vote, f64)>,
            |best, next| match best {
                Some(best) if next.1 < best.1 => Some(best),
                _ => Some(next),
            },
        )?;
        let is_for = |ballot: &Ballot| {
            let is_for =
                |vote: &Vote| self.min_confidence <= vote.confidence && winner.agrees(vote);
            ballot.votes.iter().any(is_for)
        };
        let rivals = all().filter(|vote| contradicts(&winner, vote));
        let rival = rivals.map(|vote| self.support(vote)).fold(0.0, f64::max);
        (self.is_enough(&is_for, support) && rival <= MAX_RIVAL * support).then_some(winner)
    }

    /// Whether the positions that vote for a pose are enough. Their share is that since one of them: the first
    /// positions may have seen little.
    fn is_enough(&self, is_for: impl Fn(&Ballot) -> bool, support: f64) -> bool {
        let votes: Vec<(f64, bool)> =
            self.ballots.iter().map(|ballot| (ballot.path_m, is_for(ballot))).collect();
        let Some(last) = votes.iter().rposition(|vote| vote.1) else { return false };
        let is_since = |first: usize| {
            let n_for = votes[first..].iter().filter(|vote| vote.1).count();
            let n_since = votes.len() - first;
            votes[first].1
                && MIN_POSITIONS <= n_for
                && MIN_SPAN_M <= votes[last].0 - votes[first].0
                && MIN_SHARE * n_since as f64 <= n_for as f64
        };
        MIN_LOG_ODDS <= support
            && MIN_PATH_M <= votes[last].0
            && (0..=last).any(is_since)
    }

    /// The sum over the positions of the weight of the most confident vote that agrees: its log odds minus those
    /// of `min_confidence`, from 0 to [`MAX_LOG_ODDS`].
    fn support(&self, vote: &Vote) -> f64 {
        let of_ballot = |ballot: &Ballot| {
            let agreeing = ballot.votes.iter().filter(|other| vote.agrees(other));
            let confidence = agreeing.map(|other| other.confidence).fold(0.0, f64::max);
            (log_odds(confidence) - log_odds(self.min_confidence)).clamp(0.0, MAX_LOG_ODDS)
        };
        self.ballots.iter().map(of_ballot).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vote(x_m: f64, at_m: f64, confidence: f64) -> Vote {
        let at = |x_m| Pose2 { x_m, ..Pose2::default() };
        Vote { map: 0, map_from_local: at(x_m), local: at(at_m), margin: 0.2, confidence }
    }

    /// Positions every metre from 6 m on. The first one with 9 m of path behind it is the fourth. The log odds of
    /// 0.99 are 4.6, four times that is more than 18.
    #[test]
    fn four_positions_that_agree_decide() {
        let mut votes = Votes::new(0.5);
        for k in 0..4 {
            assert!(votes.winner().is_none(), "{k}");
            let path_m = 6.0 + f64::from(k);
            votes.add(
                path_m,
                vec![vote(50.0, path_m, 0.99), vote(f64::from(k) * 20.0, path_m, 0.6)],
            );
        }
        assert!(
            votes.winner().is_some_and(|winner| (winner.map_from_local.x_m - 50.0).abs() < 1e-9)
        );
    }

    /// The log odds of 0.99 and 0.9 are 4.6 and 2.2: less than half. Those of 0.92 are 2.44.
    #[test]
    fn a_rival_with_more_than_half_of_the_log_odds_prevents_a_decision() {
        for (confidence, is_decided) in [(0.9, true), (0.92, false)] {
            let mut votes = Votes::new(0.5);
            for k in 0..4 {
                let path_m = 6.0 + f64::from(k);
                let both = vec![vote(50.0, path_m, 0.99), vote(10.0, path_m, confidence)];
                votes.add(path_m, both);
            }
            assert_eq!(votes.winner().is_some(), is_decided);
        }
    }

    /// A robot that does not move forgets by number, one that drives by path.
    #[test]
    fn the_number_of_positions_is_bounded() {
        let mut votes = Votes::new(0.5);
        for k in 0..1000 {
            votes.add(if k < 500 { 0.0 } else { f64::from(k) }, vec![vote(0.0, 0.0, 0.9)]);
            assert!(votes.ballots.len() <= MAX_BALLOTS);
        }
        // Metres 974 to 999.
        assert_eq!(votes.ballots.len(), 26);
        assert!(votes.leaders(4).len() == 1);
    }
}
