"""Maps of several drives: which logs share a map, closures between them, and the error of the maps.

usage: sites.py LOOPBOOST LOGS OUT [--only NAME,...] [--write docs/maps.md]

LOOPBOOST is the program, and LOGS the folder that detection.py needs. Pipelines, models and run folders are
written into OUT, which can be that of detection.py: the models are the same. Each site is solved with a model
that was trained on other sites. `--only` selects rows, and `--write` replaces the table between the `sites`
comments in a file. The script needs numpy, pyarrow and mcap.

Halves: a log is cut in the middle of its time. The second half gets odometry of its own, so that nothing is known
of the relative pose of the two. Different buildings are given as one site. Two drives through equal buildings, one
in each, look the same to their scans: docs/maps.md states this limit.
"""

import json
import time
from pathlib import Path

import mcap.reader
from buildings import symmetric_ring, wings_side_by_side, write_drive
from cuts import Log
from detection import (
    CAMPUS_SEEDS,
    FULL_CIRCLE,
    HALF_CIRCLE,
    SITES,
    Benchmark,
    arguments,
    chosen,
    pipeline,
    replace,
    rule,
    run,
)

COLUMNS = "| site | drives | maps | accepted between drives | false | revisits closed | median error | ATE of the maps | time |"


def halves(source, folder):
    """The two halves of a log. They overlap in nothing."""
    with open(source, "rb") as file:
        statistics = mcap.reader.make_reader(file).get_summary().statistics
    middle_ns = (statistics.message_start_time + statistics.message_end_time) // 2
    folder.mkdir(exist_ok=True)
    paths = [folder / f"{source.stem}-{half}.mcap" for half in ("first", "second")]
    for path, start_ns, end_ns in zip(paths, (None, middle_ns), (middle_ns, None)):
        log = Log(path)
        log.add(source, end_ns=end_ns, start_ns=start_ns)
        log.finish()
    return paths


class Sites(Benchmark):
    def detect(self, name, logs, left_out, family, truth=True):
        """Solves logs as one site."""
        model = self.model_without(left_out, family)
        file = self.out / f"site-{name}.toml"
        text = pipeline(name, logs, packets=family is FULL_CIRCLE)
        if not truth:
            # The frames of the ground truth of different buildings have no relation.
            text = "\n".join(line for line in text.splitlines() if not line.startswith("truth"))
        file.write_text(text.replace("[ingest]\n", '[ingest]\nsite = "one"\n', 1) + "\n")
        return self.solve(name, [self.program, "detect", file, "--model", model])

    def campus(self, seed):
        """Two days, in opposite directions around the same buildings."""
        model = self.model_without([], FULL_CIRCLE)
        file = Path(__file__).resolve().parents[2] / "pipelines/north-campus.toml"
        options = ["--set", f"seed={seed}", "--set", 'evaluate.truth.topic="/ground_truth"']
        return self.solve(f"campus-{seed}", [self.program, "detect", file, "--model", model, *options])

    def solve(self, name, command):
        out = self.out / f"site-{name}"
        start = time.monotonic()
        run([*command, "--out", out, "--set", "detect.classifier=false"], f"{out}.txt")
        secs = time.monotonic() - start
        return json.loads((out / "evaluation/summary.json").read_text())["sites"][0], secs

    def two_halves(self, log):
        family = FULL_CIRCLE if log in FULL_CIRCLE else HALF_CIRCLE
        logs = halves(self.logs / f"{log}.mcap", self.out.resolve() / "halves")
        return self.detect(f"{log}-halves", logs, [SITES[log]], family)

    def buildings(self, name, logs, family):
        logs = [self.logs / f"{log}.mcap" for log in logs]
        # The models of the other families were trained on these sites, but not on two of them as one.
        return self.detect(name, logs, [SITES[logs[0].stem]], family, truth=False)

    def equal_buildings(self, name, building, scanner):
        """One drive in each of two equal buildings."""
        folder = self.out.resolve() / "equal"
        folder.mkdir(exist_ok=True)
        logs = [folder / f"{name}-{k}.mcap" for k in (1, 2)]
        # Without another noise, the second log would be a copy, which a run leaves out.
        for seed, log in enumerate(logs):
            if not log.exists():
                write_drive(log, building, scanner, seed)
        return self.detect(name, logs, [], FULL_CIRCLE if scanner == "full" else HALF_CIRCLE, truth=False)


def rows(sites):
    """The rows of the table, by name."""
    halved = {f"{log} in two halves": lambda log=log: sites.two_halves(log) for log in FULL_CIRCLE + HALF_CIRCLE}
    campus = {f"north-campus on two days with seed {seed}": lambda seed=seed: sites.campus(seed) for seed in CAMPUS_SEEDS}
    return campus | halved | {
        "three buildings with a full circle": lambda: sites.buildings("full-buildings", FULL_CIRCLE, FULL_CIRCLE),
        "three buildings with a half circle": lambda: sites.buildings("half-buildings", HALF_CIRCLE, HALF_CIRCLE),
        "symmetric building with a half circle": lambda: sites.equal_buildings("symmetric", symmetric_ring(100), "half"),
        "equal buildings with a half circle": lambda: sites.equal_buildings("equal", wings_side_by_side(), "half"),
    }


def row(name, site, secs):
    metres = lambda value: "-" if value is None else f"{value:.3f} m"
    truth = site["truth"] or {}
    count = lambda key: f"{truth[key]}" if truth else "-"
    share = f" ({truth['n_closed'] / truth['n_revisits']:.3f})" if truth.get("n_revisits") else ""
    cells = [
        name,
        f"{site['n_drives']}",
        f"{len(site['maps'])}",
        f"{site['n_accepted']}",
        f"{count('n_false')} of {count('n_judged')}" if truth else "-",
        f"{count('n_closed')} of {count('n_revisits')}{share}" if truth else "-",
        metres(truth.get("median_m")),
        ", ".join(metres(of_map["ate_rmse_m"]) for of_map in site["maps"]),
        f"{secs:.0f} s",
    ]
    return f"| {' | '.join(cells)} |"


def main():
    options = arguments(__doc__).parse_args()
    of_rows = rows(Sites(options.program, options.logs, options.out))
    made = [COLUMNS, rule(COLUMNS)]
    print("\n".join(made))
    for name in chosen(options, list(of_rows)):
        made.append(row(name, *of_rows[name]()))
        print(made[-1], flush=True)
    if options.write:
        replace(options.write, "sites", "\n".join(made))


if __name__ == "__main__":
    main()
