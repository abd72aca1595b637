//! Absolute references: measured positions and poses that put a map into a frame of the outside world, such
//! as satellite fixes and surveyed poses.
//!
//! 1. The map is moved as a whole to where most references agree with it (`reference_fit.rs`).
//! 2. It bends, within the errors of its odometry and its closures, so that it agrees with the references. Those
//!    that contradict it are rejected, with graduated non-convexity.
//! 3. If half of them or more are rejected, they contradict the map as a whole, and it stays as it was. Measurements
//!    with correlated errors count as fewer.
//!
//! References state their errors, often too small. The scatter of all references is compared with what they
//! state, and larger errors are used if it is larger. Consecutive fixes have nearly the same error, see
//! [`n_correlated`](crate::n_correlated).

use dataset::Pose2;
use model::Detector;
use nalgebra::{Matrix3, Vector2};
use register::{Drive, places as places_along};

use crate::gnc::{Doubtful, MAX_CHI2, Robust, reject_outliers};
use crate::graph::{Edge, covariances};
use crate::places::{carry, chain};
use crate::reference::{Reference, adjoint};
use crate::reference_fit::{Contradiction, Fitted};
use crate::solve::PLACE_STEP_M;
use crate::trusted::{nearest_scan, trusted};

/// A map that references are to place.
#[derive(Clone, Copy)]
pub struct ReferencedMap<'a> {
    /// All drives of a site.
    pub drive: &'a Drive,
    /// The drives of the map.
    pub parts: &'a [usize],
    /// The drives before this one are in the frame of the references, and stay.
    pub first_new: usize,
    /// Times of all scans \[ns\].
    pub stamps_ns: &'a [i64],
    /// Poses of all scans.
    pub poses: &'a [Pose2],
    /// The accepted closures of the site, between scans.
    pub closures: &'a [Edge],
}

/// A map in the frame of its references.
#[derive(Debug, Clone)]
pub struct Placed {
    /// Poses of all scans. Those of other maps are as before.
    pub poses: Vec<Pose2>,
    /// Covariances of x, y and heading of all scans in the frame of the references. Zero for those of other maps,
    /// and of drives that stay.
    pub covariances: Vec<Matrix3<f64>>,
    /// Each reference after that.
    pub residuals: Vec<Residual>,
    /// Factor of the stated standard deviations that explains the scatter of the references, 1 or more.
    pub scatter: f64,
    /// Standard deviation of the direction of the map as a whole \[rad\]; 0 with drives that stay.
    pub heading_std_rad: f64,
    /// Standard deviation in each direction of a single reference, with `scatter` \[m\]. Errors that all
    /// references of a drive share never average out.
    pub single_std_m: f64,
}

/// A reference compared with the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Residual {
    /// Whether it agrees with the map. Others have no influence.
    pub is_kept: bool,
    /// Distance between the measured and the estimated position \[m\].
    pub distance_m: f64,
    /// Root mean square error per direction, in stated standard deviations.
    pub n_stds: f64,
}

/// What references say about a map.
#[derive(Debug, Clone)]
pub enum Placement {
    /// They place it.
    Placed(Placed),
    /// They do not determine its direction.
    Undecided {
        /// Standard deviation of the direction \[rad\]. Infinite for a single position.
        heading_std_rad: f64,
    },
    /// They contradict the map as a whole.
    Contradicted(Contradiction),
}

/// References determine the direction of a map if its standard deviation is at most this. At 50 m from the middle
/// of the references, 5 deg are 4 m.
const MAX_HEADING_STD_DEG: f64 = 5.0;
/// The stated standard deviations are believed to be too small by this factor at most. Beyond, something else
/// is wrong.
const MAX_SCATTER: f64 = 5.0;
/// A map bends by this many times the errors of its odometry and its closures at most. The squared errors that the
/// references cause in them are compared with the number of independent values that the references measure:
/// if all errors have the right size, they are less than one per value.
const MAX_STRAIN: f64 = 3.0;
/// The 99 % quantile of the chi-square distribution with 2 degrees of freedom, -2 ln(0.01), for positions.
const MAX_CHI2_POSITION: f64 = 9.210_340_371_976_182;
/// The medians of the chi-square distribution with 2 degrees of freedom, 2 ln(2), and with 3.
const MEDIAN_CHI2: [f64; 2] = [1.386_294_361_119_890_6, 2.365_973_884_375_338];
/// How often the graph is set up again with the new headings. With the point 3 m from the lidar and a first error of
/// 0.1 rad, the second-order error 3 m * 0.1^2 / 2 is 15 mm, and vanishes the next time.
const N_LINEARIZATIONS: usize = 3;

/// Places a map by references to scans of its drives.
pub fn place_by_references(
    map: &ReferencedMap<'_>,
    references: &[Reference],
    detector: &Detector,
) -> Placement {
    let heading_std_rad = map.heading_std_rad(references, None);
    if references.is_empty() || MAX_HEADING_STD_DEG.to_radians() < heading_std_rad {
        return Placement::Undecided { heading_std_rad };
    }
    let start = match map.is_held() {
        true => map.poses.to_vec(),
        false => map.moved(map.fitted(references).best()),
    };
    let bend = Bend::new(map, &start, references, detector);
    // A first time with large errors, to measure the scatter.
    let contradicted =
        || Placement::Contradicted(map.fitted(references).contradiction(map.is_held()));
    let Some((poses, _)) = bend.robust(MAX_SCATTER) else { return contradicted() };
    let scatter = scatter(references, &poses).clamp(1.0, MAX_SCATTER);
    let Some((poses, is_kept)) = bend.robust(scatter) else { return contradicted() };
    let heading_std_rad = scatter * map.heading_std_rad(references, Some(&is_kept));
    if MAX_HEADING_STD_DEG.to_radians() < heading_std_rad {
        return Placement::Undecided { heading_std_rad };
    }
    let residual = |(reference, &is_kept): (&Reference, &bool)| {
        let chi2 = reference.chi2(&poses);
        let n_stds = (chi2 / reference.n_measured()).sqrt();
        Residual { is_kept, distance_m: reference.distance_m(&poses), n_stds }
    };
    let residuals = references.iter().zip(&is_kept).map(residual).collect();
    let mut variances: Vec<f64> = references
        .iter()
        .zip(&is_kept)
        .filter(|(_, kept)| **kept)
        .map(|(reference, _)| reference.variance_m2())
        .collect();
    variances.sort_by(f64::total_cmp);
    let single_std_m = scatter * variances[variances.len() / 2].sqrt();
    let Some(covariances) = map.covariances(&poses, references, &is_kept, scatter, detector) else {
        return Placement::Undecided { heading_std_rad };
    };
    Placement::Placed(Placed {
        poses,
        covariances,
        residuals,
        scatter,
        heading_std_rad,
        single_std_m,
    })
}

/// The factor of the stated standard deviations that explains the median error.
fn scatter(references: &[Reference], poses: &[Pose2]) -> f64 {
    let mut ratios: Vec<f64> = references
        .iter()
        .map(|reference| reference.chi2(poses) / MEDIAN_CHI2[usize::from(reference.has_heading)])
        .collect();
    ratios.sort_by(f64::total_cmp);
    ratios.get(ratios.len() / 2).map_or(1.0, |ratio| ratio.sqrt())
}

/// The vertex that references are edges from: the median of the measured positions, with the axes of their
/// frame. It is fixed to 0.1 mrad only, which is 3 cm at 300 m, and the origin can be far away.
fn frame_of(references: &[Reference]) -> Pose2 {
    let middle = |value: fn(&Reference) -> f64| {
        let mut values: Vec<f64> = references.iter().map(value).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or(0.0)
    };
    Pose2 { x_m: middle(|r| r.measured.x_m), y_m: middle(|r| r.measured.y_m), heading_rad: 0.0 }
}

/// The graph of a map and its references.
struct Bend<'a> {
    map: &'a ReferencedMap<'a>,
    /// The poses that the map has before it bends.
    start: &'a [Pose2],
    references: &'a [Reference],
    /// Vertex 0, see [`frame_of`].
    frame: Pose2,
    /// The scans that are vertices 1, 2, ...
    scans: Vec<usize>,
    /// The vertex of each reference.
    vertices: Vec<usize>,
    trusted: Vec<Edge>,
}

impl<'a> Bend<'a> {
    fn new(
        map: &'a ReferencedMap<'a>,
        start: &'a [Pose2],
        references: &'a [Reference],
        detector: &Detector,
    ) -> Self {
        let frame = frame_of(references);
        let mut scans = places_along(map.drive, PLACE_STEP_M);
        // Each drive has a vertex, whatever its keyframes.
        scans.extend(map.drive.parts().iter().map(|part| part.start));
        scans.sort_unstable();
        scans.dedup();
        scans.retain(|&scan| map.moves(scan));
        let vertex = |scan: usize| nearest_scan(map.drive, &scans, scan).map_or(0, |k| k + 1);
        let joined: Vec<[usize; 2]> = map.closures.iter().map(|edge| [edge.a, edge.b]).collect();
        let mut trusted = trusted(map.drive, start, &scans, &joined, detector);
        // Closures with drives that stay hold to the frame.
        trusted.extend(joined.iter().filter_map(|&[a, b]| {
            let moved = match [map.stays(a), map.stays(b)] {
                [true, false] => b,
                [false, true] => a,
                _ => return None,
            };
            let vertex = nearest_scan(map.drive, &scans, moved)?;
            let noise = &detector.closure;
            let (std_m, std_rad) = (noise.consistency_std_m, noise.consistency_std_rad);
            let frame_from_vertex = frame.inverse() * start[scans[vertex]];
            Some(Edge::independent(0, vertex + 1, frame_from_vertex, std_m, std_rad))
        }));
        let vertices = references.iter().map(|reference| vertex(reference.scan)).collect();
        Self { map, start, references, frame, scans, vertices, trusted }
    }

    /// The poses of all scans that agree best with the references, if their errors are `scatter` times what
    /// they state, and the references that agree with them. `None` if they do not count more than
    /// the others, or if the map bends too much.
    fn robust(&self, scatter: f64) -> Option<(Vec<Pose2>, Vec<bool>)> {
        let squared = scatter * scatter;
        let limit = |reference: &Reference| match reference.has_heading {
            true => MAX_CHI2 * squared,
            false => MAX_CHI2_POSITION * squared,
        };
        let max_chi2: Vec<f64> = self.references.iter().map(limit).collect();
        let shares: Vec<f64> =
            self.references.iter().map(|r| 1.0 / (r.n_correlated * squared)).collect();
        let mut poses = self.start.to_vec();
        let mut is_kept = vec![true; self.references.len()];
        for _ in 0..N_LINEARIZATIONS {
            let vertices = self.vertices(&poses);
            let edges: Vec<Edge> = self
                .references
                .iter()
                .zip(&self.vertices)
                .map(|(r, &vertex)| r.edge(vertex, &vertices, &poses))
                .collect();
            let (shares, max_chi2) = (shares.clone(), max_chi2.clone());
            let doubtful = Doubtful { edges: &edges, shares, max_chi2 };
            let Robust { poses: found, is_kept: kept } =
                reject_outliers(&self.trusted, &doubtful, &vertices);
            let weight = |is_kept: bool| {
                let of = self.references.iter().zip(&kept).filter(|(_, kept)| **kept == is_kept);
                of.map(|(reference, _)| 1.0 / reference.n_correlated).sum::<f64>()
            };
            if weight(true) <= weight(false) {
                return None;
            }
            poses = carry(self.map.drive, self.start, &self.scans, &found[1..]);
            is_kept = kept;
        }
        let vertices = self.vertices(&poses);
        let strain: f64 = self.trusted.iter().map(|edge| edge.chi2(&vertices)).sum();
        let kept = self.references.iter().zip(&shares).zip(&is_kept).filter(|(_, kept)| **kept);
        let n_values: f64 = kept.map(|((r, share), _)| r.n_measured() * share).sum();
        (strain <= MAX_STRAIN * MAX_STRAIN * n_values.max(1.0)).then_some((poses, is_kept))
    }

    /// The poses of the vertices: the frame, and the scans.
    fn vertices(&self, poses: &[Pose2]) -> Vec<Pose2> {
        let of_scans = self.scans.iter().map(|&scan| poses[scan]);
        [self.frame].into_iter().chain(of_scans).collect()
    }
}

impl ReferencedMap<'_> {
    fn is_in_map(&self, scan: usize) -> bool {
        self.parts.contains(&self.drive.part_of(scan))
    }

    /// Whether the pose of a scan of the map stays.
    fn stays(&self, scan: usize) -> bool {
        self.is_in_map(scan) && self.drive.part_of(scan) < self.first_new
    }

    fn moves(&self, scan: usize) -> bool {
        self.is_in_map(scan) && self.first_new <= self.drive.part_of(scan)
    }

    /// Whether a drive of the map stays.
    fn is_held(&self) -> bool {
        self.parts.iter().any(|&part| part < self.first_new)
    }

    /// The poses after the map was moved as a whole.
    fn moved(&self, map_from_before: Pose2) -> Vec<Pose2> {
        let pose = |(scan, pose): (usize, &Pose2)| match self.is_in_map(scan) {
            true => map_from_before * *pose,
            false => *pose,
        };
        self.poses.iter().enumerate().map(pose).collect()
    }

    /// Standard deviation of the direction of the map as a whole, by all references or those that are kept:
    /// positions determine it by their distances from their mean.
    fn heading_std_rad(&self, references: &[Reference], is_kept: Option<&[bool]>) -> f64 {
        if self.is_held() {
            return 0.0;
        }
        let kept = || {
            let is_kept = |k: usize| is_kept.is_none_or(|kept| kept[k]);
            references.iter().enumerate().filter(move |(k, _)| is_kept(*k)).map(|(_, r)| r)
        };
        let weight = |r: &Reference| 1.0 / (r.n_correlated * r.variance_m2());
        let point = |r: &Reference| {
            let Pose2 { x_m, y_m, .. } = r.point(self.poses);
            Vector2::new(x_m, y_m)
        };
        let sum: f64 = kept().map(weight).sum();
        let mean = kept().fold(Vector2::zeros(), |mean, r| mean + point(r) * (weight(r) / sum));
        let information = |r: &Reference| {
            let of_heading = match r.has_heading {
                true => 1.0 / (r.n_correlated * r.covariance[(2, 2)]),
                false => 0.0,
            };
            weight(r) * (point(r) - mean).norm_squared() + of_heading
        };
        1.0 / kept().map(information).sum::<f64>().sqrt()
    }

    fn fitted<'b>(&'b self, references: &'b [Reference]) -> Fitted<'b> {
        Fitted { drive: self.drive, references, poses: self.poses, stamps_ns: self.stamps_ns }
    }

    /// Covariances of all scans of the map that move, from a graph with a vertex per scan. `None` if the graph does
    /// not determine them.
    fn covariances(
        &self,
        poses: &[Pose2],
        references: &[Reference],
        is_kept: &[bool],
        scatter: f64,
        detector: &Detector,
    ) -> Option<Vec<Matrix3<f64>>> {
        let frame = frame_of(references);
        let scans: Vec<usize> = (0..poses.len()).filter(|&scan| self.moves(scan)).collect();
        let vertex = |scan: usize| scans.binary_search(&scan).map_or(0, |k| k + 1);
        let mut edges = chain(self.drive, poses, &scans, &detector.drift);
        edges.iter_mut().for_each(|edge| (edge.a, edge.b) = (edge.a + 1, edge.b + 1));
        let in_map = |edge: &&Edge| self.is_in_map(edge.a) && self.is_in_map(edge.b);
        edges.extend(self.closures.iter().filter(in_map).filter_map(|edge| {
            let (a, b) = (vertex(edge.a), vertex(edge.b));
            match (a, b) {
                (0, 0) => None,
                // The frame takes the place of a scan that stays, at the pose of the other one.
                (0, b) => {
                    Some(Edge { a: 0, b, a_from_b: frame.inverse() * poses[edge.b], ..*edge })
                }
                (a, 0) => {
                    let to_a = adjoint(&edge.a_from_b.inverse());
                    let information = to_a.transpose() * edge.information * to_a;
                    let a_from_b = frame.inverse() * poses[edge.a];
                    Some(Edge { a: 0, b: a, a_from_b, information })
                }
                (a, b) => Some(Edge { a, b, ..*edge }),
            }
        }));
        let mut vertices = vec![frame];
        vertices.extend(scans.iter().map(|&scan| poses[scan]));
        let kept = references.iter().zip(is_kept).filter(|(_, kept)| **kept);
        edges.extend(kept.map(|(reference, _)| {
            let edge = reference.edge(vertex(reference.scan), &vertices, poses);
            let share = 1.0 / (reference.n_correlated * scatter * scatter);
            Edge { information: edge.information * share, ..edge }
        }));
        let mut all = vec![Matrix3::zeros(); poses.len()];
        let found = covariances(&edges, &vertices)?;
        for (&scan, covariance) in scans.iter().zip(&found[1..]) {
            all[scan] = *covariance;
        }
        Some(all)
    }
}
