//! How well a pose graph knows the distance between two of its poses.
//!
//! The covariance of the relative pose of two vertices is at most that of any part of the graph that
//! connects them: more measurements never increase it. [`PoseGraph`] uses single paths, on which
//! covariances add up. The path is one with small variances of the position, searched as in Dijkstra, "A
//! note on two problems in connexion with graphs" (1959). Any path gives an upper bound, so the search need
//! not find the best one.
//!
//! The error of a distance is the error along the line between the two positions, to first order. An error
//! e across a line of length d makes it longer by e^2 / (2 d). For e of two standard deviations s, this is
//! 2 s^2 / d, so s^2 / d is added to the standard deviation of the distance. No error of the distance is
//! larger than that of the position, in the direction with the largest one.
//!
//! The standard deviations of the two poses relative to the first pose of their map give another bound.
//! The standard deviation of a difference is at most the sum of both, whatever their correlation. The
//! smaller of the two bounds is used.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use dataset::{Keyframe, Pose2};

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
    /// `(n_vertices,)`. Infinite if it is not known.
    from_first_m: Vec<f64>,
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
        let from_first_m = from_first_m(vertices, &edges);
        Self { edges, from_first_m, keyframes }
    }

    /// Bounds of the standard deviations of the distances between a keyframe and all keyframes before it
    /// \[m\], `(query,)`. Infinite if the graph does not connect the two. `None` if the uncertainty of one of
    /// them is not known. `keyframes` have the optimized poses.
    pub fn distance_stds_m(&self, keyframes: &[Keyframe], query: usize) -> Vec<Option<f64>> {
        let Some(of_query) = self.keyframes[query] else { return vec![None; query] };
        let covariances = self.search(of_query);
        let bound = |(reference, keyframe): (&Option<usize>, &Keyframe)| {
            let reference = (*reference)?;
            let reference_from_query = keyframe.pose.inverse() * keyframes[query].pose;
            let along_path_m = covariances[reference].map_or(f64::INFINITY, |covariance| {
                distance_std_m(&reference_from_query, &covariance)
            });
            let from_first_m = self.from_first_m[of_query] + self.from_first_m[reference];
            let graph_m = along_path_m.min(from_first_m);
            Some((graph_m * graph_m + 2.0 * ALIGNMENT_STD_M * ALIGNMENT_STD_M).sqrt())
        };
        self.keyframes[..query].iter().zip(keyframes).map(bound).collect()
    }

    /// Bounds of the covariances of all vertices that are connected to one of them, seen from this one and in
    /// the frames of the vertices.
    fn search(&self, from: usize) -> Vec<Option<[f64; 6]>> {
        let mut best = vec![f64::INFINITY; self.edges.len()];
        let mut covariances = vec![None; self.edges.len()];
        covariances[from] = Some([0.0; 6]);
        let mut is_settled = vec![false; self.edges.len()];
        best[from] = 0.0;
        // The bits of numbers that are not negative have the order of the numbers.
        let mut next = BinaryHeap::from([Reverse((0u64, from))]);
        while let Some(Reverse((_, at))) = next.pop() {
            if std::mem::replace(&mut is_settled[at], true) {
                continue;
            }
            let Some(of_vertex) = covariances[at] else { continue };
            for step in self.edges[at].iter().filter(|step| !is_settled[step.to]) {
                let before = moved(&step.from_from_to, &of_vertex);
                let covariance = std::array::from_fn(|k| before[k] + step.covariance[k]);
                let variance = largest_variance(&covariance);
                if variance < best[step.to] {
                    best[step.to] = variance;
                    covariances[step.to] = Some(covariance);
                    next.push(Reverse((variance.to_bits(), step.to)));
                }
            }
        }
        covariances
    }
}

/// Bounds of the standard deviations of all positions relative to the first one of their map \[m\]. Those
/// that are not known are bounded by a neighbour: by the sum of the standard deviations of its position, of
/// its heading times the distance, and of the measurement between the two.
fn from_first_m(vertices: &[Vertex], edges: &[Vec<Step>]) -> Vec<f64> {
    let mut bounds = vec![f64::INFINITY; vertices.len()];
    let mut headings = vec![f64::INFINITY; vertices.len()];
    let mut next = BinaryHeap::new();
    for (k, vertex) in vertices.iter().enumerate() {
        if let Some(covariance) = &vertex.covariance {
            bounds[k] = largest_variance(covariance).sqrt();
            headings[k] = covariance[5].sqrt();
            next.push(Reverse((bounds[k].to_bits(), k)));
        }
    }
    let mut is_settled = vec![false; vertices.len()];
    while let Some(Reverse((_, at))) = next.pop() {
        if std::mem::replace(&mut is_settled[at], true) {
            continue;
        }
        for step in &edges[at] {
            let step_m = step.from_from_to.distance_m(&Pose2::default());
            let std_m = largest_variance(&step.covariance).sqrt();
            let bound_m = bounds[at] + headings[at] * step_m + std_m;
            if vertices[step.to].covariance.is_none() && bound_m < bounds[step.to] {
                bounds[step.to] = bound_m;
                headings[step.to] = headings[at] + step.covariance[5].sqrt();
                next.push(Reverse((bound_m.to_bits(), step.to)));
            }
        }
    }
    bounds
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

/// The standard deviation of the distance between two poses, if the covariance of `b` seen from `a` is given in
/// the frame of `b` \[m\].
fn distance_std_m(b_from_a: &Pose2, covariance: &[f64; 6]) -> f64 {
    let largest_m = largest_variance(covariance).sqrt();
    let distance_m = b_from_a.distance_m(&Pose2::default());
    if distance_m == 0.0 {
        return largest_m;
    }
    let (x, y) = (b_from_a.x_m / distance_m, b_from_a.y_m / distance_m);
    let [xx, xy, _, yy, ..] = *covariance;
    let along = x * x * xx + 2.0 * x * y * xy + y * y * yy;
    let across = y * y * xx - 2.0 * x * y * xy + x * x * yy;
    (along.max(0.0).sqrt() + across.max(0.0) / distance_m).min(largest_m)
}

/// The variance of the position in the direction with the largest one \[m^2\].
fn largest_variance(&[xx, xy, _, yy, ..]: &[f64; 6]) -> f64 {
    let (mean, half) = (0.5 * (xx + yy), 0.5 * (xx - yy));
    (mean + (half * half + xy * xy).sqrt()).max(0.0)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use dataset::ScanId;

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

    /// Keyframes at these positions on the x axis, heading along it.
    fn keyframes(xs_m: &[f64]) -> Vec<Keyframe> {
        let of = |(&x_m, scan): (&f64, u32)| Keyframe {
            id: ScanId { log: "drive".into(), scan },
            site: "campus".into(),
            stamp_ns: i64::from(scan),
            pose: Pose2 { x_m, y_m: 0.0, heading_rad: 0.0 },
            covariance: None,
            z_m: None,
            segment: 0,
            frame: 0,
            map: Some(0),
            travel_m: x_m,
            coverage_deg: 360.0,
        };
        xs_m.iter().zip(0..).map(of).collect()
    }

    /// What the graph adds to the error of the alignment of both scans \[m^2\].
    fn variance(graph: &PoseGraph, xs_m: &[f64], query: usize, reference: usize) -> f64 {
        let std_m = graph.distance_stds_m(&keyframes(xs_m), query)[reference].unwrap();
        std_m * std_m - 2.0 * ALIGNMENT_STD_M * ALIGNMENT_STD_M
    }

    /// Two steps of 10 m, each with 0.01 m^2 in x and y. The variance along the line of 20 m is 0.02 m^2, and no
    /// heading counts. Seen from the query, the heading of its own edge moves the other end across the line by
    /// 20 m * 0.01, and the other heading by 10 m * 0.01: 0.02 + 0.04 + 0.01 = 0.07 m^2, so 0.07 / 20 m are
    /// added to the standard deviation.
    #[test]
    fn an_error_across_the_line_counts_in_second_order() {
        let noise = diagonal(0.01, 0.01, 1e-4);
        let path = [step(0, 1, 10.0, 0.0, noise), step(1, 2, 10.0, 0.0, noise)];
        let expected_m = 0.02f64.sqrt() + 0.07 / 20.0;
        let found = variance(&graph(3, &path), &[0.0, 10.0, 20.0], 2, 0);
        assert!((found - expected_m * expected_m).abs() < 1e-12, "{found}");
    }

    /// Between two places 10 m apart, around two corners: 10 m along x, 10 m along y, and 10 m back. The ends are
    /// at (0, 0) and (0, 10). With the last place fixed, the heading error of 0.01 rad at the corner at (10, 0)
    /// moves the first place by 10 m * 0.01 along the line between the ends, and not across.
    #[test]
    fn an_error_of_a_heading_counts_along_a_line_that_is_not_the_path() {
        let path = [
            step(0, 1, 10.0, FRAC_PI_2, diagonal(0.0, 0.0, 1e-4)),
            step(1, 2, 10.0, FRAC_PI_2, diagonal(0.0, 0.0, 0.0)),
            step(2, 3, 10.0, 0.0, diagonal(0.0, 0.0, 0.0)),
        ];
        let mut ends = keyframes(&[0.0, 10.0, 10.0, 0.0]);
        ends[2].pose.y_m = 10.0;
        (ends[3].pose.y_m, ends[3].pose.heading_rad) = (10.0, 2.0 * FRAC_PI_2);
        let std_m = graph(4, &path).distance_stds_m(&ends, 3)[0].unwrap();
        let of_graph_m = (std_m * std_m - 2.0 * ALIGNMENT_STD_M * ALIGNMENT_STD_M).sqrt();
        assert!((of_graph_m - 0.1).abs() < 1e-9, "{of_graph_m}");
    }

    /// At the same position, every direction can be that of the distance: 0.5 m^2 in y is the largest variance.
    #[test]
    fn the_largest_variance_is_the_limit() {
        let there = graph(2, &[step(0, 1, 0.0, 0.3, diagonal(0.01, 0.5, 0.01))]);
        assert!((variance(&there, &[3.0, 3.0], 1, 0) - 0.5).abs() < 1e-12);
        let near =
            distance_std_m(&Pose2 { x_m: 1e-3, ..Pose2::default() }, &diagonal(0.01, 0.5, 0.0));
        assert!((near - 0.5f64.sqrt()).abs() < 1e-12);
    }

    /// A path of 100 steps with 0.01 m^2 each gives 1 m^2. A closure between its ends has 0.04 m^2.
    #[test]
    fn a_closure_is_a_short_path() {
        let noise = diagonal(0.01, 0.01, 0.0);
        let mut path: Vec<_> = (0..100).map(|k| step(k, k + 1, 1.0, 0.0, noise)).collect();
        let same = [0.0; 101];
        assert!((variance(&graph(101, &path), &same, 100, 0) - 1.0).abs() < 1e-12);
        path.push(step(0, 100, 0.0, 0.0, diagonal(0.04, 0.04, 0.0)));
        assert!((variance(&graph(101, &path), &same, 100, 0) - 0.04).abs() < 1e-12);
        // From the step before the last one: over the closure and a step.
        assert!((variance(&graph(101, &path), &same, 99, 0) - 0.05).abs() < 1e-12);
    }

    /// Relative to the first pose, the positions are known to 0.3 m and 0.4 m in their worst direction. The
    /// standard deviations add up, because their correlation is not known: 0.7 m. The path has 1 m.
    #[test]
    fn the_smaller_of_two_bounds_is_used() {
        let path = [step(0, 1, 1.0, 0.0, diagonal(1.0, 0.5, 0.0))];
        let vertex = |std_m: f64| Vertex { covariance: Some(diagonal(0.01, std_m * std_m, 9.0)) };
        let graph = |a, b| PoseGraph::new(&[vertex(a), vertex(b)], &path, vec![Some(0), Some(1)]);
        assert!((variance(&graph(0.3, 0.4), &[0.0; 2], 1, 0) - 0.49).abs() < 1e-12);
        assert!((variance(&graph(0.8, 0.4), &[0.0; 2], 1, 0) - 1.0).abs() < 1e-12);
    }

    /// Vertex 1 is known to 0.3 m and 0.01 rad relative to the first pose, and vertex 3 to 0.2 m. Vertex 2 is a
    /// step of 2 m and 0.1 m from vertex 1: at most 0.3 m + 2 m * 0.01 + 0.1 m = 0.42 m. With vertex 3:
    /// 0.62 m. The path between them has 1 m.
    #[test]
    fn a_vertex_that_is_not_known_is_bounded_by_its_neighbour() {
        let known = |std_m: f64, std_rad: f64| Vertex {
            covariance: Some(diagonal(std_m * std_m, std_m * std_m, std_rad * std_rad)),
        };
        let vertices = [Vertex::default(), known(0.3, 0.01), Vertex::default(), known(0.2, 0.02)];
        let edges = [
            step(1, 2, 2.0, 0.5, diagonal(0.01, 0.004, 0.0)),
            step(2, 3, 5.0, 0.0, diagonal(1.0, 1.0, 0.0)),
        ];
        let graph = PoseGraph::new(&vertices, &edges, (0..4).map(Some).collect());
        assert!((variance(&graph, &[0.0; 4], 3, 2) - 0.62 * 0.62).abs() < 1e-12);
        assert_eq!(graph.distance_stds_m(&keyframes(&[0.0; 4]), 3)[0], Some(f64::INFINITY));
    }

    #[test]
    fn what_the_graph_does_not_connect_is_not_known() {
        let path = [step(0, 1, 1.0, 0.0, diagonal(1.0, 1.0, 0.0))];
        let of_keyframes = vec![Some(0), Some(1), Some(2), None];
        let graph = PoseGraph::new(&[Vertex::default(); 3], &path, of_keyframes);
        let keyframes = keyframes(&[0.0; 4]);
        assert_eq!(graph.distance_stds_m(&keyframes, 2), [Some(f64::INFINITY); 2]);
        assert_eq!(graph.distance_stds_m(&keyframes, 3), [None; 3]);
    }
}
