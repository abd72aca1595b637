//! Walls as segments: the outline of a floor plan, and rays cast against it.

use nalgebra::{Point2, Vector2};

/// A position in the map frame \[m\].
pub type Point = Point2<f64>;
pub(crate) type Vector = Vector2<f64>;

/// The third component of the cross product of two plane vectors.
pub(crate) fn cross(a: Vector, b: Vector) -> f64 {
    a.x * b.y - a.y * b.x
}

/// A straight piece of wall, from floor to ceiling.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// One end \[m\].
    pub start: Point,
    /// The other end \[m\].
    pub end: Point,
}

impl Segment {
    /// Distance from a point to the nearest point of the segment \[m\].
    pub fn distance_m(&self, point: Point) -> f64 {
        let along = self.end - self.start;
        let share = (point - self.start).dot(&along) / along.norm_squared();
        (point - (self.start + along * share.clamp(0.0, 1.0))).norm()
    }
}

/// An axis-aligned rectangle whose sides lie on whole millimetres, so that equal means equal \[m\].
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

    /// The rectangle with every side moved outwards by `margin` \[m\].
    pub(crate) fn grown(&self, margin: f64) -> Self {
        let Self { x0, y0, x1, y1 } = *self;
        Self::new(Point::new(x0 - margin, y0 - margin), Point::new(x1 + margin, y1 + margin))
    }

    /// Whether the interiors meet.
    pub(crate) fn overlaps(&self, other: &Self) -> bool {
        self.x0 < other.x1 && other.x0 < self.x1 && self.y0 < other.y1 && other.y0 < self.y1
    }

    pub(crate) fn is_inside(&self, other: &Self) -> bool {
        other.x0 <= self.x0 && self.x1 <= other.x1 && other.y0 <= self.y0 && self.y1 <= other.y1
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

/// The outline of the free space: the union of `open` without the union of `solid`.
///
/// The sides of all rectangles cut the plane into cells; a wall stands wherever a free cell meets
/// one that is not.
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

/// The longest runs `k0..k1` along a grid line in which one and the same side is free.
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

/// Where a ray met a wall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Hit {
    /// \[m\]
    pub(crate) range_m: f64,
    /// Which of the segments.
    pub(crate) segment: usize,
}

/// Side of a grid cell \[m\].
const CELL_M: f64 = 0.5;
/// How far over its ends a segment still stops a ray, as a share of its length: rays must not
/// slip through a corner between two rounding errors.
const END_SLACK: f64 = 1e-9;

/// Segments in a uniform grid: a ray visits the cells along its way, nearest first.
#[derive(Debug, Clone)]
pub(crate) struct Walls {
    segments: Vec<Segment>,
    /// Lower left corner of the grid.
    corner: Point,
    n_x: usize,
    n_y: usize,
    /// The segments of cell `c` are `entries[starts[c]..starts[c + 1]]`.
    starts: Vec<u32>,
    entries: Vec<u32>,
}

impl Walls {
    pub(crate) fn new(segments: Vec<Segment>) -> Self {
        let ends = || segments.iter().flat_map(|s| [s.start, s.end]);
        let low = ends().fold(Point::new(f64::MAX, f64::MAX), |a, b| a.inf(&b));
        let high = ends().fold(Point::new(f64::MIN, f64::MIN), |a, b| a.sup(&b));
        let margin = Vector::new(CELL_M, CELL_M);
        let corner = low - margin;
        let size = high + margin - corner;
        let cells = |metres: f64| (metres / CELL_M).ceil().max(0.0) as usize;
        let (n_x, n_y) = (cells(size.x), cells(size.y));

        // All segments are short or parallel to an axis: the cells of their bounding box will do.
        let mut in_cell = vec![Vec::new(); n_x * n_y];
        let cell_at = |metres: f64, corner: f64| ((metres - corner) / CELL_M) as usize;
        for (k, Segment { start, end }) in segments.iter().enumerate() {
            let slack = Vector::new(1e-6, 1e-6);
            let (low, high) = (start.inf(end) - slack, start.sup(end) + slack);
            for j in cell_at(low.y, corner.y)..=cell_at(high.y, corner.y) {
                for i in cell_at(low.x, corner.x)..=cell_at(high.x, corner.x) {
                    in_cell[j * n_x + i].push(k as u32);
                }
            }
        }
        let mut starts = vec![0];
        let mut entries = Vec::new();
        for cell in in_cell {
            entries.extend(cell);
            starts.push(entries.len() as u32);
        }
        Self { segments, corner, n_x, n_y, starts, entries }
    }

    pub(crate) fn segments(&self) -> &[Segment] {
        &self.segments
    }

    /// The nearest wall from `from` along the unit vector `direction`, up to `max_m`.
    ///
    /// Amanatides and Woo (1987), "A fast voxel traversal algorithm for ray tracing".
    pub(crate) fn cast(&self, from: Point, direction: Vector, max_m: f64) -> Option<Hit> {
        let start = (from - self.corner) / CELL_M;
        let is_inside = |at: f64, n: usize| 0.0 <= at && at < n as f64;
        if !is_inside(start.x, self.n_x) || !is_inside(start.y, self.n_y) {
            return None;
        }
        let mut i = start.x as usize;
        let mut j = start.y as usize;
        // Range to the next cell border, and from border to border, for either axis.
        let borders = |at: f64, cell: usize, step: f64| {
            let period = CELL_M / step.abs();
            let share = if 0.0 < step { (cell + 1) as f64 - at } else { at - cell as f64 };
            // Parallel to the borders: never. (0 * infinity is not a number.)
            (if period.is_finite() { share * period } else { f64::INFINITY }, period)
        };
        let (mut next_x, period_x) = borders(start.x, i, direction.x);
        let (mut next_y, period_y) = borders(start.y, j, direction.y);

        let mut nearest = Hit { range_m: max_m, segment: usize::MAX };
        loop {
            let cell = j * self.n_x + i;
            for &k in &self.entries[self.starts[cell] as usize..self.starts[cell + 1] as usize] {
                if let Some(range_m) = meet(&self.segments[k as usize], from, direction)
                    && range_m < nearest.range_m
                {
                    nearest = Hit { range_m, segment: k as usize };
                }
            }
            let border = next_x.min(next_y);
            if nearest.range_m <= border {
                break;
            }
            // A step below zero wraps to a huge index: outside, like one past the end.
            if next_x < next_y {
                i = if 0.0 < direction.x { i + 1 } else { i.wrapping_sub(1) };
                next_x += period_x;
                if self.n_x <= i {
                    break;
                }
            } else {
                j = if 0.0 < direction.y { j + 1 } else { j.wrapping_sub(1) };
                next_y += period_y;
                if self.n_y <= j {
                    break;
                }
            }
        }
        (nearest.segment != usize::MAX).then_some(nearest)
    }
}

/// Range at which a ray meets a segment: from + r direction = start + u (end - start).
fn meet(segment: &Segment, from: Point, direction: Vector) -> Option<f64> {
    let along = segment.end - segment.start;
    let to_start = segment.start - from;
    let denominator = cross(direction, along);
    let u = cross(to_start, direction) / denominator;
    let range_m = cross(to_start, along) / denominator;
    // A parallel ray gives infinities or NaN, and so false.
    let is_between_ends = (-END_SLACK..=1.0 + END_SLACK).contains(&u);
    (is_between_ends && 0.0 <= range_m).then_some(range_m)
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

    /// Two rooms of 4 x 3 m, 0.2 m apart, joined by a door of 1 m: the outline is two perimeters
    /// of 14 m, less the door twice, plus its two jambs of 0.2 m.
    #[test]
    fn rooms_with_a_door_between() {
        let rooms = [rect(0.0, 0.0, 4.0, 3.0), rect(4.2, 0.0, 8.2, 3.0)];
        assert!((length_m(&outline(&rooms, &[])) - 28.0).abs() < 1e-9);
        let door = rect(4.0, 1.0, 4.2, 2.0);
        let walls = outline(&[rooms[0], rooms[1], door], &[]);
        assert!((length_m(&walls) - (28.0 - 2.0 + 0.4)).abs() < 1e-9);
        // A pillar of 0.5 x 0.5 m at a wall hides 0.5 m of it and shows three sides.
        let pillar = rect(1.0, 0.0, 1.5, 0.5);
        let walls = outline(&[rooms[0]], &[pillar]);
        assert!((length_m(&walls) - (14.0 - 0.5 + 1.5)).abs() < 1e-9);
    }

    /// In the middle of a room of 10 x 6 m: 5 m ahead, 3 m to either side, 3 sqrt(2) m diagonally,
    /// and through a door of 1 m, 2 m into the next room.
    #[test]
    fn ranges_in_a_room() {
        let room = rect(0.0, 0.0, 10.0, 6.0);
        let next = rect(10.2, 0.0, 12.2, 6.0);
        let door = rect(10.0, 2.5, 10.2, 3.5);
        let from = Point::new(5.0, 3.0);
        let range = |open: &[Rect], x: f64, y: f64, max_m| {
            let direction = Vector::new(x, y).normalize();
            Walls::new(outline(open, &[])).cast(from, direction, max_m).map(|hit| hit.range_m)
        };
        let close = |found: Option<f64>, expected: f64| {
            assert!((found.unwrap() - expected).abs() < 1e-9, "{found:?}, expected {expected}");
        };
        close(range(&[room], 1.0, 0.0, 70.0), 5.0);
        close(range(&[room], -1.0, 0.0, 70.0), 5.0);
        close(range(&[room], 0.0, 1.0, 70.0), 3.0);
        close(range(&[room], 0.0, -1.0, 70.0), 3.0);
        close(range(&[room], 1.0, 1.0, 70.0), 3.0 * 2f64.sqrt());
        close(range(&[room, next, door], 1.0, 0.0, 70.0), 7.2);
        assert_eq!(range(&[room], 1.0, 0.0, 4.99), None);
    }

    /// The grid finds what a search through all segments finds.
    #[test]
    fn the_grid_misses_no_wall() {
        let open =
            [rect(0.0, 0.0, 30.0, 2.0), rect(28.0, 0.0, 30.0, 20.0), rect(3.0, 2.0, 7.0, 5.5)];
        let mut segments = outline(&open, &[rect(12.0, 0.0, 12.4, 0.4)]);
        segments.push(Segment { start: Point::new(4.0, 3.0), end: Point::new(5.1, 4.3) });
        let walls = Walls::new(segments);
        for k in 0..2000 {
            let (sin, cos) = libm::sincos(f64::from(k) * 0.0314);
            let direction = Vector::new(cos, sin);
            for from in [Point::new(5.5, 1.0), Point::new(29.0, 1.0), Point::new(6.5, 5.0)] {
                let all = walls.segments().iter().filter_map(|s| meet(s, from, direction));
                let expected = all.fold(f64::INFINITY, f64::min);
                let found = walls.cast(from, direction, 70.0).unwrap().range_m;
                assert!((found - expected).abs() < 1e-12, "{found} {expected}");
            }
        }
    }
}
