//! One scan of a JPEG: does it hold exactly the blocks that its frame asks for?
//!
//! A scan codes `ceil(w / 8h_max) · ceil(h / 8v_max)` units of `Σ hᵢvᵢ` blocks (or, with a single
//! component, that component's own blocks), each block 64 coefficients in zigzag order, as pairs of
//! a run of zeros and a value (ITU-T T.81, annexes F.1.2 and G.1.2). The walk reads every code and
//! keeps no value. It stops where
//! - no code begins with the bits that come,
//! - a run leaves the block, or the data end before the last unit,
//! - the mean of a block, `|DC| · q`, leaves the range of 8-bit samples (a wrong difference shifts
//!   all that follow),
//! - an expected restart marker is another or none, or
//! - one byte comes over and over where coefficients are coded: a lost sector reads so, a coded
//!   surface does not.

use super::defect::Defect;
use super::huffman::{Bits, HuffmanTable};

/// Largest `|DC| · q` of samples of 8 bits, `8 · 128`, and half as much again: encoders round and
/// some shape noise, damage shifts by multiples.
const MAX_MEAN: i64 = 1536;

/// Bytes that may be left after the last block: encoders that flush one byte too many.
const MAX_LEFT: usize = 2;

/// Values of a block that may come while one byte repeats itself: a drawing with the period of the
/// blocks can have a few.
const MAX_MONOTONOUS: usize = 4;

/// A colour component of a frame.
#[derive(Clone)]
pub(super) struct Component {
    id: u8,
    h: usize,
    v: usize,
    quantiser: usize,
    /// Blocks of a row, as stored.
    blocks_x: usize,
    /// Per block, which coefficients are not zero so far; only progressive frames need it.
    nonzero: Vec<u64>,
}

impl Component {
    pub(super) fn new(id: u8, h: usize, v: usize, quantiser: u8) -> Option<Self> {
        let fits = (1..=4).contains(&h) && (1..=4).contains(&v) && quantiser < 4;
        fits.then(|| Self {
            id,
            h,
            v,
            quantiser: usize::from(quantiser),
            blocks_x: 0,
            nonzero: Vec::new(),
        })
    }
}

/// What all scans share.
pub(super) struct Frame {
    progressive: bool,
    precision: u8,
    width: usize,
    height: usize,
    h_max: usize,
    v_max: usize,
    components: Vec<Component>,
}

impl Frame {
    pub(super) fn new(
        progressive: bool,
        precision: u8,
        width: usize,
        height: usize,
        mut components: Vec<Component>,
    ) -> Self {
        let h_max = components.iter().map(|c| c.h).max().unwrap_or(1);
        let v_max = components.iter().map(|c| c.v).max().unwrap_or(1);
        for component in &mut components {
            component.blocks_x = width.div_ceil(8 * h_max) * component.h;
            if progressive {
                let rows = height.div_ceil(8 * v_max) * component.v;
                component.nonzero = vec![0; component.blocks_x * rows];
            }
        }
        Self {
            progressive,
            precision,
            width,
            height,
            h_max,
            v_max,
            components,
        }
    }

    pub(super) fn index_of(&self, id: u8) -> Option<usize> {
        self.components.iter().position(|c| c.id == id)
    }

    pub(super) fn quantiser_of(&self, component: usize) -> usize {
        self.components[component].quantiser
    }
}

/// A component's part in a scan.
pub(super) struct Part {
    pub(super) component: usize,
    pub(super) dc: Option<HuffmanTable>,
    pub(super) ac: Option<HuffmanTable>,
    pub(super) mean_step: u16,
}

/// A scan's header.
pub(super) struct Scan {
    pub(super) parts: Vec<Part>,
    /// First and last coefficient, zigzag order.
    pub(super) band: (usize, usize),
    /// Whether it adds a bit to values known already.
    pub(super) refines: bool,
    /// Bits that later scans add.
    pub(super) shift: u8,
    pub(super) restart_interval: usize,
}

/// Reads a scan from `at` on; where its data end.
pub(super) fn follow(
    frame: &mut Frame,
    scan: &Scan,
    bytes: &[u8],
    at: usize,
) -> Result<usize, Defect> {
    let no_memory = Defect::Damaged("its image data exceed the memory");
    let mut bits = Bits::new(bytes, at).ok_or(no_memory)?;
    let mut means = vec![0i64; scan.parts.len()];
    let mut end_of_band = 0u32;
    // A scan of one component holds its own blocks, without those that only fill the last units.
    let alone = match &scan.parts[..] {
        [part] => Some(&frame.components[part.component]),
        _ => None,
    };
    let (h, v) = alone.map_or((1, 1), |component| (component.h, component.v));
    let units_x = (frame.width * h).div_ceil(8 * frame.h_max);
    let units_y = (frame.height * v).div_ceil(8 * frame.v_max);
    let (alone, rows_each) = (alone.is_some(), 8 * frame.v_max / v);
    let num_units = units_x * units_y;
    for unit in 0..num_units {
        let (x, y) = (unit % units_x, unit / units_x);
        let damaged = Defect::Scan {
            row: (y * rows_each).min(frame.height),
            height: frame.height,
        };
        if scan.restart_interval > 0 && unit > 0 && unit % scan.restart_interval == 0 {
            let expected = 0xD0 + ((unit / scan.restart_interval - 1) % 8) as u8;
            // The marker's code stands after its `0xFF` and any fill bytes.
            let rest = bytes.get(bits.marker..).unwrap_or_default();
            let fill = rest.iter().take_while(|&&byte| byte == 0xFF).count();
            if bits.num_left() > MAX_LEFT || rest.get(fill) != Some(&expected) {
                return Err(damaged);
            }
            bits = Bits::new(bytes, bits.marker + fill + 1).ok_or(no_memory)?;
            means.fill(0);
            end_of_band = 0;
        }
        for (part, mean) in scan.parts.iter().zip(&mut means) {
            let component = &mut frame.components[part.component];
            let (h, v) = match alone {
                true => (1, 1),
                false => (component.h, component.v),
            };
            for block in 0..h * v {
                let index = (y * v + block / h) * component.blocks_x + x * h + block % h;
                let read = if frame.progressive {
                    component.nonzero.get_mut(index).and_then(|nonzero| {
                        progressive(&mut bits, scan, part, mean, &mut end_of_band, nonzero)
                    })
                } else {
                    sequential(&mut bits, part, mean)
                };
                let step = i64::from(part.mean_step);
                let level = (*mean << scan.shift).abs() * step;
                if read.is_none() || (frame.precision == 8 && level > MAX_MEAN + step) {
                    let is_cut_off = bytes.len().saturating_sub(bits.marker) < 2;
                    return Err(match is_cut_off {
                        true => Defect::CutOff(bytes.len()),
                        false => damaged,
                    });
                }
            }
        }
    }
    match bits.num_left() {
        left if left > MAX_LEFT => Err(Defect::Left(left)),
        _ => Ok(bits.marker),
    }
}

/// The difference of a block's mean to the one before.
fn mean_difference(bits: &mut Bits, part: &Part) -> Option<i64> {
    let category = bits.symbol(part.dc.as_ref()?)?;
    (category <= 15).then_some(())?;
    bits.coefficient(category).map(i64::from)
}

/// A block of a sequential scan (F.2.2).
fn sequential(bits: &mut Bits, part: &Part, mean: &mut i64) -> Option<()> {
    *mean += mean_difference(bits, part)?;
    let table = part.ac.as_ref()?;
    let mut k = 1;
    let mut num = 0;
    while k < 64 {
        let symbol = bits.symbol(table)?;
        let (run, category) = (usize::from(symbol >> 4), symbol & 15);
        if category == 0 {
            match run {
                0 => return Some(()),
                15 => k += 16,
                _ => return None,
            }
            continue;
        }
        k += run;
        num += 1;
        (k < 64 && !(num > MAX_MONOTONOUS && bits.is_lost())).then_some(())?;
        bits.number(category)?;
        k += 1;
    }
    (k == 64).then_some(())
}

/// A block of a progressive scan (G.1.2).
fn progressive(
    bits: &mut Bits,
    scan: &Scan,
    part: &Part,
    mean: &mut i64,
    end_of_band: &mut u32,
    nonzero: &mut u64,
) -> Option<()> {
    let (first, last) = scan.band;
    if first == 0 {
        if scan.refines {
            bits.number(1)?;
        } else {
            *mean += mean_difference(bits, part)?;
        }
        return Some(());
    }
    (last < 64).then_some(())?;
    let table = part.ac.as_ref()?;
    let mut k = first;
    if *end_of_band == 0 {
        while k <= last {
            let symbol = bits.symbol(table)?;
            let (mut run, category) = (symbol >> 4, symbol & 15);
            if category == 0 && run < 15 {
                *end_of_band = (1 << run) + bits.number(run)?;
                break;
            }
            if !scan.refines {
                k += usize::from(run);
                if category > 0 {
                    (k <= last).then_some(())?;
                    bits.number(category)?;
                    *nonzero |= 1 << k;
                }
                k += 1;
                continue;
            }
            // Values known already take a bit each on the way; the run counts those still zero.
            (category <= 1).then_some(())?;
            bits.number(category)?;
            while k <= last {
                if *nonzero >> k & 1 == 1 {
                    bits.number(1)?;
                } else if run == 0 {
                    break;
                } else {
                    run -= 1;
                }
                k += 1;
            }
            if category == 1 {
                (k <= last).then_some(())?;
                *nonzero |= 1 << k;
            }
            k += 1;
        }
        (k <= last + 1).then_some(())?;
    }
    if *end_of_band > 0 {
        if scan.refines {
            for k in k..=last {
                if *nonzero >> k & 1 == 1 {
                    bits.number(1)?;
                }
            }
        }
        *end_of_band -= 1;
    }
    Some(())
}
