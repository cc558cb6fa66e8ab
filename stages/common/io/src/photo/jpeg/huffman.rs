//! Huffman codes of a JPEG scan, bit by bit (ITU-T T.81, annexes C and F.2.2).

use std::sync::Arc;

/// Equal bytes in a row from which coefficients other than zero are none: a lost sector. Chance
/// makes as many once in 2¹⁸⁴.
const MIN_LOST: usize = 24;

/// Longest code, bits.
const MAX_LENGTH: usize = 16;

/// A code table: for every 16 bits that may come, the length of the code they begin with and its
/// symbol; length 0 where no code begins so.
#[derive(Clone)]
pub(super) struct HuffmanTable(Arc<Vec<(u8, u8)>>);

impl HuffmanTable {
    /// Reads the counts of codes by length and the symbols; also how many bytes they take.
    pub(super) fn read(bytes: &[u8]) -> Option<(Self, usize)> {
        let counts = bytes.get(..MAX_LENGTH)?;
        let total: usize = counts.iter().map(|&count| usize::from(count)).sum();
        let mut symbols = bytes.get(MAX_LENGTH..MAX_LENGTH + total)?.iter();
        let mut table = vec![(0, 0); 1 << MAX_LENGTH];
        let mut next = 0;
        for (length, &count) in (1..=MAX_LENGTH).zip(counts) {
            for _ in 0..count {
                let end = next + (1 << (MAX_LENGTH - length));
                let codes = table.get_mut(next..end)?;
                codes.fill((length as u8, *symbols.next()?));
                next = end;
            }
        }
        Some((Self(Arc::new(table)), MAX_LENGTH + total))
    }
}

/// The bits of a scan, or of its part up to a restart: as far as the next marker.
pub(super) struct Bits {
    /// Bytes without the zeros that are stuffed behind `0xFF`, and four zeros more.
    data: Vec<u8>,
    /// Bits that were read, and those that there are.
    at: usize,
    len: usize,
    /// Place of the marker that ends them, or of the file's end.
    pub(super) marker: usize,
}

impl Bits {
    /// The bits from a place on; `None` where there is no memory for them.
    pub(super) fn new(bytes: &[u8], at: usize) -> Option<Self> {
        let rest = bytes.get(at..).unwrap_or_default();
        let is_marker = |pair: &[u8]| pair[0] == 0xFF && pair[1] != 0;
        let end = rest.windows(2).position(is_marker);
        let end = end.unwrap_or(rest.len() - usize::from(rest.ends_with(&[0xFF])));
        let mut data = Vec::new();
        data.try_reserve_exact(end + 4).ok()?;
        let mut before = 0;
        for &byte in &rest[..end] {
            if (before, byte) != (0xFF, 0) {
                data.push(byte);
            }
            before = byte;
        }
        let len = 8 * data.len();
        data.extend([0; 4]);
        Some(Self {
            data,
            at: 0,
            len,
            marker: at + end,
        })
    }

    /// Whether the byte at hand repeats those before it over and over.
    pub(super) fn is_lost(&self) -> bool {
        let last = self.at / 8;
        let equal = (last + 1).checked_sub(MIN_LOST);
        let equal = equal.and_then(|first| self.data.get(first..=last));
        equal.is_some_and(|equal| equal.iter().rev().all(|byte| *byte == equal[0]))
    }

    /// The next 16 bits, zeros behind the last.
    fn ahead(&self) -> u32 {
        let bytes = self
            .data
            .get(self.at / 8..)
            .and_then(|rest| rest.first_chunk());
        let word = u32::from_be_bytes(*bytes.unwrap_or(&[0; 4]));
        word << (self.at % 8) >> 16
    }

    fn pass(&mut self, num: u8) -> Option<()> {
        self.at += usize::from(num);
        (self.at <= self.len).then_some(())
    }

    /// The next symbol; `None` where no code begins so or the data end.
    pub(super) fn symbol(&mut self, table: &HuffmanTable) -> Option<u8> {
        let (length, symbol) = table.0[self.ahead() as usize];
        (length > 0).then_some(())?;
        self.pass(length)?;
        Some(symbol)
    }

    /// The next bits as a number, highest first; at most 16.
    pub(super) fn number(&mut self, num: u8) -> Option<u32> {
        let value = self.ahead() >> (16 - num);
        self.pass(num)?;
        Some(value)
    }

    /// A coefficient of a category: its bits, the lower half of the range standing for negatives.
    pub(super) fn coefficient(&mut self, category: u8) -> Option<i32> {
        let value = self.number(category)? as i32;
        if category == 0 || value >= 1 << (category - 1) {
            return Some(value);
        }
        Some(value - (1 << category) + 1)
    }

    /// How many bytes other than zero are left unread; the rest of one that was begun is padding.
    pub(super) fn num_left(&self) -> usize {
        let rest = self.data.get(self.at.div_ceil(8)..self.len / 8);
        rest.map_or(0, |rest| rest.iter().filter(|&&byte| byte != 0).count())
    }
}
