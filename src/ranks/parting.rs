//! With what ranks part, and which failure the run ends with where several fail.

use crate::exit::{Failure, Problem, code_of};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// How long a rank that failed waits for the others to come to their next gathering, before it has MPI end them: ten
/// seconds after a failure nothing of the run shall be left.
pub const PATIENCE: Duration = Duration::from_secs(5);

/// The failure of a rank, as it is sent to the others.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Parting {
    /// Exit code.
    pub code: u8,
    /// What went wrong.
    pub text: String,
    /// Files that cannot be used, with the reasons.
    problems: Vec<(String, String)>,
    /// The item of divided work that failed.
    item: Option<u64>,
}

impl Parting {
    /// Of an error, and of the item of divided work that it belongs to.
    pub fn of(error: &anyhow::Error, item: Option<usize>) -> Self {
        let problems = error
            .downcast_ref::<Failure>()
            .map_or(&[][..], |failure| failure.problems());
        Self {
            code: code_of(error),
            text: format!("{error:#}"),
            problems: problems
                .iter()
                .map(|problem| (problem.file.display().to_string(), problem.reason.clone()))
                .collect(),
            item: item.map(|item| item as u64),
        }
    }

    /// Of a rank whose word cannot be understood.
    pub fn unknown() -> Self {
        Self {
            code: 1,
            text: "failed, and its reason did not arrive".to_owned(),
            problems: Vec::new(),
            item: None,
        }
    }

    /// An error like the one that it was made of, in every rank; `place` names the rank where not all failed alike.
    pub fn into_error(self, place: Option<&str>) -> anyhow::Error {
        let at = |text: String| match place {
            Some(place) => format!("{place}: {text}"),
            None => text,
        };
        match self.code {
            2 => Failure::Usage(at(self.text)).into(),
            3 => {
                let problems = self.problems.into_iter().map(|(file, reason)| Problem {
                    file: file.into(),
                    reason: at(reason),
                });
                Failure::Input(problems.collect()).into()
            }
            4 => Failure::NoResult(at(self.text)).into(),
            5 => Failure::RunDirectory(at(self.text)).into(),
            6 => Failure::ReadOrWrite(at(self.text)).into(),
            130 => Failure::Interrupted.into(),
            _ => anyhow::anyhow!(at(self.text)),
        }
    }
}

/// The rank whose failure the run ends with: that of the lowest item, else the first rank; a failure before an
/// interruption, which may be its consequence.
pub fn decisive(partings: &[Option<Parting>]) -> Option<(usize, &Parting)> {
    let failed = partings.iter().enumerate();
    let failed = failed.filter_map(|(rank, parting)| Some((rank, parting.as_ref()?)));
    failed.min_by_key(|(rank, parting)| {
        let item = parting.item.unwrap_or(u64::MAX);
        (parting.code == 130, item, *rank)
    })
}

/// Whether all ranks failed in the same way, as where none has anything of its own to do with it.
pub fn is_common(partings: &[Option<Parting>]) -> bool {
    partings.windows(2).all(|two| two[0] == two[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn failed(error: impl Into<anyhow::Error>, item: Option<usize>) -> Option<Parting> {
        Some(Parting::of(&error.into(), item))
    }

    #[test]
    fn the_lowest_item_decides_and_an_interruption_last() {
        let disk = || Failure::ReadOrWrite("full".to_owned());
        let partings = [
            None,
            failed(disk(), Some(4)),
            failed(Failure::NoResult("none".to_owned()), Some(3)),
            failed(Failure::Interrupted, Some(0)),
        ];
        let (rank, parting) = decisive(&partings).unwrap();
        assert_eq!((rank, parting.code), (2, 4));
        assert!(!is_common(&partings));
        assert!(is_common(&[failed(disk(), None), failed(disk(), None)]));
        assert_eq!(decisive(&[None, None]), None);
    }

    #[test]
    fn an_error_keeps_its_code_and_names_rank_and_file() {
        let place = Some("rank 1 on node7");
        for error in [
            Failure::Usage("a".to_owned()).into(),
            Failure::input("a.jpg", "is not there").into(),
            Failure::NoResult("a".to_owned()).into(),
            Failure::RunDirectory("a".to_owned()).into(),
            anyhow::Error::new(std::io::Error::other("full")).context("writing"),
            Failure::Interrupted.into(),
            anyhow::anyhow!("surprise"),
        ] {
            let again = Parting::of(&error, None).into_error(place);
            assert_eq!(code_of(&again), code_of(&error));
            let told = again.to_string();
            assert!(
                told.contains("rank 1 on node7") || code_of(&error) == 130,
                "{told}"
            );
        }
        let input = Failure::input("a.jpg", "is not there").into();
        let told = Parting::of(&input, None).into_error(place).to_string();
        assert!(
            told.contains("a.jpg: rank 1 on node7: is not there"),
            "{told}"
        );
    }
}
