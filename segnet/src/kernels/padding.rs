//! Images with their padding around them.

use super::crew::for_each_slice;
use super::workspace::Workspace;
use super::{Shape, Window};

/// Size of an image with all pixels that the window covers.
pub(super) fn padded_shape(shape: Shape, window: &Window) -> Shape {
    let covered = |axis: usize| (window.output[axis] - 1) * window.stride + window.kernel;
    Shape { height: covered(0), width: covered(1), ..shape }
}

/// The pixels of `padded` images that begin `before` rows above and columns left of those of `input`, zeros outside.
pub(super) fn padded_copy(input: &[f32], shape: Shape, padded: Shape, before: [usize; 2]) -> Workspace {
    let mut copy = Workspace::zeros(padded.len());
    let columns = shape.width.min(padded.width.saturating_sub(before[1])) * shape.channels;
    let row = padded.width * padded.channels;
    if columns == 0 {
        return copy; // padding alone
    }
    for_each_slice(&mut copy, COPIED * row, |chunk, rows| {
        for (index, to) in rows.chunks_exact_mut(row).enumerate() {
            let (image, y) = ((chunk * COPIED + index) / padded.height, (chunk * COPIED + index) % padded.height);
            if let Some(y) = y.checked_sub(before[0]).filter(|y| *y < shape.height) {
                let from = (image * shape.height + y) * shape.width * shape.channels;
                to[before[1] * shape.channels..][..columns].copy_from_slice(&input[from..from + columns]);
            }
        }
    });
    copy
}

/// Rows a chunk copies.
const COPIED: usize = 32;
