//! Which returns of joined scans come from things that stand still.

use dataset::{FULL_RING_DEG, Pose2, Scan};

use crate::points::{Motion, Points, length};
use crate::submap::{Member, sector};

/// A return moves if fewer than this share of the scans that look at its position see something there. The same
/// share makes a square of a submap occupied.
const MIN_SEEN: f64 = 0.35;
/// Something is seen at a position if the nearest return in its direction is at most this much nearer or farther
/// \[m\]: the length of a step, and the size of a person.
const SAME_M: f64 = 0.5;
/// Without a return, a scan sees this far \[m\]. A dark surface farther away may give no return.
const SEES_M: f64 = 10.0;
/// Number of directions of a scan.
const N_SECTORS: usize = 180;
/// Side of the squares that are judged as one \[m\], and their number along a side of the area. What is
/// outside of the area is not judged.
const SQUARE_M: f64 = 0.1;
const N_SQUARES: usize = 640;

/// What a scan sees: the range of the nearest return in each direction and its two neighbours.
struct View {
    scan_from_node: Motion,
    /// Infinite if there is no return. 0 if that says nothing.
    nearest_m: Vec<f64>,
}

impl View {
    fn new(member: &Member<'_>) -> Self {
        let scan = member.scan;
        let mut ranges_m = vec![f64::INFINITY; N_SECTORS];
        for p in scan.points() {
            let range = &mut ranges_m[sector(p, N_SECTORS)];
            *range = range.min(length(p));
        }
        // Without a full circle, there may have been no beam.
        let has_all_beams = FULL_RING_DEG <= scan.coverage_deg && scan.hole_deg <= 0.0;
        let nearest = |k: usize| {
            let around = [k + N_SECTORS - 1, k, k + 1].map(|k| ranges_m[k % N_SECTORS]);
            let nearest_m = around.into_iter().fold(f64::INFINITY, f64::min);
            if nearest_m.is_finite() || has_all_beams { nearest_m } else { 0.0 }
        };
        Self {
            scan_from_node: Motion::new(&member.node_from_scan.inverse()),
            nearest_m: (0..N_SECTORS).map(nearest).collect(),
        }
    }

    /// Whether the scan sees something at a position. `None` if it does not see the position.
    fn sees(&self, position_m: [f64; 2]) -> Option<bool> {
        let p = self.scan_from_node.point(position_m);
        let (nearest_m, range_m) = (self.nearest_m[sector(p, N_SECTORS)], length(p));
        match nearest_m.is_finite() {
            true => (range_m - nearest_m <= SAME_M).then_some(nearest_m - range_m <= SAME_M),
            false => (range_m <= SEES_M).then_some(false),
        }
    }
}

/// Which squares around a node have something that stands still. While a robot drives past, people leave a trail:
/// each position of it is seen by few scans. Most others see through it, to a return behind it or to no return
/// at all.
pub(crate) struct StillSquares {
    views: Vec<View>,
    /// Known answers.
    squares: Vec<Option<bool>>,
}

impl StillSquares {
    pub(crate) fn new(members: &[Member<'_>]) -> Self {
        let views = members.iter().map(View::new).collect();
        Self { views, squares: vec![None; N_SQUARES * N_SQUARES] }
    }

    /// Whether something at a position in the frame of the node stands still.
    fn is_still(&mut self, position_m: [f64; 2]) -> bool {
        let middle = N_SQUARES as f64 / 2.0;
        let [a, b] = position_m.map(|v| (v / SQUARE_M + middle).floor());
        let is_inside = |v: f64| 0.0 <= v && v < N_SQUARES as f64;
        if !is_inside(a) || !is_inside(b) {
            return true;
        }
        let k = a as usize * N_SQUARES + b as usize;
        if let Some(known) = self.squares[k] {
            return known;
        }
        let centre_m = [a, b].map(|v| (v + 0.5 - middle) * SQUARE_M);
        let (mut n_seen, mut n_looks) = (0usize, 0usize);
        for sees in self.views.iter().filter_map(|view| view.sees(centre_m)) {
            n_looks += 1;
            n_seen += usize::from(sees);
        }
        let is_still = MIN_SEEN * n_looks as f64 <= n_seen as f64;
        self.squares[k] = Some(is_still);
        is_still
    }

    /// The returns of a member that stand still.
    pub(crate) fn scan(&mut self, member: &Member<'_>) -> Scan {
        let motion = Motion::new(&member.node_from_scan);
        let mut still = Scan { x_m: Vec::new(), y_m: Vec::new(), ..*member.scan };
        for (&x, &y) in member.scan.x_m.iter().zip(&member.scan.y_m) {
            if self.is_still(motion.point([f64::from(x), f64::from(y)])) {
                still.x_m.push(x);
                still.y_m.push(y);
            }
        }
        still
    }

    /// The points of a member that stand still.
    pub(crate) fn points(&mut self, node_from_scan: &Pose2, points: &Points) -> Points {
        let motion = Motion::new(node_from_scan);
        let mut still = points.clone();
        still.retain(|p| self.is_still(motion.point(p)));
        still
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// A round room of 4 m, open towards negative y, with a person at a distance of 2 m.
    fn scan(person_rad: f64, coverage_deg: f32) -> Scan {
        let mut scan = Scan { coverage_deg, ..Scan::default() };
        for k in 0..360 {
            let angle = TAU * f64::from(k) / 360.0;
            let is_person = dataset::wrap_angle(angle - person_rad).abs() < 0.1;
            if is_person || angle < TAU / 2.0 {
                let (sin, cos) = libm::sincos(angle);
                let range_m = if is_person { 2.0 } else { 4.0 };
                scan.x_m.push((range_m * cos) as f32);
                scan.y_m.push((range_m * sin) as f32);
            }
        }
        scan
    }

    /// Number of returns of the walls and of the person, of all scans. The lidar moves 0.1 m per scan.
    fn kept(coverage_deg: f32, angles_rad: [f64; 8]) -> [usize; 2] {
        let scans = angles_rad.map(|angle| scan(angle, coverage_deg));
        let members: Vec<Member<'_>> = (0..8)
            .map(|k| {
                let x_m = 0.1 * k as f64;
                let node_from_scan = Pose2 { x_m, ..Pose2::default() };
                Member { node_from_scan, scan: &scans[k] }
            })
            .collect();
        let mut squares = StillSquares::new(&members);
        let mut n = [0, 0];
        for member in &members {
            let still = squares.scan(member);
            let limits = dataset::RangeLimits { min_m: 0.1, max_m: 25.0 };
            let points = Points::from_scan(member.scan, limits);
            assert_eq!(squares.points(&member.node_from_scan, &points).len(), still.len());
            for p in still.points() {
                n[usize::from(length(p) < 3.0)] += 1;
            }
        }
        n
    }

    /// A person has 11 returns per scan, the walls have at least 169.
    #[test]
    fn a_person_who_walks_leaves_no_trail() {
        let walks = [0.0, 0.4, 0.8, 1.2, 1.6, 2.0, 2.4, 2.8];
        let [n_walls, n_person] = kept(360.0, walks);
        assert!(n_person == 0 && n_walls >= 8 * 165, "{n_walls} {n_person}");
        let [_, n_person] = kept(360.0, [1.0; 8]);
        assert!(n_person >= 8 * 11, "{n_person}");
    }

    /// Where nothing is behind the person, a full circle without a return shows that the person has left. Less
    /// than a circle does not, because there may have been no beam.
    #[test]
    fn no_return_of_a_full_circle_sees_through() {
        let walks = [3.5, 3.9, 4.3, 4.7, 5.1, 5.5, 5.8, 6.0];
        assert_eq!(kept(360.0, walks)[1], 0);
        assert!(kept(270.0, walks)[1] >= 8 * 11);
    }
}
