//! What a task reports on stdout: numbers in `run.json`, sentences for people.

use std::fmt;

use serde::{Deserialize, Serialize};

/// The result of a task in numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "summary", rename_all = "snake_case", deny_unknown_fields)]
pub(crate) enum Summary {
    /// A simulated drive.
    Simulated {
        log: String,
        length_m: f64,
        duration_s: f64,
        n_revolutions: u64,
        n_packets: u64,
        n_files: u64,
    },
    /// An ingested log.
    Ingested { log: String, n_scans: u64, n_poses: u64 },
    /// The keyframes of a log.
    Subsampled { log: String, n_keyframes: u64, length_m: f64 },
    /// Labelled pairs.
    Labelled { n_pairs_per_class: u64, candidates: label::Candidates },
    /// The features of a log.
    Featurized { log: String, set: String, n_features: u64, n_keyframes: u64 },
    /// The registered scans of a log.
    Registered { log: String, n_scans: u64, n_degenerate: u64, length_m: f64 },
    /// The candidates of a log.
    Detected { log: String, n_places: u64, n_candidates: u64 },
    /// The candidates between the drives of a site.
    DetectedBetween { site: String, n_drives: u64, n_candidates: u64 },
    /// The closures of a log, and the number of poses of its trajectory.
    Optimized { log: String, n_accepted: u64, n_rejected: u64, n_poses: u64 },
    /// The closures between the drives of a site, and its maps.
    Joined { site: String, n_drives: u64, n_maps: u64, n_accepted: u64, n_rejected: u64 },
    /// The absolute references of a log, compared with its map.
    Referenced {
        log: String,
        source: String,
        n_used: u64,
        n_outliers: u64,
        mean_m: f64,
        rms_m: f64,
        largest_m: f64,
        rms_stds: f64,
    },
    /// The closures and the trajectory of a segment of a log, compared with the ground truth.
    Closed {
        log: String,
        segment: u32,
        n_revisits: u64,
        n_closed: u64,
        n_false: u64,
        n_judged: u64,
        ate_rmse_m: Option<f64>,
    },
    /// The closures between the drives of a site, compared with the ground truth, and the error of the worst
    /// of its maps.
    ClosedBetween {
        site: String,
        n_revisits: u64,
        n_closed: u64,
        n_false: u64,
        n_judged: u64,
        ate_rmse_m: f64,
    },
    /// A saved model, with its error by each grouping.
    Trained { model: String, version: String, rounds: u64, errors: Vec<GroupingError> },
    /// Errors of a learner by a grouping, after some rounds.
    Evaluated { learner: String, grouping: String, errors: Vec<RoundsError> },
    /// No learner was tested on ground that it was not trained on.
    NotValidatedOnUnseenGround,
    /// A file for people.
    Written { file: String },
}

/// The error by a grouping, 0 to 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct GroupingError {
    pub(crate) grouping: String,
    pub(crate) error: f64,
}

/// The error after so many rounds, 0 to 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct RoundsError {
    /// None for a baseline, which has no rounds.
    pub(crate) rounds: Option<u64>,
    pub(crate) error: f64,
}

impl Summary {
    /// Closures compared with the ground truth.
    fn closed(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Closed { log, segment, n_revisits, n_closed, n_false, n_judged, ate_rmse_m } => {
                f.write_str(log)?;
                if 0 < *segment {
                    write!(f, " (segment {segment})")?;
                }
                write!(
                    f,
                    ": {n_closed} of {n_revisits} revisits closed, {n_false} of {n_judged} closures false"
                )?;
                match ate_rmse_m {
                    Some(ate_rmse_m) => write!(f, ", trajectory error {ate_rmse_m:.3} m"),
                    None => Ok(()),
                }
            }
            Self::ClosedBetween { site, n_revisits, n_closed, n_false, n_judged, ate_rmse_m } => {
                write!(
                    f,
                    "site {site}: {n_closed} of {n_revisits} revisits of an earlier drive closed, {n_false} of {n_judged} closures between drives false, map error {ate_rmse_m:.3} m"
                )
            }
            _ => Ok(()),
        }
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Simulated { log, length_m, duration_s, n_revolutions, n_packets, n_files } => {
                write!(
                    f,
                    "{log}: {length_m:.0} m in {duration_s:.0} s, {n_revolutions} revolutions, {n_packets} packets"
                )?;
                if *n_files > 1 {
                    write!(f, " in {n_files} files")?;
                }
                Ok(())
            }
            Self::Ingested { log, n_scans, n_poses } => {
                write!(f, "{log}: {n_scans} scans, {n_poses} poses")
            }
            Self::Subsampled { log, n_keyframes, length_m } => {
                write!(f, "{log}: {n_keyframes} keyframes along {length_m:.0} m")
            }
            Self::Labelled { n_pairs_per_class: n, candidates } => write!(
                f,
                "{n} of {} positive and {n} of {} negative pairs; {}",
                candidates.positive,
                candidates.negative,
                candidates.left_out()
            ),
            Self::Featurized { log, set, n_features, n_keyframes } => {
                write!(f, "{log}: {n_features} features ({set}) of {n_keyframes} keyframes")
            }
            Self::Registered { log, n_scans, n_degenerate, length_m } => write!(
                f,
                "{log}: {n_scans} scans along {length_m:.0} m, {n_degenerate} with an unknown direction"
            ),
            Self::Detected { log, n_places, n_candidates } => {
                write!(f, "{log}: {n_candidates} candidates among {n_places} places")
            }
            Self::DetectedBetween { site, n_drives, n_candidates } => {
                write!(f, "site {site}: {n_candidates} candidates between {n_drives} drives")
            }
            Self::Joined { site, n_drives, n_maps, n_accepted, n_rejected } => write!(
                f,
                "site {site}: {n_drives} drives in {n_maps} {}; {n_accepted} closures between drives accepted, {n_rejected} rejected",
                if *n_maps == 1 { "map" } else { "maps" }
            ),
            Self::Optimized { log, n_accepted, n_rejected, n_poses } => write!(
                f,
                "{log}: {n_accepted} closures accepted, {n_rejected} rejected; {n_poses} poses"
            ),
            Self::Referenced {
                log, source, n_used, n_outliers, mean_m, rms_m, largest_m, ..
            } => {
                write!(
                    f,
                    "{log}: {n_used} references of {source} agree with the map within {largest_m:.2} m (mean {mean_m:.2} m, root mean square {rms_m:.2} m), {n_outliers} outliers"
                )
            }
            Self::Closed { .. } => self.closed(f),
            Self::ClosedBetween { .. } => self.closed(f),
            Self::Trained { model, version, rounds, errors } => {
                let errors: Vec<String> = errors
                    .iter()
                    .map(|of| format!("{:.1} % by {}", of.error * 100.0, of.grouping))
                    .collect();
                write!(f, "{model} {version}: error {} after round {rounds}", errors.join(", "))
            }
            Self::Evaluated { learner, grouping, errors } => {
                let errors: Vec<String> = errors
                    .iter()
                    .map(|of| match of.rounds {
                        Some(rounds) => format!("{:.1} % after round {rounds}", of.error * 100.0),
                        None => format!("{:.1} %", of.error * 100.0),
                    })
                    .collect();
                write!(f, "{learner} by {grouping}: error {}", errors.join(", "))
            }
            Self::NotValidatedOnUnseenGround => {
                f.write_str("not validated on unseen ground: no result for the grouping `place`")
            }
            Self::Written { file } => f.write_str(file),
        }
    }
}
