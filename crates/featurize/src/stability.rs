//! How far features move when a scanner turns twice as fast.

use dataset::{Scan, Unusable};

use crate::{Featurizer, Options};

/// Of each feature the median of |f - f of every other return|, as a share of the interquartile
/// range of f over the scans, `(n_features,)`; 0 where a feature never moves, infinite where it
/// moves and half of the scans have one value. Scans of which no features can be computed, whole or
/// thinned, are left out; the values are NaN where none is left.
pub fn stability<'a>(options: &Options, scans: impl IntoIterator<Item = &'a Scan>) -> Vec<f64> {
    let n_features = options.set.feature_names().len();
    let mut featurizer = Featurizer::new(options);
    let mut columns = vec![(Vec::new(), Vec::new()); n_features];
    let (mut whole, mut half) = (vec![0.0; n_features], vec![0.0; n_features]);
    for scan in scans {
        let mut both = || -> Result<(), Unusable> {
            featurizer.features(scan, &mut whole)?;
            featurizer.features(&thinned(scan), &mut half)
        };
        if both().is_err() {
            continue;
        }
        for (((values, moves), f), g) in columns.iter_mut().zip(&whole).zip(&half) {
            values.push(*f);
            moves.push((f - g).abs());
        }
    }
    let relative = |(mut values, mut moves): (Vec<f64>, Vec<f64>)| {
        let range = quantile(&mut values, 0.75) - quantile(&mut values, 0.25);
        let moved = quantile(&mut moves, 0.5);
        if moved.abs() < f64::MIN_POSITIVE { moved } else { moved / range }
    };
    columns.into_iter().map(relative).collect()
}

/// Every other return, from the first.
pub fn thinned(scan: &Scan) -> Scan {
    let every_other = |values: &[f32]| values.iter().copied().step_by(2).collect();
    Scan { x_m: every_other(&scan.x_m), y_m: every_other(&scan.y_m), ..scan.clone() }
}

/// Linear between neighbours; NaN of no values.
fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let Some(last) = values.len().checked_sub(1) else { return f64::NAN };
    let place = last as f64 * share;
    let (k, next) = (place as usize, (place as usize + 1).min(last));
    values[k] + (values[next] - values[k]) * (place - k as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_by_hand() {
        assert_eq!(quantile(&mut [4.0, 1.0, 2.0], 0.75), 3.0);
        assert!(quantile(&mut [], 0.5).is_nan());
    }

    /// Circles of 200 and more returns: thinning halves `size`, and leaves `circle_radius` alone.
    /// Sizes 200, 240, 280, 320 and 360 have the quartiles 240 and 320, and move by 140 in the
    /// median: 140 / 80.
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
