//! Tables of named rows, for terminals and for Markdown.

use super::distribution::Distribution;
use crate::{Error, Result};

/// Cells under named columns; the first cell of a row is its name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Table {
    columns: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// An empty table with these `columns`, the first of which names the rows.
    pub fn new<S: Into<String>>(columns: impl IntoIterator<Item = S>) -> Self {
        Self { columns: columns.into_iter().map(Into::into).collect(), rows: Vec::new() }
    }

    /// Adds a row.
    ///
    /// # Errors
    ///
    /// [`Error::Invalid`] if it has not one cell per column.
    pub fn add<S: Into<String>>(&mut self, cells: impl IntoIterator<Item = S>) -> Result<()> {
        let row: Vec<String> = cells.into_iter().map(Into::into).collect();
        if row.len() != self.columns.len() {
            let (cells, columns) = (row.len(), self.columns.len());
            return Err(Error::Invalid(format!("row of {cells} cells in a table of {columns} columns")));
        }
        self.rows.push(row);
        Ok(())
    }

    /// Names of the columns.
    pub fn columns(&self) -> &[String] {
        &self.columns
    }

    /// The rows, each with one cell per column.
    pub fn rows(&self) -> &[Vec<String>] {
        &self.rows
    }

    /// As plain text: names left, numbers right, a rule under the head.
    pub fn to_text(&self) -> String {
        let widths = self.widths(|cell| cell.chars().count());
        let rule: Vec<String> = widths.iter().map(|width| "-".repeat(*width)).collect();
        let lines = [&self.columns, &rule].into_iter().chain(&self.rows);
        let lines = lines.map(|row| aligned(row, &widths).join("  ").trim_end().to_owned());
        joined(lines)
    }

    /// As a Markdown table; bars and line breaks inside cells are escaped.
    pub fn to_markdown(&self) -> String {
        let escape = |row: &Vec<String>| -> Vec<String> {
            row.iter().map(|cell| cell.replace('|', "\\|").replace(['\n', '\r'], " ")).collect()
        };
        let columns = escape(&self.columns);
        let rows: Vec<_> = self.rows.iter().map(escape).collect();
        // A rule needs three dashes, and its colon says which side the column is aligned to.
        let widths = self.widths(|cell| cell.replace('|', "\\|").chars().count().max(3));
        let rule = widths.iter().enumerate().map(|(column, width)| match column {
            0 => format!(":{}", "-".repeat(width - 1)),
            _ => format!("{}:", "-".repeat(width - 1)),
        });
        let lines = [columns, rule.collect()].into_iter().chain(rows);
        joined(lines.map(|row| format!("| {} |", aligned(&row, &widths).join(" | "))))
    }

    fn widths(&self, width: impl Fn(&String) -> usize) -> Vec<usize> {
        let of_column = |column: usize| self.rows.iter().map(|row| width(&row[column])).max().unwrap_or(0);
        self.columns.iter().enumerate().map(|(column, name)| width(name).max(of_column(column))).collect()
    }
}

/// The lines as one text, each ended.
fn joined(lines: impl Iterator<Item = String>) -> String {
    lines.fold(String::new(), |text, line| text + &line + "\n")
}

/// The first cell to the left, the others, which are numbers, to the right.
fn aligned(row: &[String], widths: &[usize]) -> Vec<String> {
    let cells = row.iter().zip(widths).enumerate();
    cells
        .map(|(column, (cell, width))| if column == 0 { format!("{cell:<width$}") } else { format!("{cell:>width$}") })
        .collect()
}

/// A table of error distributions: count, mean, median, percentiles, and shares of all cases within thresholds.
#[derive(Clone, Debug)]
pub struct ErrorTable {
    table: Table,
    scale: f64,
    thresholds: Vec<f64>,
}

impl ErrorTable {
    /// An empty table of the error called `name`.
    ///
    /// Values are shown in `unit`, `scale` of which make the unit of the values (mm: 1000, degrees: 180 / pi); the
    /// `thresholds` are in the unit of the values.
    ///
    /// # Errors
    ///
    /// [`Error::Invalid`] if `scale` or a threshold is not a positive number.
    pub fn new(name: &str, unit: &str, scale: f64, thresholds: &[f64]) -> Result<Self> {
        let positive = |number: &f64| number.is_finite() && *number > 0.0;
        if !(positive(&scale) && thresholds.iter().all(positive)) {
            return Err(Error::Invalid(format!(
                "table of {name}: scale {scale} and thresholds {thresholds:?} must be positive"
            )));
        }
        let mut columns = vec![format!("{name} [{unit}]")];
        columns.extend(["found", "missing", "mean", "median", "p90", "p99", "max"].map(String::from));
        columns.extend(thresholds.iter().map(|limit| format!("<= {}", trimmed(limit * scale))));
        Ok(Self { table: Table::new(columns), scale, thresholds: thresholds.to_vec() })
    }

    /// Adds a row called `name`.
    pub fn add(&mut self, name: &str, errors: &Distribution) {
        let shown = |value: f64| significant(value * self.scale);
        let counts = [errors.values().len(), errors.missing()].map(|count| count.to_string());
        let percentiles = [50.0, 90.0, 99.0, 100.0].map(|percent| shown(errors.percentile(percent)));
        let shares = self.thresholds.iter().map(|limit| format!("{:.1} %", 100.0 * errors.share_within(*limit)));
        let mut row = vec![name.to_owned()];
        row.extend(counts);
        row.push(shown(errors.mean()));
        row.extend(percentiles);
        row.extend(shares);
        self.table.rows.push(row);
    }

    /// The table itself.
    pub fn as_table(&self) -> &Table {
        &self.table
    }

    /// As plain text.
    pub fn to_text(&self) -> String {
        self.table.to_text()
    }

    /// As a Markdown table.
    pub fn to_markdown(&self) -> String {
        self.table.to_markdown()
    }
}

/// Three significant digits, but never an exponent and never fewer digits than the whole number has.
fn significant(value: f64) -> String {
    let magnitude = if value == 0.0 { 0.0 } else { value.abs().log10().floor() };
    let decimals = (2.0 - magnitude).clamp(0.0, 6.0) as usize;
    format!("{value:.decimals$}")
}

/// Without the noise that scaling leaves in the last digits (`0.005 * 1000.0`).
fn trimmed(value: f64) -> String {
    let text = format!("{value:.6}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_and_markdown_are_aligned() {
        let mut table = ErrorTable::new("position", "mm", 1000.0, &[0.005, 0.02]).unwrap();
        table.add("ours", &Distribution::new(&[0.001, 0.002, 0.003]).unwrap().with_missing(1));
        table.add("a|b", &Distribution::new(&[0.0123]).unwrap());
        let text = "\
position [mm]  found  missing  mean  median   p90   p99   max    <= 5    <= 20
-------------  -----  -------  ----  ------  ----  ----  ----  ------  -------
ours               3        1  2.00    2.00  2.80  2.98  3.00  75.0 %   75.0 %
a|b                1        0  12.3    12.3  12.3  12.3  12.3   0.0 %  100.0 %
";
        assert_eq!(table.to_text(), text);
        let markdown = table.to_markdown();
        assert!(markdown.lines().all(|line| line.chars().count() == markdown.lines().next().unwrap().chars().count()));
        assert!(markdown.contains("| a\\|b "));
        assert!(markdown.lines().nth(1).unwrap().starts_with("| :---"));
    }

    #[test]
    fn a_row_of_another_length_is_refused() {
        let mut table = Table::new(["name", "value"]);
        assert!(table.add(["one"]).is_err());
        assert!(table.add(["one", "1"]).is_ok());
    }

    #[test]
    fn numbers_keep_three_digits() {
        let shown = [0.0, 0.012_345, 1.234_5, 12.345, 123.45, 12345.6].map(significant);
        assert_eq!(shown, ["0.00", "0.0123", "1.23", "12.3", "123", "12346"]);
    }
}
