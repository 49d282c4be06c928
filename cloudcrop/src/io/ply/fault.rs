//! How a PLY file can be wrong.

/// What is wrong with a PLY file, or with a cloud to be written as one. Rows and faces count from 0, lines from 1.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PlyFault {
    /// The first line is not `ply`.
    #[error("starts with {found:?}, a PLY file starts with the line `ply`")]
    NotPly {
        /// The first bytes of the file.
        found: String,
    },
    /// The file ends before `end_header`.
    #[error("the header does not end: line `end_header` is missing")]
    UnfinishedHeader,
    /// A line of the header is not understood.
    #[error("header line {line} is {found:?}, needed is {needed}")]
    HeaderLine {
        /// Number of the line.
        line: usize,
        /// The line, cut after 80 characters.
        found: String,
        /// What would be right.
        needed: &'static str,
    },
    /// An element or property is missing.
    #[error("element `{element}` has no property `{property}`")]
    MissingProperty {
        /// The element.
        element: &'static str,
        /// The property it needs.
        property: &'static str,
    },
    /// The data ends before the counts of the header are met.
    #[error("the data ends in row {row} of element `{element}`, the header promises {count} rows")]
    Truncated {
        /// The element.
        element: String,
        /// The row that is not complete.
        row: u64,
        /// Rows that the header promises.
        count: u64,
    },
    /// A value of an ASCII file is not of its type.
    #[error("element `{element}`, row {row}, property `{property}`: found {found:?}, needed is {needed}")]
    Value {
        /// The element.
        element: String,
        /// Its row.
        row: u64,
        /// The property.
        property: String,
        /// The text, cut after 80 characters.
        found: String,
        /// What would be right.
        needed: &'static str,
    },
    /// A vertex has a coordinate that is NaN, infinite or too large for single precision.
    #[error("vertex {vertex} has a coordinate that is not finite in single precision")]
    NonFiniteVertex {
        /// The vertex.
        vertex: u64,
    },
    /// A face uses a vertex that does not exist.
    #[error("face {face} uses vertex {index}, there are {vertices} vertices")]
    IndexOutOfRange {
        /// The face.
        face: u64,
        /// The index it has.
        index: i64,
        /// Number of vertices.
        vertices: u64,
    },
    /// A face has fewer than three corners.
    #[error("face {face} has {corners} corners, at least 3 are needed")]
    Polygon {
        /// The face.
        face: u64,
        /// How many it has.
        corners: usize,
    },
    /// There is data after the last element.
    #[error("{bytes} bytes follow the last element that the header promises")]
    TrailingData {
        /// How much there is.
        bytes: usize,
    },
    /// A cloud to be written has lists of different lengths, or more entries than the format can count.
    #[error("the cloud has {found} {list}, needed are {needed}")]
    Lengths {
        /// The list.
        list: &'static str,
        /// Its length.
        found: usize,
        /// What would be right.
        needed: String,
    },
}

/// At most 80 characters of `text`, for a message.
pub(in crate::io) fn shortened(text: &[u8]) -> String {
    let end = text.len().min(320);
    String::from_utf8_lossy(&text[..end]).chars().take(80).collect()
}
