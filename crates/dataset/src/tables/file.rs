//! Reads and writes one table file. Writing is atomic. Reading checks the kind and the version.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{BufWriter, Read, Write};
use std::path::{Path, PathBuf};

use arrow_array::RecordBatch;
use arrow_schema::SchemaRef;
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_reader::{
    ArrowReaderMetadata, ArrowReaderOptions, ParquetRecordBatchReaderBuilder,
};
use parquet::arrow::arrow_writer::ArrowWriterOptions;
use parquet::basic::{Compression, ZstdLevel};
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties, WriterPropertiesBuilder};

use super::{FORMAT_VERSION, Provenance, Result, TableError};

/// Writes a file atomically: `fill` writes to a temporary file in the same folder, which is renamed
/// when it is complete and on disk.
///
/// If there is an error or a crash, `path` is unchanged.
pub fn write_atomically<T, E: From<TableError>>(
    path: &Path,
    fill: impl FnOnce(BufWriter<File>) -> std::result::Result<(BufWriter<File>, T), E>,
) -> std::result::Result<T, E> {
    let io = |action| move |source| TableError::Io { action, path: path.to_owned(), source };
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(|source| TableError::Io {
            action: "create folder",
            path: folder.to_owned(),
            source,
        })?;
    }
    let partial = partial_path(path);
    let written = (|| {
        let file = File::create(&partial).map_err(io("write"))?;
        let (mut writer, value) = fill(BufWriter::with_capacity(1 << 20, file))?;
        writer.flush().map_err(io("write"))?;
        writer.get_ref().sync_all().map_err(io("write"))?;
        fs::rename(&partial, path).map_err(io("write"))?;
        Ok(value)
    })();
    if written.is_err() {
        // Only the first error is reported. If the file cannot be removed, the next run overwrites
        // it.
        let _ = fs::remove_file(&partial);
    }
    written
}

/// Writes a file atomically.
pub fn write_file(path: &Path, bytes: &[u8]) -> Result<()> {
    write_atomically(path, |mut file| match file.write_all(bytes) {
        Ok(()) => Ok((file, ())),
        Err(source) => Err(TableError::Io { action: "write", path: path.to_owned(), source }),
    })
}

/// The path of the temporary file: `.pairs.parquet.partial` for `pairs.parquet`.
fn partial_path(path: &Path) -> PathBuf {
    let mut name = OsString::from(".");
    name.push(path.file_name().unwrap_or_default());
    name.push(".partial");
    path.with_file_name(name)
}

/// Whether the path is a temporary file of [`write_atomically`].
pub fn is_partial(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.starts_with('.') && name.ends_with(".partial")
}

/// Number of bytes that are hashed at a time.
const DIGEST_BLOCK_BYTES: usize = 8 << 20;

/// BLAKE3 digest of the content of a file, in hex.
pub fn digest_file(path: &Path) -> Result<String> {
    let io = |source| read_error(path, source);
    let mut hasher = blake3::Hasher::new();
    // The file is read in blocks to limit the memory. All threads hash the same block.
    let mut file = File::open(path).map_err(io)?;
    let mut block = Vec::with_capacity(DIGEST_BLOCK_BYTES);
    loop {
        block.clear();
        let block_bytes = DIGEST_BLOCK_BYTES as u64;
        if (&mut file).take(block_bytes).read_to_end(&mut block).map_err(io)? == 0 {
            break;
        }
        hasher.update_rayon(&block);
    }
    Ok(hasher.finalize().to_hex().to_string())
}

/// Writer settings of all tables: zstd compression. The version of the Parquet library is not
/// stored, because it would change the bytes with every update of the library.
pub(super) fn properties(metadata: Vec<KeyValue>) -> WriterPropertiesBuilder {
    WriterProperties::builder()
        .set_compression(Compression::ZSTD(ZstdLevel::try_new(1).expect("1 is a zstd level")))
        .set_statistics_enabled(EnabledStatistics::Chunk)
        .set_created_by("loopboost".to_owned())
        .set_key_value_metadata(Some(metadata))
}

/// Writes a table that fits in memory.
pub fn write_table(
    path: &Path,
    kind: &str,
    provenance: &Provenance,
    batch: &RecordBatch,
) -> Result<()> {
    write_table_with(path, kind, provenance, batch, &[])
}

/// Writes a table with further keys and values in its metadata. The prefix `loopboost.` is added to the
/// keys.
pub(super) fn write_table_with(
    path: &Path,
    kind: &str,
    provenance: &Provenance,
    batch: &RecordBatch,
    further: &[(&str, &str)],
) -> Result<()> {
    let mut metadata = provenance.to_metadata(kind);
    metadata.extend(
        further
            .iter()
            .map(|(key, value)| KeyValue::new(format!("loopboost.{key}"), (*value).to_owned())),
    );
    write_atomically(path, |file| {
        let failed = |e: parquet::errors::ParquetError| write_error(path, e);
        // The tables do not need an embedded Arrow schema. Without it, readers in Python show the
        // provenance as the metadata of the schema.
        let options = ArrowWriterOptions::new()
            .with_properties(properties(metadata).build())
            .with_skip_arrow_metadata(true);
        let mut writer =
            ArrowWriter::try_new_with_options(file, batch.schema(), options).map_err(failed)?;
        writer.write(batch).map_err(failed)?;
        Ok((writer.into_inner().map_err(failed)?, ()))
    })
}

pub(super) fn write_error(path: &Path, error: parquet::errors::ParquetError) -> TableError {
    let source = match error {
        parquet::errors::ParquetError::External(inner) => match inner.downcast() {
            Ok(io) => *io,
            Err(other) => std::io::Error::other(other),
        },
        other => std::io::Error::other(other),
    };
    TableError::Io { action: "write", path: path.to_owned(), source }
}

pub(super) fn unreadable(
    path: &Path,
    source: impl Into<Box<dyn std::error::Error + Send + Sync>>,
) -> TableError {
    TableError::Unreadable { path: path.to_owned(), source: source.into() }
}

pub(super) fn read_error(path: &Path, source: std::io::Error) -> TableError {
    let path = path.to_owned();
    match source.kind() {
        std::io::ErrorKind::NotFound => TableError::Missing { path },
        _ => TableError::Io { action: "read", path, source },
    }
}

/// The number of rows of a table of any kind.
pub fn n_rows(path: &Path) -> Result<u64> {
    let file = File::open(path).map_err(|source| read_error(path, source))?;
    let metadata = ArrowReaderMetadata::load(&file, ArrowReaderOptions::new())
        .map_err(|e| unreadable(path, e))?;
    Ok(u64::try_from(metadata.metadata().file_metadata().num_rows()).unwrap_or(0))
}

/// Reads the kind and the provenance of a table of any kind.
pub fn read_provenance(path: &Path) -> Result<(String, Provenance)> {
    let file = File::open(path).map_err(|source| read_error(path, source))?;
    let metadata = ArrowReaderMetadata::load(&file, ArrowReaderOptions::new())
        .map_err(|e| unreadable(path, e))?;
    let get = |key: &str| value_of(&metadata, key);
    // A table without a version is not a table of loopboost.
    if let Some(found) = get("loopboost.format_version") {
        check_version(path, Some(found))?;
    }
    Provenance::from_entries(get).ok_or_else(|| {
        unreadable(path, "the provenance metadata of loopboost is missing or incomplete")
    })
}

/// The value of a key in the metadata of a table.
fn value_of(metadata: &ArrowReaderMetadata, key: &str) -> Option<String> {
    let entries = metadata.metadata().file_metadata().key_value_metadata()?;
    entries.iter().find(|entry| entry.key == key)?.value.clone()
}

fn check_version(path: &Path, found: Option<String>) -> Result<()> {
    if found.as_deref() == Some(&*FORMAT_VERSION.to_string()) {
        return Ok(());
    }
    Err(TableError::Version {
        path: path.to_owned(),
        found: found.unwrap_or_else(|| "none".to_owned()),
        expected: FORMAT_VERSION,
    })
}

/// Opens a table and checks its kind and its format version.
pub(super) fn open_table(
    path: &Path,
    kind: &'static str,
) -> Result<(ParquetRecordBatchReaderBuilder<File>, Provenance)> {
    let file = File::open(path).map_err(|source| read_error(path, source))?;
    let metadata = ArrowReaderMetadata::load(&file, ArrowReaderOptions::new())
        .map_err(|e| unreadable(path, e))?;
    let provenance = {
        let get = |key: &str| value_of(&metadata, &format!("loopboost.{key}"));
        match get("kind") {
            Some(found) if found == kind => {}
            found => {
                return Err(TableError::Kind {
                    path: path.to_owned(),
                    expected: kind,
                    found: found.map_or("not a table of loopboost".to_owned(), |k| {
                        format!("a table of kind `{k}`")
                    }),
                });
            }
        }
        check_version(path, get("format_version"))?;
        Provenance::from_metadata(get)
            .ok_or_else(|| unreadable(path, "the provenance metadata is incomplete"))?
    };
    Ok((ParquetRecordBatchReaderBuilder::new_with_metadata(file, metadata), provenance))
}

/// Reads a complete table of the given kind, and its provenance.
pub fn read_table(path: &Path, kind: &'static str) -> Result<(RecordBatch, Provenance)> {
    read_table_with(path, kind, "").map(|(batch, provenance, _)| (batch, provenance))
}

/// Reads a complete table, its provenance, and the value of a key of
/// [`write_table_with`], if the table has it.
pub(super) fn read_table_with(
    path: &Path,
    kind: &'static str,
    key: &str,
) -> Result<(RecordBatch, Provenance, Option<String>)> {
    let (builder, provenance) = open_table(path, kind)?;
    let key = format!("loopboost.{key}");
    let entries = builder.metadata().file_metadata().key_value_metadata();
    let value = entries.into_iter().flatten().find(|entry| entry.key == key);
    let value = value.and_then(|entry| entry.value.clone());
    let schema: SchemaRef = builder.schema().clone();
    let n_rows = usize::try_from(builder.metadata().file_metadata().num_rows()).unwrap_or(0);
    let reader = builder.with_batch_size(n_rows.max(1)).build().map_err(|e| unreadable(path, e))?;
    let mut whole = RecordBatch::new_empty(schema);
    for batch in reader {
        // There is at most one batch, because the batch size is the size of the table.
        whole = batch.map_err(|e| unreadable(path, e))?;
    }
    if whole.num_rows() != n_rows {
        return Err(unreadable(path, format!("read {} rows, expected {n_rows}", whole.num_rows())));
    }
    Ok((whole, provenance, value))
}
