//! Rejection of false closures: truncated least squares with graduated non-convexity.

use dataset::Pose2;

use crate::graph::{Edge, Solver, optimize};

/// A closure whose squared error is above this value is rejected: the 99 % quantile of the chi-square
/// distribution with 3 degrees of freedom.
pub const MAX_CHI2: f64 = 11.344_866_730_144_373;
/// Factor of the control parameter from round to round (Yang et al. 2020, section V).
const GROWTH: f64 = 1.4;
/// The most rounds.
const MAX_ROUNDS: usize = 150;

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
/// In the end, the graph is optimized again from `start` with the kept closures, because the last poses
/// of a graduation that rejects everything can be bad.
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
    let Doubtful { edges: doubted, shares, max_chi2 } = doubtful;
    let mut kept = vec![1.0; doubted.len()];
    let weights =
        |kept: &[f64]| -> Vec<f64> { kept.iter().zip(shares).map(|(k, s)| k * s).collect() };
    let mut graph = Graduated::new(trusted, doubted, start.len());
    let mut poses = start.to_vec();
    graph.optimize(&weights(&kept), &mut poses);
    let chi2_of = |poses: &[Pose2]| -> Vec<f64> { doubted.iter().map(|c| c.chi2(poses)).collect() };
    let mut chi2 = chi2_of(&poses);
    let worst = chi2.iter().zip(max_chi2).max_by(|a, b| (a.0 / a.1).total_cmp(&(b.0 / b.1)));
    if let Some((largest, max)) = worst.filter(|(chi2, max)| max < chi2) {
        let mut control = max / (2.0 * largest - max);
        for _ in 0..MAX_ROUNDS {
            for (k, weight) in kept.iter_mut().enumerate() {
                *weight = truncated_weight(chi2[k], control, max_chi2[k]);
            }
            graph.optimize(&weights(&kept), &mut poses);
            chi2 = chi2_of(&poses);
            if kept.iter().all(|&w| w == 0.0 || w == 1.0) {
                break;
            }
            control *= GROWTH;
        }
    }
    let is_kept: Vec<bool> = kept.iter().map(|&weight| weight > 0.5).collect();
    let weighted = doubted.iter().zip(shares).zip(&is_kept).filter(|(_, kept)| **kept);
    let weighted =
        weighted.map(|((edge, share), _)| Edge { information: edge.information * *share, ..*edge });
    let edges: Vec<Edge> = trusted.iter().copied().chain(weighted).collect();
    Robust { poses: optimize(&edges, start), is_kept }
}

/// The graph of the trusted edges, and of the doubtful ones that have a weight.
struct Graduated<'a> {
    trusted: &'a [Edge],
    doubtful: &'a [Edge],
    /// The doubtful edges in the graph, ascending.
    members: Vec<usize>,
    solver: Solver,
}

/// Edges without weight make each step slower. They are taken out when they are this share of all.
const MAX_IDLE_SHARE: f64 = 0.1;
/// A step that reduces the cost by a smaller share is the last one of a round.
const CONVERGED: f64 = 1e-4;

impl<'a> Graduated<'a> {
    fn new(trusted: &'a [Edge], doubtful: &'a [Edge], n_poses: usize) -> Self {
        let members: Vec<usize> = (0..doubtful.len()).collect();
        let edges = trusted.iter().chain(doubtful).copied().collect();
        Self { trusted, doubtful, members, solver: Solver::new(n_poses, edges) }
    }

    /// Optimizes the poses with these weights of the doubtful edges.
    fn optimize(&mut self, weights: &[f64], poses: &mut [Pose2]) {
        let with_weight: Vec<usize> = (0..weights.len()).filter(|&k| 0.0 < weights[k]).collect();
        let is_member = |k: &usize| self.members.binary_search(k).is_ok();
        let n_idle = self.members.len().saturating_sub(with_weight.len());
        if MAX_IDLE_SHARE * (self.members.len() as f64) < n_idle as f64
            || !with_weight.iter().all(is_member)
        {
            let doubtful = with_weight.iter().map(|&k| &self.doubtful[k]);
            let edges = self.trusted.iter().chain(doubtful).copied().collect();
            self.solver = Solver::new(poses.len(), edges);
            self.members = with_weight;
        }
        let mut of_edges = vec![1.0; self.trusted.len()];
        of_edges.extend(self.members.iter().map(|&k| weights[k]));
        self.solver.optimize(&of_edges, poses, CONVERGED);
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
