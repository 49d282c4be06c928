"""Alternates segnet_rival with PyTorch, ONNX Runtime and OpenVINO on the same weights and input.

usage: compare.py --peers DIR --python VENV/bin/python --rival target/release/segnet_rival [--rounds 7]
                  [--sizes 288x160,512x288] [--train-sizes 288x160,512x288] [--train-rounds 7,3]
                  [--compile-rounds 2] [--bf16] [--work DIR] [--results benches/RESULTS.md]

DIR holds bench.py and model.py (the rivals' harness; its README says what to install). Each round starts every
process once, one after the other, on an otherwise idle machine; a process reports its median and its fastest call.
The table gives the median over the rounds of either, checks our logits against PyTorch's, and replaces what stands
between the markers in the results file. torch.compile takes a minute to start and may take part in the first rounds
only, or with 0 in none. --bf16 adds inference in bfloat16, ours and OpenVINO's.
"""
import argparse
import json
import re
import statistics
import subprocess
from pathlib import Path

BEGIN, END = "<!-- segnet peers: begin -->", "<!-- segnet peers: end -->"
LOGITS = """
import sys; sys.path.insert(0, sys.argv[1])
import numpy as np, torch
from safetensors.torch import load_file
from model import BiSeNet
net = BiSeNet(); net.load_state_dict(load_file(sys.argv[2])); net.eval()
torch.manual_seed(1)
x = torch.rand(1, 3, int(sys.argv[4]), int(sys.argv[3])) * 2 - 1
np.save(sys.argv[5] + "x.npy", x.numpy())
with torch.no_grad(): np.save(sys.argv[5] + "y.npy", net(x).numpy())
"""
CHECK = """
import sys, numpy as np
y, ours = np.load(sys.argv[1] + "y.npy"), np.load(f"{sys.argv[1]}{sys.argv[2]}.npy")
gap = np.abs(ours - y).max() / np.abs(y).max()
print(f"{gap:.1e} {int((ours.argmax(1) != y.argmax(1)).sum())}")
"""


def run(command):
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"{command[:3]}...: {done.stderr.strip()[-400:]}")
    return done.stdout.strip().splitlines()


def rival(command):
    line = json.loads(run(command)[-1])
    return line["median_ms"], line["min_ms"], line["peak_rss_mib"]


def bench(command):
    """What bench.py prints, as numbers: median and fastest call in ms, memory in MiB."""
    line = run(command)[-1]
    rss = float(re.search(r"peak RSS (\d+)", line)[1])
    median = float(re.search(r"median\s+([\d.]+) ms", line)[1])
    fastest = re.search(r"min\s+([\d.]+)", line)
    return median, float(fastest[1]) if fastest else None, rss


def alternate(processes, rounds, few={}):
    """Every process once a round, those of `few` in so many only; failing ones are left out with their reason."""
    found, failed = {name: [] for name in processes}, {}
    for number in range(rounds):
        for name, (parse, command) in processes.items():
            if name in failed or number >= few.get(name, rounds):
                continue
            try:
                found[name].append(parse(command))
            except Exception as error:
                failed[name] = str(error)
                print(f"{name} left out: {error}", flush=True)
                continue
            median, fastest, rss = found[name][-1]
            print(f"round {number}: {name:28} median {median:8.2f} ms  min {milliseconds(fastest)}  RSS {mebibytes(rss)}", flush=True)
    columns = lambda rows: tuple(None if None in column else statistics.median(column) for column in zip(*rows))
    return {name: columns(rows) for name, rows in found.items() if rows and name not in failed}


def table(title, found, ours, batch):
    lines = [f"**{title}**", "", "| | fastest call | median call | images/s (median) | peak RSS |", "|---|---|---|---|---|"]
    for name, (median, fastest, rss) in sorted(found.items(), key=lambda item: item[1][0]):
        lines.append(f"| {name} | {milliseconds(fastest)} | {median:.2f} ms | {batch * 1e3 / median:.1f} | {mebibytes(rss)} |")
    for column, what in [(1, "fastest"), (0, "median")]:
        rivals = [row[column] for name, row in found.items() if name != ours]
        if ours in found and rivals and None not in rivals:
            lines += ["", f"The best rival takes {min(rivals) / found[ours][column]:.2f} times as long as ours ({what} calls)."]
    return lines + [""]


def milliseconds(time):
    return "-" if time is None else f"{time:.2f} ms"


def mebibytes(rss):
    return "-" if rss is None else f"{rss:.0f} MiB"


def main():
    parser = argparse.ArgumentParser()
    for name in ["--peers", "--python", "--rival"]:
        parser.add_argument(name, required=True, type=Path)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--sizes", default="288x160,512x288")
    parser.add_argument("--train-sizes", default="288x160,512x288")
    parser.add_argument("--train-rounds", default="7,3", help="one number per training size")
    parser.add_argument("--compile-rounds", type=int, default=2)
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--bf16", action="store_true")
    parser.add_argument("--work", type=Path, default=Path("out/segnet_peers"))
    parser.add_argument("--results", type=Path)
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    weights, harness = options.work / "bisenet.safetensors", options.peers / "bench.py"
    text = []
    for size in filter(None, options.sizes.split(",")):
        width, height = size.split("x")
        common = ["--size", size, "--out", options.work, "--threads", options.threads]
        run([options.python, harness, "export", *common])
        prefix = f"{options.work}/{size}_"
        run([options.python, "-c", LOGITS, options.peers, weights, width, height, prefix])
        names = {"torch_cl": "PyTorch, folded, NHWC", "compile": "torch.compile", "ort": "ONNX Runtime", "ov": "OpenVINO"}
        if options.compile_rounds == 0:
            del names["compile"]
        infer = lambda peer: [options.python, harness, "infer", *common, "--only", peer, "--weights", weights, "--reps", 60]
        processes = {name: (bench, infer(peer)) for peer, name in names.items()}
        ours = [options.rival, "infer", "--weights", weights, "--input", prefix + "x.npy", "--size", size]
        ours += ["--threads", options.threads, "--rounds", 60]
        out = lambda precision: ["--precision", precision, "--out", f"{prefix}{precision}.npy"]
        processes["segnet"] = (rival, ours + out("f32"))
        if options.bf16:
            # bench.py runs f32, then bfloat16 in the same process: the memory is that of both.
            processes["OpenVINO, bf16"] = (lambda command: (*bench(command)[:2], None), infer("ov,ovbf16"))
            processes["segnet, bf16"] = (rival, ours + out("bf16"))
        few = {"torch.compile": options.compile_rounds}
        found = alternate(processes, options.rounds, few)
        for precision, suffix in [("f32", ""), ("bf16", ", bf16")]:
            rows = {name: row for name, row in found.items() if name.endswith(", bf16") == bool(suffix)}
            if rows:
                text += table(f"Inference, {size}, batch 1, {precision}", rows, "segnet" + suffix, 1)
            if "segnet" + suffix in rows:
                gap, other = run([options.python, "-c", CHECK, prefix, precision])[-1].split()
                text += [f"Largest difference of our logits from PyTorch's in f32: {gap} of the largest; {other} labels differ.", ""]
    train_rounds = [int(rounds) for rounds in options.train_rounds.split(",")]
    for size, rounds in zip(filter(None, options.train_sizes.split(",")), train_rounds, strict=True):
        common = ["--batch", options.batch, "--size", size, "--threads", options.threads]
        processes = {
            "segnet": (rival, [options.rival, "train", *common, "--steps", 8]),
            "PyTorch, NHWC": (bench, [options.python, harness, "train", *common, "--channels-last", "--reps", 48]),
        }
        found = alternate(processes, rounds)
        text += table(f"Training step, {size}, batch {options.batch}", found, "segnet", options.batch)
    print("\n".join(text))
    if options.results:
        before, rest = options.results.read_text().split(BEGIN)
        after = rest.split(END)[1]
        options.results.write_text(before + "\n".join([BEGIN, *text, END]) + after)


if __name__ == "__main__":
    main()
