//! What the system may interrupt the program with: Ctrl-C and termination signals, of which the first
//! asks for a resumable stop and the second aborts; limits on files and memory.
//!
//! A stop waits for the work at hand, some seconds at most. After them the program ends where it is: every file is
//! complete or not there, so that the same command goes on from there too.

use crate::exit::Failure;
use signal_hook::consts::signal::{SIGABRT, SIGXFSZ};
use signal_hook::low_level;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Once};
use std::thread::Builder;
use std::time::Duration;

static STOP: AtomicBool = AtomicBool::new(false);
static INSTALL: Once = Once::new();

/// Time that the work at hand has to come to an end.
const PATIENCE: Duration = Duration::from_secs(4);

/// What is said where the program aborts: the standard library does when memory is refused.
const ABORTED: &[u8] =
    b"error: the system refused memory, or a library gave up; stages that are done \
are kept. Give the program more memory, or ask for less: smaller photos, --memory, --threads 1\n";

/// Starts listening; harmless when called twice.
pub fn listen() {
    INSTALL.call_once(|| {
        let installed = ctrlc::set_handler(|| {
            if STOP.swap(true, Ordering::SeqCst) {
                end();
            }
            tell!("stopping; once more aborts at once");
            // Where no thread can be had, the work at hand is waited for.
            let _ = Builder::new().spawn(|| -> () {
                std::thread::sleep(PATIENCE);
                tell!("{}", Failure::Interrupted);
                end();
            });
        });
        if let Err(error) = installed {
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
