//! Ctrl-C and termination signals: the first asks for a resumable stop, the second aborts.

use std::sync::Once;
use std::sync::atomic::{AtomicBool, Ordering};

static STOP: AtomicBool = AtomicBool::new(false);
static INSTALL: Once = Once::new();

/// Starts listening; harmless when called twice.
pub fn listen() {
    INSTALL.call_once(|| {
        let installed = ctrlc::set_handler(|| {
            if STOP.swap(true, Ordering::SeqCst) {
                std::process::exit(130);
            }
            tell!("stopping; once more aborts at once");
        });
        if let Err(error) = installed {
            // Without a handler the system's default ends the program, which is resumable too.
            tell!("warning: Ctrl-C cannot be caught: {error}");
        }
    });
}

/// Whether the user asked to stop.
pub fn requested() -> bool {
    STOP.load(Ordering::Relaxed)
}
