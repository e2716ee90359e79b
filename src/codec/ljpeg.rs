//! Writing lossless JPEG (ITU-T T.81, process 14, predictor 1), as raw files hold their sensor data.
//!
//! Takes interleaved samples of 1 to 4 components, gives the stream from SOI to EOI: one scan, one Huffman table for
//! all components, made from the samples' own statistics.

/// Categories of differences: 0 to 16 bits.
const CATEGORIES: usize = 17;

/// A scan's size: `width` x `height` samples of each of `components` components, `precision` bits each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Scan {
    pub(super) width: u16,
    pub(super) height: u16,
    pub(super) components: u8,
    pub(super) precision: u8,
}

/// A code of the Huffman table: `length` bits, 0 for categories that do not occur.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Code {
    bits: u32,
    length: u32,
}

/// Encodes `samples`, row by row, components side by side; `None` if their number does not fit the scan.
pub(super) fn encode(samples: &[u16], scan: Scan) -> Option<Vec<u8>> {
    let components = usize::from(scan.components);
    let row = usize::from(scan.width) * components;
    let fits = (1..=4).contains(&components)
        && (2..=16).contains(&scan.precision)
        && row > 0
        && samples.len() == row * usize::from(scan.height)
        && !samples.is_empty();
    if !fits {
        return None;
    }
    let mut counts = [0u64; CATEGORIES];
    for_each_difference(samples, row, scan, |difference| counts[category(difference)] += 1);
    let codes = codes(&counts);

    let mut out = Vec::with_capacity(samples.len() + samples.len() / 4);
    write_headers(&mut out, scan, &codes);
    let mut bits = Bits { out, waiting: 0, have: 0 };
    for_each_difference(samples, row, scan, |difference| {
        let category = category(difference);
        let code = codes[category];
        bits.put(code.bits, code.length);
        if (1..16).contains(&category) {
            // Negative differences are written as their low bits minus one.
            let value = i32::from(difference) - i32::from(difference < 0);
            bits.put(value as u32 & ((1 << category) - 1), category as u32);
        }
    });
    let mut out = bits.finish();
    out.extend([0xff, 0xd9]);
    Some(out)
}

/// Differences from the sample of the same component to the left; at a row's start from the one above; at the very
/// start from half of the range. Modulo 2^16, as the standard has it.
fn for_each_difference(samples: &[u16], row: usize, scan: Scan, mut each: impl FnMut(i16)) {
    let components = usize::from(scan.components);
    let mut above: Option<&[u16]> = None;
    for line in samples.chunks_exact(row) {
        for (i, sample) in line[..components].iter().enumerate() {
            let predicted = above.map_or(1 << (scan.precision - 1), |above| above[i]);
            each(sample.wrapping_sub(predicted) as i16);
        }
        for (sample, left) in line[components..].iter().zip(line) {
            each(sample.wrapping_sub(*left) as i16);
        }
        above = Some(line);
    }
}

/// Bits of a difference's magnitude.
fn category(difference: i16) -> usize {
    (u16::BITS - difference.unsigned_abs().leading_zeros()) as usize
}

/// Huffman codes for categories that occur `counts` times each, at most 16 bits long, none of them all ones.
fn codes(counts: &[u64; CATEGORIES]) -> [Code; CATEGORIES] {
    let total: u64 = counts.iter().sum();
    // Rare categories are counted as not quite so rare, which keeps the longest code under 16 bits.
    let floor = (total >> 10).max(1);
    // Trees of (weight, categories); the last category stands for the code of all ones, which is not used.
    let mut trees: Vec<(u64, Vec<usize>)> = (0..CATEGORIES)
        .filter(|&c| counts[c] > 0)
        .map(|c| (counts[c].max(floor), vec![c]))
        .chain([(1, vec![CATEGORIES])])
        .collect();
    let mut lengths = [0u32; CATEGORIES + 1];
    while trees.len() > 1 {
        trees.sort_by_key(|tree| std::cmp::Reverse(tree.0));
        let (Some(a), Some(b)) = (trees.pop(), trees.pop()) else { break };
        let joined = [a.1, b.1].concat();
        for &c in &joined {
            lengths[c] += 1;
        }
        trees.push((a.0 + b.0, joined));
    }
    let mut order: Vec<usize> = (0..=CATEGORIES).filter(|&c| lengths[c] > 0).collect();
    // Canonical order; the unused one is the last of the longest.
    order.sort_by_key(|&c| (lengths[c], c));
    let mut codes = [Code::default(); CATEGORIES + 1];
    let (mut next, mut length) = (0u32, 0);
    for c in order {
        next <<= lengths[c] - length;
        length = lengths[c];
        codes[c] = Code { bits: next, length };
        next += 1;
    }
    std::array::from_fn(|c| codes[c])
}

fn write_headers(out: &mut Vec<u8>, scan: Scan, codes: &[Code; CATEGORIES]) {
    let mut used: Vec<usize> = (0..CATEGORIES).filter(|&c| codes[c].length > 0).collect();
    used.sort_by_key(|&c| (codes[c].length, codes[c].bits));
    out.extend([0xff, 0xd8, 0xff, 0xc4]);
    out.extend((2 + 1 + 16 + used.len() as u16).to_be_bytes());
    out.push(0);
    out.extend((1..=16).map(|length| used.iter().filter(|&&c| codes[c].length == length).count() as u8));
    out.extend(used.iter().map(|&c| c as u8));
    out.extend([0xff, 0xc3]);
    out.extend((8 + 3 * u16::from(scan.components)).to_be_bytes());
    out.push(scan.precision);
    out.extend(scan.height.to_be_bytes());
    out.extend(scan.width.to_be_bytes());
    out.push(scan.components);
    for component in 1..=scan.components {
        out.extend([component, 0x11, 0]);
    }
    out.extend([0xff, 0xda]);
    out.extend((6 + 2 * u16::from(scan.components)).to_be_bytes());
    out.push(scan.components);
    for component in 1..=scan.components {
        out.extend([component, 0]);
    }
    // Predictor 1, no point transform.
    out.extend([1, 0, 0]);
}

/// Bits, most significant first, with a zero byte after each byte of ones.
struct Bits {
    out: Vec<u8>,
    waiting: u64,
    have: u32,
}

impl Bits {
    /// Adds the low `length` (at most 16) bits of `bits`.
    fn put(&mut self, bits: u32, length: u32) {
        self.waiting = self.waiting << length | u64::from(bits);
        self.have += length;
        while self.have >= 8 {
            self.have -= 8;
            let byte = (self.waiting >> self.have) as u8;
            self.out.push(byte);
            if byte == 0xff {
                self.out.push(0);
            }
        }
    }

    /// Fills the last byte with ones, as the standard has it.
    fn finish(mut self) -> Vec<u8> {
        let missing = (8 - self.have % 8) % 8;
        self.put((1 << missing) - 1, missing);
        self.out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_difference_belongs_to_the_category_of_its_magnitude() {
        for (difference, bits) in
            [(0, 0), (1, 1), (-1, 1), (2, 2), (-3, 2), (255, 8), (-256, 9), (i16::MIN, 16)]
        {
            assert_eq!(category(difference), bits, "{difference}");
        }
    }

    #[test]
    fn no_code_begins_another_and_none_is_all_ones() {
        let mut fibonacci = [1u64; CATEGORIES];
        for i in 2..CATEGORIES {
            fibonacci[i] = fibonacci[i - 1] + fibonacci[i - 2];
        }
        let mut steep = [0u64; CATEGORIES];
        (0..CATEGORIES).for_each(|i| steep[i] = 1 << (3 * i));
        let mut single = [0u64; CATEGORIES];
        single[3] = 7;
        for counts in [fibonacci, steep, [5; CATEGORIES], single] {
            let codes = codes(&counts);
            for (c, a) in codes.iter().enumerate() {
                assert_eq!(a.length > 0, counts[c] > 0);
                assert!(a.length <= 16 && (a.length == 0 || a.bits != (1 << a.length) - 1), "{a:?}");
                for (_, b) in
                    codes.iter().enumerate().filter(|(other, b)| *other != c && b.length >= a.length)
                {
                    assert!(a.length == 0 || b.bits >> (b.length - a.length) != a.bits, "{a:?} begins {b:?}");
                }
            }
        }
    }

    #[test]
    fn a_number_of_samples_that_does_not_fit_is_refused() {
        let scan = Scan { width: 4, height: 2, components: 2, precision: 14 };
        assert!(encode(&[0; 15], scan).is_none());
        assert!(encode(&[0; 16], scan).is_some());
        assert!(encode(&[0; 16], Scan { components: 0, ..scan }).is_none());
    }
}
