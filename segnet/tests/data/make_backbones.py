"""Writes backbones.json: features that torchvision's networks and timm's Xception (a copy of Cadene's) compute from
weights and an image made by a formula, which the test in src/backbone/tests.rs repeats.

    pip install torch torchvision timm
    python segnet/tests/data/make_backbones.py
"""

import json
import pathlib

import numpy
import timm
import torch
import torchvision

HEIGHT, WIDTH = 64, 96
VALUES = 40


def noise(name, count):
    """Numbers in -1 to 1 from a name and their index: FNV-1a, then the last steps of MurmurHash3."""
    seed = 0x811C9DC5
    for byte in name.encode():
        seed = (seed ^ byte) * 0x01000193 & 0xFFFFFFFF
    x = (numpy.arange(count, dtype=numpy.uint64) * 0x9E3779B1 + seed) & 0xFFFFFFFF
    for shift, factor in [(16, 0x85EBCA6B), (13, 0xC2B2AE35)]:
        x = ((x ^ (x >> shift)) * factor) & 0xFFFFFFFF
    x ^= x >> 16
    return (x.astype(numpy.float64) / 2**31 - 1).astype(numpy.float32)


def value(name, shape):
    x = noise(name, int(numpy.prod(shape))).reshape(shape)
    if len(shape) == 4:
        return x * numpy.float32((6 / numpy.prod(shape[1:])) ** 0.5)
    if name.endswith("running_var"):
        return 1 + numpy.float32(0.5) * x
    if name.endswith(("running_mean", "bias")):
        return numpy.float32(0.3) * x
    return 1 + numpy.float32(0.3) * x


def fill(net):
    state = {name: torch.from_numpy(value(name, tuple(tensor.shape))) for name, tensor in net.state_dict().items()
             if not name.endswith("num_batches_tracked")}
    net.load_state_dict(state, strict=False)
    return net.eval()


def taps_of(net, modules, image):
    found = {}
    hooks = [net.get_submodule(name).register_forward_hook(lambda _, __, out, name=name: found.update({name: out.clone()}))
             for name in modules]
    with torch.no_grad():
        net(image)
    for hook in hooks:
        hook.remove()
    return [found[name][0] for name in modules]


NETS = {
    "MobileNetV2": (torchvision.models.mobilenet_v2, ["features.6", "features.13", "features.17"]),
    "ResNet18": (torchvision.models.resnet18, ["layer2", "layer3", "layer4"]),
    "ResNet50": (torchvision.models.resnet50, ["layer2", "layer3", "layer4"]),
    "DenseNet121": (torchvision.models.densenet121, ["features.denseblock2", "features.denseblock3", "features.norm5"]),
    "Xception": (lambda: timm.create_model("legacy_xception"), ["block2", "block11", "act4"]),
}

image = torch.from_numpy(noise("image", 3 * HEIGHT * WIDTH).reshape(1, 3, HEIGHT, WIDTH))
result = {}
for kind, (make, modules) in NETS.items():
    net = fill(make())
    parameters = sum(parameter.numel() for parameter in net.parameters())
    taps = []
    for tap in taps_of(net, modules, image):
        flat = tap.reshape(-1).double()
        step = flat.numel() // VALUES
        taps.append({"shape": list(tap.shape), "step": step, "largest": float(flat.abs().max()),
                     "values": [float(x) for x in flat[: step * VALUES : step].float()]})
    result[kind] = {"parameters": parameters, "taps": taps}
    print(kind, parameters, [(tap["shape"], round(tap["largest"], 2)) for tap in taps])
path = pathlib.Path(__file__).with_name("backbones.json")
path.write_text(json.dumps(result, indent=None, separators=(",", ":")).replace("},", "},\n") + "\n")
