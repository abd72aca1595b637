//! Scans and poses of logs, without files.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use arrow_array::{RecordBatch, RecordBatchIterator};
use arrow_schema::SchemaRef;
use dataset::tables::pose_batch;
use dataset::tables::scans::scan_batch;
use dataset::{Losses, Note};
use ingest::{IngestError, Ingested, Log, Options};
use pyo3::prelude::*;
use pyo3::types::PyCapsule;

use crate::table::{column_names, stream};
use crate::{Class, error};

/// Rows in memory.
#[pyclass(frozen, module = "loopboost._loopboost")]
pub(crate) struct Rows {
    schema: SchemaRef,
    batches: Vec<RecordBatch>,
    messages: Vec<String>,
}

impl Rows {
    /// Batches of this schema, and lines about them.
    pub(crate) fn new(schema: SchemaRef, batches: Vec<RecordBatch>, messages: Vec<String>) -> Self {
        Self { schema, batches, messages }
    }
}

#[pymethods]
impl Rows {
    fn __repr__(&self) -> String {
        format!(
            "<Rows: {} rows, columns {}; polars.DataFrame(rows) or pyarrow.table(rows) takes them>",
            self.__len__(),
            self.column_names().join(", ")
        )
    }

    fn __len__(&self) -> usize {
        self.batches.iter().map(RecordBatch::num_rows).sum()
    }

    /// The names of the columns, in order.
    #[getter]
    fn column_names(&self) -> Vec<&str> {
        column_names(&self.schema)
    }

    /// Losses and notes with their codes, as lines.
    #[getter]
    fn messages(&self) -> &[String] {
        &self.messages
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
        let batches = self.batches.clone().into_iter().map(Ok);
        stream(py, RecordBatchIterator::new(batches, self.schema.clone()))
    }
}

/// The scans of a drive. `files` are its files, at least one. The first one gives the drive its name. `options` are JSON.
/// `progress` is called with about how many bytes were read, and those of all files.
#[pyfunction]
pub(crate) fn read_scans(
    py: Python<'_>,
    files: Vec<PathBuf>,
    options: &str,
    progress: Option<Py<PyAny>>,
) -> PyResult<Rows> {
    let drive = Drive::open(py, &files, options)?;
    let mut batches = Vec::new();
    let mut n_scans = 0;
    let ingested = while_waiting(py, drive.n_bytes(), progress, |shared| {
        let take = |scans: Vec<dataset::Scan>| {
            batches.push(scan_batch(&drive.name, n_scans, &scans));
            n_scans += scans.len() as u32;
            shared.proceed()
        };
        let logs: Vec<&Log> = drive.logs.iter().collect();
        let set = |n_bytes| shared.n_bytes.store(n_bytes, Ordering::Relaxed);
        ingest::ingest(&logs, &drive.options, take, set)
    })?;
    let schema = scan_batch("", 0, &[]).schema();
    Ok(Rows { schema, batches, messages: drive.messages(ingested.losses, ingested.notes) })
}

/// The poses of the lidar of a drive. The arguments are those of `read_scans`.
#[pyfunction]
pub(crate) fn read_poses(py: Python<'_>, files: Vec<PathBuf>, options: &str) -> PyResult<Rows> {
    let drive = Drive::open(py, &files, options)?;
    let ingested = while_waiting(py, drive.n_bytes(), None, |shared| {
        let logs: Vec<&Log> = drive.logs.iter().collect();
        ingest::read_poses(&logs, &drive.options, || shared.proceed())
    })?;
    let batch = pose_batch(&drive.name, &ingested.trajectory);
    let messages = drive.messages(ingested.losses, ingested.notes);
    Ok(Rows { schema: batch.schema(), batches: vec![batch], messages })
}

/// The files of a drive, and how they are read.
struct Drive {
    name: String,
    logs: Vec<Log>,
    options: Options,
}

impl Drive {
    fn open(py: Python<'_>, files: &[PathBuf], options: &str) -> PyResult<Self> {
        let wrong = |message: String| error(py, Class::Argument, message);
        let mut options: Options =
            serde_json::from_str(options).map_err(|failed| wrong(failed.to_string()))?;
        options.lidar.check().map_err(|failed| wrong(failed.to_string()))?;
        if let Some(pose) = &options.pose {
            pose.check().map_err(|failed| wrong(failed.to_string()))?;
            if pose.run.is_some() {
                let message = "`poses` names a run; open it with `loopboost.Run`, whose `table(\"trajectory\", log)` has them";
                return Err(wrong(message.to_owned()));
            }
        }
        let name = files.first().and_then(|file| file.file_stem()).unwrap_or_default();
        let name = name.to_string_lossy().into_owned();
        if let Some(pose) = &mut options.pose {
            pose.file = pose.file_of(&name);
        }
        let open = |file: &PathBuf| Log::open(file).map_err(|failed| input_error(py, failed));
        let logs = files.iter().map(open).collect::<PyResult<Vec<Log>>>()?;
        Ok(Self { name, logs, options })
    }

    fn n_bytes(&self) -> u64 {
        self.logs.iter().map(Log::n_bytes).sum()
    }

    /// A line for each loss and note, as the program prints them.
    fn messages(&self, losses: Losses, notes: Vec<Note>) -> Vec<String> {
        let of_note = |mut note: Note| {
            note.subject.log = Some(self.name.clone());
            (note.severity(), note.line())
        };
        let mut lines = losses.in_log(&self.name).lines();
        lines.extend(notes.into_iter().map(of_note));
        // Stable: losses before notes, in their order.
        lines.sort_by_key(|(severity, _)| std::cmp::Reverse(*severity));
        lines.into_iter().map(|(_, line)| line).collect()
    }
}

/// What the thread that reads and the one that waits share.
#[derive(Default)]
struct Shared {
    n_bytes: AtomicU64,
    is_stopped: AtomicBool,
}

impl Shared {
    fn proceed(&self) -> Result<(), Failed> {
        match self.is_stopped.load(Ordering::Relaxed) {
            true => Err(Failed::Stopped),
            false => Ok(()),
        }
    }
}

/// Why nothing was read.
enum Failed {
    Ingest(Box<IngestError>),
    Stopped,
}

impl From<IngestError> for Failed {
    fn from(error: IngestError) -> Self {
        Self::Ingest(Box::new(error))
    }
}

/// How often signals are looked for.
const POLL: Duration = Duration::from_millis(50);

/// Reads with threads of its own, because those of rayon do not exist in a process that Python forked. Meanwhile, this
/// thread looks for signals and calls `progress`. An exception of either ends the reading.
fn while_waiting(
    py: Python<'_>,
    n_bytes: u64,
    progress: Option<Py<PyAny>>,
    read: impl FnOnce(&Shared) -> Result<Ingested, Failed> + Send,
) -> PyResult<Ingested> {
    let shared = Shared::default();
    let mut exception = None;
    let done = py.detach(|| {
        let pool = rayon::ThreadPoolBuilder::new().build();
        let pool = pool.map_err(|failed| failed.to_string())?;
        Ok::<_, String>(std::thread::scope(|scope| {
            let (sender, receiver) = channel();
            let shared = &shared;
            let reader = scope.spawn(move || {
                let done = pool.install(|| read(shared));
                // The receiver lives until this thread has ended.
                let _ = sender.send(());
                done
            });
            let mut reported = 0;
            while receiver.recv_timeout(POLL) == Err(RecvTimeoutError::Timeout) {
                if exception.is_some() {
                    continue;
                }
                let read = shared.n_bytes.load(Ordering::Relaxed);
                let called = Python::attach(|py| {
                    py.check_signals()?;
                    match progress.as_ref().filter(|_| reported < read) {
                        Some(progress) => progress.call1(py, (read, n_bytes)).map(drop),
                        None => Ok(()),
                    }
                });
                // In a log that was written topic by topic, the poses are read first, and the scans then from the start.
                reported = reported.max(read);
                if let Err(raised) = called {
                    exception = Some(raised);
                    shared.is_stopped.store(true, Ordering::Relaxed);
                }
            }
            reader.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        }))
    });
    match (exception, done) {
        (Some(exception), _) => Err(exception),
        (None, Err(no_threads)) => Err(error(py, Class::Input, no_threads)),
        (None, Ok(Err(Failed::Ingest(failed)))) => Err(input_error(py, *failed)),
        (None, Ok(Err(Failed::Stopped))) => unreachable!("it is stopped by an exception"),
        (None, Ok(Ok(ingested))) => {
            if let Some(progress) = progress {
                progress.call1(py, (n_bytes, n_bytes))?;
            }
            Ok(ingested)
        }
    }
}

fn input_error(py: Python<'_>, failed: IngestError) -> PyErr {
    error(py, Class::Input, format!("{:#}", anyhow::Error::from(failed)))
}
