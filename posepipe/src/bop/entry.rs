//! One object inside a JSON file, read key by key with errors that name file, entry and key.

use std::{collections::BTreeMap, path::Path};

use serde_json::{Map, Value};

use super::file::{data_error, read_bytes};
use crate::{Error, Result};

/// The keyed numbers of one image or object in a BOP JSON file.
pub(super) struct Entry<'a> {
    path: &'a Path,
    /// Where in the file, for messages: `image 3, object 0`.
    place: String,
    fields: &'a Map<String, Value>,
}

impl<'a> Entry<'a> {
    pub(super) fn new(path: &'a Path, place: String, value: &'a Value) -> Result<Self> {
        match value {
            Value::Object(fields) => Ok(Self { path, place, fields }),
            other => Err(data_error(path, format!("{place}: found {}, an object is needed", kind(other)))),
        }
    }

    /// The number under `key`.
    pub(super) fn number(&self, key: &str) -> Result<f64> {
        let value = self.required(key)?;
        value.as_f64().ok_or_else(|| self.wrong(key, "a number", value))
    }

    /// The whole number under `key`.
    pub(super) fn integer(&self, key: &str) -> Result<u32> {
        let value = self.required(key)?;
        let number = value.as_u64().and_then(|number| u32::try_from(number).ok());
        number.ok_or_else(|| self.wrong(key, "a whole number from 0 to 4294967295", value))
    }

    /// The list of `N` numbers under `key`.
    pub(super) fn numbers<const N: usize>(&self, key: &str) -> Result<[f64; N]> {
        let value = self.required(key)?;
        numbers(value).ok_or_else(|| self.wrong(key, &format!("a list of {N} numbers"), value))
    }

    /// The number under `key`, if the key is there at all.
    pub(super) fn number_if_present(&self, key: &str) -> Result<Option<f64>> {
        self.has(key).then(|| self.number(key)).transpose()
    }

    /// The elements of the list under `key`; none if the key is missing.
    pub(super) fn list(&self, key: &str) -> Result<&'a [Value]> {
        match self.fields.get(key) {
            None => Ok(&[]),
            Some(Value::Array(elements)) => Ok(elements),
            Some(other) => Err(self.wrong(key, "a list", other)),
        }
    }

    pub(super) fn has(&self, key: &str) -> bool {
        self.fields.contains_key(key)
    }

    /// An error about this entry.
    pub(super) fn error(&self, reason: &str) -> Error {
        data_error(self.path, format!("{}: {reason}", self.place))
    }

    fn required(&self, key: &str) -> Result<&'a Value> {
        self.fields.get(key).ok_or_else(|| self.error(&format!("key `{key}` is missing")))
    }

    fn wrong(&self, key: &str, needed: &str, found: &Value) -> Error {
        self.error(&format!("`{key}` is {}, {needed} is needed", kind(found)))
    }
}

/// A list of exactly `N` numbers.
pub(super) fn numbers<const N: usize>(value: &Value) -> Option<[f64; N]> {
    let numbers: Option<Vec<f64>> = value.as_array()?.iter().map(Value::as_f64).collect();
    numbers?.try_into().ok()
}

/// A JSON file that maps ids to values, sorted by id.
pub(super) fn read_by_id(path: &Path) -> Result<BTreeMap<u32, Value>> {
    let bytes = read_bytes(path)?;
    let root = serde_json::from_slice(&bytes).map_err(|source| Error::Json { path: path.to_owned(), source })?;
    let Value::Object(fields) = root else {
        return Err(data_error(path, format!("found {}, an object that maps ids to entries is needed", kind(&root))));
    };
    let mut entries = BTreeMap::new();
    for (key, value) in fields {
        let id: u32 =
            key.parse().map_err(|_| data_error(path, format!("key `{key}` is not an id (a whole number)")))?;
        if entries.insert(id, value).is_some() {
            return Err(data_error(path, format!("id {id} appears twice")));
        }
    }
    Ok(entries)
}

/// What a value is, for messages.
pub(super) fn kind(value: &Value) -> String {
    match value {
        Value::Null => "null".into(),
        Value::Bool(_) => "true or false".into(),
        Value::Number(number) => format!("the number {number}"),
        Value::String(_) => "a string".into(),
        Value::Array(elements) => format!("a list of {}", elements.len()),
        Value::Object(_) => "an object".into(),
    }
}
