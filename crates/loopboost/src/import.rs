//! `import`: converts a recording in another format to an MCAP log.

use std::fs::File;
use std::io::BufWriter;
use std::net::IpAddr;
use std::path::{Path, PathBuf};

use ::import::{Compression, ImportError, Imported, Options};
use anyhow::{Context, Result, anyhow};
use clap::{Args, ValueEnum};
use dataset::tables::{TableError, write_atomically};
use serde_json::json;

use crate::findings::Findings;
use crate::run::progress_bar;

#[derive(Args)]
pub(crate) struct ImportArgs {
    /// The files of one recording: ROS 1 bags, a ROS 2 bag (its folder or .db3 files), Velodyne captures (pcap,
    /// pcapng), an NCLT folder or its files, or CARMEN logs
    #[arg(required = true, value_name = "RECORDING")]
    inputs: Vec<PathBuf>,
    /// Log to write; must not exist
    #[arg(long, value_name = "LOG.mcap")]
    out: PathBuf,
    /// Import this topic and no others (bags only; can be repeated)
    #[arg(long, value_name = "NAME")]
    topic: Vec<String>,
    /// Compression of the chunks
    #[arg(long, value_enum, default_value_t = CompressionArg::Zstd)]
    compression: CompressionArg,
    /// UDP port of the data packets (captures only)
    #[arg(long, default_value_t = Options::default().udp_port)]
    udp_port: u16,
    /// UDP port of the position packets (captures only)
    #[arg(long, default_value_t = Options::default().position_port)]
    position_port: u16,
    /// IP address of the sensor (captures only; required if a capture contains several sensors)
    #[arg(long, value_name = "ADDRESS")]
    source_ip: Option<IpAddr>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum CompressionArg {
    Zstd,
    Lz4,
    None,
}

impl ImportArgs {
    /// Writes the log. Returns the sensor data that could not be used.
    pub(crate) fn execute(self) -> Result<Findings> {
        if self.out.exists() {
            return Err(anyhow!(
                "{} already exists; choose another file with --out",
                self.out.display()
            ));
        }
        let options = Options {
            compression: match self.compression {
                CompressionArg::Zstd => Compression::Zstd,
                CompressionArg::Lz4 => Compression::Lz4,
                CompressionArg::None => Compression::None,
            },
            udp_port: self.udp_port,
            position_port: self.position_port,
            source_ip: self.source_ip,
            select: self.topic.clone(),
            // Unpacked files are large. They go where the log goes.
            scratch: self.out.parent().map(|folder| match folder.as_os_str().is_empty() {
                true => PathBuf::from("."),
                false => folder.to_owned(),
            }),
            ..Options::default()
        };
        let n_bytes = ::import::input_bytes(&self.inputs)?;
        let progress = progress_bar(n_bytes, format!("import {}", self.out.display()), true);
        let imported = write_atomically(&self.out, |mut file: BufWriter<File>| {
            let imported =
                ::import::import(&self.inputs, &options, &mut file, |n| progress.set_position(n))?;
            Ok::<_, WriteLog>((file, imported))
        })
        .map_err(|error| match error {
            WriteLog::Import(error) => anyhow::Error::from(error),
            WriteLog::Table(error) => error.into(),
        })
        .with_context(|| format!("cannot write {}", self.out.display()))?;
        progress.finish_and_clear();
        match self.json {
            true => print_json(&self.out, &imported)?,
            false => print(&self.out, &imported),
        }
        Ok(Findings { losses: imported.losses, notes: imported.notes })
    }
}

fn print(path: &Path, imported: &Imported) {
    let seconds = (imported.end_ns - imported.start_ns) as f64 * 1e-9;
    out!("{}: {seconds:.1} s, imported from {}", path.display(), imported.format);
    for topic in &imported.topics {
        out!("  {:<24} {} ({} messages)", topic.topic, topic.message_type, topic.n_messages);
    }
}

fn print_json(path: &Path, imported: &Imported) -> Result<()> {
    let topics = imported.topics.iter().map(|topic| {
        json!({
            "topic": topic.topic,
            "type": topic.message_type.to_string(),
            "n_messages": topic.n_messages,
        })
    });
    let all = json!({
        "log": path,
        "format": imported.format.to_string(),
        "start_ns": imported.start_ns,
        "end_ns": imported.end_ns,
        "topics": topics.collect::<Vec<_>>(),
        "losses": imported.losses,
        "notes": imported.notes,
    });
    out!("{}", serde_json::to_string_pretty(&all)?);
    Ok(())
}

/// An error while the log is written.
enum WriteLog {
    Import(ImportError),
    Table(TableError),
}

impl From<ImportError> for WriteLog {
    fn from(error: ImportError) -> Self {
        Self::Import(error)
    }
}

impl From<TableError> for WriteLog {
    fn from(error: TableError) -> Self {
        Self::Table(error)
    }
}
