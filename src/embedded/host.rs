//! What a command needs of the process that it runs in: threads, news, a way to be stopped.

use super::failure::CommandFailure;
use crate::observe::{Console, JsonSink};
use crate::{panics, raw_child};
use serde_json::Value;
use std::ffi::OsString;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Once};

/// Stack of a command's threads, bytes: that of a program's main thread, in which commands run
/// otherwise.
const STACK: usize = 8 << 20;

/// Asks commands to stop: soon, leaving nothing half done.
#[derive(Clone, Debug, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// Asks; harmless when done twice.
    pub fn ask(&self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// What a command has to show.
#[derive(Clone, Debug, PartialEq)]
pub enum News {
    /// An event, as `--json` prints it.
    Event(Value),
    /// A sentence for people.
    Note(String),
}

/// Takes news, from whatever thread.
pub type NewsSink = Box<dyn FnMut(News) + Send>;

struct Sink(NewsSink);

impl JsonSink for Sink {
    fn event(&mut self, event: &Value) {
        (self.0)(News::Event(event.clone()));
    }

    fn note(&mut self, message: &str) {
        (self.0)(News::Note(message.to_owned()));
    }
}

/// The console of a command.
pub(super) fn console(stop: &Stop, news: NewsSink) -> Console {
    Console::embedded(Sink(news), Arc::clone(&stop.0))
}

/// Runs work whose panic is a failure.
pub(super) fn guarded<T>(
    work: impl FnOnce() -> Result<T, CommandFailure>,
) -> Result<T, CommandFailure> {
    static INSTALL: Once = Once::new();
    // The hook of this library, whose copy of the standard library a program in another language
    // does not share.
    INSTALL.call_once(panics::install);
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let what = panic
            .downcast_ref::<String>()
            .map(String::as_str)
            .or_else(|| panic.downcast_ref::<&str>().copied())
            .unwrap_or("a panic");
        Err(CommandFailure::new(
            CommandFailure::PANICKED,
            format!("internal error: {what}; this is a defect, please report it"),
        ))
    })
}

/// Runs work on threads of its own; without a number on as many as there are cores.
pub(super) fn in_own_threads<T: Send>(
    number: Option<u16>,
    work: impl FnOnce() -> Result<T, CommandFailure> + Send,
) -> Result<T, CommandFailure> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(number.map_or(0, usize::from))
        .stack_size(STACK)
        .build()
        .map_err(|error| {
            let message = format!("cannot start the threads ({error}); try one thread");
            CommandFailure::new(1, message)
        })?;
    pool.install(work)
}

/// Has camera RAW files decoded by another process, as the command line does: `program` with its
/// arguments, to which a file's name is added, has to call [`decode_raw`]. Without it they are
/// decoded in this process, which a damaged file can then end. Once, before the first command.
pub fn decode_raw_with(program: Vec<OsString>) {
    raw_child::set_child(program);
    rilievo_io::set_raw_decoder(raw_child::decode);
}

/// Decodes the RAW file on stdin to stdout, and returns the exit code that the process must end
/// with. It bounds the process's memory and time: only a process that does nothing else may call
/// it.
pub fn decode_raw(name: &Path) -> u8 {
    catch_unwind(|| raw_child::serve(name)).unwrap_or(CommandFailure::PANICKED)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_on_a_thread_of_the_work_is_a_failure() {
        let failed: Result<(), _> = guarded(|| in_own_threads(Some(2), || panic!("number {}", 7)));
        let failure = failed.unwrap_err();
        assert_eq!(failure.exit_code, CommandFailure::PANICKED);
        assert!(failure.message.contains("number 7"), "{failure}");
    }
}
