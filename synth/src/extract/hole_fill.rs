use super::component::DIRECTIONS;

/// What is known about a pixel of a mask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pixel {
    Object,
    Background,
    /// No depth: decided by its surroundings.
    Unknown,
}

/// Of the eight directions, so many must meet the object for a pixel without depth to belong to it.
///
/// Inside a hole all eight do, in a bay of the silhouette five or six. The shadow that a projector throws beside an
/// object meets it on one side only: at most three or four.
const VOTES: u32 = 5;

/// Turns unknown pixels that the object surrounds into object, all other unknown pixels into background.
///
/// From each unknown pixel eight rays run to the first known pixel; [`VOTES`] of them must end on the object.
/// Rays that leave the picture do not vote for it.
pub(super) fn fill(pixels: &mut [Pixel], width: usize) {
    let mut votes = vec![0_u8; pixels.len()];
    for direction in DIRECTIONS {
        cast(pixels, width, direction, &mut votes);
    }
    for (pixel, votes) in pixels.iter_mut().zip(votes) {
        if *pixel == Pixel::Unknown {
            let surrounded = u32::from(votes) >= VOTES;
            *pixel = if surrounded { Pixel::Object } else { Pixel::Background };
        }
    }
}

/// Adds one vote to each unknown pixel whose ray in `direction` first meets the object.
///
/// Pixels are visited against the ray, so each takes over what its neighbour has already seen.
fn cast(pixels: &[Pixel], width: usize, (dx, dy): (isize, isize), votes: &mut [u8]) {
    let height = pixels.len() / width;
    let mut meets = vec![false; pixels.len()];
    for row in 0..height {
        let y = if dy > 0 { height - 1 - row } else { row };
        for column in 0..width {
            let x = if dx > 0 { width - 1 - column } else { column };
            let here = y * width + x;
            let (nx, ny) = (x as isize + dx, y as isize + dy);
            let inside = (0..width as isize).contains(&nx) && (0..height as isize).contains(&ny);
            meets[here] = match pixels[here] {
                Pixel::Object => true,
                Pixel::Background => false,
                Pixel::Unknown => inside && meets[ny as usize * width + nx as usize],
            };
            if pixels[here] == Pixel::Unknown && meets[here] {
                votes[here] += 1;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(rows: &[&str]) -> Vec<Pixel> {
        rows.concat()
            .chars()
            .map(|c| match c {
                '#' => Pixel::Object,
                '?' => Pixel::Unknown,
                _ => Pixel::Background,
            })
            .collect()
    }

    #[test]
    fn holes_and_bays_fill_but_shadows_do_not() {
        let mut pixels = parse(&[
            ".........", //
            ".#####??.",
            ".#??##??.",
            ".#??##??.",
            ".##?###?.",
            ".........",
        ]);
        fill(&mut pixels, 9);
        let expected = parse(&[
            ".........", //
            ".#####...",
            ".#####...",
            ".#####...",
            ".######..",
            ".........",
        ]);
        assert_eq!(pixels, expected);
    }
}
