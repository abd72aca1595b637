//! The pose graph and the trajectory as files.

use std::fmt::Write as _;

use dataset::{GraphEdge, Pose2, RegisteredScan, StampedPose, Trajectory};
use optimize::{Edge, Solution};

use crate::drives::upper_triangle;

/// Whether two consecutive rows belong to the same drive.
pub(crate) fn is_same_drive(a: &RegisteredScan, b: &RegisteredScan) -> bool {
    (&a.id.log, a.segment) == (&b.id.log, b.segment)
}

/// `graph.g2o`: the pose graphs of all maps.
#[derive(Default)]
pub(crate) struct Graph {
    n_vertices: usize,
    comments: String,
    vertices: String,
    edges: String,
    /// The edges by scan, for `graph.parquet`.
    pub(crate) by_scan: Vec<GraphEdge>,
}

impl Graph {
    /// Adds the graph of the drives of a site: its vertices are the scans that have an edge.
    pub(crate) fn add(&mut self, rows: &[RegisteredScan], solution: &Solution) {
        let mut ids = vec![None; rows.len()];
        for &Edge { a, b, .. } in &solution.edges {
            (ids[a], ids[b]) = (Some(0), Some(0));
        }
        for (row, id) in ids.iter_mut().enumerate() {
            if row == 0 || !is_same_drive(&rows[row - 1], &rows[row]) {
                let RegisteredScan { id: first, segment, .. } = &rows[row];
                let _ = writeln!(
                    self.comments,
                    "# vertices from {}: log {}, segment {segment}",
                    self.n_vertices, first.log
                );
            }
            if id.is_none() {
                continue;
            }
            *id = Some(self.n_vertices);
            let Pose2 { x_m, y_m, heading_rad } = solution.poses[row];
            let _ =
                writeln!(self.vertices, "VERTEX_SE2 {} {x_m} {y_m} {heading_rad}", self.n_vertices);
            self.n_vertices += 1;
        }
        for Edge { a, b, a_from_b, information } in &solution.edges {
            let (Some(a), Some(b)) = (ids[*a], ids[*b]) else { continue };
            let Pose2 { x_m, y_m, heading_rad } = a_from_b;
            let upper = upper_triangle(information).map(|entry| entry.to_string()).join(" ");
            let _ = writeln!(self.edges, "EDGE_SE2 {a} {b} {x_m} {y_m} {heading_rad} {upper}");
        }
        for Edge { a, b, a_from_b, information } in &solution.edges {
            let Some(covariance) = information.try_inverse() else { continue };
            self.by_scan.push(GraphEdge {
                reference: rows[*a].id.clone(),
                query: rows[*b].id.clone(),
                reference_from_query: *a_from_b,
                covariance: upper_triangle(&covariance),
            });
        }
    }

    /// The text of the file. docs/detection.md describes it. The comments are at the end, because GTSAM
    /// stops reading edges at a comment.
    pub(crate) fn text(&self) -> String {
        format!(
            "{}{}# Poses of the lidar [m, rad]. Vertices are numbered along each drive.\n{}",
            self.vertices, self.edges, self.comments
        )
    }
}

/// Poses as text, one line per pose: `stamp x y z qx qy qz qw`, in s, m and a unit quaternion.
pub(crate) fn tum(trajectory: &Trajectory) -> String {
    const SECOND_NS: u64 = 1_000_000_000;
    let mut text = String::new();
    for StampedPose { stamp_ns, pose, .. } in trajectory.poses() {
        let sign = if *stamp_ns < 0 { "-" } else { "" };
        let ns = stamp_ns.unsigned_abs();
        let (seconds, rest) = (ns / SECOND_NS, ns % SECOND_NS);
        let (sin, cos) = libm::sincos(pose.heading_rad / 2.0);
        let _ = writeln!(
            text,
            "{sign}{seconds}.{rest:09} {:.9} {:.9} 0 0 0 {sin:.12} {cos:.12}",
            pose.x_m, pose.y_m
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A quarter turn to the left: half of it is 45 deg, whose sine and cosine are 0.7071.
    #[test]
    fn a_trajectory_as_text_has_nanoseconds_and_quaternions() {
        let heading_rad = std::f64::consts::FRAC_PI_2;
        let pose =
            |stamp_ns| StampedPose::new(stamp_ns, Pose2 { x_m: 1.5, y_m: -2.0, heading_rad });
        let (trajectory, _) = Trajectory::new(vec![pose(1_000_000_007), pose(-1)]);
        let text = tum(&trajectory);
        let lines: Vec<&str> = text.lines().collect();
        let rest = "1.500000000 -2.000000000 0 0 0 0.707106781187 0.707106781187";
        assert_eq!(lines, [format!("-0.000000001 {rest}"), format!("1.000000007 {rest}")]);
    }
}
