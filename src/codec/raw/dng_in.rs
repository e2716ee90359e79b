//! What a DNG says of its sensor data (DNG 1.4), and its uncompressed pixels at 8 to 16 bits a site.
//!
//! Positions of CFA pattern and black levels count from the active area's first site, as the standard has
//! it. BlackLevelDelta and opcode lists are not applied: the values stay the sensor's own.

use super::RawError;
use super::sensor::{Description, Plane, Rect};
use super::tiffdir::{Directory, Tiff, tag};
use crate::photometry::{Cfa, LevelSource};

const PHOTOMETRIC_CFA: u64 = 32803;
const PHOTOMETRIC_LINEAR_RAW: u64 = 34892;

/// Compression of a DNG's sensor data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Storage {
    Uncompressed {
        bits: usize,
    },
    LosslessJpeg,
    /// Compressed in a way that only the second decoder may know.
    Other,
}

/// A DNG's directory of sensor data, understood.
pub(super) struct DngFrame<'t, 'a> {
    directory: &'t Directory<'a>,
    little: bool,
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) storage: Storage,
    pub(super) description: Description,
}

/// Finds and reads the directory of the full-size sensor data.
pub(super) fn describe<'t, 'a>(what: &str, tiff: &'t Tiff<'a>) -> Result<DngFrame<'t, 'a>, RawError> {
    let full_size = |d: &&Directory| d.one(tag::NEW_SUBFILE_TYPE).unwrap_or(0) == 0;
    let of = |kind: u64| move |d: &&Directory| d.one(tag::PHOTOMETRIC) == Some(kind);
    let Some(directory) = tiff.directories.iter().filter(full_size).find(of(PHOTOMETRIC_CFA)) else {
        let linear = tiff.directories.iter().any(|d| of(PHOTOMETRIC_LINEAR_RAW)(&d));
        let what = what.to_owned();
        return Err(if linear {
            RawError::Demosaiced { what, how: "linear DNG" }
        } else {
            RawError::NoSensorData { what }
        });
    };
    let need = |tag: u16, name: &str| {
        directory.one(tag).ok_or_else(|| damaged(what, format!("its sensor data has no readable {name} tag")))
    };
    let (width, height) =
        (need(tag::IMAGE_WIDTH, "ImageWidth")? as usize, need(tag::IMAGE_LENGTH, "ImageLength")? as usize);
    if need(tag::SAMPLES_PER_PIXEL, "SamplesPerPixel")? != 1 {
        return Err(damaged(what, "a filter array with more than one value a site"));
    }
    let bits = need(tag::BITS_PER_SAMPLE, "BitsPerSample")? as usize;
    let storage = match need(tag::COMPRESSION, "Compression")? {
        1 if (8..=16).contains(&bits) => Storage::Uncompressed { bits },
        1 => return Err(unsupported(what, format!("{bits} bits a site"))),
        7 => Storage::LosslessJpeg,
        // Deflate, lossy JPEG, JPEG XL.
        8 | 34892 | 52546 => Storage::Other,
        other => return Err(unsupported(what, format!("DNG compression {other}"))),
    };
    let description = describe_levels(what, directory, width, height, bits)?;
    description.check(what, width, height)?;
    Ok(DngFrame { directory, little: tiff.little, width, height, storage, description })
}

fn describe_levels(
    what: &str,
    directory: &Directory,
    width: usize,
    height: usize,
    bits: usize,
) -> Result<Description, RawError> {
    let pattern = directory.unsigned(tag::CFA_PATTERN).unwrap_or_default();
    let rectangular = directory.one(tag::CFA_LAYOUT).unwrap_or(1) == 1;
    let &[a, b, c, d] = pattern.as_slice() else {
        return Err(RawError::Pattern { what: what.to_owned(), pattern: format!("{pattern:?}") });
    };
    if directory.unsigned(tag::CFA_REPEAT) != Some(vec![2, 2])
        || !rectangular
        || pattern.iter().any(|&v| v > 2)
    {
        return Err(RawError::Pattern { what: what.to_owned(), pattern: format!("{pattern:?}") });
    }
    let rect = |v: &[u64]| Rect {
        top: v[0] as usize,
        left: v[1] as usize,
        bottom: v[2] as usize,
        right: v[3] as usize,
    };
    let active = match directory.unsigned(tag::ACTIVE_AREA) {
        Some(v) if v.len() == 4 => rect(&v),
        _ => Rect { top: 0, left: 0, bottom: height, right: width },
    };
    let masked = directory.unsigned(tag::MASKED_AREAS).unwrap_or_default();
    let masked: Vec<Rect> = masked.chunks_exact(4).take(4).map(rect).collect();
    let white = directory.numbers(tag::WHITE_LEVEL).and_then(|v| v.first().copied());
    // The standard's own default, for files without the tag.
    let white = white.unwrap_or_else(|| f64::from((1u32 << bits.min(16)) - 1)) as f32;
    Ok(Description {
        active,
        cfa: Cfa([[a as u8, b as u8], [c as u8, d as u8]]),
        masked,
        black: black_levels(what, directory)?,
        saturation: [[white; 2]; 2],
        source: LevelSource::FileTag,
    })
}

/// BlackLevel repeated over the 2x2 array; 0 without the tag, as the standard has it.
fn black_levels(what: &str, directory: &Directory) -> Result<[[f32; 2]; 2], RawError> {
    let levels = directory.numbers(tag::BLACK_LEVEL).unwrap_or_else(|| vec![0.0]);
    let repeat = directory.unsigned(tag::BLACK_REPEAT).unwrap_or_else(|| vec![1, 1]);
    let &[rows, columns] = repeat.as_slice() else {
        return Err(damaged(what, "BlackLevelRepeatDim is not two numbers"));
    };
    if !(1..=2).contains(&rows) || !(1..=2).contains(&columns) || levels.len() as u64 != rows * columns {
        return Err(unsupported(what, format!("{} black levels repeating {rows} x {columns}", levels.len())));
    }
    let at = |row: usize, column: usize| {
        let (rows, columns) = (rows as usize, columns as usize);
        levels[(row % rows) * columns + column % columns] as f32
    };
    Ok([[at(0, 0), at(0, 1)], [at(1, 0), at(1, 1)]])
}

impl DngFrame<'_, '_> {
    /// Reads uncompressed strips or tiles; the segments are known to lie inside `bytes`.
    pub(super) fn read_uncompressed(&self, what: &str, bytes: &[u8], bits: usize) -> Result<Plane, RawError> {
        let &DngFrame { width, height, directory, .. } = self;
        let (across, down) = match directory.one(tag::TILE_WIDTH) {
            Some(w) => (w as usize, directory.one(tag::TILE_LENGTH).unwrap_or(0) as usize),
            None => (width, (directory.one(tag::ROWS_PER_STRIP).unwrap_or(u64::MAX) as usize).min(height)),
        };
        let segments = directory.segments().ok_or_else(|| damaged(what, "strips without their lengths"))?;
        let row_bytes = across.checked_mul(bits).map(|b| b.div_ceil(8));
        let segment_bytes = row_bytes.and_then(|b| b.checked_mul(down));
        let (Some(row_bytes), Some(segment_bytes), true) = (row_bytes, segment_bytes, across > 0 && down > 0)
        else {
            return Err(damaged(what, "strips of no or endless size"));
        };
        let columns = width.div_ceil(across);
        if segments.len() != columns * height.div_ceil(down) {
            return Err(damaged(what, "the number of strips does not fit its size"));
        }
        let mut dn = vec![0u16; width * height];
        for (i, &(offset, length)) in segments.iter().enumerate() {
            let (x, y) = ((i % columns) * across, (i / columns) * down);
            // The last strip may be shorter; a tile is always whole.
            let rows = down.min(height - y);
            let needed = if columns == 1 { row_bytes * rows } else { segment_bytes };
            let segment = bytes.get(offset as usize..).and_then(|b| b.get(..length as usize));
            let Some(segment) = segment.filter(|s| s.len() >= needed) else {
                return Err(damaged(what, "a strip is shorter than its rows"));
            };
            let wide = across.min(width - x);
            for (row, source) in segment.chunks_exact(row_bytes).take(rows).enumerate() {
                let start = (y + row) * width + x;
                unpack(source, bits, self.little, &mut dn[start..start + wide]);
            }
        }
        Ok(Plane { width, height, dn })
    }

    /// Applies the LinearizationTable, if there is one: stored codes to sensor values.
    pub(super) fn linearize(&self, what: &str, plane: &mut Plane) -> Result<(), RawError> {
        if !self.directory.has(tag::LINEARIZATION) {
            return Ok(());
        }
        let table: Option<Vec<u16>> = self
            .directory
            .unsigned(tag::LINEARIZATION)
            .and_then(|t| t.into_iter().map(|v| u16::try_from(v).ok()).collect());
        let Some((table, last)) = table.as_ref().and_then(|t| Some((t, *t.last()?))) else {
            return Err(damaged(what, "its linearization table cannot be read"));
        };
        for dn in &mut plane.dn {
            *dn = table.get(usize::from(*dn)).copied().unwrap_or(last);
        }
        Ok(())
    }
}

/// One row: 16-bit values in the file's byte order, all others packed from the most significant bit down.
fn unpack(source: &[u8], bits: usize, little: bool, out: &mut [u16]) {
    if bits == 16 {
        for (out, pair) in out.iter_mut().zip(source.chunks_exact(2)) {
            let pair = [pair[0], pair[1]];
            *out = if little { u16::from_le_bytes(pair) } else { u16::from_be_bytes(pair) };
        }
        return;
    }
    let mask = (1u32 << bits) - 1;
    let mut waiting = 0u32;
    let mut have = 0;
    let mut bytes = source.iter();
    for out in out {
        while have < bits {
            waiting = waiting << 8 | u32::from(bytes.next().copied().unwrap_or(0));
            have += 8;
        }
        have -= bits;
        *out = (waiting >> have & mask) as u16;
    }
}

fn damaged(what: &str, why: impl Into<String>) -> RawError {
    RawError::Damaged { what: what.to_owned(), why: why.into() }
}

fn unsupported(what: &str, how: String) -> RawError {
    RawError::Unsupported { what: what.to_owned(), how }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fourteen_bit_values_are_packed_from_the_top() {
        let mut out = [0; 4];
        unpack(&[0xff, 0xfc, 0, 0x10, 0, 0x80, 0x01], 14, true, &mut out);
        assert_eq!(out, [0x3fff, 0x0001, 0x0002, 0x0001]);
    }

    #[test]
    fn sixteen_bit_values_follow_the_files_byte_order() {
        let mut out = [0; 2];
        unpack(&[1, 2, 3, 4], 16, false, &mut out);
        assert_eq!(out, [0x0102, 0x0304]);
    }
}
