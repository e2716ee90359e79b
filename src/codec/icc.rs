//! ICC profiles of linear RGB spaces, for pictures that name their colours (ICC.1:2010, version 4.3).
//!
//! A three-component matrix profile with identity curves: what a linear picture is, exactly, to any program that manages
//! colour.

/// A linear RGB space as a profile tells it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearRgb<'a> {
    /// Name shown to users; ASCII.
    pub name: &'a str,
    /// XYZ of red, green and blue at value 1, adapted to D50.
    pub colorants: [[f64; 3]; 3],
    /// Adaptation from the space's own white to D50, row by row.
    pub adaptation: [[f64; 3]; 3],
}

const HEADER: usize = 128;

/// D50 as every profile's header has it.
const D50: [f64; 3] = [0.9642, 1.0, 0.8249];

/// Encodes the profile.
pub fn encode(space: &LinearRgb<'_>) -> Vec<u8> {
    // The curve of no entries is the identity.
    let curve = [b"curv".as_slice(), &[0; 8]].concat();
    let matrix: Vec<f64> = space.adaptation.concat();
    let [red, green, blue] = space.colorants.map(|c| xyz(&c));
    let tags: [(&[u8; 4], Vec<u8>); 10] = [
        (b"desc", text(space.name)),
        (b"cprt", text("No copyright, use freely")),
        (b"wtpt", xyz(&D50)),
        (b"chad", [b"sf32\0\0\0\0".to_vec(), numbers(&matrix)].concat()),
        (b"rXYZ", red),
        (b"gXYZ", green),
        (b"bXYZ", blue),
        (b"rTRC", curve.clone()),
        (b"gTRC", curve.clone()),
        (b"bTRC", curve),
    ];
    let mut table = (tags.len() as u32).to_be_bytes().to_vec();
    let mut data = vec![];
    let start = HEADER + 4 + 12 * tags.len();
    for (name, bytes) in &tags {
        table.extend_from_slice(*name);
        table.extend(((start + data.len()) as u32).to_be_bytes());
        table.extend((bytes.len() as u32).to_be_bytes());
        data.extend(bytes);
        data.resize(data.len().next_multiple_of(4), 0);
    }
    let mut out = vec![0; HEADER];
    out[..4].copy_from_slice(&((start + data.len()) as u32).to_be_bytes());
    out[8..12].copy_from_slice(&[4, 0x30, 0, 0]);
    out[12..24].copy_from_slice(b"mntrRGB XYZ ");
    // A fixed date, so that the same picture is the same file: year, month, day.
    for (at, value) in [(24, 2025_u16), (26, 1), (28, 1)] {
        out[at..at + 2].copy_from_slice(&value.to_be_bytes());
    }
    out[36..40].copy_from_slice(b"acsp");
    // Media-relative colorimetric.
    out[67] = 1;
    out[68..80].copy_from_slice(&numbers(&D50));
    out.extend(table);
    out.extend(data);
    out
}

fn xyz(value: &[f64; 3]) -> Vec<u8> {
    [b"XYZ \0\0\0\0".to_vec(), numbers(value)].concat()
}

/// s15Fixed16Number.
fn numbers(values: &[f64]) -> Vec<u8> {
    values.iter().flat_map(|v| ((v * 65536.0).round() as i32).to_be_bytes()).collect()
}

/// multiLocalizedUnicodeType with one record, English.
fn text(ascii: &str) -> Vec<u8> {
    let utf16: Vec<u8> = ascii.encode_utf16().flat_map(u16::to_be_bytes).collect();
    let head = [1_u32, 12].into_iter().flat_map(u32::to_be_bytes);
    let place = [utf16.len() as u32, 28].into_iter().flat_map(u32::to_be_bytes);
    b"mluc\0\0\0\0".iter().copied().chain(head).chain(*b"enUS").chain(place).chain(utf16).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_profile_is_as_long_as_it_says_and_its_tags_lie_inside() {
        let space = LinearRgb {
            name: "linear sRGB",
            colorants: [[0.4361, 0.2225, 0.0139], [0.3851, 0.7169, 0.0971], [0.1431, 0.0606, 0.7141]],
            adaptation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        };
        let profile = encode(&space);
        let word = |at: usize| u32::from_be_bytes(profile[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!(word(0), profile.len());
        assert_eq!(&profile[36..40], b"acsp");
        assert_eq!(word(128), 10);
        for tag in 0..word(128) {
            let (offset, length) = (word(136 + 12 * tag), word(140 + 12 * tag));
            assert!(offset % 4 == 0 && offset + length <= profile.len());
        }
        let red = word(136 + 12 * 4);
        assert_eq!(&profile[red..red + 4], b"XYZ ");
        assert!((word(red + 8) as f64 / 65536.0 - 0.4361).abs() < 1e-4);
    }
}
