//! `scans/<log>.parquet`: one row per planar scan. The table is streamed, because a log can contain
//! many scans.
//!
//! | column | type | |
//! |---|---|---|
//! | `log` | string | file stem of the log |
//! | `scan` | u32 | row number |
//! | `stamp_ns` | i64 | time at which the first beam fired |
//! | `x_m`, `y_m` | list of f32 | returns in the lidar frame, in firing order |
//! | `coverage_deg` | f32 | angle covered by the firings |
//! | `hole_deg` | f32 | the largest angle without packets; 0 if no packets are missing |
//! | `usable` | bool | whether features can be computed ([`Scan::check_usable`]) |

use std::fs::File;
use std::io::BufWriter;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::builder::{Float32Builder, ListBuilder};
use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Int64Type, UInt32Type};
use arrow_array::{
    Array, ArrayRef, BooleanArray, Float32Array, Int64Array, ListArray, RecordBatch, StringArray,
    UInt32Array,
};
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use parquet::arrow::ArrowSchemaConverter;
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{
    ArrowReaderMetadata, ParquetRecordBatchReaderBuilder, RowSelection, RowSelector,
};
use parquet::arrow::arrow_writer::{ArrowColumnChunk, ArrowRowGroupWriterFactory, compute_leaves};
use parquet::basic::Encoding;
use parquet::errors::ParquetError;
use parquet::file::properties::EnabledStatistics;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::ColumnPath;
use rayon::prelude::*;

use super::columns::Columns;
use super::file::{open_table, properties, read_error, unreadable, write_error};
use super::{Provenance, Result, TableError, write_atomically};
use crate::{Losses, Note, Scan};

/// Number of rows per row group. It is fixed because the bytes must not depend on how the scans are
/// batched.
const SCANS_PER_GROUP: usize = 128;

/// A scan without its points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScanHeader {
    /// Time at which the first beam fired \[ns since the epoch\].
    pub stamp_ns: i64,
    /// Angle covered by the firings \[deg\].
    pub coverage_deg: f32,
    /// Whether features can be computed from the scan.
    pub usable: bool,
}

/// Writes a table of scans. `produce` passes the scans to the [`ScanWriter`] in order.
pub fn write_scans<T, E: From<TableError>>(
    path: &Path,
    provenance: &Provenance,
    log: &str,
    produce: impl FnOnce(&mut ScanWriter<'_>) -> std::result::Result<T, E>,
) -> std::result::Result<T, E> {
    write_atomically(path, |file| {
        let mut writer = ScanWriter::new(path, file, provenance, log)?;
        let value = produce(&mut writer)?;
        Ok((writer.finish()?, value))
    })
}

/// Writes scans in row groups, in order. Several row groups are encoded in parallel.
///
/// The bytes of the file do not depend on the number of threads or on how the scans are batched.
pub struct ScanWriter<'a> {
    path: &'a Path,
    log: &'a str,
    file: SerializedFileWriter<BufWriter<File>>,
    factory: ArrowRowGroupWriterFactory,
    schema: SchemaRef,
    provenance: Provenance,
    losses: Losses,
    notes: Vec<Note>,
    waiting: Vec<Scan>,
    n_scans: u32,
    n_groups: usize,
}

impl<'a> ScanWriter<'a> {
    fn new(
        path: &'a Path,
        file: BufWriter<File>,
        provenance: &Provenance,
        log: &'a str,
    ) -> Result<Self> {
        let schema = schema();
        let mut builder = properties(Vec::new()).set_max_row_group_row_count(Some(SCANS_PER_GROUP));
        for list in ["x_m", "y_m"] {
            // Coordinates rarely repeat: dictionaries and statistics do not help. Byte stream
            // split stores the bytes with sign and exponent next to each other. These bytes often
            // repeat, and zstd compresses them well.
            let leaf = ColumnPath::new(vec![list.into(), "list".into(), "item".into()]);
            builder = builder
                .set_column_dictionary_enabled(leaf.clone(), false)
                .set_column_statistics_enabled(leaf.clone(), EnabledStatistics::None)
                .set_column_encoding(leaf, Encoding::BYTE_STREAM_SPLIT);
        }
        let properties = builder.build();
        let failed = |e| write_error(path, e);
        let parquet_schema = ArrowSchemaConverter::new().convert(&schema).map_err(failed)?;
        let file =
            SerializedFileWriter::new(file, parquet_schema.root_schema_ptr(), Arc::new(properties))
                .map_err(failed)?;
        let factory = ArrowRowGroupWriterFactory::new(&file, schema.clone());
        Ok(Self {
            path,
            log,
            file,
            factory,
            schema,
            provenance: provenance.clone(),
            losses: Losses::default(),
            notes: Vec::new(),
            waiting: Vec::new(),
            n_scans: 0,
            n_groups: 0,
        })
    }

    /// Appends scans.
    pub fn push(&mut self, scans: impl IntoIterator<Item = Scan>) -> Result<()> {
        self.waiting.extend(scans);
        // Full groups are encoded as soon as there is one per thread.
        if self.waiting.len() >= SCANS_PER_GROUP * rayon::current_num_threads() {
            self.write_groups(self.waiting.len() / SCANS_PER_GROUP * SCANS_PER_GROUP)?;
        }
        Ok(())
    }

    /// Number of scans added so far.
    pub fn n_scans(&self) -> u32 {
        self.n_scans + self.waiting.len() as u32
    }

    /// Sets the losses and the notes in the provenance of the table.
    pub fn set_findings(&mut self, losses: Losses, notes: Vec<Note>) {
        self.losses = losses;
        self.notes = notes;
    }

    fn finish(mut self) -> Result<BufWriter<File>> {
        self.write_groups(self.waiting.len())?;
        let provenance = Provenance { losses: self.losses, notes: self.notes, ..self.provenance };
        for entry in provenance.to_metadata("scans") {
            self.file.append_key_value_metadata(entry);
        }
        self.file.into_inner().map_err(|e| write_error(self.path, e))
    }

    /// Encodes the first `n` waiting scans in parallel and appends them in order.
    fn write_groups(&mut self, n: usize) -> Result<()> {
        let scans: Vec<Scan> = self.waiting.drain(..n).collect();
        let (log, schema, factory) = (self.log, &self.schema, &self.factory);
        let (first_scan, first_group) = (self.n_scans, self.n_groups);
        let groups = scans
            .par_chunks(SCANS_PER_GROUP)
            .enumerate()
            .map(|(k, scans)| {
                let first_scan = first_scan + (k * SCANS_PER_GROUP) as u32;
                let columns = columns(log, first_scan, scans);
                encode_group(schema, factory, first_group + k, &columns)
            })
            .collect::<Vec<_>>();
        let failed = |e| write_error(self.path, e);
        for group in groups {
            let mut row_group = self.file.next_row_group().map_err(failed)?;
            for chunk in group.map_err(failed)? {
                chunk.append_to_row_group(&mut row_group).map_err(failed)?;
            }
            row_group.close().map_err(failed)?;
            self.n_groups += 1;
        }
        self.n_scans += n as u32;
        Ok(())
    }
}

fn encode_group(
    schema: &Schema,
    factory: &ArrowRowGroupWriterFactory,
    group: usize,
    columns: &[ArrayRef],
) -> std::result::Result<Vec<ArrowColumnChunk>, ParquetError> {
    let writers = factory.create_column_writers(group)?;
    let mut chunks = Vec::with_capacity(writers.len());
    let mut writers = writers.into_iter();
    for (field, column) in schema.fields().iter().zip(columns) {
        for leaf in compute_leaves(field, column)? {
            let mut writer = writers.next().expect("a writer for each leaf");
            writer.write(&leaf)?;
            chunks.push(writer.close()?);
        }
    }
    Ok(chunks)
}

fn list_item() -> Arc<Field> {
    Arc::new(Field::new("item", DataType::Float32, false))
}

fn schema() -> SchemaRef {
    Arc::new(Schema::new(vec![
        Field::new("log", DataType::Utf8, false),
        Field::new("scan", DataType::UInt32, false),
        Field::new("stamp_ns", DataType::Int64, false),
        Field::new("x_m", DataType::List(list_item()), false),
        Field::new("y_m", DataType::List(list_item()), false),
        Field::new("coverage_deg", DataType::Float32, false),
        Field::new("hole_deg", DataType::Float32, false),
        Field::new("usable", DataType::Boolean, false),
    ]))
}

/// The columns of the table, in the order of [`schema`].
fn columns(log: &str, first_scan: u32, scans: &[Scan]) -> Vec<ArrayRef> {
    let n_returns = scans.iter().map(Scan::len).sum();
    let lists = |values: fn(&Scan) -> &[f32]| -> ArrayRef {
        let mut builder =
            ListBuilder::with_capacity(Float32Builder::with_capacity(n_returns), scans.len())
                .with_field(list_item());
        for scan in scans {
            builder.values().append_slice(values(scan));
            builder.append(true);
        }
        Arc::new(builder.finish())
    };
    vec![
        Arc::new(scans.iter().map(|_| Some(log)).collect::<StringArray>()),
        Arc::new(UInt32Array::from_iter_values((first_scan..).take(scans.len()))),
        Arc::new(Int64Array::from_iter_values(scans.iter().map(|s| s.stamp_ns))),
        lists(|s| &s.x_m),
        lists(|s| &s.y_m),
        Arc::new(Float32Array::from_iter_values(scans.iter().map(|s| s.coverage_deg))),
        Arc::new(Float32Array::from_iter_values(scans.iter().map(|s| s.hole_deg))),
        Arc::new(scans.iter().map(|s| Some(s.check_usable().is_ok())).collect::<BooleanArray>()),
    ]
}

/// Some scans of a log as rows of the table, without a file. `first_scan` is the number of the first one.
pub fn scan_batch(log: &str, first_scan: u32, scans: &[Scan]) -> RecordBatch {
    RecordBatch::try_new(schema(), columns(log, first_scan, scans))
        .expect("the columns are those of the schema")
}

/// Reads the headers of all scans, in order.
pub fn read_scan_headers(path: &Path) -> Result<(Vec<ScanHeader>, Provenance)> {
    let (builder, provenance) = open_table(path, "scans")?;
    let mask = ProjectionMask::columns(
        builder.parquet_schema(),
        ["scan", "stamp_ns", "coverage_deg", "usable"],
    );
    let reader = builder.with_projection(mask).build().map_err(|e| unreadable(path, e))?;
    let mut headers: Vec<ScanHeader> = Vec::new();
    for batch in reader {
        let batch = batch.map_err(|e| unreadable(path, e))?;
        let columns = Columns::new(path, &batch);
        let scans = columns.numbers::<UInt32Type>("scan")?;
        let stamps = columns.numbers::<Int64Type>("stamp_ns")?;
        let coverage = columns.numbers::<Float32Type>("coverage_deg")?;
        let usable = columns.column("usable")?;
        let usable = usable.as_boolean_opt().ok_or_else(|| {
            columns.error("usable", "a boolean column", usable.data_type().to_string())
        })?;
        for row in 0..batch.num_rows() {
            if scans.value(row) as usize != headers.len() {
                return Err(TableError::Row {
                    path: path.to_owned(),
                    row: headers.len(),
                    detail: format!("scan {}, expected the number of the row", scans.value(row)),
                });
            }
            headers.push(ScanHeader {
                stamp_ns: stamps.value(row),
                coverage_deg: coverage.value(row),
                usable: usable.value(row),
            });
        }
    }
    Ok((headers, provenance))
}

/// Reads the given scans and passes them to `take` in batches. The numbers must be strictly
/// ascending.
pub fn read_scans<E: From<TableError>>(
    path: &Path,
    scans: &[u32],
    mut take: impl FnMut(Vec<Scan>) -> std::result::Result<(), E>,
) -> std::result::Result<(), E> {
    let (builder, _) = open_table(path, "scans")?;
    let n_rows = usize::try_from(builder.metadata().file_metadata().num_rows()).unwrap_or(0);
    let selection = row_selection(path, scans, n_rows)?;
    let reader = builder
        .with_row_selection(selection)
        .with_batch_size(SCANS_PER_GROUP)
        .build()
        .map_err(|e| unreadable(path, e))?;
    for batch in reader {
        let batch = batch.map_err(|e| unreadable(path, e))?;
        take(scans_of(path, &batch)?)?;
    }
    Ok(())
}

/// A table of scans that is read in pieces, in any order.
#[derive(Debug)]
pub struct ScanTable {
    path: PathBuf,
    metadata: ArrowReaderMetadata,
    /// The rows of each group.
    groups: Vec<Range<u32>>,
}

impl ScanTable {
    /// Opens a table, and reads where its groups are.
    pub fn open(path: &Path) -> Result<Self> {
        let (builder, _) = open_table(path, "scans")?;
        let file_metadata = builder.metadata().clone();
        let metadata = ArrowReaderMetadata::try_new(file_metadata, Default::default())
            .map_err(|e| unreadable(path, e))?;
        let mut groups: Vec<Range<u32>> = Vec::new();
        for group in metadata.metadata().row_groups() {
            let first = groups.last().map_or(0, |last| last.end);
            let n = u32::try_from(group.num_rows()).map_err(|e| unreadable(path, e))?;
            groups.push(first..first + n);
        }
        Ok(Self { path: path.to_owned(), metadata, groups })
    }

    /// The numbers of the scans that are stored together, group by group. A scan is read with all scans of its
    /// group, so it is fastest to read those of a group at once.
    pub fn groups(&self) -> &[Range<u32>] {
        &self.groups
    }

    /// Reads scans of a group. The numbers must be strictly ascending.
    pub fn read(&self, group: usize, scans: &[u32]) -> Result<Vec<Scan>> {
        let Range { start, end } = self.groups[group];
        let in_group: Vec<u32> = scans.iter().map(|scan| scan.wrapping_sub(start)).collect();
        let selection = row_selection(&self.path, &in_group, (end - start) as usize)?;
        let failed = |e| unreadable(&self.path, e);
        let file = File::open(&self.path).map_err(|source| read_error(&self.path, source))?;
        let reader =
            ParquetRecordBatchReaderBuilder::new_with_metadata(file, self.metadata.clone())
                .with_row_groups(vec![group])
                .with_row_selection(selection)
                .with_batch_size(scans.len().max(1))
                .build()
                .map_err(failed)?;
        let mut found = Vec::with_capacity(scans.len());
        for batch in reader {
            let batch = batch.map_err(|e| unreadable(&self.path, e))?;
            found.extend(scans_of(&self.path, &batch)?);
        }
        if found.len() != scans.len() {
            let detail = format!("{} scans, expected {}", found.len(), scans.len());
            return Err(TableError::Row { path: self.path.clone(), row: start as usize, detail });
        }
        Ok(found)
    }
}

/// The row selection that selects only `scans`.
fn row_selection(path: &Path, scans: &[u32], n_rows: usize) -> Result<RowSelection> {
    let mut selectors = Vec::with_capacity(2 * scans.len());
    let mut next = 0;
    for &scan in scans {
        let scan = scan as usize;
        if scan < next || n_rows <= scan {
            return Err(TableError::Row {
                path: path.to_owned(),
                row: scan,
                detail: format!("requested out of order, or the table has only {n_rows} rows"),
            });
        }
        selectors.push(RowSelector::skip(scan - next));
        selectors.push(RowSelector::select(1));
        next = scan + 1;
    }
    Ok(RowSelection::from(selectors))
}

fn scans_of(path: &Path, batch: &RecordBatch) -> Result<Vec<Scan>> {
    let columns = Columns::new(path, batch);
    let stamps = columns.numbers::<Int64Type>("stamp_ns")?;
    let coverage = columns.numbers::<Float32Type>("coverage_deg")?;
    let holes = columns.numbers::<Float32Type>("hole_deg")?;
    let lists = |name| -> Result<&ListArray> {
        let column = columns.column(name)?;
        column
            .as_list_opt::<i32>()
            .filter(|list| list.values().data_type() == &DataType::Float32)
            .ok_or_else(|| columns.error(name, "a list of f32", column.data_type().to_string()))
    };
    let (x, y) = (lists("x_m")?, lists("y_m")?);
    let values = |list: &ListArray, row: usize| {
        list.value(row).as_primitive::<Float32Type>().values().to_vec()
    };
    (0..batch.num_rows())
        .map(|row| {
            let (x_m, y_m) = (values(x, row), values(y, row));
            if x_m.len() != y_m.len() {
                return Err(TableError::Row {
                    path: path.to_owned(),
                    row,
                    detail: format!("{} values in `x_m`, {} in `y_m`", x_m.len(), y_m.len()),
                });
            }
            Ok(Scan {
                stamp_ns: stamps.value(row),
                x_m,
                y_m,
                coverage_deg: coverage.value(row),
                hole_deg: holes.value(row),
            })
        })
        .collect()
}
