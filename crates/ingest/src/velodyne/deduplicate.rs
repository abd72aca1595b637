//! Removes packets that two files of a split drive have in common.

use crate::velodyne::packet::RingPacket;

/// Detects packets that an earlier file of the drive already contains.
///
/// Some recorders repeat the last packets of a file at the start of the next one.
#[derive(Debug)]
pub(crate) struct FileOverlap {
    /// Number of the current file.
    file: usize,
    /// Newest stamp in the files before the current one \[ns\].
    file_from_ns: i64,
    /// Newest stamp so far \[ns\].
    newest_ns: i64,
}

impl Default for FileOverlap {
    fn default() -> Self {
        Self { file: 0, file_from_ns: i64::MIN, newest_ns: i64::MIN }
    }
}

impl FileOverlap {
    /// Call this before the packets of a piece, with the number of the piece's file.
    pub(crate) fn enter_file(&mut self, file: usize) {
        if self.file != file {
            self.file = file;
            self.file_from_ns = self.newest_ns;
        }
    }

    /// Whether a packet of the current file is new: later than all packets of the files before.
    pub(crate) fn is_new(&mut self, packet: &RingPacket) -> bool {
        if packet.end_ns <= self.file_from_ns {
            return false;
        }
        self.newest_ns = self.newest_ns.max(packet.end_ns);
        true
    }
}
