//! Pose graphs in the plane, and their best poses.

use dataset::{Pose2, wrap_angle};
use nalgebra::{Matrix3, Vector3};
use register::{BlockSystem, relative_derivatives};

/// A measured relative pose between two poses of a graph.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edge {
    /// Index of the first pose.
    pub a: usize,
    /// Index of the second pose.
    pub b: usize,
    /// The second pose in the frame of the first, as measured.
    pub a_from_b: Pose2,
    /// Inverse covariance of x, y and heading of the measurement, in its own frame, `(3, 3)`.
    pub information: Matrix3<f64>,
}

impl Edge {
    /// An edge with independent errors of these standard deviations.
    pub fn independent(a: usize, b: usize, a_from_b: Pose2, std_m: f64, std_rad: f64) -> Self {
        let weights = Vector3::new(std_m, std_m, std_rad).map(|std| 1.0 / (std * std));
        Self { a, b, a_from_b, information: Matrix3::from_diagonal(&weights) }
    }

    /// The difference between the poses and the measurement, in the frame of the measurement: x, y
    /// \[m\] and heading \[rad\].
    pub fn error(&self, poses: &[Pose2]) -> Vector3<f64> {
        let error = self.a_from_b.inverse() * (poses[self.a].inverse() * poses[self.b]);
        Vector3::new(error.x_m, error.y_m, error.heading_rad)
    }

    /// The squared error in standard deviations (Mahalanobis distance). 3 on average if the measurement
    /// is right.
    pub fn chi2(&self, poses: &[Pose2]) -> f64 {
        let error = self.error(poses);
        (error.transpose() * self.information * error)[(0, 0)]
    }

    /// Derivatives of the error with respect to x, y and heading of both poses.
    fn derivatives(&self, poses: &[Pose2]) -> [Matrix3<f64>; 2] {
        let (sin, cos) = libm::sincos(self.a_from_b.heading_rad);
        let to_measured = Matrix3::new(
            cos, sin, 0.0, //
            -sin, cos, 0.0, //
            0.0, 0.0, 1.0,
        );
        relative_derivatives(&poses[self.a], &poses[self.b]).map(|d| to_measured * d)
    }
}

/// Inverse variance of the pose that a graph is fixed at \[1/m^2, 1/rad^2\]: 0.1 mm.
const ANCHOR: f64 = 1e8;
/// When an optimization ends.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits {
    /// A step that reduces the cost by a smaller share is the last one.
    pub(crate) converged: f64,
    /// The most steps.
    pub(crate) max_steps: usize,
}

/// Limits of the optimization of a graph without wrong edges.
const CLEAN: Limits = Limits { converged: 1e-7, max_steps: 60 };
/// Damping of the first step, the smallest one, and the largest one before the optimization gives up.
const FIRST_DAMPING: f64 = 1e-6;
const MIN_DAMPING: f64 = 1e-12;
const MAX_DAMPING: f64 = 1e6;

/// Edges between poses, with the structure of their normal equations.
pub(crate) struct Solver {
    edges: Vec<Edge>,
    /// The first pose of each connected part, which stays where it is.
    anchors: Vec<usize>,
    system: BlockSystem,
    /// Damping of the next step.
    pub(crate) damping: f64,
}

/// Sum of the weighted squared errors.
pub(crate) fn cost(edges: &[Edge], weights: &[f64], poses: &[Pose2]) -> f64 {
    edges.iter().zip(weights).filter(|(_, w)| **w > 0.0).map(|(e, w)| w * e.chi2(poses)).sum()
}

impl Solver {
    /// Prepares the optimization of `n_poses` poses.
    pub(crate) fn new(n_poses: usize, edges: Vec<Edge>) -> Self {
        let anchors = first_of_parts(n_poses, &edges);
        let system = BlockSystem::new(n_poses, edges.iter().map(|edge| (edge.a, edge.b)));
        Self { edges, anchors, system, damping: FIRST_DAMPING }
    }

    /// Sets up the normal equations at the poses.
    fn linearize(&mut self, weights: &[f64], poses: &[Pose2]) {
        self.system.clear();
        for (edge, &weight) in self.edges.iter().zip(weights) {
            let [da, db] = edge.derivatives(poses);
            let weighted = edge.information * weight;
            let (to_a, to_b) = (da.transpose() * weighted, db.transpose() * weighted);
            let error = edge.error(poses);
            self.system.add(edge.a, edge.a, &(to_a * da));
            self.system.add(edge.b, edge.b, &(to_b * db));
            self.system.add(edge.a, edge.b, &(to_a * db));
            self.system.add_right(edge.a, &-(to_a * error));
            self.system.add_right(edge.b, &-(to_b * error));
        }
        for &anchor in &self.anchors {
            self.system.add(anchor, anchor, &Matrix3::from_diagonal_element(ANCHOR));
        }
    }

    /// Reduces the weighted cost with the method of Levenberg and Marquardt. Returns the share of the cost that the
    /// last step took away, 0 if no step reduced it. Starts with the damping that the last optimization ended with.
    pub(crate) fn optimize(
        &mut self,
        weights: &[f64],
        poses: &mut [Pose2],
        limits: &Limits,
    ) -> f64 {
        let mut before = cost(&self.edges, weights, poses);
        let mut share = 0.0;
        for _ in 0..limits.max_steps {
            let mut gained = None;
            while self.damping < MAX_DAMPING {
                // Again for each damping: the factor takes the place of the equations. That needs no copy of them.
                self.linearize(weights, poses);
                if let Some(step) = self.system.solve_in_place(self.damping) {
                    let moved: Vec<Pose2> = poses.iter().zip(&step).map(apply).collect();
                    let after = cost(&self.edges, weights, &moved);
                    if after <= before {
                        poses.copy_from_slice(&moved);
                        gained = Some((before - after) / (before + 1e-12));
                        before = after;
                        self.damping = (self.damping / 10.0).max(MIN_DAMPING);
                        break;
                    }
                }
                self.damping *= 10.0;
            }
            if gained.is_none() {
                self.damping = FIRST_DAMPING;
            }
            share = gained.unwrap_or(0.0);
            if share <= limits.converged {
                break;
            }
        }
        share
    }

    /// Covariances of all poses relative to the fixed pose of their part, in the frame of the map.
    fn into_covariances(mut self, weights: &[f64], poses: &[Pose2]) -> Option<Vec<Matrix3<f64>>> {
        self.linearize(weights, poses);
        self.system.into_inverse_diagonal()
    }
}

/// Moves a pose by a step in x, y and heading.
fn apply((pose, step): (&Pose2, &Vector3<f64>)) -> Pose2 {
    Pose2 {
        x_m: pose.x_m + step[0],
        y_m: pose.y_m + step[1],
        heading_rad: wrap_angle(pose.heading_rad + step[2]),
    }
}

/// The first pose of each part of the graph that edges connect.
fn first_of_parts(n_poses: usize, edges: &[Edge]) -> Vec<usize> {
    let mut first: Vec<usize> = (0..n_poses).collect();
    fn root(first: &mut [usize], mut k: usize) -> usize {
        while first[k] != k {
            first[k] = first[first[k]];
            k = first[k];
        }
        k
    }
    for edge in edges {
        let (a, b) = (root(&mut first, edge.a), root(&mut first, edge.b));
        first[a.max(b)] = a.min(b);
    }
    (0..n_poses).filter(|&k| first[k] == k).collect()
}

/// The poses that agree best with all edges, from a start.
pub fn optimize(edges: &[Edge], start: &[Pose2]) -> Vec<Pose2> {
    let mut poses = start.to_vec();
    let mut solver = Solver::new(start.len(), edges.to_vec());
    solver.optimize(&vec![1.0; edges.len()], &mut poses, &CLEAN);
    poses
}

/// Covariances of x, y and heading of all poses, relative to the first pose of their part of the graph,
/// in the frame of the map. `None` if the edges do not determine the poses.
pub fn covariances(edges: &[Edge], poses: &[Pose2]) -> Option<Vec<Matrix3<f64>>> {
    Solver::new(poses.len(), edges.to_vec()).into_covariances(&vec![1.0; edges.len()], poses)
}
