//! The candidate order of keyframes, and a tree of boxes over it.
//!
//! Keyframes are sorted by their square of ground: squares with fewer keyframes first, as
//! [`Squares::of_pair`] compares them. Within a square, a k-d tree (Bentley, "Multidimensional binary
//! search trees used for associative searching", 1975) halves the keyframes at the median of their
//! wider side. Every square and every node of its tree is therefore one range of the order:
//!
//! ```text
//! order    | small square | small square |          large square          |
//! nodes    |    leaf      |     leaf     |   leaf   |   leaf   |   leaf   |
//! ```
//!
//! A pair belongs to the later of its two keyframes. That is also the square that it counts for, so
//! that the candidates of a square are one range too.
//!
//! The order depends on positions and names alone, not on the order of the logs.

use std::collections::BTreeMap;
use std::ops::Range;

use dataset::{Keyframe, Squares};

use crate::rules::Rules;

/// Largest number of keyframes in a node without halves. Pairs of such nodes are compared one by one.
const LEAF: usize = 32;

/// Keyframes in candidate order: a row is a keyframe's number in this order.
pub(crate) struct Tree {
    /// The keyframe of each row, `(n_keyframes,)`.
    pub(crate) keyframes: Vec<u32>,
    /// Positions in this order \[m\], `(n_keyframes,)`.
    pub(crate) xs_m: Vec<f64>,
    pub(crate) ys_m: Vec<f64>,
    /// The squares in their order.
    pub(crate) squares: Vec<Square>,
    nodes: Vec<Node>,
    /// Squares by frame and bucket.
    buckets: BTreeMap<(u32, i64, i64), Vec<u32>>,
    bucket_m: f64,
}

/// A square of ground with its keyframes.
pub(crate) struct Square {
    pub(crate) root: Node,
    pub(crate) frame: u32,
    /// The site of all its keyframes, by number. `None` if they have several: keyframes in the map of a run.
    pub(crate) site: Option<u32>,
}

/// A range of the order, and the box around its positions.
#[derive(Clone, Copy)]
pub(crate) struct Node {
    start: u32,
    end: u32,
    /// Least and largest x and y \[m\].
    low_m: [f64; 2],
    high_m: [f64; 2],
    /// The nodes of both halves.
    halves: Option<[u32; 2]>,
}

/// The number of a keyframe of a square in order of names, and its position \[m\].
type Point = (usize, [f64; 2]);

impl Tree {
    /// The order of the keyframes of some rules.
    pub(crate) fn new(rules: &Rules<'_>, keyframes: &[Keyframe]) -> Self {
        let (options, rows) = (rules.options(), rules.rows());
        let (width_m, layer_m) = (options.place_m, options.max_height_difference_m);
        let frames: Vec<u32> = rows.iter().map(|row| row.frame).collect();
        let squares = Squares::new(keyframes, &frames, width_m, layer_m);
        // A pair that is not negative is within this distance. The uncertainty of a distance has no limit.
        let reach_m = if rules.is_exact() { options.negative_min_m } else { f64::INFINITY };
        let square_of = |k: u32| {
            let square = squares.of_keyframes[k as usize];
            (squares.sizes[square as usize], square)
        };
        let mut order: Vec<u32> = (0..rows.len() as u32).collect();
        order.sort_by_key(|&k| (rows[k as usize].log, keyframes[k as usize].id.scan));
        order.sort_by_key(|&k| square_of(k));
        let position = |k: u32| [rows[k as usize].pose.x_m, rows[k as usize].pose.y_m];
        let mut tree = Self {
            keyframes: Vec::new(),
            xs_m: Vec::new(),
            ys_m: Vec::new(),
            squares: Vec::new(),
            nodes: Vec::new(),
            buckets: BTreeMap::new(),
            // Squares within reach are in the same bucket or in the next one. The hundredth is more than
            // the rounding errors of the division.
            bucket_m: 1.01 * (width_m + reach_m),
        };
        let mut start = 0;
        for of_square in order.chunk_by_mut(|&a, &b| square_of(a) == square_of(b)) {
            // In order of their names, which decides between equal positions.
            let of_names = of_square.to_vec();
            let mut points: Vec<Point> =
                (0..).zip(&of_names).map(|(n, &k)| (n, position(k))).collect();
            let root = tree.add(&mut points, start);
            of_square.iter_mut().zip(&points).for_each(|(k, point)| *k = of_names[point.0]);
            start += of_square.len() as u32;
            let (first, bucket) = (&rows[of_square[0] as usize], tree.bucket(&root));
            let is_one_site = of_square.iter().all(|&k| rows[k as usize].site == first.site);
            let key = (first.frame, bucket[0], bucket[1]);
            tree.buckets.entry(key).or_default().push(tree.squares.len() as u32);
            let site = is_one_site.then_some(first.site);
            tree.squares.push(Square { root, frame: first.frame, site });
        }
        tree.xs_m = order.iter().map(|&k| position(k)[0]).collect();
        tree.ys_m = order.iter().map(|&k| position(k)[1]).collect();
        tree.keyframes = order;
        tree
    }

    /// Sorts keyframes into a tree, and returns its root. `start` is the row of the first one.
    fn add(&mut self, points: &mut [Point], start: u32) -> Node {
        let mut low_m = [f64::INFINITY; 2];
        let mut high_m = [f64::NEG_INFINITY; 2];
        for (_, position) in points.iter() {
            low_m = [0, 1].map(|k| low_m[k].min(position[k]));
            high_m = [0, 1].map(|k| high_m[k].max(position[k]));
        }
        let end = start + points.len() as u32;
        let mut node = Node { start, end, low_m, high_m, halves: None };
        if LEAF < points.len() {
            let wider = usize::from(high_m[0] - low_m[0] < high_m[1] - low_m[1]);
            let middle = points.len() / 2;
            points.select_nth_unstable_by(middle, |a, b| {
                a.1[wider].total_cmp(&b.1[wider]).then(a.0.cmp(&b.0))
            });
            let (before, after) = points.split_at_mut(middle);
            let halves = [self.add(before, start), self.add(after, start + middle as u32)];
            let first = self.nodes.len() as u32;
            self.nodes.extend(halves);
            node.halves = Some([first, first + 1]);
        } else {
            points.sort_unstable_by_key(|point| point.0);
        }
        node
    }

    fn bucket(&self, node: &Node) -> [i64; 2] {
        node.low_m.map(|metres| (metres / self.bucket_m).floor() as i64)
    }

    /// The squares up to this one with keyframes that can form a pair with its keyframes that is not
    /// negative, and a few others.
    pub(crate) fn near(&self, square: usize) -> impl Iterator<Item = &Square> {
        let Square { root, frame, .. } = &self.squares[square];
        let [x, y] = self.bucket(root);
        let around = |at: i64| at.saturating_sub(1)..=at.saturating_add(1);
        around(x)
            .flat_map(move |x| around(y).map(move |y| (*frame, x, y)))
            .filter_map(|key| self.buckets.get(&key))
            .flatten()
            .filter(move |&&other| other as usize <= square)
            .map(|&other| &self.squares[other as usize])
    }

    /// The nodes of both halves; `None` for a leaf.
    pub(crate) fn halves(&self, node: &Node) -> Option<[&Node; 2]> {
        node.halves.map(|halves| halves.map(|k| &self.nodes[k as usize]))
    }

    /// Nodes with at most `most` keyframes that have all keyframes of a square together.
    pub(crate) fn parts(&self, square: usize, most: usize) -> Vec<Node> {
        let mut parts = vec![self.squares[square].root];
        let mut at = 0;
        while let Some(node) = parts.get(at) {
            match self.halves(node).filter(|_| most < node.len()) {
                Some([before, after]) => {
                    parts[at] = *before;
                    parts.insert(at + 1, *after);
                }
                None => at += 1,
            }
        }
        parts
    }

    /// The number of the square of a row.
    pub(crate) fn square_of(&self, row: usize) -> usize {
        self.squares.partition_point(|square| square.root.range().end <= row)
    }
}

impl Node {
    pub(crate) fn range(&self) -> Range<usize> {
        self.start as usize..self.end as usize
    }

    pub(crate) fn len(&self) -> usize {
        self.range().len()
    }

    /// The box around a single keyframe.
    pub(crate) fn of_row(tree: &Tree, row: usize) -> Self {
        let at = [tree.xs_m[row], tree.ys_m[row]];
        let start = row as u32;
        Self { start, end: start + 1, low_m: at, high_m: at, halves: None }
    }

    /// Bounds of the squared distances between the positions of two nodes \[m^2\]. They hold for rounded
    /// numbers as well: differences, squares and sums are rounded in the order of the exact values.
    pub(crate) fn squared_distances(&self, other: &Self) -> (f64, f64) {
        let mut bounds = (0.0, 0.0);
        for k in [0, 1] {
            let [a, b] = [self.high_m[k] - other.low_m[k], other.high_m[k] - self.low_m[k]];
            let (least, most) = ((-a).max(-b).max(0.0), a.max(b));
            bounds.0 += least * least;
            bounds.1 += most * most;
        }
        bounds
    }
}
