//! Tables of a run folder as Arrow streams.

use std::collections::BTreeMap;
use std::fs::File;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::ffi_stream::{FFI_ArrowArrayStream, RecordBatchStreamReader};
use arrow_array::{RecordBatch, RecordBatchReader};
use arrow_schema::{ArrowError, Schema, SchemaRef};
use parquet::arrow::arrow_reader::{ParquetRecordBatchReader, ParquetRecordBatchReaderBuilder};
use pyo3::prelude::*;
use pyo3::types::PyCapsule;

use crate::{Class, error};

/// Rows of one or more Parquet files with the same columns. They are read when they are needed.
#[pyclass(frozen, module = "loopboost._loopboost")]
pub(crate) struct Table {
    files: Vec<PathBuf>,
    schema: SchemaRef,
    n_rows: usize,
}

#[pymethods]
impl Table {
    /// Opens files. There is at least one.
    #[new]
    fn new(py: Python<'_>, files: Vec<PathBuf>) -> PyResult<Self> {
        let fail = |message: String| error(py, Class::Input, message);
        let (mut schema, mut n_rows): (Option<Schema>, usize) = (None, 0);
        for file in &files {
            let opened = open(file).map_err(fail)?;
            n_rows += opened.metadata().file_metadata().num_rows() as usize;
            let of_file = opened.schema();
            let first = schema.get_or_insert_with(|| of_file.as_ref().clone());
            if first.fields != of_file.fields {
                return Err(fail(format!(
                    "{} has other columns than {}; make the tables with one version of loopboost",
                    file.display(),
                    files[0].display()
                )));
            }
        }
        let schema = schema.ok_or_else(|| fail("no files".to_owned()))?;
        // The metadata of the first file is not that of all.
        let schema = if files.len() == 1 { schema } else { Schema::new(schema.fields) };
        Ok(Self { files, schema: Arc::new(schema), n_rows })
    }

    fn __repr__(&self) -> String {
        format!(
            "<Table: {} rows in {} files, columns {}; polars.DataFrame(table) or pyarrow.table(table) reads it>",
            self.n_rows,
            self.files.len(),
            self.column_names().join(", ")
        )
    }

    fn __len__(&self) -> usize {
        self.n_rows
    }

    /// The names of the columns, in order.
    #[getter]
    fn column_names(&self) -> Vec<&str> {
        column_names(&self.schema)
    }

    /// The files, in the order of their rows.
    #[getter]
    fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// What each file says about itself, by file and key.
    fn metadata(&self, py: Python<'_>) -> PyResult<BTreeMap<PathBuf, BTreeMap<String, String>>> {
        let of_file = |file: &PathBuf| {
            let opened = open(file).map_err(|message| error(py, Class::Input, message))?;
            let metadata = opened.schema().metadata().clone();
            Ok((file.clone(), metadata.into_iter().collect()))
        };
        self.files.iter().map(of_file).collect()
    }

    /// The rows as a stream of the Arrow C interface.
    #[pyo3(signature = (requested_schema = None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        // A request is a wish. A producer can give the columns as they are.
        drop(requested_schema);
        let files = self.files.clone().into_iter();
        stream(py, RowsOfFiles { schema: self.schema.clone(), files, current: None })
    }
}

/// The names of the columns, in order.
pub(crate) fn column_names(schema: &Schema) -> Vec<&str> {
    schema.fields.iter().map(|field| field.name().as_str()).collect()
}

/// Rows as a stream of the Arrow C interface.
pub(crate) fn stream(
    py: Python<'_>,
    rows: impl RecordBatchReader + Send + 'static,
) -> PyResult<Bound<'_, PyCapsule>> {
    let stream = FFI_ArrowArrayStream::new(Box::new(rows));
    PyCapsule::new_with_value(py, stream, STREAM)
}

/// The name of a stream in a capsule, by the Arrow PyCapsule interface.
const STREAM: &std::ffi::CStr = c"arrow_array_stream";

/// The rows of a stream that another library made. They are taken out of the capsule.
pub(crate) fn rows_of(capsule: &Bound<'_, PyCapsule>) -> PyResult<RecordBatchStreamReader> {
    let py = capsule.py();
    let no_table = |found: String| {
        let message = format!(
            "expected a table that gives an Arrow stream of rows, not a single column: {found}"
        );
        error(py, Class::Argument, message)
    };
    let pointer =
        capsule.pointer_checked(Some(STREAM)).map_err(|found| no_table(found.to_string()))?;
    // SAFETY: a capsule with this name has a pointer to such a stream. The reader moves it out, and leaves a released one.
    #[allow(unsafe_code)]
    let reader = unsafe { RecordBatchStreamReader::from_raw(pointer.cast().as_ptr()) };
    reader.map_err(|found| no_table(found.to_string()))
}

/// The next rows of such a stream.
pub(crate) fn next_of(
    py: Python<'_>,
    rows: &mut RecordBatchStreamReader,
) -> PyResult<Option<RecordBatch>> {
    py.check_signals()?;
    let next = py.detach(|| rows.next().transpose());
    next.map_err(|failed| error(py, Class::Input, format!("the table cannot be read: {failed}")))
}

/// The rows of files, one file after the other.
struct RowsOfFiles {
    schema: SchemaRef,
    files: std::vec::IntoIter<PathBuf>,
    current: Option<(PathBuf, ParquetRecordBatchReader)>,
}

impl RowsOfFiles {
    fn next_batch(&mut self) -> Result<Option<RecordBatch>, String> {
        loop {
            if let Some((file, reader)) = &mut self.current {
                let next = guarded(file, || {
                    let batch = reader.next().transpose()?;
                    batch.map(|batch| batch.with_schema(self.schema.clone())).transpose()
                })?;
                if next.is_some() {
                    return Ok(next);
                }
            }
            let Some(file) = self.files.next() else { return Ok(None) };
            let builder = open(&file)?;
            let reader = guarded(&file, || builder.build())?;
            self.current = Some((file, reader));
        }
    }
}

impl Iterator for RowsOfFiles {
    type Item = Result<RecordBatch, ArrowError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.next_batch().map_err(|message| ArrowError::ExternalError(message.into())).transpose()
    }
}

impl RecordBatchReader for RowsOfFiles {
    fn schema(&self) -> SchemaRef {
        self.schema.clone()
    }
}

fn open(file: &Path) -> Result<ParquetRecordBatchReaderBuilder<File>, String> {
    let opened = File::open(file).map_err(|failed| cannot_read(file, failed))?;
    guarded(file, || ParquetRecordBatchReaderBuilder::try_new(opened))
}

/// What `read` reads from a file. The Parquet reader panics for some damaged files. Here that is an error, because a panic in
/// the C interface of Arrow would end the process.
fn guarded<T, E: std::fmt::Display>(
    file: &Path,
    read: impl FnOnce() -> Result<T, E>,
) -> Result<T, String> {
    match catch_unwind(AssertUnwindSafe(read)) {
        Ok(read) => read.map_err(|failed| cannot_read(file, failed)),
        Err(_) => Err(cannot_read(file, "it is damaged; run the command that made it again")),
    }
}

fn cannot_read(file: &Path, failed: impl std::fmt::Display) -> String {
    format!("cannot read {}: {failed}", file.display())
}
