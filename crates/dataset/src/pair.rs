/// Whether two scans show one place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Label {
    /// Another place, -1.
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

    /// From +1 or -1.
    pub fn from_sign(sign: i8) -> Option<Self> {
        match sign {
            1 => Some(Self::Positive),
            -1 => Some(Self::Negative),
            _ => None,
        }
    }

    /// The label that a confidence stands for: positive where it reaches the threshold.
    pub fn from_confidence(confidence: f64, threshold: f64) -> Self {
        if threshold <= confidence { Self::Positive } else { Self::Negative }
    }
}

/// Two keyframes, unordered and unequal, and what is known of them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// Index of the later keyframe in the keyframe table.
    pub query: usize,
    /// Index of the earlier keyframe; always less than `query`.
    pub reference: usize,
    /// The label.
    pub label: Label,
    /// Distance between the positions \[m\]; infinite between sites, which share no frame.
    pub distance_m: f64,
    /// Unsigned angle between the headings \[rad\]; none between sites.
    pub heading_difference_rad: Option<f64>,
    /// Path driven between the two \[m\]; infinite between logs, which no path joins.
    pub travel_gap_m: f64,
}
