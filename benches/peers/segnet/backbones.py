"""Times segnet_rival against PyTorch with each backbone, and with MobileNetV2 at each of the paper's sizes.

usage: backbones.py --peers DIR --python VENV/bin/python --rival target/release/segnet_rival [--rounds 3]
                    [--size 512x288] [--backbones ResNet18,...] [--sizes 288x160,...] [--results benches/RESULTS.md]

DIR holds bench.py and model.py as for compare.py; torchvision and timm must be installed, too. A network of PyTorch is
that of model.py with its backbone replaced by torchvision's or, for Xception, timm's; batch norms are folded by torch.fx
for inference. Weights are random: convolutions take the same time whatever they are.
"""
import argparse
import sys
from pathlib import Path

from compare import alternate, bench, milliseconds, rival

BEGIN, END = "<!-- segnet backbones: begin -->", "<!-- segnet backbones: end -->"
# Run by the interpreter that has PyTorch: arguments are DIR, the backbone, then those of bench.py.
HARNESS = """
import runpy, sys
peers, kind = sys.argv[1:3]
sys.path.insert(0, peers)
import model, timm, torch, torchvision
from torch.fx.experimental.optimization import fuse
from torchvision.models.feature_extraction import create_feature_extractor
nets = torchvision.models
make, taps, channels = {
    "MobileNetV2": (nets.mobilenet_v2, ["features.13", "features.17"], (96, 320)),
    "ResNet18": (nets.resnet18, ["layer3", "layer4"], (256, 512)),
    "ResNet50": (nets.resnet50, ["layer3", "layer4"], (1024, 2048)),
    "DenseNet121": (nets.densenet121, ["features.denseblock3", "features.norm5"], (1024, 1024)),
    "Xception": (lambda: timm.create_model("legacy_xception"), ["block11", "act4"], (728, 2048)),
}[kind]
class Backbone(torch.nn.Module):
    def __init__(self, last=False):
        super().__init__()
        self.net = create_feature_extractor(make(), dict(zip(taps, ["c16", "c32"])))
        self.channels = channels
    def forward(self, x):
        found = self.net(x)
        return found["c16"], found["c32"]
model.MobileNetV2 = Backbone
fold = model.fold_bn
def fold_all(net):
    folded = fold(net)
    for module in folded.modules():  # a copied graph does not pass eval() on
        module.training = False
    folded.backbone.net = fuse(folded.backbone.net, inplace=True)
    return folded
model.fold_bn = fold_all
sys.argv = [peers + "/bench.py", *sys.argv[3:]]
runpy.run_path(sys.argv[0], run_name="__main__")
"""


def main():
    parser = argparse.ArgumentParser()
    for name in ["--peers", "--python", "--rival"]:
        parser.add_argument(name, required=True, type=Path)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--size", default="512x288")
    parser.add_argument("--train-size", default="288x160")
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--reps", type=int, default=30, help="of bench.py: training takes a sixth as many steps, five at least")
    parser.add_argument("--backbones", default="MobileNetV2,ResNet18,DenseNet121,ResNet50,Xception")
    parser.add_argument("--sizes", default="288x160,384x224,512x288,672x384,896x512")
    parser.add_argument("--results", type=Path)
    options = parser.parse_args()
    title = f"inference {options.size}, training step {options.train_size}"
    text = [f"{options.rounds} alternated round(s); inference by fastest calls, training, batch {options.batch}, by medians.", ""]
    text += table(options, title, [(kind, kind, options.size, options.train_size) for kind in listed(options.backbones)])
    text += ["", *table(options, "MobileNetV2", [(size, "MobileNetV2", size, size) for size in listed(options.sizes)])]
    if options.results:
        before, rest = options.results.read_text().split(BEGIN)
        options.results.write_text(before + "\n".join([BEGIN, *text, END]) + rest.split(END)[1])


def listed(text):
    return list(filter(None, text.split(",")))


def table(options, title, rows):
    """Lines for rows of (label, backbone, size of inference, size of training)."""
    lines = [f"| {title} | inference: ours | PyTorch | ratio | training step: ours | PyTorch | ratio | peak RSS ours | PyTorch |"]
    lines.append("|---" * 9 + "|")
    for label, kind, size, train_size in rows:
        lines.append("| " + " | ".join([label, *measured(options, kind, size, train_size)]) + " |")
        print(lines[-1], flush=True)
    return lines


def measured(options, kind, size, train_size):
    harness = lambda *arguments: (bench, [options.python, "-c", HARNESS, options.peers, kind, *arguments])
    ours = lambda *arguments: (rival, [options.rival, *arguments, "--backbone", kind])
    infer = ["--size", size, "--threads", options.threads]
    train = ["--size", train_size, "--threads", options.threads, "--batch", options.batch]
    inference = alternate({
        "ours": ours("infer", *infer, "--rounds", 30),
        "PyTorch": harness("infer", *infer, "--only", "torch_cl", "--reps", 30),
    }, options.rounds)
    training = alternate({
        "ours": ours("train", *train, "--steps", 5),
        "PyTorch": harness("train", *train, "--channels-last", "--reps", options.reps),
    }, options.rounds)
    cells = []
    for found, column in [(inference, 1), (training, 0)]:
        mine, theirs = (found[name][column] if name in found else None for name in ["ours", "PyTorch"])
        ratio = f"{theirs / mine:.2f}" if mine and theirs else "-"
        cells += [milliseconds(mine), milliseconds(theirs), ratio]
    return cells + [f"{training[name][2]:.0f} MiB" if name in training else "-" for name in ["ours", "PyTorch"]]


if __name__ == "__main__":
    sys.exit(main())
