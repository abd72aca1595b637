//! Rejection of false closures: truncated least squares with graduated non-convexity.

use dataset::Pose2;

use crate::graph::{Edge, Limits, Solver, cost, optimize};

/// A closure whose squared error is above this value is rejected: the 99 % quantile of the chi-square
/// distribution with 3 degrees of freedom.
pub const MAX_CHI2: f64 = 11.344_866_730_144_373;
/// Factor of the control parameter from round to round (Yang et al. 2020, section V).
const GROWTH: f64 = 1.4;
/// The most rounds, and the most optimizations of a round.
const MAX_ROUNDS: usize = 150;
const MAX_REPEATS: usize = 20;
/// An optimization of a round ends after a few steps. The weights change anyway, and with many wrong edges each step is
/// slow.
const ROUND: Limits = Limits { converged: 1e-4, max_steps: 3 };
/// The control parameter stays as it is while the last step of an optimization reduces the cost by a larger share.
const SETTLED: f64 = 0.1;
/// Limits of the first optimization, with all edges, in the first and in the second attempt. Its poses decide which edges
/// lose weight first, and where many wrong edges pull, they mean little.
const FIRST: [Limits; 2] = [ROUND, Limits { converged: 1e-4, max_steps: 15 }];
/// There is no second attempt if the first one keeps this share of the edges, or more.
const MOST: f64 = 0.5;
/// The most damping that a round starts with.
const MOST_DAMPING: f64 = 1e-2;
/// Edges without weight make each step slower. They are taken out when they are this share of all.
const MAX_IDLE_SHARE: f64 = 0.01;

/// The result of a robust optimization.
#[derive(Debug, Clone, PartialEq)]
pub struct Robust {
    /// The poses.
    pub poses: Vec<Pose2>,
    /// For each closure whether it is kept.
    pub is_kept: Vec<bool>,
}

/// Optimizes a graph of trusted odometry edges and doubtful closures, and decides which closures to
/// keep, with graduated non-convexity on the truncated least squares cost (Yang, Antonante, Tzoumas and
/// Carlone 2020, "Graduated non-convexity for robust spatial perception", algorithm 1 and table II).
///
/// The method finds a local minimum, and which one depends on the first poses. If it keeps less than half of the
/// closures, or costs more than keeping nothing, it is tried again after more steps of the first optimization. Of the
/// results, and of keeping nothing, the one with the smallest truncated cost is taken: the squared errors of the odometry
/// and of the kept closures, and [`MAX_CHI2`] for each closure that is not kept.
///
/// The poses are the better ones of two optimizations with the kept closures, from `start` and from the last poses of
/// the method, which can be bad if it rejects everything.
pub fn reject_false_closures(odometry: &[Edge], closures: &[Edge], start: &[Pose2]) -> Robust {
    let shares = vec![1.0; closures.len()];
    let max_chi2 = vec![MAX_CHI2; closures.len()];
    reject_outliers(odometry, &Doubtful { edges: closures, shares, max_chi2 }, start)
}

/// Measurements of which some are wrong.
pub(crate) struct Doubtful<'a> {
    pub(crate) edges: &'a [Edge],
    /// The weight of each in the cost, if it is kept. Whether it is kept is decided with its whole squared
    /// error.
    pub(crate) shares: Vec<f64>,
    /// The squared error above which each is rejected.
    pub(crate) max_chi2: Vec<f64>,
}

/// The same as [`reject_false_closures`] for any doubtful measurements.
pub(crate) fn reject_outliers(
    trusted: &[Edge],
    doubtful: &Doubtful<'_>,
    start: &[Pose2],
) -> Robust {
    let n = doubtful.edges.len();
    let (mut lowest, mut best) = with_kept(trusted, doubtful, vec![false; n], &[start]);
    for first in &FIRST {
        let attempt = graduate(trusted, doubtful, start, first);
        let n_kept = attempt.is_kept.iter().filter(|kept| **kept).count();
        let (cost, robust) = with_kept(trusted, doubtful, attempt.is_kept, &[start, &attempt.last]);
        let is_best = cost < lowest;
        if is_best {
            (lowest, best) = (cost, robust);
        }
        let is_enough = is_best && MOST * n as f64 <= n_kept as f64;
        if is_enough || attempt.has_settled_first {
            break;
        }
    }
    best
}

/// An attempt to find the doubtful edges that are right.
struct Attempt {
    is_kept: Vec<bool>,
    /// The poses at its end.
    last: Vec<Pose2>,
    /// The first optimization ended before its last step, so that more steps would change nothing.
    has_settled_first: bool,
}

/// Decides which doubtful edges to keep, starting with an optimization of these limits.
fn graduate(trusted: &[Edge], doubtful: &Doubtful<'_>, start: &[Pose2], first: &Limits) -> Attempt {
    let Doubtful { edges: doubted, shares, max_chi2 } = doubtful;
    let mut kept = vec![1.0; doubted.len()];
    let mut graph = Graduated::new(trusted, doubted, start.len());
    let mut poses = start.to_vec();
    let has_settled_first = graph.optimize(shares, &mut poses, first) <= first.converged;
    let chi2_of = |poses: &[Pose2]| -> Vec<f64> { doubted.iter().map(|c| c.chi2(poses)).collect() };
    let mut chi2 = chi2_of(&poses);
    let worst = chi2.iter().zip(max_chi2).max_by(|a, b| (a.0 / a.1).total_cmp(&(b.0 / b.1)));
    if let Some((largest, max)) = worst.filter(|(chi2, max)| max < chi2) {
        let mut control = max / (2.0 * largest - max);
        for _ in 0..MAX_ROUNDS {
            for _ in 0..MAX_REPEATS {
                for (k, weight) in kept.iter_mut().enumerate() {
                    *weight = truncated_weight(chi2[k], control, max_chi2[k]);
                }
                let weights: Vec<f64> = kept.iter().zip(shares).map(|(k, s)| k * s).collect();
                let last_gain = graph.optimize(&weights, &mut poses, &ROUND);
                chi2 = chi2_of(&poses);
                if last_gain <= SETTLED {
                    break;
                }
            }
            if kept.iter().all(|&w| w == 0.0 || w == 1.0) {
                break;
            }
            control *= GROWTH;
        }
    }
    let is_kept = kept.iter().map(|&weight| weight > 0.5).collect();
    Attempt { is_kept, last: poses, has_settled_first }
}

/// The truncated cost of keeping these edges, and the poses: the best ones of the optimizations from these starts.
fn with_kept(
    trusted: &[Edge],
    doubtful: &Doubtful<'_>,
    is_kept: Vec<bool>,
    starts: &[&[Pose2]],
) -> (f64, Robust) {
    let mut edges = trusted.to_vec();
    let mut of_rejected = 0.0;
    for (k, edge) in doubtful.edges.iter().enumerate() {
        let share = doubtful.shares[k];
        match is_kept[k] {
            true => edges.push(Edge { information: edge.information * share, ..*edge }),
            false => of_rejected += share * doubtful.max_chi2[k],
        }
    }
    let weights = vec![1.0; edges.len()];
    let ends = starts.iter().map(|start| {
        let poses = optimize(&edges, start);
        (cost(&edges, &weights, &poses), poses)
    });
    let better = |best: (f64, Vec<Pose2>), next: (f64, Vec<Pose2>)| match next.0 < best.0 {
        true => next,
        false => best,
    };
    let (of_kept, poses) = ends.reduce(better).unwrap_or_default();
    (of_kept + of_rejected, Robust { poses, is_kept })
}

/// The graph of the trusted edges, and of the doubtful ones that have a weight.
struct Graduated<'a> {
    trusted: &'a [Edge],
    doubtful: &'a [Edge],
    /// The doubtful edges in the graph, ascending.
    members: Vec<usize>,
    solver: Solver,
}

impl<'a> Graduated<'a> {
    fn new(trusted: &'a [Edge], doubtful: &'a [Edge], n_poses: usize) -> Self {
        let members: Vec<usize> = (0..doubtful.len()).collect();
        let edges = trusted.iter().chain(doubtful).copied().collect();
        Self { trusted, doubtful, members, solver: Solver::new(n_poses, edges) }
    }

    /// Optimizes the poses with these weights of the doubtful edges. Returns the share of the cost that the last step
    /// took away.
    fn optimize(&mut self, weights: &[f64], poses: &mut [Pose2], limits: &Limits) -> f64 {
        let with_weight: Vec<usize> = (0..weights.len()).filter(|&k| 0.0 < weights[k]).collect();
        let is_member = |k: &usize| self.members.binary_search(k).is_ok();
        let n_idle = self.members.len().saturating_sub(with_weight.len());
        if MAX_IDLE_SHARE * (self.members.len() as f64) < n_idle as f64
            || !with_weight.iter().all(is_member)
        {
            let doubtful = with_weight.iter().map(|&k| &self.doubtful[k]);
            let edges = self.trusted.iter().chain(doubtful).copied().collect();
            let damping = self.solver.damping;
            self.solver = Solver::new(poses.len(), edges);
            self.solver.damping = damping;
            self.members = with_weight;
        }
        // A strongly damped step gains little, which must not look like the end of a round.
        self.solver.damping = self.solver.damping.min(MOST_DAMPING);
        let mut of_edges = vec![1.0; self.trusted.len()];
        of_edges.extend(self.members.iter().map(|&k| weights[k]));
        self.solver.optimize(&of_edges, poses, limits)
    }
}

/// The weight of an edge at a control parameter mu, with c^2 = `max_chi2`: 1 below
/// mu / (mu + 1) c^2, 0 above (mu + 1) / mu c^2, and sqrt(c^2 mu (mu + 1) / chi2) - mu between.
fn truncated_weight(chi2: f64, control: f64, max_chi2: f64) -> f64 {
    if chi2 <= control / (control + 1.0) * max_chi2 {
        1.0
    } else if (control + 1.0) / control * max_chi2 <= chi2 {
        0.0
    } else {
        ((max_chi2 * control * (control + 1.0) / chi2).sqrt() - control).clamp(0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use dataset::SplitMix64;

    use super::*;

    /// A random relative pose up to these limits.
    fn within(random: &mut SplitMix64, half_m: f64, half_rad: f64) -> Pose2 {
        let mut within = |half: f64| half * (2.0 * random.unit() - 1.0);
        Pose2 { x_m: within(half_m), y_m: within(half_m), heading_rad: within(half_rad) }
    }

    /// Odometry edges of three rounds along a square of 40 m, the poses that they add up to, and closures: 20 right ones
    /// between the first two rounds, and then wrong ones.
    fn drive(random: &mut SplitMix64, n_wrong: usize) -> (Vec<Edge>, Vec<Pose2>, Vec<Edge>) {
        let (mut truth, mut start) = (vec![Pose2::default()], vec![Pose2::default()]);
        let mut odometry = Vec::new();
        for k in 1..240 {
            let heading_rad = if k % 20 == 0 { std::f64::consts::FRAC_PI_2 } else { 0.0 };
            let step = Pose2 { x_m: 2.0, y_m: 0.0, heading_rad };
            let measured = step * within(random, 0.1, 0.05);
            truth.push(truth[k - 1] * step);
            start.push(start[k - 1] * measured);
            odometry.push(Edge::independent(k - 1, k, measured, 0.06, 0.03));
        }
        let mut closures = Vec::new();
        for a in (0..20).map(|k| 4 * k) {
            let measured = truth[a].inverse() * truth[a + 80] * within(random, 0.08, 0.015);
            closures.push(Edge::independent(a, a + 80, measured, 0.05, 0.01));
        }
        for _ in 0..n_wrong {
            let b = 40 + random.below(200);
            let a = random.below(b as u64 - 30);
            let measured = within(random, 2.0, 3.0);
            closures.push(Edge::independent(a, b, measured, 0.05, 0.01));
        }
        (odometry, start, closures)
    }

    /// Most closures are wrong, and the odometry is bad. No attempt is always the best one, and some are worse than keeping
    /// nothing.
    #[test]
    fn the_result_with_the_smallest_cost_is_taken() {
        let mut n_best = [0; 3];
        for seed in 0..20 {
            let (odometry, start, edges) = drive(&mut SplitMix64::new(seed), 400);
            let n = edges.len();
            let doubtful =
                Doubtful { edges: &edges, shares: vec![1.0; n], max_chi2: vec![MAX_CHI2; n] };
            let [first, second] = FIRST.map(|limits| {
                let attempt = graduate(&odometry, &doubtful, &start, &limits);
                with_kept(&odometry, &doubtful, attempt.is_kept, &[&start, &attempt.last])
            });
            let nothing =
                (n as f64 * MAX_CHI2, Robust { poses: start.clone(), is_kept: vec![false; n] });
            let found = reject_false_closures(&odometry, &edges, &start);
            let results = [&first, &second, &nothing];
            let least = results.iter().map(|result| result.0).fold(f64::INFINITY, f64::min);
            let is_best = results.map(|(cost, _)| *cost < least + 1e-6);
            let is_found = |(_, result): &&(f64, Robust)| result.is_kept == found.is_kept;
            assert!(
                results.iter().zip(is_best).any(|(r, is_best)| is_best && is_found(r)),
                "seed {seed}"
            );
            if let [only] = (0..3).filter(|&k| is_best[k]).collect::<Vec<_>>()[..] {
                n_best[only] += 1;
            }
        }
        assert!(n_best.iter().all(|n| 0 < *n), "{n_best:?}");
    }

    /// Most closures are right. One attempt finds them, and its poses are those of a graph without the wrong ones.
    #[test]
    fn right_closures_are_found_among_a_few_wrong_ones() {
        let (odometry, start, closures) = drive(&mut SplitMix64::new(1), 6);
        let found = reject_false_closures(&odometry, &closures, &start);
        assert_eq!(found.is_kept, (0..26).map(|k| k < 20).collect::<Vec<_>>());
        let right: Vec<Edge> = odometry.iter().chain(&closures[..20]).copied().collect();
        for (found, expected) in found.poses.iter().zip(optimize(&right, &start)) {
            assert!(found.distance_m(&expected) < 5e-3, "{found:?} {expected:?}");
        }
    }
}
