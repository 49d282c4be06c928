//! Loss, learning rate and validation over the steps, as a drawing.

use std::fmt::Write as _;

const WIDTH: f64 = 720.0;
/// Height of one of the three panels, with its heading.
const PANEL: f64 = 170.0;
/// Room for the numbers on the left and the axis below, pixels.
const LEFT: f64 = 64.0;
const RIGHT: f64 = 16.0;
const TOP: f64 = 26.0;
const BOTTOM: f64 = 40.0;
/// Most points of a line: about one per pixel. More steps are drawn as means over equal parts.
const MOST_POINTS: usize = 600;
/// Share of a new point in the smoothed loss.
const SMOOTHING: f64 = 0.05;

/// What is drawn.
#[derive(Clone, Debug, Default)]
pub(super) struct Curves {
    /// Step, loss, learning rate.
    steps: Vec<(u64, f64, f64)>,
    /// Step, `IoU`.
    validations: Vec<(u64, f64)>,
}

type Points = Vec<(f64, f64)>;

impl Curves {
    pub(super) fn add_step(&mut self, step: u64, loss: f64, learning_rate: f64) {
        self.steps.push((step, loss, learning_rate));
    }

    pub(super) fn add_validation(&mut self, step: u64, iou: f64) {
        self.validations.push((step, iou));
    }

    /// A complete SVG document.
    pub(super) fn svg(&self) -> String {
        let losses = self.steps.iter().map(|&(step, loss, _)| (step as f64, loss));
        let rates = self.steps.iter().map(|&(step, _, rate)| (step as f64, rate));
        let [losses, rates] = [means(&losses.collect::<Points>()), means(&rates.collect::<Points>())];
        let ious: Points = self.validations.iter().map(|&(step, iou)| (step as f64, iou)).collect();
        let last = losses.iter().chain(&ious).map(|point| point.0).fold(1.0, f64::max);
        let height = 3.0 * PANEL + BOTTOM;
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"{height}\" \
             viewBox=\"0 0 {WIDTH} {height}\" font-family=\"sans-serif\" font-size=\"11\" fill=\"#333\">\n\
             <style>.grid{{stroke:#ddd}}.edge{{stroke:#333}}polyline{{fill:none}}.raw{{stroke:#c4d7ea}}\
             .line{{stroke:#5b8fc7;stroke-width:2}}.dot{{fill:#5b8fc7}}</style>\n\
             <rect width=\"{WIDTH}\" height=\"{height}\" fill=\"#fff\"/>\n"
        );
        let panel =
            |number: f64, most: f64| Panel { top: number * PANEL + TOP, bottom: (number + 1.0) * PANEL, last, most };
        let most =
            |points: &[(f64, f64)]| points.iter().map(|point| point.1).reduce(f64::max).filter(|most| *most > 0.0);
        let loss = panel(0.0, most(&losses).unwrap_or(1.0));
        loss.frame(&mut svg, "loss (pale: as it was, dark: running mean)");
        loss.line(&mut svg, "raw", &losses);
        loss.line(&mut svg, "line", &smoothed(&losses));
        let rate = panel(1.0, most(&rates).unwrap_or(1.0));
        rate.frame(&mut svg, "learning rate");
        rate.line(&mut svg, "line", &rates);
        let iou = panel(2.0, 1.0);
        iou.frame(&mut svg, "IoU of the held-out images");
        iou.line(&mut svg, "line", &ious);
        iou.dots(&mut svg, &ious);
        iou.steps(&mut svg);
        svg.push_str("</svg>\n");
        svg
    }
}

/// At most [`MOST_POINTS`] points: means over equal numbers of points, each at the last of its part.
fn means(points: &[(f64, f64)]) -> Points {
    let part = points.len().div_ceil(MOST_POINTS).max(1);
    let mean = |part: &[(f64, f64)]| {
        let sum: f64 = part.iter().map(|point| point.1).sum();
        (part[part.len() - 1].0, sum / part.len() as f64)
    };
    points.chunks(part).map(mean).collect()
}

/// Exponential moving average, without the pull of a first value out of nowhere: weights are divided by their sum.
fn smoothed(points: &[(f64, f64)]) -> Points {
    let (mut sum, mut weight) = (0.0, 0.0);
    let smooth = |&(x, y): &(f64, f64)| {
        sum = sum * (1.0 - SMOOTHING) + y * SMOOTHING;
        weight = weight * (1.0 - SMOOTHING) + SMOOTHING;
        (x, sum / weight)
    };
    points.iter().map(smooth).collect()
}

/// Steps 0 to `last` from left to right, values 0 to `most` from the bottom up.
struct Panel {
    top: f64,
    bottom: f64,
    last: f64,
    most: f64,
}

impl Panel {
    fn x(&self, step: f64) -> f64 {
        LEFT + (WIDTH - LEFT - RIGHT) * step / self.last
    }

    fn y(&self, value: f64) -> f64 {
        self.bottom - (self.bottom - self.top) * value / self.most
    }

    fn frame(&self, svg: &mut String, title: &str) {
        let (right, heading) = (WIDTH - RIGHT, self.top - 8.0);
        let _ = writeln!(svg, "<text x=\"{LEFT}\" y=\"{heading:.1}\" font-size=\"12\">{title}</text>");
        let step = round_step(self.most / 4.0);
        let decimals = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
        for line in 0..=(self.most / step * (1.0 + 1e-12)).floor() as u32 {
            let value = f64::from(line) * step;
            let (y, number) = (self.y(value), LEFT - 6.0);
            let _ = writeln!(
                svg,
                "<line class=\"grid\" x1=\"{LEFT}\" y1=\"{y:.1}\" x2=\"{right}\" y2=\"{y:.1}\"/>\
                 <text x=\"{number}\" y=\"{:.1}\" text-anchor=\"end\">{value:.decimals$}</text>",
                y + 4.0
            );
        }
    }

    fn line(&self, svg: &mut String, class: &str, points: &[(f64, f64)]) {
        let _ = write!(svg, "<polyline class=\"{class}\" points=\"");
        for &(step, value) in points {
            let _ = write!(svg, "{:.1},{:.1} ", self.x(step), self.y(value));
        }
        svg.push_str("\"/>\n");
    }

    fn dots(&self, svg: &mut String, points: &[(f64, f64)]) {
        for &(step, value) in points {
            let (x, y) = (self.x(step), self.y(value));
            let _ = writeln!(svg, "<circle class=\"dot\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3\"/>");
        }
    }

    /// The axis below.
    fn steps(&self, svg: &mut String) {
        let (right, bottom) = (WIDTH - RIGHT, self.bottom);
        let _ = writeln!(svg, "<line class=\"edge\" x1=\"{LEFT}\" y1=\"{bottom}\" x2=\"{right}\" y2=\"{bottom}\"/>");
        let step = round_step(self.last / 8.0).max(1.0);
        for tick in 0..=(self.last / step).floor() as u32 {
            let value = f64::from(tick) * step;
            let (x, y) = (self.x(value), bottom + 16.0);
            let _ = writeln!(svg, "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"middle\">{value}</text>");
        }
        let (middle, low) = (f64::midpoint(LEFT, right), bottom + 32.0);
        let _ = writeln!(svg, "<text x=\"{middle}\" y=\"{low:.1}\" text-anchor=\"middle\">step</text>");
    }
}

/// The next of 1, 2, 5 times a power of ten.
fn round_step(least: f64) -> f64 {
    let power = 10.0_f64.powf(least.log10().floor());
    let factor = [1.0, 2.0, 5.0].into_iter().find(|factor| factor * power >= least * (1.0 - 1e-12));
    power * factor.unwrap_or(10.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curves(steps: u64) -> Curves {
        let mut curves = Curves::default();
        for step in 0..steps {
            curves.add_step(step, 3.0 / (1.0 + step as f64), 1e-3);
        }
        curves.add_validation(steps.saturating_sub(1), 0.8);
        curves
    }

    #[test]
    fn long_trainings_are_drawn_with_few_points() {
        for (steps, points) in [(0, 0), (1, 1), (600, 600), (601, 301), (62_500, 596)] {
            let svg = curves(steps).svg();
            let line = svg.split("class=\"raw\" points=\"").nth(1).unwrap().split('"').next().unwrap();
            assert_eq!(line.split_whitespace().count(), points, "{steps} steps");
            assert!(!svg.contains("NaN") && !svg.contains("inf") && svg.ends_with("</svg>\n"));
        }
    }

    #[test]
    fn parts_keep_their_mean_and_smoothing_keeps_a_constant() {
        let line: Points = (0..1200).map(|step| (f64::from(step), f64::from(step % 2))).collect();
        assert!(means(&line).iter().all(|point| point.1 == 0.5));
        let constant: Points = (0..50).map(|step| (f64::from(step), 0.7)).collect();
        assert!(smoothed(&constant).iter().all(|point| (point.1 - 0.7).abs() < 1e-12));
    }

    #[test]
    fn a_validation_lies_where_its_step_and_value_are() {
        let mut curves = Curves::default();
        curves.add_step(0, 1.0, 1e-3);
        curves.add_step(100, 1.0, 1e-3);
        curves.add_validation(50, 0.25);
        let (x, y) = (LEFT + (WIDTH - LEFT - RIGHT) / 2.0, 3.0 * PANEL - 0.25 * (PANEL - TOP));
        assert!(curves.svg().contains(&format!("cx=\"{x:.1}\" cy=\"{y:.1}\"")));
    }
}
