//! Between the names in a file and those of our module tree.

use crate::MobileNetV2;

/// Pairs of name prefixes, each ending in a dot: in the file, in the module tree. Names without a pair are the same in
/// both.
pub(crate) struct Renaming {
    pairs: Vec<(String, String)>,
}

impl Renaming {
    /// Our own files: the module tree without the folders `context` and `layers`, so that
    /// `spatial.0.conv.weight` and `backbone.blocks.3.depthwise.bn.running_mean` are names, as a plain PyTorch network
    /// of this layout has them.
    pub(crate) fn own() -> Self {
        let context = ["backbone", "tail", "arm16", "arm32", "refine16", "refine32"];
        let mut pairs = vec![("spatial.".to_owned(), "spatial.layers.".to_owned())];
        pairs.extend(context.map(|name| (format!("{name}."), format!("context.{name}."))));
        Self { pairs }
    }

    /// Torchvision's `mobilenet_v2`: layer 0 of `features` is the stem, layer n + 1 holds block n.
    pub(crate) fn torchvision_backbone(backbone: &MobileNetV2) -> Self {
        let mut pairs = Vec::new();
        let mut pair = |file: String, [conv, bn]: [&str; 2], module: String| {
            pairs.push((format!("{file}.{conv}."), format!("{module}.conv.")));
            pairs.push((format!("{file}.{bn}."), format!("{module}.bn.")));
        };
        pair("features.0".to_owned(), ["0", "1"], "stem".to_owned());
        for (block, expands) in backbone.expansions().enumerate() {
            let (file, module) = (format!("features.{}.conv", block + 1), format!("blocks.{block}"));
            let depthwise = usize::from(expands);
            if expands {
                pair(format!("{file}.0"), ["0", "1"], format!("{module}.expand"));
            }
            pair(format!("{file}.{depthwise}"), ["0", "1"], format!("{module}.depthwise"));
            let project = [(depthwise + 1).to_string(), (depthwise + 2).to_string()];
            pair(file, [&project[0], &project[1]], format!("{module}.project"));
        }
        Self { pairs }
    }

    /// A name of the module tree as the file spells it.
    pub(crate) fn in_file(&self, name: &str) -> String {
        let renamed = |(file, module): &(String, String)| Some(format!("{file}{}", name.strip_prefix(module)?));
        self.pairs.iter().find_map(renamed).unwrap_or_else(|| name.to_owned())
    }

    /// Regular expressions over file names, with their replacements.
    pub(crate) fn patterns(&self) -> impl Iterator<Item = (String, &str)> {
        self.pairs.iter().map(|(file, module)| (format!("^{}", file.replace('.', r"\.")), module.as_str()))
    }
}
