use dataset::OutOfRange;
use serde::{Deserialize, Serialize};

/// The section `[label]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "LabelOptions"))]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// A pair at most this far apart is positive \[m\].
    pub positive_radius_m: f64,
    /// Largest difference between the headings of a positive pair \[deg\]. Only used for scans
    /// that see less than a full circle.
    pub positive_heading_deg: f64,
    /// A pair more than this far apart is negative \[m\].
    pub negative_min_m: f64,
    /// Least path length between the two scans of a positive pair from one log \[m\]. With 0,
    /// neighbours along the path are positive too, as in the paper.
    pub min_travel_gap_m: f64,
    /// Largest difference between the heights of a positive pair \[m\], if the poses have a
    /// height. Pairs that are close in the plane but farther apart in height are not used. Floors
    /// of buildings and car parks are at least 2.6 m apart. Poses whose plane coordinates are good
    /// enough for `positive_radius_m` rarely drift by more than this in height; raise it if they do.
    pub max_height_difference_m: f64,
    /// Number of pairs to draw from each class. The paper uses 1218.
    pub pairs_per_class: usize,
    /// Largest share of the pairs of a class from one place: 0.1 is a tenth, and 1 is no limit. The
    /// limit prevents a place where the robot spent most of its time from dominating. If the other
    /// places have too few pairs, the share is raised as far as necessary, with a warning if one
    /// place has more than half of the positives.
    pub max_place_share: f64,
    /// Width of a place for `max_place_share`, a square of ground \[m\].
    pub place_m: f64,
    /// Treat pairs from two different sites as negative. Sites do not share a map frame.
    pub cross_site_negatives: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            positive_radius_m: 1.5,
            positive_heading_deg: 180.0,
            negative_min_m: 50.0,
            min_travel_gap_m: 0.0,
            max_height_difference_m: 2.5,
            pairs_per_class: 1218,
            max_place_share: 0.1,
            place_m: 5.0,
            cross_site_negatives: false,
        }
    }
}

impl Options {
    /// Checks that every value is in range.
    pub fn check(&self) -> Result<(), OutOfRange> {
        let fail =
            |key: &str, found: f64, expected: &str| Err(OutOfRange::new(key, found, expected));
        let is_valid = |value: f64| value.is_finite() && 0.0 <= value;
        if !is_valid(self.positive_radius_m) {
            return fail("label.positive_radius_m", self.positive_radius_m, "0 or more");
        }
        if !is_valid(self.positive_heading_deg) || 180.0 < self.positive_heading_deg {
            return fail("label.positive_heading_deg", self.positive_heading_deg, "0 to 180");
        }
        if !is_valid(self.negative_min_m) || self.negative_min_m < self.positive_radius_m {
            return fail(
                "label.negative_min_m",
                self.negative_min_m,
                "`label.positive_radius_m` or more",
            );
        }
        if !is_valid(self.min_travel_gap_m) {
            return fail("label.min_travel_gap_m", self.min_travel_gap_m, "0 or more");
        }
        if !(self.max_height_difference_m.is_finite() && 0.0 < self.max_height_difference_m) {
            return fail(
                "label.max_height_difference_m",
                self.max_height_difference_m,
                "more than 0",
            );
        }
        if self.pairs_per_class == 0 {
            return fail("label.pairs_per_class", 0.0, "1 or more");
        }
        if !(0.0 < self.max_place_share && self.max_place_share <= 1.0) {
            return fail("label.max_place_share", self.max_place_share, "more than 0, at most 1");
        }
        if !(self.place_m.is_finite() && 0.0 < self.place_m) {
            return fail("label.place_m", self.place_m, "more than 0");
        }
        Ok(())
    }
}
