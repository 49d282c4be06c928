//! Things that resemble an object without being it, made from the object's own crops.

mod body;
mod fill;
mod outline;
mod solid;

use self::body::Body;
use self::fill::Fill;
use self::outline::Outline;
use crate::backgrounds::{Backgrounds, Scratch};
use crate::crop::Crop;
use crate::error::{Error, Result};
use crate::sample_rng::SampleRng;
use image::{Rgba, RgbaImage};

/// Photo kept around each decoy, for blending, in pixels.
const MARGIN: u32 = 16;
/// Largest side of a decoy, in pixels.
const LARGEST: f64 = 4096.0;

/// `count` decoys for [`Synthesizer::new`](crate::Synthesizer::new) to scatter as distractors: other forms filled with
/// an object's own colours, and an object's outline filled with something else.
///
/// A network that meets nothing but its objects on photographs learns their colour, or the seams of pasting, and finds
/// everything that has these. The paper's remedy is to photograph what is mistaken for the object and to train again;
/// decoys need no photograph, and come before the first mistake. Half of them are filled with a piece of an object's
/// own texture, a quarter with one of its colours and a quarter with a piece of a photo. They are flat (a polygon, an
/// ellipse, a rounded box or a wavy blob with faces of different brightness), boxes, or round things like buckets; some
/// of those with a photo's colours have the outline of an object. Nothing with an object's own colours has an outline
/// that overlaps that of its crop by more than nine tenths, mirrored or not, both stretched to one size: of a ball or a
/// box there are fewer forms of decoys. Outlines of other crops are not looked at.
///
/// Decoy *i* is a pure function of seed, crops, photos and *i*.
///
/// # Errors
///
/// [`Error::NoCrops`] if decoys are asked for and there is no crop, [`Error::EmptyMask`] for a crop without an object
/// pixel, and those of reading a photo.
///
/// ```
/// # use image::{Rgba, RgbaImage};
/// use synth::{Backgrounds, Crop, decoys};
///
/// let crop = Crop { image: RgbaImage::from_pixel(30, 40, Rgba([90, 60, 30, 255])), class: 1, name: String::new() };
/// let decoys = decoys(&[crop], &Backgrounds::procedural(0, 2)?, 0, 5)?;
/// assert!(decoys.iter().all(|decoy| decoy.class == 0 && decoy.image.pixels().any(|pixel| pixel[3] > 0)));
/// # Ok::<(), synth::Error>(())
/// ```
pub fn decoys(crops: &[Crop], photos: &Backgrounds, seed: u64, count: usize) -> Result<Vec<Crop>> {
    if crops.is_empty() && count > 0 {
        return Err(Error::NoCrops { what: "object crops" });
    }
    let mut scratch = Scratch::default();
    (0..count).map(|index| decoy(crops, photos, seed, index, &mut scratch)).collect()
}

fn decoy(crops: &[Crop], photos: &Backgrounds, seed: u64, index: usize, scratch: &mut Scratch) -> Result<Crop> {
    // A stream that no sample of the same seed has.
    let mut rng = SampleRng::new(seed, u64::MAX - index as u64);
    let crop = &crops[rng.below(crops.len())];
    let bounds = crop.object_bounds().ok_or_else(|| Error::EmptyMask { name: crop.name.clone() })?;
    let sides = [bounds.2 - bounds.0 + 1, bounds.3 - bounds.1 + 1];
    let is_photo = rng.chance(0.25);
    let size = sides.map(|side| (rng.uniform((0.4, 1.1)) * f64::from(side)).round().clamp(4.0, LARGEST));
    let size = size.map(|side| side as u32);
    let body = if is_photo && rng.chance(0.4) {
        Body::flat(Outline::of_crop(crop, bounds), size, &mut rng)
    } else {
        unlike(crop, bounds, size, is_photo, &mut rng)
    };
    let canvas = size.map(|side| side + 2 * MARGIN);
    let mut photo = |rng: &mut SampleRng| {
        let aspect = f64::from(canvas[0]) / f64::from(canvas[1]);
        photos.draw(rng, aspect, 0.2, (canvas[0], canvas[1]), scratch, Vec::new())
    };
    let around = photo(&mut rng)?;
    let fill = if is_photo { Fill::photo(photo(&mut rng)?) } else { Fill::of_object(crop, bounds, &mut rng) };
    let image = RgbaImage::from_fn(canvas[0], canvas[1], |x, y| {
        // -1 to 1 within the size asked for.
        let place = [(x, size[0]), (y, size[1])]
            .map(|(at, side)| 2.0 * (f64::from(at) - f64::from(MARGIN) + 0.5) / f64::from(side) - 1.0);
        let Some(spot) = body.at(place) else {
            let [r, g, b] = around.get_pixel(x, y).0;
            return Rgba([r, g, b, 0]);
        };
        let [r, g, b] = fill.colour(spot);
        Rgba([r, g, b, 255])
    });
    Ok(Crop { image, class: 0, name: format!("decoy {index}") })
}

/// A form that is not mistaken for the object, whatever its colours; a wavy blob if too many are.
fn unlike(crop: &Crop, bounds: (u32, u32, u32, u32), size: [u32; 2], is_photo: bool, rng: &mut SampleRng) -> Body {
    const TRIES: u32 = 20;
    const ALIKE: f64 = 0.9;
    for _ in 0..TRIES {
        let body = Body::draw(size, rng);
        if is_photo || body.likeness(crop, bounds) < ALIKE {
            return body;
        }
    }
    Body::flat(Outline::wavy(rng), size, rng)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn crop() -> Crop {
        let image = RgbaImage::from_fn(60, 80, |x, y| {
            let inside = (5..55).contains(&x) && (10..70).contains(&y);
            Rgba([40, 150 + (x % 8) as u8, 60, if inside { 255 } else { 0 }])
        });
        Crop { image, class: 1, name: "box".to_owned() }
    }

    #[test]
    fn decoys_repeat_each_alone_and_differ() {
        let photos = Backgrounds::procedural(3, 4).unwrap();
        let all = decoys(&[crop()], &photos, 7, 12).unwrap();
        let fewer = decoys(&[crop()], &photos, 7, 5).unwrap();
        assert!(fewer.iter().zip(&all).all(|(a, b)| a.image == b.image));
        assert!(all.windows(2).all(|pair| pair[0].image != pair[1].image));
        assert!(all[0].image != decoys(&[crop()], &photos, 8, 1).unwrap()[0].image);
    }

    /// Most decoys look like the object by colour, and no pixel of theirs lies on the canvas' rim.
    #[test]
    fn most_decoys_have_the_objects_colour_within_their_margin() {
        let decoys = decoys(&[crop()], &Backgrounds::procedural(3, 4).unwrap(), 1, 60).unwrap();
        let mut green = 0;
        for decoy in &decoys {
            let (width, height) = decoy.image.dimensions();
            let opaque = decoy.image.enumerate_pixels().filter(|(_, _, pixel)| pixel[3] > 0);
            let (mut count, mut sums) = (0_u32, [0_u32; 3]);
            for (x, y, pixel) in opaque {
                assert!(x >= MARGIN && y >= MARGIN && x + MARGIN < width && y + MARGIN < height, "{}", decoy.name);
                (0..3).for_each(|channel| sums[channel] += u32::from(pixel[channel]));
                count += 1;
            }
            assert!(count > 0, "{} is empty", decoy.name);
            green += u32::from(sums[1] > 2 * sums[0] && sums[1] > 2 * sums[2]);
        }
        assert!((36..58).contains(&green), "{green} of 60");
    }

    #[test]
    fn without_crops_there_are_no_decoys() {
        let photos = Backgrounds::procedural(3, 1).unwrap();
        assert!(decoys(&[], &photos, 0, 0).unwrap().is_empty());
        assert!(matches!(decoys(&[], &photos, 0, 1), Err(Error::NoCrops { .. })));
    }

    #[test]
    fn an_object_of_one_pixel_will_do() {
        let mut image = RgbaImage::new(3, 3);
        image.put_pixel(1, 1, Rgba([200, 90, 10, 255]));
        let crop = Crop { image, class: 1, name: String::new() };
        let decoys = decoys(&[crop], &Backgrounds::procedural(3, 1).unwrap(), 0, 40).unwrap();
        assert!(decoys.iter().all(|decoy| decoy.object_bounds().is_some()));
    }

    /// A box has no boxes of its own colours for decoys: nothing that is the object is labelled background.
    #[test]
    fn no_decoy_of_the_objects_colour_has_its_outline() {
        let (object, bounds) = (crop(), crop().object_bounds().unwrap());
        for index in 0..100 {
            let body = unlike(&object, bounds, [40, 50], false, &mut SampleRng::new(5, index));
            assert!(body.likeness(&object, bounds) < 0.9);
        }
        let square = Body::flat(Outline::of_crop(&object, bounds), [40, 50], &mut SampleRng::new(5, 0));
        assert!(square.likeness(&object, bounds) > 0.99);
    }
}
