//! The map as an image for `map_server`.

use dataset::Pose2;
use rayon::prelude::*;
use register::{Member, Square, Submap, SubmapOptions};

use crate::error::ViewError;
use crate::placed::PlacedScan;

/// Side of a square \[m\].
const SQUARE_M: f64 = 0.05;
/// Returns farther than this are not used \[m\].
const MAX_RANGE_M: f64 = 20.0;
/// The space of a ray is free up to this distance before its return \[m\]: two squares, for the noise of
/// the range and of the pose.
const FREE_MARGIN_M: f64 = 0.1;
/// Unknown space around the map \[m\].
const BORDER_M: f64 = 1.0;
/// Squares per side of a tile. The map is computed in tiles, so that memory does not grow with the counts
/// of all squares.
const TILE_SQUARES: usize = 512;
/// The largest map: 1 km x 1 km.
const MAX_SQUARES: f64 = 4e8;

/// Pixels as `map_saver` of ROS writes them.
const OCCUPIED: u8 = 0;
const FREE: u8 = 254;
const UNKNOWN: u8 = 205;

/// A map of occupied, free and unknown squares.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    /// Position of the lower left corner \[m\].
    origin_m: [f64; 2],
    width: usize,
    /// Row by row from the top, which is the largest y.
    pixels: Vec<u8>,
}

impl Grid {
    /// Joins scans of one map. See [`Submap::new`] for the rule that decides what is occupied.
    pub fn new(scans: &[PlacedScan<'_>]) -> Result<Self, ViewError> {
        let (low_m, high_m) = bounds_m(scans).ok_or(ViewError::EmptyMap)?;
        // Squares of all maps lie on the same lattice.
        let origin_m = low_m.map(|v| ((v - BORDER_M) / SQUARE_M).floor() * SQUARE_M);
        let size =
            [0, 1].map(|k| ((high_m[k] + BORDER_M - origin_m[k]) / SQUARE_M).ceil().max(1.0));
        if MAX_SQUARES < size[0] * size[1] {
            return Err(ViewError::MapTooLarge {
                width_m: size[0] * SQUARE_M,
                height_m: size[1] * SQUARE_M,
                max_squares: MAX_SQUARES,
                square_m: SQUARE_M,
            });
        }
        let [width, height] = size.map(|n| n as usize);
        let mut grid = Self { origin_m, width, pixels: vec![UNKNOWN; width * height] };
        let [n_x, n_y] = [width, height].map(|n| n.div_ceil(TILE_SQUARES));
        let tiles: Vec<Vec<Square>> = (0..n_x * n_y)
            .into_par_iter()
            .map(|k| tile(scans, origin_m, k / n_y, k % n_y))
            .collect();
        for (k, squares) in tiles.iter().enumerate() {
            let first = [k / n_y * TILE_SQUARES, k % n_y * TILE_SQUARES];
            for (square, &kind) in squares.iter().enumerate() {
                let x = first[0] + square / TILE_SQUARES;
                let y = first[1] + square % TILE_SQUARES;
                if x < width && y < height {
                    grid.pixels[(height - 1 - y) * width + x] = pixel(kind);
                }
            }
        }
        Ok(grid)
    }

    /// The centres of the occupied squares \[m\].
    pub fn occupied_m(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        let occupied = self.pixels.iter().enumerate().filter(|(_, pixel)| **pixel == OCCUPIED);
        occupied.map(|(k, _)| {
            let (x, y) = (k % self.width, self.height() - 1 - k / self.width);
            [(x, 0), (y, 1)].map(|(v, axis)| self.origin_m[axis] + (v as f64 + 0.5) * SQUARE_M)
        })
    }

    /// The image as a PNG file: one pixel per square, occupied black, free white, unknown grey.
    pub fn png(&self) -> Result<Vec<u8>, ViewError> {
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, self.width as u32, self.height() as u32);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.pixels)?;
        writer.finish()?;
        Ok(file)
    }

    /// The description that `map_server` loads. `image` is the path of the PNG file from the description.
    ///
    /// The thresholds are those of `map_saver`: an unknown pixel, 205, has the occupancy
    /// (255 - 205) / 255 = 0.1961, which is just above the threshold of free space.
    pub fn yaml(&self, image: &str) -> String {
        let [x_m, y_m] = self.origin_m;
        format!(
            "image: {image}\nmode: trinary\nresolution: {SQUARE_M}\norigin: [{x_m:.3}, {y_m:.3}, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
        )
    }

    fn height(&self) -> usize {
        self.pixels.len() / self.width
    }
}

fn pixel(square: Square) -> u8 {
    match square {
        Square::Occupied => OCCUPIED,
        Square::Free => FREE,
        Square::Unknown => UNKNOWN,
    }
}

/// The smallest rectangle that contains all returns in range and all poses. `None` without returns.
fn bounds_m(scans: &[PlacedScan<'_>]) -> Option<([f64; 2], [f64; 2])> {
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    let mut n_returns = 0_usize;
    let mut add = |p: [f64; 2]| {
        for k in 0..2 {
            (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k]));
        }
    };
    for PlacedScan { pose, scan, .. } in scans {
        let (sin, cos) = libm::sincos(pose.heading_rad);
        add([pose.x_m, pose.y_m]);
        for [x, y] in scan.points().filter(|[x, y]| x * x + y * y < MAX_RANGE_M * MAX_RANGE_M) {
            add([pose.x_m + cos * x - sin * y, pose.y_m + sin * x + cos * y]);
            n_returns += 1;
        }
    }
    (0 < n_returns).then_some((low, high))
}

/// The squares of a tile, row-major, x first, `(TILE_SQUARES, TILE_SQUARES)`.
fn tile(scans: &[PlacedScan<'_>], origin_m: [f64; 2], x: usize, y: usize) -> Vec<Square> {
    // One more square on each side: whether a square is free depends on its neighbours.
    let n = TILE_SQUARES + 2;
    let side_m = TILE_SQUARES as f64 * SQUARE_M;
    let centre = |origin_m: f64, k: usize| origin_m + (k as f64 + 0.5) * side_m;
    let (x_m, y_m) = (centre(origin_m[0], x), centre(origin_m[1], y));
    let tile_from_map = Pose2 { x_m, y_m, heading_rad: 0.0 }.inverse();
    let reach_m = side_m / 2.0 + SQUARE_M + MAX_RANGE_M;
    let is_near =
        |pose: &Pose2| (pose.x_m - x_m).abs() <= reach_m && (pose.y_m - y_m).abs() <= reach_m;
    let members: Vec<Member<'_>> = scans
        .iter()
        .filter(|placed| is_near(&placed.pose))
        .map(|placed| Member { node_from_scan: tile_from_map * placed.pose, scan: placed.scan })
        .collect();
    let options = SubmapOptions {
        square_m: SQUARE_M,
        n_squares: n as u32,
        max_range_m: MAX_RANGE_M,
        free_margin_m: FREE_MARGIN_M,
        ..SubmapOptions::default()
    };
    let submap = Submap::new(&members, &options);
    let squares: Vec<Square> = submap.squares().collect();
    let rows = squares.chunks(n).skip(1).take(TILE_SQUARES);
    rows.flat_map(|row| &row[1..=TILE_SQUARES]).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use dataset::Scan;

    /// A scan in a room with walls at x = -3, x = 3, y = -2 and y = 2, seen from (x, 0).
    fn room(x_m: f64) -> Scan {
        let mut scan = Scan { coverage_deg: 360.0, ..Scan::default() };
        for k in 0..720 {
            let (sin, cos) = (f64::from(k) / 2.0).to_radians().sin_cos();
            let to_x = if cos > 0.0 { (3.0 - x_m) / cos } else { (-3.0 - x_m) / cos };
            let to_y = if sin > 0.0 { 2.0 / sin } else { -2.0 / sin };
            let range_m = to_x.min(to_y);
            scan.x_m.push((range_m * cos) as f32);
            scan.y_m.push((range_m * sin) as f32);
        }
        scan
    }

    fn at(x_m: f64, y_m: f64) -> Pose2 {
        Pose2 { x_m, y_m, heading_rad: 0.0 }
    }

    /// Two rooms, 40 m apart: the second one is in another tile.
    #[test]
    fn walls_are_black_rooms_are_white_and_the_rest_is_unknown() {
        let scan = room(0.0);
        let placed = [at(0.0, 0.0), at(40.0, 1.0)];
        let placed = placed.map(|pose| PlacedScan { stamp_ns: 0, pose, scan: &scan });
        let grid = Grid::new(&placed).unwrap();
        // The rooms reach from -3 m to 43 m and from -2 m to 3 m, with a border of 1 m. Walls on the
        // edge of a square count as one or the other.
        assert!(grid.width.abs_diff(48 * 20) <= 1 && grid.height().abs_diff(7 * 20) <= 1);
        let mut n = 0;
        for [x, y] in grid.occupied_m() {
            let (x, y) = if x < 20.0 { (x, y) } else { (x - 40.0, y - 1.0) };
            let to_wall_m = (x.abs() - 3.0).abs().min((y.abs() - 2.0).abs());
            assert!(to_wall_m <= 0.051, "({x}, {y})");
            n += 1;
        }
        // The walls of a room are 20 m long: 400 squares, of which distant ones have no return.
        assert!((500..=800).contains(&n), "{n}");
        let pixel = |[x, y]: [f64; 2]| {
            let column = ((x - grid.origin_m[0]) / SQUARE_M) as usize;
            let row = grid.height() - 1 - ((y - grid.origin_m[1]) / SQUARE_M) as usize;
            grid.pixels[row * grid.width + column]
        };
        for room in [[0.0, 0.0], [40.0, 1.0], [41.5, 2.0]] {
            assert_eq!(pixel(room), FREE);
        }
        assert_eq!(pixel([20.0, 0.0]), UNKNOWN);
        assert!(grid.yaml("a.png").contains("\norigin: [-4.0"), "{}", grid.yaml("a.png"));
    }

    #[test]
    fn the_png_contains_the_pixels() {
        let scan = room(0.5);
        let grid =
            Grid::new(&[PlacedScan { stamp_ns: 0, pose: at(0.0, 0.0), scan: &scan }]).unwrap();
        let png = grid.png().unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(&png)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        assert_eq!((info.width as usize, info.height as usize), (grid.width, grid.height()));
        assert_eq!(pixels, grid.pixels);
    }

    #[test]
    fn a_map_that_is_empty_or_too_large_is_an_error() {
        assert!(matches!(Grid::new(&[]), Err(ViewError::EmptyMap)));
        let scan = room(0.0);
        let far = [at(0.0, 0.0), at(1e4, 1e4)];
        let far = far.map(|pose| PlacedScan { stamp_ns: 0, pose, scan: &scan });
        let error = Grid::new(&far).unwrap_err().to_string();
        assert!(error.contains("10008 m x 10006 m"), "{error}");
    }
}
