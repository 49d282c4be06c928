//! How a PCD file can be wrong.

/// What is wrong with a PCD file, or with a cloud to be written as one. Rows count from 0, lines from 1.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PcdFault {
    /// The first line that is no comment is not one of a PCD header.
    #[error("starts with {found:?}, a PCD file starts with comments and lines such as `VERSION 0.7`")]
    NotPcd {
        /// The line, cut after 80 characters.
        found: String,
    },
    /// The file ends before the line `DATA`.
    #[error("the header does not end: line `DATA ascii|binary|binary_compressed` is missing")]
    UnfinishedHeader,
    /// A line of the header is not understood.
    #[error("header line {line} is {found:?}, needed is {needed}")]
    HeaderLine {
        /// Number of the line.
        line: usize,
        /// The line, cut after 80 characters.
        found: String,
        /// What would be right.
        needed: String,
    },
    /// The header has no line of this kind.
    #[error("the header has no line `{keyword}`")]
    MissingLine {
        /// How the line would start.
        keyword: &'static str,
    },
    /// A field is missing, or holds several numbers.
    #[error("there is no field `{field}` of count 1")]
    MissingField {
        /// The field.
        field: &'static str,
    },
    /// A field of floating point numbers has a size that these do not come in.
    #[error("field `{field}` is a float of {size} bytes, 4 or 8 are needed")]
    FloatSize {
        /// The field.
        field: String,
        /// Its size in bytes.
        size: u64,
    },
    /// Width, height and number of points do not fit together.
    #[error("the header states {width}x{height} and {points} points")]
    PointCount {
        /// Points in a row.
        width: u64,
        /// Rows.
        height: u64,
        /// Points in all.
        points: u64,
    },
    /// There is less data than the header promises.
    #[error("{found} bytes of data follow the header, which promises {needed}")]
    Truncated {
        /// Bytes that are there.
        found: u64,
        /// Bytes needed; `u64::MAX` for any number above it.
        needed: u64,
    },
    /// There are fewer rows of text than the header promises.
    #[error("the data ends after {found} rows, the header promises {needed}")]
    MissingRows {
        /// Rows that are there.
        found: u64,
        /// Rows needed.
        needed: u64,
    },
    /// A row of text has too few or too many numbers.
    #[error("row {row} has {found} numbers, {needed} are needed")]
    RowLength {
        /// The row.
        row: u64,
        /// Numbers it has.
        found: u64,
        /// Numbers it needs.
        needed: u64,
    },
    /// A value of an ASCII file is not of its type.
    #[error("row {row}, field `{field}`: found {found:?}, needed is {needed}")]
    Value {
        /// The row.
        row: u64,
        /// The field.
        field: String,
        /// The text, cut after 80 characters.
        found: String,
        /// What would be right.
        needed: &'static str,
    },
    /// The compressed data states another size than the header.
    #[error("the compressed data states {found} bytes once unpacked, the header promises {needed}")]
    UnpackedSize {
        /// Bytes stated.
        found: u64,
        /// Bytes needed; `u64::MAX` for any number above it.
        needed: u64,
    },
    /// The compressed data is broken.
    #[error("the compressed data is broken at byte {at}: {what}")]
    Compression {
        /// Bytes of compressed data before the fault.
        at: usize,
        /// What is wrong.
        what: &'static str,
    },
    /// There is data after the last point.
    #[error("{bytes} bytes follow the last point that the header promises")]
    TrailingData {
        /// How much there is.
        bytes: usize,
    },
    /// A cloud to be written has lists of different lengths, or more than the format can count.
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
