//! The candidates of both classes: how many each keyframe has, and which one has a given rank.
//!
//! A pair belongs to the later of its two keyframes in the candidate order (see [`Tree`]). Candidates are
//! sorted by their later keyframe, then by the other one. The rank of a candidate is its number in this
//! order, from 0.
//!
//! Few pairs are looked at. Of two boxes of the tree, all pairs are
//!
//! - negative, if the boxes are more than `negative_min_m` apart: they are not visited. The negatives of a
//!   keyframe are all keyframes before it, less those that are not negative;
//! - ambiguous, if the boxes are more than `positive_radius_m` apart and no two points of them are more than
//!   `negative_min_m` apart: they are counted at once;
//! - otherwise to be looked at: the boxes are halved, and in the end the rules decide on each pair.
//!
//! If the poses rest on measurements, the uncertainty of any distance can be too large for a label. All pairs
//! that are not ambiguous by distance are then looked at.

use std::collections::BTreeMap;

use dataset::Label;
use rayon::prelude::*;

use crate::rules::{Kind, Row, Rules, Tally};
use crate::tree::{Node, Square, Tree};

/// The candidates of both classes.
pub(crate) struct Ranked<'a> {
    rules: &'a Rules<'a>,
    tree: &'a Tree,
    /// The keyframes in candidate order, `(n_keyframes,)`.
    rows: Vec<Row>,
    limits: Limits,
    /// The rank of the first candidate of each row, and the number of candidates,
    /// `(n_keyframes + 1,)`.
    positive: Vec<u64>,
    negative: Vec<u64>,
    pub(crate) tally: Tally,
}

/// The largest squares of distances that are within a radius.
#[derive(Clone, Copy)]
struct Limits {
    positive_m2: f64,
    negative_m2: f64,
}

/// The pairs between two boxes.
enum Between {
    AllNegative,
    AllAmbiguous,
    Any,
}

/// Number of keyframes that are counted as one task.
const TASK: usize = 512;

/// What is counted for the keyframes of a task.
struct Counted {
    start: usize,
    /// Positive pairs, and pairs of one frame that are not negative, `(n,)`.
    positive: Vec<u32>,
    not_negative: Vec<u32>,
    tally: Tally,
}

impl<'a> Ranked<'a> {
    /// Counts the candidates.
    pub(crate) fn new(rules: &'a Rules<'a>, tree: &'a Tree) -> Self {
        let options = rules.options();
        let limits = Limits {
            positive_m2: largest_square(options.positive_radius_m),
            negative_m2: largest_square(options.negative_min_m),
        };
        let (positive, negative) = (vec![0], vec![0]);
        let rows = tree.keyframes.iter().map(|&k| rules.rows()[k as usize]).collect();
        let tally = Tally::default();
        let mut ranked = Self { rules, tree, rows, limits, positive, negative, tally };
        let tasks: Vec<(usize, Node)> = (0..tree.squares.len())
            .flat_map(|square| tree.parts(square, TASK).into_iter().map(move |part| (square, part)))
            .collect();
        let counted: Vec<Counted> =
            tasks.par_iter().map(|(square, part)| ranked.count(*square, part)).collect();
        ranked.add_up(counted);
        ranked
    }

    /// Counts the pairs of the keyframes of a part of a square.
    fn count(&self, square: usize, part: &Node) -> Counted {
        let mut counted = Counted {
            start: part.range().start,
            positive: vec![0; part.len()],
            not_negative: vec![0; part.len()],
            tally: Tally::default(),
        };
        for other in self.tree.near(square) {
            self.visit(part, &other.root, &mut counted);
        }
        counted
    }

    /// Counts the pairs of the keyframes of `a` with keyframes of `b` that are before them.
    fn visit(&self, a: &Node, b: &Node, counted: &mut Counted) {
        let (of_a, of_b) = (a.range(), b.range());
        if of_a.end <= of_b.start {
            return;
        }
        // Boxes with keyframes in common are not apart: all of `b` is before `a` in the first two cases.
        match self.between(a, b) {
            Between::AllNegative => return,
            Between::AllAmbiguous => {
                let rows = of_a.start - counted.start..of_a.end - counted.start;
                for n in &mut counted.not_negative[rows] {
                    *n += b.len() as u32;
                }
                counted.tally.candidates.ambiguous += a.len() as u64 * b.len() as u64;
                return;
            }
            Between::Any => {}
        }
        match (self.tree.halves(a), self.tree.halves(b)) {
            (Some(halves), other) if other.is_none() || b.len() <= a.len() => {
                halves.into_iter().for_each(|half| self.visit(half, b, counted));
            }
            (_, Some(halves)) => {
                halves.into_iter().for_each(|half| self.visit(a, half, counted));
            }
            _ => self.look(a, b, counted),
        }
    }

    /// Looks at each pair of two leaves.
    fn look(&self, a: &Node, b: &Node, counted: &mut Counted) {
        for row in a.range() {
            let before = b.range().start..b.range().end.min(row);
            let k = row - counted.start;
            if !self.rules.is_exact() {
                before.for_each(|other| self.look_at(row, other, counted, k));
                continue;
            }
            let [n_close, n_near] = self.within(row, before.clone());
            counted.not_negative[k] += (n_near - n_close) as u32;
            counted.tally.candidates.ambiguous += n_near - n_close;
            if n_close == 0 {
                continue;
            }
            for other in before {
                if self.squared_distance(row, other) <= self.limits.positive_m2 {
                    self.look_at(row, other, counted, k);
                }
            }
        }
    }

    fn look_at(&self, row: usize, other: usize, counted: &mut Counted, k: usize) {
        let (query, reference) = self.ends(row, other);
        let kind = self.rules.kind_of(query, reference);
        if let Kind::Labelled(Label::Negative) = kind {
            return;
        }
        counted.tally.add(self.rules.options(), &kind, query, reference);
        counted.positive[k] += u32::from(matches!(kind, Kind::Labelled(Label::Positive)));
        counted.not_negative[k] += 1;
    }

    /// How many keyframes are within the positive radius and within the negative one.
    #[inline]
    fn within(&self, row: usize, others: std::ops::Range<usize>) -> [u64; 2] {
        let Tree { xs_m, ys_m, .. } = self.tree;
        let (x_m, y_m, mut n_close, mut n_near) = (xs_m[row], ys_m[row], 0, 0);
        for (other_x_m, other_y_m) in xs_m[others.clone()].iter().zip(&ys_m[others]) {
            let (dx, dy) = (x_m - other_x_m, y_m - other_y_m);
            let squared_m2 = dx * dx + dy * dy;
            n_close += u64::from(squared_m2 <= self.limits.positive_m2);
            n_near += u64::from(squared_m2 <= self.limits.negative_m2);
        }
        [n_close, n_near]
    }

    fn squared_distance(&self, row: usize, other: usize) -> f64 {
        let Tree { xs_m, ys_m, .. } = self.tree;
        let (dx, dy) = (xs_m[row] - xs_m[other], ys_m[row] - ys_m[other]);
        dx * dx + dy * dy
    }

    fn between(&self, a: &Node, b: &Node) -> Between {
        let (least_m2, most_m2) = a.squared_distances(b);
        if self.limits.negative_m2 < least_m2 && self.rules.is_exact() {
            Between::AllNegative
        } else if self.limits.positive_m2 < least_m2 && most_m2 <= self.limits.negative_m2 {
            Between::AllAmbiguous
        } else {
            Between::Any
        }
    }

    /// Computes the ranks, and the numbers of pairs in several frames.
    fn add_up(&mut self, counted: Vec<Counted>) {
        let is_negative_across = self.rules.options().cross_site_negatives;
        let mut before = Before::new(&self.rows);
        let mut n_of_class = [0, 0];
        for part in counted {
            self.tally = self.tally.plus(part.tally);
            let of_part = part.positive.into_iter().zip(part.not_negative);
            for (row, (positive, not_negative)) in (part.start..).zip(of_part) {
                let n = before.add(&self.rows[row]);
                let mut negative = n.of_frame - u64::from(not_negative);
                if is_negative_across {
                    negative += n.elsewhere;
                } else {
                    self.tally.candidates.without_common_frame += n.elsewhere;
                }
                self.tally.candidates.other_frame += n.in_other_frame_of_site;
                n_of_class[0] += u64::from(positive);
                n_of_class[1] += negative;
                self.positive.push(n_of_class[0]);
                self.negative.push(n_of_class[1]);
            }
        }
        [self.tally.candidates.positive, self.tally.candidates.negative] = n_of_class;
    }

    /// Two keyframes: the query has the larger number.
    #[inline]
    fn ends(&self, row: usize, other: usize) -> (&Row, &Row) {
        let (a, b) = (&self.rows[row], &self.rows[other]);
        if a.keyframe < b.keyframe { (b, a) } else { (a, b) }
    }

    fn ranks(&self, label: Label) -> &[u64] {
        match label {
            Label::Positive => &self.positive,
            Label::Negative => &self.negative,
        }
    }

    /// The rank of the first candidate of each square, and the number of candidates, `(n_squares + 1,)`.
    pub(crate) fn of_squares(&self, label: Label) -> Vec<u64> {
        let ranks = self.ranks(label);
        let ends = self.tree.squares.iter().map(|square| ranks[square.root.range().end]);
        std::iter::once(0).chain(ends).collect()
    }

    /// The query and the reference of the candidate with a rank.
    pub(crate) fn candidate(&self, label: Label, rank: u64) -> Option<(usize, usize)> {
        let ranks = self.ranks(label);
        let row = ranks.partition_point(|&first| first <= rank) - 1;
        let at = Node::of_row(self.tree, row);
        let mut left = rank - ranks[row];
        let square = self.tree.square_of(row);
        let found = match label {
            Label::Positive => {
                let mut near: Vec<&Square> = self.tree.near(square).collect();
                near.sort_by_key(|square| square.root.range().start);
                near.into_iter().find_map(|other| self.find(label, &at, &other.root, &mut left))
            }
            Label::Negative => {
                let own = &self.tree.squares[square];
                let site = self.rows[row].site;
                self.tree.squares[..=square].iter().find_map(|other| {
                    match (other.frame == own.frame, other.site) {
                        (true, _) => self.find(label, &at, &other.root, &mut left),
                        (false, _) if !self.rules.options().cross_site_negatives => None,
                        (false, Some(same)) if same == site => None,
                        (false, Some(_)) => skip(&other.root, &mut left),
                        (false, None) => self.search(label, &at, &other.root, &mut left),
                    }
                })
            }
        };
        let (query, reference) = self.ends(row, found?);
        Some((query.keyframe as usize, reference.keyframe as usize))
    }

    /// The row of a candidate of the keyframe `at` in a node, if the node has it: of the candidates in the
    /// node, the one with `left` others before it. Otherwise `left` is lowered by their number.
    fn find(&self, label: Label, at: &Node, node: &Node, left: &mut u64) -> Option<usize> {
        if at.range().start <= node.range().start {
            return None;
        }
        match (self.between(at, node), label) {
            (Between::AllNegative, Label::Negative) => return skip(node, left),
            (Between::AllNegative, Label::Positive) | (Between::AllAmbiguous, _) => return None,
            (Between::Any, _) => {}
        }
        match self.tree.halves(node) {
            Some(halves) => halves.into_iter().find_map(|half| self.find(label, at, half, left)),
            None => self.search(label, at, node, left),
        }
    }

    /// As `find`, but looks at each pair.
    fn search(&self, label: Label, at: &Node, node: &Node, left: &mut u64) -> Option<usize> {
        let row = at.range().start;
        for other in node.range().start..node.range().end.min(row) {
            let (query, reference) = self.ends(row, other);
            if matches!(self.rules.kind_of(query, reference), Kind::Labelled(of) if of == label) {
                if *left == 0 {
                    return Some(other);
                }
                *left -= 1;
            }
        }
        None
    }
}

/// As [`Ranked::find`], for a node with candidates only.
fn skip(node: &Node, left: &mut u64) -> Option<usize> {
    let n = node.len() as u64;
    if *left < n {
        return Some(node.range().start + *left as usize);
    }
    *left -= n;
    None
}

/// The largest number with a square root of at most `radius`. A distance is within the radius exactly if
/// its square is at most this number, because rounding keeps the order of square roots.
fn largest_square(radius: f64) -> f64 {
    let mut square = radius * radius;
    while square.sqrt() <= radius && square < f64::MAX {
        square = square.next_up();
    }
    while radius < square.sqrt() {
        square = square.next_down();
    }
    square
}

/// How many keyframes were added, by frame and site.
struct Before {
    n: u64,
    of_frames: Vec<u64>,
    of_sites: Vec<u64>,
    of_groups: BTreeMap<(u32, u32), u64>,
}

/// The keyframes before another one.
struct NumbersBefore {
    of_frame: u64,
    /// Of its site, but not of its frame.
    in_other_frame_of_site: u64,
    /// Neither of its frame nor of its site.
    elsewhere: u64,
}

impl Before {
    fn new(rows: &[Row]) -> Self {
        let n_of = |number: fn(&Row) -> u32| {
            rows.iter().map(number).max().map_or(0, |last| last as usize + 1)
        };
        let of_frames = vec![0; n_of(|row| row.frame)];
        let of_sites = vec![0; n_of(|row| row.site)];
        Self { n: 0, of_frames, of_sites, of_groups: BTreeMap::new() }
    }

    /// Adds a keyframe, and counts the keyframes before it.
    fn add(&mut self, &Row { frame, site, .. }: &Row) -> NumbersBefore {
        let of_frame = &mut self.of_frames[frame as usize];
        let of_site = &mut self.of_sites[site as usize];
        let of_both = self.of_groups.entry((frame, site)).or_default();
        let found = NumbersBefore {
            of_frame: *of_frame,
            in_other_frame_of_site: *of_site - *of_both,
            elsewhere: self.n + *of_both - *of_frame - *of_site,
        };
        for n in [&mut self.n, of_frame, of_site, of_both] {
            *n += 1;
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use dataset::{Keyframe, Pose2, ScanId, SplitMix64, Squares};

    use super::*;
    use crate::uncertainty::{Measurement, PoseGraph, Vertex};
    use crate::{Candidates, Options};

    /// The limits compare squares, and the rules compare distances: both agree next to each radius.
    #[test]
    fn squares_are_within_the_limit_exactly_if_distances_are_within_the_radius() {
        for radius in [0.0, 1e-200, 0.1, 1.0, 1.5, 2.0, 3.3, 50.0, 1e6 / 3.0, 1e160, f64::MAX] {
            let limit = largest_square(radius);
            assert!(limit.sqrt() <= radius, "{radius}");
            let beyond = limit.next_up();
            assert!(radius < beyond.sqrt() || limit == f64::MAX, "{radius}");
        }
    }

    fn one_of<T: Copy>(random: &mut SplitMix64, values: &[T]) -> T {
        values[random.below(values.len() as u64)]
    }

    /// Positions are multiples of half a metre, so that many distances are exactly at a radius, and several
    /// keyframes are at one position. There are sites with several logs, logs with several frames, maps with
    /// several sites, scans of half a circle, and floors.
    fn world(random: &mut SplitMix64, n: usize) -> Vec<Keyframe> {
        let width = one_of(random, &[4, 20, 60]);
        let n_logs = 1 + random.below(4);
        let (n_frames, in_maps) = (one_of(random, &[1, 1, 2]), random.below(3) == 0);
        let floors = one_of(random, &[1, 1, 3]);
        let origin_m = one_of(random, &[0.0, -7.25, 4e5 + 0.1]);
        let keyframe = |k: usize| {
            let log = random.below(n_logs as u64);
            let [x, y] = [(); 2].map(|()| random.below(width) as f64);
            Keyframe {
                id: ScanId { log: format!("log {}", (log + 2) % 4).into(), scan: k as u32 },
                site: format!("site {}", log / 2).into(),
                stamp_ns: k as i64,
                pose: Pose2 {
                    x_m: origin_m + 0.5 * x,
                    y_m: 0.5 * y - origin_m,
                    heading_rad: one_of(random, &[0.0, 1.5, 3.0, -3.0]),
                },
                covariance: None,
                z_m: (0 < random.below(4)).then(|| 3.0 * random.below(floors) as f64),
                segment: 0,
                frame: if log == 1 { random.below(n_frames) as u32 } else { 0 },
                map: (in_maps && log != 2).then_some(log as u32 % 2),
                travel_m: k as f64,
                coverage_deg: one_of(random, &[180.0, 360.0, 360.0]),
            }
        };
        (0..n).map(keyframe).collect()
    }

    fn options(random: &mut SplitMix64) -> Options {
        let positive_radius_m = one_of(random, &[0.0, 0.5, 1.0, 1.5]);
        Options {
            positive_radius_m,
            positive_heading_deg: one_of(random, &[45.0, 180.0]),
            negative_min_m: positive_radius_m + one_of(random, &[0.0, 0.5, 2.5, 8.0]),
            min_travel_gap_m: one_of(random, &[0.0, 20.0]),
            place_m: one_of(random, &[0.4, 1.0, 5.0, 1000.0]),
            cross_site_negatives: random.below(2) == 0,
            ..Options::default()
        }
    }

    /// A path through all keyframes, a few of which have no vertex.
    fn graph(random: &mut SplitMix64, keyframes: &[Keyframe]) -> PoseGraph {
        let n = keyframes.len();
        let variance = one_of(random, &[1e-4, 0.01]);
        let step = |a: usize| Measurement {
            a,
            b: a + 1,
            a_from_b: keyframes[a].pose.inverse() * keyframes[a + 1].pose,
            covariance: [variance, 0.0, 0.0, variance, 0.0, 1e-6],
        };
        let path: Vec<Measurement> = (0..n - 1).map(step).collect();
        let of_keyframes = (0..n).map(|k| (0 < random.below(10)).then_some(k)).collect();
        PoseGraph::new(&vec![Vertex::default(); n], &path, of_keyframes)
    }

    /// Compares counts and ranks with the rules for all pairs, one by one.
    fn check(keyframes: &[Keyframe], options: &Options, rules: &Rules<'_>, what: &str) -> Tally {
        let tree = Tree::new(rules, keyframes);
        let ranked = Ranked::new(rules, &tree);
        let frames: Vec<u32> = rules.rows().iter().map(|row| row.frame).collect();
        let layer_m = options.max_height_difference_m;
        let squares = Squares::new(keyframes, &frames, options.place_m, layer_m);
        let mut row_of = vec![0; keyframes.len()];
        tree.keyframes.iter().enumerate().for_each(|(row, &k)| row_of[k as usize] = row);
        let mut tally = Tally::default();
        let mut expected = [BTreeSet::new(), BTreeSet::new()];
        for query in 0..keyframes.len() {
            for reference in 0..query {
                let [a, b] = [query, reference].map(|k| &rules.rows()[k]);
                let kind = rules.kind_of(a, b);
                tally.add(options, &kind, a, b);
                if let Kind::Labelled(label) = kind {
                    let (later, other) = (row_of[query], row_of[reference]);
                    let order = (later.max(other), later.min(other));
                    let of_label = &mut expected[usize::from(label == Label::Negative)];
                    of_label.insert((order, query, reference));
                }
            }
        }
        assert_eq!(ranked.tally, tally, "{what}");
        for (label, expected) in [Label::Positive, Label::Negative].into_iter().zip(expected) {
            let firsts = ranked.of_squares(label);
            assert_eq!(*firsts.last().unwrap(), expected.len() as u64, "{what}");
            for (rank, (_, query, reference)) in (0..).zip(expected) {
                let found = ranked.candidate(label, rank);
                assert_eq!(found, Some((query, reference)), "{what}: {label:?} {rank}");
                let square = &tree.squares[crate::draw::place_of(&firsts, rank)];
                let of_square = tree.keyframes[square.root.range().start] as usize;
                let counts_for = squares.of_pair(query, reference);
                assert_eq!(squares.of_keyframes[of_square], counts_for, "{what}");
            }
        }
        tally
    }

    #[test]
    fn counts_and_ranks_are_those_of_all_pairs() {
        let mut random = SplitMix64::new(16);
        let mut all = Tally::default();
        for round in 0..200 {
            let n = if round % 100 == 0 { 700 } else { 1 + random.below(150) };
            let (keyframes, options) = (world(&mut random, n), options(&mut random));
            let what = format!("round {round}: {n} keyframes, {options:?}");
            let rules = Rules::new(&options, &keyframes);
            all = all.plus(check(&keyframes, &options, &rules, &what));
            if n < 100 {
                let graph = graph(&mut random, &keyframes);
                let rules = Rules::with_graph(&options, &keyframes, &graph);
                let what = format!("with a graph, {what}");
                all = all.plus(check(&keyframes, &options, &rules, &what));
            }
        }
        let Candidates { positive, negative, ambiguous, .. } = all.candidates;
        let Candidates { undecided_positive, undecided_negative, .. } = all.candidates;
        let Candidates { other_height, short_travel_gap, other_frame, .. } = all.candidates;
        let n_without = all.candidates.without_common_frame;
        for (k, n) in [
            positive,
            negative,
            ambiguous,
            undecided_positive,
            undecided_negative,
            other_height,
            short_travel_gap,
            other_frame,
            n_without,
        ]
        .into_iter()
        .enumerate()
        {
            assert!(1000 < n, "too few pairs of kind {k} to compare: {n}");
        }
    }
}
