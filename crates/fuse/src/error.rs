use dataset::{Losses, OutOfRange};

/// The reason why a drive could not be fused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FuseError {
    /// An option is out of range.
    #[error(transparent)]
    Option(#[from] OutOfRange),
    /// There are fewer than two usable wheel samples.
    #[error(
        "found {found} usable wheel samples{}, expected 2 or more; check the wheel topic and check that its stamps increase",
        in_parentheses(.losses)
    )]
    TooFewWheelSamples {
        /// Number of usable wheel samples.
        found: usize,
        /// The samples that could not be used.
        losses: Losses,
    },
    /// The time ranges of wheels and IMU do not overlap.
    #[error(
        "0 of {n_imu} IMU samples are used: the wheels are stamped from {:.3} to {:.3} s and the IMU from {:.3} to {:.3} s; expected the same clock. Correct the stamps of one topic, or remove `ingest.pose.imu` to use the wheels alone",
        .wheels_ns.0 as f64 * 1e-9, .wheels_ns.1 as f64 * 1e-9, .imu_ns.0 as f64 * 1e-9, .imu_ns.1 as f64 * 1e-9
    )]
    NoCommonTime {
        /// Number of IMU samples.
        n_imu: usize,
        /// First and last stamp of the wheels \[ns\].
        wheels_ns: (i64, i64),
        /// First and last stamp of the IMU \[ns\].
        imu_ns: (i64, i64),
    },
}

fn in_parentheses(losses: &Losses) -> String {
    match losses.is_empty() {
        true => String::new(),
        false => format!(" ({losses})"),
    }
}
