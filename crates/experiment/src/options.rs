use std::collections::BTreeSet;
use std::fmt::Display;

use dataset::OutOfRange;
use label::Grouping;
use serde::{Deserialize, Serialize};
use train::Learner;

/// Largest margin around test ground, in widths of a square. A larger one is a typing error: it
/// leaves no ground to train on.
const MAX_MARGIN: f64 = 10.0;

/// The keys of the section `[evaluate]` that `train` uses.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Options {
    /// Largest number of folds.
    pub folds: u32,
    /// What is kept in one fold; each grouping is evaluated.
    pub groupings: Vec<Grouping>,
    /// Fail if a grouping cannot be evaluated, instead of leaving it out.
    pub require_groupings: bool,
    /// Width of the squares of ground of the grouping `place` \[m\].
    pub place_m: f64,
    /// Margin between training and test ground of the grouping `place` \[m\].
    pub place_margin_m: f64,
    /// Score all pairs of keyframes of each log.
    pub retrieval: bool,
    /// Of these, leave out pairs with less path between them \[m\].
    pub min_separation_m: f64,
    /// Largest number of pairs to score.
    pub max_pairs: u64,
    /// The error under other label rules.
    pub grid: GridOptions,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            folds: 10,
            groupings: vec![Grouping::Pair, Grouping::Place],
            require_groupings: false,
            place_m: 20.0,
            place_margin_m: 3.0,
            retrieval: true,
            min_separation_m: 30.0,
            max_pairs: 20_000_000,
            grid: GridOptions::default(),
        }
    }
}

impl Options {
    /// Checks that every value is in range. `label` has the rules that the grid varies.
    pub fn check(&self, label: &label::Options) -> Result<(), OutOfRange> {
        let fail = |key: &str, found: &dyn Display, expected: &str| {
            Err(OutOfRange::new(format!("evaluate.{key}"), found, expected))
        };
        if self.folds < 2 {
            return fail("folds", &self.folds, "2 or more");
        }
        if label.pairs_per_class < self.folds as usize {
            let expected =
                format!("at most `label.pairs_per_class`, which is {}", label.pairs_per_class);
            return fail("folds", &self.folds, &expected);
        }
        let names: Vec<&str> = self.groupings.iter().map(|grouping| grouping.name()).collect();
        let list = format!("[{}]", names.join(", "));
        if names.is_empty() {
            return fail("groupings", &list, "at least one grouping");
        }
        if names.iter().collect::<BTreeSet<_>>().len() < names.len() {
            return fail("groupings", &list, "each grouping once");
        }
        if !(self.place_m.is_finite() && 0.0 < self.place_m) {
            return fail("place_m", &self.place_m, "more than 0");
        }
        if !(0.0..=MAX_MARGIN * self.place_m).contains(&self.place_margin_m) {
            let expected = format!("0 to {MAX_MARGIN} times `evaluate.place_m`");
            return fail("place_margin_m", &self.place_margin_m, &expected);
        }
        if !(self.min_separation_m.is_finite() && 0.0 <= self.min_separation_m) {
            return fail("min_separation_m", &self.min_separation_m, "0 or more");
        }
        if self.max_pairs == 0 {
            return fail("max_pairs", &self.max_pairs, "1 or more");
        }
        self.grid.check(label)
    }
}

/// The section `[evaluate.grid]`: the error under every combination of three label options. If a
/// list is empty, there is no grid.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct GridOptions {
    /// Values of `label.positive_radius_m` \[m\].
    pub positive_radius_m: Vec<f64>,
    /// Values of `label.negative_min_m` \[m\].
    pub negative_min_m: Vec<f64>,
    /// Values of `label.min_travel_gap_m` \[m\]. With 0, neighbours along the path are positive too;
    /// larger values leave true revisits only.
    pub min_travel_gap_m: Vec<f64>,
    /// The learners to cross-validate.
    pub learners: Vec<Learner>,
    /// What is kept in one fold.
    pub grouping: Grouping,
}

impl Default for GridOptions {
    fn default() -> Self {
        Self {
            positive_radius_m: Vec::new(),
            negative_min_m: Vec::new(),
            min_travel_gap_m: vec![0.0],
            learners: vec![Learner::GentleStump],
            grouping: Grouping::Place,
        }
    }
}

impl GridOptions {
    /// Checks the label options of every cell.
    fn check(&self, label: &label::Options) -> Result<(), OutOfRange> {
        // The options of a cell come from the grid: name its keys, not those of `label`.
        let of_grid = |text: &str| text.replace("label.", "evaluate.grid.");
        self.label_options(label).iter().try_for_each(label::Options::check).map_err(|error| {
            OutOfRange::new(of_grid(&error.key), &error.found, of_grid(&error.expected))
        })
    }

    /// The label options of each cell.
    pub fn label_options(&self, label: &label::Options) -> Vec<label::Options> {
        let mut cells = Vec::new();
        for &min_travel_gap_m in &self.min_travel_gap_m {
            for &negative_min_m in &self.negative_min_m {
                for &positive_radius_m in &self.positive_radius_m {
                    cells.push(label::Options {
                        positive_radius_m,
                        negative_min_m,
                        min_travel_gap_m,
                        ..label.clone()
                    });
                }
            }
        }
        cells
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(options: &Options) -> String {
        options.check(&label::Options::default()).unwrap_err().to_string()
    }

    #[test]
    fn the_defaults_are_in_range() {
        assert_eq!(Options::default().check(&label::Options::default()), Ok(()));
    }

    #[test]
    fn a_value_out_of_range_is_named_with_its_key() {
        let defaults = Options::default;
        assert_eq!(
            error(&Options { folds: 1, ..defaults() }),
            "`evaluate.folds` is 1, expected 2 or more"
        );
        assert_eq!(
            error(&Options { folds: 2000, ..defaults() }),
            "`evaluate.folds` is 2000, expected at most `label.pairs_per_class`, which is 1218"
        );
        assert_eq!(
            error(&Options { groupings: vec![Grouping::Pair; 2], ..defaults() }),
            "`evaluate.groupings` is [pair, pair], expected each grouping once"
        );
        let grid = GridOptions {
            positive_radius_m: vec![1.5],
            negative_min_m: vec![50.0, 1.0],
            ..GridOptions::default()
        };
        assert_eq!(
            error(&Options { grid, ..defaults() }),
            "`evaluate.grid.negative_min_m` is 1, expected `evaluate.grid.positive_radius_m` or more"
        );
    }

    /// Two radii, two distances and one gap are four cells. The other label options stay.
    #[test]
    fn the_grid_has_a_cell_for_every_combination() {
        let grid = GridOptions {
            positive_radius_m: vec![1.0, 2.0],
            negative_min_m: vec![25.0, 50.0],
            ..GridOptions::default()
        };
        let label = label::Options { pairs_per_class: 7, ..label::Options::default() };
        let cells = grid.label_options(&label);
        let values: Vec<_> =
            cells.iter().map(|c| (c.positive_radius_m, c.negative_min_m)).collect();
        assert_eq!(values, [(1.0, 25.0), (2.0, 25.0), (1.0, 50.0), (2.0, 50.0)]);
        assert!(cells.iter().all(|c| c.pairs_per_class == 7));
    }
}
