//! An end that does not wait: what unfinished work left on disk is taken away, and the process ends.
//!
//! A signal interrupts Python between two of its instructions. A long call into a library comes
//! first, and where that keeps the interpreter lock no other Python thread can act either. So a
//! thread of ours waits for signals, gives the interpreter a while to unwind, and then does what
//! unwinding would have done. It knows from a list of what is unfinished what to take away.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// What is on disk while something is being made.
#[derive(Clone, Debug, Default)]
pub struct Unfinished {
    /// File or folder that goes away.
    pub temporary: PathBuf,
    /// Something that was set aside, and what it was called: it gets its name back if nothing new
    /// has taken that, and goes away otherwise.
    pub aside: Option<(PathBuf, PathBuf)>,
    /// Folders that were made for it, the deepest first; those that are empty go away.
    pub parents: Vec<PathBuf>,
}

#[derive(Default)]
struct State {
    unfinished: BTreeMap<u64, Unfinished>,
    next: u64,
    /// How many threads must not be stopped just now.
    holding: usize,
    /// Nobody comes past this module any more.
    ending: bool,
    /// Somebody has told the user.
    told: bool,
}

static STATE: Mutex<State> = Mutex::new(State {
    unfinished: BTreeMap::new(),
    next: 0,
    holding: 0,
    ending: false,
    told: false,
});
static CHANGED: Condvar = Condvar::new();

/// How long a thread that asked not to be stopped is waited for: two renames take less.
const HOLDING: Duration = Duration::from_millis(250);

/// Notes something unfinished, before it is made; the number is for `finished`.
pub fn unfinished(what: Unfinished) -> u64 {
    let mut state = passed();
    state.next += 1;
    let number = state.next;
    state.unfinished.insert(number, what);
    number
}

/// Nothing is left of it to be taken away.
pub fn finished(number: u64) {
    passed().unfinished.remove(&number);
}

/// From here on the process is not ended, for the blink of an eye; `allow_end` has to follow.
pub fn hold_end() {
    passed().holding += 1;
}

/// See `hold_end`.
pub fn allow_end() {
    let mut state = lock();
    state.holding = state.holding.saturating_sub(1);
    CHANGED.notify_all();
}

/// Whether the caller may tell the user why the process ends; true once.
pub fn last_word() -> bool {
    !std::mem::replace(&mut passed().told, true)
}

/// The state, unless the process is ending: then the caller waits here for its end. It must not go
/// on and end the process while its leftovers are still being taken away.
fn passed() -> MutexGuard<'static, State> {
    let mut state = lock();
    while state.ending {
        state = CHANGED.wait(state).unwrap_or_else(PoisonError::into_inner);
    }
    state
}

/// Nothing that may panic is done under the lock, so a poisoned one is as good as any.
fn lock() -> MutexGuard<'static, State> {
    STATE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Take away what is unfinished. Those who hold up the end are waited for, but not for long.
fn tidy() -> MutexGuard<'static, State> {
    let mut state = lock();
    state.ending = true;
    let held = |state: &mut State| state.holding > 0;
    let (state, _) = CHANGED
        .wait_timeout_while(state, HOLDING, held)
        .unwrap_or_else(PoisonError::into_inner);
    let all: Vec<_> = state.unfinished.values().rev().collect();
    for what in &all {
        take_away(what);
    }
    for what in all {
        remove(&what.temporary); // whoever was about to open a file there has done so by now
    }
    state
}

fn take_away(what: &Unfinished) {
    // Out of the way first: who writes into it by its name finds it no more.
    let mut name = what.temporary.clone().into_os_string();
    name.push("-ended");
    let moved = PathBuf::from(name);
    if what.temporary.is_dir() && fs::rename(&what.temporary, &moved).is_ok() {
        remove(&moved);
    } else {
        remove(&what.temporary);
    }
    if let Some((aside, target)) = &what.aside
        && aside.symlink_metadata().is_ok()
        && (target.symlink_metadata().is_ok() || fs::rename(aside, target).is_err())
    {
        remove_if_replaced(aside, target);
    }
    for parent in &what.parents {
        let _ = fs::remove_dir(parent); // one that is not empty stays
    }
}

/// What was set aside stays where it is when its name is free and it could not get it back.
fn remove_if_replaced(aside: &Path, target: &Path) {
    if target.symlink_metadata().is_ok() {
        remove(aside);
    }
}

/// A file or a folder with all in it. Errors are nobody's any more.
fn remove(path: &Path) {
    for _ in 0..10 {
        let removed = match path.symlink_metadata() {
            Err(_) => return,
            Ok(found) if found.is_dir() => fs::remove_dir_all(path),
            Ok(_) => fs::remove_file(path),
        };
        if removed.is_ok() {
            return; // else something new may have come into the folder
        }
    }
}

#[cfg(all(unix, feature = "python"))]
pub use watch::watch;

#[cfg(all(unix, feature = "python"))]
mod watch {
    use std::io::{self, ErrorKind, IsTerminal, Read, Write};
    use std::os::fd::AsRawFd;
    use std::os::unix::net::UnixStream;
    use std::thread;
    use std::time::{Duration, Instant};

    /// From here on the process ends `grace` after it was told to by one of `ending`, and at once
    /// when told twice, whatever its other threads do.
    ///
    /// Returns the number of a file that wants a byte for every signal, with its number. `word` is
    /// said if nobody else has had the last one.
    pub fn watch(grace: Duration, word: String, ending: Vec<i32>) -> io::Result<i32> {
        let (signals, ours) = UnixStream::pair()?;
        signals.set_nonblocking(true)?; // a handler must not wait
        let number = signals.as_raw_fd();
        thread::Builder::new()
            .name("pbrfit-ending".into())
            .spawn(move || {
                let _open = signals;
                if let Some(first) = told(&ours, &ending, None) {
                    told(&ours, &ending, Some(Instant::now() + grace));
                    end(first, &word);
                }
            })?;
        Ok(number)
    }

    /// The next signal that ends a process; None after the deadline.
    fn told(mut ours: &UnixStream, ending: &[i32], deadline: Option<Instant>) -> Option<i32> {
        let mut byte = [0];
        loop {
            let left = deadline.map(|deadline| deadline.saturating_duration_since(Instant::now()));
            if left == Some(Duration::ZERO) || ours.set_read_timeout(left).is_err() {
                return None;
            }
            match ours.read(&mut byte) {
                Ok(1) if ending.contains(&byte[0].into()) => {
                    return Some(byte[0].into());
                }
                Ok(0) => return None,
                Ok(_) => (),
                Err(error) => match error.kind() {
                    ErrorKind::Interrupted | ErrorKind::WouldBlock | ErrorKind::TimedOut => (),
                    _ => return None,
                },
            }
        }
    }

    fn end(signal: i32, word: &str) -> ! {
        let state = super::tidy();
        if !state.told {
            let mut stderr = io::stderr().lock();
            // On a terminal a progress bar may be in the line, and what Ctrl-C looks like.
            let first = if stderr.is_terminal() { "\n" } else { "" };
            let _ = writeln!(stderr, "{first}{word}");
        }
        // Without what libraries want done at the end: they would wait for threads at work.
        signal_hook::low_level::exit(128 + signal)
    }
}
