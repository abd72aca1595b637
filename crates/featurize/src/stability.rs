//! How much features change when the scanner spins twice as fast.

use dataset::{Scan, Unusable, quantile};

use crate::{Featurizer, Options};

/// How much each feature changes when every other return is removed, `(n_features,)`. The result is
/// the median of |f - f of the thinned scan| over the scans, divided by the interquartile range of f
/// over the scans.
///
/// The result is 0 if a feature never changes. It is infinite if a feature changes and half of the
/// scans share one value. A scan is left out if no features can be computed from it or from its
/// thinned copy. The results are NaN if no scan is left.
pub fn stability<'a>(options: &Options, scans: impl IntoIterator<Item = &'a Scan>) -> Vec<f64> {
    let n_features = options.set.feature_names().len();
    let mut featurizer = Featurizer::new(options);
    let mut columns = vec![(Vec::new(), Vec::new()); n_features];
    let (mut full, mut half) = (vec![0.0; n_features], vec![0.0; n_features]);
    for scan in scans {
        let mut compute_both = || -> Result<(), Unusable> {
            featurizer.features(scan, &mut full)?;
            featurizer.features(&thinned(scan), &mut half)
        };
        if compute_both().is_err() {
            continue;
        }
        for (((values, changes), f), g) in columns.iter_mut().zip(&full).zip(&half) {
            values.push(*f);
            changes.push((f - g).abs());
        }
    }
    let relative = |(mut values, mut changes): (Vec<f64>, Vec<f64>)| {
        values.sort_unstable_by(f64::total_cmp);
        changes.sort_unstable_by(f64::total_cmp);
        let range = quantile(&values, 0.75) - quantile(&values, 0.25);
        let change = quantile(&changes, 0.5);
        if change.abs() < f64::MIN_POSITIVE { change } else { change / range }
    };
    columns.into_iter().map(relative).collect()
}

/// The scan with every other return removed. The first return stays.
pub fn thinned(scan: &Scan) -> Scan {
    let every_other = |values: &[f32]| values.iter().copied().step_by(2).collect();
    Scan { x_m: every_other(&scan.x_m), y_m: every_other(&scan.y_m), ..scan.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// For circles of 200 and more returns, thinning halves `size` and does not change
    /// `circle_radius`. The sizes 200, 240, 280, 320 and 360 have the quartiles 240 and 320, and
    /// their median change is 140, hence 140 / 80.
    #[test]
    fn thinning_halves_the_size_and_keeps_the_radius() {
        let circle = |n: usize| {
            let angle = move |k: usize| k as f32 / n as f32 * std::f32::consts::TAU;
            let r = n as f32 / 40.0;
            let x_m = (0..n).map(|k| r * angle(k).cos()).collect();
            let y_m = (0..n).map(|k| r * angle(k).sin()).collect();
            Scan { x_m, y_m, coverage_deg: 360.0, ..Scan::default() }
        };
        let scans = [200, 240, 280, 320, 360].map(circle);
        let options = Options::default();
        let found = stability(&options, &scans);
        let of = |name| found[options.set.feature_names().iter().position(|n| *n == name).unwrap()];
        assert!((of("size") - 140.0 / 80.0).abs() < 1e-12, "{}", of("size"));
        assert!(of("circle_radius") < 1e-5, "{}", of("circle_radius"));
        assert!(stability(&options, &[]).iter().all(|f| f.is_nan()));
    }
}
