//! Messages of undefined channels, and channels with contradictory definitions.
//!
//! The structure of a file shows them if it was scanned. If it was read from the index, they appear
//! when the pieces are read.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use dataset::{Loss, LossKind, Losses, Subject};
use rayon::prelude::*;

use crate::drive::topic::{Drive, FilePiece};
use crate::drive::window::Part;
use crate::error::IngestError;
use crate::mcap::chunk::{self, Buffer, Rest};
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

    /// Reads the pieces without messages of the topics, which are not in `windows`, to check them. Damage
    /// there does not change the result, but the log is not what was recorded.
    pub(crate) fn check_unused(
        &mut self,
        drive: &Drive<'_>,
        windows: &[(Part, Vec<FilePiece<'_>>)],
    ) -> Losses {
        let key = |piece: &FilePiece<'_>| (piece.file, piece.piece.range.start);
        let used: BTreeSet<_> =
            windows.iter().flat_map(|(_, window)| window.iter().map(key)).collect();
        let all = drive.pieces(|_, _| true).into_iter();
        let unused: Vec<_> = all.filter(|piece| !used.contains(&key(piece))).collect();
        let check = |buffer: &mut Buffer, FilePiece { file, log, piece, .. }: &FilePiece<'_>| {
            let mut n_undefined = 0;
            let Rest { losses, definitions } =
                chunk::messages(log.bytes(), piece, buffer, |header, _| {
                    n_undefined += u64::from(!drive.defines(*file, header.channel_id));
                });
            (losses, PieceStructure::new(drive, *file, n_undefined, definitions))
        };
        let found: Vec<_> = unused.par_iter().map_init(Buffer::default, check).collect();
        let mut losses = Losses::default();
        for (of_piece, structure) in found {
            losses.merge(of_piece);
            self.add(drive, structure);
        }
        losses
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
