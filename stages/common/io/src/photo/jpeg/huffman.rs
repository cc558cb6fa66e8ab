//! Huffman codes of a JPEG scan, bit by bit (ITU-T T.81, annexes C and F.2.2).

use std::sync::Arc;

/// Equal bytes in a row from which data with coefficients other than zero are none: a lost sector.
/// Chance gives as many once in 2¹⁸⁴.
const MIN_LOST: u32 = 24;

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
                table
                    .get_mut(next..end)?
                    .fill((length as u8, *symbols.next()?));
                next = end;
            }
        }
        Some((Self(Arc::new(table)), MAX_LENGTH + total))
    }
}

/// The bits of a scan: stuffed zeros taken out, stopping at a marker.
pub(super) struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
    /// The next bits, from the highest one down.
    buffer: u64,
    count: u32,
    /// How often the last byte came in a row.
    repeated: u32,
    last: u8,
}

impl<'a> Bits<'a> {
    pub(super) fn new(bytes: &'a [u8], at: usize) -> Self {
        Self {
            bytes,
            at,
            buffer: 0,
            count: 0,
            repeated: 0,
            last: 0,
        }
    }

    /// Whether the file ends here, without the marker that ends a scan.
    pub(super) fn exhausted(&self) -> bool {
        matches!(self.bytes.get(self.at..), None | Some([] | [0xFF]))
    }

    /// Whether the bytes that come are one value over and over.
    pub(super) fn monotonous(&self) -> bool {
        self.repeated >= MIN_LOST
    }

    fn fill(&mut self) {
        while self.count <= 56 {
            let step = match self.bytes.get(self.at..) {
                Some([0xFF, 0x00, ..]) => 2,
                Some([0xFF, ..] | []) | None => return,
                Some(_) => 1,
            };
            let byte = self.bytes[self.at];
            self.repeated = if byte == self.last {
                self.repeated + 1
            } else {
                1
            };
            self.last = byte;
            self.buffer |= u64::from(byte) << (56 - self.count);
            self.count += 8;
            self.at += step;
        }
    }

    fn drop_bits(&mut self, num: u32) -> Option<()> {
        self.count = self.count.checked_sub(num)?;
        self.buffer <<= num;
        Some(())
    }

    /// The next symbol; `None` where no code begins so or the data end.
    pub(super) fn symbol(&mut self, table: &HuffmanTable) -> Option<u8> {
        if self.count < MAX_LENGTH as u32 {
            self.fill();
        }
        let (length, symbol) = table.0[(self.buffer >> 48) as usize];
        (length > 0).then_some(())?;
        self.drop_bits(u32::from(length))?;
        Some(symbol)
    }

    /// The next bits as a number, highest first; at most 16.
    pub(super) fn number(&mut self, num: u8) -> Option<u32> {
        if num == 0 {
            return Some(0);
        }
        if self.count < u32::from(num) {
            self.fill();
        }
        let value = (self.buffer >> (64 - u32::from(num))) as u32;
        self.drop_bits(u32::from(num))?;
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

    /// Ends the scan or interval: how many bytes other than zero are left unread, and where the
    /// marker stands.
    pub(super) fn end(&self) -> (usize, usize) {
        // What is left of a byte that was begun is padding.
        let begun = self.count % 8;
        let buffered = (self.buffer << begun).to_be_bytes();
        let whole = (self.count / 8) as usize;
        let mut left = buffered[..whole].iter().filter(|&&byte| byte != 0).count();
        let mut at = self.at;
        loop {
            match self.bytes.get(at..) {
                Some([0xFF, 0x00, ..]) => {
                    at += 2;
                    left += 1;
                }
                // A marker, or fill bytes before one.
                Some([0xFF, ..] | []) | None => return (left, at),
                Some([byte, ..]) => {
                    at += 1;
                    left += usize::from(*byte != 0);
                }
            }
        }
    }
}
