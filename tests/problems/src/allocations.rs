//! A counting allocator: how many times a piece of code asks for memory, and for how much.
#![allow(unsafe_code)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

thread_local! {
    static COUNT: Cell<usize> = const { Cell::new(0) };
    // Bytes in use, and the most there have been; memory may be given back by another thread than the one
    // that asked.
    static LIVE: Cell<isize> = const { Cell::new(0) };
    static PEAK: Cell<isize> = const { Cell::new(0) };
}

/// The system's allocator, counting the requests of every thread apart.
struct Counting;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

// The cells have no destructors, so they can be reached as long as the thread runs.

fn count(bytes: usize) {
    COUNT.with(|c| c.set(c.get() + 1));
    let live = LIVE.with(|l| {
        l.set(l.get() + bytes as isize);
        l.get()
    });
    PEAK.with(|p| p.set(p.get().max(live)));
}

fn give_back(bytes: usize) {
    LIVE.with(|l| l.set(l.get() - bytes as isize));
}

// SAFETY: every request is handed to the system's allocator unchanged; the counter does not allocate.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size());
        // SAFETY: the caller keeps the contract of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count(layout.size());
        // SAFETY: the caller keeps the contract of `alloc_zeroed`.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        give_back(layout.size());
        count(size);
        // SAFETY: the caller keeps the contract of `realloc`.
        unsafe { System.realloc(pointer, layout, size) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        give_back(layout.size());
        // SAFETY: the caller keeps the contract of `dealloc`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

/// Runs `code` and returns how many times this thread asked for memory meanwhile, with what it returned.
pub fn allocations<T>(code: impl FnOnce() -> T) -> (usize, T) {
    let before = COUNT.with(Cell::get);
    let value = code();
    (COUNT.with(Cell::get) - before, value)
}

/// Memory of one thread \[bytes\].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Heap {
    /// What was asked for and not given back.
    pub kept: usize,
    /// The most that was in use at once.
    pub peak: usize,
}

/// Runs `code` and returns what this thread asked for meanwhile, with what it returned (still counted as
/// kept).
pub fn heap<T>(code: impl FnOnce() -> T) -> (Heap, T) {
    let before = LIVE.with(Cell::get);
    PEAK.with(|p| p.set(before));
    let value = code();
    let since = |cell: &Cell<isize>| (cell.get() - before).max(0) as usize;
    (Heap { kept: LIVE.with(since), peak: PEAK.with(since) }, value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_bytes_kept_and_at_most() {
        let (heap, kept) = heap(|| {
            drop(vec![0u8; 1000]);
            let mut kept = vec![1u8; 300];
            kept.resize(500, 2);
            kept.shrink_to_fit();
            kept
        });
        assert_eq!(heap, Heap { kept: kept.len(), peak: 1000 });
    }

    #[test]
    fn counts_what_asks_for_memory_and_nothing_else() {
        assert_eq!(allocations(|| 1 + 1).0, 0);
        let mut kept = Vec::with_capacity(4);
        assert_eq!(allocations(|| kept.extend([1, 2, 3, 4])).0, 0);
        assert_eq!(allocations(|| kept.push(5)).0, 1);
        assert_eq!(allocations(|| vec![0.0; 100]).0, 1);
    }
}
