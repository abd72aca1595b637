//! Maps in the frame of their absolute references.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use dataset::{CandidateClosure, Note, NoteKind, Pose2, ScanClosure, ScanId, Subject};
use ingest::Origin;
use model::Detector;
use nalgebra::{Matrix2, Matrix3, Vector2};
use optimize::{
    Cause, Closure, Contradiction, Edge, Placed, Placement, Reference, ReferencedMap, Residual,
    Site, place_by_references,
};
use register::Drive;

use crate::reference_options::ReferenceOptions;
use crate::references::{DriveReference, SiteReferences, subject_of};
use crate::site_drives::SiteDrives;
use crate::summary::Summary;

/// The 99.99 % quantile of the chi-square distribution with 2 degrees of freedom, -2 ln(1e-4): the places of a
/// closure that are farther apart than this by the references are not the same.
const MAX_CHI2_SAME: f64 = 18.420_680_743_952_367;

/// The references of a site, and what they are applied to.
pub(crate) struct Georeference<'a> {
    pub(crate) site: &'a SiteDrives,
    pub(crate) references: &'a SiteReferences,
    /// The entries of `optimize.references`.
    pub(crate) options: &'a [ReferenceOptions],
    pub(crate) detector: &'a Detector,
}

/// A drive in the frame of the references, before its loops are closed.
pub(crate) struct Located {
    poses: Vec<Pose2>,
    covariances: Vec<Matrix3<f64>>,
    /// Variance in each direction of the errors that all references of the drive share \[m^2\].
    common_m2: f64,
}

/// Candidates that the references rule out.
#[derive(Default)]
pub(crate) struct Far {
    pub(crate) closures: Vec<ScanClosure>,
    /// Distance of the places of each by the references \[m\].
    distances_m: Vec<f64>,
}

/// What the references made of the maps.
#[derive(Default)]
pub(crate) struct Georeferenced {
    /// The maps that are in the frame of the references now, which are one map. Each is connected by closures.
    parts: Vec<Vec<usize>>,
    heading_std_rad: f64,
    origin: Option<Origin>,
    pub(crate) notes: Vec<Note>,
    pub(crate) summaries: Vec<Summary>,
}

impl Georeference<'_> {
    /// The drives that their references place, by their odometry alone.
    pub(crate) fn locate(&self, drives: &[Drive]) -> Vec<Option<Located>> {
        drives.iter().enumerate().map(|(k, drive)| self.locate_drive(k, drive)).collect()
    }

    fn locate_drive(&self, k: usize, drive: &Drive) -> Option<Located> {
        if let Some(poses) = self.site.known_poses.get(k) {
            let (poses, covariances) = (poses.clone(), vec![Matrix3::zeros(); poses.len()]);
            return self.is_in_frame(k).then_some(Located { poses, covariances, common_m2: 0.0 });
        }
        let references: Vec<Reference> =
            self.references.of_drives[k].iter().map(|of_drive| of_drive.reference).collect();
        let rows = &self.site.drives[k].rows;
        let stamps_ns: Vec<i64> = rows.iter().map(|row| row.stamp_ns).collect();
        let map = ReferencedMap {
            drive,
            parts: &[0],
            first_new: 0,
            stamps_ns: &stamps_ns,
            poses: &drive.poses,
            closures: &[],
        };
        match place_by_references(&map, &references, self.detector) {
            Placement::Placed(Placed { poses, covariances, single_std_m, .. }) => {
                Some(Located { poses, covariances, common_m2: single_std_m * single_std_m })
            }
            _ => None,
        }
    }

    /// Whether a drive of the known map is in the frame of the references.
    fn is_in_frame(&self, known: usize) -> bool {
        self.site.known_frame.is_some_and(|(number, _)| self.site.known_maps[known] == number)
    }

    /// Puts the maps into the frame of their references. Those that the references place become one map.
    pub(crate) fn place(&self, drive: &Drive, solved: &mut Site) -> Georeferenced {
        let mut made = Georeferenced { origin: self.references.origin, ..Georeferenced::default() };
        let rows = self.site.drives.iter().flat_map(|drive| &drive.rows);
        let stamps_ns: Vec<i64> = rows.map(|row| row.stamp_ns).collect();
        let accepted = solved.solution.closures.iter().filter(|closure| closure.rejected.is_none());
        let closures: Vec<Edge> = accepted.filter_map(edge).collect();
        for map in solved.maps.clone() {
            let of_map = self.of_map(drive, &map);
            let known: Vec<usize> =
                map.iter().copied().filter(|&k| k < self.site.n_known()).collect();
            let is_in_frame = known.iter().any(|&k| self.is_in_frame(k));
            if !known.is_empty() && !is_in_frame {
                let n_references = of_map.len() as u64;
                let kind = NoteKind::EarlierMapWithoutReferences { n_references };
                made.notes.extend((0 < n_references).then(|| Note::from(kind)));
                continue;
            }
            if of_map.is_empty() {
                // New drives in the known map are in its frame.
                made.parts.extend(is_in_frame.then_some(map));
                continue;
            }
            let referenced = ReferencedMap {
                drive,
                parts: &map,
                first_new: self.site.n_known(),
                stamps_ns: &stamps_ns,
                poses: &solved.solution.poses,
                closures: &closures,
            };
            let references: Vec<Reference> = of_map.iter().map(|r| r.reference).collect();
            match place_by_references(&referenced, &references, self.detector) {
                Placement::Placed(placed) => {
                    self.describe(drive, &of_map, &placed, &mut made);
                    for (scan, covariance) in placed.covariances.iter().enumerate() {
                        if map.contains(&drive.part_of(scan)) {
                            solved.solution.covariances[scan] = *covariance;
                        }
                    }
                    solved.solution.poses = placed.poses;
                    made.heading_std_rad = made.heading_std_rad.max(placed.heading_std_rad);
                    made.parts.push(map);
                }
                Placement::Undecided { heading_std_rad } => {
                    let std_deg = Some(heading_std_rad.to_degrees());
                    let kind = NoteKind::ReferencesDoNotDecide {
                        n_references: of_map.len() as u64,
                        heading_std_deg: std_deg.filter(|std_deg| std_deg.is_finite()),
                    };
                    made.notes.push(Note::new(kind, self.subject(drive, &of_map)));
                    made.parts.extend(is_in_frame.then_some(map));
                }
                Placement::Contradicted(contradiction) => {
                    let kind = contradicted(&contradiction);
                    made.notes.push(Note::new(kind, self.subject(drive, &of_map)));
                    made.parts.extend(is_in_frame.then_some(map));
                }
            }
        }
        let in_frame: BTreeSet<usize> = made.parts.iter().flatten().copied().collect();
        if 1 < made.parts.len() {
            solved.maps.retain(|map| !in_frame.contains(&map[0]));
            solved.maps.push(in_frame.into_iter().collect());
            solved.maps.sort();
        }
        made
    }

    /// The references of the drives of a map, with indices in the joined drives.
    fn of_map(&self, drive: &Drive, map: &[usize]) -> Vec<DriveReference> {
        let of_drive = |&k: &usize| {
            let first = drive.starts[k];
            self.references.of_drives[k].iter().map(move |of_drive| {
                let scan = first + of_drive.reference.scan;
                let reference = Reference { scan, ..of_drive.reference };
                DriveReference { reference, ..*of_drive }
            })
        };
        map.iter().flat_map(of_drive).collect()
    }

    fn log_of(&self, drive: &Drive, scan: usize) -> &str {
        self.site.drives[drive.part_of(scan)].log().map_or("", |log| &**log)
    }

    /// The source and the log of references, if there is one.
    fn subject(&self, drive: &Drive, of_map: &[DriveReference]) -> Subject {
        let of = |r: &DriveReference| (r.source, self.log_of(drive, r.reference.scan));
        let mut sources: Vec<(usize, &str)> = of_map.iter().map(of).collect();
        sources.sort_unstable();
        sources.dedup();
        match sources[..] {
            [(source, log)] => subject_of(&self.options[source], log),
            _ => Subject::default(),
        }
    }

    /// Says how well the references of each log and source agree with their map.
    fn describe(
        &self,
        drive: &Drive,
        of_map: &[DriveReference],
        placed: &Placed,
        made: &mut Georeferenced,
    ) {
        if SCATTER_NOTED < placed.scatter {
            let kind = NoteKind::ReferencesScatter { factor: placed.scatter };
            made.notes.push(Note::new(kind, self.subject(drive, of_map)));
        }
        let mut by_source: BTreeMap<(usize, &str), Vec<(&DriveReference, &Residual)>> =
            BTreeMap::new();
        for (reference, residual) in of_map.iter().zip(&placed.residuals) {
            let key = (reference.source, self.log_of(drive, reference.reference.scan));
            by_source.entry(key).or_default().push((reference, residual));
        }
        for ((source, log), of_source) in by_source {
            let subject = subject_of(&self.options[source], log);
            let residuals: Vec<Residual> = of_source.iter().map(|(_, r)| **r).collect();
            let agreement = Agreement::of(&residuals);
            let references: Vec<Reference> = of_source.iter().map(|(r, _)| r.reference).collect();
            let weight = |is_kept: bool| {
                let of = references.iter().zip(&residuals).filter(|(_, r)| r.is_kept == is_kept);
                of.map(|(reference, _)| 1.0 / reference.n_correlated).sum::<f64>()
            };
            // Others place the map.
            if weight(true) <= weight(false) {
                made.notes.push(Note::new(outvoted(&references, &residuals), subject));
                continue;
            }
            let source = self.options[source].name().to_owned();
            made.notes.push(Note::new(agreement.note(), subject));
            made.summaries.push(agreement.summary(log.to_owned(), source));
        }
    }
}

/// Scatter is a remark from this factor on: with ten independent fixes, the median is up to 1.4 times as large by
/// chance.
const SCATTER_NOTED: f64 = 1.5;

/// How well references agree with a map.
struct Agreement {
    n_used: u64,
    n_outliers: u64,
    mean_m: f64,
    rms_m: f64,
    largest_m: f64,
    rms_stds: f64,
}

impl Agreement {
    fn of(residuals: &[Residual]) -> Self {
        let used: Vec<&Residual> = residuals.iter().filter(|residual| residual.is_kept).collect();
        let n = used.len().max(1) as f64;
        let mean =
            |value: &dyn Fn(&Residual) -> f64| used.iter().map(|r| value(r)).sum::<f64>() / n;
        Self {
            n_used: used.len() as u64,
            n_outliers: (residuals.len() - used.len()) as u64,
            mean_m: mean(&|r| r.distance_m),
            rms_m: mean(&|r| r.distance_m * r.distance_m).sqrt(),
            largest_m: used.iter().map(|r| r.distance_m).fold(0.0, f64::max),
            rms_stds: mean(&|r| r.n_stds * r.n_stds).sqrt(),
        }
    }

    fn note(&self) -> NoteKind {
        let Self { n_used, n_outliers, mean_m, rms_m, largest_m, rms_stds } = *self;
        NoteKind::ReferencesUsed { n_used, n_outliers, mean_m, rms_m, largest_m, rms_stds }
    }

    fn summary(&self, log: String, source: String) -> Summary {
        let Self { n_used, n_outliers, mean_m, rms_m, largest_m, rms_stds } = *self;
        Summary::Referenced { log, source, n_used, n_outliers, mean_m, rms_m, largest_m, rms_stds }
    }
}

/// Most references of a log contradict the map that others place.
fn outvoted(references: &[Reference], residuals: &[Residual]) -> NoteKind {
    let variance_m2 = |r: &Reference| f64::midpoint(r.covariance[(0, 0)], r.covariance[(1, 1)]);
    NoteKind::ReferencesContradict {
        n_references: references.len() as u64,
        median_m: median(residuals.iter().map(|r| r.distance_m).collect()),
        stated_std_m: median(references.iter().map(|r| variance_m2(r).sqrt()).collect()),
        found: "other references place the map: check the frame, the origin and the clock of these"
            .to_owned(),
    }
}

fn contradicted(contradiction: &Contradiction) -> NoteKind {
    let Contradiction { n_references, median_m, stated_std_m, cause } = *contradiction;
    let found = match cause {
        Cause::Mirrored => {
            "they fit if the axes x and y are exchanged, or one axis is reversed: use x east and y north (ENU, REP 103), not north and east (NED)".to_owned()
        }
        Cause::Scaled(factor) => format!(
            "they fit if the map is {factor:.3} times as large: check their unit, which is metres, and the scale of their projection"
        ),
        Cause::Delayed(secs) => format!(
            "they fit if their stamps are {:.1} s {}: check the clocks, or set `stamp = \"log\"`",
            secs.abs(),
            if secs < 0.0 { "earlier" } else { "later" }
        ),
        Cause::Moved { distance_m, turn_rad } => format!(
            "they fit {distance_m:.1} m and {:.1} deg from where the map is: check their frame and their origin",
            turn_rad.to_degrees()
        ),
        Cause::Understated => {
            "they fit roughly, with larger errors than they state: set `std_m`".to_owned()
        }
        Cause::Unknown => {
            "they do not have the shape of the drive: check that they are of this log, their frame, and whether the odometry jumps".to_owned()
        }
    };
    let n_references = n_references as u64;
    NoteKind::ReferencesContradict { n_references, median_m, stated_std_m, found }
}

impl Georeferenced {
    /// Remarks about the map in the frame of the references. `numbers` are those of the maps of all drives.
    pub(crate) fn notes_of_map(&self, site: &SiteDrives, numbers: &[u32]) -> Vec<Note> {
        let logs_of = |part: &[usize]| -> BTreeSet<String> {
            part.iter().filter_map(|&k| site.drives[k].log()).map(ToString::to_string).collect()
        };
        let Some(first) = self.parts.first() else { return Vec::new() };
        let (map, of_site) = (numbers[first[0]], site.site.clone());
        let all: Vec<usize> = self.parts.concat();
        let mut notes = vec![Note::from(NoteKind::MapGeoreferenced {
            site: of_site.clone(),
            map,
            logs: logs_of(&all).into_iter().collect(),
            latitude_deg: self.origin.map(|origin| origin.latitude_deg),
            longitude_deg: self.origin.map(|origin| origin.longitude_deg),
            altitude_m: self.origin.map(|origin| origin.altitude_m),
            heading_std_deg: self.heading_std_rad.to_degrees(),
        })];
        if 1 < self.parts.len() {
            let joined =
                |part: &Vec<usize>| logs_of(part).into_iter().collect::<Vec<_>>().join(", ");
            let parts: Vec<String> = self.parts.iter().map(joined).collect();
            let parts = parts.join(" | ");
            notes.push(NoteKind::MapsLinkedByReferences { site: of_site, map, parts }.into());
        }
        notes
    }
}

impl Far {
    /// Splits candidates: those whose places can be the same, and those whose places are far from each other by
    /// the references of both drives.
    pub(crate) fn split(
        candidates: &[CandidateClosure],
        site: &SiteDrives,
        located: &[Option<Located>],
    ) -> (Vec<CandidateClosure>, Self) {
        let places = site.drives.iter().zip(located).flat_map(|(drive, located)| {
            let located = located.as_ref();
            drive.rows.iter().enumerate().map(move |(k, row)| (&row.id, (k, located)))
        });
        let places: HashMap<&ScanId, (usize, Option<&Located>)> = places.collect();
        let mut far = Self::default();
        let distance_if_far = |candidate: &CandidateClosure| {
            let place = |id: &ScanId| {
                let (k, located) = places.get(id)?;
                Some((*k, (*located)?))
            };
            let closure = &candidate.closure;
            let (reference, query) = (place(&closure.reference)?, place(&closure.query)?);
            distance_if_far(closure, reference, query)
        };
        let mut near = Vec::new();
        for candidate in candidates {
            match distance_if_far(candidate) {
                Some(distance_m) => {
                    far.closures.push(candidate.closure.clone());
                    far.distances_m.push(distance_m);
                }
                None => near.push(candidate.clone()),
            }
        }
        (near, far)
    }

    /// A remark about those that look like closures.
    pub(crate) fn note(&self, site: &str, min_confidence: f64) -> Option<Note> {
        let of_closures = self.closures.iter().zip(&self.distances_m);
        let confident = of_closures.filter(|(closure, _)| min_confidence <= closure.confidence);
        let distances_m: Vec<f64> = confident.map(|(_, distance_m)| *distance_m).collect();
        let n_closures = distances_m.len() as u64;
        let (site, median_m) = (site.to_owned(), median(distances_m));
        let kind = NoteKind::ClosuresFarByReferences { site, n_closures, median_m };
        (0 < n_closures).then(|| kind.into())
    }
}

/// The distance between the places of a closure by the references, if it is more than their errors explain.
fn distance_if_far(
    closure: &ScanClosure,
    (r, reference): (usize, &Located),
    (q, query): (usize, &Located),
) -> Option<f64> {
    let expected = reference.poses[r] * closure.reference_from_query;
    let found = query.poses[q];
    let error = Vector2::new(found.x_m - expected.x_m, found.y_m - expected.y_m);
    let position = |covariance: &Matrix3<f64>| covariance.fixed_view::<2, 2>(0, 0).into_owned();
    // Fixes of the known map had common errors, too. They are not stored.
    let common_m2 = match (reference.common_m2, query.common_m2) {
        (one, 0.0) | (0.0, one) => 2.0 * one,
        (a, b) => a + b,
    };
    let covariance = position(&reference.covariances[r])
        + position(&query.covariances[q])
        + Matrix2::from_diagonal_element(common_m2);
    let chi2 = (error.transpose() * covariance.try_inverse()? * error)[(0, 0)];
    (MAX_CHI2_SAME < chi2).then(|| error.norm())
}

fn edge(closure: &Closure) -> Option<Edge> {
    let proposal = &closure.proposal;
    Some(Edge {
        a: proposal.reference,
        b: proposal.query,
        a_from_b: proposal.reference_from_query,
        information: proposal.covariance.cholesky()?.inverse(),
    })
}

/// The upper median; 0 of nothing.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn located(x_m: f64, common_m2: f64) -> Located {
        let poses = vec![Pose2 { x_m, y_m: 0.0, heading_rad: 0.0 }];
        Located { poses, covariances: vec![Matrix3::identity()], common_m2 }
    }

    fn closure() -> ScanClosure {
        let id = |log: &str| ScanId { log: log.into(), scan: 0 };
        ScanClosure {
            query: id("b"),
            reference: id("a"),
            reference_from_query: Pose2 { x_m: 1.0, y_m: 0.0, heading_rad: 0.0 },
            covariance: [0.0; 6],
            confidence: 0.9,
            overlap: 0.5,
            known_overlap: 0.5,
            n_known: 100,
            conflict: 0.0,
            margin: 0.1,
            weakness: 0.5,
            classifier: None,
            is_degenerate: false,
        }
    }

    /// Variances of 1 m^2 each, and 1 m^2 of each drive: 4 m^2 in total, so that the limit is
    /// sqrt(18.42 * 4) = 8.58 m. The closure says that the query is 1 m in front of the reference.
    #[test]
    fn places_are_far_beyond_all_their_errors() {
        let far = |x_m: f64, [a_m2, b_m2]: [f64; 2]| {
            distance_if_far(&closure(), (0, &located(0.0, a_m2)), (0, &located(x_m, b_m2)))
        };
        assert_eq!(far(9.5, [1.0, 1.0]), None);
        assert!((far(9.7, [1.0, 1.0]).unwrap() - 8.7).abs() < 1e-12);
        // A known drive has the errors of the other one.
        assert_eq!(far(9.5, [0.0, 1.0]), None);
        assert!(far(9.7, [0.0, 1.0]).is_some());
        assert!(far(-6.0, [0.0, 0.0]).is_some(), "sqrt(18.42 * 2) = 6.07 m, found 7 m");
        assert_eq!(far(1.0, [0.0, 0.0]), None);
    }

    #[test]
    fn agreement_is_that_of_the_references_that_are_kept() {
        let residual =
            |is_kept: bool, distance_m: f64| Residual { is_kept, distance_m, n_stds: 1.0 };
        let found =
            Agreement::of(&[residual(true, 3.0), residual(false, 50.0), residual(true, 4.0)]);
        assert_eq!((found.n_used, found.n_outliers), (2, 1));
        assert_eq!((found.mean_m, found.largest_m, found.rms_stds), (3.5, 4.0, 1.0));
        assert!((found.rms_m - 12.5f64.sqrt()).abs() < 1e-12);
        assert_eq!(Agreement::of(&[]).mean_m, 0.0);
    }
}
