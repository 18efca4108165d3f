//! A counting allocator: how many times a piece of code asks for memory.
#![allow(unsafe_code)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

thread_local! {
    static COUNT: Cell<usize> = const { Cell::new(0) };
}

/// The system's allocator, counting the requests of every thread apart.
struct Counting;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn count() {
    // The cell has no destructor, so it can be reached as long as the thread runs.
    COUNT.with(|c| c.set(c.get() + 1));
}

// SAFETY: every request is handed to the system's allocator unchanged; the counter does not allocate.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller keeps the contract of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller keeps the contract of `alloc_zeroed`.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: the caller keeps the contract of `realloc`.
        unsafe { System.realloc(pointer, layout, size) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_what_asks_for_memory_and_nothing_else() {
        assert_eq!(allocations(|| 1 + 1).0, 0);
        let mut kept = Vec::with_capacity(4);
        assert_eq!(allocations(|| kept.extend([1, 2, 3, 4])).0, 0);
        assert_eq!(allocations(|| kept.push(5)).0, 1);
        assert_eq!(allocations(|| vec![0.0; 100]).0, 1);
    }
}
