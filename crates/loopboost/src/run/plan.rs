//! `--dry-run`: which tasks would run, and why.

use anyhow::Result;

use super::manifest::Record;
use super::{Run, Task};
use crate::stage::Artifact;

impl Run {
    /// Prints whether a task would run, and why.
    pub(super) fn plan(
        &self,
        name: &str,
        task: &Task,
        record: Option<&Record>,
        is_forced: bool,
    ) -> Result<()> {
        let would_change = self.would_change.borrow().clone();
        let unsettled: Vec<String> = task
            .inputs
            .iter()
            .filter(|input| would_change.contains(*input))
            .map(|input| format!("{} may change", self.folder.name_of(input)))
            .collect();
        let (verdict, runs) = match record {
            _ if is_forced => ("would run: forced".to_owned(), true),
            None => ("would run: not done yet".to_owned(), true),
            Some(_) if !unsettled.is_empty() => {
                (format!("would run if its inputs change: {}", unsettled.join(", ")), true)
            }
            Some(record) => {
                let changes = self.changes_since(record, &self.provenance(task)?);
                match changes.is_empty() {
                    true => ("up to date".to_owned(), false),
                    false => (format!("would run: {}", changes.join(", ")), true),
                }
            }
        };
        if runs {
            let is_made = |output: &&Artifact| task.makes(**output) && self.goal.has(**output);
            let outputs = task.stage.spec().outputs.iter().filter(is_made);
            let paths = outputs.flat_map(|&artifact| self.paths_of(artifact, task.log.as_deref()));
            self.would_change.borrow_mut().extend(paths);
        }
        out!("{name:<24} {verdict}");
        Ok(())
    }
}
