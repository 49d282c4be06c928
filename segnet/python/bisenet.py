"""A network that segnet saved, in PyTorch: any backbone, any variant. Needs `backbones.py` beside it and torch; numpy
and pillow for images, onnx and onnxscript for the export.

    python bisenet.py net.safetensors                                   what the file holds
    python bisenet.py net.safetensors --image photo.jpg --labels out.png  a label map, pixel = class
    python bisenet.py net.safetensors --onnx net.onnx                   RGB in 0 to 1, [1, 3, height, width] -> logits
    python bisenet.py net.safetensors --state-dict net.pth              a plain state dict

In a program: `model, description = load("net.safetensors")`; `model` is an ordinary `torch.nn.Module` in evaluation
mode whose names are those in the file; a peak (`Segmenter::with_peak`) is used for label maps alone. In training mode it gives all logits in a tuple: main head and, but for the
variant Keras, auxiliary at 1/16 and 1/32.
"""

import argparse
import json
import struct
from pathlib import Path

import torch
import torch.nn as nn
import torch.nn.functional as F
from backbones import BACKBONES, ConvBn

PATH = 128


class Net:
    """The part of the description that decides the layers."""

    FIELDS = {"backbone", "variant", "classes", "width", "padding", "batch_norm_epsilon", "seed"}

    def __init__(self, net):
        if set(net) - self.FIELDS:
            raise ValueError(f"this script knows {', '.join(sorted(self.FIELDS))}, the file has {net}")
        net = {"backbone": "MobileNetV2", "variant": "Authors", **net}  # the oldest files name neither
        self.backbone = known("backbone", net, BACKBONES)
        self.variant = known("variant", net, VARIANTS)
        self.padding = known("padding", net, ("Symmetric", "TensorFlowSame"))
        self.classes, self.width, self.epsilon = net["classes"], net["width"], net["batch_norm_epsilon"]

    def channels(self, paper):
        """The nearest multiple of 8 to the scaled number, not below nine tenths of it; a half rounds up."""
        exact = paper * self.width
        nearest = max(8, int(exact / 8 + 0.5) * 8)
        return nearest + 8 if nearest < 0.9 * exact else nearest

    def conv3x3(self, cin, cout, stride=1):
        """A 3x3 convolution outside the backbone."""
        return ConvBn(cin, cout, 3, stride, separable=self.variant == "Lite")


def known(field, net, names):
    if net[field] not in names:
        raise ValueError(f"{field} is {net[field]!r}, this script knows {', '.join(names)}")
    return net[field]


class Arm(nn.Module):
    """Attention refinement."""

    def __init__(self, cin, cout, net):
        super().__init__()
        self.conv = net.conv3x3(cin, cout)
        self.att = ConvBn(cout, cout, 1, act=None)

    def forward(self, x):
        return weighted(self.conv(x), self.att)


class Ffm(nn.Module):
    """Feature fusion."""

    def __init__(self, channels):
        super().__init__()
        self.conv = ConvBn(channels, channels, 1)
        self.att1 = nn.Conv2d(channels, channels, 1, bias=False)
        self.att2 = nn.Conv2d(channels, channels, 1, bias=False)

    def forward(self, spatial, context):
        x = self.conv(torch.cat([spatial, context], 1))
        return x + weighted(x, self.att1, F.relu, self.att2)


class Head(nn.Module):
    def __init__(self, cin, middle, net):
        super().__init__()
        self.conv = net.conv3x3(cin, middle)
        self.out = nn.Conv2d(middle, net.classes, 1)

    def forward(self, x):
        return self.out(self.conv(x))


def mean(x):
    return x.mean((2, 3), keepdim=True)


def weighted(x, *attention):
    """Each channel times a factor that the means of all channels decide."""
    factors = mean(x)
    for layer in attention:
        factors = layer(factors)
    return x * torch.sigmoid(factors)


def resized(x, size):
    return F.interpolate(x, size=size, mode="bilinear", align_corners=False)


class Authors(nn.Module):
    """Normalised images [batch, 3, height, width] to logits [batch, classes, height, width], in the layout of BiSeNet's
    authors; the variant Lite has separable convolutions for the dense 3x3 ones and a first one of 3x3 for 7x7."""

    def __init__(self, net):
        super().__init__()
        path, middle = net.channels(PATH), net.channels(64)
        self.spatial = nn.Sequential(
            ConvBn(3, middle, 3 if net.variant == "Lite" else 7, 2),
            net.conv3x3(middle, middle, 2),
            net.conv3x3(middle, middle, 2),
            ConvBn(middle, path, 1),
        )
        self.backbone = BACKBONES[net.backbone](net)
        channels16, channels32 = self.backbone.channels
        self.tail = ConvBn(channels32, path, 1)
        self.arm32, self.arm16 = Arm(channels32, path, net), Arm(channels16, path, net)
        self.refine32, self.refine16 = net.conv3x3(path, path), net.conv3x3(path, path)
        self.ffm = Ffm(2 * path)
        self.head = Head(2 * path, middle, net)
        self.aux16, self.aux32 = (Head(path, net.channels(256), net) for _ in range(2))

    def forward(self, image):
        size = image.shape[2:]
        spatial = self.spatial(image)
        stride16, stride32 = self.backbone(image)
        deep = self.arm32(stride32) + self.tail(mean(stride32))
        refined32 = self.refine32(resized(deep, stride16.shape[2:]))
        refined16 = self.refine16(resized(self.arm16(stride16) + refined32, spatial.shape[2:]))
        main = resized(self.head(self.ffm(spatial, refined16)), size)
        if not self.training:
            return main
        return main, resized(self.aux16(refined16), size), resized(self.aux32(refined32), size)


class Keras(nn.Module):
    """Of and to the same shapes, in the layout of the reimplementations in TensorFlow and Keras."""

    def __init__(self, net):
        super().__init__()
        sizes = [3, *(net.channels(paper) for paper in (64, 128, 256))]
        self.spatial = nn.Sequential(*(ConvBn(cin, cout, 3, 2) for cin, cout in zip(sizes, sizes[1:])))
        self.backbone = BACKBONES[net.backbone](net)
        channels16, channels32 = self.backbone.channels
        self.attention16 = ConvBn(channels16, channels16, 1, act=None)
        self.attention32 = ConvBn(channels32, channels32, 1, act=None)
        self.fusion = ConvBn(sizes[-1] + channels16 + channels32, net.classes, 3)
        self.att1, self.att2, self.out = (nn.Conv2d(net.classes, net.classes, 1) for _ in range(3))

    def forward(self, image):
        spatial = self.spatial(image)
        stride16, stride32 = self.backbone(image)
        middle, deep = weighted(stride16, self.attention16), weighted(stride32, self.attention32)
        context = [resized(features, spatial.shape[2:]) for features in (middle, deep * mean(deep))]
        fused = self.fusion(torch.cat([spatial, *context], 1))
        main = resized(self.out(fused + weighted(fused, self.att1, F.relu, self.att2)), image.shape[2:])
        return (main,) if self.training else main


VARIANTS = {"Authors": Authors, "Lite": Authors, "Keras": Keras}


class Normalized(nn.Module):
    """The network behind its normalisation: RGB in 0 to 1."""

    def __init__(self, model, normalization):
        super().__init__()
        self.model = model
        for name in ("mean", "std"):
            self.register_buffer(name, torch.tensor(normalization[name]).reshape(1, 3, 1, 1))

    def forward(self, colours):
        return self.model((colours - self.mean) / self.std)


def load(path):
    """The network in evaluation mode and its description. All of the file must fit, but for PyTorch's step counters."""
    content = Path(path).read_bytes()
    (length,) = struct.unpack("<Q", content[:8])
    header = json.loads(content[8 : 8 + length])
    description = json.loads(header.pop("__metadata__")["segnet"])
    if description["version"] != 1:
        raise ValueError(f"version {description['version']}, this script reads 1")
    net = Net(description["net"])
    model = VARIANTS[net.variant](net)
    state = {name: tensor for name, tensor in model.state_dict().items() if name.endswith("num_batches_tracked")}
    for name, entry in header.items():
        if entry["dtype"] != "F32":
            raise ValueError(f"{name} is {entry['dtype']}, F32 is needed")
        begin, end = (8 + length + offset for offset in entry["data_offsets"])
        state[name] = torch.frombuffer(bytearray(content[begin:end]), dtype=torch.float32).reshape(entry["shape"])
    model.load_state_dict(state, strict=True)
    return model.eval(), description


def leave_out_unsure(probabilities, peak):
    """Gives to the background, of [1, classes, height, width], every part that is nowhere as likely as `peak`: pixels of
    one likeliest class that touch at sides or corners."""
    if peak <= 0:
        return
    highest, classes = probabilities.max(1, keepdim=True)
    highest = highest.nan_to_num(0.0)
    for label in range(1, probabilities.shape[1]):
        inside = (classes == label).float()
        reached, before = highest * inside, None
        while before is None or not torch.equal(reached, before):
            before, reached = reached, F.max_pool2d(reached, 3, 1, padding=1) * inside
        unsure = (inside > 0) & (reached < peak)
        probabilities.masked_fill_(unsure, 0.0)
        probabilities[:, :1].masked_fill_(unsure, 1.0)


def labels(model, description, path):
    """The class of each pixel of an image of any size."""
    import numpy
    from PIL import Image

    image = Image.open(path).convert("RGB")
    small = image.resize((description["width"], description["height"]), Image.Resampling.BILINEAR)
    colours = torch.from_numpy(numpy.asarray(small) / numpy.float32(255)).permute(2, 0, 1)[None]
    with torch.no_grad():
        probabilities = Normalized(model, description["normalization"])(colours).softmax(1)
        leave_out_unsure(probabilities, description.get("peak", 0.0))
        classes = resized(probabilities, (image.height, image.width)).argmax(1)[0]
    return Image.fromarray(classes.to(torch.uint8).numpy())


def export(model, description, path):
    """ONNX for the description's image size, normalisation inside."""
    example = torch.zeros(1, 3, description["height"], description["width"])
    network = Normalized(model, description["normalization"]).eval()
    torch.onnx.export(network, (example,), str(path), input_names=["rgb"], output_names=["logits"], external_data=False)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("network", type=Path)
    parser.add_argument("--image", type=Path)
    parser.add_argument("--labels", type=Path, default=Path("labels.png"))
    parser.add_argument("--onnx", type=Path)
    parser.add_argument("--state-dict", type=Path)
    given = parser.parse_args()
    model, description = load(given.network)
    print(json.dumps(description, indent=2))
    if given.image:
        labels(model, description, given.image).save(given.labels)
    if given.onnx:
        export(model, description, given.onnx)
    if given.state_dict:
        torch.save(model.state_dict(), given.state_dict)


if __name__ == "__main__":
    main()
