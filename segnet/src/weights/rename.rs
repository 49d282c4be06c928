//! Between the names in a file and those of our module tree.

use crate::BiSeNet;
use crate::backbone::Backbone;

/// Pairs of name prefixes, each ending in a dot: in the file, in the module tree. Names without a pair are the same in
/// both.
pub(crate) struct Renaming {
    pairs: Vec<(String, String)>,
}

impl Renaming {
    /// Our own files: the module tree without the names of the layout, the backbone's kind, `context` and `layers`, so that
    /// `spatial.0.conv.weight` and `backbone.blocks.3.depthwise.bn.running_mean` are names, as a plain PyTorch
    /// network of this layout has them.
    pub(crate) fn own(net: &BiSeNet) -> Self {
        Self { pairs: net.file_names() }
    }

    /// Every name stays.
    pub(crate) fn none() -> Self {
        Self { pairs: Vec::new() }
    }

    /// Between [`Backbone::published_names`] and a backbone's module tree.
    pub(crate) fn published(backbone: &Backbone) -> Self {
        let below = |(file, module)| (file, format!("{}.{module}", backbone.module_name()));
        Self { pairs: backbone.published_names().into_iter().map(below).collect() }
    }

    /// A name of the module tree as the file spells it.
    pub(crate) fn in_file(&self, name: &str) -> String {
        let renamed = |(file, module): &(String, String)| Some(format!("{file}{}", name.strip_prefix(module)?));
        self.pairs.iter().find_map(renamed).unwrap_or_else(|| name.to_owned())
    }
}
