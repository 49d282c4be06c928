use super::conjugate_gradient;

/// Three channels and one lane of padding.
pub(super) type Value = [f32; 4];

/// A coarse correction below this many grey levels ends the iteration; a cycle reduces the error about tenfold.
const CONVERGED: f32 = 0.02;
/// Largest residual of a converged solution, in grey levels.
const RESIDUAL: f32 = 0.05;
const MAX_CYCLES: usize = 8;
/// Smoothing steps before and after the coarse correction.
const SMOOTHING: usize = 2;
/// Smoothing steps, in either order, that solve a level of a few nodes.
const COARSEST_SMOOTHING: usize = 8;
/// Levels are added until one is no wider and no higher than this.
const COARSEST_SIDE: usize = 5;

/// Which sides of the domain lie on the border of the picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Borders {
    /// Left and right.
    pub(super) columns: [bool; 2],
    /// Top and bottom.
    pub(super) rows: [bool; 2],
}

/// Solves the discrete Poisson equation on a masked domain by multigrid.
///
/// Unknown are the nodes of a mask; around them lies a ring of at least one node that is either fixed to zero
/// (Dirichlet; other values have been moved to the right-hand side) or beyond the border of the picture (Neumann: no
/// link). At each unknown node, `sum(neighbours) - links · value = right-hand side`.
///
/// Coarse levels take every second node. Their equations are finite volumes: a cell that ends at the picture's border
/// is as wide as the border allows, and a neighbour that is fixed is as far away as the mask says. Transfer is
/// bilinear interpolation and its transpose, with nodes beyond the border mirrored. See Trottenberg, Oosterlee and
/// Schüller 2001, chapters 2 and 5.
#[derive(Clone, Debug, Default)]
pub(super) struct Multigrid {
    levels: Vec<Level>,
    depth: usize,
}

#[derive(Clone, Debug, Default)]
pub(super) struct Level {
    width: usize,
    height: usize,
    borders: Borders,
    /// Width of a column's cells and height of a row's, relative to the distance of the nodes.
    column: Vec<f32>,
    row: Vec<f32>,
    /// First and one past the last unknown of each row.
    spans: Vec<(usize, usize)>,
    /// Sum of the links; zero where the node is not unknown.
    links: Vec<f32>,
    inverse_links: Vec<f32>,
    pub(super) value: Vec<Value>,
    pub(super) right: Vec<Value>,
}

/// How a solution was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Solved {
    Cycles(usize),
    ConjugateGradient(usize),
}

impl Multigrid {
    /// Sets up the levels for `unknown` nodes of a `width` x `height` domain, ring included.
    pub(super) fn prepare(&mut self, unknown: &[bool], width: usize, height: usize, borders: Borders) {
        self.level_mut(0).set_finest(unknown, width, height, borders);
        self.depth = 1;
        while self.levels[self.depth - 1].is_large() {
            let spacing = 1 << self.depth;
            self.level_mut(self.depth);
            let (fine, coarse) = self.levels.split_at_mut(self.depth);
            let any = coarse[0].set_coarse(&fine[self.depth - 1], unknown, (width, height), spacing);
            if !any {
                break;
            }
            self.depth += 1;
        }
    }

    fn level_mut(&mut self, index: usize) -> &mut Level {
        if self.levels.len() == index {
            self.levels.push(Level::default());
        }
        &mut self.levels[index]
    }

    /// The finest level, whose right-hand side is to be filled in and whose values are the solution.
    pub(super) fn finest(&mut self) -> &mut Level {
        &mut self.levels[0]
    }

    /// Cycles until the solution stands still; where that takes too long (thin, ragged objects cut by the border),
    /// conjugate gradients go on with a cycle as preconditioner.
    pub(super) fn solve(&mut self) -> Solved {
        for cycle in 1..=MAX_CYCLES {
            let correction = self.cycle(0);
            if correction < CONVERGED && self.levels[0].largest_residual() < RESIDUAL {
                return Solved::Cycles(cycle);
            }
        }
        Solved::ConjugateGradient(conjugate_gradient::solve(self))
    }

    /// Approximates the solution of `links · value - neighbours = residual` by one symmetric cycle.
    pub(super) fn precondition(&mut self, residual: &[Value], solution: &mut Vec<Value>) {
        let finest = &mut self.levels[0];
        finest.value.fill([0.0; 4]);
        for (right, residual) in finest.right.iter_mut().zip(residual) {
            *right = residual.map(|value| -value);
        }
        self.cycle(0);
        solution.clone_from(&self.levels[0].value);
    }

    /// One V-cycle from level `index` down and back; returns the largest coarse correction.
    fn cycle(&mut self, index: usize) -> f32 {
        if index + 1 == self.depth {
            self.levels[index].smooth(COARSEST_SMOOTHING, [0, 1]);
            self.levels[index].smooth(COARSEST_SMOOTHING, [1, 0]);
            return 0.0;
        }
        self.levels[index].smooth(SMOOTHING, [0, 1]);
        let (fine, coarse) = self.levels.split_at_mut(index + 1);
        coarse[0].restrict_from(&fine[index]);
        self.cycle(index + 1);
        let (fine, coarse) = self.levels.split_at_mut(index + 1);
        let correction = coarse[0].prolong_to(&mut fine[index]);
        self.levels[index].smooth(SMOOTHING, [1, 0]);
        correction
    }
}

fn reset<T: Copy>(buffer: &mut Vec<T>, length: usize, value: T) {
    buffer.clear();
    buffer.resize(length, value);
}

impl Level {
    fn resize(&mut self, width: usize, height: usize, borders: Borders) {
        let nodes = width * height;
        (self.width, self.height, self.borders) = (width, height, borders);
        reset(&mut self.column, width, 1.0);
        reset(&mut self.row, height, 1.0);
        reset(&mut self.spans, height, (0, 0));
        reset(&mut self.links, nodes, 0.0);
        reset(&mut self.inverse_links, nodes, 0.0);
        reset(&mut self.value, nodes, [0.0; 4]);
        reset(&mut self.right, nodes, [0.0; 4]);
    }

    fn is_large(&self) -> bool {
        self.width.max(self.height) > COARSEST_SIDE
    }

    fn set_finest(&mut self, unknown: &[bool], width: usize, height: usize, borders: Borders) {
        self.resize(width, height, borders);
        for y in 1..height - 1 {
            for x in 1..width - 1 {
                if unknown[y * width + x] {
                    let beyond = [
                        borders.columns[0] && x == 1,
                        borders.columns[1] && x + 2 == width,
                        borders.rows[0] && y == 1,
                        borders.rows[1] && y + 2 == height,
                    ];
                    let links = beyond.iter().filter(|&&beyond| !beyond).count();
                    self.set_unknown(x, y, links as f32);
                }
            }
        }
    }

    fn set_unknown(&mut self, x: usize, y: usize, links: f32) {
        let node = y * self.width + x;
        self.links[node] = links;
        self.inverse_links[node] = if links > 0.0 { 1.0 / links } else { 0.0 };
        let (start, end) = &mut self.spans[y];
        if *start == *end {
            *start = x;
        }
        *end = x + 1;
    }

    /// Takes every second node of `fine`, `spacing` nodes of the finest level apart; false if none is unknown.
    fn set_coarse(&mut self, fine: &Self, unknown: &[bool], finest: (usize, usize), spacing: usize) -> bool {
        self.resize((fine.width - 1).div_ceil(2) + 1, (fine.height - 1).div_ceil(2) + 1, fine.borders);
        let borders = self.borders;
        cell_sizes(&mut self.column, spacing, finest.0, borders.columns[0], borders.columns[1]);
        cell_sizes(&mut self.row, spacing, finest.1, borders.rows[0], borders.rows[1]);
        let domain = Domain { unknown, size: finest, borders };
        let mut any = false;
        for y in 1..self.height - 1 {
            let (start, end) = fine.spans[2 * y];
            for x in start.div_ceil(2)..end.div_ceil(2) {
                if fine.links[2 * y * fine.width + 2 * x] == 0.0 {
                    continue;
                }
                let (column, row) = (self.column[x], self.row[y]);
                let link = |direction| domain.link((x * spacing, y * spacing), direction, spacing);
                let links = row * (link((-1, 0)) + link((1, 0))) + column * (link((0, -1)) + link((0, 1)));
                self.set_unknown(x, y, links);
                any |= links > 0.0;
            }
        }
        any
    }

    /// Sum over the neighbours, weighted by their links.
    #[inline]
    fn neighbours(values: &[Value], node: usize, width: usize, column: f32, row: f32) -> Value {
        let (left, right) = (values[node - 1], values[node + 1]);
        let (above, below) = (values[node - width], values[node + width]);
        let mut sum = [0.0; 4];
        for lane in 0..4 {
            sum[lane] = row * (left[lane] + right[lane]) + column * (above[lane] + below[lane]);
        }
        sum
    }

    /// Gauss–Seidel over one colour of a chessboard, then the other; the reverse order after the coarse correction
    /// keeps a cycle symmetric, as conjugate gradients need it.
    fn smooth(&mut self, steps: usize, colours: [usize; 2]) {
        for _ in 0..steps {
            for colour in colours {
                for y in 1..self.height - 1 {
                    self.smooth_row(y, colour);
                }
            }
        }
    }

    fn smooth_row(&mut self, y: usize, colour: usize) {
        let (start, end) = self.spans[y];
        let row = self.row[y];
        let first = start + ((start + y + colour) & 1);
        for x in (first..end).step_by(2) {
            let node = y * self.width + x;
            let sum = Self::neighbours(&self.value, node, self.width, self.column[x], row);
            let (right, inverse) = (self.right[node], self.inverse_links[node]);
            let value = &mut self.value[node];
            for lane in 0..4 {
                value[lane] = (sum[lane] - right[lane]) * inverse;
            }
        }
    }

    /// Right-hand side minus left-hand side at an unknown node, zero at others.
    #[inline]
    fn residual(&self, x: usize, y: usize) -> Value {
        let node = y * self.width + x;
        let links = self.links[node];
        if links == 0.0 {
            return [0.0; 4];
        }
        let sum = Self::neighbours(&self.value, node, self.width, self.column[x], self.row[y]);
        std::array::from_fn(|lane| self.right[node][lane] - sum[lane] + links * self.value[node][lane])
    }

    /// `links · value - neighbours` at the unknown nodes; others are left alone.
    pub(super) fn multiply(&self, values: &[Value], product: &mut [Value]) {
        for y in 1..self.height - 1 {
            for x in self.spans[y].0..self.spans[y].1 {
                let node = y * self.width + x;
                let links = self.links[node];
                if links > 0.0 {
                    let sum = Self::neighbours(values, node, self.width, self.column[x], self.row[y]);
                    product[node] = std::array::from_fn(|lane| links * values[node][lane] - sum[lane]);
                }
            }
        }
    }

    fn largest_residual(&self) -> f32 {
        let mut largest = 0.0_f32;
        for y in 1..self.height - 1 {
            for x in self.spans[y].0..self.spans[y].1 {
                largest = self.residual(x, y).iter().fold(largest, |most, value| most.max(value.abs()));
            }
        }
        largest
    }

    /// Collects the residual of `fine` as right-hand side (transpose of bilinear interpolation) and clears the values.
    fn restrict_from(&mut self, fine: &Self) {
        self.right.fill([0.0; 4]);
        self.value.fill([0.0; 4]);
        for y in 1..fine.height - 1 {
            let (start, end) = fine.spans[y];
            let (above, below) = (y / 2, y.div_ceil(2));
            for x in start..end {
                let residual = fine.residual(x, y).map(|value| 0.25 * value);
                let (left, right) = (x / 2, x.div_ceil(2));
                for node in [(left, above), (right, above), (left, below), (right, below)] {
                    let sum = &mut self.right[node.1 * self.width + node.0];
                    for lane in 0..4 {
                        sum[lane] += residual[lane];
                    }
                }
            }
        }
        self.fold_mirrored();
    }

    /// Adds the interpolated values to the unknowns of `fine`; returns the largest addition.
    fn prolong_to(&mut self, fine: &mut Self) -> f32 {
        self.mirror();
        let mut largest = [0.0_f32; 4];
        for y in 1..fine.height - 1 {
            let (start, end) = fine.spans[y];
            let (above, below) = (y / 2 * self.width, y.div_ceil(2) * self.width);
            for x in start..end {
                let node = y * fine.width + x;
                if fine.links[node] == 0.0 {
                    continue;
                }
                let (left, right) = (x / 2, x.div_ceil(2));
                let corners = [above + left, above + right, below + left, below + right].map(|at| self.value[at]);
                let value = &mut fine.value[node];
                for lane in 0..4 {
                    let sum = corners[0][lane] + corners[1][lane] + corners[2][lane] + corners[3][lane];
                    value[lane] += 0.25 * sum;
                    largest[lane] = largest[lane].max((0.25 * sum).abs());
                }
            }
        }
        largest.into_iter().fold(0.0, f32::max)
    }

    /// Pairs of (node beyond the border, its mirror image) along the borders of the picture, columns first.
    fn mirrored(&self) -> impl DoubleEndedIterator<Item = (usize, usize)> + use<> {
        let (width, height, borders) = (self.width, self.height, self.borders);
        let columns = [(borders.columns[0], 0, 1), (borders.columns[1], width - 1, width - 2)];
        let rows = [(borders.rows[0], 0, 1), (borders.rows[1], height - 1, height - 2)];
        let columns = columns
            .into_iter()
            .filter(|side| side.0)
            .flat_map(move |(_, beyond, inside)| (0..height).map(move |y| (y * width + beyond, y * width + inside)));
        let rows = rows
            .into_iter()
            .filter(|side| side.0)
            .flat_map(move |(_, beyond, inside)| (0..width).map(move |x| (beyond * width + x, inside * width + x)));
        columns.chain(rows)
    }

    fn mirror(&mut self) {
        for (beyond, inside) in self.mirrored() {
            self.value[beyond] = self.value[inside];
        }
    }

    /// Transpose of [`mirror`](Self::mirror), and the values beyond the border back to zero.
    fn fold_mirrored(&mut self) {
        for (beyond, inside) in self.mirrored().rev() {
            let folded = std::mem::replace(&mut self.right[beyond], [0.0; 4]);
            for (sum, folded) in self.right[inside].iter_mut().zip(folded) {
                *sum += folded;
            }
        }
    }
}

/// Relative sizes of the cells of nodes `spacing` apart, of which the first and last may end at a border.
fn cell_sizes(sizes: &mut [f32], spacing: usize, finest: usize, border_before: bool, border_after: bool) {
    let spacing_f = spacing as f32;
    for (index, size) in sizes.iter_mut().enumerate().skip(1) {
        let at = index * spacing;
        if at + 1 >= finest {
            break;
        }
        // The border runs half a pixel outside the first (1) and last (finest - 2) pixel of the picture.
        let before = if border_before && index == 1 { (at as f32 - 0.5) / spacing_f } else { 0.5 };
        let ends_here = border_after && at + spacing + 1 >= finest;
        let after = if ends_here { (finest as f32 - 1.5 - at as f32) / spacing_f } else { 0.5 };
        *size = before + after;
    }
}

/// The finest mask, from which coarse nodes measure how far away the fixed pixels are.
struct Domain<'a> {
    unknown: &'a [bool],
    size: (usize, usize),
    borders: Borders,
}

impl Domain<'_> {
    /// Link of a node to its neighbour `spacing` pixels away: 1 over the distance to the first fixed pixel, in
    /// spacings, 1 if there is none in between, 0 beyond the border of the picture.
    fn link(&self, (x, y): (usize, usize), (dx, dy): (isize, isize), spacing: usize) -> f32 {
        for step in 1..=spacing {
            let x = x.saturating_add_signed(step as isize * dx);
            let y = y.saturating_add_signed(step as isize * dy);
            if self.is_beyond_border(x, y) {
                return 0.0;
            }
            if !self.unknown[y * self.size.0 + x] {
                return spacing as f32 / step as f32;
            }
        }
        1.0
    }

    fn is_beyond_border(&self, x: usize, y: usize) -> bool {
        (self.borders.columns[0] && x == 0)
            || (self.borders.columns[1] && x + 1 == self.size.0)
            || (self.borders.rows[0] && y == 0)
            || (self.borders.rows[1] && y + 1 == self.size.1)
    }
}
