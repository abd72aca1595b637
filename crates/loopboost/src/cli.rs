//! The command line.

use std::path::PathBuf;

use anyhow::Result;
use clap::{
    Arg, ArgAction, ArgMatches, Args, CommandFactory, FromArgMatches, Parser, Subcommand, ValueEnum,
};
use clap_complete::Shell;
use evaluate::comparison::Comparison;

use crate::config::{Config, usage};
use crate::findings::{Failure, Findings};
use crate::fleet::{GcArgs, MergeArgs, PlanArgs, TaskArgs};
use crate::import::ImportArgs;
use crate::inspect::InspectArgs;
use crate::locate::LocateArgs;
use crate::map::MapCommand;
use crate::run::{Mode, Run};
use crate::score::ScoreArgs;
use crate::stage::Stage;
use crate::used_model::UsedModel;
use crate::view::ViewArgs;
use crate::{inspect, lineage, models, pipeline, shell, stages};

/// Turns the drive logs that robots record into loop-closure classifiers.
///
/// A pipeline file contains every parameter of a run. `run` runs all stages and repeats only those
/// whose inputs or options have changed. Each stage is also a command of its own on the same
/// folder. Exit codes: 0 done, nothing needs attention; 1 failed; 2 wrong command line or pipeline
/// file; 3 done, but data was dropped or a warning needs attention (docs/messages.md explains each
/// code).
#[derive(Parser)]
#[command(version)]
pub(crate) struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Run all stages, from logs to report; repeat only what has changed
    Run {
        #[command(flatten)]
        args: PipelineArgs,
        /// Repeat a stage even if nothing has changed
        #[arg(long, value_name = "STAGE", value_enum)]
        force: Vec<Stage>,
        /// Show what would run, and why, without running it
        #[arg(long)]
        dry_run: bool,
        /// Stop at a log that cannot be used, instead of leaving it out
        #[arg(long)]
        strict: bool,
    },
    #[command(flatten)]
    Stage(StageCommand),
    /// Plan the work on single logs for `task`, on one or many machines; prints the name of the plan
    Plan(PlanArgs),
    /// Do the work on one log of a plan; exit codes: 0 done, 2 wrong plan or command line, 70 another attempt had another
    /// result, 75 trouble with storage or inputs (try again)
    Task(TaskArgs),
    /// Make the tables and run.json of a run folder from the results of all tasks of a plan
    Merge(MergeArgs),
    /// Remove files in a run folder that no plan and no task needs any more
    Gc(GcArgs),
    /// Describe a log, report problems in it, and suggest a pipeline file
    Inspect(InspectArgs),
    /// Convert a recording of another format to an MCAP log
    Import(ImportArgs),
    /// Score pairs of scans with a model: confidence and label
    Score(ScoreArgs),
    /// Find where the scans of logs lie in the map of a finished run
    Locate(LocateArgs),
    /// Write the loop closures and the map of a run for Foxglove and for map_server
    View(ViewArgs),
    /// Compare the maps of two runs
    Map {
        #[command(subcommand)]
        command: MapCommand,
    },
    /// Show the inputs of an artifact, back to the logs
    Lineage {
        /// A table, a model.json or a report.html
        artifact: PathBuf,
        /// Print the options that each input was made with, too
        #[arg(long)]
        verbose: bool,
    },
    /// The former name of `lineage`.
    #[command(hide = true)]
    Log {
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        _rest: Vec<String>,
    },
    /// Check a run folder for files that changed, are missing, or are newer than their outputs
    Verify {
        /// A run folder
        folder: PathBuf,
        /// The pipeline file, to check the logs too
        #[arg(long, value_name = "PIPELINE.toml")]
        pipeline: Option<PathBuf>,
    },
    /// Print the JSON Schema of a file that loopboost reads or writes
    Schema {
        /// Which file
        file: SchemaOf,
    },
    /// List, show, compare, verify and export models
    Model {
        #[command(subcommand)]
        command: ModelCommand,
    },
    /// Print a script that completes commands and options in a shell
    Completions {
        /// The shell
        shell: Shell,
    },
    /// Write the man pages of all commands into a folder
    Man {
        /// The folder; created if missing
        folder: PathBuf,
    },
}

#[derive(Subcommand)]
enum ModelCommand {
    /// List the models in a folder
    List {
        /// A run folder, or a folder of models
        folder: PathBuf,
    },
    /// Print a model's card
    Show {
        /// A model.json, or a folder with one model
        model: PathBuf,
    },
    /// Show how two models differ
    Diff {
        /// A model.json, or a folder with one model
        a: PathBuf,
        /// Another model.json, or a folder with one model
        b: PathBuf,
    },
    /// Check every value and the digest of a model, or of all models in a folder
    Verify {
        /// A model.json or a folder
        path: PathBuf,
    },
    /// Export a model for other runtimes
    Export {
        /// A model.json, or a folder with one model
        model: PathBuf,
        /// The ONNX file to write: F = |f_a - f_b| in, confidence and label out
        #[arg(long, value_name = "FILE")]
        onnx: PathBuf,
        /// A pair with at least this confidence is labelled positive
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
    /// The output of `map compare --json`
    Comparison,
}

/// A stage as a command of its own. Names and help come from [`Stage`].
struct StageCommand {
    stage: Stage,
    args: PipelineArgs,
    /// Only `ingest`, `subsample` and `detect` have this flag.
    strict: bool,
    /// Only `evaluate` has this flag.
    json: bool,
    /// Only `register`, `detect`, `optimize` and `evaluate` have this option.
    model: Option<PathBuf>,
}

const STRICT: &str = "strict";
const JSON: &str = "json";
const MODEL: &str = "model";

impl Subcommand for StageCommand {
    fn augment_subcommands(command: clap::Command) -> clap::Command {
        Stage::ALL.into_iter().fold(command, |command, stage| {
            let flag = |name, help| Arg::new(name).long(name).action(ArgAction::SetTrue).help(help);
            let own = clap::Command::new(stage.name()).about(stage.spec().help);
            let own = PipelineArgs::augment_args(own);
            let own = match Stage::USE_MODEL.contains(&stage) {
                true => own.arg(model_arg(stage)),
                false => own,
            };
            command.subcommand(match stage {
                Stage::Ingest | Stage::Subsample | Stage::Detect => own.arg(flag(
                    STRICT,
                    "Stop at a log that cannot be used, instead of leaving it out",
                )),
                Stage::Evaluate => {
                    own.arg(flag(JSON, "Print the numbers of the report as JSON, and nothing else"))
                }
                _ => own,
            })
        })
    }

    fn augment_subcommands_for_update(command: clap::Command) -> clap::Command {
        Self::augment_subcommands(command)
    }

    fn has_subcommand(name: &str) -> bool {
        Stage::ALL.into_iter().any(|stage| stage.name() == name)
    }
}

impl FromArgMatches for StageCommand {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let (stage, matches) = matches
            .subcommand()
            .and_then(|(name, matches)| {
                Some((Stage::ALL.into_iter().find(|stage| stage.name() == name)?, matches))
            })
            .ok_or_else(|| clap::Error::new(clap::error::ErrorKind::MissingSubcommand))?;
        let has = |name| matches.try_get_one(name).ok().flatten().copied().unwrap_or(false);
        let args = PipelineArgs::from_arg_matches(matches)?;
        let model = matches.try_get_one::<PathBuf>(MODEL).ok().flatten().cloned();
        Ok(Self { stage, args, strict: has(STRICT), json: has(JSON), model })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

fn model_arg(stage: Stage) -> Arg {
    let help = match stage {
        Stage::Detect => {
            "Find loop closures in the logs of the pipeline with this model.json, or the only one in this folder: runs all stages from ingest to optimize, and the report"
        }
        _ => "The model that `loopboost detect --model` was run with, for a folder of that command",
    };
    let parser = clap::value_parser!(PathBuf);
    Arg::new(MODEL).long(MODEL).value_name("MODEL.json").value_parser(parser).help(help)
}

#[derive(Args)]
struct PipelineArgs {
    /// The pipeline file (TOML)
    pipeline: PathBuf,
    /// The run folder; created if missing
    #[arg(long, value_name = "DIR", required_unless_present = "print_config")]
    out: Option<PathBuf>,
    /// Override a key, for example --set label.positive_radius_m=2
    #[arg(long = "set", value_name = "KEY=VALUE")]
    overrides: Vec<String>,
    /// Print the pipeline with all defaults, and stop
    #[arg(long)]
    print_config: bool,
    /// Whether the command is a stage of loop detection, which has defaults without `[detect]`.
    #[arg(skip)]
    detects: bool,
}

impl Cli {
    /// Whether the command is `task`, which has exit codes of its own for batch systems.
    pub(crate) fn is_task(&self) -> bool {
        matches!(self.command, Command::Task(_))
    }

    /// Does what was asked. Returns losses and notes.
    pub(crate) fn execute(self) -> Result<Findings, Failure> {
        match self.command {
            Command::Run { args, force, dry_run, strict } => {
                let mode = if dry_run { Mode::DryRun { force } } else { Mode::Resume { force } };
                args.execute(mode, strict, None, pipeline::run)
            }
            Command::Stage(StageCommand { stage, mut args, strict, json, model }) => {
                args.detects = [Stage::Register, Stage::Detect, Stage::Optimize].contains(&stage);
                match (stage, &model) {
                    (Stage::Evaluate, _) if json => {
                        args.execute(Mode::Quiet, true, model, stages::evaluate::run_and_print)
                    }
                    (Stage::Detect, Some(_)) => {
                        let mode = Mode::Resume { force: Vec::new() };
                        args.execute(mode, strict, model, pipeline::run)
                    }
                    _ => args.execute(Mode::Always, strict, model, pipeline::stage(stage)),
                }
            }
            other => Ok(other.execute()?),
        }
    }
}

impl Command {
    /// The commands that are not stages.
    fn execute(self) -> Result<Findings> {
        match self {
            Self::Run { .. } | Self::Stage(_) => Ok(Findings::default()),
            Self::Plan(args) => args.execute(),
            Self::Task(args) => args.execute(),
            Self::Merge(args) => args.execute(),
            Self::Gc(args) => args.execute(),
            Self::Inspect(args) => inspect::inspect(&args),
            Self::Import(args) => args.execute(),
            Self::Score(args) => args.execute(),
            Self::Locate(args) => args.execute(),
            Self::View(args) => args.execute(),
            Self::Map { command } => command.execute(),
            Self::Lineage { artifact, verbose } => done(lineage::lineage(&artifact, verbose)),
            Self::Log { .. } => Err(usage("`loopboost log` was renamed: use `loopboost lineage`")),
            Self::Verify { folder, pipeline } => {
                let config = pipeline.map(|path| Config::load(&path, &[])).transpose()?;
                done(lineage::verify(&folder, config.as_ref()))
            }
            Self::Schema { file } => {
                let schema = match file {
                    SchemaOf::Pipeline => schemars::schema_for!(Config),
                    SchemaOf::Model => model::schema(),
                    SchemaOf::Comparison => schemars::schema_for!(Comparison),
                };
                out!("{}", serde_json::to_string_pretty(&schema)?);
                Ok(Findings::default())
            }
            Self::Completions { shell } => done(shell::completions(Cli::command(), shell)),
            Self::Man { folder } => done(shell::man(Cli::command(), &folder)),
            Self::Model { command } => done(match command {
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
        model: Option<PathBuf>,
        stage: fn(&Run) -> Result<Findings>,
    ) -> Result<Findings, Failure> {
        let mut config = Config::load(&self.pipeline, &self.overrides)?;
        if self.detects {
            config.detect.get_or_insert_default();
        }
        let model = model.map(|path| UsedModel::load(&path)).transpose()?;
        if let Some(model) = model.as_ref().filter(|_| config.detection().classifier) {
            model.set_features(&mut config)?;
        }
        match self.out {
            Some(out) if !self.print_config => {
                let run = Run::new(config, out, mode, strict, model)?;
                let done = stage(&run);
                // Also after an error: the tasks before it are done.
                let saved = run.finish();
                done.and_then(|findings| saved.map(|()| findings))
                    .map_err(|error| Failure { before: run.findings_so_far(), error })
            }
            _ => {
                out!("{}", config.to_toml()?.trim_end());
                Ok(Findings::default())
            }
        }
    }
}

/// For commands that read no logs.
fn done(result: Result<()>) -> Result<Findings> {
    result.map(|()| Findings::default())
}
