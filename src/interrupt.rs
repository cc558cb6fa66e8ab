//! What the system may interrupt the program with: Ctrl-C and termination signals, of which the first
//! asks for a resumable stop and the second aborts; limits on files and memory.
//!
//! A stop waits for the work at hand. In a run directory it waits some seconds at most: every file there is complete or
//! not there, so that the same command goes on wherever it ended.

use crate::exit::Failure;
use signal_hook::consts::signal::{SIGABRT, SIGHUP, SIGINT, SIGTERM, SIGXFSZ};
use signal_hook::iterator::Signals;
use signal_hook::low_level;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Once};
use std::thread::Builder;
use std::time::Duration;

static STOP: AtomicBool = AtomicBool::new(false);
static INSTALL: Once = Once::new();

/// Seconds after which work that was asked to stop is ended where it is; 0 for work that cannot be resumed from anywhere.
static PATIENCE: AtomicU64 = AtomicU64::new(0);

/// Time for the last sentence, which nobody may read.
const LAST_WORD: Duration = Duration::from_millis(200);

/// What is said where the program aborts: the standard library does when memory is refused.
const ABORTED: &[u8] =
    b"error: the system refused memory, or a library gave up; stages that are done \
are kept. Give the program more memory, or ask for less: smaller photos, --memory, --threads 1\n";

/// Starts listening; harmless when called twice.
pub fn listen() {
    INSTALL.call_once(|| {
        let listening = Signals::new([SIGINT, SIGTERM, SIGHUP]).and_then(|mut signals| {
            Builder::new().spawn(move || signals.forever().for_each(|_| stop()))
        });
        if let Err(error) = listening {
            // Without a handler the system's default ends the program, which is resumable too.
            tell!("warning: Ctrl-C cannot be caught: {error}");
        }
        // A file that grows over a limit then fails to be written, with its name, as on a full disk.
        let limit = signal_hook::flag::register(SIGXFSZ, Arc::new(AtomicBool::new(false)));
        let abort = on_abort();
        for error in [limit.err(), abort.err()].into_iter().flatten() {
            tell!("warning: signals cannot be caught: {error}");
        }
    });
}

/// Asks the work at hand to stop; asked once more, ends the program.
fn stop() {
    if STOP.swap(true, Ordering::SeqCst) {
        end();
    }
    // Where no thread can be had, the work at hand is waited for.
    let _ = Builder::new().spawn(end_in_time);
    tell!("stopping; once more aborts at once");
}

/// Says that the work from here on can be resumed wherever it ends. Where it stops with `others`,
/// the processes inform each other first.
pub fn is_resumable(others: bool) {
    PATIENCE.store(if others { 8 } else { 4 }, Ordering::Relaxed);
}

/// Waits for the work at hand, and ends it where it takes too long and can be resumed.
fn end_in_time() {
    let patience = PATIENCE.load(Ordering::Relaxed);
    if patience == 0 {
        return;
    }
    std::thread::sleep(Duration::from_secs(patience));
    // Whoever should read it may have stopped to.
    let _ = Builder::new().spawn(|| tell!("error: {}", Failure::Interrupted));
    std::thread::sleep(LAST_WORD);
    end()
}

/// Ends the program as a stop does.
fn end() -> ! {
    low_level::exit(Failure::Interrupted.code().into())
}

/// Ends an abort with a sentence and exit code 1 instead of a signal.
fn on_abort() -> std::io::Result<()> {
    let end = || {
        // Nothing can be done where stderr is closed.
        let _ = rustix::io::write(rustix::stdio::stderr(), ABORTED);
        low_level::exit(1);
    };
    // SAFETY: the handler calls only write(2) and _exit(2), which are async-signal-safe.
    #[allow(unsafe_code)]
    let registered = unsafe { low_level::register(SIGABRT, end) };
    registered.map(|_| ())
}

/// Whether the user asked to stop.
pub fn requested() -> bool {
    STOP.load(Ordering::Relaxed)
}
