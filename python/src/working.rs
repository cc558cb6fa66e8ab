//! Work beside the calling thread, which passes news on and answers signals meanwhile.

use crate::failures::raised;
use pyo3::prelude::*;
use rilievo::embedded::{CommandFailure, News, NewsSink, Stop};
use std::sync::Mutex;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::{self, Builder};
use std::time::{Duration, Instant};

/// How often signals are looked at where there is no news.
const PAUSE: Duration = Duration::from_millis(50);

const STOPPING: &str = "stopping as soon as the work at hand has ended; a run may also be killed, and goes on all the same";

/// After how long a stop that lasts is logged.
const PATIENCE: Duration = Duration::from_secs(2);

/// Does work without Python's lock. Meanwhile `on_news(kind, text)` gets `("event", JSON)`, `("note", sentence)` and
/// `("stopping", sentence)` in the calling thread, the only one in which Python answers signals and other libraries
/// take calls.
///
/// # Errors
/// What `on_news` or the handler of a signal raises; the work was then asked to stop and has ended. Else the exception
/// of the work's failure.
pub fn work<T: Send>(
    py: Python<'_>,
    on_news: &Bound<'_, PyAny>,
    command: impl FnOnce(&Stop, NewsSink) -> Result<T, CommandFailure> + Send,
) -> PyResult<T> {
    let stop = Stop::default();
    let (sender, receiver) = channel();
    let receiver = Mutex::new(receiver);
    thread::scope(|scope| {
        let stop_of_work = &stop;
        let worker = Builder::new()
            .name("rilievo".to_owned())
            .spawn_scoped(scope, move || command(stop_of_work, tell(sender)))
            .map_err(|error| {
                raised(
                    py,
                    &CommandFailure::new(1, format!("no thread can be had: {error}")),
                )
            })?;
        let mut exception = None;
        let mut told_at: Option<Instant> = None;
        while let Some(news) = py.detach(|| next(&receiver)) {
            // After the first exception the work's end is waited for, and further signals change nothing.
            let heard = news.map_or(Ok(()), |news| hear(on_news, news, exception.is_none()));
            if let Err(raised) = heard.and_then(|()| py.check_signals())
                && exception.is_none()
            {
                stop.ask();
                exception = Some(raised);
                told_at = Some(Instant::now() + PATIENCE);
            }
            if told_at.take_if(|at| *at <= Instant::now()).is_some() {
                // The exception at hand is raised whatever becomes of this.
                let _ = on_news.call1(("stopping", STOPPING));
            }
        }
        let outcome = py.detach(|| worker.join());
        match (exception, outcome) {
            (Some(exception), _) => Err(exception),
            (None, Ok(Ok(result))) => Ok(result),
            (None, Ok(Err(failure))) => Err(raised(py, &failure)),
            (None, Err(_)) => {
                let defect = "internal error: this is a defect, please report it";
                let failure = CommandFailure::new(CommandFailure::PANICKED, defect);
                Err(raised(py, &failure))
            }
        }
    })
}

fn tell(sender: Sender<News>) -> NewsSink {
    // Nobody hears it where the caller is gone.
    Box::new(move |news| drop(sender.send(news)))
}

/// The next news, nothing for a while, or the end.
fn next(receiver: &Mutex<Receiver<News>>) -> Option<Option<News>> {
    match receiver.lock().ok()?.recv_timeout(PAUSE) {
        Ok(news) => Some(Some(news)),
        Err(RecvTimeoutError::Timeout) => Some(None),
        Err(RecvTimeoutError::Disconnected) => None,
    }
}

fn hear(on_news: &Bound<'_, PyAny>, news: News, wanted: bool) -> PyResult<()> {
    if wanted {
        match news {
            News::Event(event) => on_news.call1(("event", event.to_string()))?,
            News::Note(note) => on_news.call1(("note", note))?,
        };
    }
    Ok(())
}
