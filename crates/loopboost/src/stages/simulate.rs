use std::fs::File;
use std::io::BufWriter;

use anyhow::{Context, Result, anyhow};
use dataset::Dropped;
use dataset::tables::{TableError, write_atomically};

use crate::run::{Run, progress_bar};

/// The campus of `[simulate]` -> logs/LOG.mcap
pub(crate) fn run(run: &Run) -> Result<Dropped> {
    let options = run.config.simulate.as_ref().ok_or_else(|| {
        anyhow!("the pipeline has no [simulate] section: add one, or start with `ingest`")
    })?;
    let campus = simulate::Campus::new(options, run.config.seed).context("[simulate]")?;
    let progress = progress_bar(options.logs.len() as u64, "simulate".into(), false);
    for (k, name) in options.logs.iter().enumerate() {
        let path = run.simulated_log(name);
        let summary = write_atomically(&path, |mut out: BufWriter<File>| {
            let summary = simulate::write_drive(&campus, k, &mut out)
                .map_err(|e| WriteLog::Simulate(e.into()))?;
            Ok::<_, WriteLog>((out, summary))
        })
        .map_err(|e| match e {
            WriteLog::Simulate(e) => e.context(format!("cannot simulate {}", path.display())),
            WriteLog::Table(e) => e.into(),
        })?;
        progress.inc(1);
        run.say(
            "simulate",
            format!(
                "{name}: {:.0} m in {:.0} s, {} turns, {} packets",
                summary.length_m, summary.duration_s, summary.turns, summary.packets
            ),
        );
    }
    progress.finish_and_clear();
    Ok(Dropped::default())
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
