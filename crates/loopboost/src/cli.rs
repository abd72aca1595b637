use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, Parser, Subcommand, ValueEnum};
use dataset::Dropped;

use crate::config::Config;
use crate::import::ImportArgs;
use crate::inspect::InspectArgs;
use crate::run::{Mode, Run};
use crate::{inspect, lineage, models, pipeline, stages};

/// Turns the drive logs that robots record into loop-closure classifiers.
///
/// A pipeline file holds every parameter of a run. `run` does all stages, of which it redoes only
/// what has changed; each stage is also a command of its own on the same folder. Exit codes: 0
/// done, 1 failed, 2 usage, 3 done but some data could not be used.
#[derive(Parser)]
#[command(version)]
pub(crate) struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Do all stages, from logs to report; redo only what has changed
    Run {
        #[command(flatten)]
        args: PipelineArgs,
        /// Do a stage again though nothing has changed
        #[arg(long, value_name = "STAGE", value_enum)]
        force: Vec<Stage>,
        /// Tell what would be done, and why, and do nothing
        #[arg(long)]
        dry_run: bool,
        /// Stop at a log that cannot be ingested, instead of leaving it out
        #[arg(long)]
        strict: bool,
    },
    /// Make the logs of the pipeline's [simulate] section
    Simulate(PipelineArgs),
    /// Logs -> scans/LOG.parquet, poses/LOG.parquet
    Ingest {
        #[command(flatten)]
        args: PipelineArgs,
        /// Stop at a log that cannot be ingested, instead of leaving it out
        #[arg(long)]
        strict: bool,
    },
    /// Scans and poses -> keyframes.parquet
    Subsample(PipelineArgs),
    /// Keyframes -> pairs.parquet
    Label(PipelineArgs),
    /// Keyframes -> features.parquet
    Featurize(PipelineArgs),
    /// Pairs and features -> models/, scores.parquet, rounds.parquet
    Train(PipelineArgs),
    /// Scores -> evaluation/, report.html
    Evaluate {
        #[command(flatten)]
        args: PipelineArgs,
        /// Print the numbers of the report as JSON, and nothing else
        #[arg(long)]
        json: bool,
    },
    /// Tell what a log holds and which pipeline would fit it
    Inspect(InspectArgs),
    /// Turn a recording in another format into an MCAP log
    Import(ImportArgs),
    /// Tell what an artifact was made from, up to the logs
    Log {
        /// A table, a model.json or a report.html
        artifact: PathBuf,
    },
    /// Recheck every digest of a run folder: what has changed, is missing, or is newer than what was
    /// made from it
    Verify {
        /// A run folder
        folder: PathBuf,
        /// The pipeline file, to check the logs too
        #[arg(long, value_name = "PIPELINE.toml")]
        pipeline: Option<PathBuf>,
    },
    /// Print the JSON Schema of a file that loopboost reads
    Schema {
        /// Which file
        file: SchemaOf,
    },
    /// List, show, compare, check and export models
    Model {
        #[command(subcommand)]
        command: ModelCommand,
    },
}

#[derive(Subcommand)]
enum ModelCommand {
    /// List the models below a folder
    List {
        /// A run folder, or a folder of models
        folder: PathBuf,
    },
    /// Print a model's card
    Show {
        /// A model.json
        model: PathBuf,
    },
    /// Tell how two models differ
    Diff {
        /// A model.json
        a: PathBuf,
        /// Another
        b: PathBuf,
    },
    /// Check every value and the digest of a model, or of all below a folder
    Verify {
        /// A model.json or a folder
        path: PathBuf,
    },
    /// Write a model for other runtimes
    Export {
        /// A model.json
        model: PathBuf,
        /// The ONNX file to write: F = |f_a - f_b| in, confidence and label out
        #[arg(long, value_name = "FILE")]
        onnx: PathBuf,
        /// Confidence from which a pair is labelled positive
        #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
        threshold: f64,
    },
}

#[derive(Clone, Copy, ValueEnum)]
enum SchemaOf {
    /// The pipeline file
    Pipeline,
    /// model.json
    Model,
}

#[derive(Clone, Copy, ValueEnum)]
enum Stage {
    Simulate,
    Ingest,
    Subsample,
    Label,
    Featurize,
    Train,
    Evaluate,
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
        let always = Mode::Always;
        match self.command {
            Command::Run { args, force, dry_run, strict } => {
                let force = force
                    .into_iter()
                    .filter_map(|stage| Some(stage.to_possible_value()?.get_name().to_owned()))
                    .collect();
                let mode = if dry_run { Mode::DryRun { force } } else { Mode::Resume { force } };
                args.execute(mode, strict, pipeline::run)
            }
            Command::Simulate(args) => args.execute(always, true, stages::simulate::run),
            Command::Ingest { args, strict } => args.execute(always, strict, stages::ingest::run),
            Command::Subsample(args) => args.execute(always, true, stages::subsample::run),
            Command::Label(args) => args.execute(always, true, stages::label::run),
            Command::Featurize(args) => args.execute(always, true, stages::featurize::run),
            Command::Train(args) => args.execute(always, true, stages::train::run),
            Command::Evaluate { args, json: false } => {
                args.execute(always, true, stages::evaluate::run)
            }
            Command::Evaluate { args, json: true } => {
                args.execute(Mode::Quiet, true, stages::evaluate::run_and_print)
            }
            Command::Inspect(args) => inspect::inspect(&args),
            Command::Import(args) => args.execute(),
            Command::Log { artifact } => done(lineage::log(&artifact)),
            Command::Verify { folder, pipeline } => {
                let config = pipeline.map(|path| Config::load(&path, &[])).transpose()?;
                done(lineage::verify(&folder, config.as_ref()))
            }
            Command::Schema { file } => {
                let schema = match file {
                    SchemaOf::Pipeline => schemars::schema_for!(Config),
                    SchemaOf::Model => model::schema(),
                };
                out!("{}", serde_json::to_string_pretty(&schema)?);
                Ok(Dropped::default())
            }
            Command::Model { command } => done(match command {
                ModelCommand::List { folder } => models::list(&folder),
                ModelCommand::Show { model } => models::show(&model),
                ModelCommand::Diff { a, b } => models::diff(&a, &b),
                ModelCommand::Verify { path } => models::verify(&path),
                ModelCommand::Export { model, onnx, threshold } => {
                    models::export(&model, &onnx, threshold)
                }
            }),
        }
    }
}

impl PipelineArgs {
    fn execute(
        self,
        mode: Mode,
        strict: bool,
        stage: fn(&Run) -> Result<Dropped>,
    ) -> Result<Dropped> {
        let config = Config::load(&self.pipeline, &self.overrides)?;
        match self.out {
            Some(out) if !self.print_config => stage(&Run::new(config, out, mode, strict)?),
            _ => {
                out!("{}", config.to_toml()?.trim_end());
                Ok(Dropped::default())
            }
        }
    }
}

/// For commands that use no data.
fn done(result: Result<()>) -> Result<Dropped> {
    result.map(|()| Dropped::default())
}
