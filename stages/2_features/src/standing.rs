//! Matches that stand still in the frame while others move: captions, time stamps, dust on the sensor, hot pixels, and
//! the background of an object that turns.
//!
//! They obey a two-view geometry of their own, without any motion, and are often more than the object's. Motions of a
//! scene are spread: between one and three times the motion that passes for none there are eight times as many matches
//! as below it, where motions are spread evenly around none. What stands still makes a peak there instead. Where the
//! rest of a pair then agrees on a geometry, the peak is no part of the scene; where it does not, as in two photos of
//! one view, all matches count.

use rilievo_scene::{PairMatches, PhotoKeypoints};

/// Motion over the largest that passes for none up to which a match is taken for one that stands still, once the pair
/// has such: the keypoints of larger blobs are found less exactly.
const NEAR: f64 = 3.0;

/// Whether a match may stand still.
pub(crate) fn is_near(motion: f64) -> bool {
    motion < NEAR
}

/// Whether motions have a peak at none.
pub(crate) fn have_peak(motions: impl Iterator<Item = f64>) -> bool {
    let (mut num_still, mut num_near) = (0_usize, 0_usize);
    for motion in motions {
        num_still += usize::from(motion < 1.0);
        num_near += usize::from((1.0..NEAR).contains(&motion));
    }
    // Three standard deviations more than as many, so that few do not by chance.
    num_still as f64 > num_near as f64 + 3.0 * ((num_near + 1) as f64).sqrt()
}

/// Keypoints, per photo, of matches that stand still while others of their pair move.
pub(crate) struct StandingKeypoints {
    are_standing: Vec<Vec<bool>>,
    /// Matches.
    pub num: usize,
}

impl StandingKeypoints {
    pub fn of(pairs: &[PairMatches], keypoints: &[PhotoKeypoints]) -> Self {
        let none = keypoints.iter().map(|k| vec![false; k.keypoints.len()]);
        let mut are_standing: Vec<Vec<bool>> = none.collect();
        for pair in pairs {
            for &[i, j] in &pair.standing {
                are_standing[pair.first.0][i as usize] = true;
                are_standing[pair.second.0][j as usize] = true;
            }
        }
        Self {
            are_standing,
            num: pairs.iter().map(|pair| pair.standing.len()).sum(),
        }
    }

    /// Whether one end of a match of two photos is among them.
    pub fn has(&self, [first, second]: [usize; 2], [i, j]: [u32; 2]) -> bool {
        self.are_standing[first][i as usize] || self.are_standing[second][j as usize]
    }
}
