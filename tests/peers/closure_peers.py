"""Compares the closures of `loopboost detect` with those of other programs, on the same run folders.

usage: closure_peers.py RUN... [--graphs RUN...] [--only gnc,map-closures,karto] [--max-range-m 25]
                        [--write docs/detection.md]

RUN is the folder of `loopboost detect` for a log with ground truth, in one segment. Its model is searched
in the run folders next to it. The script needs numpy, pyarrow, gtsam 4.3, map-closures 2.2 and
karto-scanmatcher 1.0.

- GTSAM: graduated non-convexity on `graph.g2o`, and on the candidates that `optimize` has to choose from.
- MapClosures: the closures that it finds in submaps, joined with the scan-matched poses.
- karto-scanmatcher: scan matching of the submaps of candidates, and of pairs of different places.

`--graphs` are more runs for GTSAM only. `--max-range-m` limits the returns in the submaps. `--write` replaces
the tables between the `peers` comments in a file.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from detection import measures, replace, rule
from detector import MAX_GAP_NS, pose_at, read_truth, relative, wrap

POSE = ("x_m", "y_m", "heading_rad")
# The same limits as in crates/evaluate/src/detection.
MAX_CARRY_NS = 4_000_000_000
DOUBTFUL_M, DOUBTFUL_RAD = 0.5, np.radians(5.0)
MAX_DOUBTFUL, MAX_STEP_M = 5, 5.0
RIGHT_M, RIGHT_RAD = 0.5, np.radians(5.0)
FALSE_M, FALSE_RAD = 1.0, np.radians(8.0)
REVISIT_M, REVISIT_PATH_M = 3.0, 30.0
# The distance between places along the path, as in `optimize`.
PLACE_M = 2.5


def compose(a, b):
    """The pose `b`, which is given in the frame of pose `a`, in the frame of `a` itself."""
    cos, sin = np.cos(a[2]), np.sin(a[2])
    return np.array([a[0] + cos * b[0] - sin * b[1], a[1] + sin * b[0] + cos * b[1], wrap(a[2] + b[2])])


def poses_of(table):
    return np.stack([table[name].to_numpy() for name in POSE], 1)


def difference(found, expected):
    """Distance and angle between two relative poses."""
    return np.hypot(*(found[:2] - expected[:2])), abs(wrap(found[2] - expected[2]))


class Run:
    """A run folder: the registered scans of its log, by index, with path, scan-matched and true poses."""

    def __init__(self, folder):
        self.folder = Path(folder)
        (registered,) = (self.folder / "registered").glob("*.parquet")
        self.log = registered.stem
        table = pq.read_table(registered)
        assert len(set(table["segment"].to_pylist())) == 1, f"{registered} has several segments, expected one"
        self.scan = table["scan"].to_numpy()
        self.stamp_ns = table["stamp_ns"].to_numpy()
        self.path_m = table["travel_m"].to_numpy()
        self.is_keyframe = table["keyframe"].to_numpy(zero_copy_only=False)
        self.matched = poses_of(table)
        self.row_of = {scan: row for row, scan in enumerate(self.scan)}
        self.measures = measures(self.folder)[self.log]
        self.candidates = self.pairs("candidates.parquet")
        self.closures = self.pairs("closures.parquet")
        optimized = pq.read_table(self.folder / f"trajectory/{registered.name}")
        self.optimized_ns, self.optimized = optimized["stamp_ns"].to_numpy(), poses_of(optimized)
        self.truth = self.true_poses()
        self.places = self.every(PLACE_M)

    def pairs(self, name):
        """The rows of a table of pairs, with indices of scans and the relative pose."""
        rows = pq.read_table(self.folder / name).to_pylist()
        for row in rows:
            row["query"], row["reference"] = (self.row_of[row[f"{of}_scan"]] for of in ("query", "reference"))
            row["pose"] = np.array([row["dx_m"], row["dy_m"], row["dheading_rad"]])
        return rows

    def every(self, step_m):
        """Keyframes at least `step_m` of path apart."""
        places, next_m = [], -np.inf
        for row in np.flatnonzero(self.is_keyframe):
            if next_m <= self.path_m[row]:
                places.append(int(row))
                next_m = self.path_m[row] + step_m
        return places

    def detector(self):
        """What the model of the run has learned."""
        task = json.loads((self.folder / "run.json").read_text())["tasks"]["detect"]
        model = task["options"]["model"]
        found = sorted(self.folder.parent.glob(f"*/models/{model['name']}/{model['version']}/model.json"))
        if found:
            return json.loads(found[0].read_text())["detector"]
        raise SystemExit(f"model {model['name']} {model['version']} of {self.folder} is not next to it")

    def optimized_at(self, stamp_ns):
        """The optimized pose, interpolated."""
        after = np.clip(np.searchsorted(self.optimized_ns, stamp_ns), 1, len(self.optimized_ns) - 1)
        a, b = self.optimized[after - 1], self.optimized[after]
        share = (stamp_ns - self.optimized_ns[after - 1]) / (self.optimized_ns[after] - self.optimized_ns[after - 1])
        step = b - a
        step[2] = wrap(step[2])
        return a + np.clip(share, 0, 1) * step

    def matched_at(self, stamp_ns):
        """The scan-matched pose: that of the last registered scan, moved like the optimized poses."""
        last = max(np.searchsorted(self.stamp_ns, stamp_ns, side="right") - 1, 0)
        step = relative(self.optimized_at(self.stamp_ns[last]), self.optimized_at(stamp_ns))
        return compose(self.matched[last], step)

    def doubtful(self, truth):
        """True poses that contradict scan matching, while the truth before and after agrees with it."""
        poses = truth["pose"]
        matched = [self.matched_at(stamp) for stamp in truth["stamp_ns"]]

        def agrees(a, b):
            if MAX_STEP_M < np.hypot(*(poses[b] - poses[a])[:2]):
                return None
            metres, angle = difference(relative(poses[a], poses[b]), relative(matched[a], matched[b]))
            return bool(metres <= DOUBTFUL_M and angle <= DOUBTFUL_RAD)

        doubtful, k = np.zeros(len(poses), bool), 0
        while k + 1 < len(poses):
            following = k + 1
            if agrees(k, following) is False:
                later = range(k + 2, min(k + 1 + MAX_DOUBTFUL, len(poses) - 1) + 1)
                agreeing = next((after for after in later if agrees(k, after)), None)
                if agreeing is not None:
                    doubtful[k + 1 : agreeing] = True
                    following = agreeing
            k = following
        return doubtful

    def true_poses(self):
        """The true pose of each registered scan, or None: see crates/evaluate/src/detection/truth.rs."""
        truth = read_truth(self.folder / f"truth/{self.log}.parquet")
        stamps = truth["stamp_ns"]
        if np.median(np.diff(stamps)) <= MAX_GAP_NS:
            found = [pose_at(truth, stamp) for stamp in self.stamp_ns]
            return [None if pose is None else pose[0] for pose in found]
        trusted = ~self.doubtful(truth)
        stamps, poses = stamps[trusted], truth["pose"][trusted]
        found = []
        for stamp in self.stamp_ns:
            nearest = int(np.argmin(abs(stamps - stamp)))
            if MAX_CARRY_NS < abs(stamps[nearest] - stamp):
                found.append(None)
                continue
            step = relative(self.optimized_at(stamps[nearest]), self.optimized_at(stamp))
            found.append(compose(poses[nearest], step))
        return found

    def true_relative(self, query, reference):
        if self.truth[query] is None or self.truth[reference] is None:
            return None
        return relative(self.truth[reference], self.truth[query])

    def judge(self, query, reference, pose):
        """'right', 'inexact', 'false' or 'unknown', with the errors of position and heading."""
        truth = self.true_relative(query, reference)
        if truth is None:
            return "unknown", None, None
        metres, angle = difference(pose, truth)
        if FALSE_M < metres or FALSE_RAD < angle:
            return "false", metres, angle
        return ("right" if metres < RIGHT_M and angle < RIGHT_RAD else "inexact"), metres, angle

    def verdicts(self, pairs):
        return [self.judge(pair["query"], pair["reference"], pair["pose"])[0] for pair in pairs]

    def trajectory_error_m(self, poses):
        """ATE: the distance of the poses of all registered scans from the truth, root mean square."""
        known = [row for row, truth in enumerate(self.truth) if truth is not None]
        return aligned_distance_m(poses[known], np.array([self.truth[row] for row in known]))


def aligned_distance_m(found, expected):
    """The root mean square distance of two trajectories after alignment."""
    found, expected = (poses[:, :2] - poses[:, :2].mean(0) for poses in (found, expected))
    u, _, vt = np.linalg.svd(expected.T @ found)
    rotation = u @ np.diag([1, np.linalg.det(u @ vt)]) @ vt
    return np.sqrt(np.mean(np.sum((expected - found @ rotation.T) ** 2, 1)))


# GTSAM

# The limit of `reject_false_closures`: 99 % of right closures have a smaller squared error.
INLIER_PROBABILITY = 0.99
ANCHOR_STD = 1e-4
MIN_STEP_M = 0.2
# A confirmed closure is at most this far from the candidate for the same pair, as in `guided.rs`.
SAME_M, SAME_RAD = 0.35, np.radians(3.0)
REJECTED_BEFORE = ("low_confidence", "inconsistent", "unsupported")


def gnc(graph, start, known):
    """Which factors GTSAM's graduated non-convexity keeps, with truncated least squares, and its time."""
    import gtsam

    parameters = gtsam.GncLMParams()
    parameters.setLossType(gtsam.GncLossType.TLS)
    parameters.setKnownInliers(known)
    begin = time.monotonic()
    optimizer = gtsam.GncLMOptimizer(graph, start, parameters)
    optimizer.setInlierCostThresholdsAtProbability(INLIER_PROBABILITY)
    optimizer.optimize()
    return optimizer.getWeights() > 0.5, time.monotonic() - begin


def anchored(graph, first):
    import gtsam

    graph.addPriorPose2(0, first, gtsam.noiseModel.Isotropic.Sigma(3, ANCHOR_STD))


def exported(run):
    """A row about `graph.g2o`."""
    import gtsam

    path = run.folder / "graph.g2o"
    lines = path.read_text().splitlines()
    graph, start = gtsam.readG2o(str(path), False)
    n_edges, n = graph.size(), start.size()
    assert n_edges == sum(line.startswith("EDGE") for line in lines), f"GTSAM reads {n_edges} edges"
    chain = [k for k in range(n_edges) if graph.at(k).keys()[1] == graph.at(k).keys()[0] + 1]
    anchored(graph, start.atPose2(0))
    kept, secs = gnc(graph, start, [*chain, n_edges])
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, start)
    after = optimizer.optimize()
    poses = lambda values: np.array([[p.x(), p.y(), p.theta()] for p in map(values.atPose2, range(n))])
    moved = f"{aligned_distance_m(poses(after), poses(start)):.3f} m"
    ate = f"{run.trajectory_error_m(poses(start)):.3f}, {run.trajectory_error_m(poses(after)):.3f} m"
    n_closures = n_edges - len(chain)
    return [run.log, n_closures, int(kept.sum()) - len(chain) - 1, moved, ate, f"{secs:.2f} s"]


def chosen(run, candidates):
    """What GTSAM keeps of candidates, with the noise that the detector of the run has learned."""
    import gtsam

    detector = run.detector()
    rows = sorted({*run.places, *(c[of] for c in run.candidates for of in ("query", "reference"))})
    index = {row: k for k, row in enumerate(rows)}
    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, row in enumerate(rows):
        start.insert(k, gtsam.Pose2(*run.matched[row]))

    def add(a, b, pose, std_m, std_rad):
        noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([std_m, std_m, std_rad]))
        graph.add(gtsam.BetweenFactorPose2(a, b, gtsam.Pose2(*pose), noise))

    for k, (a, b) in enumerate(zip(rows, rows[1:])):
        root = np.sqrt(max(run.path_m[b] - run.path_m[a], MIN_STEP_M))
        noise = (detector["drift"][f"std_{unit}_per_sqrt_m"] * root for unit in ("m", "rad"))
        add(k, k + 1, relative(run.matched[a], run.matched[b]), *noise)
    noise = [detector["closure"][f"consistency_std_{unit}"] for unit in ("m", "rad")]
    for c in candidates:
        add(index[c["reference"]], index[c["query"]], c["pose"], *noise)
    anchored(graph, start.atPose2(0))
    n_chain = len(rows) - 1
    kept, secs = gnc(graph, start, [*range(n_chain), n_chain + len(candidates)])
    return kept[n_chain:-1], secs


def kept_by_loopboost(run, candidates):
    """Which candidates `optimize` keeps: not rejected, and not replaced by another relative pose."""
    closure = {(c["query"], c["reference"]): c for c in run.closures}

    def is_kept(candidate):
        found = closure[candidate["query"], candidate["reference"]]
        metres, angle = difference(found["pose"], candidate["pose"])
        return found["reason"] not in REJECTED_BEFORE and metres < SAME_M and angle < SAME_RAD

    return np.array([is_kept(c) for c in candidates])


def offered(run):
    """The candidates that `optimize` offers to its pose graph."""
    closure = {(c["query"], c["reference"]): c["reason"] for c in run.closures}
    return [c for c in run.candidates if closure[c["query"], c["reference"]] != "low_confidence"]


# Submaps

# `register`, `detect` and `optimize` use the returns up to this range.
MAX_RANGE_M = 25.0


def scans_of(run, max_range_m):
    """The points of each registered scan, in the frame of the lidar."""
    table = pq.read_table(run.folder / f"scans/{run.log}.parquet", columns=["scan", "x_m", "y_m"])
    row_of = {scan: row for row, scan in enumerate(table["scan"].to_pylist())}
    scans = []
    for scan in run.scan:
        points = np.stack([table[name][row_of[scan]].values.to_numpy() for name in ("x_m", "y_m")], 1)
        scans.append(points[np.hypot(*points.T) < max_range_m].astype(float))
    return scans


def members(run, place, half_m):
    """The scans around a place, each with its scan-matched pose in the frame of the place."""
    near = np.flatnonzero(abs(run.path_m - run.path_m[place]) <= half_m)
    return [(row, relative(run.matched[place], run.matched[row])) for row in near]


def submap(run, scans, place, half_m):
    """The points of the scans around a place, in the frame of the place."""
    parts = []
    for row, (x, y, heading) in members(run, place, half_m):
        cos, sin = np.cos(heading), np.sin(heading)
        parts.append(scans[row] @ np.array([[cos, sin], [-sin, cos]]) + [x, y])
    return np.concatenate(parts)


# MapClosures

# Name, path before and after a place [m], size of a pixel [m]. The other options are the defaults.
MAP_CLOSURES = [
    ("defaults, 20 m submaps", 10.0, 0.5),
    ("0.1 m pixels, 20 m submaps", 10.0, 0.1),
    ("0.1 m pixels, 10 m submaps", 5.0, 0.1),
]
# Its pipeline accepts closures with more inliers than this.
DEFAULT_INLIERS = 5
# A revisit is closed if there is a right closure at most this far along the path, as in `closed_nearby`.
NEAR_PATH_M = 1.75


def map_closures(run, scans, half_m, pixel_m):
    """The closures that MapClosures finds: (query, inliers, verdict, errors). Also its time."""
    from map_closures.config import MapClosuresConfig
    from map_closures.map_closures import MapClosures

    found, secs = [], 0.0
    program = MapClosures(MapClosuresConfig(density_map_resolution=pixel_m))
    for index, place in enumerate(run.places):
        points = submap(run, scans, place, half_m)
        points = np.column_stack([points, np.zeros(len(points))])
        begin = time.monotonic()
        closures = program.get_closures(index, points)
        secs += time.monotonic() - begin
        for closure in closures:
            reference, query = run.places[closure.source_id], run.places[closure.target_id]
            if run.path_m[query] - run.path_m[reference] < REVISIT_PATH_M:
                continue
            # The pose of the reference in the frame of the query.
            matrix = np.asarray(closure.pose)
            pose = np.array([matrix[0, 3], matrix[1, 3], np.arctan2(matrix[1, 0], matrix[0, 0])])
            verdict = run.judge(query, reference, relative(pose, np.zeros(3)))
            found.append((query, closure.number_of_inliers, *verdict))
    return [closure for closure in found if closure[2] != "unknown"], secs


def revisits_of(run):
    rows = pq.read_table(run.folder / "evaluation/revisits.parquet").to_pylist()
    return [run.row_of[row["scan"]] for row in rows]


def quality(run, found, min_inliers):
    """Cells: closures, false ones, revisits closed, median error."""
    taken = [closure for closure in found if min_inliers <= closure[1]]
    right = [closure for closure in taken if closure[2] == "right"]
    path_m = run.path_m[[closure[0] for closure in right]] if right else np.array([np.inf])
    revisits = revisits_of(run)
    n_closed = sum(abs(path_m - run.path_m[row]).min() <= NEAR_PATH_M for row in revisits)
    n_false = sum(closure[2] == "false" for closure in taken)
    errors = [np.median([closure[k] for closure in taken]) for k in (3, 4)] if taken else None
    error = f"{errors[0]:.3f} m, {np.degrees(errors[1]):.2f} deg" if errors else "-"
    precision = f"{1 - n_false / len(taken):.3f}" if taken else "-"
    return [len(taken), n_false, precision, f"{n_closed} of {len(revisits)} ({n_closed / len(revisits):.3f})", error]


def map_closures_rows(run, scans):
    of = run.measures
    error = f"{of['closure_median_m']:.3f} m, {of['closure_median_deg']:.2f} deg"
    n_near, n = int(of["revisits_closed_nearby"]), int(of["revisits"])
    n_judged, n_false = int(of["n_judged"]), int(of["n_false_by_pose"])
    precision = f"{1 - n_false / n_judged:.3f}" if n_judged else "-"
    rows = [[run.log, "loopboost", n_judged, n_false, precision, f"{n_near} of {n} ({n_near / n:.3f})", error, "-"]]
    for name, half_m, pixel_m in MAP_CLOSURES:
        found, secs = map_closures(run, scans, half_m, pixel_m)
        most = max((closure[1] for closure in found if closure[2] == "false"), default=0)
        time_used = f"{secs:.0f} s"
        rows.append([run.log, f"MapClosures, {name}", *quality(run, found, DEFAULT_INLIERS + 1), time_used])
        best = [run.log, f"the same, at least {most + 1} inliers", *quality(run, found, most + 1), time_used]
        rows.append(best)
    return rows


# karto-scanmatcher

N_BEAMS = 720
HALF_M = 5.0
# At most this many right and this many false candidates of each log, spread evenly.
MOST_PAIRS = 100
# The loop closure search of slam_toolbox: width [m], resolution [m], half of the angle [rad].
SEARCH_M, RESOLUTION_M, SEARCH_RAD = 8.0, 0.05, np.radians(20.0)
# The search starts this far from the pose of the candidate, which is already aligned.
START = np.array([0.33, -0.22, np.radians(6.3)])


class Karto:
    def __init__(self, run, scans):
        import karto_scanmatcher

        self.run, self.scans, self.karto = run, scans, karto_scanmatcher
        step = 2 * np.pi / N_BEAMS
        self.sensor = karto_scanmatcher.LaserScanConfig(-np.pi, np.pi - step, step, 0.1, MAX_RANGE_M, MAX_RANGE_M, "lidar")
        options = karto_scanmatcher.ScanMatcherConfig()
        options.search_size, options.resolution = SEARCH_M, RESOLUTION_M
        options.coarse_search_angle_offset, options.range_threshold = SEARCH_RAD, MAX_RANGE_M
        self.matcher = karto_scanmatcher.Wrapper(options)
        self.references = {}

    def scan(self, points, pose):
        """A scan of one range per beam, the shortest one; 0 where there is none."""
        beams = np.round((np.arctan2(points[:, 1], points[:, 0]) + np.pi) / (2 * np.pi) * N_BEAMS).astype(int) % N_BEAMS
        ranges = np.full(N_BEAMS, np.inf)
        np.minimum.at(ranges, beams, np.hypot(*points.T))
        ranges[np.isinf(ranges)] = 0.0
        pose = self.karto.Pose2(*pose)
        return self.karto.LocalizedRangeScan(self.sensor, ranges.tolist(), pose, pose, 0, 0.0)

    def match(self, pair):
        """The relative pose, the response and the time."""
        reference, query = pair["reference"], pair["query"]
        if reference not in self.references:
            parts = members(self.run, reference, HALF_M)
            self.references[reference] = [self.scan(self.scans[row], pose) for row, pose in parts]
        scan = self.scan(submap(self.run, self.scans, query, HALF_M), compose(pair["pose"], START))
        begin = time.monotonic()
        # As the loop closure of slam_toolbox: no penalty for the distance from the start.
        found = self.matcher.match_scan(scan, self.references[reference], False, True)
        pose = np.array([found.best_pose.x, found.best_pose.y, found.best_pose.yaw])
        return pose, found.response, time.monotonic() - begin


def spread(pairs):
    """At most `MOST_PAIRS` of the pairs, at equal steps."""
    if len(pairs) <= MOST_PAIRS:
        return pairs
    return [pairs[k] for k in np.linspace(0, len(pairs) - 1, MOST_PAIRS).astype(int)]


def karto_row(run, scans):
    karto = Karto(run, scans)
    candidates = list(zip(run.candidates, run.verdicts(run.candidates)))
    right, false = (spread([c for c, found in candidates if found == verdict]) for verdict in ("right", "false"))
    matched = [(pair, *karto.match(pair)) for pair in right + false]
    judged = [run.judge(pair["query"], pair["reference"], pose) for pair, pose, _, _ in matched]
    responses = np.array([response for _, _, response, _ in matched])
    is_right = np.array([verdict == "right" for verdict, _, _ in judged])
    of_right = np.arange(len(matched)) < len(right)
    n_above = int(np.sum(responses[of_right & is_right] > responses[~is_right].max(initial=0.0)))
    confidences = np.array([pair["confidence"] for pair in right])
    n_confident = int(np.sum(confidences > max((pair["confidence"] for pair in false), default=0.0)))
    errors = np.array([errors for (_, *errors), of in zip(judged, is_right & of_right) if of])
    own = np.array([run.judge(pair["query"], pair["reference"], pair["pose"])[1:] for pair in right])
    median = lambda e: f"{np.median(e[:, 0]):.3f} m, {np.degrees(np.median(e[:, 1])):.2f} deg" if len(e) else "-"
    response = f"{np.median(responses[of_right]):.2f}, {np.median(responses[~of_right]):.2f}"
    secs = np.mean([time_used for *_, time_used in matched])
    return [run.log, len(right), len(false), median(own), len(errors), median(errors), response, n_confident, n_above, f"{1000 * secs:.0f} ms"]


# Tables

EXPORTED = "| log | closures | kept by GTSAM | distance of its optimum from `trajectory.parquet` | ATE: `trajectory.parquet`, optimum | time of GTSAM |"
CHOSEN = "| log | offered | right, false, unknown | kept by loopboost: all, false | kept by GTSAM: all, false | kept by both | only the false ones offered to GTSAM: kept | time of GTSAM |"
MAPS = "| log | program | closures | false | precision | revisits closed nearby | median error | time |"
KARTO = "| log | right pairs | wrong pairs | loopboost: median error | karto: right | karto: median error | response of right and wrong pairs, median | right pairs above all wrong ones: loopboost, by confidence | karto, by response | time per pair |"


def chosen_row(run):
    pairs = offered(run)
    verdicts = np.array(run.verdicts(pairs))
    kept, secs = chosen(run, pairs)
    own = kept_by_loopboost(run, pairs)
    false = [pair for pair, verdict in zip(pairs, verdicts) if verdict == "false"]
    n_false_kept = int(chosen(run, false)[0].sum()) if false else 0
    count = lambda mask: f"{mask.sum()}, {(mask & (verdicts == 'false')).sum()}"
    kinds = ", ".join(str((verdicts == kind).sum()) for kind in ("right", "false", "unknown"))
    return [run.log, len(pairs), kinds, count(own), count(kept), int((own & kept).sum()), f"{n_false_kept} of {len(false)}", f"{secs:.2f} s"]


def lines(header, rows):
    """A table. Its rows are printed as soon as they are there."""
    text = [header, rule(header)]
    for row in rows:
        text.append(f"| {' | '.join(map(str, row))} |")
        print(text[-1], file=sys.stderr, flush=True)
    return "\n".join(text)


def tables(runs, graphs, peers, max_range_m):
    made = []
    if "gnc" in peers:
        made.append("GTSAM on `graph.g2o`:\n\n" + lines(EXPORTED, map(exported, runs + graphs)))
        made.append("GTSAM on the candidates:\n\n" + lines(CHOSEN, map(chosen_row, runs + graphs)))
    scans = {run.log: scans_of(run, max_range_m) for run in runs} if set(peers) - {"gnc"} else {}
    if "map-closures" in peers:
        rows = (row for run in runs for row in map_closures_rows(run, scans[run.log]))
        made.append("MapClosures:\n\n" + lines(MAPS, rows))
    if "karto" in peers:
        made.append("karto-scanmatcher:\n\n" + lines(KARTO, (karto_row(run, scans[run.log]) for run in runs)))
    return "\n\n".join(made)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", metavar="RUN")
    parser.add_argument("--graphs", nargs="+", metavar="RUN", default=[])
    parser.add_argument("--max-range-m", type=float, default=MAX_RANGE_M)
    parser.add_argument("--only", default="gnc,map-closures,karto")
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    runs, graphs = ([Run(folder) for folder in folders] for folders in (options.runs, options.graphs))
    made = tables(runs, graphs, options.only.split(","), options.max_range_m)
    print(made)
    if options.write:
        replace(options.write, "peers", made)


if __name__ == "__main__":
    main()
