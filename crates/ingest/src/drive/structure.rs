//! Messages of undefined channels, and channels with contradictory definitions.
//!
//! The structure of a file shows them if it was scanned. If it was read from the index, they appear
//! when the pieces are read.

use std::collections::BTreeMap;
use std::path::PathBuf;

use dataset::{Loss, LossKind, Losses, Subject};

use crate::drive::topic::Drive;
use crate::error::IngestError;
use crate::mcap::definitions::{Definitions, Redefined};

/// What one piece shows.
#[derive(Debug, Default)]
pub(crate) struct PieceStructure {
    pub(crate) file: usize,
    /// Number of messages of channels that the file does not define.
    pub(crate) n_undefined: u64,
    pub(crate) redefined: Vec<Redefined>,
}

impl PieceStructure {
    pub(crate) fn new(
        drive: &Drive<'_>,
        file: usize,
        n_undefined: u64,
        definitions: Definitions,
    ) -> Self {
        let redefined = definitions.contradictions(&drive.contents(file).channels);
        Self { file, n_undefined, redefined }
    }
}

/// What all pieces show.
#[derive(Debug)]
pub(crate) struct StructureCheck {
    /// Number of messages of undefined channels, according to the structure of the files.
    n_known: u64,
    /// The same, in the pieces that were read.
    n_read: u64,
    redefined: BTreeMap<(usize, u16), (PathBuf, Redefined)>,
}

impl StructureCheck {
    pub(crate) fn new(drive: &Drive<'_>) -> Self {
        let mut check = Self { n_known: 0, n_read: 0, redefined: BTreeMap::new() };
        for file in 0..drive.n_files() {
            let contents = drive.contents(file);
            check.n_known = check.n_known.saturating_add(contents.n_undefined);
            check.add_redefined(drive, file, contents.redefined.clone());
        }
        check
    }

    pub(crate) fn add(&mut self, drive: &Drive<'_>, piece: PieceStructure) {
        self.n_read += piece.n_undefined;
        self.add_redefined(drive, piece.file, piece.redefined);
    }

    fn add_redefined(&mut self, drive: &Drive<'_>, file: usize, redefined: Vec<Redefined>) {
        for redefined in redefined {
            let path = drive.path_of(file);
            self.redefined.entry((file, redefined.id)).or_insert((path, redefined));
        }
    }

    /// An error if a topic is in a channel with contradictory definitions, because its messages cannot
    /// be distinguished from those of another topic.
    pub(crate) fn check_topics(&self, topics: &[&str]) -> Result<(), IngestError> {
        let affects = |r: &Redefined| {
            [&r.first, &r.second].iter().any(|channel| topics.contains(&channel.topic.as_str()))
        };
        match self.redefined.values().find(|(_, redefined)| affects(redefined)) {
            Some((path, redefined)) => Err(IngestError::RedefinedChannel {
                path: path.clone(),
                channel: redefined.id,
                definitions: redefined.to_string(),
            }),
            None => Ok(()),
        }
    }

    /// What was found, as losses.
    pub(crate) fn losses(&self) -> Losses {
        let mut losses = Losses::default();
        losses.add(LossKind::UndefinedChannel, self.n_known.max(self.n_read));
        for (_, redefined) in self.redefined.values() {
            let kind = LossKind::RedefinedChannels { second: redefined.second.topic.clone() };
            losses.add(Loss::new(kind, Subject::topic(&redefined.first.topic)), 1);
        }
        losses
    }
}
