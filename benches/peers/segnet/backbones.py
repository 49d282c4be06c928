"""Times segnet_rival against PyTorch with each backbone.

usage: backbones.py --peers DIR --python VENV/bin/python --rival target/release/segnet_rival [--rounds 3]
                    [--size 512x288] [--backbones ResNet18,...] [--results benches/RESULTS.md]

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
    parser.add_argument("--backbones", default="MobileNetV2,ResNet18,DenseNet121,ResNet50,Xception")
    parser.add_argument("--results", type=Path)
    options = parser.parse_args()
    harness = lambda kind, *arguments: (bench, [options.python, "-c", HARNESS, options.peers, kind, *arguments])
    ours = lambda kind, *arguments: (rival, [options.rival, *arguments, "--backbone", kind])
    head = f"| | inference {options.size}: ours | PyTorch | ratio | training step {options.train_size}, batch {options.batch}: ours | PyTorch | ratio | peak RSS ours | PyTorch |"
    rows = [head, "|---|---|---|---|---|---|---|---|---|"]
    for kind in options.backbones.split(","):
        infer = ["--size", options.size, "--threads", options.threads]
        train = ["--size", options.train_size, "--threads", options.threads, "--batch", options.batch]
        inference = alternate({
            "ours": ours(kind, "infer", *infer, "--rounds", 30),
            "PyTorch": harness(kind, "infer", *infer, "--only", "torch_cl", "--reps", 30),
        }, options.rounds)
        training = alternate({
            "ours": ours(kind, "train", *train, "--steps", 5),
            "PyTorch": harness(kind, "train", *train, "--channels-last", "--reps", 30),
        }, options.rounds)
        cells = [kind]
        for found, column in [(inference, 1), (training, 0)]:
            mine, theirs = (found[name][column] if name in found else None for name in ["ours", "PyTorch"])
            ratio = f"{theirs / mine:.2f}" if mine and theirs else "-"
            cells += [milliseconds(mine), milliseconds(theirs), ratio]
        cells += [f"{training[name][2]:.0f} MiB" if name in training else "-" for name in ["ours", "PyTorch"]]
        rows.append("| " + " | ".join(cells) + " |")
        print(rows[-1], flush=True)
    text = [f"{options.rounds} alternated rounds; inference by fastest calls, training by medians.", "", *rows]
    if options.results:
        before, rest = options.results.read_text().split(BEGIN)
        options.results.write_text(before + "\n".join([BEGIN, *text, END]) + rest.split(END)[1])


if __name__ == "__main__":
    sys.exit(main())
