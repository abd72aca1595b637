//! Reads ROS 1 bags of version 2.0.
//!
//! Source: <https://wiki.ros.org/Bags/Format/2.0>. The crate `rosbag` also reads this format. It is not used because it
//! maps the file into memory, and because it panics if the recorder did not close the bag.

use std::collections::btree_map::OccupiedEntry;
use std::collections::{BTreeMap, VecDeque};
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use bzip2::read::BzDecoder;
use dataset::{Loss, LossKind, Losses, Subject};

use super::{Bag, Connection, Message, Selection};
use crate::error::ImportError;
use crate::input::{Meter, Metered, bytes, excerpt, file_name, read_full};
use crate::record::is_representable;

/// The first line of a bag.
const MAGIC: &[u8] = b"#ROSBAG V2.0\n";
/// Kinds of records.
const OP_MESSAGE: u8 = 0x02;
const OP_BAG: u8 = 0x03;
const OP_INDEX: u8 = 0x04;
const OP_CHUNK: u8 = 0x05;
const OP_CHUNK_INFO: u8 = 0x06;
const OP_CONNECTION: u8 = 0x07;
/// The longest header of a record that is read \[bytes\]. Headers have some hundred bytes.
const MAX_HEADER_BYTES: u32 = 1 << 20;
/// The largest chunk that is unpacked \[bytes\]. Recorders write chunks of 768 kB, or of one larger message.
const MAX_CHUNK_BYTES: u32 = 1 << 30;

/// A bag file.
pub(super) struct File {
    path: PathBuf,
    reader: BufReader<Metered>,
    n_bytes: u64,
    /// The byte that is read next.
    at: u64,
    selection: Selection,
    connections: Vec<Connection>,
    /// The index of each connection by its number in the bag.
    by_number: BTreeMap<u32, usize>,
    /// Start and position of the chunks that were not read yet, by the index, in the order of time.
    chunks: VecDeque<(i64, u64)>,
    /// Whether the bag has a complete index. Otherwise, the recorder did not close it, or it was cut off: it is read from
    /// start to end.
    is_indexed: bool,
    /// The messages that were read, by time and order.
    ready: BTreeMap<(i64, u64), Message>,
    n_read: u64,
    /// Whether the bag was closed, but its end is missing.
    is_cut: bool,
    /// Whether the last chunk has no length, because the recorder was still writing it.
    is_in_open_chunk: bool,
    has_ended: bool,
}

/// What the header of a bag says.
struct Start {
    index_at: u64,
    n_chunks: u32,
}

/// A record of the file. Its data follows.
struct Record {
    header: Vec<u8>,
    n_data: u32,
}

/// Why no record was read.
enum Stop {
    End,
    Truncated,
    Damaged,
    Io(io::Error),
}

impl From<io::Error> for Stop {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::UnexpectedEof => Self::Truncated,
            _ => Self::Io(error),
        }
    }
}

impl File {
    pub(super) fn open(
        path: &Path,
        selection: &Selection,
        meter: &Meter,
    ) -> Result<Self, ImportError> {
        let n_bytes =
            std::fs::metadata(path).map_err(|source| ImportError::io("read", path, source))?.len();
        let reader = bytes(path, meter)?;
        let mut file = Self {
            path: path.to_owned(),
            reader,
            n_bytes,
            at: 0,
            selection: selection.clone(),
            connections: Vec::new(),
            by_number: BTreeMap::new(),
            chunks: VecDeque::new(),
            is_indexed: false,
            ready: BTreeMap::new(),
            n_read: 0,
            is_cut: false,
            is_in_open_chunk: false,
            has_ended: false,
        };
        let start = file.read_start()?;
        if (file.at..n_bytes).contains(&start.index_at) {
            file.read_index(&start)?;
        }
        let n_listed = file.chunks.len() as u64;
        file.is_cut = n_bytes < start.index_at || n_listed < start.n_chunks.into();
        Ok(file)
    }

    /// Reads the first line and the header of the bag.
    fn read_start(&mut self) -> Result<Start, ImportError> {
        let mut magic = [0; MAGIC.len()];
        let n = read_full(&mut self.reader, &mut magic).map_err(|source| self.io(source))?;
        self.at = n as u64;
        if magic != MAGIC {
            let found = excerpt(String::from_utf8_lossy(&magic[..n]).trim_end());
            let expected = "`#ROSBAG V2.0`; update older bags with `rosbag fix`";
            return Err(ImportError::unexpected(&self.path, "the first line", found, expected));
        }
        let unexpected = |file: &Self, found: &str| {
            let expected = "the header of a bag that is not encrypted (`rosbag decrypt`)";
            ImportError::unexpected(&file.path, "the first record", found, expected)
        };
        let record = match self.record() {
            Ok(record) if op(&record.header) == Some(OP_BAG) => record,
            Ok(_) => return Err(unexpected(self, "another record")),
            Err(Stop::Io(source)) => return Err(self.io(source)),
            Err(_) => return Err(unexpected(self, "no record")),
        };
        if field(&record.header, "encryptor").is_some_and(|value| !value.is_empty()) {
            return Err(unexpected(self, "an encrypted bag"));
        }
        let index_at = field(&record.header, "index_pos").and_then(|value| value.try_into().ok());
        let n_chunks = number(&record.header, "chunk_count").unwrap_or(0);
        self.skip(record.n_data).map_err(|source| self.io(source))?;
        Ok(Start { index_at: index_at.map_or(0, u64::from_le_bytes), n_chunks })
    }

    /// Reads the connections and the list of chunks after the chunks, and returns to the chunks.
    fn read_index(&mut self, start: &Start) -> Result<(), ImportError> {
        let first_chunk = self.at;
        self.seek(start.index_at)?;
        let mut chunks = Vec::new();
        loop {
            let record = match self.record() {
                Ok(record) => record,
                Err(Stop::Io(source)) => return Err(self.io(source)),
                Err(_) => break,
            };
            match op(&record.header) {
                Some(OP_CONNECTION) => {
                    let data = self.data(record.n_data).map_err(|source| self.io(source))?;
                    self.add_connection(&record.header, &data);
                }
                kind => {
                    if kind == Some(OP_CHUNK_INFO) {
                        chunks.extend(chunk_start(&record.header));
                    }
                    self.skip(record.n_data).map_err(|source| self.io(source))?;
                }
            }
        }
        self.is_indexed = !chunks.is_empty() && chunks.len() == start.n_chunks as usize;
        chunks.sort_unstable();
        self.chunks = chunks.into();
        self.seek(first_chunk)
    }

    /// Reads the next chunk by the index.
    fn advance_by_index(&mut self, losses: &mut Losses) -> Result<(), ImportError> {
        let Some((_, at)) = self.chunks.pop_front() else {
            self.has_ended = true;
            return Ok(());
        };
        self.seek(at)?;
        let read = self.record().and_then(|record| match op(&record.header) {
            Some(OP_CHUNK) => {
                let data = self.data(record.n_data)?;
                self.read_chunk(&record.header, &data, losses);
                Ok(())
            }
            _ => Err(Stop::Damaged),
        });
        match read {
            Ok(()) => Ok(()),
            Err(Stop::Io(source)) => Err(self.io(source)),
            Err(_) => {
                losses.add(self.loss(LossKind::DamagedBagChunks), 1);
                Ok(())
            }
        }
    }

    fn io(&self, source: io::Error) -> ImportError {
        ImportError::io("read", &self.path, source)
    }

    fn seek(&mut self, to: u64) -> Result<(), ImportError> {
        self.reader.seek(SeekFrom::Start(to)).map_err(|source| self.io(source))?;
        self.at = to;
        Ok(())
    }

    /// Reads the next record up to its data.
    fn record(&mut self) -> Result<Record, Stop> {
        if self.n_bytes <= self.at {
            return Err(Stop::End);
        }
        let n_header = self.number()?;
        if MAX_HEADER_BYTES < n_header {
            return Err(Stop::Damaged);
        }
        let header = self.data(n_header)?;
        let n_data = self.number()?;
        match op(&header) {
            None => Err(Stop::Damaged),
            Some(_) if self.n_bytes < self.at + u64::from(n_data) => Err(Stop::Truncated),
            Some(_) => Ok(Record { header, n_data }),
        }
    }

    fn number(&mut self) -> io::Result<u32> {
        let mut bytes = [0; 4];
        self.reader.read_exact(&mut bytes)?;
        self.at += 4;
        Ok(u32::from_le_bytes(bytes))
    }

    fn data(&mut self, n: u32) -> io::Result<Vec<u8>> {
        let mut data = Vec::new();
        let read = (&mut self.reader).take(n.into()).read_to_end(&mut data)?;
        self.at += read as u64;
        match read == n as usize {
            true => Ok(data),
            false => Err(io::ErrorKind::UnexpectedEof.into()),
        }
    }

    fn skip(&mut self, n: u32) -> io::Result<()> {
        self.reader.seek_relative(n.into())?;
        self.at += u64::from(n);
        Ok(())
    }

    /// Reads the next record. Messages are added to `ready`.
    fn advance(&mut self, losses: &mut Losses) -> Result<(), ImportError> {
        if self.is_indexed {
            return self.advance_by_index(losses);
        }
        let start = self.at;
        let read = self.record().and_then(|record| {
            match op(&record.header) {
                Some(OP_CHUNK) => {
                    let data = self.data(record.n_data)?;
                    self.is_in_open_chunk = data.is_empty();
                    self.read_chunk(&record.header, &data, losses);
                }
                Some(OP_CONNECTION) => {
                    let data = self.data(record.n_data)?;
                    self.add_connection(&record.header, &data);
                }
                // In a chunk that is not packed, and whose length was not written yet.
                Some(OP_MESSAGE) => {
                    let data = self.data(record.n_data)?;
                    if let Some(message) = self.message(&record.header, &data, losses) {
                        self.add(message);
                    }
                }
                // The index is not needed.
                Some(OP_INDEX | OP_CHUNK_INFO) => self.skip(record.n_data)?,
                _ => return Err(Stop::Damaged),
            }
            Ok(())
        });
        let kind = match read {
            Ok(()) => return Ok(()),
            Err(Stop::Io(source)) => return Err(self.io(source)),
            Err(Stop::End) => self.is_cut.then_some(LossKind::TruncatedBag),
            Err(Stop::Truncated) => Some(LossKind::TruncatedBag),
            Err(Stop::Damaged) if self.is_in_open_chunk => Some(LossKind::TruncatedBag),
            Err(Stop::Damaged) => Some(LossKind::DamagedBag { at_byte: start }),
        };
        self.has_ended = true;
        if let Some(kind) = kind {
            losses.add(self.loss(kind), 1);
        }
        Ok(())
    }

    fn loss(&self, kind: LossKind) -> Loss {
        Loss::new(kind, Subject::file(file_name(&self.path)))
    }

    /// Adds the connections and messages of a chunk.
    fn read_chunk(&mut self, header: &[u8], data: &[u8], losses: &mut Losses) {
        let Some(chunk) = unpack(header, data) else {
            losses.add(self.loss(LossKind::DamagedBagChunks), 1);
            return;
        };
        let mut rest = chunk.as_slice();
        let mut is_damaged = false;
        while !rest.is_empty() {
            let record = part(&mut rest).zip(part(&mut rest));
            let Some((header, data)) = record.filter(|(header, _)| op(header).is_some()) else {
                is_damaged = true;
                break;
            };
            match op(header) {
                Some(OP_CONNECTION) => self.add_connection(header, data),
                Some(OP_MESSAGE) => {
                    if let Some(message) = self.message(header, data, losses) {
                        self.add(message);
                    }
                }
                _ => is_damaged = true,
            }
        }
        if is_damaged {
            losses.add(self.loss(LossKind::DamagedBagChunks), 1);
        }
    }

    fn add(&mut self, message: Message) {
        self.ready.insert((message.stamp_ns, self.n_read), message);
        self.n_read += 1;
    }

    fn message(&self, header: &[u8], data: &[u8], losses: &mut Losses) -> Option<Message> {
        let connection = number(header, "conn").and_then(|number| self.by_number.get(&number));
        let Some(&connection) = connection else {
            losses.add(self.loss(LossKind::MessagesWithoutConnection), 1);
            return None;
        };
        let Some(stamp_ns) = field(header, "time").and_then(time_ns) else {
            losses.add(self.loss(LossKind::DamagedMessages), 1);
            return None;
        };
        if !self.selection.contains(&self.connections[connection].topic) {
            return None;
        }
        if !is_representable(stamp_ns) {
            let kind = LossKind::TimesOutOfRange { item: "message".to_owned() };
            losses.add(Loss::new(kind, Subject::topic(&self.connections[connection].topic)), 1);
            return None;
        }
        Some(Message { connection, stamp_ns, data: data.to_vec() })
    }

    /// Adds a connection, if it is not known. One without topic or type is left out, so that its messages are counted.
    fn add_connection(&mut self, header: &[u8], data: &[u8]) {
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        let topic = field(header, "topic").map(text);
        let message_type = field(data, "type").map(text);
        let (Some(number), Some(topic), Some(message_type)) =
            (number(header, "conn"), topic, message_type)
        else {
            return;
        };
        let described = |name: &str| Some((name.to_owned(), text(field(data, name)?)));
        let connection = Connection {
            topic,
            message_type,
            encoding: "ros1".to_owned(),
            definition_encoding: "ros1msg".to_owned(),
            definition: field(data, "message_definition").unwrap_or_default().to_vec(),
            metadata: ["callerid", "latching", "md5sum"]
                .into_iter()
                .filter_map(described)
                .collect(),
        };
        self.by_number.entry(number).or_insert_with(|| {
            self.connections.push(connection);
            self.connections.len() - 1
        });
    }
}

impl Bag for File {
    fn knows_topics(&self) -> bool {
        self.is_indexed
    }

    fn connections(&self) -> &[Connection] {
        &self.connections
    }

    fn peek(&mut self, losses: &mut Losses) -> Result<Option<i64>, ImportError> {
        while self.ready.is_empty() && !self.has_ended && !self.is_indexed {
            self.advance(losses)?;
        }
        let first = self.ready.first_key_value().map(|(&(stamp_ns, _), _)| stamp_ns);
        let chunk = self.chunks.front().filter(|_| self.is_indexed).map(|&(start_ns, _)| start_ns);
        Ok(first.into_iter().chain(chunk).min())
    }

    fn next(&mut self, losses: &mut Losses) -> Result<Option<Message>, ImportError> {
        let Some(at_ns) = self.peek(losses)? else { return Ok(None) };
        // Chunks that begin at this time or before can have earlier messages.
        while self.is_indexed && self.chunks.front().is_some_and(|&(start_ns, _)| start_ns <= at_ns)
        {
            self.advance(losses)?;
        }
        let first = self.ready.first_entry().filter(|first| first.key().0 <= at_ns);
        Ok(first.map(OccupiedEntry::remove))
    }
}

/// Start and position of a chunk, from its record in the index.
fn chunk_start(header: &[u8]) -> Option<(i64, u64)> {
    let at = u64::from_le_bytes(field(header, "chunk_pos")?.try_into().ok()?);
    Some((time_ns(field(header, "start_time")?)?, at))
}

/// A time of 4 bytes of seconds and 4 bytes of nanoseconds \[ns since the epoch\].
fn time_ns(bytes: &[u8]) -> Option<i64> {
    let (seconds, ns) = bytes.split_first_chunk()?;
    let [seconds, ns] = [*seconds, ns.try_into().ok()?].map(u32::from_le_bytes).map(i64::from);
    Some(seconds * 1_000_000_000 + ns)
}

/// The bytes of a chunk. `None` if they cannot be decompressed, or have another length than the header says.
fn unpack(header: &[u8], data: &[u8]) -> Option<Vec<u8>> {
    let n_bytes = number(header, "size").filter(|n| *n <= MAX_CHUNK_BYTES)?;
    let mut chunk = Vec::new();
    // No more than the header says: a damaged chunk must not fill the memory.
    let most = u64::from(n_bytes) + 1;
    let read = match field(header, "compression")? {
        b"none" => data.take(most).read_to_end(&mut chunk),
        b"bz2" => BzDecoder::new(data).take(most).read_to_end(&mut chunk),
        b"lz4" => lz4::Decoder::new(data).ok()?.take(most).read_to_end(&mut chunk),
        _ => return None,
    };
    (read.ok()? == n_bytes as usize).then_some(chunk)
}

/// Takes a length and as many bytes from the start.
fn part<'a>(rest: &mut &'a [u8]) -> Option<&'a [u8]> {
    let (length, after) = rest.split_first_chunk()?;
    let (part, after) = after.split_at_checked(u32::from_le_bytes(*length) as usize)?;
    *rest = after;
    Some(part)
}

/// The value of a field of a header.
fn field<'a>(header: &'a [u8], name: &str) -> Option<&'a [u8]> {
    let mut rest = header;
    while let Some(field) = part(&mut rest) {
        let at = field.iter().position(|&byte| byte == b'=')?;
        if &field[..at] == name.as_bytes() {
            return Some(&field[at + 1..]);
        }
    }
    None
}

fn number(header: &[u8], name: &str) -> Option<u32> {
    Some(u32::from_le_bytes(field(header, name)?.try_into().ok()?))
}

/// The kind of a record.
fn op(header: &[u8]) -> Option<u8> {
    match field(header, "op")? {
        &[op] => Some(op),
        _ => None,
    }
}
