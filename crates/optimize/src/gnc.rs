//! Rejection of false closures: truncated least squares with graduated non-convexity.

use dataset::Pose2;

use crate::graph::{Edge, Solver};

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
    let edges: Vec<Edge> = odometry.iter().chain(closures).copied().collect();
    let mut solver = Solver::new(start.len(), &edges);
    let mut weights = vec![1.0; edges.len()];
    let mut poses = start.to_vec();
    solver.optimize(&weights, &mut poses);
    let chi2_of =
        |poses: &[Pose2]| -> Vec<f64> { closures.iter().map(|c| c.chi2(poses)).collect() };
    let mut chi2 = chi2_of(&poses);
    let largest = chi2.iter().copied().fold(0.0, f64::max);
    if MAX_CHI2 < largest {
        let mut control = MAX_CHI2 / (2.0 * largest - MAX_CHI2);
        for _ in 0..MAX_ROUNDS {
            for (weight, &chi2) in weights[odometry.len()..].iter_mut().zip(&chi2) {
                *weight = truncated_weight(chi2, control);
            }
            solver.optimize(&weights, &mut poses);
            chi2 = chi2_of(&poses);
            if weights.iter().all(|&w| w == 0.0 || w == 1.0) {
                break;
            }
            control *= GROWTH;
        }
    }
    let is_kept: Vec<bool> = weights[odometry.len()..].iter().map(|&weight| weight > 0.5).collect();
    for (weight, &is_kept) in weights[odometry.len()..].iter_mut().zip(&is_kept) {
        *weight = if is_kept { 1.0 } else { 0.0 };
    }
    let mut poses = start.to_vec();
    solver.optimize(&weights, &mut poses);
    Robust { poses, is_kept }
}

/// The weight of a closure at a control parameter mu, with c^2 = [`MAX_CHI2`]: 1 below
/// mu / (mu + 1) c^2, 0 above (mu + 1) / mu c^2, and sqrt(c^2 mu (mu + 1) / chi2) - mu between.
fn truncated_weight(chi2: f64, control: f64) -> f64 {
    if chi2 <= control / (control + 1.0) * MAX_CHI2 {
        1.0
    } else if (control + 1.0) / control * MAX_CHI2 <= chi2 {
        0.0
    } else {
        ((MAX_CHI2 * control * (control + 1.0) / chi2).sqrt() - control).clamp(0.0, 1.0)
    }
}
