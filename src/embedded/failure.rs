//! How a command fails inside another program.

use crate::exit::{Failure, code_of};

/// A failure with what scripts know it by.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CommandFailure {
    /// The exit code that the command line would end with.
    pub exit_code: u8,
    /// What went wrong, and what to try.
    pub message: String,
    /// Unusable files, each with the reason.
    pub problems: Vec<(String, String)>,
}

impl CommandFailure {
    /// Exit code of wrong usage.
    pub const USAGE: u8 = 2;
    /// Exit code of input that cannot be used.
    pub const INPUT: u8 = 3;
    /// Exit code of a stop that was asked for.
    pub const INTERRUPTED: u8 = 130;
    /// Exit code of a defect.
    pub const PANICKED: u8 = 101;

    /// A failure without files.
    pub fn new(exit_code: u8, message: impl Into<String>) -> Self {
        Self {
            exit_code,
            message: message.into(),
            problems: Vec::new(),
        }
    }

    /// The caller asks for something that does not exist.
    pub fn usage(message: impl Into<String>) -> Self {
        Self::new(Self::USAGE, message)
    }
}

impl std::fmt::Display for CommandFailure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for CommandFailure {}

impl From<anyhow::Error> for CommandFailure {
    fn from(error: anyhow::Error) -> Self {
        let failure = error.chain().find_map(|e| e.downcast_ref::<Failure>());
        let problems = failure.map(Failure::problems).unwrap_or_default();
        Self {
            exit_code: code_of(&error),
            message: format!("{error:#}"),
            problems: problems
                .iter()
                .map(|problem| (problem.file.display().to_string(), problem.reason.clone()))
                .collect(),
        }
    }
}

impl From<clap::Error> for CommandFailure {
    fn from(error: clap::Error) -> Self {
        let text = error.to_string();
        // How to call the command line is no news to who calls a function.
        let text = text.split("\n\nUsage:").next().unwrap_or_default();
        let text = text.split("\n\nFor more information").next();
        let text = text.unwrap_or_default().trim();
        Self::usage(text.strip_prefix("error: ").unwrap_or(text))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::Cli;
    use clap::Parser;

    #[test]
    fn wrong_usage_is_told_without_the_way_to_the_help() {
        let error = Cli::try_parse_from(["rilievo", "synth", "--views=few", "out"]).unwrap_err();
        let failure = CommandFailure::from(error);
        assert_eq!(failure.exit_code, 2);
        assert!(
            failure.message.starts_with("invalid value 'few'")
                && !failure.message.contains("Usage")
                && !failure.message.contains("--help"),
            "{failure}"
        );
    }

    #[test]
    fn unusable_files_are_named() {
        let failure = CommandFailure::from(anyhow::Error::from(Failure::input("a.jpg", "empty")));
        assert_eq!(failure.exit_code, CommandFailure::INPUT);
        let problem = ("a.jpg".to_owned(), "empty".to_owned());
        assert_eq!(failure.problems, [problem]);
    }
}
