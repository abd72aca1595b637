use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, Parser, Subcommand};
use dataset::Dropped;

use crate::config::Config;
use crate::run::Run;
use crate::{inspect, pipeline, stages};

/// Turns the drive logs that robots record into loop-closure classifiers.
///
/// A pipeline file holds every parameter of a run. `run` does all stages; each stage is also a
/// command of its own on the same folder. Exit codes: 0 done, 1 failed, 2 usage, 3 done but some
/// data could not be used.
#[derive(Parser)]
#[command(version)]
pub(crate) struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Do all stages, from logs to report
    Run(PipelineArgs),
    /// Make the logs of the pipeline's [simulate] section
    Simulate(PipelineArgs),
    /// Logs -> scans/LOG.parquet, poses/LOG.parquet
    Ingest(PipelineArgs),
    /// Scans and poses -> keyframes.parquet
    Subsample(PipelineArgs),
    /// Keyframes -> pairs.parquet
    Label(PipelineArgs),
    /// Keyframes -> features.parquet
    Featurize(PipelineArgs),
    /// Pairs and features -> models/, scores.parquet, rounds.parquet
    Train(PipelineArgs),
    /// Scores -> evaluation/, report.html
    Evaluate(PipelineArgs),
    /// Tell what a log holds and which pipeline would fit it
    Inspect {
        /// An MCAP log
        log: PathBuf,
    },
}

#[derive(Args)]
struct PipelineArgs {
    /// The pipeline file (TOML)
    pipeline: PathBuf,
    /// The run folder; it is made if need be
    #[arg(long, value_name = "DIR", required_unless_present = "print_config")]
    out: Option<PathBuf>,
    /// Override a key, such as --set label.positive_radius_m=2
    #[arg(long = "set", value_name = "KEY=VALUE")]
    overrides: Vec<String>,
    /// Print the pipeline with every default written out, and stop
    #[arg(long)]
    print_config: bool,
}

impl Cli {
    /// Does what was asked; returns what of the data could not be used.
    pub(crate) fn execute(self) -> Result<Dropped> {
        let (args, stage): (_, fn(&Run) -> Result<Dropped>) = match self.command {
            Command::Run(args) => (args, pipeline::run),
            Command::Simulate(args) => (args, stages::simulate::run),
            Command::Ingest(args) => (args, stages::ingest::run),
            Command::Subsample(args) => (args, stages::subsample::run),
            Command::Label(args) => (args, stages::label::run),
            Command::Featurize(args) => (args, stages::featurize::run),
            Command::Train(args) => (args, stages::train::run),
            Command::Evaluate(args) => (args, stages::evaluate::run),
            Command::Inspect { log } => return inspect::inspect(&log),
        };
        let config = Config::load(&args.pipeline, &args.overrides)?;
        match args.out {
            Some(out) if !args.print_config => stage(&Run::new(config, out)),
            _ => {
                print!("{}", config.to_toml()?);
                Ok(Dropped::default())
            }
        }
    }
}
