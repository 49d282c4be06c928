"""Writes `imagenet_logits.json`: what PyTorch makes of two drawn pictures with the MobileNetV2 files of the shared data.

    python make_imagenet_logits.py DATA

DATA is the folder with `weights/` and `backgrounds/`. Needs torch and safetensors (made with torch 2.15.0), and
ai-edge-litert, numpy and pillow to compare the classes with those of the quantized network that the first file comes
from. Padding is TensorFlow's: a 3x3 convolution of stride 2 over even sides is padded at the bottom and the right.
"""

import json
import sys
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from safetensors.torch import load_file

SIDE = 224
FILES = ["mobilenetv2_imagenet224_from_int8.safetensors", "mobilenetv2_imagenet160_fp32_notop.safetensors"]
# Expansion and stride of each block.
BLOCKS = [(1, 1)] + [(6, s) for s in (2, 1, 2, 1, 1, 2, 1, 1, 1, 1, 1, 1, 2, 1, 1, 1)]


def picture(index):
    """RGB bytes as in the test: stripes and a disc, of other colours in each picture."""
    y, x = np.mgrid[0:SIDE, 0:SIDE]
    colours = np.stack([(x * (3 + index) + y) % 256, (x + y * (2 + index)) % 256, (x * y // (7 + index)) % 256], 2)
    disc = (x - 112) ** 2 + (y - 100) ** 2 < (60 + 10 * index) ** 2
    colours[disc] = [200 - 60 * index, 40 + 90 * index, 30]
    return colours.astype(np.uint8)


def planes(colours):
    return torch.from_numpy(colours).permute(2, 0, 1)[None].float() / 127.5 - 1


def conv_bn(w, conv, bn, x, stride=1, groups=1, relu6=True):
    if w[conv + ".weight"].shape[2] == 3:
        x = F.pad(x, (0, 1, 0, 1) if stride == 2 else (1, 1, 1, 1))
    x = F.conv2d(x, w[conv + ".weight"], stride=stride, groups=groups)
    statistics = [w[f"{bn}.{leaf}"] for leaf in ("running_mean", "running_var", "weight", "bias")]
    x = F.batch_norm(x, *statistics, eps=1e-5)
    return F.relu6(x) if relu6 else x


def features(w, x):
    x = conv_bn(w, "features.0.0", "features.0.1", x, stride=2)
    for index, (expansion, stride) in enumerate(BLOCKS, 1):
        name, y = f"features.{index}.conv", x
        if expansion > 1:
            y = conv_bn(w, f"{name}.0.0", f"{name}.0.1", y)
        at = 1 if expansion > 1 else 0
        y = conv_bn(w, f"{name}.{at}.0", f"{name}.{at}.1", y, stride, groups=y.shape[1])
        y = conv_bn(w, f"{name}.{at + 1}", f"{name}.{at + 2}", y, relu6=False)
        x = x + y if stride == 1 and x.shape == y.shape else y
    return x


def logits(w, x):
    x = conv_bn(w, "features.18.0", "features.18.1", x).mean((2, 3))
    return F.linear(x, w["classifier.1.weight"], w["classifier.1.bias"])


def rounded(values):
    return [float(f"{value:.6g}") for value in values.flatten().tolist()]


def agreement(data, w):
    """Pictures of which the quantized network names the same class, and pictures in all."""
    from ai_edge_litert.interpreter import Interpreter
    from PIL import Image

    interpreter = Interpreter(str(data / "weights" / "tf2_mobilenet_v2_1.0_224_ptq.tflite"))
    interpreter.allocate_tensors()
    (taken,), (given,) = interpreter.get_input_details(), interpreter.get_output_details()
    scale, zero = taken["quantization"]
    paths = sorted((data / "backgrounds").iterdir())
    paths = [path for path in paths if path.suffix in (".jpg", ".png")]
    same = 0
    for path in paths:
        image = Image.open(path).convert("RGB")
        left, top = (image.width - 320) // 2, (image.height - 320) // 2
        square = image.crop((left, top, left + 320, top + 320)).resize((SIDE, SIDE), Image.Resampling.BILINEAR)
        colours = np.array(square)
        if taken["dtype"] == np.float32:
            quantized = colours.astype(np.float32)[None] / 127.5 - 1
        else:
            limits = np.iinfo(taken["dtype"])
            quantized = np.round((colours / 127.5 - 1) / scale + zero).clip(limits.min, limits.max)[None]
        interpreter.set_tensor(taken["index"], quantized.astype(taken["dtype"]))
        interpreter.invoke()
        theirs = interpreter.get_tensor(given["index"])[0]
        ours = logits(w, features(w, planes(colours)))
        # The quantized network has a class 0 for "background".
        same += int(theirs.argmax()) - (theirs.size - 1000) == int(ours.argmax())
    return same, len(paths)


def main():
    torch.set_num_threads(1)
    torch.set_grad_enabled(False)
    data = Path(sys.argv[1])
    files = []
    for name in FILES:
        w = load_file(data / "weights" / name)
        entry = {"file": name, "pictures": []}
        for index in range(2):
            x = features(w, planes(picture(index)))
            result = {"feature_means": rounded(x.mean((2, 3)))}
            if "classifier.1.weight" in w:
                result["logits"] = rounded(logits(w, x))
            entry["pictures"].append(result)
        if "classifier.1.weight" in w:
            same, pictures = agreement(data, w)
            entry["same_class_as_int8"] = {"pictures": pictures, "same": same}
            print(f"{same} of {pictures} pictures have the class that the quantized network names")
        files.append(entry)
    path = Path(__file__).parent / "imagenet_logits.json"
    path.write_text(json.dumps({"torch": torch.__version__, "files": files}) + "\n")


main()
