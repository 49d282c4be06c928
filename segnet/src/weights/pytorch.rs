//! State dicts that PyTorch saved, by the reader of Burn's authors.

use std::collections::BTreeMap;
use std::path::Path;

use pytorch_reader::{DType, PytorchError, PytorchReader};

use super::stored::{Content, Float, StoredTensor};
use crate::{Error, Result};

/// Endings of file names that mean PyTorch.
const EXTENSIONS: [&str; 4] = ["pth", "pt", "ckpt", "bin"];

/// Whether a file that begins so is PyTorch's: by content, else by name.
pub(super) fn is_pytorch(path: &Path, start: &[u8]) -> bool {
    // Eight bytes of length before the JSON of a safetensors file, which may begin like a pickle.
    let safetensors = start.get(8) == Some(&b'{');
    let zip_or_pickle = start.starts_with(b"PK\x03\x04") || start.first() == Some(&0x80);
    let extension = path.extension().and_then(|extension| extension.to_str()).map(str::to_lowercase);
    !safetensors && (zip_or_pickle || extension.is_some_and(|found| EXTENSIONS.contains(&found.as_str())))
}

/// The tensors of all dictionaries in the file, by their path through them (`state_dict.conv1.weight`), content unread.
pub(super) fn tensors(path: &Path) -> Result<BTreeMap<String, StoredTensor>> {
    let reader = PytorchReader::new(path).map_err(|error| match error {
        PytorchError::Io(source) if source.raw_os_error().is_some() => Error::Io { path: path.to_owned(), source },
        error => Error::Format { path: path.to_owned(), reason: format!("no PyTorch file: {error}") },
    })?;
    Ok(reader.into_tensors().into_iter().map(|(name, tensor)| (name, stored(tensor))).collect())
}

fn stored(tensor: pytorch_reader::Tensor) -> StoredTensor {
    let float = match tensor.dtype() {
        DType::F16 => Some(Float::F16),
        DType::BF16 => Some(Float::Bf16),
        DType::F32 => Some(Float::F32),
        DType::F64 => Some(Float::F64),
        _ => None,
    };
    StoredTensor {
        float,
        number_type: format!("{:?}", tensor.dtype()),
        shape: tensor.shape().to_vec(),
        content: Content::Pytorch(tensor),
    }
}
