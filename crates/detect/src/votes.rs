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
    /// Confidence of the detector, 0 to 1. 0 if the points do not determine the position: in a bare corridor,
    /// an alignment stays where it starts, and seems to agree with any other one.
    pub(crate) confidence: f64,
}

/// The votes of one position.
struct Ballot {
    path_m: f64,
    votes: Vec<Vote>,
}

/// The votes of the last metres.
#[derive(Default)]
pub(crate) struct Votes {
    ballots: VecDeque<Ballot>,
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
/// A position counts if one of its votes has this confidence.
const MIN_CONFIDENCE: f64 = 0.5;
/// The least number of positions that agree.
const MIN_POSITIONS: usize = 4;
/// The least path from the first to the last of them \[m\].
const MIN_SPAN_M: f64 = 3.0;
/// The least path of all scans that they have seen \[m\].
const MIN_PATH_M: f64 = 9.0;
/// The least share of the positions from the first one that agrees to the last.
const MIN_SHARE: f64 = 0.6;
/// The most that one position counts: a confidence of 0.998.
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

impl Votes {
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
            let is_for = |vote: &Vote| MIN_CONFIDENCE <= vote.confidence && winner.agrees(vote);
            ballot.votes.iter().any(is_for)
        };
        let first = self.ballots.iter().position(is_for)?;
        let last = self.ballots.iter().rposition(is_for)?;
        let n_for = self.ballots.iter().filter(|ballot| is_for(ballot)).count();
        let n_since = self.ballots.len() - first;
        let span_m = self.ballots[last].path_m - self.ballots[first].path_m;
        let is_enough = MIN_POSITIONS <= n_for
            && MIN_SPAN_M <= span_m
            && MIN_PATH_M <= self.ballots[last].path_m
            && MIN_SHARE * n_since as f64 <= n_for as f64;
        let rivals = all().filter(|vote| contradicts(&winner, vote));
        let rival = rivals.map(|vote| self.support(vote)).fold(0.0, f64::max);
        (is_enough && rival <= MAX_RIVAL * support).then_some(winner)
    }

    /// The sum over the positions of the log odds of the most confident vote that agrees. Positions that
    /// speak against the pose count 0, and at most [`MAX_LOG_ODDS`] speak for it.
    fn support(&self, vote: &Vote) -> f64 {
        let of_ballot = |ballot: &Ballot| {
            let agreeing = ballot.votes.iter().filter(|other| vote.agrees(other));
            let confidence = agreeing.map(|other| other.confidence).fold(0.0, f64::max);
            libm::log(confidence / (1.0 - confidence)).clamp(0.0, MAX_LOG_ODDS)
        };
        self.ballots.iter().map(of_ballot).sum()
    }
}
