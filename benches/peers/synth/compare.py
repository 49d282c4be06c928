"""Alternates synth_rival with OpenCV on the same crops and backgrounds.

usage: compare.py --data DIR --python VENV/bin/python --rival target/release/synth_rival [--rounds 7] [--calls 60]
                  [--generator gen_cv2.py] [--images 60]
                  [--crops S_ellipse,S_ring,L_ellipse,L_ring] [--background china_640x480] [--core 0]
                  [--work DIR] [--results benches/RESULTS.md]

DIR holds crop_NAME.png and bg_NAME.jpg; VENV has OpenCV, numpy and SciPy. OpenCV decodes the backgrounds, both blend
the same PNG. Each round starts every process once, one after the other, bound to one core; a process warms up and
reports the median and the fastest of its own calls, which take set-up and composition in. The table gives the median
over the rounds of the medians and the minimum of the minima. Quality is against a sparse factorisation in double
precision with the same clamping and rounding. With --generator whole training images follow, made by that program and
by ours, in memory (backgrounds decoded once, or for each image) and to disk (JPEG 95, label PNG, YOLO). The tables replace what stands between the markers in the results file.
"""
import argparse
import json
import re
import shutil
import statistics
import subprocess
import tempfile
from pathlib import Path

BEGIN, END = "<!-- synth peers: begin -->", "<!-- synth peers: end -->"
MODES = ["normal", "mixed"]
# Prints the same line as synth_rival.
OPENCV = """
import sys, time, json, cv2, numpy as np
data, crop, background, mode, calls, out = sys.argv[1:]
cv2.setNumThreads(1)
image = cv2.imread(f"{data}/crop_{crop}.png", cv2.IMREAD_UNCHANGED)
picture = cv2.imread(f"{data}/bg_{background}.png")
photo, alpha = np.ascontiguousarray(image[..., :3]), np.ascontiguousarray(image[..., 3])
# seamlessClone places the middle of the mask's bounding box.
x, y, w, h = cv2.boundingRect(alpha)
left, top = (picture.shape[1] - image.shape[1]) // 2, (picture.shape[0] - image.shape[0]) // 2
middle = (left + x + w // 2, top + y + h // 2)
flag = cv2.NORMAL_CLONE if mode == "normal" else cv2.MIXED_CLONE
times = []
for call in range(3 + int(calls)):
    start = time.perf_counter()
    result = cv2.seamlessClone(photo, picture, alpha, middle, flag)
    times.append(1e3 * (time.perf_counter() - start))
cv2.imwrite(out, result)
print(json.dumps({"median_ms": float(np.median(times[3:])), "min_ms": min(times[3:])}))
"""
# Largest difference and share of values off inside the mask, largest difference outside: exact against each picture.
QUALITY = """
import sys, cv2, numpy as np, scipy.sparse as sp, scipy.sparse.linalg as sl
data, crop, background, mode = sys.argv[1:5]
image = cv2.imread(f"{data}/crop_{crop}.png", cv2.IMREAD_UNCHANGED)
picture = cv2.imread(f"{data}/bg_{background}.png")
height, width = image.shape[:2]
left, top = (picture.shape[1] - width) // 2, (picture.shape[0] - height) // 2
inside = image[..., 3] > 127
ys, xs = np.nonzero(inside)
count = len(ys)
index = np.full((height, width), -1); index[inside] = np.arange(count)
photo, under = image[..., :3].astype(float), picture[top:top + height, left:left + width].astype(float)
right = np.zeros((count, 3))
rows, columns, values = [np.arange(count)], [np.arange(count)], [np.full(count, 4.0)]
for dy, dx in ((0, 1), (0, -1), (1, 0), (-1, 0)):
    v, u = ys + dy, xs + dx
    other = index[v, u]; known = other < 0
    rows.append(np.arange(count)[~known]); columns.append(other[~known]); values.append(np.full((~known).sum(), -1.0))
    own, there = photo[ys, xs] - photo[v, u], under[ys, xs] - under[v, u]
    right += np.where(np.abs(there) > np.abs(own), there, own) if mode == "mixed" else own
    right[known] += under[v, u][known]
matrix = sp.csc_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (count, count))
solution = sl.splu(matrix, permc_spec="MMD_AT_PLUS_A").solve(right)
exact = picture.copy()
exact[top + ys, left + xs] = np.clip(np.floor(solution + 0.5), 0, 255).astype(np.uint8)
mask = np.zeros(picture.shape[:2], bool); mask[top + ys, left + xs] = True
for path in sys.argv[5:]:
    off = np.abs(cv2.imread(path).astype(int) - exact)
    print(off[mask].max(), 100 * (off[mask] > 0).mean(), off[mask].mean(), off[~mask].max())
"""


def run(command):
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"{command[:3]}...: {done.stderr.strip()[-400:]}")
    return done.stdout.strip().splitlines()


def prepare(options):
    """Copies the crops and decodes the background, once for both."""
    options.work.mkdir(parents=True, exist_ok=True)
    for crop in options.crops:
        shutil.copyfile(options.data / f"crop_{crop}.png", options.work / f"crop_{crop}.png")
    decode = "import cv2, sys; cv2.imwrite(sys.argv[2], cv2.imread(sys.argv[1]))"
    name = f"bg_{options.background}"
    run([options.python, "-c", decode, options.data / f"{name}.jpg", options.work / f"{name}.png"])


def commands(options, crop, mode):
    out = {peer: options.work / f"{peer}_{crop}_{mode}.png" for peer in ("ours", "opencv")}
    bound = ["taskset", "-c", options.core]
    ours = [options.rival, "blend", "--data", options.work, "--mode", mode, "--crop", crop]
    ours += ["--background", options.background, "--rounds", options.calls, "--out", out["ours"]]
    theirs = [options.python, "-c", OPENCV, options.work, crop, options.background, mode, options.calls, out["opencv"]]
    return out, {"opencv": [*bound, *theirs], "ours": [*bound, *ours]}


def table(options, found):
    lines = ["| | OpenCV, median / fastest | ours, median / fastest | ratio of medians | of fastest | largest difference | off by one | OpenCV off, mean |"]
    lines.append("|---" * 8 + "|")
    for (crop, mode), rows in found.items():
        time = lambda peer: (statistics.median(row[0] for row in rows[peer]), min(row[1] for row in rows[peer]))
        (theirs, their_best), (ours, our_best) = time("opencv"), time("ours")
        out, _ = commands(options, crop, mode)
        quality = run([options.python, "-c", QUALITY, options.work, crop, options.background, mode, out["ours"], out["opencv"]])
        (worst, share, _, outside), (_, _, theirs_off, _) = [map(float, line.split()) for line in quality]
        if worst > 1 or share > 5 or outside > 0:
            raise RuntimeError(f"{crop} {mode}: {worst} grey levels, {share} % off, {outside} outside the mask")
        cells = [f"{crop}, {mode}", f"{theirs:.2f} / {their_best:.2f} ms", f"{ours:.2f} / {our_best:.2f} ms"]
        cells += [f"{theirs / ours:.1f}", f"{their_best / our_best:.1f}", f"{worst:.0f}", f"{share:.2f} %", f"{theirs_off:.1f}"]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


# Name, option of OpenCV's and of ours, whether images go to disk.
GENERATED = [
    ("in memory, backgrounds held", ["--cached"], ["--cached"], False),
    ("in memory", [], ["--streamed"], False),
    ("to disk, backgrounds held", ["--cached"], ["--cached"], True),
    ("to disk", [], ["--streamed"], True),
]


def generated(options):
    """Images per second, by crops and case."""
    found = {(crops, case[0]): {"opencv": [], "ours": []} for crops in "SL" for case in GENERATED}
    out = Path(tempfile.mkdtemp(prefix="images_", dir=options.work))
    for number in range(options.rounds):
        for crops in "SL":
            for name, theirs, ours, disk in GENERATED:
                # A folder for each run, none deleted before the last: ext4 is slow to give files inodes after that.
                folder = {peer: ["--out", out / f"{peer}_{crops}_{number}_{len(theirs)}"] if disk else [] for peer in ("opencv", "ours")}
                both = ["--size", "640x480", "--crops", crops, "--n", options.images]
                bound = ["taskset", "-c", options.core]
                rows = found[crops, name]
                line = run([*bound, options.python, options.generator, *both, *theirs, *folder["opencv"]])[-1]
                rows["opencv"].append(float(re.search(r"([0-9.]+) images/s", line).group(1)))
                line = run([*bound, options.rival, "image", "--data", options.data, *both, *ours, *folder["ours"]])[-1]
                rows["ours"].append(json.loads(line)["images_per_s"])
        print(f"images, round {number + 1} of {options.rounds}", flush=True)
    shutil.rmtree(out)
    lines = ["", f"Training images of 640x480 with three objects, images per second (median of {options.rounds} rounds of {options.images}):", ""]
    lines += ["| | OpenCV | ours | ratio |", "|---|---|---|---|"]
    for (crops, name), rows in found.items():
        theirs, ours = (statistics.median(rows[peer]) for peer in ("opencv", "ours"))
        lines.append(f"| {crops}, {name} | {theirs:.1f} | {ours:.1f} | {ours / theirs:.1f} |")
    return lines


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("data", "python", "rival"):
        parser.add_argument(f"--{name}", type=Path, required=True)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--calls", type=int, default=60)
    parser.add_argument("--crops", type=lambda names: names.split(","), default="S_ellipse,S_ring,L_ellipse,L_ring")
    parser.add_argument("--generator", type=Path)
    parser.add_argument("--images", type=int, default=60)
    parser.add_argument("--background", default="china_640x480")
    parser.add_argument("--core", default="0")
    parser.add_argument("--work", type=Path, default=Path("out/synth_peers"))
    parser.add_argument("--results", type=Path)
    options = parser.parse_args()
    prepare(options)
    found = {(crop, mode): {"opencv": [], "ours": []} for crop in options.crops for mode in MODES}
    for number in range(options.rounds):
        for (crop, mode), rows in found.items():
            for peer, command in commands(options, crop, mode)[1].items():
                line = json.loads(run(command)[-1])
                rows[peer].append((line["median_ms"], line["min_ms"]))
        print(f"round {number + 1} of {options.rounds}", flush=True)
    text = [f"One blend on {options.background}, one thread, {options.rounds} rounds of {options.calls} calls:", ""]
    text += table(options, found)
    if options.generator:
        text += generated(options)
    print("\n".join(text))
    if options.results:
        block = "\n".join([BEGIN, *text, END])
        before = options.results.read_text()
        options.results.write_text(re.sub(f"{BEGIN}.*{END}", lambda _: block, before, flags=re.S))


if __name__ == "__main__":
    main()
