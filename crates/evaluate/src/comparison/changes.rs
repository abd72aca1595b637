//! Which differences are beyond the tolerances.

use dataset::{Note, NoteKind, Subject};

use super::closures::ComparedClosures;
use super::result::Comparison;
use super::scans::Presence;

impl Comparison {
    /// A note for each difference beyond the tolerances.
    pub fn notes(&self) -> Vec<Note> {
        let mut notes = self.notes_of_logs();
        let tolerances = &self.tolerances;
        notes.extend(self.notes_of_closures());
        for trajectory in self.trajectories.iter().filter(|t| t.is_beyond(tolerances)) {
            let kind = NoteKind::TrajectoryChanged {
                logs: trajectory.logs.clone(),
                farthest_log: trajectory.farthest.log.clone(),
                keyframe: trajectory.farthest.keyframe.into(),
                median_m: trajectory.median_m,
                largest_m: trajectory.max_m,
                largest_deg: trajectory.max_deg,
                max_shift_m: tolerances.max_shift_m,
                max_turn_deg: tolerances.max_turn_deg,
            };
            notes.push(kind.into());
        }
        let max_flips = tolerances.max_flips;
        if let Some(labels) = self.labels.as_ref().filter(|labels| max_flips < labels.n_flips()) {
            let kind = NoteKind::LabelsChanged {
                n_positive_to_negative: labels.n_positive_to_negative as u64,
                n_negative_to_positive: labels.n_negative_to_positive as u64,
                n_common: labels.n_common as u64,
                max_flips: max_flips as u64,
            };
            notes.push(kind.into());
        }
        if max_flips < self.places.n_flips() {
            let kind = NoteKind::PlacesChanged {
                n_only_a: self.places.n_only_a as u64,
                n_only_b: self.places.n_only_b as u64,
                n_a: self.places.n_a as u64,
                radius_m: self.place_rule.positive_radius_m,
                max_flips: max_flips as u64,
            };
            notes.push(kind.into());
        }
        notes
    }

    fn notes_of_logs(&self) -> Vec<Note> {
        let names = |presence: Presence| -> Vec<String> {
            let logs = self.logs.iter().filter(|log| log.presence == presence);
            logs.map(|log| log.log.clone()).collect()
        };
        let mut notes: Vec<Note> = Vec::new();
        let only_a = names(Presence::OnlyA);
        if !only_a.is_empty() {
            notes.push(NoteKind::LogsRemoved { logs: only_a }.into());
        }
        let only_b = names(Presence::OnlyB);
        if !only_b.is_empty() && !self.tolerances.allow_new_logs {
            notes.push(NoteKind::LogsAdded { logs: only_b }.into());
        }
        for log in self.logs.iter().filter(|log| 0 < log.n_other_stamps) {
            let kind = NoteKind::OtherScans {
                n_other: log.n_other_stamps as u64,
                n_common: log.n_common_keyframes as u64,
            };
            notes.push(Note::new(kind, Subject::log(&log.log)));
        }
        let is_both = |log: &&super::scans::ComparedLog| log.presence == Presence::Both;
        for log in self.logs.iter().filter(is_both).filter(|log| log.n_maps_a != log.n_maps_b) {
            let kind = NoteKind::MapsOfLogChanged {
                n_maps_a: log.n_maps_a as u64,
                n_maps_b: log.n_maps_b as u64,
            };
            notes.push(Note::new(kind, Subject::log(&log.log)));
        }
        let (only_a, only_b) = (&self.maps.joined_only_in_a, &self.maps.joined_only_in_b);
        if let Some([first, second]) = only_a.first().or(only_b.first()) {
            let kind = NoteKind::MapsJoinedOrSplit {
                n_only_a: only_a.len() as u64,
                n_only_b: only_b.len() as u64,
                first: first.clone(),
                second: second.clone(),
            };
            notes.push(kind.into());
        }
        notes
    }

    fn notes_of_closures(&self) -> Vec<Note> {
        let tolerances = &self.tolerances;
        let ComparedClosures { n_lost, n_gained, n_moved, n_kept, .. } = self.closures;
        let mut notes: Vec<Note> = Vec::new();
        if tolerances.max_lost < n_lost {
            let n_closures_a = self.closures.n_a as u64;
            let (n_lost, max_lost) = (n_lost as u64, tolerances.max_lost as u64);
            notes.push(NoteKind::ClosuresLost { n_lost, n_closures_a, max_lost }.into());
        }
        if tolerances.max_gained < n_gained {
            let n_closures_b = self.closures.n_b as u64;
            let (n_gained, max_gained) = (n_gained as u64, tolerances.max_gained as u64);
            notes.push(NoteKind::ClosuresGained { n_gained, n_closures_b, max_gained }.into());
        }
        if let Some(kept) = self.closures.kept.filter(|_| 0 < n_moved) {
            let kind = NoteKind::ClosuresMoved {
                n_moved: n_moved as u64,
                n_kept: n_kept as u64,
                largest_m: kept.max_m,
                largest_deg: kept.max_deg,
                max_shift_m: tolerances.max_shift_m,
                max_turn_deg: tolerances.max_turn_deg,
            };
            notes.push(kind.into());
        }
        notes
    }
}
