//! Reads ROS 2 bags of the storage plugin `sqlite3`, also packed with Zstandard.
//!
//! Source: rosbag2, `rosbag2_storage_sqlite3` (tables `topics`, `messages` and, from Iron on, `message_definitions`) and
//! `rosbag2_compression` (whole files `.db3.zstd`, or each message).

use std::collections::{BTreeMap, VecDeque};
use std::ffi::OsStr;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use dataset::{Loss, LossKind, Losses, Subject};
use messages::{Encoding, MessageType, schemas};
use rusqlite::{Connection as Database, ErrorCode, OpenFlags, OptionalExtension};
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
/// The largest message that is unpacked \[bytes\].
const MAX_MESSAGE_BYTES: u64 = 1 << 28;

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
        present.retain(|path| !is_packed(path) || !path.with_extension("").exists());
        return Ok(present);
    }
    let text = std::fs::read_to_string(&description)
        .map_err(|source| ImportError::io("read", &description, source))?;
    let listed = listed_files(&text).ok_or_else(|| {
        let expected = "`relative_file_paths` under `rosbag2_bagfile_information`";
        ImportError::unexpected(&description, "the document", "another content", expected)
    })?;
    let mut files = Vec::new();
    for name in &listed {
        let file = found_file(folder, Path::new(name)).unwrap_or_else(|| folder.join(name));
        if !files.contains(&file) {
            files.push(file);
        }
    }
    // A recorder that was stopped has not listed its last files. A packed file that was played has its unpacked one next
    // to it: one of them is enough.
    let names = |file: &Path| -> Option<PathBuf> {
        let name = Path::new(file.file_name()?);
        Some(if is_packed(name) { name.with_extension("") } else { name.to_owned() })
    };
    for file in present {
        if !files.iter().any(|other| names(other) == names(&file)) {
            files.push(file);
        }
    }
    Ok(files)
}

/// The file of a bag with this name, packed or not. Descriptions before version 4 name the file from the folder around the
/// bag, and those of packed bags list the name before or after packing.
fn found_file(folder: &Path, name: &Path) -> Option<PathBuf> {
    let names = [Some(name), name.file_name().map(Path::new)].into_iter().flatten();
    let variants = |name: &Path| {
        let bare = if is_packed(name) { name.with_extension("") } else { name.to_owned() };
        let packed = ["zstd", "zst"].map(|ending| bare.with_added_extension(ending));
        [vec![name.to_owned(), bare], packed.into()].concat()
    };
    names.flat_map(variants).map(|name| folder.join(name)).find(|path| path.is_file())
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
    scratch: Option<PathBuf>,
    /// Open from the first message to the last one, so that only a few files are open at a time. A packed file is unpacked
    /// twice: for the list of its messages, and for the messages.
    opened: Option<Opened>,
    meter: Meter,
    connections: Vec<Connection>,
    /// The selected messages that were not read yet, in the order of time.
    rows: VecDeque<Row>,
    /// What was found when the file was opened, until it is reported.
    faults: Vec<(LossKind, u64)>,
}

/// Time, number and connection of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Row {
    stamp_ns: i64,
    number: i64,
    connection: usize,
}

/// An open database.
struct Opened {
    database: Database,
    /// The unpacked file, which is deleted at the end.
    _unpacked: Option<TempPath>,
}

impl Opened {
    fn of(path: &Path, scratch: Option<&Path>) -> Result<Self, ImportError> {
        let unpacked = match is_packed(path) {
            true => Some(unpack(path, scratch)?),
            false => None,
        };
        let read: &Path = unpacked.as_deref().unwrap_or(path);
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        // SQLite would write files next to a database with a write-ahead log, even to read it. It need not if there is no
        // such log any more.
        let database = match unpacked.is_some() || !has_log(read) {
            true => Database::open_with_flags(unchanging(read), flags | OpenFlags::SQLITE_OPEN_URI),
            false => Database::open_with_flags(read, flags),
        };
        let database = database.map_err(|error| damaged(path, &error))?;
        Ok(Self { database, _unpacked: unpacked })
    }
}

/// Whether a database has changes that are not in its file yet.
fn has_log(path: &Path) -> bool {
    let mut log = path.as_os_str().to_owned();
    log.push("-wal");
    std::fs::metadata(log).is_ok_and(|log| 0 < log.len())
}

/// The address of a database that does not change while it is read (sqlite.org/uri.html).
fn unchanging(path: &Path) -> String {
    let mut address = "file:".to_owned();
    for byte in path.to_string_lossy().bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'.' | b'_' | b'-' | b'~' => {
                address.push(byte.into());
            }
            _ => address += &format!("%{byte:02X}"),
        }
    }
    address + "?immutable=1"
}

impl File {
    pub(super) fn open(
        path: &Path,
        options: &Options,
        selection: &Selection,
        meter: &Meter,
    ) -> Result<Self, ImportError> {
        let n_bytes =
            std::fs::metadata(path).map_err(|source| ImportError::io("read", path, source))?.len();
        let mut file = Self {
            path: path.to_owned(),
            scratch: options.scratch.clone(),
            opened: None,
            meter: meter.clone(),
            connections: Vec::new(),
            rows: VecDeque::new(),
            faults: Vec::new(),
        };
        // The last file of a recorder that lost its power.
        if n_bytes == 0 {
            file.faults.push((LossKind::TruncatedBag, 1));
            return Ok(file);
        }
        let opened = Opened::of(path, file.scratch.as_deref())?;
        let failed = |error| damaged(path, &error);
        let topics = topics(&opened.database).map_err(failed)?;
        let definitions = definitions(&opened.database).map_err(failed)?;
        let numbers: BTreeMap<i64, usize> =
            topics.iter().enumerate().map(|(k, topic)| (topic.number, k)).collect();
        file.connections = topics.into_iter().map(|topic| topic.connection(&definitions)).collect();
        file.list(&opened.database, &numbers, selection).map_err(failed)?;
        Ok(file)
    }

    /// Lists the messages. The table is read without its index, which can be missing or damaged.
    fn list(
        &mut self,
        database: &Database,
        numbers: &BTreeMap<i64, usize>,
        selection: &Selection,
    ) -> rusqlite::Result<()> {
        let mut statement =
            database.prepare("SELECT timestamp, id, topic_id FROM messages NOT INDEXED")?;
        let mut found = statement.query([])?;
        let mut rows = Vec::new();
        let (mut n_unknown, mut n_untimed) = (0, 0);
        loop {
            let row = match found.next() {
                Ok(Some(row)) => row,
                Ok(None) => break,
                Err(_) => {
                    self.faults.push((LossKind::DamagedDatabase, 1));
                    break;
                }
            };
            let connection = row.get(2).ok().and_then(|number: i64| numbers.get(&number));
            let time = row.get(0).ok().filter(|stamp_ns| is_representable(*stamp_ns));
            match (connection, time, row.get(1)) {
                (None, ..) => n_unknown += 1,
                (Some(_), None, _) | (_, _, Err(_)) => n_untimed += 1,
                (Some(&connection), Some(stamp_ns), Ok(number)) => {
                    if selection.contains(&self.connections[connection].topic) {
                        rows.push(Row { stamp_ns, number, connection });
                    }
                }
            }
        }
        rows.sort_unstable();
        self.rows = rows.into();
        let untimed = LossKind::TimesOutOfRange { item: "message".to_owned() };
        for (kind, n) in [(LossKind::MessagesWithoutConnection, n_unknown), (untimed, n_untimed)] {
            if 0 < n {
                self.faults.push((kind, n));
            }
        }
        Ok(())
    }

    /// The bytes of a message, unpacked. `None` if they are damaged.
    fn data(&mut self, row: &Row) -> Result<Option<Vec<u8>>, ImportError> {
        let opened = match self.opened.take() {
            Some(opened) => opened,
            None => Opened::of(&self.path, self.scratch.as_deref())?,
        };
        let opened = self.opened.insert(opened);
        let select = "SELECT data FROM messages WHERE id = ?1";
        let data: rusqlite::Result<Vec<u8>> =
            opened.database.query_row(select, [row.number], |row| row.get(0));
        let Ok(data) = data else { return Ok(None) };
        self.meter.add(data.len() as u64);
        if !data.starts_with(ZSTD_MAGIC) {
            return Ok(Some(data));
        }
        let mut unpacked = Vec::new();
        let Ok(decoder) = zstd::Decoder::new(data.as_slice()) else { return Ok(None) };
        let read = decoder.take(MAX_MESSAGE_BYTES + 1).read_to_end(&mut unpacked);
        Ok(read.is_ok_and(|n| n as u64 <= MAX_MESSAGE_BYTES).then_some(unpacked))
    }
}

impl Bag for File {
    fn knows_topics(&self) -> bool {
        true
    }

    fn connections(&self) -> &[Connection] {
        &self.connections
    }

    fn peek(&mut self, losses: &mut Losses) -> Result<Option<i64>, ImportError> {
        for (kind, n) in self.faults.drain(..) {
            losses.add(Loss::new(kind, Subject::file(file_name(&self.path))), n);
        }
        Ok(self.rows.front().map(|row| row.stamp_ns))
    }

    fn next(&mut self, losses: &mut Losses) -> Result<Option<Message>, ImportError> {
        let Some(row) = self.rows.pop_front() else { return Ok(None) };
        let Row { stamp_ns, connection, .. } = row;
        let data = self.data(&row)?;
        if data.is_none() {
            let subject = Subject::topic(&self.connections[connection].topic);
            losses.add(Loss::new(LossKind::DamagedMessages, subject), 1);
        }
        if self.rows.is_empty() {
            self.opened = None;
        }
        Ok(data.map(|data| Message { connection, stamp_ns, data }))
    }
}

/// A row of the table of topics.
struct Topic {
    number: i64,
    name: String,
    message_type: String,
    encoding: String,
    metadata: BTreeMap<String, String>,
}

fn topics(database: &Database) -> rusqlite::Result<Vec<Topic>> {
    let mut statement = database.prepare("SELECT * FROM topics ORDER BY id")?;
    let topic = |row: &rusqlite::Row<'_>| {
        // Old bags do not have all columns. rosbag2 stores them in MCAP logs under these names.
        let described =
            |(column, name): (&str, &str)| Some((name.to_owned(), row.get(column).ok()?));
        let metadata = [
            ("offered_qos_profiles", "offered_qos_profiles"),
            ("type_description_hash", "topic_type_hash"),
        ];
        Ok(Topic {
            number: row.get("id")?,
            name: row.get("name")?,
            message_type: row.get("type")?,
            encoding: row.get("serialization_format")?,
            metadata: metadata.into_iter().filter_map(described).collect(),
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
            metadata: self.metadata,
        }
    }
}

/// The definition of a type that loopboost itself writes.
fn known_definition(message_type: &str) -> Option<(String, String)> {
    let schema = schemas::of(MessageType::from_schema_name(message_type)?, Encoding::Cdr)?;
    Some((schema.encoding.to_owned(), schema.text))
}

/// Unpacks a database to a temporary file.
fn unpack(path: &Path, scratch: Option<&Path>) -> Result<TempPath, ImportError> {
    let error = |source| ImportError::io("unpack", path, source);
    let packed = std::fs::File::open(path).map_err(error)?;
    let mut unpacked = match scratch {
        Some(folder) => tempfile::NamedTempFile::new_in(folder),
        None => tempfile::NamedTempFile::new(),
    }
    .map_err(error)?;
    let mut decoder = zstd::Decoder::new(packed).map_err(error)?;
    io::copy(&mut decoder, &mut unpacked).map_err(error)?;
    Ok(unpacked.into_temp_path())
}

fn damaged(path: &Path, error: &rusqlite::Error) -> ImportError {
    let expected = match error.sqlite_error_code() {
        Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase) => {
            "a whole database; copy the file again, or repair it: `sqlite3 OLD.db3 .recover | sqlite3 NEW.db3`"
        }
        Some(ErrorCode::CannotOpen | ErrorCode::ReadOnly) => {
            "a database that the recorder closed; copy its folder to a place where you can write"
        }
        _ => "the tables `topics` and `messages` of a ROS 2 bag",
    };
    ImportError::unexpected(path, "the database", error.to_string(), expected)
}
