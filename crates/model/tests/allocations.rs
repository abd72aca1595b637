//! Scoring a pair allocates no memory.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use model::{Classifier, Learner, WeakLearner};

struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: every call is passed to the system allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|n| n.set(n.get() + 1));
        // SAFETY: the caller upholds the contract of the system allocator.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller upholds the contract of the system allocator.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn scoring_a_pair_allocates_no_memory() {
    let rounds = (0..50)
        .map(|k| WeakLearner::Step { feature: k % 16, threshold: 8.0, below: 0.5, above: -0.25 })
        .collect();
    let classifier = Classifier { learner: Learner::GentleStump, rounds };
    let (a, b): ([f64; 16], [f64; 16]) =
        (std::array::from_fn(|k| k as f64), std::array::from_fn(|k| 20.0 - k as f64));
    let mut f = [0.0; 16];
    let before = ALLOCATIONS.with(Cell::get);
    let mut sum = 0.0;
    for _ in 0..1000 {
        featurize::difference(&a, &b, &mut f);
        sum += classifier.confidence(&f);
    }
    assert_eq!(ALLOCATIONS.with(Cell::get) - before, 0);
    assert!(sum.is_finite());
}
