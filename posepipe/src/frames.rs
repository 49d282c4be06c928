use std::path::PathBuf;
use std::rc::Rc;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::bop::{BopScene, BopSplit};
use crate::{Error, Result};

/// Which frames of each scene to take, by their place in the sorted list of image numbers.
///
/// The even and odd halves share no picture: teach on one, test on the other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FrameSelection {
    /// Every frame.
    #[default]
    All,
    /// The first, third, fifth ... frame (index 0, 2, 4 ...).
    Even,
    /// The second, fourth ... frame (index 1, 3, 5 ...).
    Odd,
}

impl FrameSelection {
    /// Whether the frame at `index` of its scene is taken.
    #[must_use]
    pub fn takes(self, index: usize) -> bool {
        match self {
            Self::All => true,
            Self::Even => index.is_multiple_of(2),
            Self::Odd => !index.is_multiple_of(2),
        }
    }
}

impl FromStr for FrameSelection {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        match text {
            "all" => Ok(Self::All),
            "even" => Ok(Self::Even),
            "odd" => Ok(Self::Odd),
            other => Err(Error::Invalid(format!("frames `{other}`: needed all, even or odd"))),
        }
    }
}

/// Some frames of a data set in BOP format.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrameSet {
    /// Root folder of the data set.
    pub root: PathBuf,
    /// Split below the root, `train` for instance.
    pub split: String,
    /// Which frames of each scene.
    pub frames: FrameSelection,
}

impl FrameSet {
    /// The folder of the split.
    #[must_use]
    pub fn folder(&self) -> PathBuf {
        self.root.join(&self.split)
    }

    /// The selected frames as scene and image number, sorted by both.
    ///
    /// # Errors
    ///
    /// [`Error::Data`] if the split holds no such frame, and whatever keeps its folders from being read.
    pub fn list(&self) -> Result<Vec<(Rc<BopScene>, u32)>> {
        let split = BopSplit::open(&self.folder())?;
        let mut found = Vec::new();
        for id in split.scenes() {
            let scene = Rc::new(split.scene(id)?);
            for (index, info) in scene.frames().iter().enumerate() {
                if self.frames.takes(index) {
                    found.push((Rc::clone(&scene), info.image));
                }
            }
        }
        if found.is_empty() {
            return Err(Error::data(self.folder(), "no frames found, at least one is needed"));
        }
        Ok(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn even_and_odd_share_no_frame_and_cover_all() {
        for index in 0..10 {
            assert!(FrameSelection::All.takes(index));
            assert_ne!(FrameSelection::Even.takes(index), FrameSelection::Odd.takes(index));
        }
        assert!(FrameSelection::Even.takes(0));
        assert!("third".parse::<FrameSelection>().is_err());
    }
}
