"""A network that segnet saved, in PyTorch. Needs torch; pillow for images, onnx and onnxscript for the export.

    python bisenet.py net.safetensors                                   what the file holds
    python bisenet.py net.safetensors --image photo.jpg --labels out.png  a label map, pixel = class
    python bisenet.py net.safetensors --onnx net.onnx                   RGB in 0 to 1, [1, 3, height, width] -> logits
    python bisenet.py net.safetensors --state-dict net.pth              a plain state dict

In a program: `model, description = load("net.safetensors")`; `model` is an ordinary `torch.nn.Module` in evaluation
mode whose names are those in the file. In training mode it gives three logits: main head, auxiliary at 1/16 and 1/32.
"""

import argparse
import json
import struct
from pathlib import Path

import torch
import torch.nn as nn
import torch.nn.functional as F

# Table 2 of the MobileNetV2 paper: expansion, channels, repetitions, stride of the first.
STAGES = [(1, 16, 1, 1), (6, 24, 2, 2), (6, 32, 3, 2), (6, 64, 4, 2), (6, 96, 3, 1), (6, 160, 3, 2), (6, 320, 1, 1)]
STRIDE16_BLOCK = 12
PATH = 128


class Net:
    """The part of the description that decides the layers."""

    def __init__(self, net):
        known = {"backbone", "variant", "classes", "width", "padding", "batch_norm_epsilon", "seed"}
        layers = (net.get("backbone", "MobileNetV2"), net.get("variant", "Authors"))
        if set(net) - known or layers != ("MobileNetV2", "Authors"):
            raise ValueError(f"this script builds MobileNetV2 in the authors' layout, the file has {net}")
        if net["padding"] not in ("Symmetric", "TensorFlowSame"):
            raise ValueError(f"padding {net['padding']!r} is not known here")
        self.classes, self.width, self.epsilon = net["classes"], net["width"], net["batch_norm_epsilon"]
        self.tensorflow_same = net["padding"] == "TensorFlowSame"

    def channels(self, paper):
        """The nearest multiple of 8 to the scaled number, not below nine tenths of it; a half rounds up."""
        exact = paper * self.width
        nearest = max(8, int(exact / 8 + 0.5) * 8)
        return nearest + 8 if nearest < 0.9 * exact else nearest


class ConvBn(nn.Module):
    """Convolution without bias, batch norm, activation."""

    def __init__(self, cin, cout, kernel, stride=1, groups=1, act=F.relu, eps=1e-5, tensorflow_same=False):
        super().__init__()
        self.tensorflow_same = tensorflow_same
        padding = 0 if tensorflow_same else kernel // 2
        self.conv = nn.Conv2d(cin, cout, kernel, stride, padding, groups=groups, bias=False)
        self.bn = nn.BatchNorm2d(cout, eps=eps)
        self.act = act

    def forward(self, x):
        if self.tensorflow_same:
            x = F.pad(x, self.same(x.shape[3]) + self.same(x.shape[2]))
        x = self.bn(self.conv(x))
        return self.act(x) if self.act else x

    def same(self, size):
        """Zeros before and after, the odd one after: as few as give ceil(size / stride) outputs."""
        kernel, stride = self.conv.kernel_size[0], self.conv.stride[0]
        zeros = max((-(-size // stride) - 1) * stride + kernel - size, 0)
        return [zeros // 2, zeros - zeros // 2]


class InvertedResidual(nn.Module):
    def __init__(self, cin, cout, stride, expansion, conv_bn):
        super().__init__()
        middle = cin * expansion
        self.skip = stride == 1 and cin == cout
        self.expand = conv_bn(cin, middle, 1, act=F.relu6) if expansion > 1 else None
        self.depthwise = conv_bn(middle, middle, 3, stride, groups=middle, act=F.relu6)
        self.project = conv_bn(middle, cout, 1, act=None)

    def forward(self, x):
        y = self.expand(x) if self.expand else x
        y = self.project(self.depthwise(y))
        return x + y if self.skip else y


class MobileNetV2(nn.Module):
    """Features at 1/16 and 1/32."""

    def __init__(self, net):
        super().__init__()

        def conv_bn(*sizes, **options):
            return ConvBn(*sizes, **options, eps=net.epsilon, tensorflow_same=net.tensorflow_same)

        cin = net.channels(32)
        self.stem = conv_bn(3, cin, 3, 2, act=F.relu6)
        self.blocks = nn.ModuleList()
        for expansion, channels, repetitions, stride in STAGES:
            for repetition in range(repetitions):
                cout = net.channels(channels)
                self.blocks.append(InvertedResidual(cin, cout, 1 if repetition else stride, expansion, conv_bn))
                cin = cout
        self.channels = net.channels(STAGES[4][1]), cin

    def forward(self, x):
        x = self.stem(x)
        for index, block in enumerate(self.blocks):
            x = block(x)
            if index == STRIDE16_BLOCK:
                stride16 = x
        return stride16, x


class Arm(nn.Module):
    """Attention refinement."""

    def __init__(self, cin, cout):
        super().__init__()
        self.conv = ConvBn(cin, cout, 3)
        self.att = ConvBn(cout, cout, 1, act=None)

    def forward(self, x):
        x = self.conv(x)
        return x * torch.sigmoid(self.att(x.mean((2, 3), keepdim=True)))


class Ffm(nn.Module):
    """Feature fusion."""

    def __init__(self, channels):
        super().__init__()
        self.conv = ConvBn(channels, channels, 1)
        self.att1 = nn.Conv2d(channels, channels, 1, bias=False)
        self.att2 = nn.Conv2d(channels, channels, 1, bias=False)

    def forward(self, spatial, context):
        x = self.conv(torch.cat([spatial, context], 1))
        return x + x * torch.sigmoid(self.att2(F.relu(self.att1(x.mean((2, 3), keepdim=True)))))


class Head(nn.Module):
    def __init__(self, cin, middle, classes):
        super().__init__()
        self.conv = ConvBn(cin, middle, 3)
        self.out = nn.Conv2d(middle, classes, 1)

    def forward(self, x):
        return self.out(self.conv(x))


def resized(x, size):
    return F.interpolate(x, size=size, mode="bilinear", align_corners=False)


class BiSeNet(nn.Module):
    """Normalised images [batch, 3, height, width] to logits [batch, classes, height, width]."""

    def __init__(self, net):
        super().__init__()
        path, middle = net.channels(PATH), net.channels(64)
        sizes = [(3, middle, 7, 2), (middle, middle, 3, 2), (middle, middle, 3, 2), (middle, path, 1)]
        self.spatial = nn.Sequential(*(ConvBn(*size) for size in sizes))
        self.backbone = MobileNetV2(net)
        channels16, channels32 = self.backbone.channels
        self.tail = ConvBn(channels32, path, 1)
        self.arm32, self.arm16 = Arm(channels32, path), Arm(channels16, path)
        self.refine32, self.refine16 = ConvBn(path, path, 3), ConvBn(path, path, 3)
        self.ffm = Ffm(2 * path)
        self.head = Head(2 * path, middle, net.classes)
        self.aux16, self.aux32 = (Head(path, net.channels(256), net.classes) for _ in range(2))

    def forward(self, image):
        size = image.shape[2:]
        spatial = self.spatial(image)
        stride16, stride32 = self.backbone(image)
        deep = self.arm32(stride32) + self.tail(stride32.mean((2, 3), keepdim=True))
        refined32 = self.refine32(resized(deep, stride16.shape[2:]))
        refined16 = self.refine16(resized(self.arm16(stride16) + refined32, spatial.shape[2:]))
        main = resized(self.head(self.ffm(spatial, refined16)), size)
        if not self.training:
            return main
        return main, resized(self.aux16(refined16), size), resized(self.aux32(refined32), size)


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
    model = BiSeNet(Net(description["net"]))
    state = {name: tensor for name, tensor in model.state_dict().items() if name.endswith("num_batches_tracked")}
    for name, entry in header.items():
        if entry["dtype"] != "F32":
            raise ValueError(f"{name} is {entry['dtype']}, F32 is needed")
        begin, end = (8 + length + offset for offset in entry["data_offsets"])
        state[name] = torch.frombuffer(bytearray(content[begin:end]), dtype=torch.float32).reshape(entry["shape"])
    model.load_state_dict(state, strict=True)
    return model.eval(), description


def labels(model, description, path):
    """The class of each pixel of an image of any size."""
    import numpy
    from PIL import Image

    image = Image.open(path).convert("RGB")
    small = image.resize((description["width"], description["height"]), Image.Resampling.BILINEAR)
    colours = torch.from_numpy(numpy.asarray(small) / numpy.float32(255)).permute(2, 0, 1)[None]
    with torch.no_grad():
        probabilities = Normalized(model, description["normalization"])(colours).softmax(1)
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
