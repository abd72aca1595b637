//! Poses in the order of the file -> poses in order of time, in continuous segments.
//!
//! 1. Where the clock steps back, the order of the file decides ([`crate::pose::clock`]). Times that
//!    occur twice are left out, because a scan with such a time could belong to either part.
//! 2. Poses that jump away and back are outliers and are left out.
//! 3. Every other jump, change of frame and step of the clock starts a new segment. Poses are not
//!    interpolated between two segments. Poses after a jump are in a new frame, unless the options say
//!    that they are in the same one.

use std::collections::BTreeMap;

use dataset::{LossKind, Losses, NoteKind, StampedPose};

use crate::pose::clock::ClockPieces;
use crate::pose::jumps::{Jump, OwnSpeed, climb_m, is_too_fast, secs};

/// Poses that jump away and back within this time are outliers \[s\]. A single pose is an outlier after
/// any time. A receiver of satellite signals loses its fix for some seconds between buildings.
const MAX_OUTLIER_S: f64 = 5.0;
/// Poses between two jumps that do not lead back are outliers too, if they are fewer than this share of
/// the longest part without jumps: for example the first pose of a localiser, before it knows its
/// position.
const MAX_FRAGMENT_SHARE: f64 = 0.1;
/// If more poses than this share are outliers or jump, they cannot be the path of one robot.
const MAX_CONTRADICTORY_SHARE: f64 = 0.25;
/// With fewer jumps and outliers, their share is not evidence.
const MIN_CONTRADICTORY: usize = 4;

/// How poses are split into segments.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SegmentOptions {
    /// `ingest.pose.max_speed_m_s`.
    pub(crate) max_speed_m_s: f64,
    /// Whether poses after a jump are in the frame of those before.
    pub(crate) same_frame: bool,
}

/// Poses in segments.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Segmented {
    /// The poses, with ascending stamps.
    pub(crate) poses: Vec<StampedPose>,
    /// What was left out.
    pub(crate) losses: Losses,
    /// What was found.
    pub(crate) notes: Vec<NoteKind>,
    /// Number of poses that are outliers, or after a jump.
    n_contradictory: usize,
    n_poses: usize,
}

impl Segmented {
    /// Whether the poses cannot be the path of one robot: the number of outliers and jumps, and the
    /// number of poses.
    pub(crate) fn contradiction(&self) -> Option<(usize, usize)> {
        let limit = MAX_CONTRADICTORY_SHARE * self.n_poses as f64;
        (MIN_CONTRADICTORY <= self.n_contradictory && limit < self.n_contradictory as f64)
            .then_some((self.n_contradictory, self.n_poses))
    }
}

/// Splits poses in the order of the file into segments. The frames of the poses are numbers of frames
/// of the topic. `repeated_ns` are intervals of time that are known to occur twice; they contain no
/// poses.
pub(crate) fn segments(
    poses: Vec<StampedPose>,
    options: &SegmentOptions,
    mut repeated_ns: Vec<(i64, i64)>,
) -> Segmented {
    let clock = ClockPieces::of(&poses);
    repeated_ns.extend(clock.repeated_ns(&poses));
    repeated_ns.sort_unstable();
    let late = NoteKind::PosesReordered { n_poses: clock.n_late };
    let clock_notes = (0 < clock.n_late).then_some(late).into_iter().chain(clock.note(&poses));
    let mut n_duplicates = 0;
    let starts: Vec<usize> = clock.pieces.iter().skip(1).map(|piece| piece.start).collect();
    let mut pieces = split(poses, &starts);
    for piece in &mut pieces {
        piece.sort_by_key(|p| p.stamp_ns); // stable
        let before = piece.len();
        piece.dedup_by_key(|p| p.stamp_ns);
        n_duplicates += before - piece.len();
    }
    let runs = || pieces.iter().flat_map(|piece| piece.chunk_by(|a, b| a.frame == b.frame));
    let own = OwnSpeed::of(runs(), options.max_speed_m_s);
    let mut found = Found { own, options: *options, ..Found::default() };
    for piece in pieces {
        found.last_of_file = found.last_of_piece.take();
        let is_start = |k: &usize| piece[k - 1].frame != piece[*k].frame;
        let starts: Vec<usize> = (1..piece.len()).filter(is_start).collect();
        for run in split(piece, &starts) {
            found.add_run(run);
        }
    }
    found.finish(clock_notes, &repeated_ns, n_duplicates as u64)
}

/// Splits poses before some indices, which ascend. The poses are moved, because hours of poses need
/// hundreds of megabytes.
fn split(mut poses: Vec<StampedPose>, starts: &[usize]) -> Vec<Vec<StampedPose>> {
    let mut parts: Vec<_> = starts.iter().rev().map(|start| poses.split_off(*start)).collect();
    parts.push(poses);
    parts.reverse();
    parts
}

/// A part of the poses without a jump.
#[derive(Debug, Clone, Default)]
struct Part {
    poses: Vec<StampedPose>,
    /// The jump before it.
    jump: Option<Jump>,
}

/// The segments of the pieces so far.
#[derive(Default)]
struct Found {
    own: OwnSpeed,
    options: SegmentOptions,
    poses: Vec<StampedPose>,
    n_segments: u32,
    n_frames: u32,
    /// The last pose of each frame of the topic: where the frame can continue.
    frames: BTreeMap<u32, StampedPose>,
    /// The last pose before the clock stepped back.
    last_of_file: Option<StampedPose>,
    last_of_piece: Option<StampedPose>,
    n_outliers: u64,
    /// Pairs of poses around each jump.
    jumps: Vec<(Jump, StampedPose, StampedPose)>,
}

impl Default for SegmentOptions {
    fn default() -> Self {
        Self { max_speed_m_s: f64::INFINITY, same_frame: false }
    }
}

impl Found {
    /// Adds poses in order of time, all in one frame of the topic.
    fn add_run(&mut self, run: Vec<StampedPose>) {
        let Some(name) = run.first().map(|p| p.frame) else { return };
        let parts = self.without_outliers(parts(run, &self.own));
        let mut previous: Option<StampedPose> = None;
        for part in parts {
            let [Some(first), Some(last)] = [part.poses.first(), part.poses.last()] else {
                continue;
            };
            let frame = match (previous, part.jump) {
                (Some(before), Some(jump)) => {
                    self.jumps.push((jump, before, *first));
                    if self.options.same_frame { before.frame } else { self.new_frame() }
                }
                _ => self.frame_of(name, first),
            };
            let segment = self.n_segments;
            self.n_segments += 1;
            let in_segment = part.poses.iter().map(|p| StampedPose { segment, frame, ..*p });
            self.poses.extend(in_segment);
            let last = StampedPose { segment, frame, ..*last };
            self.frames.insert(name, last);
            self.last_of_piece = Some(last);
            previous = Some(last);
        }
    }

    /// The frame of the first pose of a run.
    fn frame_of(&mut self, name: u32, first: &StampedPose) -> u32 {
        let continues = match (self.frames.get(&name), self.last_of_file.take()) {
            // After a step of the clock, the time between the poses is not known. One period is likely.
            (Some(last), Some(in_file)) if *last == in_file => {
                let period_ns = (2e9 * self.own.period_s) as i64;
                let before = StampedPose { stamp_ns: first.stamp_ns - period_ns, ..*last };
                self.own.is_reachable(&before, first).then_some(last.frame)
            }
            (Some(last), _) => self.own.is_reachable(last, first).then_some(last.frame),
            (None, _) => None,
        };
        match (continues, self.frames.get(&name)) {
            (Some(frame), _) => frame,
            (None, Some(last)) if self.options.same_frame => last.frame,
            (None, _) => self.new_frame(),
        }
    }

    fn new_frame(&mut self) -> u32 {
        self.n_frames += 1;
        self.n_frames - 1
    }

    /// Removes outliers, and joins the parts before and after them if the robot can have driven from
    /// one to the other.
    fn without_outliers(&mut self, mut parts: Vec<Part>) -> Vec<Part> {
        let n_before: usize = parts.iter().map(|part| part.poses.len()).sum();
        let mut joined: Vec<Part> = Vec::with_capacity(parts.len());
        let mut at = 0;
        while at < parts.len() {
            let mut part = std::mem::take(&mut parts[at]);
            at += 1;
            while let Some(back) =
                part.poses.last().and_then(|last| self.way_back(&parts[at..], last))
            {
                at += back;
                part.poses.append(&mut parts[at].poses);
                at += 1;
            }
            joined.push(part);
        }
        let longest = joined.iter().map(|part| part.poses.len()).max().unwrap_or(0);
        joined.retain(|part| !is_fragment(part, longest));
        if let Some(first) = joined.first_mut() {
            first.jump = None;
        }
        let n_after: usize = joined.iter().map(|part| part.poses.len()).sum();
        self.n_outliers += (n_before - n_after) as u64;
        joined
    }

    /// The number of parts after which the poses are back where the robot can have driven from `last`.
    /// The parts between are outliers.
    fn way_back(&self, parts: &[Part], last: &StampedPose) -> Option<usize> {
        let mut jumps = Jumps::default();
        let mut n_between = 0;
        let mut before = *last;
        for (k, part) in parts.iter().enumerate() {
            let [Some(first), Some(end)] = [part.poses.first(), part.poses.last()] else {
                continue;
            };
            jumps.add(&before, first);
            if 1 < n_between && MAX_OUTLIER_S < secs(last, first) {
                return None;
            }
            if 0 < k && self.own.is_reachable(last, first) && jumps.cancel(&self.own) {
                return Some(k);
            }
            n_between += part.poses.len();
            before = *end;
        }
        None
    }

    /// Removes the poses at repeated times, and sorts the rest by stamp.
    fn finish(
        mut self,
        clock_notes: impl Iterator<Item = NoteKind>,
        repeated_ns: &[(i64, i64)],
        n_duplicates: u64,
    ) -> Segmented {
        let n_all = self.poses.len();
        let n_after = |stamp_ns: i64| repeated_ns.partition_point(|(_, to_ns)| *to_ns < stamp_ns);
        let is_repeated = |p: &StampedPose| {
            repeated_ns.get(n_after(p.stamp_ns)).is_some_and(|(from_ns, _)| *from_ns <= p.stamp_ns)
        };
        self.poses.retain(|p| !is_repeated(p));
        let n_repeated = (n_all - self.poses.len()) as u64;
        self.poses.sort_by_key(|p| p.stamp_ns);
        number(&mut self.poses, n_after);
        let mut losses = Losses::default();
        losses.add(LossKind::DuplicatePoseStamps, n_duplicates);
        losses.add(LossKind::PoseOutliers, self.n_outliers);
        losses.add(LossKind::PosesAtRepeatedTimes, n_repeated);
        let mut notes = self.notes();
        notes.extend(clock_notes);
        let n_outliers = self.n_outliers as usize;
        let n_contradictory = n_outliers + self.jumps.len();
        let n_poses = n_all + n_outliers;
        Segmented { poses: self.poses, losses, notes, n_contradictory, n_poses }
    }

    fn notes(&self) -> Vec<NoteKind> {
        let mut notes = Vec::new();
        let of = |kind: Jump| self.jumps.iter().filter(move |(jump, ..)| *jump == kind);
        let largest = |kind, size: fn(&StampedPose, &StampedPose) -> f64| {
            of(kind).rev().max_by(|(_, a, b), (_, c, d)| size(a, b).total_cmp(&size(c, d)))
        };
        let same_frame = self.options.same_frame;
        if let Some((_, a, b)) = largest(Jump::Position, |a, b| a.pose.distance_m(&b.pose)) {
            notes.push(NoteKind::PoseJumps {
                n_jumps: of(Jump::Position).count() as u64,
                own_speed_m_s: self.own.speed_m_s,
                largest_m: a.pose.distance_m(&b.pose),
                largest_s: secs(a, b),
                stamp_ns: a.stamp_ns,
                same_frame,
            });
        }
        if let Some((_, a, b)) = largest(Jump::Height, |a, b| climb_m(a, b).abs()) {
            notes.push(NoteKind::HeightJumps {
                n_jumps: of(Jump::Height).count() as u64,
                largest_m: climb_m(a, b).abs(),
                largest_s: secs(a, b),
                stamp_ns: a.stamp_ns,
                same_frame,
            });
        }
        notes.extend(self.too_fast());
        notes
    }

    /// Steps within a segment that are faster than `max_speed_m_s`.
    fn too_fast(&self) -> Option<NoteKind> {
        let max_speed_m_s = self.options.max_speed_m_s;
        let pairs = self.poses.windows(2).filter(|pair| pair[0].segment == pair[1].segment);
        let fast: Vec<_> =
            pairs.filter(|pair| is_too_fast(&pair[0], &pair[1], max_speed_m_s)).collect();
        let distance_m = |pair: &[StampedPose]| pair[0].pose.distance_m(&pair[1].pose);
        let longest = fast.iter().rev().max_by(|a, b| distance_m(a).total_cmp(&distance_m(b)))?;
        Some(NoteKind::PosesTooFast {
            n_steps: fast.len() as u64,
            max_speed_m_s,
            largest_m: distance_m(longest),
            largest_s: secs(&longest[0], &longest[1]),
            stamp_ns: longest[0].stamp_ns,
        })
    }
}

/// Successive jumps.
#[derive(Debug, Clone, Copy, Default)]
struct Jumps {
    /// Sum along x, y and z \[m\].
    sum: [f64; 3],
    /// The longest, along the ground or in height \[m\].
    longest_m: f64,
    /// Their time \[s\].
    secs: f64,
}

impl Jumps {
    fn add(&mut self, a: &StampedPose, b: &StampedPose) {
        let jump = [b.pose.x_m - a.pose.x_m, b.pose.y_m - a.pose.y_m, climb_m(a, b)];
        self.sum.iter_mut().zip(jump).for_each(|(sum, jump)| *sum += jump);
        self.longest_m = self.longest_m.max(a.pose.distance_m(&b.pose)).max(jump[2].abs());
        self.secs += secs(a, b);
    }

    /// Whether the last jumps lead back to where the first one started. Poses that are wrong move less
    /// than half as far as they jump.
    fn cancel(&self, own: &OwnSpeed) -> bool {
        let [x, y, z] = self.sum;
        let left_m = (x * x + y * y).sqrt().max(z.abs());
        left_m <= 0.5 * self.longest_m + own.speed_m_s * self.secs
    }
}

/// Splits poses at their jumps.
fn parts(run: Vec<StampedPose>, own: &OwnSpeed) -> Vec<Part> {
    let (starts, jumps): (Vec<usize>, Vec<Jump>) = own.jumps(&run).into_iter().unzip();
    let jumps = std::iter::once(None).chain(jumps.into_iter().map(Some));
    jumps.zip(split(run, &starts)).map(|(jump, poses)| Part { poses, jump }).collect()
}

/// Whether a part is too short to be a segment.
fn is_fragment(part: &Part, longest: usize) -> bool {
    let [Some(first), Some(last)] = [part.poses.first(), part.poses.last()] else { return true };
    secs(first, last) <= MAX_OUTLIER_S
        && (part.poses.len() as f64) < MAX_FRAGMENT_SHARE * longest as f64
}

/// Numbers segments and frames in order of time, without holes. A segment also ends where poses at
/// repeated times were left out.
fn number(poses: &mut [StampedPose], n_repeated_before: impl Fn(i64) -> usize) {
    let mut frames: BTreeMap<u32, u32> = BTreeMap::new();
    let mut previous = None;
    let mut segment = 0;
    for pose in poses {
        let key = (pose.segment, n_repeated_before(pose.stamp_ns));
        if previous.is_some_and(|previous| previous != key) {
            segment += 1;
        }
        previous = Some(key);
        let n_frames = frames.len() as u32;
        pose.frame = *frames.entry(pose.frame).or_insert(n_frames);
        pose.segment = segment;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dataset::Pose2;

    const OPTIONS: SegmentOptions = SegmentOptions { max_speed_m_s: 15.0, same_frame: false };

    fn pose(s: f64, x_m: f64, y_m: f64) -> StampedPose {
        StampedPose::new((s * 1e9) as i64, Pose2 { x_m, y_m, heading_rad: 0.0 })
    }

    /// A robot that drives 2 m/s along x, with poses at 5 Hz, changed by `at`.
    fn drive(n: usize, at: impl Fn(usize, StampedPose) -> StampedPose) -> Vec<StampedPose> {
        (0..n).map(|k| at(k, pose(0.2 * k as f64, 0.4 * k as f64, 0.0))).collect()
    }

    /// The number of poses of each successive segment, with its frame.
    fn pieces(found: &Segmented) -> Vec<(usize, u32)> {
        let segments = found.poses.chunk_by(|a, b| a.segment == b.segment);
        let pieces: Vec<_> = segments.map(|s| (s.len(), s[0].frame)).collect();
        let numbers: Vec<u32> =
            found.poses.chunk_by(|a, b| a.segment == b.segment).map(|s| s[0].segment).collect();
        assert!(numbers.iter().copied().eq(0..numbers.len() as u32), "{numbers:?}");
        pieces
    }

    fn shifted(pose: StampedPose, y_m: f64) -> StampedPose {
        StampedPose { pose: Pose2 { y_m, ..pose.pose }, ..pose }
    }

    #[test]
    fn a_continuous_drive_is_one_segment() {
        let found = segments(drive(100, |_, p| p), &OPTIONS, vec![]);
        assert_eq!(pieces(&found), [(100, 0)]);
        assert!(found.losses.is_empty() && found.notes.is_empty());
        assert_eq!(segments(vec![], &OPTIONS, vec![]), Segmented::default());
    }

    #[test]
    fn a_jump_starts_a_segment_in_a_new_frame_or_in_the_same() {
        let jumps = drive(200, |k, p| shifted(p, if k < 80 { 0.0 } else { 5.0 }));
        let found = segments(jumps.clone(), &OPTIONS, vec![]);
        assert_eq!(pieces(&found), [(80, 0), (120, 1)]);
        assert!(matches!(
            found.notes[0],
            NoteKind::PoseJumps { n_jumps: 1, stamp_ns: 15_800_000_000, same_frame: false, .. }
        ));
        let options = SegmentOptions { same_frame: true, ..OPTIONS };
        assert_eq!(pieces(&segments(jumps, &options, vec![])), [(80, 0), (120, 0)]);
    }

    /// A satellite receiver under a bridge: one fix, or all fixes of 3 s, are 40 m off. 8 s are too
    /// long to be an outlier.
    #[test]
    fn poses_that_jump_away_and_back_are_outliers() {
        for (n_off, expected) in
            [(1, vec![(199, 0)]), (15, vec![(185, 0)]), (40, vec![(100, 0), (40, 1), (60, 2)])]
        {
            let off = drive(200, |k, p| {
                shifted(p, if (100..100 + n_off).contains(&k) { 40.0 } else { 0.0 })
            });
            let found = segments(off, &OPTIONS, vec![]);
            assert_eq!(pieces(&found), expected);
            let n_outliers = if n_off < 40 { n_off as u64 } else { 0 };
            assert_eq!(found.losses.count("pose_outliers"), n_outliers);
            assert_eq!(found.contradiction(), None);
        }
    }

    /// Two corrections within 3 s do not lead back: each part is in its own frame. A part of only a few
    /// poses is left out.
    #[test]
    fn two_corrections_are_not_an_outlier() {
        let corrected = |second: usize| {
            let poses = drive(200, |k, p| match k {
                0..100 => p,
                _ if k < second => shifted(p, 4.0),
                _ => shifted(p, 9.0),
            });
            segments(poses, &OPTIONS, vec![])
        };
        assert_eq!(pieces(&corrected(105)), [(100, 0), (95, 1)]);
        let found = corrected(115);
        assert_eq!(pieces(&found), [(100, 0), (15, 1), (85, 2)]);
    }

    /// A localiser starts at the origin before it knows its position.
    #[test]
    fn a_first_pose_at_another_place_is_an_outlier() {
        let start = drive(100, |k, p| if k < 2 { p } else { shifted(p, 30.0) });
        let found = segments(start, &OPTIONS, vec![]);
        assert_eq!(pieces(&found), [(98, 0)]);
        assert_eq!(found.losses.count("pose_outliers"), 2);
        assert!(found.notes.is_empty());
    }

    /// The clock steps back by 6 s after 100 poses: 30 poses before and after have common times.
    #[test]
    fn a_clock_step_starts_a_segment_in_the_same_frame() {
        let stepped = |shift_m: f64| {
            drive(200, |k, p| match k {
                0..100 => p,
                _ => StampedPose { stamp_ns: p.stamp_ns - 6_000_000_000, ..shifted(p, shift_m) },
            })
        };
        let found = segments(stepped(0.0), &OPTIONS, vec![]);
        assert_eq!(found.losses.count("poses_at_repeated_times"), 60);
        assert_eq!(pieces(&found), [(70, 0), (70, 0)]);
        assert!(matches!(
            found.notes[..],
            [NoteKind::PoseClockStepsBack { n_steps: 1, stamp_ns: 14_000_000_000, .. }]
        ));
        // The simulation starts again at another place.
        assert_eq!(pieces(&segments(stepped(50.0), &OPTIONS, vec![])), [(70, 0), (70, 1)]);
    }

    /// The localiser is off for a while, and the poses are in the frame of the odometry.
    #[test]
    fn a_change_of_the_frame_starts_a_segment_and_a_frame_can_return() {
        let changed =
            drive(200, |k, p| StampedPose { frame: u32::from((100..150).contains(&k)), ..p });
        let found = segments(changed, &OPTIONS, vec![]);
        assert_eq!(pieces(&found), [(100, 0), (50, 1), (50, 0)]);
        assert!(found.notes.is_empty() && found.losses.is_empty());
    }

    /// Two robots, or two filters that disagree, with poses on one topic.
    #[test]
    fn alternating_poses_are_a_contradiction() {
        let two = drive(200, |k, p| shifted(p, if k % 2 == 0 { 0.0 } else { 20.0 }));
        let (n, n_poses) = segments(two, &OPTIONS, vec![]).contradiction().unwrap();
        assert!(99 <= n && n_poses <= 200, "{n} of {n_poses}");
    }

    /// Late poses are put back in order; of two poses with one stamp, the first is used.
    #[test]
    fn late_and_duplicate_poses_are_counted() {
        let mut poses = drive(50, |_, p| p);
        poses.swap(10, 11);
        poses.push(pose(9.8, 7.0, 7.0));
        let found = segments(poses, &OPTIONS, vec![]);
        assert_eq!(pieces(&found), [(50, 0)]);
        assert_eq!(found.losses.count("duplicate_pose_stamps"), 1);
        assert_eq!(found.notes, [NoteKind::PosesReordered { n_poses: 1 }]);
    }
}
