use crate::error::{Result, require};

/// How the object is told from the empty scene.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default, deny_unknown_fields))]
pub struct ExtractConfig {
    /// Standard deviation of the sensor's `1/z` in 1/m, used where it cannot be measured.
    ///
    /// Default 0.0015: 1.4e-3 for the first Kinect (Khoshelham and Elberink 2012), 3.4 mm at 1.5 m.
    pub noise: f32,
    /// An object has pixels nearer than the empty scene by at least this many standard deviations. Default 6.
    pub strong: f32,
    /// Pixels connected to a strong one belong to the object from this many standard deviations on. Default 2.5.
    pub weak: f32,
    /// The same where the empty scene is a plane: real floors are not flat and sensors bend them. Default 4.5.
    ///
    /// On 58 frames of a cabinet on an office floor the mean overlap (intersection over union) with the references
    /// is 0.976 with 4.5 and 0.957 with 2.5, which lets far floor in.
    pub weak_over_plane: f32,
    /// Largest shift of `1/z` that is taken for camera motion, in 1/m; 0 switches the drift fit off. Default 0.02.
    pub max_drift: f32,
    /// Edges of the empty scene may appear up to this many pixels beside their place. Default 4.
    ///
    /// A camera that moved sideways or turned shows near things beside where they were. What is no nearer than the
    /// empty scene within this distance is explained by that, and an object needs pixels that are not. A turn of
    /// 0.3 degrees shifts the picture of a camera with a focal length of 570 px by 3 px.
    pub sideways_px: u8,
    /// The camera counts as moved if a larger share of the picture is farther than the empty scene, 0 to 1; 1 switches
    /// the check off. Default 0.1. See [`CameraCheck`](crate::CameraCheck).
    pub max_farther: f32,
    /// The camera counts as moved if a smaller share of the picture agrees with the empty scene, 0 to 1; 0 switches the
    /// check off. Default 0.05, used only with frames of the empty scene.
    pub min_support: f32,
    /// Neighbours whose depth differs by more than this share of it are not the same object. Default 0.05.
    ///
    /// Used only when the empty scene is a plane, where walls and other furniture are "nearer than the plane" too.
    pub depth_jump: f32,
    /// Gaps up to this many pixels are bridged. Default 2.
    pub closing_px: u8,
    /// Threads and tips up to twice this width are removed, in pixels. Default 1.
    pub opening_px: u8,
    /// A smaller change is not an object, in pixels. Default 100.
    pub min_area_px: usize,
}

impl Default for ExtractConfig {
    fn default() -> Self {
        Self {
            noise: 0.0015,
            strong: 6.0,
            weak: 2.5,
            weak_over_plane: 4.5,
            max_drift: 0.02,
            sideways_px: 4,
            max_farther: 0.1,
            min_support: 0.05,
            depth_jump: 0.05,
            closing_px: 2,
            opening_px: 1,
            min_area_px: 100,
        }
    }
}

impl ExtractConfig {
    pub(super) fn validate(&self) -> Result<()> {
        let positive = |value: f32| value.is_finite() && value > 0.0;
        require(positive(self.noise), "noise", self.noise, "a positive standard deviation in 1/m")?;
        require(positive(self.weak), "weak", self.weak, "a positive number")?;
        let over_plane = positive(self.weak_over_plane);
        require(over_plane, "weak_over_plane", self.weak_over_plane, "a positive number")?;
        let highest = self.weak.max(self.weak_over_plane);
        let ordered = self.strong.is_finite() && self.strong >= highest;
        require(ordered, "strong", self.strong, "a number not below `weak` and `weak_over_plane`")?;
        let drift = self.max_drift.is_finite() && self.max_drift >= 0.0;
        require(drift, "max_drift", self.max_drift, "zero or a positive shift in 1/m")?;
        let share = |value: f32| (0.0..=1.0).contains(&value);
        require(share(self.max_farther), "max_farther", self.max_farther, "a share from 0 to 1")?;
        require(share(self.min_support), "min_support", self.min_support, "a share from 0 to 1")?;
        require(positive(self.depth_jump), "depth_jump", self.depth_jump, "a positive share")
    }
}
