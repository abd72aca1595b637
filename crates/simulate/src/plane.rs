//! Plane geometry: points, segments, rectangles, and the outline of a floor plan.

use nalgebra::{Point2, Vector2};

/// A position in the map frame \[m\].
pub type Point = Point2<f64>;
pub(crate) type Vector = Vector2<f64>;

/// The z component of the cross product of two plane vectors.
pub(crate) fn cross(a: Vector, b: Vector) -> f64 {
    a.x * b.y - a.y * b.x
}

/// A line segment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// One end \[m\].
    pub start: Point,
    /// The other end \[m\].
    pub end: Point,
}

impl Segment {
    /// Distance from a point to the segment \[m\].
    pub fn distance_m(&self, point: Point) -> f64 {
        let along = self.end - self.start;
        let share = (point - self.start).dot(&along) / along.norm_squared();
        (point - (self.start + along * share.clamp(0.0, 1.0))).norm()
    }
}

/// An axis-aligned rectangle \[m\]. Its sides are rounded to whole millimetres, which makes exact
/// comparisons of sides valid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Rect {
    pub(crate) x0: f64,
    pub(crate) y0: f64,
    pub(crate) x1: f64,
    pub(crate) y1: f64,
}

impl Rect {
    /// From any two opposite corners.
    pub(crate) fn new(a: Point, b: Point) -> Self {
        let mm = |metres: f64| (metres * 1000.0).round() / 1000.0;
        Self {
            x0: mm(a.x.min(b.x)),
            y0: mm(a.y.min(b.y)),
            x1: mm(a.x.max(b.x)),
            y1: mm(a.y.max(b.y)),
        }
    }

    pub(crate) fn centred(centre: Point, width: f64, height: f64) -> Self {
        let half = Vector::new(width / 2.0, height / 2.0);
        Self::new(centre - half, centre + half)
    }

    /// The rectangle enlarged by `margin` on every side \[m\].
    pub(crate) fn grown(&self, margin: f64) -> Self {
        let Self { x0, y0, x1, y1 } = *self;
        Self::new(Point::new(x0 - margin, y0 - margin), Point::new(x1 + margin, y1 + margin))
    }

    /// Whether the interiors overlap.
    pub(crate) fn overlaps(&self, other: &Self) -> bool {
        self.x0 < other.x1 && other.x0 < self.x1 && self.y0 < other.y1 && other.y0 < self.y1
    }

    pub(crate) fn is_inside(&self, other: &Self) -> bool {
        other.x0 <= self.x0 && self.x1 <= other.x1 && other.y0 <= self.y0 && self.y1 <= other.y1
    }

    pub(crate) fn contains(&self, point: Point) -> bool {
        self.x0 <= point.x && point.x <= self.x1 && self.y0 <= point.y && point.y <= self.y1
    }

    /// The corners, counter-clockwise.
    pub(crate) fn corners(&self) -> [Point; 4] {
        let Self { x0, y0, x1, y1 } = *self;
        [(x0, y0), (x1, y0), (x1, y1), (x0, y1)].map(|(x, y)| Point::new(x, y))
    }

    pub(crate) fn width(&self) -> f64 {
        self.x1 - self.x0
    }

    pub(crate) fn height(&self) -> f64 {
        self.y1 - self.y0
    }

    pub(crate) fn centre(&self) -> Point {
        Point::new((self.x0 + self.x1) / 2.0, (self.y0 + self.y1) / 2.0)
    }
}

/// The outline of the free space: the union of `open` minus the union of `solid`.
///
/// The sides of all rectangles divide the plane into cells. A wall separates each free cell from a
/// neighbour that is not free.
pub(crate) fn outline(open: &[Rect], solid: &[Rect]) -> Vec<Segment> {
    let cuts = |sides: fn(&Rect) -> [f64; 2]| {
        let mut cuts: Vec<f64> = open.iter().chain(solid).flat_map(sides).collect();
        cuts.sort_by(f64::total_cmp);
        cuts.dedup();
        cuts
    };
    let xs = cuts(|r| [r.x0, r.x1]);
    let ys = cuts(|r| [r.y0, r.y1]);

    let (n_x, n_y) = (xs.len().saturating_sub(1), ys.len().saturating_sub(1));
    let mut free = vec![false; n_x * n_y];
    for (rects, is_open) in [(open, true), (solid, false)] {
        for rect in rects {
            let (i0, i1) = (index_of(&xs, rect.x0), index_of(&xs, rect.x1));
            for j in index_of(&ys, rect.y0)..index_of(&ys, rect.y1) {
                free[j * n_x + i0..j * n_x + i1].fill(is_open);
            }
        }
    }
    let is_free = |i: usize, j: usize| i < n_x && j < n_y && free[j * n_x + i];

    let mut segments = Vec::new();
    for (i, &x) in xs.iter().enumerate() {
        let sides = |j| (0 < i && is_free(i - 1, j), is_free(i, j));
        for (j0, j1) in wall_runs(n_y, sides) {
            segments.push(Segment { start: Point::new(x, ys[j0]), end: Point::new(x, ys[j1]) });
        }
    }
    for (j, &y) in ys.iter().enumerate() {
        let sides = |i| (0 < j && is_free(i, j - 1), is_free(i, j));
        for (i0, i1) in wall_runs(n_x, sides) {
            segments.push(Segment { start: Point::new(xs[i0], y), end: Point::new(xs[i1], y) });
        }
    }
    segments
}

fn index_of(cuts: &[f64], value: f64) -> usize {
    cuts.partition_point(|&cut| cut < value)
}

/// The longest runs `k0..k1` along a grid line in which exactly one side is free, always the same.
fn wall_runs(n: usize, sides: impl Fn(usize) -> (bool, bool)) -> Vec<(usize, usize)> {
    let mut runs = Vec::new();
    let mut k0 = 0;
    while k0 < n {
        let here = sides(k0);
        let k1 = (k0 + 1..n).find(|&k| sides(k) != here).unwrap_or(n);
        if here.0 != here.1 {
            runs.push((k0, k1));
        }
        k0 = k1;
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rect(x0: f64, y0: f64, x1: f64, y1: f64) -> Rect {
        Rect::new(Point::new(x0, y0), Point::new(x1, y1))
    }

    fn length_m(segments: &[Segment]) -> f64 {
        segments.iter().map(|s| (s.end - s.start).norm()).sum()
    }

    /// Two rooms of 4 x 3 m, 0.2 m apart, joined by a door of 1 m. The outline is two perimeters of
    /// 14 m, minus twice the door, plus its two jambs of 0.2 m.
    #[test]
    fn the_outline_of_two_rooms_has_an_opening_at_the_door() {
        let rooms = [rect(0.0, 0.0, 4.0, 3.0), rect(4.2, 0.0, 8.2, 3.0)];
        assert!((length_m(&outline(&rooms, &[])) - 28.0).abs() < 1e-9);
        let door = rect(4.0, 1.0, 4.2, 2.0);
        let walls = outline(&[rooms[0], rooms[1], door], &[]);
        assert!((length_m(&walls) - (28.0 - 2.0 + 0.4)).abs() < 1e-9);
        // A pillar of 0.5 x 0.5 m at a wall hides 0.5 m of the wall and adds three sides.
        let pillar = rect(1.0, 0.0, 1.5, 0.5);
        let walls = outline(&[rooms[0]], &[pillar]);
        assert!((length_m(&walls) - (14.0 - 0.5 + 1.5)).abs() < 1e-9);
    }
}
