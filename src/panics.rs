//! What is printed when the program panics: one sentence that says what to do, and nothing where a
//! decoder's panic becomes the refusal of a file.

use crate::output::to_stderr_of_any_rank;
use crate::ranks;
use rilievo_io::decoder_is_guarded;
use std::panic::PanicHookInfo;

/// Takes the place of the standard library's message; the exit code stays 101.
pub fn install() {
    std::panic::set_hook(Box::new(|info| {
        if !decoder_is_guarded() {
            match ranks::name() {
                Some(rank) => to_stderr_of_any_rank(format_args!("{rank}: {}", sentence(info))),
                None => tell!("{}", sentence(info)),
            }
        }
    }));
}

fn sentence(info: &PanicHookInfo<'_>) -> String {
    let what = info.payload_as_str().unwrap_or("a panic");
    let place = info.location().map_or_else(String::new, |place| {
        format!(" at {}:{}", place.file(), place.line())
    });
    format!("internal error: {what}{place}; this is a defect, please report it").replace('\n', " ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::{Arc, Mutex};

    #[test]
    fn a_panic_is_one_sentence_with_its_place() {
        let told = Arc::new(Mutex::new(String::new()));
        let listener = Arc::clone(&told);
        let before = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            if let Ok(mut told) = listener.lock() {
                *told = sentence(info);
            }
        }));
        let number = 7;
        let panicked = std::panic::catch_unwind(|| panic!("number {number}"));
        std::panic::set_hook(before);
        assert!(panicked.is_err());
        let told = told.lock().unwrap();
        assert!(
            told.starts_with("internal error: number 7 at src/panics.rs:")
                && told.ends_with("please report it")
                && told.lines().count() == 1,
            "{told}"
        );
    }
}
