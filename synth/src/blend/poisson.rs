use super::blender::grey_of_many;
use super::domain::Domain;
use super::guidance::{Guidance, Scene};
use super::multigrid::{CHANNELS, Multigrid, Solved};
use super::source::Source;
use crate::bit_row::intervals;
use crate::dispatch::dispatched;
use image::RgbImage;

/// Seamless cloning (Pérez, Gangnet and Blake 2003) and its buffers.
///
/// Solved for is the *difference* between result and photo: it is harmonic inside the mask, equals picture minus photo
/// just outside it (eq. 10 and 14: the membrane), and is smooth, which suits multigrid. With `mixed`, the guidance is
/// the stronger of both gradients per pair of pixels and channel (eq. 13), and the difference has sources.
#[derive(Clone, Debug, Default)]
pub(super) struct Poisson {
    domain: Domain,
    guidance: Guidance,
    multigrid: Multigrid,
}

/// What there was to solve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Cloned {
    /// No pixel is at least half covered: nothing is changed.
    Nothing,
    /// The object covers the whole picture: it touches no background, so that only its own colours are known.
    ///
    /// Any other part of an object has background beside it, as a picture is connected.
    Everything,
    By(Solved),
}

impl Poisson {
    /// Blends `source` into `picture`; leaves it alone unless the answer is [`Cloned::By`].
    pub(super) fn blend(&mut self, picture: &mut RgbImage, source: Source, mixed: bool) -> Cloned {
        let Self { domain, guidance, multigrid } = self;
        if !domain.set(source, picture.dimensions()) {
            return Cloned::Nothing;
        }
        if domain.fills(picture.dimensions()) {
            return Cloned::Everything;
        }
        let scene = Scene { domain, picture, source };
        multigrid.prepare(&domain.unknown, (domain.width, domain.height), domain.borders);
        guidance.write_equations(scene, multigrid.finest(), mixed);
        let solved = multigrid.solve().unwrap_or_else(|| multigrid.solve_slowly());
        write(domain, source, multigrid, picture);
        Cloned::By(solved)
    }
}

dispatched! {
    /// Adds the solution to the photo.
    fn write(domain: &Domain, source: Source, multigrid: &mut Multigrid, picture: &mut RgbImage) = write_body
}

#[inline(always)]
fn write_body(domain: &Domain, source: Source, multigrid: &mut Multigrid, picture: &mut RgbImage) {
    let pitch = picture.width() as usize;
    let rectangle = source.rectangle();
    // Domain to picture and to source: column and row 1 are the first pixel inside the ring.
    let offset = domain.left - rectangle.left;
    let mut photo = vec![0; CHANNELS * domain.width + 1];
    for y in 1..domain.height - 1 {
        let row = domain.top + y - 1;
        let solution = multigrid.solution_row(y);
        let colours = source.row(row - rectangle.top);
        for (first, last) in intervals(domain.unknown.row(y)) {
            let count = CHANNELS * (last - first);
            colours.bytes(offset + first - 1, &mut photo[..=count]);
            let start = CHANNELS * (row * pitch + domain.left + first - 1);
            add(&photo[..count], &solution[CHANNELS * first..][..count], &mut picture.as_mut()[start..][..count]);
        }
    }
}

#[inline(always)]
fn add(photo: &[u8], difference: &[f32], sum: &mut [u8]) {
    for ((sum, photo), difference) in sum.iter_mut().zip(photo).zip(difference) {
        *sum = grey_of_many(f32::from(*photo) + difference);
    }
}

#[cfg(test)]
impl Poisson {
    /// Solves again the domain of the last call, until that changes nothing, and writes the result.
    fn solve_whole(&mut self, picture: &mut RgbImage, source: Source) {
        let Self { domain, guidance, multigrid } = self;
        multigrid.prepare(&domain.unknown, (domain.width, domain.height), domain.borders);
        guidance.write_equations(Scene { domain, picture, source }, multigrid.finest(), false);
        multigrid.solve_slowly();
        write(domain, source, multigrid, picture);
    }
}

#[cfg(test)]
#[path = "poisson_tests.rs"]
mod tests;
