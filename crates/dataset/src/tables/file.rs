//! One table file: written completely or not at all; its provenance is checked when it is read.

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

/// Writes a file through `fill` to a temporary file in the same folder, and renames it when it is
/// complete and on disk.
///
/// After an error, or a crash at any moment, `path` is unchanged.
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
        // Report the first error; the next run overwrites a leftover.
        let _ = fs::remove_file(&partial);
    }
    written
}

/// Writes a file completely or not at all.
pub fn write_file(path: &Path, bytes: &[u8]) -> Result<()> {
    write_atomically(path, |mut file| match file.write_all(bytes) {
        Ok(()) => Ok((file, ())),
        Err(source) => Err(TableError::Io { action: "write", path: path.to_owned(), source }),
    })
}

/// `keyframes.parquet` is written as `.keyframes.parquet.partial`.
fn partial_path(path: &Path) -> PathBuf {
    let mut name = OsString::from(".");
    name.push(path.file_name().unwrap_or_default());
    name.push(".partial");
    path.with_file_name(name)
}

/// Whether a file is one that [`write_atomically`] did not finish.
pub fn is_partial(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.starts_with('.') && name.ends_with(".partial")
}

/// Bytes of a file that are hashed at a time.
const DIGEST_BLOCK_BYTES: usize = 8 << 20;

/// BLAKE3 digest of a file's bytes, hex.
pub fn digest_file(path: &Path) -> Result<String> {
    let io = |source| read_error(path, source);
    let mut hasher = blake3::Hasher::new();
    // In blocks: memory must not grow with the file. All threads hash one block.
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

/// Writer settings of all tables: zstd, and no version of the library, which would change the bytes
/// with every update.
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
    write_atomically(path, |file| {
        let failed = |e: parquet::errors::ParquetError| write_error(path, e);
        // The tables need no embedded Arrow schema. Without it, readers in Python show the
        // provenance as the metadata of the schema.
        let options = ArrowWriterOptions::new()
            .with_properties(properties(provenance.to_metadata(kind)).build())
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

pub(super) fn unreadable(path: &Path, error: impl std::fmt::Display) -> TableError {
    TableError::Unreadable { path: path.to_owned(), detail: error.to_string() }
}

fn read_error(path: &Path, source: std::io::Error) -> TableError {
    let path = path.to_owned();
    match source.kind() {
        std::io::ErrorKind::NotFound => TableError::Missing { path },
        _ => TableError::Io { action: "read", path, source },
    }
}

/// Reads the kind and the provenance of a table of any kind.
pub fn read_provenance(path: &Path) -> Result<(String, Provenance)> {
    let file = File::open(path).map_err(|source| read_error(path, source))?;
    let metadata = ArrowReaderMetadata::load(&file, ArrowReaderOptions::new())
        .map_err(|e| unreadable(path, e))?;
    let entries = metadata.metadata().file_metadata().key_value_metadata();
    Provenance::from_entries(|key| entries?.iter().find(|entry| entry.key == key)?.value.clone())
        .ok_or_else(|| unreadable(path, "it has no provenance metadata of loopboost"))
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
        let entries = metadata.metadata().file_metadata().key_value_metadata();
        let get = |key: &str| {
            let key = format!("loopboost.{key}");
            entries?.iter().find(|entry| entry.key == key)?.value.clone()
        };
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
        match get("format_version") {
            Some(found) if found == FORMAT_VERSION.to_string() => {}
            found => {
                return Err(TableError::Version {
                    path: path.to_owned(),
                    found: found.unwrap_or_else(|| "none".to_owned()),
                    expected: FORMAT_VERSION,
                });
            }
        }
        Provenance::from_metadata(get)
            .ok_or_else(|| unreadable(path, "its provenance metadata is incomplete"))?
    };
    Ok((ParquetRecordBatchReaderBuilder::new_with_metadata(file, metadata), provenance))
}

/// Reads a whole table of a kind, with its provenance.
pub fn read_table(path: &Path, kind: &'static str) -> Result<(RecordBatch, Provenance)> {
    let (builder, provenance) = open_table(path, kind)?;
    let schema: SchemaRef = builder.schema().clone();
    let n_rows = usize::try_from(builder.metadata().file_metadata().num_rows()).unwrap_or(0);
    let reader = builder.with_batch_size(n_rows.max(1)).build().map_err(|e| unreadable(path, e))?;
    let mut whole = RecordBatch::new_empty(schema);
    for batch in reader {
        // The batch size is the size of the table: there is at most one batch.
        whole = batch.map_err(|e| unreadable(path, e))?;
    }
    if whole.num_rows() != n_rows {
        return Err(unreadable(path, format!("{} of {n_rows} rows", whole.num_rows())));
    }
    Ok((whole, provenance))
}
