"""Writes the files in `pytorch/`: one small layer as PyTorch programs save their state dicts. Made with torch 2.15.0.

    python make_pytorch_files.py
"""

from collections import OrderedDict
from pathlib import Path

import torch

FOLDER = Path(__file__).parent / "pytorch"


def numbers(tensor, start):
    """Element i is ((37 i + start) mod 101 - 50) / 64, which half precision holds exactly."""
    count = torch.arange(tensor.numel())
    return (((37 * count + start) % 101 - 50) / 64).reshape(tensor.shape)


class Layer(torch.nn.Module):
    """A 3x3 convolution of 3 to 8 channels and its batch norm."""

    def __init__(self):
        super().__init__()
        self.conv = torch.nn.Conv2d(3, 8, 3, bias=False)
        self.bn = torch.nn.BatchNorm2d(8)


layer = Layer()
for start, (name, tensor) in enumerate(sorted(layer.state_dict().items())):
    if tensor.is_floating_point():
        tensor.copy_(numbers(tensor, start))
state = layer.state_dict()


def renamed(prefix):
    return OrderedDict((prefix + name, tensor) for name, tensor in state.items())


def cast(kind):
    return OrderedDict((n, t.to(kind) if t.is_floating_point() else t) for n, t in state.items())


FOLDER.mkdir(exist_ok=True)
torch.save(state, FOLDER / "plain.pth")
torch.save(state, FOLDER / "legacy.pth", _use_new_zipfile_serialization=False)
torch.save(cast(torch.float16), FOLDER / "float16.pth")
torch.save(cast(torch.bfloat16), FOLDER / "bfloat16.pth")
torch.save(cast(torch.float64), FOLDER / "float64.pth")
torch.save(cast(torch.int32), FOLDER / "int32.pth")
torch.save(renamed("module."), FOLDER / "data_parallel.pth")
torch.save(renamed("encoder."), FOLDER / "encoder.pth")
optimizer = torch.optim.Adam(layer.parameters())
sum(parameter.sum() for parameter in layer.parameters()).backward()
optimizer.step()
for start, (name, tensor) in enumerate(sorted(layer.state_dict().items())):
    if tensor.is_floating_point():
        tensor.copy_(numbers(tensor, start))
checkpoint = {"epoch": 3, "state_dict": renamed("module."), "optimizer": optimizer.state_dict()}
torch.save(checkpoint, FOLDER / "checkpoint.pth")
torch.save({"model": state, "state_dict": state}, FOLDER / "two_networks.pth")
# Strides other than the shape's: the filter lies in memory as [out, height, width, in].
strided = OrderedDict(state, **{"conv.weight": state["conv.weight"].to(memory_format=torch.channels_last)})
torch.save(strided, FOLDER / "channels_last.pth")
# A view that claims far more elements than are stored.
endless = torch.zeros(1).expand(1 << 15, 1 << 15)
torch.save(OrderedDict(state, **{"conv.weight": endless}), FOLDER / "endless.pth")
