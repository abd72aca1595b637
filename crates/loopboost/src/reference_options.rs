//! The options of absolute references: `optimize.references`.

use anyhow::{Result, anyhow};
use dataset::OutOfRange;
use ingest::{PlanarPose, ReferenceTopic, Stamp};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A source of absolute references. Set one of `topic` and `file`.
#[derive(Debug, Clone, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct ReferenceOptions {
    /// Topic of the logs with `NavSatFix` messages, or with poses in the frame of the references
    /// (`PoseStamped`, `PoseWithCovarianceStamped`, `Odometry`, `foxglove.PoseInFrame`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) topic: Option<String>,
    /// CSV file with surveyed positions or poses: a header with the columns `stamp_ns` (or `time_s`), `x_m` and
    /// `y_m`, and, if wanted, `log`, `heading_rad`, `std_m` and `std_rad`. The path is relative to the pipeline
    /// file, and `{log}` stands for the name of the log.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) file: Option<String>,
    /// The frame whose messages are used, if several publishers use the topic (`header.frame_id`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) frame_id: Option<String>,
    /// The time of a message that is used: `header` or `log`.
    pub(crate) stamp: Stamp,
    /// Standard deviation of a position in each direction \[m\], instead of the one that messages state, and for rows
    /// of a file that state none. Needed for poses without one. For fixes without one, the default is 3.3 m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) std_m: Option<f64>,
    /// The same for the heading \[deg\]. Headings without a standard deviation are not used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) std_deg: Option<f64>,
    /// Time over which errors are correlated \[s\]. The measurements of twice this time count as about one. The
    /// default is 60 s for a topic, and 0 for a file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) correlation_secs: Option<f64>,
    /// The measured point on the robot: the antenna. Without it, the transforms of the log give the place of the
    /// frame of `NavSatFix` messages; poses are those of the robot.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) mount: Option<PlanarPose>,
}

/// The default of `correlation_secs` for a topic \[s\]. Errors of satellite receivers last from seconds (multipath
/// in motion) to half an hour (the ionosphere). This value is a guess between them.
const TOPIC_CORRELATION_SECS: f64 = 60.0;

impl ReferenceOptions {
    pub(crate) fn check(&self) -> Result<()> {
        match (&self.topic, &self.file) {
            (Some(_), None) | (None, Some(_)) => {}
            (found, _) => {
                return Err(anyhow!(
                    "an entry of `optimize.references` sets {}, expected one of `topic` and `file`",
                    if found.is_some() {
                        "both `topic` and `file`"
                    } else {
                        "neither `topic` nor `file`"
                    }
                ));
            }
        }
        if self.file.is_some() && self.frame_id.is_some() {
            return Err(anyhow!(
                "an entry of `optimize.references` sets `file` and `frame_id`, but `frame_id` is only used with `topic`; remove one of them"
            ));
        }
        let fail = |key: &str, found: f64, expected: &str| {
            Err(OutOfRange::new(format!("optimize.references.{key}"), found, expected).into())
        };
        for (key, found) in [("std_m", self.std_m), ("std_deg", self.std_deg)] {
            if let Some(found) = found.filter(|found| !(found.is_finite() && 0.0 < *found)) {
                return fail(key, found, "more than 0");
            }
        }
        let secs = self.correlation_secs.filter(|secs| !(secs.is_finite() && 0.0 <= *secs));
        if let Some(found) = secs {
            return fail("correlation_secs", found, "0 or more");
        }
        match self.mount.and_then(|mount| mount.not_finite()) {
            Some((key, found)) => fail(&format!("mount.{key}"), found, "a finite number"),
            None => Ok(()),
        }
    }

    /// What `ingest` reads; `None` for a file.
    pub(crate) fn of_topic(&self) -> Option<ReferenceTopic> {
        let Self { frame_id, stamp, mount, .. } = self.clone();
        Some(ReferenceTopic { topic: self.topic.clone()?, frame_id, stamp, mount })
    }

    pub(crate) fn correlation_secs(&self) -> f64 {
        let default = if self.topic.is_some() { TOPIC_CORRELATION_SECS } else { 0.0 };
        self.correlation_secs.unwrap_or(default)
    }

    /// Its name in messages.
    pub(crate) fn name(&self) -> &str {
        self.topic.as_deref().or(self.file.as_deref()).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_that_contradict_each_other_are_refused() {
        let error = |text: &str| {
            let options: ReferenceOptions = toml::from_str(text).unwrap();
            options.check().unwrap_err().to_string()
        };
        assert!(error("").contains("neither `topic` nor `file`"));
        assert!(error("topic = \"/a\"\nfile = \"b\"").contains("both `topic` and `file`"));
        assert!(error("file = \"b\"\nframe_id = \"c\"").contains("only used with `topic`"));
        let found = error("topic = \"/a\"\nstd_m = 0.0");
        assert!(found.contains("`optimize.references.std_m` is 0"), "{found}");
        let found = error("topic = \"/a\"\ncorrelation_secs = -1.0");
        assert!(found.contains("`optimize.references.correlation_secs` is -1"), "{found}");
    }

    #[test]
    fn only_topics_are_correlated_by_default() {
        let topic: ReferenceOptions = toml::from_str("topic = \"/a\"").unwrap();
        let file: ReferenceOptions = toml::from_str("file = \"a\"").unwrap();
        assert_eq!((topic.correlation_secs(), file.correlation_secs()), (60.0, 0.0));
        let set = ReferenceOptions { correlation_secs: Some(5.0), ..topic };
        assert_eq!(set.correlation_secs(), 5.0);
    }
}
