//! One point, the most confident, in every cube of edge `spacing`.
//!
//! All points are stored out of core. The cubes are dealt out to as many passes as the memory asks
//! for; each goes through all points and sorts those of its cubes by cube, confidence and order.
//! What is first in its cube is marked, and in the end handed on in the order of all points.

use crate::error::FusionError;
use crate::memory;
use crate::options::FusionOptions;
use rilievo_scene::{CloudPoint, Room, Scratch, ScratchError};

/// Bytes of a point: position, normal, confidence, colour, views.
const RECORD: usize = 32;
/// Points that are written or read at once.
const NUM_AT_ONCE: usize = 1 << 15;

/// A point's cube, and what it is chosen by.
struct Entry {
    cube: [i64; 3],
    confidence: f32,
    idx: u64,
}

/// Takes all points, and hands on those that are kept.
pub(crate) struct Thinner {
    room: Box<dyn Room>,
    /// Points that are not stored yet.
    waiting: Vec<u8>,
    num_points: u64,
    spacing: f64,
    max_num_sorted: u64,
}

impl Thinner {
    pub fn new(scratch: &dyn Scratch, options: &FusionOptions) -> Result<Self, ScratchError> {
        Ok(Self {
            room: scratch.room()?,
            waiting: Vec::with_capacity(NUM_AT_ONCE * RECORD),
            num_points: 0,
            spacing: options.spacing,
            max_num_sorted: memory::max_num_sorted(options, size_of::<Entry>()) as u64,
        })
    }

    pub fn add(&mut self, points: &[CloudPoint]) -> Result<(), ScratchError> {
        for point in points {
            let floats = point.position.iter().chain(&point.normal);
            for value in floats.chain([&point.confidence]) {
                self.waiting.extend(value.to_le_bytes());
            }
            self.waiting.extend(point.color);
            self.waiting.push(point.num_views);
            self.num_points += 1;
            if self.waiting.len() == NUM_AT_ONCE * RECORD {
                self.store()?;
            }
        }
        Ok(())
    }

    fn store(&mut self) -> Result<(), ScratchError> {
        let end = self.num_points * RECORD as u64;
        self.room
            .write_at(&self.waiting, end - self.waiting.len() as u64)?;
        self.waiting.clear();
        Ok(())
    }

    /// Goes through all points in their order.
    fn visit(
        &self,
        mut each: impl FnMut(u64, &CloudPoint) -> Result<(), FusionError>,
    ) -> Result<(), FusionError> {
        let mut bytes = Vec::new();
        for first in (0..self.num_points).step_by(NUM_AT_ONCE) {
            let num = (self.num_points - first).min(NUM_AT_ONCE as u64);
            bytes.resize(num as usize * RECORD, 0);
            self.room.read_at(&mut bytes, first * RECORD as u64)?;
            for (i, record) in bytes.chunks_exact(RECORD).enumerate() {
                each(first + i as u64, &read(record))?;
            }
        }
        Ok(())
    }

    /// Hands on what is kept, in the order in which it came.
    pub fn finish(
        mut self,
        take: &mut dyn FnMut(&[CloudPoint]) -> Result<(), FusionError>,
    ) -> Result<(), FusionError> {
        self.store()?;
        let mut is_kept = vec![0_u8; self.num_points.div_ceil(8) as usize];
        let num_passes = self.num_points.div_ceil(self.max_num_sorted);
        let mut entries = Vec::new();
        for pass in 0..num_passes {
            entries.clear();
            self.visit(|idx, point| {
                let cube = point
                    .position
                    .map(|c| (f64::from(c) / self.spacing).floor() as i64);
                if dealt_to(cube, num_passes) == pass {
                    entries.push(Entry {
                        cube,
                        confidence: point.confidence,
                        idx,
                    });
                }
                Ok(())
            })?;
            entries.sort_unstable_by(|a, b| {
                a.cube
                    .cmp(&b.cube)
                    .then(b.confidence.total_cmp(&a.confidence))
                    .then(a.idx.cmp(&b.idx))
            });
            for cube in entries.chunk_by(|a, b| a.cube == b.cube) {
                let idx = cube[0].idx;
                is_kept[idx as usize / 8] |= 1 << (idx % 8);
            }
        }
        let mut kept = Vec::new();
        self.visit(|idx, point| {
            if is_kept[idx as usize / 8] >> (idx % 8) & 1 == 1 {
                kept.push(*point);
            }
            if kept.len() == NUM_AT_ONCE {
                take(&kept)?;
                kept.clear();
            }
            Ok(())
        })?;
        take(&kept)
    }
}

/// The pass of a cube.
fn dealt_to(cube: [i64; 3], num_passes: u64) -> u64 {
    let mixed = cube.iter().fold(0_u64, |mixed, &c| {
        (mixed ^ c as u64)
            .wrapping_mul(0x9e37_79b9_7f4a_7c15)
            .rotate_left(29)
    });
    mixed % num_passes
}

fn read(record: &[u8]) -> CloudPoint {
    let float = |k: usize| {
        let four = record.get(4 * k..4 * k + 4).and_then(|b| b.try_into().ok());
        f32::from_le_bytes(four.unwrap_or_default())
    };
    CloudPoint {
        position: [0, 1, 2].map(float),
        normal: [3, 4, 5].map(float),
        confidence: float(6),
        color: [record[28], record[29], record[30]],
        num_views: record[31],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::MemoryScratch;
    use rilievo_synthetic::testing::Random;

    fn thinned(points: &[CloudPoint], max_num_sorted: u64) -> Vec<CloudPoint> {
        let options = FusionOptions {
            spacing: 0.1,
            ..FusionOptions::default()
        };
        let mut thinner = Thinner::new(&MemoryScratch, &options).expect("room in memory");
        thinner.max_num_sorted = max_num_sorted;
        thinner.add(points).expect("room in memory");
        let mut kept = Vec::new();
        let taken = thinner.finish(&mut |points| {
            kept.extend_from_slice(points);
            Ok(())
        });
        taken.expect("room in memory");
        kept
    }

    #[test]
    fn the_most_confident_point_of_each_cube_stays_however_many_passes_there_are() {
        let mut random = Random(3);
        let points: Vec<CloudPoint> = (0..40_000)
            .map(|_| CloudPoint {
                position: [0; 3].map(|_| 4.0 * random.unit() as f32 - 2.0),
                normal: [0.0, 0.0, 1.0],
                color: [1, 2, 3],
                confidence: random.below(4) as f32,
                num_views: 2,
            })
            .collect();
        let cube = |p: &CloudPoint| p.position.map(|c| (f64::from(c) / 0.1).floor() as i64);
        let kept = thinned(&points, u64::MAX);
        assert_eq!(kept, thinned(&points, 5_000));
        let mut best = std::collections::BTreeMap::new();
        for (i, point) in points.iter().enumerate() {
            let entry = best.entry(cube(point)).or_insert(i);
            if point.confidence > points[*entry].confidence {
                *entry = i;
            }
        }
        let mut expected: Vec<usize> = best.into_values().collect();
        expected.sort_unstable();
        let expected: Vec<CloudPoint> = expected.into_iter().map(|i| points[i]).collect();
        assert_eq!(kept, expected);
    }
}
