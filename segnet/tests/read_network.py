"""Loads a network that segnet saved, gives its logits of one image, and saves its state dict.

    python read_network.py NETWORK IMAGE HEIGHT WIDTH LOGITS STATE_DICT

IMAGE and LOGITS are little-endian float32, channel by channel. Where onnxruntime is installed, the network's ONNX
export must agree with it.
"""

import importlib.util
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "python"))
import bisenet
import torch

torch.set_num_threads(1)
network, image, height, width, logits, state_dict = sys.argv[1:]
model, description = bisenet.load(network)
content = bytearray(Path(image).read_bytes())
planes = torch.frombuffer(content, dtype=torch.float32).reshape(1, 3, int(height), int(width))
with torch.no_grad():
    Path(logits).write_bytes(model(planes).numpy().tobytes())
torch.save(model.state_dict(), state_dict)

if all(importlib.util.find_spec(package) for package in ("onnx", "onnxscript", "onnxruntime")):
    import onnxruntime

    colours = torch.rand(1, 3, description["height"], description["width"], generator=torch.Generator().manual_seed(1))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "net.onnx"
        bisenet.export(model, description, path)
        (found,) = onnxruntime.InferenceSession(str(path)).run(None, {"rgb": colours.numpy()})
    with torch.no_grad():
        expected = bisenet.Normalized(model, description["normalization"])(colours)
    difference = (torch.from_numpy(found) - expected).abs().max().item()
    assert difference < 1e-4, f"ONNX differs by {difference}"
    print(f"ONNX differs by {difference}")
