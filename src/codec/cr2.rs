//! Writing a Canon CR2 in the layout of the EOS 5DS, which rawloader, rawler, dcraw and LibRaw read.
//!
//! Takes a whole sensor (masked border included) and settings, gives the file's bytes. The layout: two directories,
//! EXIF and maker's notes beside the first; sensor data as lossless JPEG of four components with half as many lines
//! as the sensor has rows, cut into two vertical slices. Levels stand in the notes' colour data, where dcraw and
//! rawler look for them. It serves the simulated camera and the measurements of what decoding costs.

use super::canon;
use super::dng::{exif_date, rational};
use super::ljpeg::{self, Scan};
use crate::pair::Settings;
use crate::raster::Image;

/// Sites of a 5DS's sensor: width, height, border included.
pub const SENSOR: (usize, usize) = (8896, 5920);
/// Masked columns at the left.
pub const BORDER_LEFT: usize = 160;
/// Masked rows at the top.
pub const BORDER_TOP: usize = 64;
/// The body whose layout this is: decoders go by the name.
pub const MODEL: &str = "Canon EOS 5DS";

/// What a CR2 is made from.
#[derive(Clone, Copy, Debug)]
pub struct Cr2Content<'a> {
    /// The whole sensor, 14-bit DN, filters red first (RGGB): [`BORDER_LEFT`] masked columns, [`BORDER_TOP`] masked
    /// rows, then the picture. Width a multiple of 8, height even.
    pub sensor: &'a Image<u16>,
    /// Black in DN, as the camera notes it.
    pub black: u16,
    /// Saturation in DN, as the camera notes it.
    pub white: u16,
    /// Settings; make and model are the 5DS's whatever they say here, the rest is written where it is.
    pub settings: &'a Settings,
}

/// Why no CR2 could be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Cr2Error {
    /// A size that the layout cannot hold.
    #[error(
        "a CR2 in the 5DS layout needs a sensor wider than its {BORDER_LEFT} and higher than its {BORDER_TOP} masked sites, a multiple of 8 wide, even in height, at most 65535 either way; got {width} x {height}"
    )]
    Size {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// A value of more than 14 bits.
    #[error("a CR2 holds values up to 16383 DN, but the sensor has one of {dn}; scale or clip it first")]
    Value {
        /// The value.
        dn: u16,
    },
}

/// Encodes a CR2.
pub fn encode(content: &Cr2Content) -> Result<Vec<u8>, Cr2Error> {
    let sensor = content.sensor;
    let (width, height) = (sensor.width(), sensor.height());
    let fits = width > BORDER_LEFT
        && height > BORDER_TOP
        && width.is_multiple_of(8)
        && height.is_multiple_of(2)
        && width.max(height) <= usize::from(u16::MAX);
    if !fits {
        return Err(Cr2Error::Size { width, height });
    }
    if let Some(&dn) = sensor.pixels().iter().find(|&&dn| dn > 0x3fff) {
        return Err(Cr2Error::Value { dn });
    }
    let slice = width / 2;
    let mut samples = Vec::with_capacity(width * height);
    for from in [0, slice] {
        samples.extend(sensor.pixels().chunks_exact(width).flat_map(|row| &row[from..from + slice]).copied());
    }
    let scan = Scan { width: slice as u16, height: (height / 2) as u16, components: 4, precision: 14 };
    let jpeg = ljpeg::encode(&samples, scan).ok_or(Cr2Error::Size { width, height })?;
    drop(samples);
    let mut file = directories(content, slice as u16, jpeg.len() as u32);
    file.extend_from_slice(&jpeg);
    Ok(file)
}

/// Everything before the sensor data.
fn directories(content: &Cr2Content, slice: u16, jpeg_length: u32) -> Vec<u8> {
    let (width, height) = (content.sensor.width() as u16, content.sensor.height() as u16);
    let settings = content.settings;
    let taken = settings.taken_at.as_deref().map(exif_date);
    let mut main = Directory::default();
    main.shorts(256, &[width]);
    main.shorts(257, &[height]);
    main.shorts(258, &[8, 8, 8]);
    main.shorts(259, &[6]);
    main.ascii(271, Some("Canon"));
    main.ascii(272, Some(MODEL));
    main.longs(273, &[0]);
    main.shorts(274, &[1]);
    main.longs(279, &[0]);
    main.ascii(306, taken.as_deref());
    main.longs(34665, &[0]);

    let mut exif = Directory::default();
    exif.ratio(33434, settings.shutter.map(|t| t.0));
    exif.ratio(33437, settings.aperture.map(|n| n.0));
    let program = settings.exposure_program.as_deref().and_then(super::exif::program_number);
    exif.shorts(34850, program.as_slice());
    let iso = settings.iso.map(|iso| iso.0.round());
    exif.shorts(34855, iso.map(|iso| iso.min(65535.0) as u16).as_slice());
    exif.longs(34866, iso.filter(|iso| *iso >= 65535.0).map(|iso| iso as u32).as_slice());
    exif.put(36864, 7, 4, b"0230".to_vec());
    exif.ascii(36867, taken.as_deref());
    exif.ratio(37386, settings.focal_length_mm);
    exif.put(37500, 7, 0, Vec::new());
    let balance = settings.white_balance.as_deref().and_then(super::exif::white_balance_number);
    exif.shorts(41987, balance.as_slice());
    exif.ascii(42033, settings.serial.as_deref());
    exif.ascii(42036, settings.lens.as_deref());
    let notes = notes(content);

    let mut raw = Directory::default();
    raw.shorts(259, &[6]);
    raw.longs(273, &[0]);
    raw.longs(279, &[jpeg_length]);
    raw.longs(0xc5d8, &[1]);
    raw.longs(0xc5e0, &[1]);
    raw.shorts(0xc640, &[1, slice, slice]);
    raw.longs(0xc6c5, &[1]);

    let main_at = 16;
    let exif_at = main_at + main.length();
    let notes_at = exif_at + exif.length();
    let raw_at = notes_at + notes.length();
    let data_at = raw_at + raw.length();
    main.point(34665, 1, exif_at);
    exif.point(37500, notes.length(), notes_at);
    raw.point(273, 1, data_at);

    let mut file = b"II*\0\x10\0\0\0CR\x02\0".to_vec();
    file.extend(raw_at.to_le_bytes());
    main.write(&mut file, raw_at);
    exif.write(&mut file, 0);
    notes.write(&mut file, 0);
    raw.write(&mut file, 0);
    file
}

/// Canon's notes: settings, body, borders of the sensor, levels.
fn notes(content: &Cr2Content) -> Directory {
    let sensor = content.sensor;
    let (drive, focus, lighting) = canon::numbers(content.settings);
    let mut notes = Directory::default();
    if drive.is_some() || focus.is_some() {
        // Counted from 1 after their length in bytes; -1 stands for what the body does not tell.
        let mut camera = [0u16; 49];
        camera[0] = 98;
        camera[canon::QUALITY] = 4;
        camera[canon::DRIVE] = drive.unwrap_or(-1) as u16;
        camera[canon::FOCUS] = focus.unwrap_or(-1) as u16;
        notes.shorts(canon::CAMERA_SETTINGS, &camera);
    }
    notes.ascii(0x0006, Some(MODEL));
    notes.ascii(0x0007, Some("Firmware Version 1.1.2"));
    notes.longs(0x0010, &[0x8000_0382]);
    let edges = [sensor.width(), sensor.height(), BORDER_LEFT, BORDER_TOP].map(|v| v as u16);
    let [wide, high, left, top] = edges;
    let mut borders = [0u16; 17];
    borders[0] = 34;
    borders[1..3].copy_from_slice(&[wide, high]);
    borders[3..9].copy_from_slice(&[1, 1, left, top, wide - 1, high - 1]);
    notes.shorts(0x00e0, &borders);
    let mut colours = [0u16; 1560];
    colours[0] = 12;
    colours[0x3f..0x43].copy_from_slice(&[2000, 1024, 1024, 1700]);
    colours[0x30a..0x30e].copy_from_slice(&[content.black; 4]);
    colours[0x30e..0x310].copy_from_slice(&[content.white - content.white / 10, content.white]);
    notes.shorts(0x4001, &colours);
    if lighting.iter().any(Option::is_some) {
        let mut options = [0u32; 12];
        options[0] = 48;
        let places = [canon::TONE_PRIORITY, canon::LONG_EXPOSURE, canon::HIGH_ISO];
        for (at, number) in places.into_iter().zip(lighting) {
            options[at] = number.unwrap_or(-1) as u32;
        }
        notes.longs(canon::LIGHTING, &options);
    }
    notes
}

/// A little-endian TIFF directory whose longer values stand right behind it. Entries come in the order of tags.
#[derive(Default)]
struct Directory {
    entries: Vec<Entry>,
}

struct Entry {
    tag: u16,
    kind: u16,
    count: u32,
    data: Vec<u8>,
    /// Where the value stands, if not here.
    elsewhere: Option<u32>,
}

impl Directory {
    fn put(&mut self, tag: u16, kind: u16, count: u32, data: Vec<u8>) {
        self.entries.push(Entry { tag, kind, count, data, elsewhere: None });
    }

    /// Values, if any.
    fn shorts(&mut self, tag: u16, values: &[u16]) {
        if !values.is_empty() {
            self.put(tag, 3, values.len() as u32, values.iter().flat_map(|v| v.to_le_bytes()).collect());
        }
    }

    /// Values, if any.
    fn longs(&mut self, tag: u16, values: &[u32]) {
        if !values.is_empty() {
            self.put(tag, 4, values.len() as u32, values.iter().flat_map(|v| v.to_le_bytes()).collect());
        }
    }

    fn ascii(&mut self, tag: u16, text: Option<&str>) {
        if let Some(text) = text {
            let data = [text.as_bytes(), &[0]].concat();
            self.put(tag, 2, data.len() as u32, data);
        }
    }

    fn ratio(&mut self, tag: u16, value: Option<f64>) {
        if let Some(ratio) = value.map(rational) {
            self.put(tag, 5, 1, [ratio.n.to_le_bytes(), ratio.d.to_le_bytes()].concat());
        }
    }

    /// Makes the entry with `tag` say that its `count` values stand at `at`.
    fn point(&mut self, tag: u16, count: u32, at: u32) {
        for entry in self.entries.iter_mut().filter(|e| e.tag == tag) {
            (entry.count, entry.elsewhere) = (count, Some(at));
        }
    }

    /// Length in bytes, values included.
    fn length(&self) -> u32 {
        let values = self.entries.iter().filter(|e| e.data.len() > 4).map(|e| even(e.data.len()));
        6 + 12 * self.entries.len() as u32 + values.sum::<u32>()
    }

    /// Appends itself to `file`; `next` is where the next directory stands, 0 if there is none.
    fn write(&self, file: &mut Vec<u8>, next: u32) {
        let mut values_at = (file.len() + 6 + 12 * self.entries.len()) as u32;
        file.extend((self.entries.len() as u16).to_le_bytes());
        for entry in &self.entries {
            file.extend(entry.tag.to_le_bytes());
            file.extend(entry.kind.to_le_bytes());
            file.extend(entry.count.to_le_bytes());
            if let Some(at) = entry.elsewhere {
                file.extend(at.to_le_bytes());
            } else if entry.data.len() > 4 {
                file.extend(values_at.to_le_bytes());
                values_at += even(entry.data.len());
            } else {
                let mut short = [0; 4];
                short[..entry.data.len()].copy_from_slice(&entry.data);
                file.extend(short);
            }
        }
        file.extend(next.to_le_bytes());
        for entry in self.entries.iter().filter(|e| e.data.len() > 4) {
            file.extend_from_slice(&entry.data);
            if entry.data.len() % 2 != 0 {
                file.push(0);
            }
        }
    }
}

fn even(length: usize) -> u32 {
    length.next_multiple_of(2) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::raw;
    use crate::photometry::{Cfa, LevelSource};
    use crate::units::{FNumber, Iso, Seconds};

    fn settings() -> Settings {
        Settings {
            make: Some("Canon".into()),
            model: Some(MODEL.into()),
            serial: Some("083022000039".into()),
            lens: Some("EF100mm f/2.8L Macro IS USM".into()),
            shutter: Some(Seconds(1.0 / 125.0)),
            aperture: Some(FNumber(11.0)),
            iso: Some(Iso(100.0)),
            focal_length_mm: Some(100.0),
            exposure_program: Some("Manual".into()),
            white_balance: Some("Manual".into()),
            taken_at: Some("2026-05-04T10:00:04".into()),
            focus_mode: Some("Manual Focus (3)".into()),
            drive_mode: Some("Single".into()),
            highlight_tone_priority: Some("Off".into()),
            long_exposure_noise_reduction: Some("Off".into()),
            high_iso_noise_reduction: Some("Off".into()),
        }
    }

    fn sensor(width: usize, height: usize) -> Image<u16> {
        Image::from_fn(width, height, |x, y| {
            let noise = ((x * 7919 + y * 104_729) ^ (x * y)) % 61;
            let masked = x < BORDER_LEFT || y < BORDER_TOP;
            (if masked { 2017 + noise } else { 2100 + (x * 11 + y * 17) % 13_000 + noise }) as u16
        })
    }

    #[test]
    fn what_is_written_is_read_back_site_by_site_with_its_settings() {
        let (sensor, settings) = (sensor(640, 400), settings());
        let content = Cr2Content { sensor: &sensor, black: 2047, white: 15_283, settings: &settings };
        let photo = raw::decode(&encode(&content).unwrap(), "made.cr2").unwrap();
        assert_eq!(photo.settings, settings);
        let dn = &photo.mosaic.dn;
        // rawloader's table leaves the last two columns out.
        assert_eq!((dn.width(), dn.height()), (640 - BORDER_LEFT - 2, 400 - BORDER_TOP));
        for y in 0..dn.height() {
            for x in 0..dn.width() {
                assert_eq!(dn.at(x, y), sensor.at(x + BORDER_LEFT, y + BORDER_TOP), "{x}, {y}");
            }
        }
        assert_eq!(photo.mosaic.cfa, Cfa::RGGB);
        assert_eq!(photo.mosaic.levels.black_source, LevelSource::MaskedPixels);
    }

    #[test]
    fn the_extremes_of_fourteen_bits_come_back() {
        let extremes = Image::from_fn(176, 80, |x, y| if (x * 3 + y) % 2 == 0 { 0 } else { 0x3fff });
        let settings = Settings::default();
        let content = Cr2Content { sensor: &extremes, black: 0, white: 0x3fff, settings: &settings };
        let file = encode(&content).unwrap();
        let rawloader::RawImageData::Integer(plane) = rawloader::decode(&mut file.as_slice()).unwrap().data
        else {
            panic!("floating point");
        };
        assert_eq!(plane, extremes.pixels());
    }

    #[test]
    fn sizes_and_values_that_do_not_fit_are_refused() {
        let settings = settings();
        let of = |sensor: &Image<u16>| {
            encode(&Cr2Content { sensor, black: 2047, white: 15_283, settings: &settings }).map(|_| ())
        };
        assert!(matches!(of(&sensor(644, 400)), Err(Cr2Error::Size { width: 644, .. })));
        assert!(matches!(of(&sensor(640, 64)), Err(Cr2Error::Size { .. })));
        let bright = Image::from_fn(640, 400, |_, _| 16_384);
        assert!(matches!(of(&bright), Err(Cr2Error::Value { dn: 16_384 })));
    }
}
