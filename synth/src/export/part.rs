use super::config::{ExportConfig, Images};
use super::{coco, jpeg, voc, yolo};
use crate::synthesizer::Sample;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::error::EncodingError;
use image::{ExtendedColorType, ImageEncoder as _, ImageError, ImageFormat, ImageResult};
use std::path::{Path, PathBuf};

/// One of the files of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    Label,
    Image,
    Yolo,
    Voc,
    Coco,
}

impl Part {
    /// The files that are asked for.
    pub(super) fn wanted(config: &ExportConfig) -> Vec<Self> {
        let optional = [(Self::Yolo, config.yolo), (Self::Voc, config.voc), (Self::Coco, config.coco)];
        let chosen = optional.into_iter().filter(|(_, wanted)| *wanted).map(|(part, _)| part);
        [Self::Label, Self::Image].into_iter().chain(chosen).collect()
    }

    /// The folder it lies in.
    pub(super) fn folder(self) -> &'static str {
        match self {
            Self::Image => "images",
            Self::Label | Self::Yolo => "labels",
            Self::Voc => "voc",
            Self::Coco => coco::RECORDS,
        }
    }

    pub(super) fn path(self, folder: &Path, index: u64, images: Images) -> PathBuf {
        let extension = match self {
            Self::Image => images.extension(),
            Self::Label => "png",
            Self::Yolo => "txt",
            Self::Voc => "xml",
            Self::Coco => "json",
        };
        folder.join(self.folder()).join(format!("{index:08}.{extension}"))
    }

    /// Writes the content of the file to `bytes`, in place of what they held.
    pub(super) fn encode(
        self,
        sample: &Sample,
        index: u64,
        config: &ExportConfig,
        bytes: &mut Vec<u8>,
    ) -> ImageResult<()> {
        let (width, height) = sample.image.dimensions();
        bytes.clear();
        match self {
            // Most pixels of a label map are as the one above: what is left are zeros, which pack fast.
            Self::Label => {
                png(bytes, FilterType::Up).write_image(&sample.label, width, height, ExtendedColorType::L8)?;
            }
            Self::Image => match config.images {
                Images::Png => {
                    let encoder = png(bytes, FilterType::Adaptive);
                    encoder.write_image(&sample.image, width, height, ExtendedColorType::Rgb8)?;
                }
                Images::Jpeg { quality, chroma } => {
                    jpeg::encode(&sample.image, quality, chroma, bytes)
                        .map_err(|fault| ImageError::Encoding(EncodingError::new(ImageFormat::Jpeg.into(), fault)))?;
                }
            },
            Self::Yolo => bytes.extend(yolo::boxes(sample).into_bytes()),
            Self::Voc => bytes.extend(voc::annotation(sample, &image_name(index, config), config).into_bytes()),
            Self::Coco => bytes.extend(coco::record(sample, index, &image_name(index, config)).into_bytes()),
        }
        Ok(())
    }
}

fn png(bytes: &mut Vec<u8>, filter: FilterType) -> PngEncoder<&mut Vec<u8>> {
    PngEncoder::new_with_quality(bytes, CompressionType::Fast, filter)
}

fn image_name(index: u64, config: &ExportConfig) -> String {
    format!("{index:08}.{}", config.images.extension())
}
