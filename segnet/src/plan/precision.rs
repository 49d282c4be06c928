//! What the products of a plan are taken in.

use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// What the products of a [`Plan`](crate::Plan) are taken in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// Single precision.
    #[default]
    F32,
    /// Weights and what they are multiplied with are rounded to bfloat16, which has eight bits of mantissa. Sums, depthwise
    /// convolutions, residuals, the backbone's stem, 3x3 convolutions of large maps (by Winograd's method), attention and
    /// the logits of fewer than sixteen classes stay in single precision. Faster on processors with AVX-512 BF16
    /// ([`Isa::Avx512Bf16`](crate::kernels::Isa::Avx512Bf16)), slower on others, which compute the same but for rounding
    /// and for subnormal numbers.
    Bf16,
}

impl Precision {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::F32, Self::Bf16];

    /// `f32` or `bf16`.
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::Bf16 => "bf16",
        }
    }
}

impl std::fmt::Display for Precision {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl std::str::FromStr for Precision {
    type Err = Error;

    /// From its name, in capitals or not.
    fn from_str(text: &str) -> Result<Self> {
        let named = Self::ALL.into_iter().find(|precision| precision.name().eq_ignore_ascii_case(text));
        named.ok_or_else(|| Error::config("precision", text, "f32 or bf16"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back() {
        for precision in Precision::ALL {
            assert_eq!(precision.to_string().to_uppercase().parse::<Precision>().ok(), Some(precision));
            let json = serde_json::to_string(&precision).ok();
            assert_eq!(json, Some(format!("\"{precision}\"")));
        }
        assert!("f16".parse::<Precision>().is_err());
    }
}
