//! What training programs put around a network's own names.

use std::path::Path;

use crate::{Error, Result};

/// Keys under which checkpoints keep the state dict, beside optimizers and counters.
const KEYS: [&str; 4] = ["", "state_dict.", "model_state_dict.", "model."];
/// What `DataParallel` and `torch.compile` put before each name.
const WRAPPERS: [&str; 3] = ["", "module.", "_orig_mod."];

/// The one prefix under which the file has names that the network needs; none if there is no such name.
///
/// A file that has them as they are is never looked at under a prefix.
pub(super) fn prefix(path: &Path, names: &[&str], is_needed: impl Fn(&str) -> bool) -> Result<String> {
    let prefixes = KEYS.into_iter().flat_map(|key| WRAPPERS.map(|wrapper| format!("{key}{wrapper}")));
    let holds = |prefix: &String| names.iter().any(|name| name.strip_prefix(prefix.as_str()).is_some_and(&is_needed));
    let mut found: Vec<String> = prefixes.filter(holds).collect();
    if found.len() > 1 && !found[0].is_empty() {
        let reason = format!("the network's tensors stand in it under {}: keep one of them", found.join(" and "));
        return Err(Error::Format { path: path.to_owned(), reason });
    }
    Ok(if found.is_empty() { String::new() } else { found.swap_remove(0) })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn prefix_of(names: &[&str]) -> Result<String> {
        prefix(Path::new("some.pth"), names, |name| name == "conv.weight")
    }

    #[test]
    fn one_prefix_is_found() {
        for prefix in ["", "module.", "state_dict.", "model.", "state_dict.module.", "model_state_dict._orig_mod."] {
            let weight = format!("{prefix}conv.weight");
            assert_eq!(prefix_of(&[&weight, "optimizer.state.0.exp_avg"]).unwrap(), prefix);
        }
        assert_eq!(prefix_of(&["model.net.conv.weight", "epoch"]).unwrap(), "");
        assert_eq!(prefix_of(&[]).unwrap(), "");
    }

    #[test]
    fn plain_names_come_first_and_two_prefixes_are_one_too_many() {
        assert_eq!(prefix_of(&["conv.weight", "module.conv.weight"]).unwrap(), "");
        let error = prefix_of(&["model.conv.weight", "state_dict.conv.weight"]).unwrap_err().to_string();
        assert!(error.contains("state_dict. and model."), "{error}");
    }
}
