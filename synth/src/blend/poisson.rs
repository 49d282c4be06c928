use super::blender::grey;
use super::domain::Domain;
use super::guidance::Guidance;
use super::multigrid::{CHANNELS, Multigrid, Solved, interleave};
use super::source::Source;
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
        multigrid.prepare(&domain.unknown, domain.width, domain.height, domain.borders);
        guidance.read(domain, picture, source, mixed);
        guidance.write_right_hand_side(multigrid.finest());
        let solved = multigrid.solve();
        write(domain, guidance, multigrid, picture);
        Cloned::By(solved)
    }
}

dispatched! {
    /// Adds the solution to the photo.
    fn write(domain: &Domain, guidance: &Guidance, multigrid: &mut Multigrid, picture: &mut RgbImage) = write_body
}

#[inline(always)]
fn write_body(domain: &Domain, guidance: &Guidance, multigrid: &mut Multigrid, picture: &mut RgbImage) {
    let level = multigrid.finest();
    let pitch = picture.width() as usize;
    let mut rows = [const { Vec::new() }; CHANNELS];
    for y in 1..domain.height - 1 {
        for (channel, row) in rows.iter_mut().enumerate() {
            let [even, odd] = level.value_row(y, channel);
            row.resize(2 * even.len(), 0.0_f32);
            interleave(even, odd, row);
            for (value, difference) in row.iter_mut().zip(guidance.difference(y, channel)) {
                *value -= difference;
            }
        }
        let start = 3 * ((domain.top + y - 1) * pitch + domain.left);
        let pixels = picture.as_mut()[start..][..3 * (domain.width - 2)].as_chunks_mut::<3>().0;
        for (x, (pixel, unknown)) in pixels.iter_mut().zip(&domain.row(y)[1..]).enumerate() {
            if *unknown {
                for channel in 0..CHANNELS {
                    // Picture minus difference is the photo.
                    pixel[channel] = grey(f32::from(pixel[channel]) + rows[channel][x + 1]);
                }
            }
        }
    }
}

#[cfg(test)]
#[path = "poisson_tests.rs"]
mod tests;
