//! Reads ROS 1 bags of version 2.0.
//!
//! Source: <https://wiki.ros.org/Bags/Format/2.0>. The crate `rosbag` also reads this format. It is not used because it
//! maps the file into memory, and because it panics if the recorder did not close the bag.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
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
    /// The messages of the last chunk.
    ready: VecDeque<Message>,
    has_ended: bool,
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
            ready: VecDeque::new(),
            has_ended: false,
        };
        let index_at = file.read_start()?;
        // Without an index, the recorder did not close the bag. Its connections are in the chunks as well.
        if (file.at..n_bytes).contains(&index_at) {
            file.read_index(index_at)?;
        }
        Ok(file)
    }

    /// Reads the first line and the header of the bag. Returns the position of its index.
    fn read_start(&mut self) -> Result<u64, ImportError> {
        let mut magic = [0; MAGIC.len()];
        let n = read_full(&mut self.reader, &mut magic).map_err(|source| self.io(source))?;
        self.at = n as u64;
        if magic != MAGIC {
            let found = excerpt(String::from_utf8_lossy(&magic[..n]).trim_end());
            let expected = "`#ROSBAG V2.0`; update older bags with `rosbag fix`";
            return Err(ImportError::unexpected(&self.path, "the first line", found, expected));
        }
        let unexpected = |file: &Self, found: &str| {
            let expected = "the header of a bag, without encryption";
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
        self.skip(record.n_data).map_err(|source| self.io(source))?;
        Ok(index_at.map_or(0, u64::from_le_bytes))
    }

    /// Reads the connections after the chunks, and returns to the chunks.
    fn read_index(&mut self, index_at: u64) -> Result<(), ImportError> {
        let start = self.at;
        self.seek(index_at)?;
        loop {
            match self.record() {
                Ok(record) if op(&record.header) == Some(OP_CONNECTION) => {
                    let data = self.data(record.n_data).map_err(|source| self.io(source))?;
                    self.add_connection(&record.header, &data);
                }
                Ok(record) => self.skip(record.n_data).map_err(|source| self.io(source))?,
                Err(Stop::Io(source)) => return Err(self.io(source)),
                Err(_) => break,
            }
        }
        self.seek(start)
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

    /// Reads the next record. Messages of chunks are added to `ready`.
    fn advance(&mut self, losses: &mut Losses) -> Result<(), ImportError> {
        let start = self.at;
        let read = self.record().and_then(|record| {
            match op(&record.header) {
                Some(OP_CHUNK) => {
                    let data = self.data(record.n_data)?;
                    self.read_chunk(&record.header, &data, losses);
                }
                Some(OP_CONNECTION) => {
                    let data = self.data(record.n_data)?;
                    self.add_connection(&record.header, &data);
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
            Err(Stop::End) => None,
            Err(Stop::Truncated) => Some(LossKind::TruncatedBag),
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
        let mut messages = Vec::new();
        while !rest.is_empty() {
            let record = part(&mut rest).zip(part(&mut rest));
            let Some((header, data)) = record.filter(|(header, _)| op(header).is_some()) else {
                losses.add(self.loss(LossKind::DamagedBagChunks), 1);
                break;
            };
            match op(header) {
                Some(OP_CONNECTION) => self.add_connection(header, data),
                Some(OP_MESSAGE) => messages.extend(self.message(header, data, losses)),
                _ => {}
            }
        }
        messages.sort_by_key(|message| message.stamp_ns);
        self.ready.extend(messages);
    }

    fn message(&self, header: &[u8], data: &[u8], losses: &mut Losses) -> Option<Message> {
        let connection = number(header, "conn").and_then(|number| self.by_number.get(&number));
        let time = field(header, "time").filter(|time| time.len() == 8);
        let (Some(&connection), Some(time)) = (connection, time) else {
            losses.add(self.loss(LossKind::MessagesWithoutConnection), 1);
            return None;
        };
        if !self.selection.contains(&self.connections[connection].topic) {
            return None;
        }
        let [seconds, ns] = [0, 4].map(|from| {
            time[from..].first_chunk().map_or(0, |bytes| i64::from(u32::from_le_bytes(*bytes)))
        });
        let stamp_ns = seconds * 1_000_000_000 + ns;
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
    fn topics(&self) -> BTreeSet<String> {
        self.connections.iter().map(|connection| connection.topic.clone()).collect()
    }

    fn connections(&self) -> &[Connection] {
        &self.connections
    }

    fn next(&mut self, losses: &mut Losses) -> Result<Option<Message>, ImportError> {
        while self.ready.is_empty() && !self.has_ended {
            self.advance(losses)?;
        }
        Ok(self.ready.pop_front())
    }
}

/// The bytes of a chunk. `None` if they cannot be decompressed, or have another length than the header says.
fn unpack(header: &[u8], data: &[u8]) -> Option<Vec<u8>> {
    let n_bytes = number(header, "size")?;
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
