//! Work on many machines: `plan`, `task`, `merge` and `gc`.
//!
//! `plan` lists the work on single logs, `task` does one piece of it on any machine that sees the run folder and the
//! logs, and `merge` makes the run folder what `loopboost run` would have made of it. loopboost does not start tasks:
//! a batch system does, which may kill them, repeat them, and run two attempts at once.

mod entry;
mod gc;
mod merge;
mod paths;
mod plan;
mod store;
mod task;
mod trouble;

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;

use crate::config::{Config, usage};
use crate::findings::Findings;

pub(crate) use trouble::{Conflict, is_storage_trouble};

use plan::Plan;
use store::Store;
use task::Worker;

/// The options of `plan`.
#[derive(Args)]
pub(crate) struct PlanArgs {
    /// The pipeline file (TOML)
    pipeline: PathBuf,
    /// The run folder; created if missing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Override a key, for example --set label.positive_radius_m=2
    #[arg(long = "set", value_name = "KEY=VALUE")]
    overrides: Vec<String>,
    /// Plan for `loopboost detect` with this model.json, or the only one in this folder
    #[arg(long, value_name = "MODEL.json")]
    model: Option<PathBuf>,
    /// The folder that the paths of logs are relative to; the default is the deepest folder with the pipeline file and
    /// all logs
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
}

/// The options of `task`.
#[derive(Args)]
pub(crate) struct TaskArgs {
    /// The run folder
    folder: PathBuf,
    /// The name of the plan, which `loopboost plan` printed
    #[arg(long, value_name = "PLAN")]
    plan: String,
    /// The task, counted from 0; without it, SLURM_ARRAY_TASK_ID, JOB_COMPLETION_INDEX, AWS_BATCH_JOB_ARRAY_INDEX or
    /// BATCH_TASK_INDEX
    #[arg(long, value_name = "I")]
    index: Option<usize>,
    /// Do the tasks I, I + N, I + 2 N, ...
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    of: Option<u64>,
    /// Where the logs are on this machine; the default is the place relative to the run folder that the plan states
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
    /// Where temporary files are written; the default is the system's folder for them (TMPDIR)
    #[arg(long, value_name = "DIR")]
    scratch: Option<PathBuf>,
}

/// The options of `merge`.
#[derive(Args)]
pub(crate) struct MergeArgs {
    /// The run folder
    folder: PathBuf,
    /// The name of the plan, which `loopboost plan` printed
    #[arg(long, value_name = "PLAN")]
    plan: String,
}

/// The options of `gc`.
#[derive(Args)]
pub(crate) struct GcArgs {
    /// The run folder
    folder: PathBuf,
    /// Keep files that were written in the last hours: a task that is running may need them
    #[arg(long, value_name = "HOURS", default_value_t = 24)]
    min_age_hours: u64,
}

/// The variables in which batch systems state the index of a task.
const INDEX_VARIABLES: [&str; 4] = [
    "SLURM_ARRAY_TASK_ID",
    "JOB_COMPLETION_INDEX",
    "AWS_BATCH_JOB_ARRAY_INDEX",
    "BATCH_TASK_INDEX",
];

impl PlanArgs {
    /// Writes the plan and prints its name.
    pub(crate) fn execute(self) -> Result<Findings> {
        let mut config = Config::load(&self.pipeline, &self.overrides)?;
        if self.model.is_some() {
            config.detect.get_or_insert_default();
        }
        let store = Store::create(&self.out)?;
        let plan = Plan::new(config, &store, self.model.as_deref(), self.root.as_deref())?;
        let bytes = plan.bytes()?;
        let id = blake3::hash(&bytes).to_hex();
        let path = store.write_plan(&id, &bytes)?;
        let n = plan.entries.len();
        eprintln!("{}: {n} {}", path.display(), if n == 1 { "task" } else { "tasks" });
        for (copy, used) in &plan.copies {
            eprintln!("log `{copy}` has the same bytes as `{used}` and is left out");
        }
        out!("{id}");
        Ok(Findings::default())
    }
}

impl TaskArgs {
    /// Does one task, or every N-th.
    pub(crate) fn execute(self) -> Result<Findings> {
        let first = match self.index {
            Some(index) => index,
            None => index_of_environment()?,
        };
        let store = Store::open(&self.folder)?;
        let plan = Plan::load(&store, &self.plan)?;
        let n = plan.entries.len();
        if self.of.is_none() && n <= first {
            return Err(usage(format!("--index {first}: the plan has {n} tasks, numbered from 0")));
        }
        let root = plan.root(&store, self.root.as_deref())?;
        let model = plan.model(&store)?;
        let scratch = self.scratch.unwrap_or_else(std::env::temp_dir);
        let worker = Worker { store: &store, plan: &plan, id: &self.plan, root, model, scratch };
        let step = self.of.map_or(n.max(1), |of| usize::try_from(of).unwrap_or(usize::MAX));
        let mut failed: Option<anyhow::Error> = None;
        for entry in plan.entries.iter().skip(first).step_by(step) {
            if let Err(error) = worker.run(entry) {
                let error = error.context(format!("task {}, log `{}`", entry.index, entry.key));
                match &failed {
                    // The error that must not be retried decides the exit code.
                    Some(first) if !is_worse(&error, first) => eprintln!("error: {error:#}"),
                    Some(first) => {
                        eprintln!("error: {first:#}");
                        failed = Some(error);
                    }
                    None => failed = Some(error),
                }
            }
        }
        match failed {
            Some(error) => Err(error),
            None => Ok(Findings::default()),
        }
    }
}

/// Whether an error, other than the one before, cannot be fixed by another attempt.
fn is_worse(error: &anyhow::Error, before: &anyhow::Error) -> bool {
    is_storage_trouble(before) && !is_storage_trouble(error)
}

fn index_of_environment() -> Result<usize> {
    let set = |name| Some((name, std::env::var(name).ok()?));
    let Some((name, value)) = INDEX_VARIABLES.into_iter().find_map(set) else {
        return Err(usage(format!(
            "which task? pass --index, or set one of {}",
            INDEX_VARIABLES.join(", ")
        )));
    };
    value.parse().map_err(|_| usage(format!("{name} is `{value}`, expected the number of a task")))
}

impl MergeArgs {
    /// Makes the run folder from the records of all tasks.
    pub(crate) fn execute(self) -> Result<Findings> {
        let store = Store::open(&self.folder)?;
        let plan = Plan::load(&store, &self.plan)?;
        merge::merge(&store, &plan, &self.plan)
    }
}

impl GcArgs {
    /// Removes objects that no record needs.
    pub(crate) fn execute(self) -> Result<Findings> {
        gc::gc(&Store::open(&self.folder)?, self.min_age_hours)?;
        Ok(Findings::default())
    }
}
