use super::picture::{has_extension, list, malformed, read};
use crate::crop::Crop;
use crate::error::{Error, Result};
use std::path::Path;

/// What lies around a cut-out, under alpha 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum Surround {
    /// The colours of the object, continued outwards.
    ///
    /// Editors leave any colour under alpha 0, mostly black, and gradient-domain blending would see a step to it.
    Extended {
        /// Width of the border around the object's bounding box, in pixels.
        margin_px: u32,
    },
    /// The colours that the file holds there: for crops that were saved with the photo around them.
    AsStored,
}

impl Default for Surround {
    fn default() -> Self {
        Self::Extended { margin_px: 16 }
    }
}

/// Reads a picture with transparency; its alpha, straight and feathered or not, is kept.
///
/// # Errors
///
/// [`Error::Io`] and [`Error::Image`] if it cannot be read, [`Error::Malformed`] if it has no alpha channel,
/// [`Error::EmptyMask`] if it is transparent throughout; all with the path.
pub fn cutout(path: impl AsRef<Path>, class: u8, surround: Surround) -> Result<Crop> {
    let path = path.as_ref();
    let picture = read(path)?;
    if !picture.color().has_alpha() {
        return Err(malformed(path, "the picture has no alpha channel, one is needed"));
    }
    let stored = Crop { image: picture.into_rgba8(), class, name: path.display().to_string() };
    if stored.object_bounds().is_none() {
        return Err(Error::EmptyMask { name: stored.name });
    }
    Ok(match surround {
        Surround::Extended { margin_px } => stored.with_extended_colours(margin_px),
        Surround::AsStored => stored,
    })
}

/// All PNG pictures of a folder (not of those below), in the order of their names, as cut-outs of one class.
///
/// # Errors
///
/// As [`cutout`]; [`Error::Malformed`] if there is no PNG file.
pub fn cutouts(folder: impl AsRef<Path>, class: u8, surround: Surround) -> Result<Vec<Crop>> {
    let folder = folder.as_ref();
    let files = list(folder)?.into_iter().filter(|path| has_extension(path, &["png"]));
    let crops = files.map(|path| cutout(path, class, surround)).collect::<Result<Vec<_>>>()?;
    if crops.is_empty() { Err(malformed(folder, "no PNG picture in this folder")) } else { Ok(crops) }
}
