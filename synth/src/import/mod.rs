//! Crops from the folders of other tools.
//!
//! * [`syndata`]: objects and distractors as syndata-generation (Dwibedi et al. 2017) takes them. Its backgrounds are a
//!   folder of pictures, read by [`Backgrounds::from_folder`](crate::Backgrounds::from_folder).
//! * [`bop_scene`]: the visible masks of a scene in the format of the BOP challenge.
//! * [`cutout`] and [`cutouts`]: PNG pictures with transparency.
//!
//! The margin around an object keeps the colours of the photo under alpha 0, as [`Crop::cut`](crate::Crop::cut) does.
//! A file that is broken, missing or of another size than its photo is an error with its path; nothing is skipped that
//! the settings do not leave out.

mod bop;
mod cutout;
mod picture;
mod syndata;

pub use bop::{BopConfig, bop_scene};
pub use cutout::{Surround, cutout, cutouts};
pub use syndata::{Syndata, SyndataConfig, syndata};
