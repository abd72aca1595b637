//! Numbers for names, which are faster to compare.

use std::collections::BTreeMap;
use std::sync::Arc;

/// Numbers names from 0 in their order, and returns the number of each.
pub(crate) fn numbers<'a>(names: impl Iterator<Item = &'a Arc<str>> + Clone) -> Vec<u32> {
    let mut known: BTreeMap<&str, u32> = names.clone().map(|name| (&**name, 0)).collect();
    known.values_mut().zip(0..).for_each(|(number, k)| *number = k);
    names.map(|name| known[&**name]).collect()
}
