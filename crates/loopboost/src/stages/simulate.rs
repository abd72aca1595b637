use std::fs::File;
use std::io::BufWriter;
use std::sync::Arc;

use anyhow::{Context, Result};
use dataset::tables::{TableError, write_atomically};
use simulate::{Campus, Map};

use crate::config::usage;
use crate::findings::Findings;
use crate::run::{Done, Run, Task, progress_bar};
use crate::stage::{Artifact, Stage};
use crate::summary::Summary;

/// The campus of `[simulate]` -> logs/LOG.mcap
pub(crate) fn run(run: &Run) -> Result<Findings> {
    let options = run.config.simulate.as_ref().ok_or_else(|| {
        usage("the pipeline has no [simulate] section: add one, or start with `ingest`")
    })?;
    let seed = run.config.seed;
    let (campus, inputs) = match &options.map {
        None => (Campus::new(options, seed), Vec::new()),
        Some(map) => {
            let yaml = run.config.beside_pipeline(map);
            let files = Map::files(&yaml).context("[simulate] map")?;
            let map = Map::load(&yaml).context("[simulate] map")?;
            (Campus::on_map(options, seed, map), files.to_vec())
        }
    };
    let campus = campus.context("[simulate]")?;
    let progress = progress_bar(options.logs.len() as u64, "simulate".into(), false);
    for (k, name) in options.logs.iter().enumerate() {
        let task = Task {
            stage: Stage::Simulate,
            log: Some(Arc::from(name.as_str())),
            only: None,
            inputs: inputs.clone(),
        };
        run.task(&task, |_| drive(run, &campus, k, name))?;
        progress.inc(1);
    }
    progress.finish_and_clear();
    Ok(Findings::default())
}

fn drive(run: &Run, campus: &Campus, k: usize, name: &str) -> Result<Done> {
    let paths = run.paths_of(Artifact::Log, Some(name));
    let (mut revolutions, mut packets, mut length_m, mut duration_s) = (0, 0, 0.0, 0.0);
    for (file, path) in paths.iter().enumerate() {
        let summary = write_atomically(path, |mut out: BufWriter<File>| {
            let summary = simulate::write_drive(campus, k, file as u32, &mut out)
                .map_err(|e| WriteLog::Simulate(e.into()))?;
            Ok::<_, WriteLog>((out, summary))
        })
        .map_err(|e| match e {
            WriteLog::Simulate(e) => e.context(format!("cannot simulate {}", path.display())),
            WriteLog::Table(e) => e.into(),
        })?;
        revolutions += summary.revolutions;
        packets += summary.packets;
        length_m += summary.length_m;
        duration_s += summary.duration_s;
    }
    let summary = Summary::Simulated {
        log: name.to_owned(),
        length_m,
        duration_s,
        n_revolutions: revolutions,
        n_packets: packets,
        n_files: paths.len() as u64,
    };
    Ok(Done { outputs: paths, summaries: vec![summary], ..Done::default() })
}

/// What can go wrong while a log is written.
enum WriteLog {
    Simulate(anyhow::Error),
    Table(TableError),
}

impl From<TableError> for WriteLog {
    fn from(error: TableError) -> Self {
        Self::Table(error)
    }
}
