//! Threads that survive a fork.
//!
//! rayon's global pool is lost in a forked child: its threads are gone, and work given to it waits
//! for ever. So every thread that calls us keeps a pool of its own, labelled with the process it
//! was made in; a forked child finds the label wrong, abandons the pool and makes a new one. No
//! lock is involved, so none can be held by a thread that did not come along.

use std::cell::RefCell;
use std::mem;
use std::process;

use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

/// More threads than pieces of work would only wait.
const MAX_THREADS: usize = 64;

struct Owned {
    process: u32,
    pool: ThreadPool,
}

thread_local! {
    static POOL: RefCell<Option<Owned>> = const { RefCell::new(None) };
}

/// Processors this process may use.
pub fn available() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// `f` of every item, on `threads` threads (0: one for each processor), results in order.
///
/// Which thread takes which item is left to chance, so `f` must not depend on it.
pub fn map<T: Send, R: Send>(
    threads: usize,
    items: Vec<T>,
    f: impl Fn(T) -> R + Send + Sync,
) -> Vec<R> {
    let threads = if threads == 0 { available() } else { threads }.min(MAX_THREADS);
    if threads == 1 || items.len() < 2 {
        return items.into_iter().map(f).collect();
    }
    POOL.with_borrow_mut(|slot| {
        let here = process::id();
        let usable = slot
            .as_ref()
            .is_some_and(|o| o.process == here && o.pool.current_num_threads() == threads);
        if !usable {
            if let Some(old) = slot.take()
                && old.process != here
            {
                mem::forget(old); // its threads live in the parent: nothing here to stop
            }
            *slot = ThreadPoolBuilder::new()
                .num_threads(threads)
                .thread_name(|i| format!("pbrfit-{i}"))
                .build()
                .ok()
                .map(|pool| Owned {
                    process: here,
                    pool,
                });
        }
        match slot {
            Some(Owned { pool, .. }) => pool.install(|| items.into_par_iter().map(f).collect()),
            // The system gives no more threads: slower, but the same result.
            None => items.into_iter().map(f).collect(),
        }
    })
}

/// Makes `to` a copy of `from`, on several threads where its memory serves again.
#[cfg(feature = "python")]
pub fn copy(threads: usize, from: &[f64], to: &mut Vec<f64>) {
    const PIECE: usize = 1 << 16;
    if to.len() != from.len() {
        to.clear();
        to.extend_from_slice(from);
        return;
    }
    let pieces = to.chunks_mut(PIECE).zip(from.chunks(PIECE)).collect();
    map(threads, pieces, |(to, from): (&mut [f64], &[f64])| {
        to.copy_from_slice(from);
    });
}
