//! Values that are made when they are needed.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};

use rayon::prelude::*;

/// Values with a number each, such as the nodes of a drive. They are made when they are needed, because all of them
/// may not fit into memory, and those that were needed last are kept.
#[derive(Debug)]
pub struct Kept<T> {
    max: usize,
    values: Mutex<Values<T>>,
}

#[derive(Debug)]
struct Values<T> {
    /// Each with the last request that needed it.
    by_number: BTreeMap<usize, (u64, Arc<T>)>,
    n_requests: u64,
}

impl<T: Send + Sync> Kept<T> {
    /// At most `max` values are kept, or those of the last request if these are more.
    pub fn new(max: usize) -> Self {
        Self { max, values: Mutex::new(Values { by_number: BTreeMap::new(), n_requests: 0 }) }
    }

    /// The values with some numbers. Those that are not kept are made, in parallel.
    pub fn get(
        &self,
        wanted: &BTreeSet<usize>,
        make: impl Fn(usize) -> T + Sync,
    ) -> BTreeMap<usize, Arc<T>> {
        let lock = || self.values.lock().unwrap_or_else(PoisonError::into_inner);
        let (request, mut found, missing) = {
            let mut values = lock();
            values.n_requests += 1;
            let request = values.n_requests;
            let (mut found, mut missing) = (BTreeMap::new(), Vec::new());
            for &number in wanted {
                match values.by_number.get_mut(&number) {
                    Some((last, value)) => {
                        *last = request;
                        found.insert(number, value.clone());
                    }
                    None => missing.push(number),
                }
            }
            let n = values.by_number.len() + missing.len();
            values.forget(n.saturating_sub(self.max));
            (request, found, missing)
        };
        // Without the lock: a thread that waits for others may meet another request.
        let made: Vec<Arc<T>> = missing.par_iter().map(|&k| Arc::new(make(k))).collect();
        let mut values = lock();
        for (number, value) in missing.into_iter().zip(made) {
            values.by_number.insert(number, (request, value.clone()));
            found.insert(number, value);
        }
        found
    }
}

impl<T> Values<T> {
    /// Forgets `n` values, those first that were needed the longest time ago, but none of the last request.
    fn forget(&mut self, n: usize) {
        if n == 0 {
            return;
        }
        let old = self.by_number.iter().filter(|(_, (last, _))| *last < self.n_requests);
        let mut old: Vec<(u64, usize)> = old.map(|(number, (last, _))| (*last, *number)).collect();
        old.sort_unstable();
        for (_, number) in old.into_iter().take(n) {
            self.by_number.remove(&number);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    /// Three values are kept. The one that was needed the longest time ago is made again.
    #[test]
    fn the_values_that_were_needed_last_are_kept() {
        let kept = Kept::new(3);
        let n_made = AtomicUsize::new(0);
        let get = |wanted: &[usize]| {
            let values = kept.get(&wanted.iter().copied().collect(), |k| {
                n_made.fetch_add(1, Ordering::Relaxed);
                10 * k
            });
            let found: Vec<(usize, usize)> = values.iter().map(|(k, v)| (*k, **v)).collect();
            let expected: Vec<(usize, usize)> = wanted.iter().map(|&k| (k, 10 * k)).collect();
            assert_eq!(found, expected);
            n_made.swap(0, Ordering::Relaxed)
        };
        assert_eq!(get(&[1, 2]), 2);
        assert_eq!(get(&[3]), 1);
        // 2 goes.
        assert_eq!(get(&[1, 4]), 1);
        assert_eq!(get(&[1, 3, 4]), 0);
        assert_eq!(get(&[2]), 1);
        // More than are kept.
        assert_eq!(get(&[5, 6, 7, 8, 9]), 5);
        assert_eq!(get(&[5, 6, 7, 8, 9]), 0);
    }
}
