/// Pixels of an image that belong together, as row-major indices.
pub(super) type Component = Vec<u32>;

/// Components of `candidates`; two candidates within `reach` pixels along a row, column or diagonal are neighbours if
/// `joined(first, second)` holds for their row-major indices.
pub(super) fn components(
    candidates: &[bool],
    width: usize,
    reach: usize,
    joined: impl Fn(usize, usize) -> bool,
) -> Vec<Component> {
    let mut open = candidates.to_vec();
    let mut found = Vec::new();
    for seed in 0..open.len() {
        if open[seed] {
            found.push(grow(seed, &mut open, width, reach, &joined));
        }
    }
    found
}

fn grow(
    seed: usize,
    open: &mut [bool],
    width: usize,
    reach: usize,
    joined: &impl Fn(usize, usize) -> bool,
) -> Component {
    let height = open.len() / width;
    let mut component = vec![seed as u32];
    let mut next = 0;
    open[seed] = false;
    while let Some(&pixel) = component.get(next) {
        next += 1;
        let pixel = pixel as usize;
        for neighbour in around(pixel, width, height, reach) {
            if open[neighbour] && joined(pixel, neighbour) {
                open[neighbour] = false;
                component.push(neighbour as u32);
            }
        }
    }
    component
}

/// The eight directions of the pixel grid.
pub(super) const DIRECTIONS: [(isize, isize); 8] =
    [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)];

fn around(pixel: usize, width: usize, height: usize, reach: usize) -> impl Iterator<Item = usize> {
    let (x, y) = ((pixel % width) as isize, (pixel / width) as isize);
    let (width, height) = (width as isize, height as isize);
    (1..=reach as isize).flat_map(move |step| {
        DIRECTIONS.iter().filter_map(move |&(dx, dy)| {
            let (x, y) = (x + step * dx, y + step * dy);
            let inside = (0..width).contains(&x) && (0..height).contains(&y);
            inside.then_some((y * width + x) as usize)
        })
    })
}

/// The components in the order of their summed weight, largest first; ties stay in row order.
pub(super) fn heaviest_first(components: Vec<Component>, weight: impl Fn(u32) -> f64) -> Vec<Component> {
    let total = |component: &Component| component.iter().map(|&pixel| weight(pixel)).sum::<f64>();
    let mut weighed: Vec<(f64, Component)> = components.into_iter().map(|found| (total(&found), found)).collect();
    weighed.sort_by(|(first, _), (second, _)| second.total_cmp(first));
    weighed.into_iter().map(|(_, component)| component).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reach_bridges_a_gap_and_a_jump_parts() {
        let candidates = [true, true, false, true, true];
        assert_eq!(components(&candidates, 5, 1, |_, _| true).len(), 2);
        assert_eq!(components(&candidates, 5, 2, |_, _| true).len(), 1);
        let parted = components(&candidates, 5, 2, |a, b| (a < 3) == (b < 3));
        assert_eq!(parted, vec![vec![0, 1], vec![3, 4]]);
    }

    #[test]
    fn the_heaviest_comes_first_and_ties_stay() {
        let found = vec![vec![0], vec![5, 6], vec![3], vec![8, 9, 10]];
        let ordered = heaviest_first(found, |pixel| if pixel == 3 { 2.5 } else { 1.0 });
        assert_eq!(ordered, [vec![8, 9, 10], vec![3], vec![5, 6], vec![0]]);
    }

    #[test]
    fn rows_do_not_wrap_around() {
        let candidates = [false, false, true, true, false, false];
        assert_eq!(components(&candidates, 3, 1, |_, _| true).len(), 2);
    }
}
