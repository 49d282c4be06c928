//! Runs of a level in its arrays, of which it is checked once that they hold them all.

#![allow(unsafe_code, reason = "slices within what was checked for all runs of a level")]
#![allow(clippy::inline_always, reason = "part of kernels that are compiled for several instruction sets")]

use super::layout::{CHANNELS, Layout, row_of};
use super::level::Level;
use super::runs::{Links, Run};
use crate::lanes::{Bits, LANES, Lanes};

/// A level whose runs are those of its layout.
#[derive(Clone, Copy)]
pub(super) struct Field<'a> {
    level: &'a Level,
    /// Values of one colour.
    values: usize,
}

/// A run of a level and one colour of its nodes.
#[derive(Clone, Copy)]
pub(super) struct Part<'a> {
    field: Field<'a>,
    run: &'a Run,
    y: usize,
    colour: usize,
    /// First of its values.
    at: usize,
}

impl<'a> Field<'a> {
    #[inline(always)]
    pub(super) fn new(level: &'a Level) -> Self {
        let Layout { height, stride, .. } = level.layout;
        assert!(level.runs.are_of(&level.layout), "runs of another layout");
        assert!(level.row.len() == height && level.column.len() == 2 * stride, "cells of another layout");
        Self { level, values: level.layout.values() }
    }

    /// The runs of row `y`.
    #[inline(always)]
    pub(super) fn parts(self, (y, colour): (usize, usize)) -> impl Iterator<Item = Part<'a>> {
        let first = self.level.layout.row(y);
        assert!(colour < 2);
        let part = move |run: &'a Run| Part { field: self, run, y, colour, at: first + LANES * run.start };
        self.level.runs.row(y).iter().map(part)
    }
}

impl<'a> Part<'a> {
    #[inline(always)]
    pub(super) fn links(&self) -> Links {
        self.run.links
    }

    /// How many [`LANES`] it has.
    #[inline(always)]
    pub(super) fn count(&self) -> usize {
        self.run.end - self.run.start
    }

    /// First of its values in a row.
    #[inline(always)]
    pub(super) fn first(&self) -> usize {
        LANES * self.run.start
    }

    /// Its values among those of its colour.
    #[inline(always)]
    pub(super) fn own<'v>(&self, values: &'v [f32]) -> &'v [Lanes] {
        // SAFETY: the run lies in its row, and in the values, as `slice` demands.
        unsafe { self.slice(values, 0) }
    }

    #[inline(always)]
    pub(super) fn own_mut<'v>(&self, values: &'v mut [f32]) -> &'v mut [Lanes] {
        assert_eq!(values.len(), self.field.values);
        // SAFETY: as in `own`; the slice is borrowed as the values are.
        unsafe { std::slice::from_raw_parts_mut(values.as_mut_ptr().add(self.at).cast(), self.count()) }
    }

    /// Of the values of the other colour: those above, one place before, at and after its own, and those below.
    #[inline(always)]
    pub(super) fn around<'v>(&self, values: &'v [f32]) -> [&'v [Lanes]; 5] {
        let (row, place) = (self.field.level.layout.stride as isize, CHANNELS as isize);
        // SAFETY: rows with runs have a row above and one below; `LANES` zeros lie before each and behind the last.
        unsafe {
            [
                self.slice(values, -row),
                self.slice(values, -place),
                self.slice(values, 0),
                self.slice(values, place),
                self.slice(values, row),
            ]
        }
    }

    /// As many values as it has, from so many after its first.
    ///
    /// # Safety
    ///
    /// They lie in rows of the layout, or the zeros around them.
    #[inline(always)]
    unsafe fn slice<'v>(&self, values: &'v [f32], further: isize) -> &'v [Lanes] {
        assert_eq!(values.len(), self.field.values);
        let first = self.at.wrapping_add_signed(further);
        debug_assert!(first + LANES * self.count() <= values.len());
        // SAFETY: `values` has the layout's length, for which the caller vouches; `Lanes` are aligned as floats are.
        unsafe { std::slice::from_raw_parts(values.as_ptr().add(first).cast(), self.count()) }
    }

    /// Which lanes are of unknown nodes.
    #[inline(always)]
    pub(super) fn unknown(&self) -> &'a [Bits] {
        // SAFETY: the run is one of these runs, in this row.
        unsafe { self.field.level.runs.unknown(self.run, self.row()) }
    }

    /// Sum of the links of its unknown nodes, of a run that has [weights](Links::Weighted) from `first` on.
    #[inline(always)]
    pub(super) fn sums_of_links(&self, first: usize) -> &'a [Lanes] {
        self.field.level.runs.links(first, self.count(), self.colour)
    }

    /// One over that.
    #[inline(always)]
    pub(super) fn inverse(&self, first: usize) -> &'a [Lanes] {
        self.field.level.runs.inverse(first, self.count(), self.colour)
    }

    /// Size of its cells: the link of a node to the left and right neighbour, and those of all to the upper and lower
    /// ones. None where all are one.
    #[inline(always)]
    pub(super) fn cells(&self) -> Option<(f32, &'a [Lanes])> {
        let level = self.field.level;
        let at = self.parity() * level.layout.stride + LANES * self.run.start;
        (!level.flat).then(|| (level.row[self.y], row_of(&level.column, at, self.count())))
    }

    /// Whether its first column is even or odd.
    #[inline(always)]
    pub(super) fn parity(&self) -> usize {
        (self.y + self.colour) & 1
    }

    #[inline(always)]
    fn row(&self) -> (usize, usize) {
        (self.y, self.colour)
    }
}
