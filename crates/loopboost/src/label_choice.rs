//! Chooses the label rules for a suggested pipeline: rules that give pairs with right labels in this log.

use std::fmt::{self, Write as _};

use dataset::{FULL_RING_DEG, Keyframe, Note, NoteKind};
use label::{LabelError, Labelled, Options};

/// Least path between the two scans of a positive pair \[m\]. Without it, most positives of a drive with
/// few revisits are neighbours along the path, which look alike because nothing has changed: 79 % in
/// the drive through the Austin ACES building.
const MIN_TRAVEL_GAP_M: f64 = 10.0;
/// Largest difference between the headings of a positive pair for scans of less than a full circle
/// \[deg\]: they have to see the same half of the place.
const POSITIVE_HEADING_DEG: f64 = 45.0;
/// Distances of negative pairs that are tried, the farthest first \[m\]: the distance of the paper, and
/// those for a building.
const NEGATIVE_MIN_M: [f64; 3] = [50.0, 25.0, 10.0];
/// With fewer pairs of a class, ten folds have one of each or none.
const MIN_PAIRS: u64 = 20;

/// Label rules that suit a log.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LabelChoice {
    options: Options,
    /// Whether the scans cover less than a full circle.
    is_open: bool,
    /// Why no rules give enough pairs; `None` if the pairs are enough.
    pub(crate) refusal: Option<String>,
    /// Remarks about the pairs. `inspect` does not report them: a run with more logs draws other pairs.
    notes: Vec<Note>,
}

impl LabelChoice {
    /// Rules for a log without keyframes, such as one without poses.
    pub(crate) fn without_keyframes(coverage_deg: Option<f64>) -> Self {
        let is_open = coverage_deg.is_some_and(|deg| deg < f64::from(FULL_RING_DEG));
        let mut options = Options { min_travel_gap_m: MIN_TRAVEL_GAP_M, ..Options::default() };
        if is_open {
            options.positive_heading_deg = POSITIVE_HEADING_DEG;
        }
        Self { options, is_open, refusal: None, notes: Vec::new() }
    }

    /// Rules for the keyframes of a log. Negatives are as far apart as the log allows. The number of
    /// pairs is the default, or fewer if the log has fewer.
    pub(crate) fn of(seed: u64, keyframes: &[Keyframe]) -> Self {
        let least_deg = keyframes.iter().map(|k| f64::from(k.coverage_deg)).reduce(f64::min);
        let mut choice = Self::without_keyframes(least_deg);
        let rules = choice.options.clone();
        let mut most = 0;
        for negative_min_m in NEGATIVE_MIN_M {
            let options = Options { negative_min_m, ..rules.clone() };
            let (n_pairs, refusal) = match label::label(&options, seed, keyframes) {
                Ok(labelled) => {
                    choice.accept(options, labelled);
                    return choice.spread_over_places(seed, keyframes);
                }
                Err(error @ LabelError::TooFew { n_positive, n_negative, .. }) => {
                    (n_positive.min(n_negative), error.to_string())
                }
                Err(error) => (0, error.to_string()),
            };
            // The farthest distance with the most pairs: a shorter one has to give more.
            if most < n_pairs {
                most = n_pairs;
                choice.options = Options { pairs_per_class: n_pairs as usize, ..options };
            }
            choice.refusal.get_or_insert(refusal);
        }
        if most < MIN_PAIRS {
            choice.options = rules;
            return choice;
        }
        match label::label(&choice.options, seed, keyframes) {
            Ok(labelled) => {
                let options = choice.options.clone();
                choice.accept(options, labelled);
            }
            Err(error) => choice.refusal = Some(error.to_string()),
        }
        choice.spread_over_places(seed, keyframes)
    }

    /// Takes fewer pairs, if one place has too large a share of them and fewer pairs would be spread.
    fn spread_over_places(mut self, seed: u64, keyframes: &[Keyframe]) -> Self {
        let n_enough = |note: &Note| match note.kind {
            NoteKind::FewPlaces { n_enough, .. } => Some(n_enough),
            _ => None,
        };
        let Some(n_pairs) = self.notes.iter().filter_map(n_enough).min() else { return self };
        if MIN_PAIRS <= n_pairs {
            let options = Options { pairs_per_class: n_pairs as usize, ..self.options.clone() };
            if let Ok(labelled) = label::label(&options, seed, keyframes) {
                self.accept(options, labelled);
            }
        }
        self
    }

    fn accept(&mut self, options: Options, labelled: Labelled) {
        self.options = options;
        self.notes = labelled.notes;
        self.refusal = None;
    }

    /// Writes the section `[label]`.
    pub(crate) fn write(&self, text: &mut String) -> fmt::Result {
        let (options, defaults) = (&self.options, Options::default());
        writeln!(
            text,
            "\n[label]\nmin_travel_gap_m = {:?}   # positives are revisits, not neighbours along the path",
            options.min_travel_gap_m
        )?;
        if self.is_open {
            writeln!(
                text,
                "positive_heading_deg = {:?}   # the scanner covers less than a full circle",
                options.positive_heading_deg
            )?;
        }
        if options.negative_min_m < defaults.negative_min_m {
            writeln!(
                text,
                "negative_min_m = {:?}   # the log has too few places that are {} m apart",
                options.negative_min_m, defaults.negative_min_m
            )?;
        }
        if options.pairs_per_class < defaults.pairs_per_class {
            writeln!(
                text,
                "pairs_per_class = {}   # as many as this log has, spread over its places",
                options.pairs_per_class
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dataset::{Pose2, ScanId};

    /// Keyframes on `n_laps` laps of a circle with a circumference of `lap_m`, half a metre apart.
    fn laps(n_laps: u32, lap_m: f64, coverage_deg: f32) -> Vec<Keyframe> {
        let n = (f64::from(n_laps) * lap_m * 2.0) as u32;
        let radius_m = lap_m / std::f64::consts::TAU;
        let at = |k: u32| {
            let angle = f64::from(k) * 0.5 / radius_m;
            let (x_m, y_m) = (radius_m * angle.cos(), radius_m * angle.sin());
            Keyframe {
                id: ScanId { log: "a".into(), scan: k },
                site: "a".into(),
                stamp_ns: i64::from(k) * 1_000_000_000,
                pose: Pose2 { x_m, y_m, heading_rad: angle },
                covariance: None,
                map: None,
                travel_m: f64::from(k) * 0.5,
                coverage_deg,
                z_m: None,
                segment: 0,
                frame: 0,
            }
        };
        (0..n).map(at).collect()
    }

    fn section(keyframes: &[Keyframe]) -> (LabelChoice, String) {
        let choice = LabelChoice::of(7, keyframes);
        let mut text = String::new();
        choice.write(&mut text).unwrap();
        (choice, text)
    }

    #[test]
    fn a_long_drive_keeps_the_defaults() {
        // Two laps of 300 m: 600 places that are visited twice, with up to 7 neighbours within 1.5 m.
        let (choice, text) = section(&laps(2, 300.0, 360.0));
        assert_eq!(choice.refusal, None);
        assert!(text.starts_with("\n[label]\nmin_travel_gap_m = 10.0"), "{text}");
        assert!(!text.contains("negative_min_m") && !text.contains("pairs_per"), "{text}");
        assert!(!text.contains("heading"), "{text}");
    }

    /// A circle of 90 m is 28.6 m wide: no two places are 50 m apart, and some are 25 m apart.
    #[test]
    fn in_a_building_negatives_are_nearer_and_pairs_are_fewer() {
        let (choice, text) = section(&laps(2, 90.0, 270.0));
        assert_eq!(choice.refusal, None);
        assert!(text.contains("negative_min_m = 25.0"), "{text}");
        assert!(text.contains("positive_heading_deg = 45.0"), "{text}");
        // A circle of 60 m is 19 m wide, and has 120 places with at most 7 neighbours.
        let keyframes = laps(2, 60.0, 270.0);
        let (choice, text) = section(&keyframes);
        assert_eq!(choice.refusal, None);
        assert!(text.contains("negative_min_m = 10.0"), "{text}");
        assert!(text.contains("pairs_per_class"), "{text}");
        assert!(label::label(&choice.options, 7, &keyframes).is_ok());
    }

    #[test]
    fn a_drive_without_revisits_is_refused() {
        let (choice, text) = section(&laps(1, 400.0, 360.0)[..700]);
        let refusal = choice.refusal.unwrap();
        assert!(refusal.contains("found 0 positive"), "{refusal}");
        assert!(text.contains("min_travel_gap_m = 10.0") && !text.contains("pairs_per"), "{text}");
    }
}
