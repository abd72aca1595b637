//! How well a pose graph knows the distance between two of its poses.
//!
//! The covariance of the relative pose of two vertices is at most that of any part of the graph that
//! connects them: more measurements never increase it. [`PoseGraph`] uses single paths, on which
//! covariances add up. The bound is the standard deviation of the position along the path with the
//! smallest one, searched as in Dijkstra, "A note on two problems in connexion with graphs" (1959).
//! Any path gives an upper bound, so the search need not find the best one.
//!
//! The standard deviations of the two poses relative to the first pose of their map give another bound.
//! The standard deviation of a difference is at most the sum of both, whatever their correlation. The
//! smaller of the two bounds is used.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use dataset::Pose2;

/// A measured pose of vertex `b` in the frame of vertex `a`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measurement {
    /// Number of a vertex.
    pub a: usize,
    /// Number of another vertex.
    pub b: usize,
    /// The measured pose.
    pub a_from_b: Pose2,
    /// Covariance of x, y and heading of `b` in the frame of `b`: the upper triangle, row by row
    /// \[m^2, m rad, rad^2\].
    pub covariance: [f64; 6],
}

/// A vertex of the graph.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Vertex {
    /// Covariance of its pose relative to the first pose of its map, in the frame of the map, if it is
    /// known. The entries are those of [`Measurement::covariance`].
    pub covariance: Option<[f64; 6]>,
}

/// The measurements that the poses of keyframes rest on.
#[derive(Debug, Clone)]
pub struct PoseGraph {
    /// Edges from each vertex, `(n_vertices,)`.
    edges: Vec<Vec<Step>>,
    /// Bound of the standard deviation of each position relative to the first one of its map \[m\],
    /// `(n_vertices,)`.
    from_first_m: Vec<Option<f64>>,
    /// The vertex of each keyframe, `(n_keyframes,)`. `None` for one whose uncertainty is not known.
    keyframes: Vec<Option<usize>>,
}

/// An edge from a vertex to `to`.
#[derive(Debug, Clone, Copy)]
struct Step {
    to: usize,
    from_from_to: Pose2,
    /// In the frame of `to`.
    covariance: [f64; 6],
}

/// The alignment of a scan with the finished map is not part of the graph. This is the standard deviation
/// of its position in each direction \[m\].
pub const ALIGNMENT_STD_M: f64 = 0.01;

impl PoseGraph {
    /// The graph of some vertices and measurements, and the vertex of each keyframe.
    ///
    /// # Panics
    /// If a measurement or a keyframe names a vertex that does not exist.
    pub fn new(
        vertices: &[Vertex],
        measurements: &[Measurement],
        keyframes: Vec<Option<usize>>,
    ) -> Self {
        let mut edges = vec![Vec::new(); vertices.len()];
        for Measurement { a, b, a_from_b, covariance } in measurements {
            edges[*a].push(Step { to: *b, from_from_to: *a_from_b, covariance: *covariance });
            // A motion of `b` seen from `a` is a motion of `a` seen from `b`.
            edges[*b].push(Step {
                to: *a,
                from_from_to: a_from_b.inverse(),
                covariance: moved(&a_from_b.inverse(), covariance),
            });
        }
        let from_first_m = vertices
            .iter()
            .map(|vertex| vertex.covariance.map(|covariance| largest_variance(&covariance).sqrt()))
            .collect();
        Self { edges, from_first_m, keyframes }
    }

    /// Bounds of the standard deviations of the distances between a keyframe and all keyframes before it
    /// \[m\], `(query,)`. Infinite if the graph does not connect the two. `None` if the uncertainty of one of
    /// them is not known.
    pub fn distance_stds_m(&self, query: usize) -> Vec<Option<f64>> {
        let Some(of_query) = self.keyframes[query] else { return vec![None; query] };
        let along_path_m = self.search(of_query);
        let query_m = self.from_first_m[of_query];
        let bound = |reference: &Option<usize>| {
            let reference = (*reference)?;
            let from_first_m = query_m.zip(self.from_first_m[reference]).map(|(a, b)| a + b);
            let graph_m = from_first_m.map_or(along_path_m[reference], |m| m.min(along_path_m[reference]));
            Some((graph_m * graph_m + 2.0 * ALIGNMENT_STD_M * ALIGNMENT_STD_M).sqrt())
        };
        self.keyframes[..query].iter().map(bound).collect()
    }

    /// Bounds of the standard deviations of the positions of all vertices, seen from one of them \[m\].
    fn search(&self, from: usize) -> Vec<f64> {
        let mut best = vec![f64::INFINITY; self.edges.len()];
        let mut covariances = vec![[0.0; 6]; self.edges.len()];
        let mut is_settled = vec![false; self.edges.len()];
        best[from] = 0.0;
        // The bits of numbers that are not negative have the order of the numbers.
        let mut next = BinaryHeap::from([Reverse((0u64, from))]);
        while let Some(Reverse((_, at))) = next.pop() {
            if std::mem::replace(&mut is_settled[at], true) {
                continue;
            }
            for step in self.edges[at].iter().filter(|step| !is_settled[step.to]) {
                let before = moved(&step.from_from_to, &covariances[at]);
                let covariance = std::array::from_fn(|k| before[k] + step.covariance[k]);
                let variance = largest_variance(&covariance);
                if variance < best[step.to] {
                    best[step.to] = variance;
                    covariances[step.to] = covariance;
                    next.push(Reverse((variance.to_bits(), step.to)));
                }
            }
        }
        best.into_iter().map(f64::sqrt).collect()
    }
}

/// The covariance of the pose of `b` in the frame of `b`, if `b` is fixed to `a` and the covariance of the
/// pose of `a` is given in the frame of `a`.
///
/// If `a` moves by v and turns by w, `b` at t moves by v + w J t, where J turns by 90 deg.
fn moved(a_from_b: &Pose2, covariance: &[f64; 6]) -> [f64; 6] {
    let (sin, cos) = libm::sincos(a_from_b.heading_rad);
    let [xx, xy, xh, yy, yh, hh] = *covariance;
    let (jx, jy) = (-a_from_b.y_m, a_from_b.x_m);
    let (xh_moved, yh_moved) = (xh + hh * jx, yh + hh * jy);
    let xx_moved = xx + 2.0 * jx * xh + jx * jx * hh;
    let yy_moved = yy + 2.0 * jy * yh + jy * jy * hh;
    let xy_moved = xy + jy * xh + jx * yh + jx * jy * hh;
    // In the axes of `b`.
    [
        cos * cos * xx_moved + 2.0 * cos * sin * xy_moved + sin * sin * yy_moved,
        cos * sin * (yy_moved - xx_moved) + (cos * cos - sin * sin) * xy_moved,
        cos * xh_moved + sin * yh_moved,
        sin * sin * xx_moved - 2.0 * cos * sin * xy_moved + cos * cos * yy_moved,
        -sin * xh_moved + cos * yh_moved,
        hh,
    ]
}

/// The variance of the position in the direction with the largest one \[m^2\].
fn largest_variance(&[xx, xy, _, yy, ..]: &[f64; 6]) -> f64 {
    let (mean, half) = (0.5 * (xx + yy), 0.5 * (xx - yy));
    (mean + (half * half + xy * xy).sqrt()).max(0.0)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;

    fn step(a: usize, b: usize, x_m: f64, turn_rad: f64, covariance: [f64; 6]) -> Measurement {
        let a_from_b = Pose2 { x_m, y_m: 0.0, heading_rad: turn_rad };
        Measurement { a, b, a_from_b, covariance }
    }

    /// Independent errors of x, y and heading.
    fn diagonal(xx: f64, yy: f64, hh: f64) -> [f64; 6] {
        [xx, 0.0, 0.0, yy, 0.0, hh]
    }

    fn graph(n: usize, measurements: &[Measurement]) -> PoseGraph {
        PoseGraph::new(&vec![Vertex::default(); n], measurements, (0..n).map(Some).collect())
    }

    /// What the graph adds to the error of the alignment of both scans \[m^2\].
    fn variance(graph: &PoseGraph, query: usize, reference: usize) -> f64 {
        let std_m = graph.distance_stds_m(query)[reference].unwrap();
        std_m * std_m - 2.0 * ALIGNMENT_STD_M * ALIGNMENT_STD_M
    }

    /// Two steps of 10 m, each with 0.01 m^2 in x and y and 1e-4 rad^2. Across the path, the heading error of
    /// the first step counts over the 10 m of the second one: 0.01 + 0.01 + 100 * 1e-4 = 0.03 m^2. Along the
    /// path, 0.02 m^2. The bound is the same from either end. With a turn by 90 deg between the steps, the
    /// first error of the heading moves the end along x instead: the sum is 0.03 m^2 as well.
    #[test]
    fn the_error_of_a_heading_counts_over_the_path_that_follows() {
        for turn_rad in [0.0, FRAC_PI_2] {
            let noise = diagonal(0.01, 0.01, 1e-4);
            let path = [step(0, 1, 10.0, turn_rad, noise), step(1, 2, 10.0, 0.0, noise)];
            assert!((variance(&graph(3, &path), 2, 0) - 0.03).abs() < 1e-12, "{turn_rad}");
            let other_way = [step(2, 1, 10.0, turn_rad, noise), step(1, 0, 10.0, 0.0, noise)];
            assert!((variance(&graph(3, &other_way), 2, 0) - 0.03).abs() < 1e-12, "{turn_rad}");
        }
    }

    /// From the end, the last turn does not matter: 0 -> 1 is a step of 10 m with 0.01 rad^2 at vertex 1.
    /// Seen from vertex 1, vertex 0 is 10 m away, and moves across the path by 10 m * 0.1 rad: 1 m^2, besides
    /// 0.01 m^2.
    #[test]
    fn a_measurement_counts_in_both_directions() {
        let there = graph(2, &[step(0, 1, 10.0, 0.3, diagonal(0.01, 0.01, 0.01))]);
        assert!((variance(&there, 1, 0) - 1.01).abs() < 1e-12);
        let back = graph(2, &[step(1, 0, 10.0, 0.3, diagonal(0.01, 0.01, 0.01))]);
        assert!((variance(&back, 1, 0) - 0.01).abs() < 1e-12);
    }

    /// A path of 100 steps with 0.01 m^2 each gives 1 m^2. A closure between its ends has 0.04 m^2.
    #[test]
    fn a_closure_is_a_short_path() {
        let noise = diagonal(0.01, 0.01, 0.0);
        let mut path: Vec<_> = (0..100).map(|k| step(k, k + 1, 1.0, 0.0, noise)).collect();
        assert!((variance(&graph(101, &path), 100, 0) - 1.0).abs() < 1e-12);
        path.push(step(0, 100, 0.0, 0.0, diagonal(0.04, 0.04, 0.0)));
        assert!((variance(&graph(101, &path), 100, 0) - 0.04).abs() < 1e-12);
        // From the step before the last one: over the closure and a step.
        assert!((variance(&graph(101, &path), 99, 0) - 0.05).abs() < 1e-12);
    }

    /// Relative to the first pose, the positions are known to 0.3 m and 0.4 m in their worst direction. The
    /// standard deviations add up, because their correlation is not known: 0.7 m. The path has 1 m.
    #[test]
    fn the_smaller_of_two_bounds_is_used() {
        let path = [step(0, 1, 1.0, 0.0, diagonal(1.0, 0.5, 0.0))];
        let vertex = |std_m: f64| Vertex { covariance: Some(diagonal(0.01, std_m * std_m, 9.0)) };
        let graph = |a, b| PoseGraph::new(&[vertex(a), vertex(b)], &path, vec![Some(0), Some(1)]);
        assert!((variance(&graph(0.3, 0.4), 1, 0) - 0.49).abs() < 1e-12);
        assert!((variance(&graph(0.8, 0.4), 1, 0) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn what_the_graph_does_not_connect_is_not_known() {
        let path = [step(0, 1, 1.0, 0.0, diagonal(1.0, 1.0, 0.0))];
        let keyframes = vec![Some(0), Some(1), Some(2), None];
        let graph = PoseGraph::new(&[Vertex::default(); 3], &path, keyframes);
        assert_eq!(graph.distance_stds_m(2), [Some(f64::INFINITY); 2]);
        assert_eq!(graph.distance_stds_m(3), [None; 3]);
    }
}
