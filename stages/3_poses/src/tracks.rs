//! Tracks: keypoints of several photos that show the same point.
//!
//! Matches join keypoints, the pairs with most verified matches first, but never so that a track
//! would hold two places of one photo: one wrong match would otherwise fuse two true tracks and
//! lose both. Keypoints at the same place with different orientations count as one.
//!
//! A match `a–b` of two photos is tested by every third photo that both are matched with: the loop
//! closes when `a` and `b` have the same partner there, and breaks otherwise. Matches that more loops
//! break than close are left out. That is what repeated texture does: a pair of photos may agree on
//! the twin of every point, but not with the photos between them (loop constraints: Zach, Klopschitz,
//! Pollefeys, CVPR 2010).

use rilievo_scene::{FeatureMatches, PhotoKeypoints};

/// One sighting of a track.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct TrackSighting {
    pub photo: usize,
    /// Keypoint in it.
    pub keypoint: u32,
}

/// For each keypoint the first one at the same place.
fn same_place(photo: &PhotoKeypoints) -> Vec<u32> {
    let key = |k: u32| {
        let keypoint = &photo.keypoints[k as usize];
        (keypoint.y.to_bits(), keypoint.x.to_bits())
    };
    let mut order: Vec<u32> = (0..photo.keypoints.len() as u32).collect();
    order.sort_by_key(|&k| (key(k), k));
    let mut first = vec![0; order.len()];
    let mut leader = 0;
    for (position, &k) in order.iter().enumerate() {
        if position == 0 || key(order[position - 1]) != key(k) {
            leader = k;
        }
        first[k as usize] = leader;
    }
    first
}

/// Forest of keypoints in which a tree knows the photos it touches.
struct Forest {
    parent: Vec<usize>,
    /// Sightings of the tree at its root, ordered by photo.
    members: Vec<Vec<TrackSighting>>,
}

impl Forest {
    fn root(&mut self, mut node: usize) -> usize {
        while self.parent[node] != node {
            self.parent[node] = self.parent[self.parent[node]];
            node = self.parent[node];
        }
        node
    }

    /// Joins two trees unless that would put two places of one photo into one track.
    fn join(&mut self, a: usize, b: usize) {
        let (mut a, mut b) = (self.root(a), self.root(b));
        if a == b {
            return;
        }
        if self.members[a].len() < self.members[b].len() {
            std::mem::swap(&mut a, &mut b);
        }
        let clash = self.members[b]
            .iter()
            .any(|s| self.members[a].iter().any(|t| t.photo == s.photo));
        if clash {
            return;
        }
        let moved = std::mem::take(&mut self.members[b]);
        self.members[a].extend(moved);
        self.parent[b] = a;
    }
}

/// One end of a match.
#[derive(Clone, Copy)]
struct End {
    photo: usize,
    /// Place among all keypoints.
    node: usize,
}

type Link = [End; 2];

/// Broken loops beyond the closed ones that a match may have.
const MAX_EXCESS_BROKEN: usize = 1;

/// The links that loops do not contradict, in their order.
fn believed(links: &[Link], num_nodes: usize) -> Vec<Link> {
    let mut partners: Vec<Vec<End>> = vec![Vec::new(); num_nodes];
    for &[a, b] in links {
        partners[a.node].push(b);
        partners[b.node].push(a);
    }
    let votes = |[a, b]: &Link| {
        let (mut closed, mut broken) = (0, 0);
        let (mine, theirs) = (&partners[a.node], &partners[b.node]);
        for third in mine.iter().filter(|p| p.photo != b.photo) {
            let mut there = theirs.iter().filter(|p| p.photo == third.photo).peekable();
            if there.peek().is_none() {
                continue;
            }
            if there.any(|p| p.node == third.node) {
                closed += 1;
            } else {
                broken += 1;
            }
        }
        (closed, broken)
    };
    links
        .iter()
        .filter(|link| {
            let (closed, broken) = votes(link);
            broken <= closed + MAX_EXCESS_BROKEN
        })
        .copied()
        .collect()
}

/// Tracks with at least two sightings, each ordered by photo.
pub(crate) fn build(matches: &FeatureMatches) -> Vec<Vec<TrackSighting>> {
    let places: Vec<Vec<u32>> = matches.photos.iter().map(same_place).collect();
    let mut start = vec![0];
    for photo in &matches.photos {
        start.push(start[start.len() - 1] + photo.keypoints.len());
    }
    let total = start[matches.photos.len()];
    let mut forest = Forest {
        parent: (0..total).collect(),
        members: Vec::with_capacity(total),
    };
    for (photo, list) in matches.photos.iter().enumerate() {
        forest
            .members
            .extend((0..list.keypoints.len()).map(|keypoint| {
                vec![TrackSighting {
                    photo,
                    keypoint: keypoint as u32,
                }]
            }));
    }
    let mut order: Vec<usize> = (0..matches.pairs.len()).collect();
    order.sort_by_key(|&k| (std::cmp::Reverse(matches.pairs[k].matches.len()), k));
    let links: Vec<Link> = order
        .into_iter()
        .flat_map(|k| {
            let pair = &matches.pairs[k];
            let end = |photo: usize, keypoint: u32| End {
                photo,
                node: start[photo] + places[photo][keypoint as usize] as usize,
            };
            let (first, second) = (pair.first.0, pair.second.0);
            pair.matches
                .iter()
                .map(move |&[i, j]| [end(first, i), end(second, j)])
                .collect::<Vec<_>>()
        })
        .collect();
    for [a, b] in believed(&links, total) {
        forest.join(a.node, b.node);
    }
    forest
        .members
        .into_iter()
        .filter(|m| m.len() >= 2)
        .map(|mut m| {
            m.sort_unstable();
            m
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::{Keypoint, PairMatches, PhotoIdx};

    fn photo(num: usize) -> PhotoKeypoints {
        PhotoKeypoints {
            keypoints: (0..num)
                .map(|k| Keypoint {
                    x: k as f32,
                    y: 0.0,
                    size_px: 2.0,
                    angle_rad: 0.0,
                    response: 1.0,
                    bright: true,
                    on_object: true,
                })
                .collect(),
            descriptors: Vec::new(),
        }
    }

    fn pair(first: usize, second: usize, matches: &[[u32; 2]]) -> PairMatches {
        PairMatches {
            first: PhotoIdx(first),
            second: PhotoIdx(second),
            matches: matches.to_vec(),
            essential: None,
            homography_share: 0.0,
            num_putative: matches.len(),
            standing: Vec::new(),
        }
    }

    #[test]
    fn a_wrong_match_does_not_fuse_two_tracks() {
        let matches = FeatureMatches {
            photos: vec![photo(3), photo(3), photo(3)],
            pairs: vec![
                pair(0, 1, &[[0, 0], [1, 1], [2, 2]]),
                pair(0, 2, &[[0, 0], [1, 1]]),
                pair(1, 2, &[[0, 1]]),
            ],
        };
        let tracks = build(&matches);
        let sizes: Vec<usize> = tracks.iter().map(Vec::len).collect();
        assert_eq!(sizes, [3, 3, 2]);
        assert!(tracks[0].iter().all(|s| s.keypoint == 0));
    }

    #[test]
    fn a_match_that_two_loops_break_is_left_out() {
        // Keypoint 0 of photo 0 is taken for 1 in photo 3; photos 1 and 2 know better.
        let right = [[0, 0], [1, 1]];
        let matches = FeatureMatches {
            photos: vec![photo(2), photo(2), photo(2), photo(2)],
            pairs: vec![
                pair(0, 3, &[[0, 1], [1, 0]]),
                pair(0, 1, &right),
                pair(0, 2, &right),
                pair(1, 2, &right),
                pair(1, 3, &right),
                pair(2, 3, &right),
            ],
        };
        let tracks = build(&matches);
        let sizes: Vec<usize> = tracks.iter().map(Vec::len).collect();
        assert_eq!(sizes, [4, 4], "{tracks:?}");
        for (k, track) in tracks.iter().enumerate() {
            assert!(track.iter().all(|s| s.keypoint == k as u32), "{tracks:?}");
        }
    }
}
