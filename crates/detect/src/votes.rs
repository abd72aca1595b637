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
struct Ballot<P> {
    path_m: f64,
    /// What the position has seen.
    place: P,
    votes: Vec<Vote>,
}

/// The votes of the last metres.
pub(crate) struct Votes<P> {
    ballots: VecDeque<Ballot<P>>,
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
/// The least share of the positions from one that agrees to the last.
const MIN_SHARE: f64 = 0.5;
/// The most that one position counts.
const MAX_LOG_ODDS: f64 = 9.0;
/// The least lead over other poses. It was chosen on the simulated campus, where the map has the true place, and where
/// the places around it were left out of the map.
const MIN_LEAD: f64 = 20.0;
/// The best rival has at most this share of the support.
const MAX_RIVAL: f64 = 0.7;

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

/// A confidence is never certain: differences of log odds stay finite.
const LEAST_DOUBT: f64 = 1e-12;

/// The log odds of a confidence.
fn log_odds(confidence: f64) -> f64 {
    let confidence = confidence.clamp(LEAST_DOUBT, 1.0 - LEAST_DOUBT);
    libm::log(confidence / (1.0 - confidence))
}

impl<P> Votes<P> {
    /// No votes. From `min_confidence` on, a vote speaks for a pose.
    pub(crate) fn new(min_confidence: f64) -> Self {
        Self { ballots: VecDeque::new(), min_confidence }
    }

    /// Adds the votes of the next position.
    pub(crate) fn add(&mut self, path_m: f64, place: P, votes: Vec<Vote>) {
        self.ballots.push_back(Ballot { path_m, place, votes });
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

    /// The positions without a vote that agrees with a leader, the latest first: their numbers, and what they have
    /// seen. None if no vote speaks for the leader.
    pub(crate) fn without(&self, leader: &Vote) -> impl Iterator<Item = (usize, &P)> {
        let is_supported = 0.0 < self.support(leader);
        let has_vote = |ballot: &Ballot<P>| ballot.votes.iter().any(|vote| leader.agrees(vote));
        let missing = self.ballots.iter().enumerate().rev();
        missing
            .filter(move |(_, ballot)| is_supported && !has_vote(ballot))
            .map(|(k, ballot)| (k, &ballot.place))
    }

    /// What the positions before the last one that vote for a pose have seen, the latest first.
    pub(crate) fn earlier_supporters<'a>(
        &'a self,
        winner: &'a Vote,
    ) -> impl Iterator<Item = &'a P> {
        let earlier = self.ballots.iter().rev().skip(1);
        earlier.filter(|ballot| self.is_for(ballot, winner)).map(|ballot| &ballot.place)
    }

    /// Whether a position votes for a pose, with enough confidence.
    fn is_for(&self, ballot: &Ballot<P>, winner: &Vote) -> bool {
        let is_for = |vote: &Vote| self.min_confidence <= vote.confidence && winner.agrees(vote);
        ballot.votes.iter().any(is_for)
    }

    /// What the last position has seen.
    pub(crate) fn last(&self) -> Option<&P> {
        self.ballots.back().map(|ballot| &ballot.place)
    }

    /// Adds a vote to an earlier position.
    pub(crate) fn add_to(&mut self, position: usize, vote: Vote) {
        self.ballots[position].votes.push(vote);
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
        let rivals = all().filter(|vote| contradicts(&winner, vote));
        let rival = rivals.map(|vote| self.support(vote)).fold(0.0, f64::max);
        let decides = self.is_enough(&winner)
            && MIN_LEAD <= self.lead(&winner)
            && rival <= MAX_RIVAL * support;
        decides.then_some(winner)
    }

    /// Whether the positions that vote for a pose are enough. Their share is that since one of them: the first
    /// positions may have seen little.
    fn is_enough(&self, winner: &Vote) -> bool {
        let ballots = self.ballots.iter();
        let votes: Vec<(f64, bool)> =
            ballots.map(|ballot| (ballot.path_m, self.is_for(ballot, winner))).collect();
        let Some(last) = votes.iter().rposition(|vote| vote.1) else { return false };
        let is_since = |first: usize| {
            let n_for = votes[first..].iter().filter(|vote| vote.1).count();
            let n_since = votes.len() - first;
            votes[first].1
                && MIN_POSITIONS <= n_for
                && MIN_SPAN_M <= votes[last].0 - votes[first].0
                && MIN_SHARE * n_since as f64 <= n_for as f64
        };
        MIN_PATH_M <= votes[last].0 && (0..=last).any(is_since)
    }

    /// The sum over the positions of the weight of the most confident vote that agrees: its log odds minus those
    /// of `min_confidence`, from 0 to [`MAX_LOG_ODDS`].
    fn support(&self, vote: &Vote) -> f64 {
        let least = log_odds(self.min_confidence);
        let of_ballot =
            |ballot: &Ballot<P>| weight(ballot.log_odds(|other| vote.agrees(other)), least);
        self.ballots.iter().map(of_ballot).sum()
    }

    /// The same, but each position counts only as much as its most confident vote that agrees is ahead of the
    /// most confident one that contradicts. So a position where a look-alike fits better says nothing.
    fn lead(&self, vote: &Vote) -> f64 {
        let least = log_odds(self.min_confidence);
        let of_ballot = |ballot: &Ballot<P>| {
            let against = ballot.log_odds(|other| contradicts(vote, other)).unwrap_or(least);
            weight(ballot.log_odds(|other| vote.agrees(other)), against.max(least))
        };
        self.ballots.iter().map(of_ballot).sum()
    }
}

/// How far the log odds are above others, from 0 to [`MAX_LOG_ODDS`].
fn weight(log_odds: Option<f64>, least: f64) -> f64 {
    log_odds.map_or(0.0, |found| (found - least).clamp(0.0, MAX_LOG_ODDS))
}

impl<P> Ballot<P> {
    /// The log odds of the most confident of some of the votes.
    fn log_odds(&self, is_some: impl Fn(&Vote) -> bool) -> Option<f64> {
        let votes = self.votes.iter().filter(|vote| is_some(vote));
        votes.map(|vote| log_odds(vote.confidence)).reduce(f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vote(x_m: f64, at_m: f64, confidence: f64) -> Vote {
        let at = |x_m| Pose2 { x_m, ..Pose2::default() };
        Vote { map: 0, map_from_local: at(x_m), local: at(at_m), margin: 0.2, confidence }
    }

    /// The log odds of 0.999 are 6.9, those of 0.6 are 0.4. So each position has a lead of 6.5, and the fourth one,
    /// which is the first with 9 m of path behind it, brings it to 26.
    #[test]
    fn four_positions_that_agree_decide() {
        let mut votes = Votes::new(0.5);
        for k in 0..4 {
            assert!(votes.winner().is_none(), "{k}");
            let path_m = 6.0 + f64::from(k);
            let other = vote(f64::from(k) * 20.0, path_m, 0.6);
            votes.add(path_m, (), vec![vote(50.0, path_m, 0.999), other]);
        }
        let winner = votes.winner();
        assert!(winner.is_some_and(|winner| (winner.map_from_local.x_m - 50.0).abs() < 1e-9));
    }

    /// The log odds of 0.99, 0.8 and 0.9 are 4.6, 1.4 and 2.2: leads of 3.2 and 2.4 per position. Eight positions
    /// are 25.7 and 19.2.
    #[test]
    fn a_rival_prevents_a_decision() {
        for (confidence, is_decided) in [(0.8, true), (0.9, false)] {
            let mut votes = Votes::new(0.5);
            for k in 0..8 {
                let path_m = 6.0 + f64::from(k);
                let both = vec![vote(50.0, path_m, 0.99), vote(10.0, path_m, confidence)];
                votes.add(path_m, (), both);
            }
            assert_eq!(votes.winner().is_some(), is_decided);
        }
    }

    /// The rival has more than 0.7 of the support, but at other positions: the lead alone does not decide.
    #[test]
    fn a_rival_at_other_positions_prevents_a_decision() {
        for (n_rival, is_decided) in [(2, true), (6, false)] {
            let mut votes = Votes::new(0.5);
            for k in 0..6 + n_rival {
                let x_m = if k < 6 { 50.0 } else { 10.0 };
                let path_m = 6.0 + f64::from(k);
                votes.add(path_m, (), vec![vote(x_m, path_m, 0.999)]);
            }
            assert_eq!(votes.winner().is_some(), is_decided, "{n_rival}");
        }
    }

    /// Positions that saw little at first do not count against those after them.
    #[test]
    fn positions_before_the_first_that_agrees_do_not_count() {
        let mut votes = Votes::new(0.5);
        votes.add(3.0, (), vec![vote(50.0, 3.0, 0.6)]);
        for k in 4..12 {
            votes.add(f64::from(k), (), Vec::new());
        }
        for k in 12..16 {
            assert!(votes.winner().is_none(), "{k}");
            votes.add(f64::from(k), (), vec![vote(50.0, f64::from(k), 0.999)]);
        }
        assert!(votes.winner().is_some());
    }

    /// A pose that is found late has only the last vote. Once the positions before it are asked, it decides.
    #[test]
    fn earlier_positions_can_be_asked() {
        let mut votes = Votes::new(0.5);
        for k in 0..8 {
            let found = if k == 7 { vec![vote(50.0, 9.0, 0.999)] } else { Vec::new() };
            votes.add(2.0 + f64::from(k), k, found);
        }
        let leader = votes.leaders(1)[0];
        let missing: Vec<_> = votes.without(&leader).map(|(at, place)| (at, *place)).collect();
        assert_eq!(missing, [(6, 6), (5, 5), (4, 4), (3, 3), (2, 2), (1, 1), (0, 0)]);
        assert!(votes.winner().is_none() && votes.last() == Some(&7));
        for (at, _) in missing {
            votes.add_to(at, vote(50.0, 9.0, 0.99));
        }
        assert!(votes.without(&leader).next().is_none() && votes.winner().is_some());
        // No vote speaks for this one.
        assert!(votes.without(&vote(10.0, 9.0, 0.999)).next().is_none());
    }

    /// Positions 1, 2 and 4 vote for the pose, position 2 without enough confidence. Position 4 is the last one.
    #[test]
    fn supporters_vote_for_the_pose_with_enough_confidence() {
        let mut votes = Votes::new(0.5);
        for (position, x_m, confidence) in
            [(1, 50.0, 0.9), (2, 50.0, 0.3), (3, 10.0, 0.9), (4, 50.5, 0.9)]
        {
            votes.add(f64::from(position), position, vec![vote(x_m, 0.0, confidence)]);
        }
        let winner = vote(50.0, 0.0, 0.9);
        let supporters: Vec<_> = votes.earlier_supporters(&winner).collect();
        assert_eq!(supporters, [&1]);
    }

    /// A robot that does not move forgets by number, one that drives by path.
    #[test]
    fn the_number_of_positions_is_bounded() {
        let mut votes = Votes::new(0.5);
        for k in 0..1000 {
            votes.add(if k < 500 { 0.0 } else { f64::from(k) }, (), vec![vote(0.0, 0.0, 0.9)]);
            assert!(votes.ballots.len() <= MAX_BALLOTS);
        }
        // Metres 974 to 999.
        assert_eq!(votes.ballots.len(), 26);
        assert!(votes.leaders(4).len() == 1);
    }
}
