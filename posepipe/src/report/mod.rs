//! Pictures and pages for the eye: overlays, reprojections, contact sheets, histograms, data sheets.
//!
//! Drawing functions return new pictures; [`save_png`], [`save_svg`] and [`DataSheet::write`] write files, each beside
//! its name first and then renamed.
//!
//! ```
//! use image::{GrayImage, Luma, Rgb, RgbImage};
//! use posepipe::report::{MaskStyle, contact_sheet, ContactSheet, draw_mask};
//!
//! # fn main() -> posepipe::Result<()> {
//! let photo = RgbImage::from_pixel(64, 48, Rgb([90, 90, 90]));
//! let mask = GrayImage::from_fn(64, 48, |x, y| Luma([if x.abs_diff(32) + y.abs_diff(24) < 15 { 255 } else { 0 }]));
//! let found = draw_mask(&photo, &mask, &MaskStyle::default())?;
//! let sheet = contact_sheet(&[(&photo, "photo"), (&found, "found")], &ContactSheet::default())?;
//! assert!(sheet.width() > 2 * photo.width());
//! # Ok(())
//! # }
//! ```

mod checkerboard;
mod contact_sheet;
mod data_sheet;
mod font;
mod histogram_svg;
mod mask_overlay;
mod model_overlay;
mod save;
mod text;
mod wireframe;

pub use checkerboard::on_checkerboard;
pub use contact_sheet::{ContactSheet, contact_sheet};
pub use data_sheet::DataSheet;
pub use histogram_svg::{HistogramStyle, histogram_svg};
pub use mask_overlay::{MaskStyle, draw_mask};
pub use model_overlay::{ModelStyle, draw_model};
pub use save::{save_png, save_svg};
pub use text::{draw_text, text_size};
pub use wireframe::{box_edges, draw_axes, draw_edges};
