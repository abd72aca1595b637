//! The pose graph and the trajectory as files.

use std::fmt::Write as _;

use dataset::{GraphEdge, Pose2, RegisteredScan};
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
