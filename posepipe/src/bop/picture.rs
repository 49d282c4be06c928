//! Colour, depth and mask pictures, read without guessing.

use std::{io::Cursor, path::Path};

use image::{ColorType, DynamicImage, GrayImage, ImageBuffer, ImageDecoder, ImageFormat, ImageReader, Luma, RgbImage};

use super::{
    MILLIMETRES,
    file::{data_error, read_bytes},
};
use crate::{Error, Result};

/// Depth along the optical axis in metres; `0.0` = no reading.
pub type DepthImage = ImageBuffer<Luma<f32>, Vec<f32>>;

/// The last chunk of every complete PNG: length 0, name, checksum.
const PNG_END: [u8; 12] = [0, 0, 0, 0, b'I', b'E', b'N', b'D', 0xAE, 0x42, 0x60, 0x82];

/// Reads a colour or grey picture (PNG or JPEG) as colour.
///
/// # Errors
///
/// [`Error::Io`] if the file cannot be read, [`Error::Data`] if it is neither PNG nor JPEG or was cut short (decoders
/// accept a JPEG without its end), [`Error::Image`] if it cannot be decoded.
pub fn read_color(path: &Path) -> Result<RgbImage> {
    let (image, _) = decode(path, &[ImageFormat::Png, ImageFormat::Jpeg])?;
    Ok(image.into_rgb8())
}

/// Reads a 16-bit single-channel PNG as depth in metres: value x `depth_scale` / 1000.
///
/// `depth_scale` is the factor from stored values to millimetres, as in `scene_camera.json`.
///
/// # Errors
///
/// [`Error::Invalid`] if `depth_scale` is not positive, [`Error::Data`] if the file is no 16-bit single-channel PNG or was
/// cut short, [`Error::Io`] and [`Error::Image`] if it cannot be read or decoded.
pub fn read_depth(path: &Path, depth_scale: f64) -> Result<DepthImage> {
    if !(depth_scale.is_finite() && depth_scale > 0.0) {
        return Err(Error::Invalid(format!("depth scale {depth_scale}: a positive number is needed")));
    }
    let (image, stored) = decode(path, &[ImageFormat::Png])?;
    let DynamicImage::ImageLuma16(values) = image else {
        return Err(data_error(path, format!("depth is {stored:?}, 16-bit single-channel PNG is needed")));
    };
    let (width, height) = values.dimensions();
    let metres = values.into_raw().into_iter().map(|value| (f64::from(value) * depth_scale / MILLIMETRES) as f32);
    ImageBuffer::from_vec(width, height, metres.collect()).ok_or_else(|| data_error(path, "image has too few pixels"))
}

/// Reads a single-channel 8-bit PNG as mask: 0 background, 255 object (any other value than 0 in the file).
///
/// # Errors
///
/// [`Error::Data`] if the file is no single-channel PNG of at most 8 bits or was cut short, [`Error::Io`] and
/// [`Error::Image`] if it cannot be read or decoded.
pub fn read_mask(path: &Path) -> Result<GrayImage> {
    let (image, stored) = decode(path, &[ImageFormat::Png])?;
    let DynamicImage::ImageLuma8(mut mask) = image else {
        return Err(data_error(path, format!("mask is {stored:?}, 8-bit single-channel PNG is needed")));
    };
    for pixel in mask.iter_mut().filter(|pixel| **pixel != 0) {
        *pixel = 255;
    }
    Ok(mask)
}

/// Decodes a complete picture of one of the `accepted` formats, with the colour type it was decoded to.
fn decode(path: &Path, accepted: &[ImageFormat]) -> Result<(DynamicImage, ColorType)> {
    let bytes = read_bytes(path)?;
    if bytes.is_empty() {
        return Err(data_error(path, "file is empty"));
    }
    let format = accepted_format(path, &bytes, accepted)?;
    if !is_complete(&bytes, format) {
        return Err(data_error(path, format!("{} has no end marker: the file was cut short", name(format))));
    }
    let image_error = |source| Error::Image { path: path.to_owned(), source };
    let decoder =
        ImageReader::with_format(Cursor::new(bytes.as_slice()), format).into_decoder().map_err(image_error)?;
    let stored = decoder.color_type();
    Ok((DynamicImage::from_decoder(decoder).map_err(image_error)?, stored))
}

/// The format by content, whatever the file is called.
fn accepted_format(path: &Path, bytes: &[u8], accepted: &[ImageFormat]) -> Result<ImageFormat> {
    let needed = || accepted.iter().map(|format| name(*format)).collect::<Vec<_>>().join(" or ");
    match image::guess_format(bytes) {
        Ok(format) if accepted.contains(&format) => Ok(format),
        Ok(format) => Err(data_error(path, format!("found {}, {} is needed", name(format), needed()))),
        Err(_) => Err(data_error(path, format!("not a picture by its first bytes, {} is needed", needed()))),
    }
}

fn name(format: ImageFormat) -> String {
    match format {
        ImageFormat::Jpeg => "JPEG".into(),
        ImageFormat::Png => "PNG".into(),
        other => format!("{other:?}"),
    }
}

fn is_complete(bytes: &[u8], format: ImageFormat) -> bool {
    match format {
        ImageFormat::Jpeg => jpeg_is_complete(bytes),
        _ => bytes.windows(PNG_END.len()).rev().any(|window| window == PNG_END),
    }
}

/// Whether the end marker FFD9 follows the scan data.
///
/// Segments before the first scan are stepped over by their length, since the thumbnail in one has an end marker of its
/// own; inside scan data FF is always followed by 00 or a restart marker (ITU-T T.81, B.1.1.5), so FFD9 there is the end.
fn jpeg_is_complete(bytes: &[u8]) -> bool {
    const START_OF_SCAN: u8 = 0xDA;
    let mut at = 2;
    loop {
        let Some(&[0xFF, marker, high, low]) = bytes.get(at..at + 4) else {
            return false;
        };
        if marker == 0xFF {
            at += 1; // fill byte
            continue;
        }
        let after = at + 2 + usize::from(u16::from_be_bytes([high, low]));
        if marker == START_OF_SCAN {
            return bytes.get(after..).is_some_and(|scan| scan.windows(2).any(|pair| pair == [0xFF, 0xD9]));
        }
        at = after;
    }
}
