/// The quantile of sorted values, interpolated linearly between order statistics (Hyndman and Fan
/// 1996, definition 7). NaN where there are no values.
///
/// `share` is between 0 (the smallest value) and 1 (the largest).
///
/// ```
/// assert_eq!(dataset::quantile(&[1.0, 2.0, 4.0], 0.75), 3.0);
/// ```
pub fn quantile(sorted: &[f64], share: f64) -> f64 {
    match sorted.len().checked_sub(1) {
        Some(last) => value_at_rank(sorted, last as f64 * share),
        None => f64::NAN,
    }
}

/// The value at a rank between 0 and `sorted.len() - 1`, interpolated linearly between the
/// neighbours. The ranks are what a quantile is computed from; percentiles of a fixed list can
/// compute them once.
///
/// # Panics
///
/// Where there are no values.
pub fn value_at_rank(sorted: &[f64], rank: f64) -> f64 {
    let last = sorted.len() - 1;
    let below = (rank as usize).min(last);
    let above = (below + 1).min(last);
    sorted[below] + (sorted[above] - sorted[below]) * (rank - below as f64)
}

#[cfg(test)]
mod tests {
    use super::quantile;

    /// 0, 1, ..., 100: 2.5 % of the way from 0 to 100 is 2.5.
    #[test]
    fn quantiles_computed_by_hand() {
        let values: Vec<f64> = (0..=100).map(f64::from).collect();
        assert!((quantile(&values, 0.025) - 2.5).abs() < 1e-9);
        assert!((quantile(&values, 0.975) - 97.5).abs() < 1e-9);
        assert_eq!(quantile(&[3.0], 0.3), 3.0);
        assert!(quantile(&[], 0.5).is_nan());
    }
}
