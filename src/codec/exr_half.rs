//! OpenEXR with 16-bit floats, one layer, wavelet-compressed: small files of many channels whose values carry
//! noise of a tenth of a percent anyway. Bytes in and out, so that they may lie inside the program.

use super::asset::MAX_PIXELS;
use exr::prelude as exr;
use exr::{ReadChannels, ReadLayers, WritableImage};
use std::io::Cursor;

/// A picture of named channels, each row-major with `width * height` values.
#[derive(Clone, Debug, PartialEq)]
pub struct Planes {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Name and values of each channel, in alphabetical order when read.
    pub channels: Vec<(String, Vec<f32>)>,
}

/// The bytes are not an OpenEXR picture, or the picture cannot be written as one.
#[derive(Debug, thiserror::Error)]
#[error("cannot {action} an OpenEXR picture: {reason}")]
pub struct PlanesError {
    action: &'static str,
    reason: String,
}

impl Planes {
    /// Values of a channel; `None` if there is none of that name.
    pub fn channel(&self, name: &str) -> Option<&[f32]> {
        Some(&self.channels.iter().find(|(n, _)| n == name)?.1)
    }
}

/// Encodes channels; values are rounded to 11 significant bits and must lie within +-65504.
pub fn encode(planes: &Planes) -> Result<Vec<u8>, PlanesError> {
    let fail = |reason: String| PlanesError { action: "write", reason };
    let size = planes.width * planes.height;
    if size == 0 || planes.channels.is_empty() || planes.channels.iter().any(|(_, v)| v.len() != size) {
        return Err(fail("every channel must have one value a pixel, and there must be some".into()));
    }
    let list = planes
        .channels
        .iter()
        .map(|(name, values)| {
            let name = exr::Text::new_or_none(name)
                .ok_or_else(|| fail(format!("channel name {name:?} is not plain text")))?;
            let values = values.iter().map(|&v| exr::f16::from_f32(v)).collect();
            Ok(exr::AnyChannel::new(name, exr::FlatSamples::F16(values)))
        })
        .collect::<Result<_, PlanesError>>()?;
    let layer = exr::Layer::new(
        exr::Vec2(planes.width, planes.height),
        exr::LayerAttributes::default(),
        exr::Encoding {
            compression: exr::Compression::PIZ,
            blocks: exr::Blocks::ScanLines,
            line_order: exr::LineOrder::Increasing,
        },
        exr::AnyChannels::sort(list),
    );
    let mut bytes = Cursor::new(Vec::new());
    exr::Image::from_layer(layer)
        .write()
        .non_parallel()
        .to_buffered(&mut bytes)
        .map_err(|e| fail(e.to_string()))?;
    Ok(bytes.into_inner())
}

/// Decodes the first layer's channels, whatever their number format.
pub fn decode(bytes: &[u8]) -> Result<Planes, PlanesError> {
    let fail = |error: exr::Error| PlanesError { action: "read", reason: error.to_string() };
    let headers = ::exr::meta::MetaData::read_from_buffered(bytes, true).map_err(fail)?.headers;
    if headers.iter().any(|h| h.layer_size.0.saturating_mul(h.layer_size.1) > MAX_PIXELS) {
        return Err(PlanesError {
            action: "read",
            reason: format!("it claims to have more than {MAX_PIXELS} pixels"),
        });
    }
    let image = exr::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(fail)?;
    let exr::Vec2(width, height) = image.layer_data.size;
    let channels = image
        .layer_data
        .channel_data
        .list
        .into_iter()
        .map(|c| (c.name.to_string(), c.sample_data.values_as_f32().collect()))
        .collect();
    Ok(Planes { width, height, channels })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_come_back_to_eleven_bits() {
        let values: Vec<f32> = (0..60).map(|i| (i as f32 * 0.37).sin() * 3.0).collect();
        let planes = Planes {
            width: 10,
            height: 6,
            channels: vec![("flash.R".into(), values.clone()), ("ambient.R".into(), vec![0.25; 60])],
        };
        let back = decode(&encode(&planes).unwrap()).unwrap();
        assert_eq!((back.width, back.height), (10, 6));
        assert_eq!(back.channel("ambient.R").unwrap(), vec![0.25; 60]);
        for (a, b) in back.channel("flash.R").unwrap().iter().zip(&values) {
            assert!((a - b).abs() <= b.abs() / 2048.0, "{a} for {b}");
        }
    }

    #[test]
    fn other_bytes_and_cut_pictures_are_refused() {
        let planes = Planes { width: 4, height: 4, channels: vec![("Y".into(), vec![1.0; 16])] };
        let bytes = encode(&planes).unwrap();
        assert!(decode(&bytes[..bytes.len() - 9]).is_err());
        assert!(decode(b"not an image").is_err());
        assert!(encode(&Planes { width: 4, height: 5, ..planes }).is_err());
    }
}
