//! One tensor of a file, whatever the file's format.

use std::ops::Range;
use std::sync::Arc;

use burn::tensor::{bf16, f16};

/// Type of a tensor's numbers. All become single precision.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Float {
    F16,
    Bf16,
    F32,
    F64,
}

impl Float {
    /// Little-endian bytes as numbers.
    fn values(self, bytes: &[u8]) -> Vec<f32> {
        match self {
            Self::F16 => bytes.as_chunks().0.iter().map(|&number| f16::from_le_bytes(number).to_f32()).collect(),
            Self::Bf16 => bytes.as_chunks().0.iter().map(|&number| bf16::from_le_bytes(number).to_f32()).collect(),
            Self::F32 => bytes.as_chunks().0.iter().map(|&number| f32::from_le_bytes(number)).collect(),
            Self::F64 => bytes.as_chunks().0.iter().map(|&number| f64::from_le_bytes(number) as f32).collect(),
        }
    }
}

/// A tensor whose content has not been read yet.
pub(super) struct StoredTensor {
    /// `None` for whole numbers and the like, which no weight is.
    pub(super) float: Option<Float>,
    /// The type as its format calls it.
    pub(super) number_type: String,
    pub(super) shape: Vec<usize>,
    pub(super) content: Content,
}

/// Where a tensor's bytes are.
pub(super) enum Content {
    /// In a file that was read as a whole.
    Memory { file: Arc<Vec<u8>>, range: Range<usize> },
    /// In a PyTorch file, which is read tensor by tensor.
    Pytorch(pytorch_reader::Tensor),
}

impl StoredTensor {
    /// Type and shape, for messages.
    pub(super) fn described(&self) -> String {
        format!("{} {:?}", self.number_type, self.shape)
    }

    /// Whether its values are ones for a tensor of this shape.
    pub(super) fn fits(&self, shape: &[usize]) -> bool {
        self.float.is_some() && self.shape == shape
    }

    /// The content, little-endian, row by row.
    pub(super) fn bytes(&self) -> std::io::Result<Vec<u8>> {
        match &self.content {
            Content::Memory { file, range } => Ok(file[range.clone()].to_vec()),
            Content::Pytorch(tensor) => tensor.read(),
        }
    }

    /// The content in single precision; empty if it is no floating-point tensor.
    pub(super) fn values(&self) -> std::io::Result<Vec<f32>> {
        let Some(float) = self.float else { return Ok(Vec::new()) };
        match &self.content {
            Content::Memory { file, range } => Ok(float.values(&file[range.clone()])),
            Content::Pytorch(tensor) => Ok(float.values(&tensor.read()?)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One and a half, minus an eighth and a number beyond half precision, in each type's bits.
    #[test]
    fn every_float_becomes_single_precision() {
        let doubles: Vec<u8> = [1.5_f64, -0.125, 1e39].into_iter().flat_map(f64::to_le_bytes).collect();
        assert_eq!(Float::F64.values(&doubles), [1.5, -0.125, f32::INFINITY]);
        let singles: Vec<u8> = [1.5_f32, -0.125].into_iter().flat_map(f32::to_le_bytes).collect();
        assert_eq!(Float::F32.values(&singles), [1.5, -0.125]);
        assert_eq!(Float::F16.values(&[0x00, 0x3e, 0x00, 0xb0, 0x00, 0x7c]), [1.5, -0.125, f32::INFINITY]);
        assert_eq!(Float::Bf16.values(&[0xc0, 0x3f, 0x00, 0xbe]), [1.5, -0.125]);
    }
}
