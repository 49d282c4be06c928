//! Tables, drawings and pictures on one HTML page.

use std::{
    fmt::Write as _,
    path::{Component, Path},
};

use super::save::escaped;
use crate::{Error, Result, bop::write_bytes, eval::Table};

/// A page that is filled from top to bottom and needs no other file than the pictures it shows.
#[derive(Clone, Debug)]
pub struct DataSheet {
    title: String,
    body: String,
}

impl DataSheet {
    /// An empty page.
    pub fn new(title: &str) -> Self {
        Self { title: title.to_owned(), body: String::new() }
    }

    /// Adds a heading.
    pub fn heading(&mut self, text: &str) -> &mut Self {
        self.push(format_args!("<h2>{}</h2>", escaped(text)))
    }

    /// Adds a paragraph of plain text.
    pub fn paragraph(&mut self, text: &str) -> &mut Self {
        self.push(format_args!("<p>{}</p>", escaped(text)))
    }

    /// Adds a table; its first column names the rows.
    pub fn table(&mut self, table: &Table) -> &mut Self {
        let row = |cells: &[String], tag: &str| -> String {
            let cells = cells.iter().map(|cell| format!("<{tag}>{}</{tag}>", escaped(cell)));
            format!("<tr>{}</tr>\n", cells.collect::<String>())
        };
        let head = row(table.columns(), "th");
        let body: String = table.rows().iter().map(|cells| row(cells, "td")).collect();
        self.push(format_args!("<table>\n<thead>{head}</thead>\n<tbody>{body}</tbody>\n</table>"))
    }

    /// Adds a drawing, for example from [`histogram_svg`](super::histogram_svg), within the page itself.
    ///
    /// `svg` goes in as it is: give drawings of this crate only, not those of strangers.
    pub fn drawing(&mut self, svg: &str) -> &mut Self {
        self.push(format_args!("<figure class=\"drawing\">{svg}</figure>"))
    }

    /// Adds a picture by its path from the page's own folder.
    ///
    /// # Errors
    ///
    /// [`Error::Invalid`] if `path` is absolute, leads out of the folder, or is no text: the page would lose its picture
    /// when the folder moves.
    pub fn picture(&mut self, path: &Path, caption: &str) -> Result<&mut Self> {
        let inside = path.components().all(|part| matches!(part, Component::Normal(_)));
        let names: Option<Vec<&str>> = path.components().map(|part| part.as_os_str().to_str()).collect();
        let Some(names) = names.filter(|names| inside && !names.is_empty()) else {
            let found = path.display();
            return Err(Error::Invalid(format!("picture {found}: a path within the page's folder is needed")));
        };
        let link = names.iter().map(|name| percent_encoded(name)).collect::<Vec<_>>().join("/");
        let caption = escaped(caption);
        Ok(self.push(format_args!(
            "<figure><img src=\"{link}\" alt=\"{caption}\"><figcaption>{caption}</figcaption></figure>"
        )))
    }

    /// The page as text.
    pub fn to_html(&self) -> String {
        let title = escaped(&self.title);
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title}</title>\n\
             <style>{STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>\n{}</body>\n</html>\n",
            self.body
        )
    }

    /// Writes the page; the file appears complete or not at all.
    ///
    /// # Errors
    ///
    /// [`Error::Io`] if the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        write_bytes(path, self.to_html().as_bytes())
    }

    fn push(&mut self, element: std::fmt::Arguments<'_>) -> &mut Self {
        // Writing to a string cannot fail.
        let _ = writeln!(self.body, "{element}");
        self
    }
}

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color:#222}\
h1{font-size:1.7rem}h2{font-size:1.2rem;margin-top:2rem;border-bottom:1px solid #ddd}\
table{border-collapse:collapse;margin:1rem 0;font-variant-numeric:tabular-nums}\
th,td{padding:.25rem .8rem;text-align:right;border-bottom:1px solid #e4e4e4}\
th:first-child,td:first-child{text-align:left}thead th{border-bottom:2px solid #888}\
figure{margin:1rem 0}figure.drawing{display:inline-block;margin:.5rem}img,svg{max-width:100%;height:auto}\
figcaption{color:#666;font-size:.9rem}";

/// A file name as part of a link (RFC 3986, unreserved characters stay).
fn percent_encoded(name: &str) -> String {
    let encode = |byte: u8| match byte {
        b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'.' | b'_' | b'~' => char::from(byte).to_string(),
        _ => format!("%{byte:02X}"),
    };
    name.bytes().map(encode).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_escaped_and_links_are_relative() {
        let mut table = Table::new(["name", "value"]);
        table.add(["<b>", "1 & 2"]).unwrap();
        let mut sheet = DataSheet::new("a < b");
        sheet.heading("x").paragraph("\"quoted\"").table(&table);
        sheet.picture(Path::new("pictures/two words.png"), "it's").unwrap();
        let html = sheet.to_html();
        for part in
            ["<title>a &lt; b</title>", "<td>&lt;b&gt;</td><td>1 &amp; 2</td>", "src=\"pictures/two%20words.png\""]
        {
            assert!(html.contains(part), "{part} is missing in {html}");
        }
        assert_eq!(html.matches("<tr>").count(), html.matches("</tr>").count());
    }

    #[test]
    fn pictures_elsewhere_are_refused() {
        let mut sheet = DataSheet::new("");
        for path in ["/etc/picture.png", "../picture.png", "", "."] {
            assert!(sheet.picture(Path::new(path), "").is_err(), "{path}");
        }
    }
}
