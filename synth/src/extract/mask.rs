use super::camera_check::CameraCheck;
use super::component::{Component, components, heaviest_first};
use super::empty_scene::EmptyScene;
use super::extract_config::ExtractConfig;
use super::hole_fill::{Pixel, fill};
use super::nearness::Comparison;
use super::quality::CropQuality;
use crate::depth::DepthImage;
use crate::error::{Error, Result};
use image::{GrayImage, Luma};
use imageproc::distance_transform::Norm;
use imageproc::morphology;

/// An object's mask and how far to trust it.
#[derive(Clone, Debug)]
pub struct Extraction {
    /// 255 on the object, 0 elsewhere; the size of the depth image.
    pub mask: GrayImage,
    /// Figures to accept or reject the mask by.
    pub quality: CropQuality,
}

/// Finds the object that stands in front of the empty scene.
///
/// 1. A robust affine drift of `1/z` between frame and empty scene is fitted and removed ([`Drift`](crate::Drift)).
/// 2. Pixels *nearer* than the empty scene by [`weak`](ExtractConfig::weak) standard deviations (over a plane,
///    [`weak_over_plane`](ExtractConfig::weak_over_plane)) are candidates. Only
///    nearer ones: an object stands in front of the empty scene, and what has become farther was taken away.
///    Single ones among others that are not (speckle) are dropped.
/// 3. Connected candidates form components; each needs pixels beyond [`strong`](ExtractConfig::strong), a tenth of
///    them more than edges of the empty scene that appear [beside their place](ExtractConfig::sideways_px) explain.
///    Over a plane they are also cut at depth jumps, since walls and furniture beyond the object are nearer than the
///    endless plane.
/// 4. The object is the component of largest area, each pixel weighted by a Gaussian around the picture's centre
///    (standard deviation: a quarter of the diagonal), because one points the camera at the object.
/// 5. Pixels without depth that the object surrounds join it; closing and opening smooth the outline; the largest
///    piece remains.
///
/// # Errors
///
/// [`Error::SizeMismatch`] if frame and empty scene differ, [`Error::NoDepth`] if the frame has no reading,
/// [`Error::NoPlane`] if a plane is to be fitted and there is none, [`Error::NoChange`] if nothing stands in front,
/// [`Error::CameraMoved`] if the frame shows another view than the empty scene ([`CameraCheck`](crate::CameraCheck)),
/// [`Error::InvalidConfig`] for values out of range.
///
/// ```
/// use image::Luma;
/// use synth::{DepthImage, EmptyScene, ExtractConfig, extract_mask};
///
/// let table = DepthImage::from_pixel(64, 48, Luma([1.0]));
/// let mut with_box = table.clone();
/// for (x, y) in (20..40).flat_map(|x| (10..30).map(move |y| (x, y))) {
///     with_box.put_pixel(x, y, Luma([0.9]));
/// }
/// let found = extract_mask(&with_box, &EmptyScene::from_frames(&[table])?, &ExtractConfig::default())?;
/// assert!(found.quality.area_px.abs_diff(400) <= 4); // opening rounds the corners
/// # Ok::<(), synth::Error>(())
/// ```
pub fn extract_mask(depth: &DepthImage, empty: &EmptyScene, config: &ExtractConfig) -> Result<Extraction> {
    let scene = Compared::new(depth, empty, config)?;
    let mut owners = scene.owners();
    let mut largest = scene.largest_refused;
    for index in 0..scene.components.len() {
        match scene.object(index, &mut owners, config) {
            Ok(object) => return Ok(object),
            Err(TooSmall(area)) => largest = largest.max(area),
        }
    }
    Err(Error::NoChange { found: largest, needed: config.min_area_px })
}

/// Finds every object that stands in front of the empty scene, the [heaviest](extract_mask) first.
///
/// The steps are those of [`extract_mask`], whose object is the first of the list. Objects that touch each other in the
/// picture are one unless the empty scene is a plane and their depths jump. Masks do not overlap.
///
/// # Errors
///
/// Those of [`extract_mask`], but for [`Error::NoChange`]: an empty list says that nothing stands there.
///
/// ```
/// use image::Luma;
/// use synth::{DepthImage, EmptyScene, ExtractConfig, extract_objects};
///
/// let table = DepthImage::from_pixel(64, 48, Luma([1.0]));
/// let mut with_boxes = table.clone();
/// for (x, y) in (8..20).chain(30..56).flat_map(|x| (10..30).map(move |y| (x, y))) {
///     with_boxes.put_pixel(x, y, Luma([0.9]));
/// }
/// let found = extract_objects(&with_boxes, &EmptyScene::from_frames(&[table])?, &ExtractConfig::default())?;
/// let bounds: Vec<[u32; 4]> = found.iter().map(|object| object.quality.bounds_px).collect();
/// assert_eq!(bounds, [[30, 10, 26, 20], [8, 10, 12, 20]]); // left, top, width, height
/// # Ok::<(), synth::Error>(())
/// ```
pub fn extract_objects(depth: &DepthImage, empty: &EmptyScene, config: &ExtractConfig) -> Result<Vec<Extraction>> {
    let scene = Compared::new(depth, empty, config)?;
    let mut owners = scene.owners();
    Ok((0..scene.components.len()).filter_map(|index| scene.object(index, &mut owners, config).ok()).collect())
}

/// A frame with what may be objects in it.
struct Compared {
    comparison: Comparison,
    /// The heaviest first.
    components: Vec<Component>,
    /// Pixels of the largest change that is too small for an object.
    largest_refused: usize,
}

/// What smoothing left of a component, in pixels.
struct TooSmall(usize);

/// Owner of a pixel that belongs to no component.
const FREE: u32 = u32::MAX;

impl Compared {
    fn new(depth: &DepthImage, empty: &EmptyScene, config: &ExtractConfig) -> Result<Self> {
        let comparison = Comparison::new(depth, empty, config)?;
        CameraCheck::of(&comparison, empty, config).require_still()?;
        let found = changes(&comparison, &Grouping::new(empty, config), config);
        let (found, refused): (Vec<_>, Vec<_>) =
            found.into_iter().partition(|component| component.len() >= config.min_area_px);
        let largest_refused = refused.iter().map(Vec::len).max().unwrap_or(0);
        let components = heaviest_first(found, |pixel| centrality(pixel, comparison.size.0, comparison.size.1));
        Ok(Self { comparison, components, largest_refused })
    }

    /// For each pixel the component it belongs to.
    fn owners(&self) -> Vec<u32> {
        let mut owners = vec![FREE; self.comparison.nearer.len()];
        for (index, component) in self.components.iter().enumerate() {
            for &pixel in component {
                owners[pixel as usize] = index as u32;
            }
        }
        owners
    }

    /// The object of a component, whose pixels it then owns.
    fn object(
        &self,
        index: usize,
        owners: &mut [u32],
        config: &ExtractConfig,
    ) -> std::result::Result<Extraction, TooSmall> {
        let raw = self.with_holes_filled(index as u32, owners);
        let mask = smoothed(&raw, index as u32, owners, config)?;
        for (owner, &value) in owners.iter_mut().zip(mask.as_raw()) {
            if value > 0 {
                *owner = index as u32;
            }
        }
        let quality = CropQuality::of(&mask, &raw, &self.comparison, config.strong);
        Ok(Extraction { mask, quality })
    }

    /// The pixels of a component, and those without depth that it surrounds.
    fn with_holes_filled(&self, index: u32, owners: &[u32]) -> GrayImage {
        let kind = |(&owner, nearer): (&u32, &f32)| match owner {
            _ if owner == index => Pixel::Object,
            FREE if nearer.is_nan() => Pixel::Unknown,
            _ => Pixel::Background,
        };
        let mut pixels: Vec<Pixel> = owners.iter().zip(&self.comparison.nearer).map(kind).collect();
        let (width, height) = self.comparison.size;
        fill(&mut pixels, width as usize);
        GrayImage::from_fn(width, height, |u, v| {
            let pixel = pixels[(v * width + u) as usize];
            Luma([if pixel == Pixel::Object { 255 } else { 0 }])
        })
    }
}

/// Which pixels are candidates and which neighbours belong together.
struct Grouping {
    weak: f32,
    depth_jump: Option<f32>,
}

impl Grouping {
    fn new(empty: &EmptyScene, config: &ExtractConfig) -> Self {
        if empty.is_plane() {
            Self { weak: config.weak_over_plane, depth_jump: Some(config.depth_jump) }
        } else {
            Self { weak: config.weak, depth_jump: None }
        }
    }
}

/// Pixels beyond `weak` whose 3x3 surroundings, as far as they have depth, are beyond it too by majority.
///
/// Where a small error remains in the empty scene, a part of the noise passes a low threshold; without this, such
/// speckle would grow onto the object.
fn without_speckle(nearer: &[f32], weak: f32, (width, height): (usize, usize)) -> Vec<bool> {
    let mut kept = vec![false; nearer.len()];
    for y in 0..height {
        for x in 0..width {
            let pixel = y * width + x;
            if nearer[pixel] > weak {
                let (mut known, mut beyond) = (0, 0);
                for v in y.saturating_sub(1)..(y + 2).min(height) {
                    for &t in &nearer[v * width + x.saturating_sub(1)..v * width + (x + 2).min(width)] {
                        known += u32::from(!t.is_nan());
                        beyond += u32::from(t > weak);
                    }
                }
                kept[pixel] = 2 * beyond > known;
            }
        }
    }
    kept
}

/// Components of candidates that something before the empty scene must have made.
fn changes(comparison: &Comparison, grouping: &Grouping, config: &ExtractConfig) -> Vec<Component> {
    let (width, height) = comparison.size;
    let (nearer, inverse) = (&comparison.nearer, &comparison.inverse);
    let candidates = without_speckle(nearer, grouping.weak, (width as usize, height as usize));
    let joined = |first: usize, second: usize| {
        grouping.depth_jump.is_none_or(|jump| {
            let (p, q) = (inverse[first], inverse[second]);
            (p - q).abs() <= jump * p.min(q)
        })
    };
    let reach = usize::from(config.closing_px).max(1);
    let mut found = components(&candidates, width as usize, reach, joined);
    let edges = comparison.nearest_edge(usize::from(config.sideways_px), config.strong);
    found.retain(|component| {
        let strong = |&&pixel: &&u32| nearer[pixel as usize] > config.strong;
        let beyond_edges = |&&pixel: &&u32| nearer[pixel as usize] > config.strong + edges[pixel as usize];
        let unexplained = component.iter().filter(beyond_edges).count();
        unexplained > 0 && UNEXPLAINED_DIVISOR * unexplained >= component.iter().filter(strong).count()
    });
    found
}

/// Of the strong pixels of an object, one in this many must not be explained by the scene's edges beside their place.
const UNEXPLAINED_DIVISOR: usize = 10;

/// Gaussian around the centre of the picture, standard deviation a quarter of the diagonal.
fn centrality(pixel: u32, width: u32, height: u32) -> f64 {
    let x = f64::from(pixel % width) - 0.5 * f64::from(width - 1);
    let y = f64::from(pixel / width) - 0.5 * f64::from(height - 1);
    let (w, h) = (f64::from(width), f64::from(height));
    let variance = (w * w + h * h) / 16.0;
    (-0.5 * (x * x + y * y) / variance).exp()
}

/// Closing, opening and the largest 8-connected piece of what is left, on pixels that no other component owns.
fn smoothed(
    raw: &GrayImage,
    index: u32,
    owners: &[u32],
    config: &ExtractConfig,
) -> std::result::Result<GrayImage, TooSmall> {
    let mut mask = raw.clone();
    if config.closing_px > 0 {
        mask = morphology::close(&mask, Norm::L2, config.closing_px);
        for (value, &owner) in mask.iter_mut().zip(owners) {
            if owner != FREE && owner != index {
                *value = 0;
            }
        }
    }
    if config.opening_px > 0 {
        mask = morphology::open(&mask, Norm::L2, config.opening_px);
    }
    let candidates: Vec<bool> = mask.as_raw().iter().map(|&value| value > 0).collect();
    let pieces = components(&candidates, mask.width() as usize, 1, |_, _| true);
    let largest = heaviest_first(pieces, |_| 1.0).into_iter().next().unwrap_or_default();
    if largest.len() < config.min_area_px.max(1) {
        return Err(TooSmall(largest.len()));
    }
    mask.fill(0);
    for pixel in largest {
        mask.as_mut()[pixel as usize] = 255;
    }
    Ok(mask)
}
