"""Loop closures on logs with ground truth, each found with a model that was trained on other sites.

usage: detection.py LOOPBOOST LOGS OUT [--only NAME,...] [--without-classifier] [--write docs/detection.md]

LOOPBOOST is the program. LOGS is a folder with hdl32e-*.mcap, intel-lab.mcap, austin-aces.mcap,
mit-csail.mcap and mit-killian.mcap. Pipelines, models and run folders are written into OUT; a command
that is interrupted resumes there. `--only` selects rows of the table. `--without-classifier` adds rows
with `detect.classifier = false`. `--write` replaces the tables between the `detection` comments in a
file. The script needs numpy and pyarrow.

A model is for scans of one coverage, so there are two families: models for full circles are trained on
the hdl32e logs, and models for half circles on the SICK logs with raw wheel odometry. The site of the log
is left out of both. mit-killian has no odometry: its corrected poses get a simulated drift, with the same
random numbers in each run.

The detector and the classifier see no ground truth of the log. The pipeline of `loopboost detect` names
it only for `evaluate`; a run without it gives the same closures.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

SITES = {
    "hdl32e-csail": "MIT CSAIL",
    "hdl32e-aces": "Austin ACES",
    "hdl32e-killian": "Killian Court",
    "intel-lab": "Intel",
    "austin-aces": "Austin ACES",
    "mit-csail": "MIT CSAIL",
    "mit-killian": "Killian Court",
}
FULL_CIRCLE = ["hdl32e-csail", "hdl32e-aces", "hdl32e-killian"]
# Logs with raw odometry. mit-killian has none, so nothing can be learned about odometry from it.
HALF_CIRCLE = ["intel-lab", "austin-aces", "mit-csail"]
# Simulated drives: seed of the simulation.
CAMPUS_SEEDS = [7, 11]

# Simulated drift of mit-killian: 5 % of scale, and headings that drift like a random walk.
DRIFT_SCALE = 1.05
DRIFT_RAD_PER_SQRT_M = np.radians(1.5)
DRIFT_RAD_PER_M = np.radians(0.1)

FULL_CIRCLE_INGEST = """
[ingest.lidar]
topic = "/velodyne_packets"
[ingest.pose]
wheels = "/wheel_states"
imu = "/imu/data"
track_m = 0.5
[evaluate]
truth = { topic = "/ground_truth" }
groupings = ["place"]
retrieval = false
"""
HALF_CIRCLE_INGEST = """
[ingest.lidar]
topic = "/scan"
range_min_m = 0.05
range_max_m = 80.0
[ingest.pose]
POSES
[evaluate]
truth = { topic = "/pose" }
groupings = ["place"]
retrieval = false
"""
# The logs are up to 60 m wide indoors, so negatives are farther apart than 10 m, not 50 m.
TRAINING = """
[label]
positive_radius_m = 1.5
HEADING
negative_min_m = 10.0
pairs_per_class = PAIRS
[featurize]
set = "campus"
[train]
learners = ["logit_trees"]
[detect]
"""


def pipeline(name, logs, poses=None, packets=None):
    """The pipeline of logs with packets and wheels, or with scans and poses."""
    paths = ", ".join(json.dumps(str(log)) for log in logs)
    text = f'name = "{name}"\nseed = 2436\n[ingest]\nlogs = [{paths}]\n'
    if packets if packets is not None else logs[0].stem in FULL_CIRCLE:
        return text + FULL_CIRCLE_INGEST
    return text + HALF_CIRCLE_INGEST.replace("POSES", poses or 'topic = "/odom"')


def run(command, log_file):
    """Runs the program. 3 means that warnings need attention, which real logs have."""
    with open(log_file, "w") as file:
        done = subprocess.run([str(part) for part in command], stdout=file, stderr=subprocess.STDOUT)
    if done.returncode not in (0, 3):
        sys.exit(f"{' '.join(map(str, command))} failed:\n{Path(log_file).read_text()[-3000:]}")


def drifted(x, y, heading):
    """Poses with a simulated drift. They start at the origin."""
    random = np.random.default_rng(2436)
    turned = (np.diff(heading) + np.pi) % (2 * np.pi) - np.pi
    cos, sin = np.cos(heading[:-1]), np.sin(heading[:-1])
    dx, dy = np.diff(x), np.diff(y)
    ahead, left = cos * dx + sin * dy, cos * dy - sin * dx
    step_m = np.hypot(dx, dy)
    turned += DRIFT_RAD_PER_M * step_m + DRIFT_RAD_PER_SQRT_M * np.sqrt(step_m) * random.standard_normal(len(step_m))
    heading = np.concatenate([[0.0], np.cumsum(turned)])
    cos, sin = DRIFT_SCALE * np.cos(heading[:-1]), DRIFT_SCALE * np.sin(heading[:-1])
    x = np.concatenate([[0.0], np.cumsum(cos * ahead - sin * left)])
    y = np.concatenate([[0.0], np.cumsum(sin * ahead + cos * left)])
    return x, y, heading


class Benchmark:
    def __init__(self, program, logs, out):
        self.program, self.logs, self.out = Path(program).resolve(), Path(logs).resolve(), Path(out)
        self.out.mkdir(parents=True, exist_ok=True)

    def model_without(self, sites, family):
        """The model trained on the logs of a family that are not of some sites."""
        logs = [log for log in family if SITES[log] not in sites]
        kind = "full" if family is FULL_CIRCLE else "half"
        name = f"{kind}-without-{('-and-'.join(sites) or 'none').lower().replace(' ', '-')}"
        heading = "" if family is FULL_CIRCLE else "positive_heading_deg = 30.0"
        # intel-lab and austin-aces have 352 positive pairs of keyframes with a true pose. intel-lab has 40, in
        # too few places to test on places not seen in training.
        n_pairs = "600" if family is FULL_CIRCLE else "40" if logs == ["intel-lab"] else "300"
        grouping = "pair" if logs == ["intel-lab"] else "place"
        file = self.out / f"{name}.toml"
        paths = [self.logs / f"{log}.mcap" for log in logs]
        text = pipeline(name, paths).replace('["place"]', f'["{grouping}"]')
        file.write_text(text + TRAINING.replace("HEADING", heading).replace("PAIRS", n_pairs))
        run([self.program, "run", file, "--out", self.out / name], self.out / f"{name}.txt")
        # The newest version of the one learner.
        versions = sorted((self.out / name / "models").glob("*/*/model.json"), key=lambda p: p.stat().st_mtime)
        return versions[-1]

    def drifting_poses(self, log):
        """Writes the corrected poses of a log with a simulated drift as a TUM file."""
        source = self.out / f"{log}-poses.toml"
        source.write_text(pipeline(f"{log}-poses", [self.logs / f"{log}.mcap"], 'topic = "/pose"'))
        run([self.program, "ingest", source, "--out", self.out / f"{log}-poses"], self.out / f"{log}-poses.txt")
        table = pq.read_table(self.out / f"{log}-poses/poses/{log}.parquet")
        stamps = table["stamp_ns"].to_numpy()
        x, y, heading = drifted(*(table[name].to_numpy() for name in ("x_m", "y_m", "heading_rad")))
        file = self.out / f"{log}-drift.tum"
        with open(file, "w") as text:
            for stamp, *pose in zip(stamps, x, y, heading):
                seconds, nanoseconds = divmod(int(stamp), 10**9)
                qz, qw = np.sin(pose[2] / 2), np.cos(pose[2] / 2)
                text.write(f"{seconds}.{nanoseconds:09d} {pose[0]:.6f} {pose[1]:.6f} 0 0 0 {qz:.9f} {qw:.9f}\n")
        return f"file = {json.dumps(file.name)}"

    def detect(self, log, classifier=True):
        """Finds the closures of a log. Returns its measures and the time that it took."""
        family = FULL_CIRCLE if log in FULL_CIRCLE else HALF_CIRCLE
        model = self.model_without([SITES[log]], family)
        poses = self.drifting_poses(log) if log == "mit-killian" else None
        name = log if classifier else f"{log}-without-classifier"
        file = self.out / f"{name}.toml"
        text = pipeline(name, [self.logs / f"{log}.mcap"], poses)
        file.write_text(text + ("" if classifier else "[detect]\nclassifier = false\n"))
        start = time.monotonic()
        command = [self.program, "detect", file, "--model", model, "--out", self.out / name]
        run(command, self.out / f"{name}.txt")
        secs = time.monotonic() - start
        return measures(self.out / name), secs

    def campus(self, seed):
        """Two simulated drives, with the model of all full-circle logs."""
        model = self.model_without([], FULL_CIRCLE)
        file = Path(__file__).resolve().parents[2] / "pipelines/north-campus.toml"
        out = self.out / f"north-campus-{seed}"
        command = [self.program, "detect", file, "--model", model, "--out", out, "--set", f"seed={seed}"]
        start = time.monotonic()
        run(command + ["--set", 'evaluate.truth.topic="/ground_truth"'], f"{out}.txt")
        return measures(out), time.monotonic() - start


def measures(folder):
    """The measures of each log: name -> {measure: value}."""
    table = pq.read_table(folder / "evaluation/detection.parquet")
    logs = {}
    for row in table.to_pylist():
        of_log = logs.setdefault(row["log"], {})
        # A log in several segments: counts add up, other measures are those of the first segment.
        name, value = row["measure"], row["value"]
        is_count = name.startswith(("n_", "revisits", "candidates_"))
        of_log[name] = of_log[name] + value if is_count and name in of_log else of_log.get(name, value)
    return logs


COLUMNS = "| log | accepted | false by pose | two keyframes beyond 1.5, 3, 5 m | revisits closed | opposite direction | median error | ATE: odometry, scan matching, optimized | NEES / 3 | time |"
STAGES = "| log | revisits | retrieved | proposed | kept | closed within 5 m of path | closed |"


def row(name, m, secs):
    count = lambda key: f"{m.get(key, 0):.0f}"
    number = lambda key, digits: f"{m[key]:.{digits}f}" if m.get(key) is not None else "-"
    closed = f"{count('revisits_closed')} of {count('revisits')}"
    share = f" ({m['revisits_closed'] / m['revisits']:.3f})" if m.get("revisits") else ""
    opposite = f"{count('revisits_closed_opposite_direction')} of {count('revisits_opposite_direction')}"
    beyond = ", ".join(count(f"n_beyond_{d}_m") for d in ("1.5", "3", "5"))
    ate = ", ".join(number(f"ate_rmse_m_{of}", 3) for of in ("odometry", "scan_matched", "optimized"))
    error = f"{number('closure_median_m', 3)} m, {number('closure_median_deg', 2)} deg"
    cells = [
        name,
        count("n_accepted"),
        count("n_false_by_pose"),
        beyond,
        closed + share,
        opposite,
        error,
        f"{ate} m",
        number("closure_nees_factor", 2),
        f"{secs:.0f} s",
    ]
    return f"| {' | '.join(cells)} |"


def stages(name, m):
    keys = ["revisits", "revisits_retrieved", "revisits_proposed", "revisits_kept", "revisits_closed_nearby", "revisits_closed"]
    return f"| {name} | {' | '.join(f'{m.get(key, 0):.0f}' for key in keys)} |"


def rule(header):
    return "|" + "---|" * (header.count("|") - 1)


def table(benchmark, names, without_classifier):
    rows, losses = [COLUMNS, rule(COLUMNS)], [STAGES, rule(STAGES)]

    def add(found, secs, suffix=""):
        for log, of_log in found.items():
            rows.append(row(log + suffix, of_log, secs))
            losses.append(stages(log + suffix, of_log))
            print(rows[-1], flush=True)

    for name in names:
        if name.startswith("north-campus"):
            seed = int(name.rsplit("-", 1)[1])
            add(*benchmark.campus(seed), f", seed {seed}")
            continue
        add(*benchmark.detect(name))
        if without_classifier:
            add(*benchmark.detect(name, classifier=False), ", without the classifier")
    return "\n".join(rows) + "\n\nRevisits that are left after each stage, by keyframe:\n\n" + "\n".join(losses)


def replace(file, name, made):
    """Replaces the text between the comments of a name in a file."""
    begin, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->\n"
    before, rest = file.read_text().split(begin)
    _, after = rest.split(end)
    file.write_text(f"{before}{begin}{made}\n{end}{after}")


def arguments(doc):
    """The arguments that all scripts with a Benchmark have."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("logs")
    parser.add_argument("out")
    parser.add_argument("--only", help="names of rows, separated by commas")
    parser.add_argument("--write", type=Path)
    return parser


def chosen(options, names):
    """The names of the rows that `--only` selects."""
    wanted = options.only.split(",") if options.only else names
    unknown = set(wanted) - set(names)
    if unknown:
        sys.exit(f"--only names {', '.join(sorted(unknown))}, expected some of {', '.join(names)}")
    return [name for name in names if name in wanted]


def main():
    parser = arguments(__doc__)
    parser.add_argument("--without-classifier", action="store_true")
    options = parser.parse_args()
    names = chosen(options, [*SITES, *(f"north-campus-{seed}" for seed in CAMPUS_SEEDS)])
    made = table(Benchmark(options.program, options.logs, options.out), names, options.without_classifier)
    print(made)
    if options.write:
        replace(options.write, "detection", made)


if __name__ == "__main__":
    main()
