//! The world on one day: vertical surfaces between a level floor and level ceilings, with ray
//! casting.
//!
//! Rays are cast in two steps. [`World::column`] follows a bearing on the floor plan and lists the
//! surfaces that any beam could hit in that direction. Each beam is then intersected with these
//! surfaces exactly, in three dimensions. All lasers with the same bearing share one column.

use nalgebra::{Point2, Vector2};

use crate::plane::{Point, Rect, Segment, Vector, cross};

/// Material of a surface. It determines how the surface reflects a beam.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Material {
    /// Plaster, brick, wood, cloth: returns every beam, scaled by the reflectivity.
    Solid,
    /// A pane of glass: most beams pass through it and hit what is behind.
    Glass,
    /// Leaves and twigs: some beams pass, the others end inside.
    Foliage,
}

/// A vertical rectangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surface {
    /// Its position on the floor plan.
    pub segment: Segment,
    /// Lower edge \[m above the floor\].
    pub z_low_m: f64,
    /// Upper edge \[m above the floor\].
    pub z_high_m: f64,
    /// Its material.
    pub material: Material,
    /// Reflectivity, 0 to 1.
    pub reflectivity: f64,
    /// Heights of the ceilings to the left and to the right of the segment, seen from its start, if
    /// they differ \[m\].
    pub(crate) ceilings_m: Option<(f64, f64)>,
}

impl Surface {
    /// A solid surface from `z.0` to `z.1` \[m above the floor\].
    pub(crate) fn solid(segment: Segment, z: (f64, f64), reflectivity: f64) -> Self {
        Self {
            segment,
            z_low_m: z.0,
            z_high_m: z.1,
            material: Material::Solid,
            reflectivity,
            ceilings_m: None,
        }
    }

    /// Whether it stops every beam.
    fn is_opaque(&self) -> bool {
        self.material == Material::Solid
    }
}

/// Vertical surfaces along the sides of a polygon, from `z.0` to `z.1` \[m above the floor\].
pub(crate) fn prism(corners: &[Point], z: (f64, f64), reflectivity: f64) -> Vec<Surface> {
    let next = corners.iter().cycle().skip(1);
    (corners.iter().zip(next))
        .map(|(&start, &end)| Surface::solid(Segment { start, end }, z, reflectivity))
        .collect()
}

/// A surface in a column.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Entry {
    /// Horizontal distance \[m\].
    pub(crate) distance_m: f64,
    /// Index of the surface.
    pub(crate) surface: u32,
}

/// Side of a grid cell \[m\].
const CELL_M: f64 = 1.0;
/// How far beyond its ends a surface still stops a ray, relative to its length. Without this,
/// rounding errors let rays pass through corners.
const END_SLACK: f64 = 1e-9;
/// Hits nearer than this to the border between two cells count in both cells \[m\].
const BORDER_SLACK_M: f64 = 1e-6;

/// Surfaces in a uniform grid. A ray visits the cells along its path, nearest first.
#[derive(Debug, Clone)]
pub(crate) struct World {
    surfaces: Vec<Surface>,
    /// Rectangles with a ceiling and its height \[m\]. Later rectangles take precedence. There is no
    /// ceiling elsewhere.
    ceilings: Vec<(Rect, f64)>,
    /// Lower left corner of the grid.
    corner: Point,
    n_x: usize,
    n_y: usize,
    /// The surfaces of cell `c` are `entries[starts[c]..starts[c + 1]]`.
    starts: Vec<u32>,
    entries: Vec<u32>,
}

impl World {
    pub(crate) fn new(surfaces: Vec<Surface>, ceilings: Vec<(Rect, f64)>) -> Self {
        let ends = || surfaces.iter().flat_map(|s| [s.segment.start, s.segment.end]);
        let low = ends().fold(Point::new(f64::MAX, f64::MAX), |a, b| a.inf(&b));
        let high = ends().fold(Point::new(f64::MIN, f64::MIN), |a, b| a.sup(&b));
        let margin = Vector::new(CELL_M, CELL_M);
        let corner = low - margin;
        let size = high + margin - corner;
        let cells = |metres: f64| (metres / CELL_M).ceil().max(0.0) as usize;
        let (n_x, n_y) = (cells(size.x), cells(size.y));

        // All surfaces are short or parallel to an axis, so the cells of the bounding box suffice.
        let mut in_cell = vec![Vec::new(); n_x * n_y];
        let cell_at = |metres: f64, corner: f64| ((metres - corner) / CELL_M) as usize;
        for (k, surface) in surfaces.iter().enumerate() {
            let Segment { start, end } = surface.segment;
            let slack = Vector::new(BORDER_SLACK_M, BORDER_SLACK_M);
            let (low, high) = (start.inf(&end) - slack, start.sup(&end) + slack);
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
        Self { surfaces, ceilings, corner, n_x, n_y, starts, entries }
    }

    pub(crate) fn surfaces(&self) -> &[Surface] {
        &self.surfaces
    }

    /// Height of the ceiling above a position; infinite outdoors \[m\].
    pub(crate) fn ceiling_m(&self, at: Point) -> f64 {
        let over = self.ceilings.iter().rev().find(|(rect, _)| rect.contains(at));
        over.map_or(f64::INFINITY, |(_, height_m)| *height_m)
    }

    /// Appends the surfaces that beams from `from` at `height_m` can hit, nearest first. The beams
    /// point along the unit vector `direction`, reach `max_m`, and rise at most by the tangent
    /// `steepest`.
    ///
    /// The traversal follows Amanatides and Woo (1987), "A fast voxel traversal algorithm for ray
    /// tracing".
    pub(crate) fn column(
        &self,
        (from, height_m): (Point, f64),
        direction: Vector,
        (max_m, steepest): (f64, f64),
        column: &mut Vec<Entry>,
    ) {
        let start = (from - self.corner) / CELL_M;
        let is_inside = |at: f64, n: usize| 0.0 <= at && at < n as f64;
        if !is_inside(start.x, self.n_x) || !is_inside(start.y, self.n_y) {
            return;
        }
        let mut i = start.x as usize;
        let mut j = start.y as usize;
        // Distance to the next cell border, and from border to border, along each axis.
        let borders = |at: f64, cell: usize, step: f64| {
            let period = CELL_M / step.abs();
            let share = if 0.0 < step { (cell + 1) as f64 - at } else { at - cell as f64 };
            // A ray parallel to the borders never reaches one. (0 * infinity is NaN.)
            (if period.is_finite() { share * period } else { f64::INFINITY }, period)
        };
        let (mut next_x, period_x) = borders(start.x, i, direction.x);
        let (mut next_y, period_y) = borders(start.y, j, direction.y);

        let mut ceiling_m = self.ceiling_m(from);
        let mut entered_m = 0.0;
        let n_start = column.len();
        loop {
            let left_m = next_x.min(next_y);
            let cell = j * self.n_x + i;
            let n_before = column.len();
            for &k in &self.entries[self.starts[cell] as usize..self.starts[cell + 1] as usize] {
                let hit = intersect(&self.surfaces[k as usize].segment, from, direction);
                if let Some(distance_m) = hit
                    && entered_m - BORDER_SLACK_M <= distance_m
                    && distance_m <= left_m + BORDER_SLACK_M
                    // A surface hit at a border is in both cells: add it once.
                    && column[n_start..].iter().rev().take(4).all(|entry| entry.surface != k)
                {
                    column.push(Entry { distance_m, surface: k });
                }
            }
            if n_before < column.len() {
                column[n_before..].sort_by(|a, b| a.distance_m.total_cmp(&b.distance_m));
                for at in n_before..column.len() {
                    let Entry { distance_m, surface } = column[at];
                    let surface = &self.surfaces[surface as usize];
                    let top_m = ceiling_m.min(height_m + distance_m * steepest);
                    if surface.is_opaque() && surface.z_low_m <= 0.0 && top_m <= surface.z_high_m {
                        // Keep other surfaces at the same corner for neighbouring beams.
                        column.truncate(at + 1);
                        return;
                    }
                    if let Some(ceilings_m) = surface.ceilings_m {
                        ceiling_m = ceiling_behind(&surface.segment, direction, ceilings_m);
                    }
                }
            }
            if max_m <= left_m {
                return;
            }
            entered_m = left_m;
            // Index -1 wraps to a huge index, which is outside.
            if next_x < next_y {
                i = if 0.0 < direction.x { i + 1 } else { i.wrapping_sub(1) };
                next_x += period_x;
                if self.n_x <= i {
                    return;
                }
            } else {
                j = if 0.0 < direction.y { j + 1 } else { j.wrapping_sub(1) };
                next_y += period_y;
                if self.n_y <= j {
                    return;
                }
            }
        }
    }
}

/// Height of the ceiling behind a surface, given the ceilings to its left and right \[m\].
pub(crate) fn ceiling_behind(
    segment: &Segment,
    direction: Vector,
    (left, right): (f64, f64),
) -> f64 {
    match 0.0 < cross(segment.end - segment.start, direction) {
        true => left,
        false => right,
    }
}

/// Range at which a ray hits a segment: from + range direction = start + u (end - start).
#[inline]
pub(crate) fn intersect(
    segment: &Segment,
    from: Point2<f64>,
    direction: Vector2<f64>,
) -> Option<f64> {
    let along = segment.end - segment.start;
    let to_start = segment.start - from;
    let denominator = cross(direction, along);
    let u = cross(to_start, direction) / denominator;
    let range_m = cross(to_start, along) / denominator;
    // A parallel ray gives infinities or NaN, and the comparisons are false.
    let is_between_ends = (-END_SLACK..=1.0 + END_SLACK).contains(&u);
    (is_between_ends && 0.0 <= range_m).then_some(range_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plane::outline;

    fn rect(x0: f64, y0: f64, x1: f64, y1: f64) -> Rect {
        Rect::new(Point::new(x0, y0), Point::new(x1, y1))
    }

    fn walls(open: &[Rect], high_m: f64) -> Vec<Surface> {
        let wall = |segment| Surface::solid(segment, (0.0, high_m), 0.5);
        outline(open, &[]).into_iter().map(wall).collect()
    }

    /// Horizontal distances of the entries of a column.
    fn distances(world: &World, from: Point, bearing: f64, max_m: f64) -> Vec<f64> {
        let (sin, cos) = libm::sincos(bearing);
        let mut column = Vec::new();
        world.column((from, 0.8), Vector::new(cos, sin), (max_m, 0.2), &mut column);
        column.iter().map(|entry| entry.distance_m).collect()
    }

    /// From the middle of a room of 10 x 6 m with a table 2 m ahead: front of the table, back of the
    /// table, wall. The room behind the wall is not in the column.
    #[test]
    fn a_column_lists_low_surfaces_and_ends_at_a_wall() {
        let mut surfaces = walls(&[rect(0.0, 0.0, 10.0, 6.0), rect(10.2, 0.0, 15.0, 6.0)], 2.7);
        surfaces.extend(prism(&rect(7.0, 2.0, 8.0, 4.0).corners(), (0.0, 0.7), 0.5));
        let world = World::new(surfaces, vec![(rect(0.0, 0.0, 15.0, 6.0), 2.7)]);
        let from = Point::new(5.0, 3.0);
        let close = |found: Vec<f64>, expected: &[f64]| {
            assert_eq!(found.len(), expected.len(), "{found:?}");
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}");
        };
        close(distances(&world, from, 0.0, 70.0), &[2.0, 3.0, 5.0]);
        close(distances(&world, from, std::f64::consts::PI, 70.0), &[5.0]);
        // Without a ceiling, beams can pass over the walls.
        let world = World::new(world.surfaces().to_vec(), Vec::new());
        assert_eq!(distances(&world, from, 0.0, 70.0).len(), 3);
        let low = World::new(walls(&[rect(0.0, 0.0, 10.0, 6.0)], 0.85), Vec::new());
        close(distances(&low, Point::new(-0.5, 3.0), 0.0, 70.0), &[0.5, 10.5]);
    }

    #[test]
    fn the_grid_finds_the_same_wall_as_a_search_of_all_surfaces() {
        let open =
            [rect(0.0, 0.0, 30.0, 2.0), rect(28.0, 0.0, 30.0, 20.0), rect(3.0, 2.0, 7.0, 5.5)];
        let mut surfaces = walls(&open, 9.0);
        let slanted = Segment { start: Point::new(4.0, 3.0), end: Point::new(5.1, 4.3) };
        surfaces.push(Surface::solid(slanted, (0.0, 9.0), 0.5));
        let world = World::new(surfaces, vec![(rect(0.0, 0.0, 30.0, 20.0), 9.0)]);
        for k in 0..2000 {
            let bearing = f64::from(k) * 0.0314;
            let (sin, cos) = libm::sincos(bearing);
            for from in [Point::new(5.5, 1.0), Point::new(29.0, 1.0), Point::new(6.5, 5.0)] {
                let all = world.surfaces().iter();
                let ranges = all.filter_map(|s| intersect(&s.segment, from, Vector::new(cos, sin)));
                let expected = ranges.fold(f64::INFINITY, f64::min);
                let found = distances(&world, from, bearing, 70.0)[0];
                assert!((found - expected).abs() < 1e-12, "{found} {expected}");
            }
        }
    }
}
