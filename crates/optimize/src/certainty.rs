//! Which places of a drive the graph knows the relative position of.

use std::collections::{BTreeMap, BinaryHeap};

use model::Drift;

use crate::guided::Prediction;

/// Two places are certain if the standard deviation of their relative position is at most this \[m\]: half of
/// [`REACH_M`](crate::guided::REACH_M), the largest distance of two places that are compared.
const MAX_STD_M: f64 = 2.0;

/// The graph of a drive, for distances: the path, and the closures that join two positions on it.
pub(crate) struct Certainty {
    /// The path length at the ends of all closures \[m\], ascending.
    ends_m: Vec<f64>,
    /// For each end, the ends that closures join it with.
    joined: Vec<Vec<usize>>,
    /// Positions farther apart over the graph than this are not certain \[m\].
    reach_m: f64,
}

/// The distances over the graph from one position, as far as they were needed (Dijkstra 1959, "A note on two problems in
/// connexion with graphs").
pub(crate) struct Distances<'a> {
    graph: &'a Certainty,
    path_m: f64,
    /// For each end that was found, the length of the shortest way so far \[m\].
    of_ends_m: BTreeMap<usize, f64>,
    /// The ends whose neighbours were not looked at, the nearest first.
    open: BinaryHeap<Reached>,
}

impl Certainty {
    /// `closures_m` are the path lengths at both ends of the closures.
    pub(crate) fn new(closures_m: &[[f64; 2]], drift: &Drift) -> Self {
        let mut ends_m: Vec<f64> = closures_m.iter().flatten().copied().collect();
        ends_m.sort_by(f64::total_cmp);
        ends_m.dedup();
        let mut joined = vec![Vec::new(); ends_m.len()];
        for closure_m in closures_m {
            let [a, b] = closure_m.map(|path_m| ends_m.partition_point(|&end| end < path_m));
            joined[a].push(b);
            joined[b].push(a);
        }
        Self { ends_m, joined, reach_m: reach_m(drift) }
    }

    /// Keeps the places, with path lengths `path_m`, whose position relative to the query is certain.
    pub(crate) fn retain(&self, path_m: &[f64], query: usize, near: &mut Vec<usize>) {
        if !near.is_empty() {
            let mut distances = self.distances(path_m[query]);
            near.retain(|&k| distances.is_certain(path_m[k]));
        }
    }

    /// Marks the predictions between places, with path lengths `path_m`, that are not certain. They are sorted by
    /// query.
    pub(crate) fn mark(&self, path_m: &[f64], predictions: &mut [Prediction]) {
        for of_query in predictions.chunk_by_mut(|a, b| a.query == b.query) {
            let mut distances = self.distances(path_m[of_query[0].query]);
            for prediction in of_query {
                prediction.is_certain = distances.is_certain(path_m[prediction.reference]);
            }
        }
    }

    /// The distances from a position on the path.
    pub(crate) fn distances(&self, path_m: f64) -> Distances<'_> {
        let (of_ends_m, open) = (BTreeMap::new(), BinaryHeap::new());
        let mut distances = Distances { graph: self, path_m, of_ends_m, open };
        let after = self.ends_m.partition_point(|&end| end < path_m);
        for end in [after.checked_sub(1), Some(after)].into_iter().flatten() {
            if let Some(end_m) = self.ends_m.get(end) {
                distances.reach(end, (end_m - path_m).abs());
            }
        }
        distances
    }
}

impl Distances<'_> {
    /// Whether the graph knows the position at `path_m` relative to this one. Any way that is short enough is sufficient,
    /// so that of places that are near each other, few distances are needed.
    pub(crate) fn is_certain(&mut self, path_m: f64) -> bool {
        let along_m = (path_m - self.path_m).abs();
        if along_m <= self.graph.reach_m {
            return true;
        }
        let after = self.graph.ends_m.partition_point(|&end| end < path_m);
        let is_near = |distances: &Self, end: Option<usize>| {
            let over_m = end.and_then(|end| {
                Some(distances.of_ends_m.get(&end)? + (distances.graph.ends_m[end] - path_m).abs())
            });
            over_m.is_some_and(|over_m| over_m <= distances.graph.reach_m)
        };
        loop {
            if is_near(self, after.checked_sub(1)) || is_near(self, Some(after)) {
                return true;
            }
            let Some(nearest) = self.open.pop() else { return false };
            self.look_around(&nearest);
        }
    }

    /// Notes a way to an end, if it is short enough and the shortest one so far.
    fn reach(&mut self, end: usize, distance_m: f64) {
        let is_nearer = self.of_ends_m.get(&end).is_none_or(|&known_m| distance_m < known_m);
        if distance_m <= self.graph.reach_m && is_nearer {
            self.of_ends_m.insert(end, distance_m);
            self.open.push(Reached { distance_m, end });
        }
    }

    /// Goes from an end to those next to it.
    fn look_around(&mut self, &Reached { distance_m, end }: &Reached) {
        let graph = self.graph;
        for &other in &graph.joined[end] {
            self.reach(other, distance_m);
        }
        for next in [end.checked_sub(1), Some(end + 1)].into_iter().flatten() {
            if let Some(next_m) = graph.ends_m.get(next) {
                self.reach(next, distance_m + (next_m - graph.ends_m[end]).abs());
            }
        }
    }
}

/// The length of path after which the standard deviation of the position is [`MAX_STD_M`] \[m\].
///
/// Over `d` metres, the position drifts by `std_m_per_sqrt_m * sqrt(d)`. The heading drifts by
/// `std_rad_per_sqrt_m * sqrt(s)` until `s`, which moves the end of a straight path sideways by the integral
/// over `s`: a random walk, whose integral has the variance `std_rad_per_sqrt_m^2 * d^3 / 3`.
fn reach_m(drift: &Drift) -> f64 {
    let std_m = |d: f64| {
        let heading = drift.std_rad_per_sqrt_m * (d * d * d / 3.0).sqrt();
        libm::hypot(drift.std_m_per_sqrt_m * d.sqrt(), heading)
    };
    // Both terms grow with the path. Halving 60 times leaves 1e-18 of the first interval.
    let (mut known_m, mut unknown_m) = (0.0, (MAX_STD_M / drift.std_m_per_sqrt_m).powi(2));
    for _ in 0..60 {
        let middle_m = 0.5 * (known_m + unknown_m);
        if std_m(middle_m) <= MAX_STD_M {
            known_m = middle_m;
        } else {
            unknown_m = middle_m;
        }
    }
    known_m
}

/// An end and the length of a way to it. The nearest one is the largest, because a heap gives the largest.
#[derive(PartialEq)]
struct Reached {
    distance_m: f64,
    end: usize,
}

impl Eq for Reached {}

impl Ord for Reached {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        other.distance_m.total_cmp(&self.distance_m).then(other.end.cmp(&self.end))
    }
}

impl PartialOrd for Reached {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// After 30 m: the position drifts by 0.1 x sqrt(30) = 0.548 m, the heading moves it by
    /// 0.02 x sqrt(30^3 / 3) = 1.897 m, together sqrt(0.3 + 3.6) = 1.975 m. After 31 m it is
    /// sqrt(0.31 + 3.972) = 2.069 m. The limit of 2 m is in between.
    const DRIFT: Drift = Drift { std_m_per_sqrt_m: 0.1, std_rad_per_sqrt_m: 0.02 };

    #[test]
    fn the_reach_is_the_path_with_the_largest_error() {
        let found = reach_m(&DRIFT);
        assert!((30.0..31.0).contains(&found), "{found}");
        // Without a drift of the heading: 0.1 x sqrt(400) = 2.
        let straight = reach_m(&Drift { std_rad_per_sqrt_m: 1e-12, ..DRIFT });
        assert!((straight - 400.0).abs() < 1e-6, "{straight}");
    }

    #[test]
    fn places_are_certain_over_short_ways_only() {
        let graph = Certainty::new(&[[10.0, 100.0], [105.0, 200.0]], &DRIFT);
        let from = |path_m: f64| graph.distances(path_m);
        // Along the path.
        assert!(from(50.0).is_certain(20.0) && !from(50.0).is_certain(19.0));
        // 110 to 100, closure, 10 to 25: 25 m. To 35 it is 35 m.
        assert!(from(110.0).is_certain(25.0) && !from(110.0).is_certain(35.0));
        assert!(from(25.0).is_certain(110.0), "in the other direction");
        // 205 to 200, closure, 105 to 100, closure, 10 to 0: 20 m. Over one closure only, none is near.
        assert!(from(205.0).is_certain(0.0) && !from(220.0).is_certain(0.0));
    }

    #[test]
    fn without_closures_the_path_alone_counts() {
        let graph = Certainty::new(&[], &DRIFT);
        assert!(graph.distances(0.0).is_certain(30.0) && !graph.distances(0.0).is_certain(31.0));
    }

    /// The distances equal those of Floyd and Warshall's method over all positions, for positions at the ends
    /// and between them.
    #[test]
    fn distances_are_the_shortest_ones() {
        let mut random = dataset::SplitMix64::new(3);
        let closures_m: Vec<[f64; 2]> =
            (0..12).map(|_| [(); 2].map(|()| (200.0 * random.unit()).round())).collect();
        let n = 201;
        let mut shortest_m: Vec<Vec<f64>> =
            (0..n).map(|a| (0..n).map(|b| (a as f64 - b as f64).abs()).collect()).collect();
        for [a, b] in closures_m.iter().map(|pair| pair.map(|m| m as usize)) {
            (shortest_m[a][b], shortest_m[b][a]) = (0.0, 0.0);
        }
        for k in 0..n {
            for a in 0..n {
                for b in 0..n {
                    shortest_m[a][b] = shortest_m[a][b].min(shortest_m[a][k] + shortest_m[k][b]);
                }
            }
        }
        let graph = Certainty::new(&closures_m, &DRIFT);
        for (a, row) in shortest_m.iter().enumerate() {
            let mut distances = graph.distances(a as f64);
            for (b, distance_m) in row.iter().enumerate() {
                assert_eq!(distances.is_certain(b as f64), *distance_m <= graph.reach_m, "{a} {b}");
            }
        }
    }
}
