//! The scans of drives, read from their tables when they are needed.

use std::collections::HashMap;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use anyhow::{Result, anyhow};
use dataset::tables::TableError;
use dataset::tables::scans::ScanTable;
use dataset::{RangeLimits, Scan};
use register::{DriveScan, ScanSource};

/// The scans in memory have about this size at most \[bytes\].
const MAX_BYTES: usize = 256 << 20;
/// Memory of a return \[bytes\]: x and y of the scan, and position and normal of most of its points.
const BYTES_PER_RETURN: usize = 48;

/// Keeps the scans that were used last. All drives of a run share one.
pub(crate) struct ScanCache {
    max_bytes: usize,
    groups: Mutex<Groups>,
    /// The first error of a source. Its scans have no returns, so no result may be used.
    error: OnceLock<Arc<TableError>>,
    n_sources: AtomicU64,
}

/// A group of scans of a source.
type Key = (u64, usize);

#[derive(Default)]
struct Groups {
    by_key: HashMap<Key, Group>,
    n_bytes: usize,
    n_requests: u64,
}

#[derive(Clone, Default)]
struct Group {
    scans: Arc<OnceLock<Vec<Arc<DriveScan>>>>,
    n_bytes: usize,
    /// The last request for it.
    last: u64,
}

impl Default for ScanCache {
    fn default() -> Self {
        Self::of_bytes(MAX_BYTES)
    }
}

impl ScanCache {
    fn of_bytes(max_bytes: usize) -> Self {
        Self {
            max_bytes,
            groups: Mutex::default(),
            error: OnceLock::new(),
            n_sources: AtomicU64::new(0),
        }
    }

    /// The scans of a table with these numbers, in this order. `limits` are the range limits of their points.
    pub(crate) fn open(
        self: &Arc<Self>,
        path: &Path,
        numbers: &[u32],
        limits: RangeLimits,
    ) -> Result<TableScans> {
        let table = ScanTable::open(path)?;
        let mut sorted: Vec<(u32, usize)> = numbers.iter().copied().zip(0..).collect();
        sorted.sort_unstable();
        let mut groups: Vec<Vec<u32>> = vec![Vec::new(); table.groups().len()];
        let mut at = vec![(0, 0); numbers.len()];
        for (number, index) in sorted {
            let group = table.groups().partition_point(|rows| rows.end <= number);
            let Some(of_group) = groups.get_mut(group) else {
                return Err(anyhow!(
                    "{}: no scan {number}, but a table that was made from it has one; repeat the command that made the run",
                    path.display()
                ));
            };
            if of_group.last() != Some(&number) {
                of_group.push(number);
            }
            at[index] = (group as u32, of_group.len() as u32 - 1);
        }
        let number = self.n_sources.fetch_add(1, Ordering::Relaxed);
        Ok(TableScans { cache: self.clone(), number, table, groups, at, limits })
    }

    /// An error if a source could not read some scans.
    pub(crate) fn check(&self) -> Result<()> {
        match self.error.get() {
            Some(error) => Err(error.clone().into()),
            None => Ok(()),
        }
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Groups> {
        self.groups.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A scan of a group, which `read` reads.
    fn scan(
        &self,
        key: Key,
        position: usize,
        read: impl FnOnce() -> Vec<Arc<DriveScan>>,
    ) -> Arc<DriveScan> {
        let scans = {
            let mut groups = self.lock();
            groups.n_requests += 1;
            let last = groups.n_requests;
            let group = groups.by_key.entry(key).or_default();
            group.last = last;
            group.scans.clone()
        };
        let mut is_new = false;
        // Other threads that ask for the group wait until it is read.
        let of_group = scans.get_or_init(|| {
            is_new = true;
            read()
        });
        if is_new {
            let n_returns: usize = of_group.iter().map(|scan| scan.scan().len()).sum();
            self.lock().add(key, BYTES_PER_RETURN * n_returns, self.max_bytes);
        }
        of_group[position].clone()
    }
}

impl Groups {
    /// Counts the bytes of a group, and forgets groups that were not used for the longest time.
    fn add(&mut self, key: Key, n_bytes: usize, max_bytes: usize) {
        if let Some(group) = self.by_key.get_mut(&key) {
            group.n_bytes = n_bytes;
            self.n_bytes += n_bytes;
        }
        while max_bytes < self.n_bytes {
            let of_others =
                self.by_key.iter().filter(|(other, group)| **other != key && 0 < group.n_bytes);
            let Some((&oldest, _)) = of_others.min_by_key(|(_, group)| group.last) else { break };
            self.n_bytes -= self.by_key.remove(&oldest).map_or(0, |group| group.n_bytes);
        }
    }
}

/// Some scans of a table.
pub(crate) struct TableScans {
    cache: Arc<ScanCache>,
    number: u64,
    table: ScanTable,
    /// The numbers of the scans in each group of the table, ascending.
    groups: Vec<Vec<u32>>,
    /// The group of each scan, and its position in the group.
    at: Vec<(u32, u32)>,
    limits: RangeLimits,
}

impl TableScans {
    fn read(&self, group: usize) -> Vec<Arc<DriveScan>> {
        let numbers = &self.groups[group];
        let scans = self.table.read(group, numbers).unwrap_or_else(|error| {
            // Only the first error is reported.
            let _ = self.cache.error.set(Arc::new(error));
            vec![Scan::default(); numbers.len()]
        });
        scans.into_iter().map(|scan| Arc::new(DriveScan::new(scan, self.limits))).collect()
    }
}

impl ScanSource for TableScans {
    fn len(&self) -> usize {
        self.at.len()
    }

    fn scan(&self, index: usize) -> Arc<DriveScan> {
        let (group, position) = self.at[index];
        let group = group as usize;
        self.cache.scan((self.number, group), position as usize, || self.read(group))
    }
}

/// The scans of a drive: some consecutive ones of a source.
pub(crate) struct DriveScans {
    pub(crate) of_log: Arc<TableScans>,
    pub(crate) first: usize,
    pub(crate) n: usize,
}

impl ScanSource for DriveScans {
    fn len(&self) -> usize {
        self.n
    }

    fn scan(&self, index: usize) -> Arc<DriveScan> {
        self.of_log.scan(self.first + index)
    }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use dataset::tables::Provenance;
    use dataset::tables::scans::write_scans;

    use super::*;

    const LIMITS: RangeLimits = RangeLimits { min_m: 0.1, max_m: 25.0 };

    /// A table of 300 scans in three groups. Scan k has its returns at x = k.
    fn table(folder: &Path) -> PathBuf {
        let path = folder.join("scans.parquet");
        let scan = |k: u32| Scan { x_m: vec![k as f32; 10], y_m: vec![1.0; 10], ..Scan::default() };
        write_scans(&path, &Provenance::default(), "monday", |writer| {
            writer.push((0..300).map(scan))
        })
        .unwrap();
        path
    }

    /// With memory for one group only, groups are read again, and the scans are the same.
    #[test]
    fn scans_come_in_the_order_that_was_asked_for_whatever_fits_into_memory() {
        let folder = tempfile::tempdir().unwrap();
        let path = table(folder.path());
        let numbers = [299, 0, 130, 5, 131, 298, 5];
        for max_bytes in [1, MAX_BYTES] {
            let cache = Arc::new(ScanCache::of_bytes(max_bytes));
            let source = cache.open(&path, &numbers, LIMITS).unwrap();
            assert_eq!(source.len(), numbers.len());
            for round in 0..2 {
                for (k, &number) in numbers.iter().enumerate() {
                    let scan = source.scan(k);
                    assert_eq!(scan.scan().x_m[0], number as f32, "{max_bytes} {round}");
                    assert_eq!(scan.scan().len(), 10);
                }
            }
            let n_kept = cache.lock().by_key.len();
            assert_eq!(n_kept, if max_bytes == 1 { 1 } else { 3 });
            assert!(cache.check().is_ok());
        }
    }

    #[test]
    fn a_table_that_cannot_be_read_any_more_is_an_error_of_the_cache() {
        let folder = tempfile::tempdir().unwrap();
        let path = table(folder.path());
        let cache = Arc::new(ScanCache::default());
        let source = cache.open(&path, &[1, 200], LIMITS).unwrap();
        std::fs::remove_file(&path).unwrap();
        assert_eq!(source.scan(1).scan().len(), 0);
        let error = cache.check().unwrap_err();
        assert!(error.to_string().contains("scans.parquet"), "{error}");
        let missing = table(folder.path());
        let error = cache.open(&missing, &[300], LIMITS).err().unwrap().to_string();
        assert!(error.contains("no scan 300"), "{error}");
    }
}
