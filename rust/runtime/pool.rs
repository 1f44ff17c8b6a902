//! Threads that survive a fork.
//!
//! rayon's global pool is lost in a forked child: its threads are gone, and work given to it waits
//! for ever. So every thread that calls us keeps a pool of its own, labelled with the process it
//! was made in; a forked child finds the label wrong, abandons the pool and makes a new one. No
//! lock outlives a call, so none can be held by a thread that did not come along.

use std::cell::RefCell;
use std::mem;
use std::process;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread::available_parallelism;

use rayon::{ThreadPool, ThreadPoolBuilder};

/// More threads than pieces of work would only wait.
const MAX_THREADS: usize = 64;

/// Bytes of a thread's stack: that of a main thread, since blocks of pixels among surroundings lie
/// there with all of their basis functions, within 5 % of the 2 MiB that are usual. The system
/// gives only what is touched.
const STACK: usize = 8 << 20;

struct Owned {
    process: u32,
    pool: ThreadPool,
}

thread_local! {
    static POOL: RefCell<Option<Owned>> = const { RefCell::new(None) };
}

/// `f` of every item, on `threads` threads (0: one for each processor), results in order.
///
/// Which thread takes which item is left to chance, so `f` must not depend on it. Nor may it call
/// this again: one of the threads is the caller's, whose pool is lent already.
pub fn map<T: Send, R: Send>(
    threads: usize,
    items: Vec<T>,
    f: impl Fn(T) -> R + Send + Sync,
) -> Vec<R> {
    let threads = match threads {
        0 => available_parallelism().map_or(1, usize::from),
        given => given,
    };
    let threads = threads.min(MAX_THREADS);
    if threads == 1 || items.len() < 2 {
        return items.into_iter().map(f).collect();
    }
    let count = items.len();
    let waiting = Mutex::new(items.into_iter().enumerate());
    let done = Mutex::new(Vec::with_capacity(count));
    let work = || {
        loop {
            let item = lock(&waiting).next();
            let Some((i, item)) = item else {
                break;
            };
            let result = f(item);
            lock(&done).push((i, result));
        }
    };
    with_pool(threads - 1, |pool| match pool {
        // The caller takes its share. Were it only to wait, the system might wake two threads of
        // the pool on the processor that it leaves, and let another idle: then they take turns for
        // seconds, at half the speed.
        Some(pool) => pool.in_place_scope(|scope| {
            for _ in 1..threads {
                scope.spawn(|_| work());
            }
            work();
        }),
        // The system gives no more threads: slower, but the same result.
        None => work(),
    });
    let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.sort_unstable_by_key(|&(i, _)| i);
    done.into_iter().map(|(_, result)| result).collect()
}

/// Nothing that may panic is done under these locks, so a poisoned one is as good as any.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// `f` with this thread's pool of `threads` threads, made anew where there is none in this process.
fn with_pool<R>(threads: usize, f: impl FnOnce(Option<&ThreadPool>) -> R) -> R {
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
                .stack_size(STACK)
                .num_threads(threads)
                .thread_name(|i| format!("pbrfit-{i}"))
                .build()
                .ok()
                .map(|pool| Owned {
                    process: here,
                    pool,
                });
        }
        f(slot.as_ref().map(|owned| &owned.pool))
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
