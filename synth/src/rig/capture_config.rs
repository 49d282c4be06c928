//! What a set of simulated captures holds.

use cloudcrop::CameraIntrinsics;

use super::sensor::Sensor;
use super::shapes::Shape;
use super::{Error, Result};

/// What a set of simulated captures holds.
///
/// A *station* is a camera that stands still in a room, but for `jitter`, while the object is put down at many
/// places in front of it; the same view without the object is photographed too. Test frames show other rooms, each
/// from a viewpoint of its own.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default, deny_unknown_fields))]
pub struct CaptureConfig {
    /// Every random choice follows from it.
    pub seed: u64,
    /// The object.
    pub object: Shape,
    /// Number of stations, up to 65,535.
    pub stations: u32,
    /// Captures with the object per station.
    pub captures_per_station: u32,
    /// Captures without the object per station.
    pub empty_per_station: u32,
    /// Rooms that the test frames are spread over, 1 to 65,535.
    pub test_rooms: u32,
    /// Test frames in all.
    pub test_frames: u32,
    /// The colour camera; depth has the same pixels.
    pub camera: CameraIntrinsics,
    /// How the camera measures.
    pub sensor: Sensor,
    /// Greatest turn of the camera between captures of a station, degrees.
    pub jitter_deg: f64,
    /// Greatest shift of the camera between captures of a station along each axis, metres.
    pub jitter: f64,
    /// Least and greatest height of the camera above the floor, metres.
    pub height: [f64; 2],
    /// Least and greatest distance between the camera and the middle of the object, metres.
    pub distance: [f64; 2],
    /// Share of test frames with one or two decoys, things of the same green, 0 to 1.
    pub decoy_share: f64,
    /// Share of test frames in which something hides 5 to 60 % of the object, 0 to 1; in the others it is at most 3 %.
    pub occlusion_share: f64,
    /// Share of test frames without the object, 0 to 1.
    pub absent_share: f64,
}

impl Default for CaptureConfig {
    /// 80 captures of the bin and 20 without it from four stations, 40 test frames, as a Kinect of 2010 sees them.
    fn default() -> Self {
        Self {
            seed: 1,
            object: Shape::LaundryBin,
            stations: 4,
            captures_per_station: 20,
            empty_per_station: 5,
            test_rooms: 4,
            test_frames: 40,
            camera: CameraIntrinsics { fx: 570.0, fy: 570.0, cx: 319.5, cy: 239.5, width: 640, height: 480 },
            sensor: Sensor::kinect_v1(),
            jitter_deg: 0.3,
            jitter: 0.004,
            height: [0.9, 1.6],
            distance: [1.2, 2.2],
            decoy_share: 0.5,
            occlusion_share: 0.3,
            absent_share: 0.0,
        }
    }
}

impl CaptureConfig {
    pub(crate) fn validate(&self) -> Result<()> {
        let refuse = |field, found: String, needed| Err(Error::Config { field, found, needed });
        if self.stations > 65_535 {
            return refuse("stations", self.stations.to_string(), "at most 65535");
        }
        if !(1..=65_535).contains(&self.test_rooms) {
            return refuse("test_rooms", self.test_rooms.to_string(), "1 to 65535");
        }
        for (field, range, needed) in [
            ("height", self.height, "two heights from 0.3 to 2.3 m, the lower one first"),
            ("distance", self.distance, "two distances from 0.3 to 6 m, the smaller one first"),
        ] {
            let [low, high] = range;
            let most = if field == "height" { 2.3 } else { 6.0 };
            if !(low >= 0.3 && high <= most && low <= high) {
                return refuse(field, format!("{range:?}"), needed);
            }
        }
        for (field, share) in [
            ("decoy_share", self.decoy_share),
            ("occlusion_share", self.occlusion_share),
            ("absent_share", self.absent_share),
        ] {
            if !(0.0..=1.0).contains(&share) {
                return refuse(field, share.to_string(), "0 to 1");
            }
        }
        if !(0.0..=30.0).contains(&self.jitter_deg) {
            return refuse("jitter_deg", self.jitter_deg.to_string(), "0 to 30 degrees");
        }
        if !(0.0..=0.3).contains(&self.jitter) {
            return refuse("jitter", self.jitter.to_string(), "0 to 0.3 m");
        }
        Ok(())
    }
}
