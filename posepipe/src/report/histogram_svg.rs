//! Histograms as SVG drawings.

use std::fmt::Write as _;

use super::save::escaped;
use crate::{Error, Result, eval::Histogram};

/// Captions and thresholds of a drawn histogram.
#[derive(Clone, Debug, PartialEq)]
pub struct HistogramStyle {
    /// Heading; empty = none.
    pub title: String,
    /// Name and unit of the values, for example `position error [mm]`.
    pub axis: String,
    /// Factor from the values to the unit on the axis, for example 1000 for metres shown as mm.
    pub scale: f64,
    /// Green line, in the unit of the values: below it a try always succeeds (Haarslev et al. 2020, Fig. 10).
    pub good: Option<f64>,
    /// Red line, in the unit of the values: above it a try always fails (same figure).
    pub bad: Option<f64>,
    /// Width of the drawing in pixels.
    pub width: u32,
    /// Height of the drawing in pixels.
    pub height: u32,
}

impl Default for HistogramStyle {
    /// 480 x 300 pixels without captions or lines, values shown as they are.
    fn default() -> Self {
        Self { title: String::new(), axis: String::new(), scale: 1.0, good: None, bad: None, width: 480, height: 300 }
    }
}

/// Room for the axis on the left, heading, right edge and captions below, pixels.
const LEFT: f64 = 56.0;
const TOP: f64 = 34.0;
const RIGHT: f64 = 18.0;
const BOTTOM: f64 = 54.0;

/// Draws `histogram` as a complete SVG document.
///
/// Values outside the bins are not hidden: their number stands in the corner.
///
/// # Errors
///
/// [`Error::Invalid`] if the drawing is smaller than 160 x 120 pixels or `scale` is not positive or a threshold is not a finite number.
pub fn histogram_svg(histogram: &Histogram, style: &HistogramStyle) -> Result<String> {
    let numbers = [Some(style.scale), style.good, style.bad];
    if style.width < 160
        || style.height < 120
        || !numbers.iter().flatten().all(|number| number.is_finite())
        || style.scale <= 0.0
    {
        return Err(Error::Invalid(format!(
            "histogram of {}x{} pixels, scale {}, lines at {:?} and {:?}: 160x120 or more, a positive scale and finite lines are needed",
            style.width, style.height, style.scale, style.good, style.bad
        )));
    }
    let frame = Frame::of(histogram, style);
    let mut svg = head(style);
    frame.draw_grid(&mut svg);
    frame.draw_bars(&mut svg, histogram);
    frame.draw_axis(&mut svg, histogram, style);
    for (value, class, name) in [(style.good, "good", "good"), (style.bad, "bad", "fails")] {
        if let Some(value) = value {
            frame.draw_threshold(&mut svg, value, class, name);
        }
    }
    frame.draw_outside(&mut svg, histogram);
    svg.push_str("</svg>\n");
    Ok(svg)
}

fn head(style: &HistogramStyle) -> String {
    let (width, height) = (style.width, style.height);
    let (title, axis) = (escaped(&style.title), escaped(&style.axis));
    let (middle, low) = (f64::from(width) / 2.0, f64::from(height) - 12.0);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
         viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" font-size=\"11\" fill=\"#333\">\n\
         <style>.grid{{stroke:#ddd}}.edge{{stroke:#333}}.bar{{fill:#5b8fc7;stroke:#fff;stroke-width:.5}}\
         .good{{stroke:#1a9641;fill:#1a9641}}.bad{{stroke:#d7191c;fill:#d7191c}}</style>\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>\n\
         <text x=\"{middle}\" y=\"20\" text-anchor=\"middle\" font-size=\"14\">{title}</text>\n\
         <text x=\"{middle}\" y=\"{low}\" text-anchor=\"middle\">{axis}</text>\n"
    )
}

/// Where values and counts lie on the drawing.
struct Frame {
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
    low: f64,
    high: f64,
    /// Distance between two lines of the grid, in counts.
    count_step: u64,
    most: u64,
}

impl Frame {
    fn of(histogram: &Histogram, style: &HistogramStyle) -> Self {
        let edges = histogram.edges();
        let (first, last) = (edges[0], edges[edges.len() - 1]);
        let lines = || [style.good, style.bad].into_iter().flatten();
        let largest = histogram.counts().iter().copied().max().unwrap_or(0).max(1);
        let count_step = (round_step(largest as f64 / 5.0).ceil() as u64).max(1);
        Self {
            left: LEFT,
            right: f64::from(style.width) - RIGHT,
            top: TOP,
            bottom: f64::from(style.height) - BOTTOM,
            // A threshold beyond the bins is still shown.
            low: lines().fold(first, f64::min),
            high: lines().fold(last, |high, line| if line > high { line + (line - first) * 0.05 } else { high }),
            count_step,
            most: largest.div_ceil(count_step) * count_step,
        }
    }

    fn x(&self, value: f64) -> f64 {
        self.left + (self.right - self.left) * (value - self.low) / (self.high - self.low)
    }

    fn y(&self, count: u64) -> f64 {
        self.bottom - (self.bottom - self.top) * count as f64 / self.most as f64
    }

    fn draw_grid(&self, svg: &mut String) {
        let (left, right) = (self.left, self.right);
        for count in (0..=self.most).step_by(self.count_step as usize) {
            let y = self.y(count);
            let _ = writeln!(
                svg,
                "<line class=\"grid\" x1=\"{left}\" y1=\"{y:.1}\" x2=\"{right}\" y2=\"{y:.1}\"/>\
                 <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{count}</text>",
                left - 6.0,
                y + 4.0
            );
        }
    }

    fn draw_bars(&self, svg: &mut String, histogram: &Histogram) {
        for (edges, count) in histogram.edges().windows(2).zip(histogram.counts()).filter(|(_, count)| **count > 0) {
            let (x, y) = (self.x(edges[0]), self.y(*count));
            let (width, height) = (self.x(edges[1]) - x, self.bottom - y);
            let _ = writeln!(
                svg,
                "<rect class=\"bar\" x=\"{x:.2}\" y=\"{y:.2}\" width=\"{width:.2}\" height=\"{height:.2}\"/>"
            );
        }
    }

    fn draw_axis(&self, svg: &mut String, histogram: &Histogram, style: &HistogramStyle) {
        let (left, right, bottom) = (self.left, self.right, self.bottom);
        let _ = writeln!(svg, "<line class=\"edge\" x1=\"{left}\" y1=\"{bottom}\" x2=\"{right}\" y2=\"{bottom}\"/>");
        let (low, high) = (self.low * style.scale, self.high * style.scale);
        let step = round_step((high - low).abs() / 8.0);
        let (low, high) = (low.min(high), low.max(high));
        let first = (low / step - 1e-9).ceil() as i64;
        let last = (high / step + 1e-9).floor() as i64;
        let decimals = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
        for tick in first..=last {
            let value = tick as f64 * step;
            let x = self.x(value / style.scale);
            let _ = writeln!(
                svg,
                "<line class=\"edge\" x1=\"{x:.2}\" y1=\"{bottom}\" x2=\"{x:.2}\" y2=\"{:.1}\"/>\
                 <text x=\"{x:.2}\" y=\"{:.1}\" text-anchor=\"middle\">{value:.decimals$}</text>",
                bottom + 4.0,
                bottom + 17.0
            );
        }
        let _ = writeln!(
            svg,
            "<text x=\"14\" y=\"{:.1}\" text-anchor=\"middle\" transform=\"rotate(-90 14 {:.1})\">count of {}</text>",
            f64::midpoint(self.top, bottom),
            f64::midpoint(self.top, bottom),
            histogram.total()
        );
    }

    fn draw_threshold(&self, svg: &mut String, value: f64, class: &str, name: &str) {
        let x = self.x(value);
        let _ = writeln!(
            svg,
            "<line class=\"{class}\" stroke-width=\"2\" x1=\"{x:.2}\" y1=\"{:.1}\" x2=\"{x:.2}\" y2=\"{:.1}\"/>\
             <text class=\"{class}\" stroke=\"none\" style=\"stroke:none\" x=\"{x:.2}\" y=\"{:.1}\" \
             text-anchor=\"middle\">{name}</text>",
            self.top,
            self.bottom,
            self.top - 3.0
        );
    }

    fn draw_outside(&self, svg: &mut String, histogram: &Histogram) {
        let mut line = |x: f64, anchor: &str, text: String| {
            let y = self.bottom + 30.0;
            let _ = writeln!(svg, "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{text}</text>");
        };
        if histogram.below() > 0 {
            line(self.left, "start", format!("&#8592; {} more", histogram.below()));
        }
        if histogram.above() > 0 {
            line(self.right, "end", format!("{} more &#8594;", histogram.above()));
        }
    }
}

/// The next of 1, 2, 5 times a power of ten.
fn round_step(least: f64) -> f64 {
    let power = 10.0_f64.powf(least.log10().floor());
    let factors = [1.0, 2.0, 5.0, 10.0];
    let factor = factors.into_iter().find(|factor| factor * power >= least * (1.0 - 1e-12));
    power * factor.unwrap_or(10.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn histogram() -> Histogram {
        Histogram::new(&[0.001, 0.002, 0.0021, 0.009, 0.5], 0.0, 0.01, 10).unwrap()
    }

    #[test]
    fn one_bar_per_filled_bin_and_a_line_per_threshold() {
        let style = HistogramStyle {
            title: "a < b".into(),
            scale: 1000.0,
            good: Some(0.003),
            bad: Some(0.02),
            ..HistogramStyle::default()
        };
        let svg = histogram_svg(&histogram(), &style).unwrap();
        assert_eq!(svg.matches("<rect class=\"bar\"").count(), 3);
        assert_eq!(svg.matches("<line class=\"good\"").count(), 1);
        assert_eq!(svg.matches("<line class=\"bad\"").count(), 1);
        assert!(svg.contains("a &lt; b") && svg.contains("1 more &#8594;") && svg.ends_with("</svg>\n"));
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
    }

    #[test]
    fn steps_are_round() {
        for (least, step) in [(0.7, 1.0), (1.0, 1.0), (1.3, 2.0), (0.031, 0.05), (7.0, 10.0)] {
            assert!((round_step(least) / step - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn drawings_without_room_or_number_are_refused() {
        assert!(histogram_svg(&histogram(), &HistogramStyle { width: 10, ..HistogramStyle::default() }).is_err());
        assert!(
            histogram_svg(&histogram(), &HistogramStyle { good: Some(f64::NAN), ..HistogramStyle::default() }).is_err()
        );
    }
}
