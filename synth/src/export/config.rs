use super::shard::Shard;
use crate::error::{Result, require};

/// What is written for each sample besides its label map.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default, deny_unknown_fields))]
pub struct ExportConfig {
    /// File format of the pictures. Default PNG.
    pub images: Images,
    /// COCO instances with run-length encoded visible masks: `annotations.json`. Default false.
    ///
    /// Category ids are the classes, `file_name` is relative to `images`, distractors are left out.
    pub coco: bool,
    /// YOLO detection boxes beside the label maps, and `data.yaml`: YOLO's class *k* is class *k + 1*. Default false.
    pub yolo: bool,
    /// Pascal VOC detection boxes: `voc/00000000.xml`. Default false.
    pub voc: bool,
    /// Names of the classes 1, 2, … for COCO, YOLO and VOC. Default none: `class1`, `class2`, …
    pub class_names: Vec<String>,
    /// The part of the samples that this run writes. Default all. A setting of the run, not of the set: not serialised.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub shard: Shard,
}

/// File format of exported pictures; label maps are always PNG.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum Images {
    /// Lossless.
    #[default]
    Png,
    /// Smaller, with small errors of colour: the file that libjpeg-turbo and `OpenCV` write, byte for byte.
    Jpeg {
        /// 1 to 100.
        quality: u8,
        /// How finely colour is kept. Default for each pixel.
        #[cfg_attr(feature = "serde", serde(default))]
        chroma: Chroma,
    },
}

/// How finely a JPEG keeps colour, as opposed to brightness.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Chroma {
    /// For each pixel (4:4:4): edges of objects keep their colours.
    #[default]
    Full,
    /// The mean of two by two pixels (4:2:0), as `OpenCV` and most cameras write: smaller and faster.
    Halved,
}

impl Images {
    /// JPEG of quality 95 with colour for each pixel.
    pub const JPEG: Self = Self::Jpeg { quality: 95, chroma: Chroma::Full };

    pub(super) fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Jpeg { .. } => "jpg",
        }
    }
}

impl ExportConfig {
    /// Checks the settings for samples of these classes (ascending).
    pub(super) fn validate(&self, classes: &[u8]) -> Result<()> {
        if let Images::Jpeg { quality, .. } = self.images {
            require((1..=100).contains(&quality), "quality", quality, "1 to 100")?;
        }
        let names = &self.class_names;
        let printable = |name: &String| !name.trim().is_empty() && !name.chars().any(char::is_control);
        require(names.iter().all(printable), "class_names", names, "printable text")?;
        let largest = usize::from(classes.last().copied().unwrap_or(0));
        require(names.is_empty() || names.len() >= largest, "class_names", names, "none, or one for each class")
    }

    /// Name of class `class`, 1 to 255.
    pub(super) fn class_name(&self, class: u8) -> String {
        let given = usize::from(class).checked_sub(1).and_then(|index| self.class_names.get(index));
        given.cloned().unwrap_or_else(|| format!("class{class}"))
    }
}
