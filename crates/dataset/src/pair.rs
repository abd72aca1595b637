/// Whether two scans show the same place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Label {
    /// Different places, -1.
    Negative,
    /// The same place, +1.
    Positive,
}

impl Label {
    /// +1 or -1.
    pub fn sign(self) -> i8 {
        match self {
            Self::Positive => 1,
            Self::Negative => -1,
        }
    }

    /// The label as a regression target, +1.0 or -1.0.
    pub fn target(self) -> f64 {
        f64::from(self.sign())
    }

    /// The label for +1 or -1; `None` for any other number.
    pub fn from_sign(sign: i8) -> Option<Self> {
        match sign {
            1 => Some(Self::Positive),
            -1 => Some(Self::Negative),
            _ => None,
        }
    }

    /// The label predicted by a confidence: positive if the confidence is at least the threshold.
    pub fn from_confidence(confidence: f64, threshold: f64) -> Self {
        if threshold <= confidence { Self::Positive } else { Self::Negative }
    }
}

/// Two different keyframes, their label and the geometry between them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// Index of the later keyframe in the keyframe table.
    pub query: usize,
    /// Index of the earlier keyframe in the keyframe table; always less than `query`.
    pub reference: usize,
    /// The label.
    pub label: Label,
    /// Distance between the positions \[m\]; infinite if they do not share a map frame.
    pub distance_m: f64,
    /// Bound of the standard deviation of the distance \[m\], if the poses are those of a finished run.
    pub distance_std_m: Option<f64>,
    /// Unsigned angle between the headings \[rad\]; `None` if they do not share a map
    /// frame.
    pub heading_difference_rad: Option<f64>,
    /// Distance driven between the two keyframes \[m\]; infinite if the logs differ.
    pub travel_gap_m: f64,
}

/// With less path than this between its two scans, a pair shows neighbours along the path \[m\].
/// Such scans look alike because they were taken within seconds of each other, and a robot that
/// looks for loop closures does not compare them. A robot that turns around within a corridor or a
/// parking space is back at its own path after about this length.
pub const NEIGHBOUR_GAP_M: f64 = 10.0;

impl Pair {
    /// Whether the two scans follow each other along the path of a log. Other pairs of the same
    /// place are revisits.
    pub fn is_neighbour(&self) -> bool {
        self.travel_gap_m < NEIGHBOUR_GAP_M
    }
}
