//! Coordinate frames that keyframes share, and squares of ground.

use std::collections::BTreeMap;

use crate::Keyframe;

/// The coordinate frame of each keyframe, numbered from 0, `(n_keyframes,)`. Only the poses of
/// keyframes with the same number can be compared.
///
/// The logs of a site share one frame. A log whose poses are in several frames (see
/// [`StampedPose::frame`](crate::StampedPose::frame)) shares none of them with other logs, because
/// it is not known which of them is the frame of the site. Keyframes in a map of a finished run (see
/// [`Keyframe::map`]) share a frame if they are in the same map, whatever their site.
///
/// ```
/// # use dataset::{Keyframe, Pose2, ScanId, common_frames};
/// # let keyframe = |log: &str, frame| Keyframe {
/// #     id: ScanId { log: log.into(), scan: 0 }, site: "campus".into(), stamp_ns: 0,
/// #     pose: Pose2::default(), covariance: None, z_m: None, segment: frame, frame,
/// #     map: None,
/// #     travel_m: 0.0, coverage_deg: 360.0,
/// # };
/// // Log `b` has two frames.
/// let keyframes = [keyframe("a", 0), keyframe("b", 0), keyframe("b", 1), keyframe("c", 0)];
/// let frames = common_frames(&keyframes);
/// assert_eq!(frames[0], frames[3]);
/// assert!(frames[1] != frames[0] && frames[2] != frames[0] && frames[1] != frames[2]);
/// ```
pub fn common_frames(keyframes: &[Keyframe]) -> Vec<u32> {
    let mut first_frames: BTreeMap<&str, (u32, bool)> = BTreeMap::new();
    for keyframe in keyframes {
        let (first, has_several) =
            first_frames.entry(&keyframe.id.log).or_insert((keyframe.frame, false));
        *has_several |= *first != keyframe.frame;
    }
    let name = |keyframe: &'_ Keyframe| {
        if keyframe.map.is_some() {
            return (keyframe.map, None, None);
        }
        let has_several = first_frames[&*keyframe.id.log].1;
        let own = has_several.then(|| (keyframe.id.log.clone(), keyframe.frame));
        (None, Some(keyframe.site.clone()), own)
    };
    numbered(&keyframes.iter().map(name).collect::<Vec<_>>())
}

/// Squares of ground, and the number of keyframes in each.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Squares {
    /// The square of each keyframe, `(n_keyframes,)`. Squares are numbered from 0.
    pub of_keyframes: Vec<u32>,
    /// Number of keyframes in each square, `(n_squares,)`.
    pub sizes: Vec<u32>,
}

impl Squares {
    /// Divides the ground of each frame into squares `width_m` wide. Where keyframes have a height,
    /// each square is divided into layers `layer_m` high.
    ///
    /// `frames` are the frames of the keyframes, by [`common_frames`]. The numbers of the squares
    /// do not depend on the order of the keyframes.
    pub fn new(keyframes: &[Keyframe], frames: &[u32], width_m: f64, layer_m: f64) -> Self {
        let cell = |k: &Keyframe, &frame: &u32| {
            let floor = |metres: f64| (metres / width_m).floor() as i64;
            // Rounded: ground at height 0 is in the middle of a layer. NaN becomes 0.
            let layer = k.z_m.map_or(0, |z_m| (z_m / layer_m).round() as i64);
            (frame, layer, floor(k.pose.x_m), floor(k.pose.y_m))
        };
        let of_keyframes = numbered(
            &keyframes.iter().zip(frames).map(|(k, frame)| cell(k, frame)).collect::<Vec<_>>(),
        );
        let n_squares = of_keyframes.iter().max().map_or(0, |&last| last as usize + 1);
        let mut sizes = vec![0; n_squares];
        for &square in &of_keyframes {
            sizes[square as usize] += 1;
        }
        Self { of_keyframes, sizes }
    }

    /// The square that a pair of keyframes counts for: of the squares of both, the one with more
    /// keyframes. A square that many scans were taken in is then in few pairs of other squares.
    pub fn of_pair(&self, query: usize, reference: usize) -> u32 {
        let [a, b] = [query, reference].map(|k| self.of_keyframes[k]);
        let size = |square: u32| (self.sizes[square as usize], square);
        if size(a) < size(b) { b } else { a }
    }
}

/// Numbers distinct names from 0 in their order, and returns the number of each name.
fn numbered<N: Ord>(names: &[N]) -> Vec<u32> {
    let mut numbers: BTreeMap<&N, u32> = names.iter().map(|name| (name, 0)).collect();
    for (number, entry) in (0..).zip(numbers.values_mut()) {
        *entry = number;
    }
    names.iter().map(|name| numbers[name]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Pose2, ScanId};

    fn at(x_m: f64, y_m: f64, z_m: Option<f64>) -> Keyframe {
        Keyframe {
            id: ScanId { log: "a".into(), scan: 0 },
            site: "a".into(),
            stamp_ns: 0,
            pose: Pose2 { x_m, y_m, heading_rad: 0.0 },
            covariance: None,
            z_m,
            segment: 0,
            frame: 0,
            map: None,
            travel_m: 0.0,
            coverage_deg: 360.0,
        }
    }

    /// Squares 5 m wide: x from -5 to 0 and from 0 to 5. Layers of 2.5 m: heights from -1.25 m to
    /// 1.25 m are one layer, 4 m is in the layer from 3.75 m to 6.25 m.
    #[test]
    fn squares_have_a_width_and_layers() {
        let keyframes = [
            at(-0.1, 1.0, None),
            at(0.0, 4.9, None),
            at(4.9, 0.0, Some(-0.3)),
            at(1.0, 1.0, Some(0.3)),
            at(1.0, 1.0, Some(4.0)),
            at(1.0, 5.0, None),
        ];
        let squares = Squares::new(&keyframes, &[0; 6], 5.0, 2.5);
        let [a, b, c, d, e, f] = squares.of_keyframes[..] else { panic!("six keyframes") };
        assert_eq!((b, c), (c, d));
        assert_eq!(std::collections::BTreeSet::from([a, b, e, f]).len(), 4);
        assert_eq!(squares.sizes.iter().sum::<u32>(), 6);
        assert_eq!(squares.sizes[b as usize], 3);
        // Of two squares, a pair counts for the one with more keyframes.
        assert_eq!((squares.of_pair(0, 3), squares.of_pair(3, 0)), (b, b));
        // In another frame, the same coordinates are other ground.
        let frames = [0, 0, 0, 1, 0, 0];
        assert_eq!(Squares::new(&keyframes, &frames, 5.0, 2.5).sizes.len(), 5);
    }

    /// Logs `a` and `b` are in map 0, although their sites differ. Log `c` of the site of `a` is in map 1,
    /// and one of its segments in map 0. Log `d` of the same site is in no map.
    #[test]
    fn keyframes_of_one_map_share_a_frame_whatever_their_site() {
        let of = |log: &str, site: &str, map| {
            let mut keyframe = at(0.0, 0.0, None);
            (keyframe.id.log, keyframe.site, keyframe.map) = (log.into(), site.into(), map);
            keyframe.frame = map.unwrap_or_default();
            keyframe
        };
        let keyframes = [
            of("a", "s", Some(0)),
            of("b", "t", Some(0)),
            of("c", "s", Some(1)),
            of("c", "s", Some(0)),
            of("d", "s", None),
        ];
        let frames = common_frames(&keyframes);
        assert_eq!((frames[0], frames[0]), (frames[1], frames[3]));
        let distinct: std::collections::BTreeSet<u32> = frames.iter().copied().collect();
        assert_eq!(distinct.len(), 3);
    }

    #[test]
    fn logs_of_a_site_share_a_frame_unless_one_of_them_has_several() {
        let of = |log: &str, site: &str, frame| {
            let mut keyframe = at(0.0, 0.0, None);
            (keyframe.id.log, keyframe.site, keyframe.frame) = (log.into(), site.into(), frame);
            keyframe
        };
        let keyframes =
            [of("a", "s", 3), of("b", "s", 0), of("c", "s", 0), of("c", "s", 1), of("d", "t", 0)];
        let frames = common_frames(&keyframes);
        assert_eq!(frames[0], frames[1], "one frame each, whatever its number");
        let distinct: std::collections::BTreeSet<u32> = frames.iter().copied().collect();
        assert_eq!(distinct.len(), 4);
    }
}
