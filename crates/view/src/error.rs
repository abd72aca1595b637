/// Why a file could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ViewError {
    /// The MCAP file cannot be written.
    #[error("cannot write the MCAP file")]
    Mcap(#[from] mcap::McapError),
    /// The image cannot be written.
    #[error("cannot write the PNG image")]
    Png(#[from] png::EncodingError),
    /// A time that the formats of MCAP and Foxglove cannot hold.
    #[error("a pose at {stamp_ns} ns, expected a time after 1970")]
    BeforeEpoch {
        /// The time \[ns since the epoch\].
        stamp_ns: i64,
    },
    /// No scan has a return.
    #[error("the scans of the map have no returns")]
    EmptyMap,
    /// The poses are too far apart for an image.
    #[error(
        "the map covers {width_m:.0} m x {height_m:.0} m, expected at most {max_squares} squares of {square_m} m"
    )]
    MapTooLarge {
        /// Size along x \[m\].
        width_m: f64,
        /// Size along y \[m\].
        height_m: f64,
        /// Largest number of squares.
        max_squares: f64,
        /// Side of a square \[m\].
        square_m: f64,
    },
}
