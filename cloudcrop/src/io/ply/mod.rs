//! PLY, after Turk's description of 1994 ("The PLY polygon file format"), version 1.0.

mod fault;
mod header;
mod reader;
mod values;
mod writer;

pub use fault::PlyFault;
pub(super) use fault::shortened;
pub use reader::{parse_ply, read_ply};
pub use writer::{PlyEncoding, write_ply, write_ply_as};
