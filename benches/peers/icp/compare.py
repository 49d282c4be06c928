"""Alternates icp_rival with small_gicp, Open3D and PCL on the same clouds and start poses.

usage: compare.py --peers DIR --data DATA --python VENV/bin/python --rival target/release/icp_rival
                  [--pcl PEER_PCL] [--rounds 5] [--accuracy] [--work DIR] [--results benches/RESULTS.md]

DIR is the rivals' harness (prepare.py, peers_py.py, score.py; its README says what to install), DATA the clouds it
prepares tasks from. Each round starts every process once, one after the other, bound to one core (and again to two
where a peer can use them), on an otherwise idle machine; a process reports the median of its own calls, the tables give
the median over the rounds. --accuracy adds one run of every suite of start poses, scored by score.py. The tables
replace what stands between the markers in the results file.
"""
import argparse
import json
import re
import statistics
import subprocess
from pathlib import Path

BEGIN, END = "<!-- icp peers: begin -->", "<!-- icp peers: end -->"
SPEED, ACCURACY = "voxel,nn,speed", "basin_bin,basin_lidar,sixdof_bunny,views"
PEERS = ["ours", "small_gicp", "open3d", "open3d_t", "pcl"]
METHODS = {"p2p": "point-to-point", "gicp": "generalised"}


def lines(command, cores):
    done = subprocess.run(["taskset", "-c", cores, *map(str, command)], capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"{command[:2]}...: {done.stderr.strip()[-400:]}")
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


def commands(options, suites, threads):
    cores = "0" if threads == 1 else "0,1"
    python = [options.python, options.peers / "peers_py.py", options.work, threads]
    yield cores, [options.rival, options.work, threads, suites + (",starts" if suites == ACCURACY else "")]
    yield cores, [*python, "small_gicp", suites]
    if threads == 1 or suites == SPEED:
        yield cores, [*python, "open3d", suites]
    if options.pcl and threads == 1 and suites == SPEED:
        yield cores, [options.pcl, options.work, *suites.split(",")]


class Times:
    """Medians over rounds of what processes report, by task and peer."""

    def __init__(self):
        self.values = {}

    def add(self, threads, row):
        kind = row["kind"]
        if kind == "voxel":
            self.note("voxel", threads, row["cloud"], row["peer"], row["ms"])
        elif kind == "nn":
            self.note("nn", threads, row["cloud"], row["peer"], row["query_ms"])
            self.note("nn with building", threads, row["cloud"], row["peer"], row["query_ms"] + row["build_ms"])
        elif kind == "align" and row["method"] in METHODS:
            name = f"{METHODS[row['method']]}, {row['suite'].removeprefix('speed_')}"
            self.note("align", threads, name, row["peer"], row["ms"])
            self.note("prepare and align", threads, name, row["peer"], row["ms"] + row["prep_ms"])

    def note(self, kind, threads, task, peer, ms):
        self.values.setdefault((kind, threads), {}).setdefault(task, {}).setdefault(peer, []).append(ms)

    def table(self, kind, threads):
        tasks = self.values.get((kind, threads), {})
        peers = [peer for peer in PEERS if any(peer in found for found in tasks.values())]
        yield "| | " + " | ".join(peers) + " | small_gicp over ours |"
        yield "|---" * (len(peers) + 2) + "|"
        for task, found in tasks.items():
            medians = {peer: statistics.median(times) for peer, times in found.items()}
            cells = [f"{medians[peer]:.2f}" if peer in medians else "-" for peer in peers]
            ratio = f"{medians['small_gicp'] / medians['ours']:.1f}x" if "small_gicp" in medians else "-"
            yield f"| {task} | " + " | ".join(cells) + f" | {ratio} |"


TITLES = {
    "align": "Alignment until both steps fall below 1e-4, clouds prepared",
    "prepare and align": "The same with trees and normals of 20 neighbours for both clouds",
    "voxel": "Voxel grid",
    "nn": "Nearest neighbour of every query, tree built",
    "nn with building": "The same with building the tree",
}


def accuracy(options):
    """Rows of score.py's table, without the columns on time."""
    rows = []
    for cores, command in commands(options, ACCURACY, 2):
        rows += lines(command, cores)
    scored = options.work / "accuracy.jsonl"
    scored.write_text("\n".join(map(json.dumps, rows)))
    done = subprocess.run(
        [options.python, options.peers / "score.py", options.work, scored], capture_output=True, text=True, check=True
    )
    yield "| suite | method | | cases | median ms | within limits | rotation, median | position, median |"
    yield "|---|---|---|---|---|---|---|---|"
    for line in done.stdout.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 12 and cells[0] not in ("suite", "---") and not cells[0].startswith("-"):
            suite, _, method, peer, _, count, ms, _, _, share, turn, shift = cells
            yield f"| {suite} | {method} | {peer} | {count} | {float(ms):.1f} | {share} | {turn} deg | {shift} mm |"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("peers", "data", "python", "rival"):
        parser.add_argument(f"--{name}", type=Path, required=True)
    parser.add_argument("--pcl", type=Path)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--accuracy", action="store_true")
    parser.add_argument("--work", type=Path, default=Path("target/icp-peers"))
    parser.add_argument("--results", type=Path)
    options = parser.parse_args()
    if not (options.work / "views.tsv").exists():
        subprocess.run([options.python, options.peers / "prepare.py", options.data, options.work], check=True)
    times = Times()
    for round_number in range(options.rounds):
        for threads in (1, 2):
            for cores, command in commands(options, SPEED, threads):
                for row in lines(command, cores):
                    times.add(threads, row)
        print(f"round {round_number + 1} of {options.rounds}", flush=True)
    text = []
    for threads in (1, 2):
        for kind, title in TITLES.items():
            text += ["", f"{title}; {threads} thread{'s' * (threads > 1)}, ms:", "", *times.table(kind, threads)]
    if options.accuracy:
        text += ["", "From many start poses (limits: bin and views 5 deg and 20 mm, bunny 5 deg and 10 mm, lidar 1 deg and 150 mm):"]
        text += ["", *accuracy(options)]
    print("\n".join(text))
    if options.results:
        old = options.results.read_text()
        table = "\n".join([BEGIN, *text, "", END])
        options.results.write_text(re.sub(f"{BEGIN}.*{END}", lambda _: table, old, flags=re.S))


if __name__ == "__main__":
    main()
