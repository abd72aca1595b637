//! Logs that are copies of another log: each drive is used once.
//!
//! Two copies of one drive would give pairs of identical scans, which every classifier recognises,
//! and the same ground in training and test.

use std::collections::BTreeMap;

use anyhow::Result;

use super::Run;
use super::manifest::Change;
use crate::logs::LogFile;

impl Run {
    /// Finds the logs with the same bytes as an earlier log and stores them in `run.json`. Only
    /// logs of the same size are read. Logs that are empty or cannot be read are left to `ingest`.
    pub(crate) fn find_copies(&self) -> Result<()> {
        let mut by_size: BTreeMap<Vec<u64>, Vec<&LogFile>> = BTreeMap::new();
        for log in self.logs()? {
            let sizes = log.paths.iter().map(|path| Ok(std::fs::metadata(path)?.len()));
            if let Ok(sizes) = sizes.collect::<std::io::Result<_>>() {
                by_size.entry(sizes).or_default().push(log);
            }
        }
        by_size.retain(|sizes, _| sizes.iter().any(|&n_bytes| 0 < n_bytes));
        let mut copies = BTreeMap::new();
        for logs in by_size.into_values().filter(|logs| 1 < logs.len()) {
            let mut by_digest: BTreeMap<Vec<String>, &LogFile> = BTreeMap::new();
            for log in logs {
                let Ok(digests) = log.paths.iter().map(|path| self.digest(path)).collect() else {
                    continue;
                };
                match by_digest.get(&digests) {
                    Some(first) => {
                        copies.insert(log.name.to_string(), first.name.to_string());
                    }
                    None => {
                        by_digest.insert(digests, log);
                    }
                }
            }
        }
        if self.manifest.borrow().copies == copies {
            return Ok(());
        }
        self.change(Change::Copies(copies))
    }

    /// The run's logs without copies of other logs.
    pub(crate) fn logs_without_copies(&self) -> Result<Vec<LogFile>> {
        let copies = self.copies()?;
        Ok(self.logs()?.iter().filter(|log| !copies.contains_key(&*log.name)).cloned().collect())
    }

    /// The copies among the logs of this run, each with the log that is used instead. `run.json` may
    /// list others, which the pipeline does not name any more.
    pub(crate) fn copies(&self) -> Result<BTreeMap<String, String>> {
        let logs = self.logs()?;
        let is_log = |name: &String| logs.iter().any(|log| *log.name == **name);
        let copies = self.manifest.borrow().copies.clone();
        Ok(copies.into_iter().filter(|(copy, used)| is_log(copy) && is_log(used)).collect())
    }
}
