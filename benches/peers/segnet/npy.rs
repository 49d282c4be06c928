//! `NumPy`'s `.npy` files, version 1.0, little-endian float32 in C order.

use std::path::Path;

use anyhow::{Context as _, Result, bail, ensure};

const MAGIC: &[u8] = b"\x93NUMPY";

/// Shape and values.
pub(crate) fn read(path: &Path) -> Result<(Vec<usize>, Vec<f32>)> {
    let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
    parse(&bytes).with_context(|| format!("{} is no .npy file that can be read here", path.display()))
}

fn parse(bytes: &[u8]) -> Result<(Vec<usize>, Vec<f32>)> {
    let rest = bytes.strip_prefix(MAGIC).context("no magic number")?;
    ensure!(rest.len() >= 4 && rest[0] == 1, "version 1 is needed");
    let length = usize::from(u16::from_le_bytes([rest[2], rest[3]]));
    let header = std::str::from_utf8(rest.get(4..4 + length).context("cut off in the header")?)?;
    ensure!(header.contains("'<f4'"), "little-endian float32 is needed: {header}");
    ensure!(header.contains("'fortran_order': False"), "C order is needed: {header}");
    let shape = header.split_once("'shape': (").and_then(|(_, rest)| rest.split_once(')')).context("no shape")?.0;
    let sides = shape.split(',').map(str::trim).filter(|side| !side.is_empty());
    let shape: Vec<usize> = sides.map(str::parse).collect::<Result<_, _>>().context("the shape")?;
    let data = &rest[4 + length..];
    let count = shape.iter().try_fold(1_usize, |count, side| count.checked_mul(*side)).context("the shape")?;
    if count.checked_mul(4) != Some(data.len()) {
        bail!("{} bytes of data for the shape {shape:?}", data.len());
    }
    let values = data.chunks_exact(4).map(|bytes| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]));
    Ok((shape, values.collect()))
}

/// Writes values of a shape.
pub(crate) fn write(path: &Path, shape: [usize; 4], values: &[f32]) -> Result<()> {
    let sides: Vec<String> = shape.iter().map(usize::to_string).collect();
    let mut header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({}), }}", sides.join(", "));
    // Magic, version, length and header together fill a multiple of 64 bytes, the last a line feed.
    let used = MAGIC.len() + 4 + header.len() + 1;
    header.push_str(&" ".repeat(used.next_multiple_of(64) - used));
    header.push('\n');
    let mut bytes = MAGIC.to_vec();
    bytes.extend([1, 0]);
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    std::fs::write(path, bytes).with_context(|| path.display().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_back_and_nonsense_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("x.npy");
        let values: Vec<f32> = (0..24).map(|i| i as f32 - 7.5).collect();
        write(&path, [1, 2, 3, 4], &values).expect("room for a small file");
        let bytes = std::fs::read(&path).expect("just written");
        assert_eq!((bytes.len() - 4 * values.len()) % 64, 0);
        assert_eq!(read(&path).expect("just written"), (vec![1, 2, 3, 4], values));
        for end in 0..bytes.len() {
            assert!(parse(&bytes[..end]).is_err(), "cut off at {end}");
        }
    }
}
