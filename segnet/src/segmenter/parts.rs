//! Parts of a segmentation that the network is nowhere sure of.

/// Gives to the background, of probabilities `[classes, height, width]`, every part whose class is nowhere as likely as
/// `peak`. A part is pixels of one likeliest class that touch at sides or corners.
pub(super) fn leave_out_unsure(planes: &mut [f32], size: [usize; 2], peak: f32) {
    let pixels = size[0] * size[1];
    // Becomes 0 where a part has been dealt with.
    let mut classes: Vec<usize> = (0..pixels).map(|pixel| likeliest(planes, pixels, pixel)).collect();
    let mut part = Vec::new();
    for first in 0..pixels {
        let class = classes[first];
        if class == 0 {
            continue;
        }
        collect_part(&mut classes, size, first, &mut part);
        if part.iter().all(|pixel| planes[class * pixels + pixel] < peak) {
            for &pixel in &part {
                planes.iter_mut().skip(pixel).step_by(pixels).for_each(|probability| *probability = 0.0);
                planes[pixel] = 1.0;
            }
        }
    }
}

/// The pixels of `first`'s class that hang together with it; `classes` is 0 there from then on.
fn collect_part(classes: &mut [usize], [height, width]: [usize; 2], first: usize, part: &mut Vec<usize>) {
    let class = std::mem::take(&mut classes[first]);
    part.clear();
    part.push(first);
    let mut done = 0;
    while let Some(&pixel) = part.get(done) {
        done += 1;
        let (y, x) = (pixel / width, pixel % width);
        for row in y.saturating_sub(1)..(y + 2).min(height) {
            for column in x.saturating_sub(1)..(x + 2).min(width) {
                let near = row * width + column;
                if classes[near] == class {
                    classes[near] = 0;
                    part.push(near);
                }
            }
        }
    }
}

/// The background before others, lower classes before higher ones.
fn likeliest(planes: &[f32], pixels: usize, pixel: usize) -> usize {
    let probabilities = planes.iter().skip(pixel).step_by(pixels).enumerate();
    let best = probabilities.fold((0, f32::MIN), |best, (class, p)| if *p > best.1 { (class, *p) } else { best });
    best.0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Probabilities of one class from a drawing: digits are tenths, two pictures side by side are two classes.
    fn planes(classes: [&str; 2]) -> Vec<f32> {
        let drawn = classes.map(|drawing| -> Vec<f32> {
            let digits = drawing.chars().filter(|c| !c.is_whitespace());
            digits.map(|c| if c == '.' { 0.0 } else { 0.1 * f32::from(c as u8 - b'0') }).collect()
        });
        let background = drawn[0].iter().zip(&drawn[1]).map(|(a, b)| 1.0 - a - b);
        background.chain(drawn[0].iter().copied()).chain(drawn[1].iter().copied()).collect()
    }

    #[test]
    fn parts_stay_whole_or_go_by_their_most_certain_pixel() {
        let first = "6.6..
                     .9..4
                     ....7";
        let second = "...8.
                      ...6.
                      6....";
        let before = planes([first, second]);
        let mut after = before.clone();
        leave_out_unsure(&mut after, [3, 5], 0.75);
        // The first class' part on the right goes, and the second one's at the lower left.
        let expected = planes([
            "6.6..
             .9..4
             .....",
            "...8.
             ...6.
             .....",
        ]);
        assert_eq!(after, expected);
        let mut all = before.clone();
        leave_out_unsure(&mut all, [3, 5], 0.5);
        assert_eq!(all, before);
        leave_out_unsure(&mut all, [3, 5], 0.95);
        assert!(all[..15].iter().enumerate().all(|(pixel, p)| *p == if pixel == 9 { before[9] } else { 1.0 }));
    }

    #[test]
    fn parts_of_two_classes_that_touch_are_two() {
        let mut found = planes(["96", ".."]);
        leave_out_unsure(&mut found, [1, 2], 0.8);
        assert_eq!(found, planes(["96", ".."]));
        let mut found = planes(["9.", ".6"]);
        leave_out_unsure(&mut found, [1, 2], 0.8);
        assert_eq!(found, planes(["9.", ".."]));
    }
}
