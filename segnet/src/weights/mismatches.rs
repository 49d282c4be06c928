//! How the tensors of a file differ from those that a network needs.

use std::collections::BTreeMap;
use std::fmt;

/// All that keeps the tensors of a file from being a network's.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Mismatches {
    /// Number of tensors that the network needs.
    pub needed: usize,
    /// Names of those that the file lacks, as it should spell them.
    pub missing: Vec<String>,
    /// Names in the file that have no place in the network.
    pub unexpected: Vec<String>,
    /// Tensors of another shape, or not of floating-point numbers.
    pub reshaped: Vec<Reshaped>,
    /// Pairs of an unexpected and a missing name that may mean the same tensor: equal shapes, and either names that
    /// differ by a prefix alone or no other tensor of this shape among the missing and the unexpected.
    pub renamed: Vec<Renamed>,
}

/// A tensor that has its name, but not its shape or number type.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reshaped {
    /// Its name in the file.
    pub name: String,
    /// Number type and shape found.
    pub found: String,
    /// Number type and shape needed.
    pub needed: String,
}

/// A name in a file that may stand for one of the network's.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Renamed {
    /// The name in the file.
    pub found: String,
    /// The name that is missing.
    pub needed: String,
}

/// Shapes by name.
pub(super) type Shapes<'a> = BTreeMap<&'a str, &'a [usize]>;

impl Mismatches {
    pub(super) fn new(needed: usize, missing: &Shapes<'_>, unexpected: &Shapes<'_>, reshaped: Vec<Reshaped>) -> Self {
        let names = |shapes: &Shapes<'_>| shapes.keys().map(|&name| name.to_owned()).collect();
        let renamed = renamed(missing, unexpected);
        Self { needed, missing: names(missing), unexpected: names(unexpected), reshaped, renamed }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.missing.is_empty() && self.unexpected.is_empty() && self.reshaped.is_empty()
    }
}

fn renamed(missing: &Shapes<'_>, unexpected: &Shapes<'_>) -> Vec<Renamed> {
    let twin = |needed: &str, shape: &[usize]| {
        let mut same_shape = unexpected.iter().filter(|&(_, &other)| other == shape).map(|(&name, _)| name);
        let first = same_shape.clone().next()?;
        let alone =
            same_shape.clone().nth(1).is_none() && missing.values().filter(|&&other| other == shape).count() == 1;
        same_shape.find(|found| differ_by_prefix(found, needed)).or(alone.then_some(first))
    };
    let pair = |(&needed, &shape): (&&str, &&[usize])| {
        twin(needed, shape).map(|found| Renamed { found: found.to_owned(), needed: needed.to_owned() })
    };
    missing.iter().filter_map(pair).collect()
}

/// Whether one name is the other behind further dotted parts.
fn differ_by_prefix(one: &str, other: &str) -> bool {
    let behind = |long: &str, short: &str| long.strip_suffix(short).is_some_and(|prefix| prefix.ends_with('.'));
    behind(one, other) || behind(other, one)
}

impl fmt::Display for Mismatches {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names = |names: &[String]| listed(names, String::clone);
        let reshaped = listed(&self.reshaped, |one| format!("{} is {}, needed {}", one.name, one.found, one.needed));
        let renamed = listed(&self.renamed, |one| format!("{} for {}", one.found, one.needed));
        write!(f, "{} tensors needed", self.needed)?;
        for (count, what, listed) in [
            (self.missing.len(), "missing", names(&self.missing)),
            (self.unexpected.len(), "unexpected", names(&self.unexpected)),
            (self.reshaped.len(), "of another kind", reshaped),
            (self.renamed.len(), "perhaps renamed", renamed),
        ] {
            if count > 0 {
                write!(f, "; {count} {what} ({listed})")?;
            }
        }
        Ok(())
    }
}

/// The first few of many.
pub(crate) fn listed<T>(all: &[T], text: impl Fn(&T) -> String) -> String {
    const SHOWN: usize = 4;
    let rest = all.len().saturating_sub(SHOWN);
    let first = all[..all.len() - rest].iter().map(text).collect::<Vec<_>>().join(", ");
    if rest == 0 { first } else { format!("{first} and {rest} more") }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn renamed_of(missing: &[(&str, &[usize])], unexpected: &[(&str, &[usize])]) -> Vec<(String, String)> {
        let shapes = (missing.iter().copied().collect(), unexpected.iter().copied().collect());
        let found = Mismatches::new(9, &shapes.0, &shapes.1, Vec::new());
        found.renamed.into_iter().map(|pair| (pair.found, pair.needed)).collect()
    }

    fn pair(found: &str, needed: &str) -> (String, String) {
        (found.to_owned(), needed.to_owned())
    }

    #[test]
    fn a_prefix_is_recognized_among_equal_shapes() {
        let missing: [(&str, &[usize]); 2] = [("bn.bias", &[8]), ("bn.weight", &[8])];
        let found = renamed_of(&missing, &[("net.bn.bias", &[8]), ("net.bn.weight", &[8]), ("xbn.bias", &[8])]);
        assert_eq!(found, [pair("net.bn.bias", "bn.bias"), pair("net.bn.weight", "bn.weight")]);
        assert_eq!(renamed_of(&[("net.bn.bias", &[8])], &[("bn.bias", &[8])]), [pair("bn.bias", "net.bn.bias")]);
        assert_eq!(renamed_of(&[("bn.bias", &[8])], &[("net.bn.bias", &[4])]), []);
    }

    #[test]
    fn a_shape_names_a_tensor_only_if_it_is_the_only_one_of_its_shape() {
        assert_eq!(renamed_of(&[("stem", &[3, 8])], &[("conv1", &[3, 8])]), [pair("conv1", "stem")]);
        assert_eq!(renamed_of(&[("stem", &[3, 8])], &[("conv1", &[3, 8]), ("conv2", &[3, 8])]), []);
        assert_eq!(renamed_of(&[("stem", &[8]), ("tail", &[8])], &[("conv1", &[8])]), []);
    }

    #[test]
    fn the_message_counts_and_names_the_first() {
        let many = ["a", "b", "c", "d", "e", "f"].map(str::to_owned).to_vec();
        let reshaped = Reshaped { name: "x".into(), found: "I64 [2]".into(), needed: "F32 [3]".into() };
        let found = Mismatches {
            needed: 20,
            missing: many,
            unexpected: vec!["net.a".into()],
            reshaped: vec![reshaped],
            renamed: vec![Renamed { found: "net.a".into(), needed: "a".into() }],
        };
        let expected = "20 tensors needed; 6 missing (a, b, c, d and 2 more); 1 unexpected (net.a); 1 of another kind (x \
                        is I64 [2], needed F32 [3]); 1 perhaps renamed (net.a for a)";
        assert_eq!(found.to_string(), expected);
    }
}
