//! The kinds of [notes](crate::Note), with code, severity and sentence.

use serde::{Deserialize, Serialize};

use crate::codes::codes;
use crate::words::{after_jumps, count, times};

/// ``log `a` `` or ``logs `a`, `b`, `c`, ...``
fn of_logs(logs: &[String]) -> String {
    const MAX_NAMED: usize = 3;
    let names: Vec<String> = logs.iter().take(MAX_NAMED).map(|log| format!("`{log}`")).collect();
    let more = if MAX_NAMED < logs.len() { ", ..." } else { "" };
    format!("{} {}{more}", if logs.len() == 1 { "log" } else { "logs" }, names.join(", "))
}

codes! {
    /// The kinds of notes. `docs/messages.md` gives meaning, usual cause and remedy of each.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    pub enum NoteKind (s) {
        // Topics and files.

        /// The channel names no schema.
        Warning "no_schema" NoSchema {
            /// The type whose decoder accepts the messages.
            read_as: String,
        } => "the topic has no schema; its messages were read as {read_as}, the only type that decodes them";
        /// A drive was read from several files.
        Info "split_drive" SplitDrive {
            /// The files, in order of time.
            files: Vec<String>,
        } => "read from {} files of one drive: {}", files.len(), files.join(", ");

        // Pipelines and sites.

        /// A stage refuses the pipeline that `inspect` suggests.
        Error "pipeline_refused" PipelineRefused {
            /// The stage, by name.
            stage: String,
            /// Its error.
            error: String,
        } => "`{stage}` refuses the suggested pipeline: {error}";
        /// The pipeline has no source of poses for the log.
        Info "no_pose_source" NoPoseSource
            => "no poses: the pipeline has no `ingest.pose`; without poses, the scans cannot be labelled";
        /// The log cannot be read with the default of an option, so the suggested pipeline sets it.
        Warning "option_needed" OptionNeeded {
            /// The option, with its suggested value.
            option: String,
            /// What the log contains.
            reason: String,
        } => "the suggested pipeline sets `{option}`, because {reason}; check that this is right";
        /// A drive of a folder cannot be read with the pipeline for the others.
        Warning "drive_differs" DriveDiffers {
            /// What it needs instead, or why it cannot be read.
            difference: String,
        } => "the suggested pipeline does not fit this drive: {difference}";
        /// Two pose topics of a log disagree in extent or revisits.
        Warning "pose_topics_disagree" PoseTopicsDisagree {
            /// The other topic. The subject is the topic that the pipeline uses.
            other: String,
            /// Extent of the path by the topic: root mean square distance from its centre \[m\].
            extent_m: f64,
            /// Extent of the path by the other topic \[m\].
            other_extent_m: f64,
            /// Revisits by the topic: pairs of places.
            n_revisits: u64,
            /// Those that are farther apart than `apart_m` by the other topic.
            n_apart: u64,
            /// Revisits by the other topic.
            other_n_revisits: u64,
            /// Those that are farther apart than `apart_m` by the topic.
            other_n_apart: u64,
            /// A revisit by one topic is contradicted if it is farther apart by the other \[m\].
            apart_m: f64,
        } => "topic `{other}` disagrees with these poses: its path has an extent of {other_extent_m:.1} m, and this path has an extent of {extent_m:.1} m (root mean square distance from the centre); {n_apart} of {n_revisits} revisits are more than {apart_m} m apart by `{other}`, and {other_n_apart} of {other_n_revisits} revisits by `{other}` are more than {apart_m} m apart here; labels are only right if the poses do not drift: check which topic is right";
        /// Logs of one site have poses in a frame of odometry, which starts at a new origin in each log.
        Warning "site_in_odometry_frame" SiteInOdometryFrame {
            /// The site.
            site: String,
            /// The frame of the poses.
            frame: String,
            /// The logs with poses in that frame.
            logs: Vec<String>,
        } => "site `{site}`: the poses of {} are in frame `{frame}`, which starts at a new origin in each log and drifts; pairs of two logs may have wrong labels: use poses in a map frame that the logs share, or remove `site`", of_logs(logs);
        /// All logs of a site start at the origin.
        Warning "site_starts_at_origin" SiteStartsAtOrigin {
            /// The site.
            site: String,
            /// The logs.
            logs: Vec<String>,
            /// Largest distance of a first pose from the origin \[m\].
            farthest_m: f64,
        } => "site `{site}`: the first poses of {} are all at the origin (within {farthest_m:.2} m), as if each log had a map frame of its own; pairs of two logs may have wrong labels: check that the logs share a map frame, or remove `site`", of_logs(logs);

        /// Messages of other frames were not used.
        Info "other_frames" OtherFrames {
            /// The frames, with their numbers of messages.
            frames: String,
        } => "messages of other frames were not used: {frames}";
        /// The stamps step back.
        Warning "stamps_step_back" StampsStepBack {
            /// Steps.
            n_steps: u64,
            /// The largest \[s\].
            largest_s: f64,
            /// Log time of the first step \[ns\].
            log_ns: u64,
            /// Whether the log times step back, too.
            with_log: bool,
            /// The option that selects log times.
            option: String,
        } => "the stamps step back by up to {largest_s:.2} s, {}, first at the log time {log_ns} ns: scans and poses of different times have the same stamps there; {}",
            times(*n_steps),
            match with_log {
                true => "the log times step back, too: split the log there".to_owned(),
                false => format!("the log times do not step back: set `{option} = \"log\"` to use them, or split the log there"),
            };
        /// The stamps step against the log times.
        Warning "stamps_step_against_log" StampsStepAgainstLog {
            /// Steps.
            n_steps: u64,
            /// The largest \[s\].
            largest_s: f64,
            /// Log time of the first step \[ns\].
            log_ns: u64,
            /// The option that selects log times.
            option: String,
        } => "the stamps step by up to {largest_s:+.2} s against the log times, {}, first at the log time {log_ns} ns; a clock was set there: set `{option} = \"log\"` to use log times, or split the log there",
            times(*n_steps);
        /// Two topics are stamped by different clocks.
        Warning "stamp_offsets_differ" StampOffsetsDiffer {
            /// The other topic.
            other: String,
            /// Log time minus stamp \[s\].
            delay_s: f64,
            /// Log time minus stamp of the other topic \[s\].
            other_delay_s: f64,
        } => "log time minus stamp is {delay_s:+.3} s, but {other_delay_s:+.3} s on topic `{other}`: the clocks that stamp the two topics differ by about {:.3} s, and scans are placed at poses of another time; synchronise the clocks, or set `ingest.lidar.stamp` and `ingest.pose.stamp` to \"log\"", (delay_s - other_delay_s).abs();
        /// Successive messages have equal stamps.
        Warning "equal_stamps" EqualStamps {
            /// Messages with the stamp of the message before.
            n_equal: u64,
            /// All messages.
            n_messages: u64,
            /// The option that selects log times.
            option: String,
        } => "{n_equal} of {n_messages} messages have the stamp of the message before: the clock that stamps them is too coarse, or stands still; set `{option} = \"log\"` to use log times";
        /// Messages are not in order of their stamps.
        Info "messages_out_of_order" MessagesOutOfOrder {
            /// Messages.
            n_messages: u64,
        } => "{} stamped earlier than a message before", count(*n_messages, "message");

        // Labels.

        /// One place would have more than its share of the pairs of a class.
        Info "place_share_limited" PlaceShareLimited {
            /// `positive` or `negative`.
            class: String,
            /// Pairs drawn.
            n_pairs: u64,
            /// Largest number of them from one place.
            n_limit: u64,
            /// Pairs of the place without the limit.
            n_without: u64,
            /// Width of a place \[m\].
            place_m: f64,
            /// The site of the place.
            site: String,
            /// Its centre \[m\].
            x_m: f64,
            /// Its centre \[m\].
            y_m: f64,
        } => "at most {n_limit} of {n_pairs} {class} pairs were drawn from one place {place_m} m wide (`label.max_place_share`); without this limit, {n_without} would be from the place at ({x_m}, {y_m}) m of site `{site}`";
        /// The pairs of a class come from too few places.
        Warning "few_places" FewPlaces {
            /// `positive` or `negative`.
            class: String,
            /// Pairs drawn.
            n_pairs: u64,
            /// Largest number of them that `label.max_place_share` allows from one place.
            n_limit: u64,
            /// Pairs of the place with the most pairs.
            n_largest: u64,
            /// Places with candidates.
            n_places: u64,
            /// Number of pairs that can be drawn within the limit; 0 if there is none.
            n_enough: u64,
            /// Width of a place \[m\].
            place_m: f64,
            /// The site of the place with the most pairs.
            site: String,
            /// Its centre \[m\].
            x_m: f64,
            /// Its centre \[m\].
            y_m: f64,
        } => "{n_largest} of {n_pairs} {class} pairs are from one place {place_m} m wide, at ({x_m}, {y_m}) m of site `{site}`; expected at most {n_limit} (`label.max_place_share`), but the {n_places} places with {class} pairs do not have enough of them: add logs with {class} pairs at other places{}",
            match n_enough {
                0 => String::new(),
                n => format!(", or set `label.pairs_per_class` to {n}"),
            };
        /// Pairs were left out because of their heights.
        Info "pairs_at_other_height" PairsAtOtherHeight {
            /// Pairs.
            n_pairs: u64,
            /// The limit \[m\].
            max_height_difference_m: f64,
        } => "{} close to each other in the plane, but more than {max_height_difference_m} m apart in height, as on two floors: not used as positives", count(*n_pairs, "pair");
        /// Pairs were left out because of their heights, which drift or noise may explain.
        Warning "heights_in_doubt" HeightsInDoubt {
            /// Pairs.
            n_pairs: u64,
            /// The limit \[m\].
            max_height_difference_m: f64,
            /// Revisits within the limit.
            n_revisits: u64,
            /// Revisits beyond the limit.
            n_revisits_left_out: u64,
            /// Positives with more than half of the allowed difference.
            n_near_limit: u64,
        } => "{} close to each other in the plane, but more than {max_height_difference_m} m apart in height: not used as positives; this leaves out {n_revisits_left_out} of {} revisits; {n_near_limit} of the positives differ by more than half of this height; if the robot drove on one floor only, its heights drift: raise `label.max_height_difference_m`",
            count(*n_pairs, "pair"), n_revisits + n_revisits_left_out;
        /// Pairs were left out because a log has several coordinate frames, or a run has several maps of a site.
        Info "pairs_between_frames" PairsBetweenFrames {
            /// Pairs.
            n_pairs: u64,
        } => "{} not used: the poses of a log or a site are in several coordinate frames or maps, and the position of one frame in another is not known", count(*n_pairs, "pair");
        /// The poses of a map cannot decide the labels of some pairs.
        Info "undecided_pairs" UndecidedPairs {
            /// Pairs within the positive radius by less than two standard deviations.
            n_positive: u64,
            /// Pairs beyond the negative radius by less than two standard deviations.
            n_negative: u64,
        } => "{} within the positive radius and {n_negative} beyond the negative radius by less than two standard deviations of their distance: not used", count(*n_positive, "pair");
        /// The poses of a map cannot decide the labels of most pairs of a class.
        Warning "poses_too_uncertain" PosesTooUncertain {
            /// Pairs within the positive radius by less than two standard deviations.
            n_positive: u64,
            /// Pairs within the positive radius by more.
            n_decided_positive: u64,
            /// Pairs beyond the negative radius by less than two standard deviations.
            n_negative: u64,
            /// Pairs beyond the negative radius by more.
            n_decided_negative: u64,
        } => "the poses of the map are too uncertain to decide most labels: {n_positive} of {} positive pairs and {n_negative} of {} negative pairs are less than two standard deviations of their distance from the radius, and not used; a map with more closures decides more", n_positive + n_decided_positive, n_negative + n_decided_negative;
        /// The labels rest on a map.
        Info "labels_from_map" LabelsFromMap {
            /// The run that made the map, as the pipeline names it.
            run: String,
            /// Number of the map in the run.
            map: u32,
            /// The logs with keyframes in the map.
            logs: Vec<String>,
            /// Accepted closures between scans of the map.
            n_closures: u64,
        } => "the labels of {} rest on map {map} of the run {run}, with {}", of_logs(logs), count(*n_closures, "closure");
        /// A map that labels rest on has no closure.
        Warning "map_without_closures" MapWithoutClosures {
            /// The run that made the map, as the pipeline names it.
            run: String,
            /// Number of the map in the run.
            map: u32,
            /// The logs with keyframes in the map.
            logs: Vec<String>,
        } => "the labels of {} rest on map {map} of the run {run}, which has no closure: its poses drift, and there are no revisits in it to learn from", of_logs(logs);
        /// No scan of a log could be located in the map.
        Warning "not_located" NotLocated {
            /// Number of scans.
            n_scans: u64,
            /// Path by scan matching \[m\].
            travel_m: f64,
        } => "none of {} was located in the map, over {travel_m:.1} m of path: no pose was found from enough places along the path, or two poses fit nearly as well", count(*n_scans, "scan");
        /// A log could not be read by `locate`. The other logs were located.
        Error "log_not_located" LogNotLocated {
            /// What is wrong with it.
            reason: String,
        } => "the log was left out: {reason}";
        /// A position in the map was lost.
        Info "position_lost" PositionLost {
            /// How often.
            n: u64,
            /// Scans after the first position that were not located.
            n_scans: u64,
        } => "the position was lost {}: the scans stopped fitting the map; {} after the first position have none", times(*n), count(*n_scans, "scan");
        /// Labels were compared with the ground truth.
        Info "labels_compared" LabelsCompared {
            /// Pairs with a true pose of both scans.
            n_pairs: u64,
            /// Pairs without.
            n_without_truth: u64,
            /// Pairs for which the ground truth gives the other label, or none.
            n_wrong: u64,
            /// Pairs for which the ground truth gives the other label.
            n_opposite: u64,
        } => "{n_wrong} of {} differ from the labels by the ground truth ({:.2} %), {n_opposite} of them are of the other class, the others between the two radii", count(*n_pairs, "label"), 100.0 * *n_wrong as f64 / (*n_pairs).max(1) as f64;
        /// Two logs have the same scans at the same poses.
        Warning "same_scans_in_two_logs" SameScansInTwoLogs {
            /// The other log.
            other: String,
            /// Keyframes with the same stamp and pose.
            n_keyframes: u64,
            /// Their share of the keyframes of the shorter log, 0 to 1.
            share: f64,
        } => "{n_keyframes} keyframes have the same stamps and poses as in log `{other}` ({:.0} % of the shorter log): the same drive is used twice; remove one of the logs",
            share * 100.0;

        // Training and evaluation.

        /// A grouping has too few groups.
        Warning "too_few_groups" TooFewGroups {
            /// The grouping, by name.
            grouping: String,
            /// What its groups are: `logs`, `places`, ...
            groups: String,
            /// Groups found.
            n_found: u64,
        } => "grouping `{grouping}` not evaluated: it needs 2 {groups} or more, found {n_found}; add logs, or remove `{grouping}` from `evaluate.groupings`";
        /// A grouping has two groups, and pairs between them.
        Warning "two_groups" TwoGroups {
            /// The grouping, by name.
            grouping: String,
            /// What its groups are: `logs`, `places`, ...
            groups: String,
            /// Pairs between the two groups.
            n_pairs: u64,
        } => "grouping `{grouping}` not evaluated: to test the pairs between the 2 {groups} ({n_pairs}), both must be held out, which leaves no pairs to train on; add a third, or remove `{grouping}` from `evaluate.groupings`";
        /// A class has fewer pairs than there are folds.
        Warning "too_few_pairs_for_folds" TooFewPairsForFolds {
            /// The grouping, by name.
            grouping: String,
            /// Folds asked for.
            n_folds: u64,
            /// `positive` or `negative`.
            class: String,
            /// Pairs found.
            n_found: u64,
        } => "grouping `{grouping}` not evaluated: {n_folds} folds need as many pairs of each class, found {n_found} {class} pairs; lower `evaluate.folds` or raise `label.pairs_per_class`";
        /// Without some folds, only one class is left to train on.
        Warning "one_class_left" OneClassLeft {
            /// The grouping, by name.
            grouping: String,
            /// Positive pairs left.
            n_positive: u64,
            /// Negative pairs left.
            n_negative: u64,
        } => "grouping `{grouping}` not evaluated: {n_positive} positive and {n_negative} negative pairs are left to train on, expected both classes; raise `label.pairs_per_class`, lower `evaluate.place_m` or `evaluate.place_margin_m`, add logs, or remove `{grouping}` from `evaluate.groupings`";
        /// A learner cannot be fitted without some folds.
        Warning "grouping_not_trainable" GroupingNotTrainable {
            /// The grouping, by name.
            grouping: String,
        } => "grouping `{grouping}` not evaluated: a learner cannot be fitted to the remaining pairs; add logs, or remove `{grouping}` from `evaluate.groupings`";

        /// Retrieval has few matches because not all scans are queries.
        Warning "few_matches_scored" FewMatchesScored {
            /// Matches scored.
            n_matches: u64,
            /// One in this many scans is a query.
            query_stride: u64,
            /// Pairs of all scans.
            n_pairs: u64,
        } => "retrieval has only {n_matches} matches, because one in {query_stride} scans is a query; expected 100 or more for a recall that is known within 10 %: raise `evaluate.max_pairs` (all scans as queries: {n_pairs})";

        // Loop closures.

        /// The ground truth of a log cannot be read.
        Warning "log_without_truth" LogWithoutTruth {
            /// The error.
            error: String,
        } => "no ground truth, so nothing is measured against it: {error}; correct `evaluate.truth`, or accept that this log is not measured";
        /// Scans are not used for training because their true pose is not known.
        Info "keyframes_without_truth" KeyframesWithoutTruth {
            /// Keyframes without a true pose.
            n_keyframes: u64,
            /// All keyframes.
            n_all: u64,
        } => "{n_keyframes} of {} have no true pose and are in no pair", count(*n_all, "keyframe");
        /// Segments are too short for a closure.
        Warning "short_segments" ShortSegments {
            /// Segments.
            n_segments: u64,
            /// Least path between the two scans of a closure \[m\].
            min_path_m: f64,
        } => "{} shorter than {min_path_m} m (`detect.min_path_m`): no closure within it is possible there", count(*n_segments, "segment");
        /// Scans match the scans before them poorly.
        Warning "poor_scan_matching" PoorScanMatching {
            /// Stretches of path.
            n_stretches: u64,
            /// Their length \[m\].
            length_m: f64,
            /// Share of the points near a point of the last metres.
            near_share: f64,
        } => "along {length_m:.0} m of path ({}), less than {:.0} % of the points of a scan are near a point of the scans before: the trajectory may be wrong there; check `ingest.lidar.mount` and the clocks of lidar and poses", count(*n_stretches, "stretch"), near_share * 100.0;
        /// The scans show another place than the odometry says.
        Warning "scans_of_another_place" ScansOfAnotherPlace {
            /// Number of times.
            n_times: u64,
            /// Scans between the two places.
            n_between: u64,
            /// Time of the first one \[s since the epoch\].
            first_secs: f64,
            /// Path before it \[m\].
            travel_m: f64,
        } => "the scans suddenly show another place than those before, although the odometry goes on ({}; first at {first_secs:.3} s, after {travel_m:.0} m): the robot was carried or took a lift, or logs were joined; a new segment begins there, which is put into the same map only if it shares places with the others, and {} between get no pose; check the log at this time", count(*n_times, "time"), count(*n_between, "scan");
        /// The odometry differs from the motion that the scans show.
        Warning "odometry_bias" OdometryBias {
            /// Motion per motion of the odometry.
            scale: f64,
            /// Turn per turn of the odometry.
            turn_scale: f64,
            /// Turn to the left per metre ahead that the odometry does not contain \[deg/m\].
            turn_deg_per_m: f64,
        } => "by its scans, the robot moves {scale:.3} m per metre of odometry, turns {turn_scale:.3} rad per radian of odometry, and turns {turn_deg_per_m:+.2} deg per metre more to the left: `register` corrects this; check the radius of the wheels, the track and the ticks per turn";
        /// The classifier was trained on another kind of scans.
        Warning "classifier_not_used" ClassifierNotUsed {
            /// Name of the model.
            model: String,
            /// Smallest angle covered by a training scan \[deg\].
            trained_deg: f64,
            /// Angle covered by the scans of the log \[deg\].
            found_deg: f64,
        } => "closures are searched without the classifier of the model `{model}`: it was trained on scans that cover {trained_deg:.0} deg or more, and those of the log cover {found_deg:.0} deg; train a model on scans of this kind";
        /// The model was trained on scans with other range limits.
        Warning "other_ranges" OtherRanges {
            /// Nearest return of the training scans \[m\].
            trained_min_m: f64,
            /// Farthest return of the training scans \[m\].
            trained_max_m: f64,
            /// Nearest return of the scans \[m\].
            min_m: f64,
            /// Farthest return of the scans \[m\].
            max_m: f64,
        } => "the classifier was trained on scans with ranges from {trained_min_m} to {trained_max_m} m, and these have {min_m} to {max_m} m: its confidences may be wrong; set `ingest.lidar.range_min_m` and `range_max_m` as in training";
        /// Loop detection has no ground truth to learn from.
        Warning "detector_not_trained" DetectorNotTrained
            => "closures are searched with the starting values of the detector, because the pipeline names no ground truth to fit it to: set `evaluate.truth`, or use `loopboost detect --model` with a trained model";
        /// Closures that agree with each other were rejected.
        Info "unsupported_closures" UnsupportedClosures {
            /// Closures.
            n_closures: u64,
        } => "{} rejected, because the scans confirm too few of the places that they predict to be the same (`unsupported` in closures.parquet)", count(*n_closures, "closure");
        /// Logs of one site are in different maps.
        Warning "separate_maps" SeparateMaps {
            /// The site.
            site: String,
            /// The logs of each map, separated by `|`.
            maps: String,
        } => "site `{site}`: its logs are in separate maps: {maps}; the scans do not show places that they share";
        /// Logs fit onto others in two ways.
        Warning "ambiguous_maps" AmbiguousMaps {
            /// The site.
            site: String,
            /// The logs that were not joined.
            logs: String,
            /// Those that they were not joined with.
            others: String,
        } => "site `{site}`: {logs} fit onto {others} in two different ways, nearly equally well, and were not joined: the buildings or corridors look alike";
        /// A drive fits two earlier maps, which stay apart.
        Warning "earlier_maps_overlap" EarlierMapsOverlap {
            /// The site.
            site: String,
            /// The logs of one map.
            logs: String,
            /// Those of the other one.
            others: String,
        } => "site `{site}`: {logs} fit onto {others}, but both contain an earlier map, and earlier maps stay where they are: run all of these logs together to get one map";

        // Absolute references of maps.

        /// A map is in the frame of its references.
        Info "map_georeferenced" MapGeoreferenced {
            /// The site.
            site: String,
            /// Number of the map.
            map: u32,
            /// The logs of the map.
            logs: Vec<String>,
            /// Latitude of the origin, positive north \[deg\]. None for surveyed poses without an origin.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            latitude_deg: Option<f64>,
            /// Longitude of the origin, positive east \[deg\].
            #[serde(default, skip_serializing_if = "Option::is_none")]
            longitude_deg: Option<f64>,
            /// Height of the origin above the ellipsoid \[m\].
            #[serde(default, skip_serializing_if = "Option::is_none")]
            altitude_m: Option<f64>,
            /// Standard deviation of the direction of the map as a whole \[deg\].
            heading_std_deg: f64,
        } => "map {map} of site `{site}` ({}) is in the frame of its references, {}; standard deviation of its direction {heading_std_deg:.2} deg", of_logs(logs),
            match (latitude_deg, longitude_deg, altitude_m) {
                (Some(latitude), Some(longitude), Some(altitude)) => format!("x east and y north of latitude {latitude} deg, longitude {longitude} deg, altitude {altitude} m"),
                _ => "that of the surveyed poses".to_owned(),
            };
        /// How well the references of a log agree with the map.
        Info "references_used" ReferencesUsed {
            /// References that agree.
            n_used: u64,
            /// References that contradict the map, and have no influence on it.
            n_outliers: u64,
            /// Mean distance from the map of those that agree \[m\].
            mean_m: f64,
            /// Root mean square distance \[m\].
            rms_m: f64,
            /// Largest distance \[m\].
            largest_m: f64,
            /// Root mean square error per direction, in stated standard deviations.
            rms_stds: f64,
        } => "{} within {largest_m:.2} m of the map (mean {mean_m:.2} m, root mean square {rms_m:.2} m, {rms_stds:.1} stated standard deviations); {n_outliers} outliers have no influence", count(*n_used, "reference");
        /// Most references of a log contradict its map.
        Error "references_contradict" ReferencesContradict {
            /// References.
            n_references: u64,
            /// Median distance from the map where they fit best \[m\].
            median_m: f64,
            /// Median of the stated standard deviations in each direction \[m\].
            stated_std_m: f64,
            /// What explains it.
            found: String,
        } => "{} not used, because most of them contradict the map: where they fit best, their median distance is {median_m:.2} m, with a stated standard deviation of {stated_std_m:.2} m; {found}", count(*n_references, "reference");
        /// References do not determine the frame of a map.
        Warning "references_do_not_decide" ReferencesDoNotDecide {
            /// References.
            n_references: u64,
            /// Standard deviation of the direction of the map \[deg\]. None if nothing is known of it.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            heading_std_deg: Option<f64>,
        } => "{} not used, because they do not determine the direction of the map ({}); expected two positions far from each other, or a pose, and a standard deviation of 5 deg or less", count(*n_references, "reference"),
            match heading_std_deg {
                Some(std) => format!("standard deviation {std:.1} deg"),
                None => "positions at one place".to_owned(),
            };
        /// References scatter more than they state.
        Warning "references_scatter" ReferencesScatter {
            /// Measured over stated standard deviation.
            factor: f64,
        } => "the errors of the references are {factor:.1} times as large as they state: standard deviations that much larger were used; state them with `std_m`";
        /// The place of an antenna on the robot is not known.
        Warning "reference_point_unknown" ReferencePointUnknown
            => "the place of the antenna on the robot is not known: no fixed transforms connect its frame and that of the lidar, and the origin of the robot was used; set `mount` of this reference";
        /// A log has no references from a source.
        Warning "log_without_references" LogWithoutReferences {
            /// Why.
            reason: String,
        } => "no references: {reason}";
        /// References are outside of the time of the scans.
        Info "references_outside_drive" ReferencesOutsideDrive {
            /// Those.
            n_outside: u64,
            /// All references.
            n_references: u64,
        } => "{n_outside} of {} before the first scan, after the last one, or in a gap of the odometry: not used", count(*n_references, "reference");
        /// Maps without a common place are in one frame.
        Info "maps_linked_by_references" MapsLinkedByReferences {
            /// The site.
            site: String,
            /// Number of the map.
            map: u32,
            /// The logs of each part, separated by `|`.
            parts: String,
        } => "map {map} of site `{site}` has parts that no closure connects: {parts}; only the references give their relative poses";
        /// Places that look alike are far from each other by the references.
        Warning "closures_far_by_references" ClosuresFarByReferences {
            /// The site.
            site: String,
            /// Possible closures with enough confidence.
            n_closures: u64,
            /// Median distance of their places by the references \[m\].
            median_m: f64,
        } => "site `{site}`: {} rejected, because the references say that the places are not the same (median distance {median_m:.0} m): the places look alike, or the references of a log are in another frame", count(*n_closures, "possible closure");
        /// Rows of a file of references are of logs that the run does not have.
        Info "references_of_other_logs" ReferencesOfOtherLogs {
            /// Rows.
            n_references: u64,
            /// The first of these logs.
            example: String,
        } => "{} not used: of logs that this run does not have, such as `{example}`", count(*n_references, "reference");
        /// The map of an earlier run has no frame of references.
        Warning "earlier_map_without_references" EarlierMapWithoutReferences {
            /// References.
            n_references: u64,
        } => "{} not used, because the earlier map (`detect.maps`) stays and is not in a frame of references; make that map with `optimize.references`", count(*n_references, "reference");

        // Comparing two runs A and B (`map compare`).

        /// B lacks logs of A.
        Warning "logs_removed" LogsRemoved {
            /// The logs.
            logs: Vec<String>,
        } => "only A has {}", of_logs(logs);
        /// B has logs that A does not have.
        Warning "logs_added" LogsAdded {
            /// The logs.
            logs: Vec<String>,
        } => "only B has {}; if new logs are expected, use `--allow-new-logs`", of_logs(logs);
        /// Keyframes of both runs have the same number and other stamps.
        Warning "other_scans" OtherScans {
            /// Keyframes with the same number and another stamp.
            n_other: u64,
            /// Keyframes with the same number and stamp.
            n_common: u64,
        } => "{} of both runs with the same number, but another stamp, and {n_common} with the same stamp: the two runs use different recordings under one name, or number their scans differently; compare runs of the same logs", count(*n_other, "keyframe");
        /// A log is in more or fewer maps.
        Warning "maps_of_log_changed" MapsOfLogChanged {
            /// Maps with a part of the log in A.
            n_maps_a: u64,
            /// Maps with a part of the log in B.
            n_maps_b: u64,
        } => "the log is in {} of A and in {} of B", count(*n_maps_a, "map"), count(*n_maps_b, "map");
        /// Logs share a map in one run only.
        Warning "maps_joined_or_split" MapsJoinedOrSplit {
            /// Pairs of logs that share a map in A only.
            n_only_a: u64,
            /// Pairs of logs that share a map in B only.
            n_only_b: u64,
            /// A log of the first of these pairs.
            first: String,
            /// The other log of that pair.
            second: String,
        } => "{} in one map in A only, and {n_only_b} in B only, such as `{first}` and `{second}`", match n_only_a {
                1 => "1 pair of logs".to_owned(),
                n => format!("{n} pairs of logs"),
            };
        /// Closures are accepted in A only.
        Warning "closures_lost" ClosuresLost {
            /// Closures.
            n_lost: u64,
            /// Accepted closures of A.
            n_closures_a: u64,
            /// Largest number that is tolerated.
            max_lost: u64,
        } => "{n_lost} of {} of A not accepted in B, expected at most {max_lost} (`--max-lost`)", count(*n_closures_a, "closure");
        /// Closures are accepted in B only.
        Warning "closures_gained" ClosuresGained {
            /// Closures.
            n_gained: u64,
            /// Accepted closures of B.
            n_closures_b: u64,
            /// Largest number that is tolerated.
            max_gained: u64,
        } => "{n_gained} of {} of B not accepted in A, expected at most {max_gained} (`--max-gained`)", count(*n_closures_b, "closure");
        /// Closures that both runs accept have other relative poses.
        Warning "closures_moved" ClosuresMoved {
            /// Closures beyond the tolerance.
            n_moved: u64,
            /// Closures that both accept.
            n_kept: u64,
            /// Largest shift \[m\].
            largest_m: f64,
            /// Largest turn \[deg\].
            largest_deg: f64,
            /// Largest shift that is tolerated \[m\].
            max_shift_m: f64,
            /// Largest turn that is tolerated \[deg\].
            max_turn_deg: f64,
        } => "the relative poses of {n_moved} of {} in both runs moved, by up to {largest_m:.3} m and {largest_deg:.2} deg; expected at most {max_shift_m} m (`--max-shift-m`) and {max_turn_deg} deg (`--max-turn-deg`)", count(*n_kept, "closure");
        /// The optimized poses of scans differ.
        Warning "trajectory_changed" TrajectoryChanged {
            /// The logs.
            logs: Vec<String>,
            /// The log with the largest distance.
            farthest_log: String,
            /// The keyframe of A nearest before the scan with the largest distance.
            keyframe: u64,
            /// Median of the distances \[m\].
            median_m: f64,
            /// Largest distance \[m\].
            largest_m: f64,
            /// Largest turn \[deg\].
            largest_deg: f64,
            /// Largest distance that is tolerated \[m\].
            max_shift_m: f64,
            /// Largest turn that is tolerated \[deg\].
            max_turn_deg: f64,
        } => "{}: after alignment, the optimized poses differ by up to {largest_m:.3} m and {largest_deg:.2} deg (median {median_m:.3} m, largest distance near scan {keyframe} of log `{farthest_log}`); expected at most {max_shift_m} m (`--max-shift-m`) and {max_turn_deg} deg (`--max-turn-deg`)", of_logs(logs);
        /// Labelled pairs have other labels.
        Warning "labels_changed" LabelsChanged {
            /// Pairs that are positive in A and negative in B.
            n_positive_to_negative: u64,
            /// Pairs that are negative in A and positive in B.
            n_negative_to_positive: u64,
            /// Pairs in both runs.
            n_common: u64,
            /// Largest number that is tolerated.
            max_flips: u64,
        } => "of {} in both runs, {n_positive_to_negative} changed from positive to negative, and {n_negative_to_positive} from negative to positive; expected at most {max_flips} (`--max-flips`)", count(*n_common, "labelled pair");
        /// Pairs of keyframes are at the same place in one run only.
        Warning "places_changed" PlacesChanged {
            /// Pairs at the same place in A only.
            n_only_a: u64,
            /// Pairs at the same place in B only.
            n_only_b: u64,
            /// Pairs at the same place in A.
            n_a: u64,
            /// Largest distance of keyframes at the same place \[m\].
            radius_m: f64,
            /// Largest number that is tolerated.
            max_flips: u64,
        } => "of {} within {radius_m} m by the optimized poses of A, {n_only_a} are not within it in B, and {n_only_b} are within it in B only; expected at most {max_flips} (`--max-flips`)", count(*n_a, "keyframe pair");

        /// A part of the detector was not fitted.
        Warning "detector_part_not_fitted" DetectorPartNotFitted {
            /// The part, by its name in `model.json`.
            part: String,
            /// What the logs contain.
            found: String,
            /// What the fit needs.
            expected: String,
        } => "`detector.{part}` of the models keeps its starting values: the logs have {found}, expected {expected}; add logs with ground truth and revisits (`evaluate.truth`)";

        // Velodyne packets.

        /// Packets come from more than one sensor.
        Warning "several_sensors" SeveralSensors
            => "the packets do not follow each other: more than one sensor seems to send to this topic";
        /// The revolutions at both ends of the log are partial.
        Info "partial_revolutions" PartialRevolutions {
            /// Revolutions.
            n_revolutions: u64,
        } => "{} at the start and end", count(*n_revolutions, "partial revolution");
        /// Packets are missing.
        Info "missing_packets" MissingPackets {
            /// Packets.
            n_packets: u64,
            /// Scans with a larger angle without packets than is usual.
            n_scans: u64,
            /// That angle \[deg\].
            min_hole_deg: f64,
        } => "{} missing{}", count(*n_packets, "packet"), match n_scans {
            0 => String::new(),
            n => format!(
                "; {} with an angle of more than {min_hole_deg} deg without packets (column `hole_deg`)",
                count(*n, "scan")
            ),
        };
        /// The device clock jumps and the stamps do not.
        Info "device_clock_jumps" DeviceClockJumps {
            /// Jumps.
            n_jumps: u64,
        } => "the device clock jumps {} while the stamps do not; nothing is lost", times(*n_jumps);
        /// The stamps step against the device clock.
        Warning "stamp_steps" StampSteps {
            /// Steps.
            n_steps: u64,
            /// The largest \[s\].
            largest_s: f64,
        } => "the stamps step {} against the device clock, by up to {largest_s:.2} s; scans and poses may be offset by that much there", times(*n_steps);
        /// All packets of a message have the same stamp.
        Warning "one_stamp_per_message" OneStampPerMessage
            => "the packets of a message share one stamp; scans may be late by up to one message: set `ingest.lidar.clock` to \"device\"";
        /// Packets were put back in order.
        Info "packets_reordered" PacketsReordered {
            /// Packets.
            n_packets: u64,
        } => "{} put back in order", count(*n_packets, "late packet");
        /// Lasers without a single return.
        Info "silent_lasers" SilentLasers {
            /// Lasers with returns.
            n_returning: u64,
            /// All lasers.
            n_lasers: u64,
            /// Lasers without returns, in firing order.
            silent: String,
        } => "{n_returning} of {n_lasers} lasers have returns; none from {silent}";

        // Scans.

        /// The points of a cloud are not in firing order.
        Info "clouds_sorted" CloudsSorted {
            /// Clouds.
            n_clouds: u64,
        } => "{} not in firing order, sorted by azimuth", count(*n_clouds, "cloud");
        /// The point times of a cloud are far from its stamp.
        Warning "cloud_times_ignored" CloudTimesIgnored {
            /// Clouds.
            n_clouds: u64,
        } => "{} with point times more than 1 s from the stamp of the cloud; the stamp was used", count(*n_clouds, "cloud");
        /// The point times of a cloud have an unusual unit or reference.
        Info "point_time_unit" PointTimeUnit {
            /// The field.
            field: String,
            /// The unit.
            unit: String,
            /// What the times count from.
            from: String,
        } => "the point times in the field `{field}` are taken as {unit} since {from}, because this fits the length of a revolution";
        /// The point times of a cloud fit no unit.
        Warning "point_times_implausible" PointTimesImplausible {
            /// The field.
            field: String,
            /// From the first point to the last, in the unit of the field.
            span: f64,
            /// Expected \[s\].
            expected_s: f64,
        } => "the point times in the field `{field}` differ by up to {span} in a cloud, which is not about {expected_s:.3} s in any unit (s, ms, us, ns); they were not used, and the scans are not deskewed";
        /// Clouds named after another frame are in the frame of their sensor.
        Warning "lidar_frame_doubtful" LidarFrameDoubtful {
            /// The frame.
            frame_id: String,
            /// What speaks for another frame, or against it.
            evidence: String,
        } => "the messages have the frame `{frame_id}`, expected the frame of the sensor; {evidence}";
        /// The maximum range of scans is not set.
        Info "range_max_unset" RangeMaxUnset {
            /// Scans.
            n_scans: u64,
        } => "{} with a range_max of 0 or less, which was taken as not set", count(*n_scans, "scan");
        /// The time between the beams of scans is impossible.
        Warning "time_increment_ignored" TimeIncrementIgnored {
            /// Scans.
            n_scans: u64,
            /// The first of them.
            example: String,
        } => "{} not deskewed, because the time between beams is impossible: {example}", count(*n_scans, "scan");
        /// By the times of its beams, a scan takes longer than the time to the next scan.
        Warning "scan_longer_than_period" ScanLongerThanPeriod {
            /// From the first beam to the last \[s\].
            duration_s: f64,
            /// Mean time between scans \[s\].
            period_s: f64,
        } => "by its time_increment, a scan takes {duration_s:.4} s, but a scan is recorded every {period_s:.4} s; the deskewed scans are probably wrong: correct the driver, or set `ingest.lidar.deskew = false`";
        /// What was deskewed.
        Info "deskewed" Deskewed {
            /// Scans deskewed.
            n_scans: u64,
        } => "{} deskewed", count(*n_scans, "scan");
        /// Scans that could not be deskewed because the motion is not known.
        Info "not_deskewed_no_motion" NotDeskewedNoMotion {
            /// Scans.
            n_scans: u64,
        } => "{} not deskewed: the motion is not known at least every 0.25 s, or it jumps", count(*n_scans, "scan");
        /// Scans that could not be deskewed because their messages have no times of returns.
        Info "not_deskewed_no_times" NotDeskewedNoTimes {
            /// Scans.
            n_scans: u64,
        } => "{} not deskewed: the messages have no times of returns", count(*n_scans, "scan");
        /// Deskewing is switched off.
        Info "deskew_off" DeskewOff => "scans not deskewed (`ingest.lidar.deskew = false`)";

        // Poses.

        /// Poses were not in order of time.
        Info "poses_reordered" PosesReordered {
            /// Poses.
            n_poses: u64,
        } => "{} earlier than the pose before; sorted by stamp", count(*n_poses, "pose");
        /// Two parents place the same frame.
        Warning "two_parent_frames" TwoParentFrames {
            /// The frame.
            child: String,
            /// The parent that was used.
            used: String,
            /// The other parent.
            other: String,
        } => "frame `{child}` has two parents, `{used}` and `{other}`; `{used}` was used: name another `parent` in `ingest.pose.frames` to use the other";
        /// Poses come from satellite fixes.
        Info "poses_from_fixes" PosesFromFixes {
            /// Fixes.
            n_fixes: u64,
            /// Latitude of the origin \[deg\].
            latitude_deg: f64,
            /// Longitude of the origin \[deg\].
            longitude_deg: f64,
            /// Altitude of the origin \[m\].
            altitude_m: f64,
        } => "poses from {n_fixes} satellite fixes, headings from the course, origin {{ latitude_deg = {latitude_deg}, longitude_deg = {longitude_deg}, altitude_m = {altitude_m} }}";
        /// Poses jump.
        Warning "pose_jumps" PoseJumps {
            /// Jumps.
            n_jumps: u64,
            /// The speed of the robot: 95 % of its motion is slower \[m/s\].
            own_speed_m_s: f64,
            /// The largest \[m\].
            largest_m: f64,
            /// The time it took \[s\].
            largest_s: f64,
            /// When it began \[ns since the epoch\].
            stamp_ns: i64,
            /// Whether the poses before and after a jump are in the same frame.
            same_frame: bool,
        } => "the poses jump {}: the robot drives {own_speed_m_s:.1} m/s, and the largest jump is {largest_m:.2} m in {largest_s:.3} s at {stamp_ns} ns; nothing is interpolated across a jump{}",
            times(*n_jumps),
            after_jumps(*same_frame);
        /// Heights jump.
        Warning "height_jumps" HeightJumps {
            /// Jumps.
            n_jumps: u64,
            /// The largest \[m\].
            largest_m: f64,
            /// The time it took \[s\].
            largest_s: f64,
            /// When it began \[ns since the epoch\].
            stamp_ns: i64,
            /// Whether the poses before and after a jump are in the same frame.
            same_frame: bool,
        } => "the height of the poses jumps {}; the largest jump is {largest_m:.2} m in {largest_s:.3} s at {stamp_ns} ns; nothing is interpolated across a jump{}",
            times(*n_jumps),
            after_jumps(*same_frame);
        /// Poses are faster than the robot.
        Warning "poses_too_fast" PosesTooFast {
            /// Steps between two poses.
            n_steps: u64,
            /// The limit \[m/s\].
            max_speed_m_s: f64,
            /// The longest step \[m\].
            largest_m: f64,
            /// The time it took \[s\].
            largest_s: f64,
            /// When it began \[ns since the epoch\].
            stamp_ns: i64,
        } => "{} between poses with more than {max_speed_m_s} m/s; the longest is {largest_m:.2} m in {largest_s:.3} s at {stamp_ns} ns; the poses are used: if the robot drives that fast, raise `ingest.pose.max_speed_m_s`, otherwise check the stamps of the poses",
            count(*n_steps, "step");
        /// The clock of the poses steps back.
        Warning "pose_clock_steps_back" PoseClockStepsBack {
            /// Steps.
            n_steps: u64,
            /// The largest \[s\].
            largest_s: f64,
            /// The first stamp after the first step \[ns since the epoch\].
            stamp_ns: i64,
        } => "the stamps of the poses step back {}, by up to {largest_s:.2} s, first to {stamp_ns} ns: the clock was set back; the trajectory is cut there, and times that occur twice are left out",
            times(*n_steps);
        /// The frame of the poses changes.
        Warning "pose_frame_changes" PoseFrameChanges {
            /// The frames with the numbers of their messages.
            frames: String,
        } => "the frame of the poses changes: {frames}; the trajectory is cut there, and poses in different frames give no pairs together: set `ingest.pose.frame_id` to use one of them";
        /// Messages in other frames than the selected one.
        Info "pose_frame_selected" PoseFrameSelected {
            /// Messages in other frames.
            n_other: u64,
            /// All frames with the numbers of their messages.
            frames: String,
        } => "{} not used, because the frame is not `ingest.pose.frame_id`: the topic has {frames}", count(*n_other, "message");
        /// Poses come from wheels and an IMU.
        Info "poses_fused" PosesFused {
            /// Wheel samples used.
            n_wheel_samples: u64,
            /// IMU samples used.
            n_imu_samples: u64,
            /// Path \[m\].
            distance_m: f64,
            /// Share of the time at rest, 0 to 1.
            still_share: f64,
            /// Track width \[m\].
            track_m: f64,
            /// Its standard deviation \[m\].
            track_std_m: f64,
            /// Bias of the gyroscope \[rad/s\].
            #[serde(default, skip_serializing_if = "Option::is_none")]
            gyro_bias_rad_s: Option<f64>,
        } => "poses fused from {n_wheel_samples} wheel and {n_imu_samples} IMU samples: {distance_m:.1} m, at rest {:.0} % of the time, track width {track_m:.3} +- {track_std_m:.3} m{}",
            still_share * 100.0,
            gyro_bias_rad_s.map_or_else(String::new, |bias| format!(", gyroscope bias {bias:.5} rad/s"));
        /// The joints that are used as wheels.
        Info "wheel_joints" WheelJoints {
            /// On the left.
            left: String,
            /// On the right.
            right: String,
            /// `velocities` or `positions`.
            source: String,
            /// Messages with these joints.
            n_messages: u64,
        } => "wheels: {left} (left) and {right} (right), {source} of {n_messages} messages";
        /// The unit of the wheels was confirmed by the gyroscope.
        Info "wheel_unit_confirmed" WheelUnitConfirmed {
            /// Turns of the gyroscope over turns of the wheels.
            ratio: f64,
        } => "the wheel velocities are taken as m/s, because the gyroscope then turns {ratio:.2} times as much as the wheels; set `ingest.pose.wheel_speed_unit = \"m/s\"` to state the unit";
        /// Wrapped wheel positions were unwrapped.
        Info "wheel_positions_unwrapped" WheelPositionsUnwrapped {
            /// How many times.
            n_turns: u64,
        } => "the wheel positions are wrapped to one turn; unwrapped {} by 2 pi", times(*n_turns);
        /// The velocities of the wheels are zero, but the positions change.
        Info "zero_wheel_velocities" ZeroWheelVelocities {
            /// Messages.
            n_messages: u64,
            /// Mean path of a wheel \[rad or m\].
            path: f64,
        } => "the wheel velocities of all {n_messages} messages are 0, but the positions change by {path:.1} rad (or m): the positions were used";
        /// The velocities of the wheels are not the changes of their positions.
        Warning "wheel_velocities_contradict_positions" WheelVelocitiesContradictPositions {
            /// Changes of the positions over integrated velocities.
            ratio: f64,
        } => "the wheel positions change {ratio:.3} times as fast as the wheel velocities, expected 1: the positions were used; check the unit of the velocities";
        /// The twist of odometry is zero, but the poses move.
        Info "zero_twists" ZeroTwists {
            /// Messages.
            n_messages: u64,
        } => "the twist of all {n_messages} odometry messages is 0, but their poses move: the speeds were computed from the poses";
        /// The twist of odometry is in the parent frame.
        Info "twist_in_parent_frame" TwistInParentFrame {
            /// The parent frame.
            parent: String,
            /// The child frame.
            child: String,
        } => "the poses show that the twist is in frame `{parent}` and not in the child frame `{child}`: it was rotated by the heading of each pose";
        /// The twist of odometry does not explain its poses.
        Warning "twist_contradicts_poses" TwistContradictsPoses {
            /// Share of the motion that it does not explain, 0 to 1 and more.
            left_share: f64,
        } => "the twist does not explain {:.0} % of the motion of the poses in the same messages: check its unit and its frame", left_share * 100.0;
        /// Gyroscope and wheels turn by different amounts.
        Warning "turn_ratio" TurnRatio {
            /// Turns of the gyroscope over turns of the wheels.
            ratio: f64,
        } => "the gyroscope turns {ratio:.2} times as much as the wheels, expected 1: check `ingest.pose.track_m` and `wheel_radius_m`; the uncertainty of the poses was raised";
        /// The wheels do not turn the robot, but the gyroscope does.
        Warning "wheels_do_not_turn" WheelsDoNotTurn {
            /// Turns of the gyroscope to both sides \[rad\].
            gyro_rad: f64,
            /// Turns of the wheels to both sides \[rad\].
            wheels_rad: f64,
        } => "the gyroscope turns by {gyro_rad:.2} rad, but the wheels by {wheels_rad:.2} rad: check the joints of the wheels, or the angular velocity of the odometry; the uncertainty of the poses was raised";
        /// The measured heading never changes.
        Info "constant_heading" ConstantHeading {
            /// `gyroscope` or `wheels`.
            reference: String,
            /// Its turns to both sides \[rad\].
            reference_rad: f64,
        } => "the orientation of the IMU never changes while the {reference} turns by {reference_rad:.2} rad: it is not measured and was not used";
        /// The measured heading does not turn with the robot.
        Warning "heading_does_not_turn" HeadingDoesNotTurn {
            /// `gyroscope` or `wheels`.
            reference: String,
            /// Its turns to both sides \[rad\].
            reference_rad: f64,
            /// Largest minus smallest heading \[rad\].
            heading_rad: f64,
        } => "the headings of the IMU stay within {heading_rad:.3} rad and do not follow the {reference}, which turns by {reference_rad:.2} rad: they were not used (`ingest.pose.use_heading = false` skips this check)";
        /// The measured heading turns the other way.
        Warning "heading_turns_opposite" HeadingTurnsOpposite {
            /// `gyroscope` or `wheels`.
            reference: String,
            /// Turns of the heading over its turns.
            ratio: f64,
        } => "the headings of the IMU turn {ratio:.2} times as much as the {reference}, expected 1: they are clockwise (NED) and were not used; convert them to counter-clockwise (ENU), or set `ingest.pose.use_heading = false`";
        /// Gyroscope and wheels contradict each other for much of the time.
        Warning "mostly_slip" MostlySlip {
            /// Windows in which they differ by more than the gate.
            n_outliers: u64,
            /// All windows of one second in motion.
            n_windows: u64,
        } => "gyroscope and wheels contradict each other in {n_outliers} of {n_windows} s in motion: this is not wheel slip; check `track_m`, `wheel_radius_m` and the stamps; the uncertainty of the poses was raised";
        /// Many measured headings contradict the other sensors.
        Warning "headings_contradict" HeadingsContradict {
            /// Headings beyond the gate.
            n_outliers: u64,
            /// Headings used.
            n_headings: u64,
        } => "{n_outliers} of {n_headings} headings of the IMU contradict gyroscope and wheels: set `ingest.pose.use_heading = false` if the heading is disturbed; the uncertainty of the poses was raised";
        /// A calibrated constant is far from its prior.
        Warning "calibration_deviates" CalibrationDeviates {
            /// The constant.
            name: String,
            /// Its value.
            value: f64,
            /// The expected value.
            expected: f64,
            /// The standard deviation of the expected value.
            std: f64,
            /// The unit.
            unit: String,
        } => "the {name} is {value:.4} {unit}, expected {expected:.4} +- {std:.4} {unit}: more than 5 standard deviations; check the options of `ingest.pose`; the uncertainty of the poses was raised";
        /// The IMU stops early or starts late.
        Warning "wheels_without_imu" WheelsWithoutImu {
            /// Time \[s\].
            alone_s: f64,
            /// Time of the wheels \[s\].
            duration_s: f64,
        } => "at the start or the end, the IMU has no samples for {alone_s:.1} s of the {duration_s:.1} s of the wheels: the wheels were used alone there";
        /// Many IMU samples are outside of the time of the wheels.
        Warning "imu_outside_wheels" ImuOutsideWheels {
            /// Samples outside.
            n_outside: u64,
            /// All samples.
            n_samples: u64,
        } => "{n_outside} of {n_samples} IMU samples are before the first or after the last wheel sample and were not used: check that both topics have stamps of one clock";
        /// Some IMU samples are outside of the time of the wheels.
        Info "imu_before_or_after_wheels" ImuBeforeOrAfterWheels {
            /// Samples outside.
            n_outside: u64,
            /// All samples.
            n_samples: u64,
        } => "{n_outside} of {n_samples} IMU samples are before the first or after the last wheel sample and were not used";
        /// Headings of the IMU were used.
        Info "headings_used" HeadingsUsed {
            /// Headings used.
            n_headings: u64,
            /// Of these, outliers.
            n_outliers: u64,
        } => "{} used, {n_outliers} of them outliers", count(*n_headings, "heading");
        /// Wheels and gyroscope disagree for some time.
        Info "wheel_slip" WheelSlip {
            /// Time \[s\].
            secs: u64,
        } => "the wheels slip for {secs} s (wheels and gyroscope disagree)";
        /// Samples are missing for some time.
        Info "sample_gaps" SampleGaps {
            /// `wheel` or `imu`.
            sensor: String,
            /// Gaps.
            n_gaps: u64,
            /// Their total time \[s\].
            secs: f64,
        } => "{} between {sensor} samples, {secs:.1} s in total", count(*n_gaps, "gap");

        // Import.

        /// The times of the lines of a log cannot be used.
        Warning "stamped_by_line" StampedByLine {
            /// What has the times: `scan`, ...
            item: String,
            /// Number of lines.
            n_lines: u64,
            /// What is wrong with the times.
            fault: String,
        } => "the times of the {n_lines} {item} lines cannot be used ({fault}); the messages are stamped by their line, 0.2 s from scan to scan, and each scan has the pose on its own line; poses are right, but times, speeds and rates are not";
        /// The poses of scans are not those of the odometry.
        Info "corrected_scan_poses" CorrectedScanPoses {
            /// Scans with another pose than the odometry.
            n_scans: u64,
            /// Scans that were compared.
            n_compared: u64,
            /// The largest distance \[m\].
            largest_m: f64,
            /// The topic with the poses of the scans.
            topic: String,
            /// The topic with the odometry.
            odom_topic: String,
        } => "the poses of {n_scans} of {n_compared} scans differ from the ODOM lines of the same time by up to {largest_m:.2} m, as in a corrected log: `{topic}` has the poses of the scans, `{odom_topic}` has the ODOM lines";
    }
}
