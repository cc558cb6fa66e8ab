//! How many threads a rank starts where several ranks share a host.

use serde::{Deserialize, Serialize};
use std::num::NonZeroUsize;

/// Where a rank runs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Place {
    pub host: String,
    /// Numbers of the processors that it may run on; launchers bind ranks to some, or to none.
    pub processors: Vec<u32>,
}

impl Place {
    /// This process's, on a host.
    pub fn of(host: String) -> Self {
        let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        let list = status
            .lines()
            .find_map(|line| line.strip_prefix("Cpus_allowed_list:"));
        Self {
            host,
            processors: list.map(processors).unwrap_or_default(),
        }
    }
}

/// Numbers in a list such as `0-3,8`.
fn processors(list: &str) -> Vec<u32> {
    let mut numbers = Vec::new();
    for part in list.trim().split(',') {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        if let (Ok(first), Ok(last)) = (first.parse::<u32>(), last.parse::<u32>()) {
            numbers.extend(first..=last);
        }
    }
    numbers
}

/// Threads of a rank: its share of the processors that it may use, each divided among the ranks of its host that may
/// use it too; one at least. `available` is what the system grants one process.
pub fn threads(places: &[Place], rank: usize, available: usize) -> NonZeroUsize {
    let share = places.get(rank).map_or(1.0, |own| {
        let beside = || places.iter().filter(|place| place.host == own.host);
        if own.processors.is_empty() {
            return available as f64 / beside().count().max(1) as f64;
        }
        let shares = own.processors.iter().map(|processor| {
            let users = beside().filter(|place| place.processors.contains(processor));
            1.0 / users.count().max(1) as f64
        });
        shares.sum::<f64>().min(available as f64)
    });
    // A third counted three times is a little less than one.
    NonZeroUsize::new((share + 1e-6).floor() as usize).unwrap_or(NonZeroUsize::MIN)
}

/// Ranks on the host of a rank, itself among them.
pub fn on_one_host(places: &[Place], rank: usize) -> usize {
    let own = places.get(rank).map(|place| &place.host);
    let beside = places.iter().filter(|place| Some(&place.host) == own);
    beside.count().max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_of_a_host_share_its_processors() {
        let place = |host: &str, list: &str| Place {
            host: host.to_owned(),
            processors: processors(list),
        };
        let of = |places: &[Place], rank, available| threads(places, rank, available).get();
        let unbound = [place("a", "0-7"), place("a", "0-7"), place("b", "0-3")];
        assert_eq!(of(&unbound, 0, 8), 4);
        assert_eq!(of(&unbound, 2, 4), 4);
        assert_eq!([0, 2].map(|rank| on_one_host(&unbound, rank)), [2, 1]);
        let bound = [place("a", "0-1,4"), place("a", "2-3")];
        assert_eq!(of(&bound, 0, 3), 3);
        assert_eq!(of(&bound, 1, 2), 2);
        let crowded = vec![place("a", "0"); 5];
        assert_eq!(of(&crowded, 4, 1), 1);
        let unknown = vec![place("a", ""); 2];
        assert_eq!(of(&unknown, 1, 6), 3);
    }
}
