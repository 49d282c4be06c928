//! Which parts of a level's rows are relaxed, and with which links.

use super::layout::{CHANNELS, LANES, Layout};
use super::level::{Level, Run};
use super::mask::intervals;
use crate::dispatch::dispatched;

/// Plain parts shorter than this are not worth a run of their own.
const SHORTEST_PLAIN: usize = 6;

impl Level {
    /// Lists the runs: rows of active nodes with the unknown neighbours that relaxation reads. `links(level, x, y)` is the
    /// sum of the links of an unknown node.
    pub(super) fn set_runs(&mut self, links: impl Fn(&Self, usize, usize) -> f32) {
        let Layout { width, height, .. } = self.layout;
        let (mut used, mut plain) = (vec![0; width], vec![0; width]);
        self.runs.clear();
        self.runs.end_row();
        for y in 1..height - 1 {
            mark_row(self, y, &mut used, &mut plain);
            let mut end = 0;
            for (first, last) in intervals(&used) {
                end = self.add_runs(Layout::blocks(first, last), end, &plain);
            }
            self.runs.end_row();
            self.set_links_of_row(y, &used, &links);
        }
        self.runs.end_row();
    }

    /// Adds the blocks `start..stop` from `done` on, where the row's earlier runs end; returns where these do.
    fn add_runs(&mut self, (start, stop): (usize, usize), done: usize, plain: &[u8]) -> usize {
        let mut at = start.max(done);
        if at >= stop {
            return done;
        }
        let (first, last) = self.layout.columns(at, stop);
        for (from, to) in intervals(&plain[first..last]) {
            let (from, to) = Layout::blocks_within(first + from, first + to);
            let (from, to) = (from.max(at), to.min(stop));
            if to >= from + SHORTEST_PLAIN {
                self.add_run(at, from, false);
                self.add_run(from, to, true);
                at = to;
            }
        }
        self.add_run(at, stop, false);
        stop
    }

    /// Adds the blocks `start..end` if there are any.
    fn add_run(&mut self, start: usize, end: usize, plain: bool) {
        if start < end {
            self.runs.push(Run { start, end, plain });
        }
    }

    /// Links of the `used` columns of a row; those of clear nodes are four.
    fn set_links_of_row(&mut self, y: usize, used: &[u8], links: &impl Fn(&Self, usize, usize) -> f32) {
        let width = self.layout.width;
        for index in 0..self.runs.row(y).len() {
            self.clear_run(y, self.runs.row(y)[index]);
        }
        let mut row = std::mem::take(&mut self.scratch);
        for (first, last) in intervals(used) {
            self.layout.fill(&mut self.links, y, (first, last), 4.0);
        }
        for (first, last) in intervals(&self.active[y * width..][..width]) {
            self.layout.fill(&mut self.inverse_links, y, (first, last), 0.25);
        }
        self.mark_outline(y, &mut row);
        for x in intervals(&row).flat_map(|(first, last)| first..last).filter(|&x| used[x] != 0) {
            let sum = links(self, x, y);
            let node = self.layout.node(x, y);
            self.links[node..node + CHANNELS].fill(sum);
            if self.active[y * width + x] != 0 {
                self.inverse_links[node..node + CHANNELS].fill(1.0 / sum);
            }
        }
        self.scratch = row;
    }

    fn clear_run(&mut self, y: usize, run: Run) {
        let layout = self.layout;
        for at in [layout.row(y), layout.values() + layout.row(y)] {
            let range = at + LANES * run.start..at + LANES * run.end;
            for values in [&mut self.right, &mut self.links, &mut self.inverse_links] {
                values[range.clone()].fill(0.0);
            }
        }
    }
}

dispatched! {
    /// Marks the columns of row `y` that relaxation reads or writes, and those that are active and clear.
    fn mark_row(level: &Level, y: usize, used: &mut [u8], plain: &mut [u8]) = mark_row_body
}

#[inline(always)]
fn mark_row_body(level: &Level, y: usize, used: &mut [u8], plain: &mut [u8]) {
    let width = level.layout.width;
    let unknown = &level.unknown[y * width..][..width];
    let clear = &level.clear[y * width..][..width];
    let active = &level.active[y * width..][..width];
    let (above, below) = (&level.active[(y - 1) * width..][..width], &level.active[(y + 1) * width..][..width]);
    for x in 1..width - 1 {
        let near = active[x - 1] | active[x] | active[x + 1] | above[x] | below[x];
        used[x] = unknown[x] & near;
        plain[x] = clear[x] & active[x];
    }
}
