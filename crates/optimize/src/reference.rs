//! A measured position or pose in a frame of the outside world.

use dataset::{Pose2, wrap_angle};
use nalgebra::{Matrix2, Matrix3, Vector3};

use crate::graph::Edge;

/// A measured position, or pose, of a point of the robot in the frame of the references.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reference {
    /// Time of the measurement \[ns\].
    pub stamp_ns: i64,
    /// The last scan of the drive before it, or the first one.
    pub scan: usize,
    /// The point in the frame of the lidar at the scan: the way since the scan, and its place on the robot.
    pub scan_from_point: Pose2,
    /// What was measured. The heading is 0 if it was not.
    pub measured: Pose2,
    /// Whether the heading was measured.
    pub has_heading: bool,
    /// Covariance of x, y and heading, in the frame of the references. The row and the column of the heading
    /// are not used if it was not measured.
    pub covariance: Matrix3<f64>,
    /// The number of measurements whose errors count as one, 1 or more.
    pub n_correlated: f64,
}

/// The number of measurements whose errors count as one, for each of some measurements in the order of time.
///
/// The errors of two measurements have the correlation exp(-dt / T) (a first-order Gauss-Markov process). The
/// variance of a mean of n measurements is then that of one, times the sum of all correlations / n^2: each
/// measurement has the weight 1 / (sum of its correlations), 1 / (2 T / dt) for a constant interval dt.
pub fn n_correlated(stamps_ns: &[i64], correlation_secs: f64) -> Vec<f64> {
    let decay = |pair: &[i64]| match correlation_secs {
        secs if 0.0 < secs => libm::exp(-(pair[1].saturating_sub(pair[0]) as f64) * 1e-9 / secs),
        _ => 0.0,
    };
    let decays: Vec<f64> = stamps_ns.windows(2).map(decay).collect();
    let mut sums = vec![1.0; stamps_ns.len()];
    let (mut before, mut after) = (0.0, 0.0);
    for (k, decay) in decays.iter().enumerate() {
        before = (before + 1.0) * decay;
        sums[k + 1] += before;
    }
    for (k, decay) in decays.iter().enumerate().rev() {
        after = (after + 1.0) * decay;
        sums[k] += after;
    }
    sums
}

impl Reference {
    /// The measured point by the poses of the scans.
    pub(crate) fn point(&self, poses: &[Pose2]) -> Pose2 {
        poses[self.scan] * self.scan_from_point
    }

    pub(crate) fn distance_m(&self, poses: &[Pose2]) -> f64 {
        self.point(poses).distance_m(&self.measured)
    }

    /// The mean of the variances of x and y \[m^2\].
    pub(crate) fn variance_m2(&self) -> f64 {
        f64::midpoint(self.covariance[(0, 0)], self.covariance[(1, 1)])
    }

    /// Number of measured values: 2 or 3.
    pub(crate) fn n_measured(&self) -> f64 {
        if self.has_heading { 3.0 } else { 2.0 }
    }

    /// Inverse covariance in the frame of the references, with zeros for a heading that was not measured.
    fn information(&self) -> Matrix3<f64> {
        if self.has_heading {
            return self.covariance.try_inverse().unwrap_or_default();
        }
        let of_position: Matrix2<f64> = self.covariance.fixed_view::<2, 2>(0, 0).into_owned();
        let mut information = Matrix3::zeros();
        let inverse = of_position.try_inverse().unwrap_or_default();
        information.fixed_view_mut::<2, 2>(0, 0).copy_from(&inverse);
        information
    }

    /// The squared error in stated standard deviations.
    pub(crate) fn chi2(&self, poses: &[Pose2]) -> f64 {
        let point = self.point(poses);
        let turn_rad = wrap_angle(point.heading_rad - self.measured.heading_rad);
        let error =
            Vector3::new(point.x_m - self.measured.x_m, point.y_m - self.measured.y_m, turn_rad);
        (error.transpose() * self.information() * error)[(0, 0)]
    }

    /// The reference as the pose of a vertex near it, relative to vertex 0, which has the axes of the frame of the
    /// references. The point is fixed to the vertex. A heading that was not measured is that of the poses,
    /// without information. `poses` are those of all scans.
    pub(crate) fn edge(&self, vertex: usize, vertices: &[Pose2], poses: &[Pose2]) -> Edge {
        let point = self.point(poses);
        let heading_rad =
            if self.has_heading { self.measured.heading_rad } else { point.heading_rad };
        let measured = Pose2 { heading_rad, ..self.measured };
        let vertex_from_point = vertices[vertex].inverse() * point;
        // An edge has its errors in its own frame.
        let in_frame = Pose2 { x_m: 0.0, y_m: 0.0, heading_rad };
        let to_frame = adjoint(&in_frame);
        let of_point = to_frame.transpose() * self.information() * to_frame;
        let to_point = adjoint(&vertex_from_point.inverse());
        let information = to_point.transpose() * of_point * to_point;
        let a_from_b = vertices[0].inverse() * measured * vertex_from_point.inverse();
        Edge { a: 0, b: vertex, a_from_b, information }
    }
}

/// Moves small errors of x, y and heading from the frame of a pose to the frame that the pose is in: the adjoint
/// of SE(2) (Sola, Deray and Atchuthan 2018, "A micro Lie theory for state estimation in robotics", eq. 159).
pub(crate) fn adjoint(pose: &Pose2) -> Matrix3<f64> {
    let (sin, cos) = libm::sincos(pose.heading_rad);
    Matrix3::new(cos, -sin, pose.y_m, sin, cos, -pose.x_m, 0.0, 0.0, 1.0)
}
