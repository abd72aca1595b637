//! The route of a drive: control points for a smooth path.

use std::f64::consts::TAU;

use crate::plane::{Point, Vector};
use crate::random::Random;

/// Nodes (column, row) of the loops in a single building. A drive follows them one after the other,
/// forever. All loops share the corner (0, 0) and the corridors next to it, and each loop therefore
/// revisits parts of the earlier ones. The order is counter-clockwise; every second drive reverses it.
const LOOPS: [&[(usize, usize)]; 4] = [
    &[(0, 0), (1, 0), (1, 1), (0, 1)],
    &[(0, 0), (1, 0), (1, 1), (1, 2), (0, 2), (0, 1)],
    &[(0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1)],
    &[(0, 0), (1, 0), (2, 0), (2, 1), (1, 1), (0, 1)],
];
/// Approximate distance between control points \[m\].
///
/// At a right-angled corner, control points at half this distance before and after the corner give a
/// smallest radius of spacing / sqrt(2) = 1.3 m and cut the corner by 0.383 x spacing = 0.7 m. That
/// is 0.6 m from the inner corner of two corridors 1.8 m wide.
const SPACING_M: f64 = 1.8;
/// The robot sways about the middle of its route. Two waves: amplitude \[m\], and minimum and maximum
/// wavelength \[m\].
const SWAY: [(f64, (f64, f64)); 2] = [(0.12, (18.0, 30.0)), (0.08, (7.0, 12.0))];
/// Number of control points after the dock over which the sway grows to its full amplitude.
const SWAY_RAMP_POINTS: f64 = 10.0;

/// Control points of an endless route, each with the direction to its left.
#[derive(Debug, Clone)]
pub(crate) struct Route {
    /// Followed once, at the start.
    lead: Vec<(Point, Vector)>,
    /// Repeated forever.
    lap: Vec<(Point, Vector)>,
    waves: [Wave; 2],
    /// Whether the route starts exactly at the dock, without sway.
    has_dock: bool,
}

/// A sine along the control points.
#[derive(Debug, Clone, Copy)]
struct Wave {
    amplitude_m: f64,
    /// \[rad per control point\]
    rate: f64,
    /// \[rad\]
    phase: f64,
}

impl Route {
    /// A route around the loops of a single building, from a random place in the first corridor.
    pub(crate) fn in_building(
        nodes: &[Vec<Point>],
        is_clockwise: bool,
        random: &mut Random,
    ) -> Self {
        let order = if is_clockwise { [0, 3, 2, 1] } else { [0, 1, 2, 3] };
        let lap: Vec<Point> = order
            .into_iter()
            .flat_map(|k| {
                let mut nodes = LOOPS[k].to_vec();
                if is_clockwise {
                    nodes[1..].reverse();
                }
                nodes
            })
            .map(|(column, row)| nodes[column][row])
            .collect();
        let mut lap = closed(&lap);
        // Both corridors that a drive can start in are longer than this.
        let start = random.index(lap.len() / 32);
        lap.rotate_left(start);
        Self { lead: Vec::new(), lap, waves: draw_waves(random), has_dock: false }
    }

    /// A route from the dock at the origin, `dock_m` along x to the junction between the last and the
    /// first node of a lap, and then around the lap.
    pub(crate) fn from_dock(dock_m: f64, lap: &[Point], random: &mut Random) -> Self {
        let junction = Point::new(dock_m, 0.0);
        // A spline starts at its second control point if the first three are in line and equidistant.
        let before = Point::new(-1.5 * SPACING_M, 0.0);
        let mut lead = edge(before, junction);
        lead.extend(edge(junction, lap[0]));
        let mut nodes = lap.to_vec();
        nodes.push(junction);
        // The lap starts where the lead ends, after the junction.
        let points = closed(&nodes);
        Self { lead, lap: points, waves: draw_waves(random), has_dock: true }
    }

    /// A closed route along points that are close to each other, shifted by `right_m` to the right.
    pub(crate) fn along(points: &[Point], spacing_m: f64, right_m: f64) -> Self {
        let still = Wave { amplitude_m: 0.0, rate: 0.0, phase: 0.0 };
        let smooth = smoothed(&thinned(points, spacing_m / 4.0), 4);
        let even = thinned(&smooth, spacing_m);
        let lap = (0..even.len())
            .map(|k| {
                let (before, after) =
                    (even[(k + even.len() - 1) % even.len()], even[(k + 1) % even.len()]);
                let direction = after - before;
                let left = match direction.norm() {
                    0.0 => Vector::zeros(),
                    norm => Vector::new(-direction.y, direction.x) / norm,
                };
                (even[k] - left * right_m, left)
            })
            .collect();
        Self { lead: Vec::new(), lap, waves: [still; 2], has_dock: false }
    }

    /// Control point number `k`.
    pub(crate) fn control_point(&self, k: usize) -> Point {
        let (middle, left) = match self.lead.get(k) {
            Some(point) => *point,
            None => self.lap[(k - self.lead.len()) % self.lap.len()],
        };
        let k = k as f64;
        let ramp = if self.has_dock { ((k - 2.0) / SWAY_RAMP_POINTS).clamp(0.0, 1.0) } else { 1.0 };
        let wave = |w: &Wave| w.amplitude_m * libm::sin(w.rate * k + w.phase);
        middle + left * (ramp * self.waves.iter().map(wave).sum::<f64>())
    }
}

fn draw_waves(random: &mut Random) -> [Wave; 2] {
    SWAY.map(|(amplitude_m, (low, high))| Wave {
        amplitude_m,
        rate: TAU * SPACING_M / random.uniform(low, high),
        phase: random.uniform(0.0, TAU),
    })
}

/// Control points from node to node and back to the first node.
fn closed(nodes: &[Point]) -> Vec<(Point, Vector)> {
    closed_every(nodes, SPACING_M)
}

fn closed_every(nodes: &[Point], spacing_m: f64) -> Vec<(Point, Vector)> {
    let next = nodes.iter().cycle().skip(1);
    nodes.iter().zip(next).flat_map(|(&a, &b)| edge_every(a, b, spacing_m)).collect()
}

/// Control points between two nodes, without the nodes.
fn edge(a: Point, b: Point) -> Vec<(Point, Vector)> {
    edge_every(a, b, SPACING_M)
}

fn edge_every(a: Point, b: Point, spacing_m: f64) -> Vec<(Point, Vector)> {
    let edge = b - a;
    let forward = edge.normalize();
    let n = (edge.norm() / spacing_m).round().max(1.0) as usize;
    (0..n)
        .map(|k| {
            let share = (k as f64 + 0.5) / n as f64;
            (a + edge * share, Vector::new(-forward.y, forward.x))
        })
        .collect()
}

/// The points without those nearer than `spacing_m` to the last one kept.
fn thinned(points: &[Point], spacing_m: f64) -> Vec<Point> {
    let mut thin: Vec<Point> = Vec::new();
    for point in points {
        if thin.last().is_none_or(|last| spacing_m <= (point - last).norm()) {
            thin.push(*point);
        }
    }
    thin
}

/// Moving average of a closed route over `reach` points on each side.
fn smoothed(points: &[Point], reach: usize) -> Vec<Point> {
    let n = points.len();
    (0..n)
        .map(|k| {
            let around = (0..=2 * reach).map(|d| points[(k + n * reach + d - reach) % n].coords);
            Point::from(around.sum::<Vector>() / (2 * reach + 1) as f64)
        })
        .collect()
}
