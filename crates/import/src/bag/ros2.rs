//! Reads ROS 2 bags of the storage plugin `sqlite3`, also packed with Zstandard.
//!
//! Source: rosbag2, `rosbag2_storage_sqlite3` (tables `topics`, `messages` and, from Iron on, `message_definitions`) and
//! `rosbag2_compression` (whole files `.db3.zstd`, or each message).

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::ffi::OsStr;
use std::io;
use std::path::{Path, PathBuf};

use dataset::{Loss, LossKind, Losses, Subject};
use messages::{Encoding, MessageType, schemas};
use rusqlite::{Connection as Database, OpenFlags, OptionalExtension, params};
use tempfile::TempPath;
use yaml_rust2::{Yaml, YamlLoader};

use super::{Bag, Connection, Message, Selection};
use crate::error::ImportError;
use crate::input::{Meter, file_name};
use crate::options::Options;
use crate::record::is_representable;
use crate::sniff::entries;

/// The description of a bag, in its folder.
const METADATA: &str = "metadata.yaml";
/// The first bytes of data packed with Zstandard (RFC 8878, section 3.1.1). Messages in CDR start with a zero.
const ZSTD_MAGIC: &[u8] = b"\x28\xB5\x2F\xFD";
/// Number of messages that are read at a time.
const N_ROWS: i64 = 32;
/// The messages after one with this time and number. rosbag2 stores an index of the times.
const AFTER_IN_TIME: &str = "SELECT timestamp, id, topic_id, data FROM messages \
    WHERE (timestamp, id) > (?1, ?2) ORDER BY timestamp, id LIMIT ?3";
/// The same without an index, in the order in which they were stored: sorting needs all of them.
const AFTER_AS_STORED: &str = "SELECT timestamp, id, topic_id, data FROM messages \
    WHERE ?1 IS NOT NULL AND id > ?2 ORDER BY id LIMIT ?3";

/// Whether a folder has the layout of a bag of `sqlite3`.
pub(crate) fn is_bag_folder(folder: &Path) -> bool {
    let is_database = |path: &PathBuf| is_database(path) && path.is_file();
    entries(folder).is_ok_and(|entries| entries.iter().any(is_database))
}

/// Whether a name is that of a database, perhaps packed.
fn is_database(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending == "db3") || is_packed(path)
}

/// Whether a name is that of a packed database.
pub(crate) fn is_packed(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending == "zstd" || ending == "zst")
        && path.file_stem().map(Path::new).and_then(Path::extension) == Some(OsStr::new("db3"))
}

/// The files of a bag: those that its description lists, or all databases in the folder.
pub(crate) fn bag_files(folder: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let mut present = entries(folder)?;
    present.retain(|path| is_database(path));
    let description = folder.join(METADATA);
    if !description.is_file() {
        return Ok(present);
    }
    let text = std::fs::read_to_string(&description)
        .map_err(|source| ImportError::io("read", &description, source))?;
    let listed = listed_files(&text).ok_or_else(|| {
        let expected = "`relative_file_paths` under `rosbag2_bagfile_information`";
        ImportError::unexpected(&description, "the document", "another content", expected)
    })?;
    let mut files: Vec<PathBuf> = listed.iter().map(|name| folder.join(name)).collect();
    // The recorder lists a file before it packs it, and versions differ in which name is listed.
    for file in &mut files {
        let packed = file.with_added_extension("zstd");
        let unpacked = file.with_extension("");
        if !file.exists() {
            if let Some(found) = [packed, unpacked].into_iter().find(|path| present.contains(path))
            {
                *file = found;
            }
        }
    }
    // A recorder that was stopped has not listed its last files.
    for file in present {
        if !files.contains(&file) {
            files.push(file);
        }
    }
    Ok(files)
}

/// The files that a description lists.
fn listed_files(text: &str) -> Option<Vec<String>> {
    let documents = YamlLoader::load_from_str(text).ok()?;
    let information = &documents.first()?["rosbag2_bagfile_information"];
    let files = information["relative_file_paths"].as_vec()?;
    Some(files.iter().filter_map(Yaml::as_str).map(str::to_owned).collect())
}

/// A database of a bag.
pub(super) struct File {
    path: PathBuf,
    database: Database,
    /// The unpacked file, which is deleted at the end.
    _unpacked: Option<TempPath>,
    meter: Meter,
    connections: Vec<Connection>,
    /// The number in the database, and whether it is selected, of each connection.
    numbers: Vec<(i64, bool)>,
    /// The messages after one, in the order of time.
    select: &'static str,
    /// Time and number of the last message that was read.
    last: (i64, i64),
    ready: VecDeque<Message>,
    has_ended: bool,
}

impl File {
    pub(super) fn open(
        path: &Path,
        options: &Options,
        selection: &Selection,
        meter: &Meter,
    ) -> Result<Self, ImportError> {
        std::fs::metadata(path).map_err(|source| ImportError::io("read", path, source))?;
        let unpacked = match is_packed(path) {
            true => Some(unpack(path, options)?),
            false => None,
        };
        let read: &Path = unpacked.as_deref().unwrap_or(path);
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let database = Database::open_with_flags(read, flags);
        let database = database.map_err(|error| damaged(path, &error))?;
        let topics = topics(&database).map_err(|error| damaged(path, &error))?;
        let definitions = definitions(&database).map_err(|error| damaged(path, &error))?;
        let select = match has_times_indexed(&database).map_err(|error| damaged(path, &error))? {
            true => AFTER_IN_TIME,
            false => AFTER_AS_STORED,
        };
        let numbers = topics.iter().map(|topic| (topic.number, selection.contains(&topic.name)));
        let numbers = numbers.collect();
        let connections = topics.into_iter().map(|topic| topic.connection(&definitions)).collect();
        Ok(Self {
            path: path.to_owned(),
            database,
            _unpacked: unpacked,
            meter: meter.clone(),
            connections,
            numbers,
            select,
            last: (i64::MIN, i64::MIN),
            ready: VecDeque::new(),
            has_ended: false,
        })
    }

    /// Reads the next messages in the order of time.
    fn advance(&mut self, losses: &mut Losses) -> Result<(), ImportError> {
        let rows = self.rows().map_err(|error| damaged(&self.path, &error))?;
        self.has_ended = rows.is_empty();
        for row in rows {
            self.last = (row.stamp_ns, row.number);
            self.meter.add(row.data.len() as u64);
            let connection = self.numbers.iter().position(|(number, _)| *number == row.topic);
            let Some(connection) = connection else {
                let subject = Subject::file(file_name(&self.path));
                losses.add(Loss::new(LossKind::MessagesWithoutConnection, subject), 1);
                continue;
            };
            if !self.numbers[connection].1 {
                continue;
            }
            let subject = || Subject::topic(&self.connections[connection].topic);
            if !is_representable(row.stamp_ns) {
                let kind = LossKind::TimesOutOfRange { item: "message".to_owned() };
                losses.add(Loss::new(kind, subject()), 1);
                continue;
            }
            let data = match row.data.starts_with(ZSTD_MAGIC) {
                true => zstd::decode_all(row.data.as_slice()).ok(),
                false => Some(row.data),
            };
            match data {
                Some(data) => {
                    self.ready.push_back(Message { connection, stamp_ns: row.stamp_ns, data });
                }
                None => losses.add(Loss::new(LossKind::DamagedMessages, subject()), 1),
            }
        }
        Ok(())
    }

    fn rows(&self) -> rusqlite::Result<Vec<Row>> {
        let mut statement = self.database.prepare(self.select)?;
        let (stamp_ns, number) = self.last;
        let row = |row: &rusqlite::Row<'_>| {
            Ok(Row {
                stamp_ns: row.get(0)?,
                number: row.get(1)?,
                topic: row.get(2)?,
                data: row.get(3)?,
            })
        };
        statement.query_map(params![stamp_ns, number, N_ROWS], row)?.collect()
    }
}

/// A row of the table of messages.
struct Row {
    stamp_ns: i64,
    number: i64,
    topic: i64,
    data: Vec<u8>,
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

fn has_times_indexed(database: &Database) -> rusqlite::Result<bool> {
    let index = "SELECT 1 FROM pragma_index_list('messages') AS list, pragma_index_info(list.name) \
        AS info WHERE info.seqno = 0 AND info.name = 'timestamp'";
    Ok(database.query_row(index, [], |_| Ok(())).optional()?.is_some())
}

/// A row of the table of topics.
struct Topic {
    number: i64,
    name: String,
    message_type: String,
    encoding: String,
}

fn topics(database: &Database) -> rusqlite::Result<Vec<Topic>> {
    let mut statement =
        database.prepare("SELECT id, name, type, serialization_format FROM topics ORDER BY id")?;
    let topic = |row: &rusqlite::Row<'_>| {
        Ok(Topic {
            number: row.get(0)?,
            name: row.get(1)?,
            message_type: row.get(2)?,
            encoding: row.get(3)?,
        })
    };
    statement.query_map([], topic)?.collect()
}

/// Encoding and text of the definitions of message types, by type.
type Definitions = BTreeMap<String, (String, String)>;

/// The definitions in the bag. Bags before Iron have none.
fn definitions(database: &Database) -> rusqlite::Result<Definitions> {
    let table = "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = 'message_definitions'";
    if database.query_row(table, [], |_| Ok(())).optional()?.is_none() {
        return Ok(Definitions::new());
    }
    let mut statement = database.prepare(
        "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions",
    )?;
    let rows = statement.query_map([], |row| Ok((row.get(0)?, (row.get(1)?, row.get(2)?))))?;
    rows.collect()
}

impl Topic {
    fn connection(self, definitions: &Definitions) -> Connection {
        let (definition_encoding, definition) = definitions
            .get(&self.message_type)
            .filter(|(_, text)| !text.is_empty())
            .cloned()
            .or_else(|| known_definition(&self.message_type))
            .unwrap_or_else(|| ("ros2msg".to_owned(), String::new()));
        Connection {
            topic: self.name,
            message_type: self.message_type,
            encoding: self.encoding,
            definition_encoding,
            definition: definition.into_bytes(),
            metadata: BTreeMap::new(),
        }
    }
}

/// The definition of a type that loopboost itself writes.
fn known_definition(message_type: &str) -> Option<(String, String)> {
    let schema = schemas::of(MessageType::from_schema_name(message_type)?, Encoding::Cdr)?;
    Some((schema.encoding.to_owned(), schema.text))
}

/// Unpacks a database to a temporary file.
fn unpack(path: &Path, options: &Options) -> Result<TempPath, ImportError> {
    let error = |source| ImportError::io("unpack", path, source);
    let packed = std::fs::File::open(path).map_err(error)?;
    let mut unpacked = match &options.scratch {
        Some(folder) => tempfile::NamedTempFile::new_in(folder),
        None => tempfile::NamedTempFile::new(),
    }
    .map_err(error)?;
    let mut decoder = zstd::Decoder::new(packed).map_err(error)?;
    io::copy(&mut decoder, &mut unpacked).map_err(error)?;
    Ok(unpacked.into_temp_path())
}

fn damaged(path: &Path, error: &rusqlite::Error) -> ImportError {
    let expected = "the tables `topics` and `messages` of a ROS 2 bag";
    ImportError::unexpected(path, "the database", error.to_string(), expected)
}
