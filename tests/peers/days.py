"""Days that are added to a map one after the other: closures, errors, time and memory of each added day.

usage: days.py LOOPBOOST LOGS OUT [--days 10] [--only SEED,...] [--write docs/maps.md]

LOOPBOOST is the program, and LOGS the folder that detection.py needs for the model. The days are simulated drives
around the campus of pipelines/north-campus.toml, in opposite directions. The first one makes a map, and each of
the others is added to the runs before it (`detect.maps`). The model is one of recorded logs, and is used
without its classifier. Processor time and peak memory are those of the whole command: from the log of the day to its
closures, with the measurements against the ground truth. The processor time counts all threads of
the program, and no other program. `--only` selects seeds, and `--write` replaces the
table between the `days` comments in a file. The script needs numpy, pyarrow and mcap.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from detection import CAMPUS_SEEDS, FULL_CIRCLE, Benchmark, arguments, chosen, replace, rule

PIPELINE = Path(__file__).resolve().parents[2] / "pipelines/north-campus.toml"
COLUMNS = "| seed | day | accepted between days | false | revisits closed | maps | ATE of all days | processor time | peak memory |"


def measured(command, log_file):
    """Runs the program. Returns the processor time in seconds and the peak memory in bytes."""
    with open(log_file, "w") as file:
        child = subprocess.Popen([str(part) for part in command], stdout=file, stderr=subprocess.STDOUT)
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode not in (0, 3):
        sys.exit(f"{' '.join(map(str, command))} failed:\n{Path(log_file).read_text()[-3000:]}")
    return usage.ru_utime + usage.ru_stime, 1024 * usage.ru_maxrss


class Days(Benchmark):
    def simulate(self, seed, names):
        out = self.out / f"days-{seed}"
        settings = ["--set", f"seed={seed}", "--set", f"simulate.logs={json.dumps(names)}"]
        measured([self.program, "simulate", PIPELINE, "--out", out, *settings], f"{out}.txt")
        return [(out / "logs" / f"{name}.mcap").resolve() for name in names]

    def add(self, seed, log, before):
        """Solves the log of a day. `before` are the runs of the days before it."""
        model = self.model_without([], FULL_CIRCLE)
        name = f"days-{seed}-{log.stem}"
        text = PIPELINE.read_text()
        ingest = text[text.index("[ingest]") : text.index("[label]")]
        ingest = ingest.replace("[ingest]\n", f"[ingest]\nlogs = [{json.dumps(str(log))}]\n", 1)
        maps = ", ".join(json.dumps(str(run.resolve())) for run in before)
        file = self.out / f"{name}.toml"
        file.write_text(
            f'name = "{name}"\nseed = {seed}\n{ingest}[detect]\nclassifier = false\nmaps = [{maps}]\n'
            '[evaluate]\ntruth = { topic = "/ground_truth" }\n'
        )
        out = self.out / name
        secs, n_bytes = measured([self.program, "detect", file, "--model", model, "--out", out], f"{out}.txt")
        return out, secs, n_bytes


class Day:
    """A day in the map, with the true poses of its keyframes."""

    def __init__(self, run):
        self.name = run.name.split("-", 2)[2]
        keyframes = pq.read_table(run / "trajectory.parquet")
        truth = pq.read_table(run / f"truth/{self.name}.parquet")
        stamps, known = (table["stamp_ns"].to_numpy() for table in (keyframes, truth))
        value = lambda name: np.interp(stamps - known[0], known - known[0], truth[name].to_numpy())
        self.xy = np.stack([value("x_m"), value("y_m")], axis=1)
        turns = np.unwrap(truth["heading_rad"].to_numpy())
        self.heading = np.interp(stamps - known[0], known - known[0], turns)
        self.found = np.stack([keyframes["x_m"].to_numpy(), keyframes["y_m"].to_numpy()], axis=1)
        self.maps = set(keyframes["map"].to_pylist())
        self.index = {scan: k for k, scan in enumerate(keyframes["scan"].to_pylist())}
        closures = pq.read_table(run / "closures.parquet").to_pylist()
        self.closures = [c for c in closures if c["accepted"] and c["reference_log"] != self.name]


def is_false(closure, query, reference):
    """More than 1 m or 8 deg off."""
    q, r = query.index[closure["query_scan"]], reference.index[closure["reference_scan"]]
    cos, sin = np.cos(reference.heading[r]), np.sin(reference.heading[r])
    dx, dy = query.xy[q] - reference.xy[r]
    off = np.hypot(cos * dx + sin * dy - closure["dx_m"], cos * dy - sin * dx - closure["dy_m"])
    turn = query.heading[q] - reference.heading[r] - closure["dheading_rad"]
    return off > 1.0 or abs((turn + np.pi) % (2 * np.pi) - np.pi) > np.radians(8.0)


def ate(days):
    """Root mean square error of all keyframes after one alignment of the map (Umeyama 1991, without scale)."""
    found, true = (np.concatenate([getattr(day, name) for day in days]) for name in ("found", "xy"))
    found, true = found - found.mean(axis=0), true - true.mean(axis=0)
    u, _, vt = np.linalg.svd(true.T @ found)
    rotation = u @ np.diag([1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return np.sqrt(np.mean(np.sum((true - found @ rotation.T) ** 2, axis=1)))


def rows(days, seed, n_days):
    runs, known = [], {}
    for log in days.simulate(seed, [f"day-{k + 1}" for k in range(n_days)]):
        run, secs, n_bytes = days.add(seed, log, runs)
        runs.append(run)
        day = Day(run)
        false = sum(is_false(c, day, known[c["reference_log"]]) for c in day.closures)
        earlier = np.concatenate([other.xy for other in known.values()]) if known else np.empty((0, 2))
        near = [len(earlier) and np.min(np.hypot(*(earlier - p).T)) <= 3.0 for p in day.xy]
        closed = {day.index[c["query_scan"]] for c in day.closures}
        n_closed = sum(bool(is_near) and k in closed for k, is_near in enumerate(near))
        known[day.name] = day
        maps = set().union(*(other.maps for other in known.values()))
        cells = [
            f"{seed}",
            day.name.removeprefix("day-"),
            f"{len(day.closures)}",
            f"{false}",
            f"{n_closed} of {sum(near)}" + (f" ({n_closed / sum(near):.3f})" if sum(near) else ""),
            f"{len(maps)}",
            f"{ate(known.values()):.3f} m",
            f"{secs:.0f} s",
            f"{n_bytes / 1e9:.1f} GB",
        ]
        yield f"| {' | '.join(cells)} |"


def main():
    parser = arguments(__doc__)
    parser.add_argument("--days", type=int, default=10)
    options = parser.parse_args()
    days = Days(options.program, options.logs, options.out)
    made = [COLUMNS, rule(COLUMNS)]
    print("\n".join(made))
    for seed in chosen(options, [str(seed) for seed in (*CAMPUS_SEEDS, 13)]):
        for row in rows(days, int(seed), options.days):
            made.append(row)
            print(row, flush=True)
    if options.write:
        replace(options.write, "days", "\n".join(made))


if __name__ == "__main__":
    main()
