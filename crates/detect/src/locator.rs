//! Where scans lie in a map, one scan at a time.

use dataset::{LocatedState, Pose2, RangeLimits, Scan};
use model::{Detector, StrongLimits};
use nalgebra::Matrix3;
use register::{AlignOptions, Fit, Prior, RegisterOptions, align, closure_covariance, fit};

use crate::candidates::{Correlated, correlate, evidence_of, options, value};
use crate::descriptor::Describer;
use crate::estimate::Estimate;
use crate::local_motion::{LocalMotion, LocalPlace};
use crate::locator_map::LocatorMap;
use crate::votes::{Vote, Votes};

/// A position in a map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Position {
    /// Number of the map.
    pub map: u32,
    /// Pose of the lidar in the map.
    pub pose: Pose2,
    /// Covariance of x, y and heading of that pose, in the frame of the map. Errors of the map itself are
    /// not in it.
    pub covariance: Matrix3<f64>,
    /// Confidence of the detector that the last alignment with the map is right, 0 to 1. 0 if there was no place
    /// near, or if the alignment went elsewhere.
    pub confidence: f64,
}

/// Finds and follows the position of a robot in a map.
///
/// 1. The scans of the last 10 m of path are matched with each other and joined into a submap, without the
///    returns of what moved, see [`Node::of_still`](register::Node::of_still).
/// 2. While the position is unknown: every 0.8 m, the 100 places of the map with the most similar descriptors are
///    compared with the submap by correlation. The best poses, eight or `n_candidates` that differ, are aligned.
///    Each is a vote, with the confidence of the detector. The eight poses that the positions before support
///    best are aligned as well, so that a place is not missed because the search did not offer it. Earlier
///    positions are asked about the best three.
/// 3. A vote speaks for a pose if its confidence is at least 0.25, or `min_confidence` if that is more. Its weight is
///    the difference of the log odds of the two, at most 9. The lead of a pose is the same sum, but over the
///    most confident vote that contradicts it at the same position. A pose is accepted after 9 m of path if
///    at least 4 positions along at least 3 m of path vote for it, if these are at least half of the positions
///    since one of them, if its lead is at least 20, and if no other pose has more than 0.7 of its weight. So a
///    place that looks like another one gives no answer. At last, the submap has to fit the nearest places of
///    the map with a confidence of at least 0.25, and determine the position, together with those before.
/// 4. Then, without odometry, each scan is aligned with the nearest place of the map. It corrects the position if at
///    least 0.7 of its points have a partner there. So errors of the motion do not add up, where
///    the scan determines the position better than the motion does.
/// 5. Every 0.8 m, the submap is aligned with the nearest places of the map. The confidence of the position is
///    that of the last alignment, also if it does not fit. If none fits for 6 m of path, if the standard
///    deviation of the position exceeds 0.5 m, or if without odometry a scan does not continue those before,
///    the position is lost, and the search begins again.
///
/// The time per scan and the memory are bounded. The only part of the time that grows with the map is the
/// comparison of descriptors, with some thousand operations per place.
pub struct Locator<'a> {
    map: &'a LocatorMap,
    detector: &'a Detector,
    describer: Option<Describer>,
    options: AlignOptions,
    motion: LocalMotion,
    /// The pose of the last scan in the local frame.
    last: Pose2,
    votes: Votes<LocalPlace>,
    state: LocatedState,
    tracked: Option<Tracked>,
    /// The path at the first scan of those that are connected \[m\].
    start_m: f64,
    /// The path at which the map is compared next \[m\].
    next_m: f64,
}

/// A known position.
struct Tracked {
    map: u32,
    estimate: Estimate,
    confidence: f64,
    /// The path at the last comparison that fitted \[m\].
    confirmed_m: f64,
}

/// The first comparison needs this much path \[m\]: less looks like too many places.
const MIN_PATH_M: f64 = 3.0;
/// Path between two comparisons \[m\].
const STEP_M: f64 = 0.8;
/// Number of places that a position is compared with by correlation. Outdoors, parked cars and hidden ground change
/// the descriptors more than the walls and trees.
const N_SEARCHED: usize = 100;
/// Number of candidates per position, or `n_candidates` if that is more. A look-alike must not win because the right
/// pose was not looked at.
const N_VOTES: usize = 8;
/// Two candidates of a position differ by more than this.
const DISTINCT_M: f64 = 2.0;
const DISTINCT_DEG: f64 = 15.0;
/// Places farther away than this are not used to follow a position \[m\].
const NEAR_M: f64 = 6.0;
/// Number of places that a position is compared with.
const N_NEAR: usize = 4;
/// The most that an alignment may change the expected pose.
const MAX_MOVE_M: f64 = 1.0;
const MAX_MOVE_DEG: f64 = 8.0;
/// A comparison needs this many points in known space.
const MIN_KNOWN: usize = 30;
/// A scan corrects a position if at least this share of its points has a partner in the map. On two drives of a
/// campus, 0.5 led to errors of 0.106 m in one scan of 100, 0.7 to 0.072 m.
const MIN_PARTNER_SHARE: f64 = 0.7;
/// A comparison confirms a position within these limits. The limits of the detector are for pairs of places
/// that need no other evidence. Here, other positions have found the same pose.
const CONFIRMS: StrongLimits = StrongLimits { known_overlap: 0.5, conflict: 0.3 };
/// Number of poses that other positions voted for, and that each position is asked about.
const N_CARRIED: usize = 8;
/// Number of poses that earlier positions are asked about, and number of positions that are asked about each, per
/// step: a pose may be found late, where a place looks more like itself.
const N_FILLED: usize = 3;
const N_EARLIER: usize = 6;
/// Number of positions whose alignments are joined for the first position.
const N_JOINED: usize = 8;
/// The least confidence from which a vote speaks for a pose. `min_confidence` of the detector may be less: it
/// leaves candidates to a later stage that compares them.
const LEAST_CONFIDENCE: f64 = 0.25;
/// The points do not determine the position if the ratio of the smallest to the largest information is less.
const DEGENERATE_RATIO: f64 = 0.05;
/// Path without a comparison that fits, after which the position is lost \[m\].
const LOST_M: f64 = 6.0;
/// A position with a larger standard deviation along its worst direction is lost \[m\].
const MAX_STD_M: f64 = 0.5;
/// Error of the step to a scan that did not determine its position.
const UNDECIDED_M: f64 = 0.05;
const UNDECIDED_RAD: f64 = 0.01;

impl<'a> Locator<'a> {
    /// A locator that knows nothing yet. `limits` are the range limits of the lidar.
    pub fn new(
        map: &'a LocatorMap,
        detector: &'a Detector,
        register: &RegisterOptions,
        limits: RangeLimits,
    ) -> Self {
        let n_squares = map.nodes.first().map(|node| node.submap().n_squares());
        Self {
            map,
            detector,
            describer: n_squares.map(Describer::new),
            options: options(),
            motion: LocalMotion::new(register, limits, detector.odometry),
            last: Pose2::default(),
            votes: Votes::new(detector.min_confidence.max(LEAST_CONFIDENCE)),
            state: LocatedState::Searching,
            tracked: None,
            start_m: 0.0,
            next_m: MIN_PATH_M,
        }
    }

    /// Adds the next scan. `step` is the motion of the lidar since the scan before by odometry: the pose of
    /// the lidar now in its frame then. Without it, the scans alone are matched. Scans should be deskewed, without
    /// odometry by the motion of [`ScanSteps`](crate::ScanSteps).
    pub fn add(&mut self, scan: &Scan, step: Option<Pose2>) -> LocatedState {
        let pose = self.motion.add(scan, step);
        let step = self.last.inverse() * pose;
        self.last = pose;
        if let Some(tracked) = &mut self.tracked {
            tracked.estimate = tracked.estimate.moved(&step, &self.detector.drift);
            if !self.motion.is_decided() {
                tracked.estimate = tracked.estimate.uncertain(UNDECIDED_M, UNDECIDED_RAD);
            }
        }
        if let Some(now) = self.scan_in_map()
            && let Some(tracked) = &mut self.tracked
        {
            tracked.estimate = tracked.estimate.joined(&now);
        }
        if self.motion.is_broken() {
            self.votes.clear();
            self.start_m = self.motion.path_m();
            self.next_m = self.start_m + MIN_PATH_M;
            if self.tracked.take().is_some() {
                self.state = LocatedState::Lost;
            }
        }
        if self.next_m <= self.motion.path_m() {
            self.next_m = self.motion.path_m() + STEP_M;
            if let Some(place) = self.motion.place() {
                match self.tracked.take() {
                    Some(tracked) => self.follow(tracked, &place),
                    None => self.search(place),
                }
            }
        }
        self.state
    }

    /// What is known about the position of the last scan.
    pub fn state(&self) -> LocatedState {
        self.state
    }

    /// The position of the last scan.
    pub fn position(&self) -> Option<Position> {
        self.tracked.as_ref().map(|tracked| Position {
            map: tracked.map,
            pose: tracked.estimate.pose,
            covariance: tracked.estimate.covariance,
            confidence: tracked.confidence,
        })
    }

    /// Path of the scans so far by scan matching \[m\].
    pub fn path_m(&self) -> f64 {
        self.motion.path_m()
    }

    fn search(&mut self, place: LocalPlace) {
        let mut votes = self.candidates(&place);
        for leader in self.votes.leaders(N_CARRIED) {
            votes.extend(self.carry(&place, &leader));
        }
        self.votes.add(self.motion.path_m() - self.start_m, place, votes);
        self.ask_earlier();
        let (Some(winner), Some(place)) = (self.votes.winner(), self.votes.last()) else { return };
        let expected = winner.map_from_local * self.last;
        let compared = self.compare(place, winner.map, &expected);
        // A look-alike can win the search, but it fits less well.
        let certain = compared.confident().and_then(|estimate| self.certain(estimate, &winner));
        if let Some(estimate) = certain {
            let (map, confidence) = (winner.map, compared.confidence);
            let confirmed_m = self.motion.path_m();
            self.tracked = Some(Tracked { map, estimate, confidence, confirmed_m });
            self.state = LocatedState::Located;
            self.votes.clear();
        }
    }

    /// The estimate of the last scan, if it is certain enough. If the last scans do not determine the position along a
    /// wall, those of the positions before that voted for the same pose can.
    fn certain(&self, estimate: Estimate, winner: &Vote) -> Option<Estimate> {
        let is_certain = |estimate: &Estimate| estimate.std_m() <= MAX_STD_M;
        if is_certain(&estimate) {
            return Some(estimate);
        }
        let expected = winner.map_from_local * self.last;
        let mut joined = estimate;
        for place in self.votes.earlier_supporters(winner).take(N_JOINED) {
            if let Some(other) = self.compare(place, winner.map, &expected).confident() {
                joined = joined.joined(&other);
            }
            if is_certain(&joined) {
                return Some(joined);
            }
        }
        None
    }

    /// Asks earlier positions about the best poses, if they have no vote for them.
    fn ask_earlier(&mut self) {
        for leader in self.votes.leaders(N_FILLED) {
            let ask = |(position, place): (usize, &LocalPlace)| {
                let vote = self.carry(place, &leader).filter(|vote| vote.agrees(&leader));
                // A position that does not agree is not asked again.
                let none = Vote { confidence: 0.0, local: place.local_from_node, ..leader };
                (position, vote.unwrap_or(none))
            };
            let votes: Vec<_> = self.votes.without(&leader).take(N_EARLIER).map(ask).collect();
            for (position, vote) in votes {
                self.votes.add_to(position, vote);
            }
        }
    }

    /// Poses in the map that the submap fits.
    fn candidates(&self, place: &LocalPlace) -> Vec<Vote> {
        let Some(describer) = &self.describer else { return Vec::new() };
        let nodes = &self.map.nodes;
        let row = describer.describe(place.node.submap());
        let similar = self.map.descriptors.most_similar_to(&row, N_SEARCHED);
        let references: Vec<usize> = similar.iter().map(|similar| similar.reference).collect();
        let correlated = correlate(|k| nodes[k].submap(), place.node.submap(), &references);
        let node_from_local = place.local_from_node.inverse();
        let vote = |correlated: &Correlated| {
            let fit = correlated.fit(&nodes[correlated.reference], &place.node, &self.options)?;
            let evidence = evidence_of(&fit, correlated.margin, None);
            let map_from_node = self.map.poses[correlated.reference] * fit.a_from_b;
            Some(Vote {
                map: self.map.maps[correlated.reference],
                map_from_local: map_from_node * node_from_local,
                local: place.local_from_node,
                margin: correlated.margin,
                confidence: self.detector.confidence(&evidence),
            })
        };
        self.distinct(&correlated).into_iter().filter_map(vote).collect()
    }

    /// The best places whose best poses differ. Otherwise, the places of one stretch of path that was driven
    /// several times would leave no room for another one that looks like it.
    fn distinct<'b>(&self, correlated: &'b [Correlated]) -> Vec<&'b Correlated> {
        let n = N_VOTES.max(self.detector.n_candidates as usize);
        let mut kept: Vec<(&Correlated, u32, Pose2)> = Vec::with_capacity(n);
        for next in correlated {
            if n <= kept.len() {
                break;
            }
            let Some(peak) = next.peaks.first() else { continue };
            let map = self.map.maps[next.reference];
            let pose = self.map.poses[next.reference] * peak.pose;
            let is_same = |(_, other_map, other): &(&Correlated, u32, Pose2)| {
                map == *other_map
                    && pose.distance_m(other) < DISTINCT_M
                    && pose.heading_difference_rad(other) < DISTINCT_DEG.to_radians()
            };
            if !kept.iter().any(is_same) {
                kept.push((next, map, pose));
            }
        }
        kept.into_iter().map(|(correlated, ..)| correlated).collect()
    }

    fn follow(&mut self, mut tracked: Tracked, place: &LocalPlace) {
        let path_m = self.motion.path_m();
        let compared = self.compare(place, tracked.map, &tracked.estimate.pose);
        tracked.confidence = compared.confidence;
        if let Some(measured) = compared.estimate {
            tracked.estimate = tracked.estimate.joined(&measured);
            tracked.confirmed_m = path_m;
        }
        let is_known =
            path_m - tracked.confirmed_m <= LOST_M && tracked.estimate.std_m() <= MAX_STD_M;
        match is_known {
            true => self.tracked = Some(tracked),
            false => self.state = LocatedState::Lost,
        }
    }

    /// The vote of this position for a pose that other positions voted for. It is not always among the candidates
    /// of the position itself. The margin is that of the other vote.
    fn carry(&self, place: &LocalPlace, leader: &Vote) -> Option<Vote> {
        let expected = leader.map_from_local * place.local_from_node;
        let NearFit { fit, map_from_node, .. } = self.near_fit(place, leader.map, &expected)?;
        let evidence = evidence_of(&fit, leader.margin, None);
        // In a bare corridor, an alignment stays where it starts, and seems to agree with any other one.
        if evidence.weakness < DEGENERATE_RATIO {
            return None;
        }
        Some(Vote {
            map_from_local: map_from_node * place.local_from_node.inverse(),
            local: place.local_from_node,
            confidence: self.detector.confidence(&evidence),
            ..*leader
        })
    }

    /// The best alignment with the nearest places of a map. `None` if there is none near, or if the pose changes too
    /// much.
    fn near_fit(&self, place: &LocalPlace, map: u32, expected: &Pose2) -> Option<NearFit> {
        let near = self.map.nearest(map, expected, NEAR_M, N_NEAR);
        let best = best(near.iter().map(|&k| self.fit_at(place, k, expected)))?;
        is_near(&best.map_from_node, expected).then_some(best)
    }

    fn fit_at(&self, place: &LocalPlace, reference: usize, start: &Pose2) -> NearFit {
        let pose = self.map.poses[reference];
        let start = pose.inverse() * *start;
        let fit = fit(&self.map.nodes[reference], &place.node, &start, &self.options);
        NearFit { reference, fit, map_from_node: pose * fit.a_from_b }
    }

    /// The pose of the last scan by its alignment with the nearest place of the map. `None` if there was odometry, if the
    /// position is not known, if the place explains too few points, or if the pose changes too much.
    fn scan_in_map(&self) -> Option<Estimate> {
        let tracked = self.tracked.as_ref()?;
        let points = self.motion.points_without_odometry()?;
        let expected = tracked.estimate.pose;
        let reference = *self.map.nearest(tracked.map, &expected, NEAR_M, 1).first()?;
        let map_from_place = self.map.poses[reference];
        let start = map_from_place.inverse() * expected;
        let target = self.map.nodes[reference].target();
        let alignment = align(points, target, &start, &Prior::none(start), &self.options);
        let n_needed = MIN_KNOWN.max((MIN_PARTNER_SHARE * points.len() as f64) as usize);
        let pose = map_from_place * alignment.target_from_source;
        if alignment.n_partners < n_needed || !is_near(&pose, &expected) {
            return None;
        }
        let covariance = closure_covariance(&alignment, &self.options, &self.detector.closure);
        Some(Estimate::turned(pose, &covariance, map_from_place.heading_rad))
    }

    /// Compares the submap with the map near the expected pose of the last scan.
    fn compare(&self, place: &LocalPlace, map: u32, expected: &Pose2) -> Compared {
        let none = Compared { estimate: None, confidence: 0.0 };
        let node_from_scan = place.local_from_node.inverse() * self.last;
        let expected = *expected * node_from_scan.inverse();
        let Some(best) = self.near_fit(place, map, &expected) else { return none };
        let NearFit { reference, fit, map_from_node } = best;
        let evidence = evidence_of(&fit, 0.0, None);
        let compared = Compared { confidence: self.detector.confidence(&evidence), ..none };
        if fit.n_known < MIN_KNOWN || !CONFIRMS.accept(&evidence) {
            return compared;
        }
        let covariance = closure_covariance(&fit.alignment, &self.options, &self.detector.closure);
        let heading_rad = self.map.poses[reference].heading_rad;
        let at_node = Estimate::turned(map_from_node, &covariance, heading_rad);
        let estimate = at_node.moved(&node_from_scan, &self.detector.drift);
        Compared { estimate: Some(estimate), ..compared }
    }
}

/// Of equal fits, the first one.
fn best(fits: impl Iterator<Item = NearFit>) -> Option<NearFit> {
    fits.reduce(|best, next| match value(&best.fit) < value(&next.fit) {
        true => next,
        false => best,
    })
}

fn is_near(found: &Pose2, expected: &Pose2) -> bool {
    found.distance_m(expected) < MAX_MOVE_M
        && found.heading_difference_rad(expected) < MAX_MOVE_DEG.to_radians()
}

/// What a comparison with the map near a pose says.
struct Compared {
    /// The pose of the last scan, if the submap fits.
    estimate: Option<Estimate>,
    /// Confidence of the detector.
    confidence: f64,
}

impl Compared {
    /// The pose of the last scan, if the confidence is enough for a first position.
    fn confident(&self) -> Option<Estimate> {
        self.estimate.filter(|_| LEAST_CONFIDENCE <= self.confidence)
    }
}

/// An alignment with a place near the expected pose.
struct NearFit {
    reference: usize,
    fit: Fit,
    map_from_node: Pose2,
}
