"""Loads networks that segnet saved, gives their logits of one image, and saves their state dicts.

    python read_network.py FOLDER HEIGHT WIDTH NAME...

FOLDER holds NAME.safetensors and `image`; NAME.logits and NAME.pth are written beside. Image and logits are
little-endian float32, channel by channel. Where onnxruntime is installed, the ONNX exports of the first and the last
network must agree with them; it takes seconds for each.
"""

import importlib.util
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "python"))
import bisenet
import torch


def check_export(name, model, description):
    import onnxruntime

    colours = torch.rand(1, 3, description["height"], description["width"], generator=torch.Generator().manual_seed(1))
    with tempfile.TemporaryDirectory() as exported:
        path = Path(exported) / "net.onnx"
        bisenet.export(model, description, path)
        (found,) = onnxruntime.InferenceSession(str(path)).run(None, {"rgb": colours.numpy()})
    with torch.no_grad():
        expected = bisenet.Normalized(model, description["normalization"])(colours)
    difference, largest = ((torch.from_numpy(found) - expected).abs().max(), expected.abs().max())
    assert difference < 1e-4 * largest, f"{name}: ONNX differs by {difference} of {largest}"
    print(f"{name}: ONNX differs by {difference} of {largest}")


torch.set_num_threads(1)
folder, names = Path(sys.argv[1]), sys.argv[4:]
height, width = (int(side) for side in sys.argv[2:4])
content = bytearray((folder / "image").read_bytes())
image = torch.frombuffer(content, dtype=torch.float32).reshape(1, 3, height, width)
has_onnx = all(importlib.util.find_spec(package) for package in ("onnx", "onnxscript", "onnxruntime"))
for name in names:
    model, description = bisenet.load(folder / f"{name}.safetensors")
    with torch.no_grad():
        (folder / f"{name}.logits").write_bytes(model(image).numpy().tobytes())
    torch.save(model.state_dict(), folder / f"{name}.pth")
    if has_onnx and name in (names[0], names[-1]):
        check_export(name, model, description)
