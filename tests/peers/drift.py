"""Drift of fused poses and of plain wheel odometry against ground truth, as a table.

usage: drift.py LOOPBOOST FUSE_CSV LOGS [--write docs/poses.md]

LOOPBOOST is the program. FUSE_CSV is the example of crates/fuse (`cargo build --release -p fuse
--example fuse_csv`). LOGS is a folder with hdl32e-*.mcap, which `loopboost ingest` fuses, and
nclt-*.mcap, which have no lidar and are fused by the example. The script needs mcap,
mcap-ros2-support, numpy, pyarrow and evo. `--write` replaces the table between the two `drift`
comments in a file.

Plain wheels: both speeds, integrated by the trapezoidal rule over arcs with the nominal track width.
Drift per 100 m: mean translation part of the relative pose errors of evo, over all pairs of poses
that are 100 m of path apart, computed here and compared with evo. Final drift: distance of the last
pose from the ground truth when the first poses are aligned, as a share of the path length.
"""

import copy
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from evo.core import metrics
from evo.core.trajectory import PoseTrajectory3D
from evo.core.units import Unit
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

TRACK_M = 0.5
SPINNING = ["hdl32e-killian", "hdl32e-csail", "hdl32e-aces"]
# The wheels of these logs measure 8 % too much.
SEGWAY = ["nclt-2012-11-04", "nclt-2012-11-16", "nclt-2013-01-10"]
SEGWAY_SCALE = 0.926


def yaw(q):
    return np.arctan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))


def read(log, topics):
    """Rows of each topic: the stamp [ns] and the values that `topics` extracts from a message."""
    rows = {topic: [] for topic in topics}
    with open(log, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages(topics=list(topics)):
            stamp = message.header.stamp
            row = topics[channel.topic](message)
            rows[channel.topic].append((stamp.sec * 10**9 + stamp.nanosec, *row))
    return rows


def truth(message):
    pose = message.pose
    return pose.position.x, pose.position.y, yaw(pose.orientation)


class Path2:
    """Stamps [ns], positions [m], headings not wrapped [rad]."""

    def __init__(self, stamps, x, y, heading):
        self.stamps = np.asarray(stamps, np.int64)
        self.x, self.y = np.asarray(x, float), np.asarray(y, float)
        self.heading = np.unwrap(np.asarray(heading, float))

    def at(self, stamps):
        start = self.stamps[0]
        where = [(s - start) * 1e-9 for s in (stamps, self.stamps)]
        values = [np.interp(*where, v) for v in (self.x, self.y, self.heading)]
        return Path2(stamps, *values)

    def path_m(self):
        steps = np.hypot(np.diff(self.x), np.diff(self.y))
        return np.concatenate([[0.0], np.cumsum(steps)])


def plain_wheels(rows, scale):
    rows = np.array(rows, dtype=object)
    stamps = rows[:, 0].astype(np.int64)
    left, right = (scale * rows[:, k].astype(float) for k in (1, 2))
    dt = np.diff(stamps) * 1e-9
    mean = [0.5 * (v[1:] + v[:-1]) * dt for v in (left, right)]
    turn, forward = (mean[1] - mean[0]) / TRACK_M, 0.5 * (mean[0] + mean[1])
    heading = np.concatenate([[0.0], np.cumsum(turn)])
    middle = heading[:-1] + 0.5 * turn
    # The length of the chord of an arc.
    chord = forward * np.sinc(turn / (2 * np.pi))
    x, y = (np.concatenate([[0.0], np.cumsum(chord * f(middle))]) for f in (np.cos, np.sin))
    return Path2(stamps, x, y, heading)


def relative(path, i, j):
    """Position of pose j in the frame of pose i."""
    dx, dy = path.x[j] - path.x[i], path.y[j] - path.y[i]
    cos, sin = np.cos(path.heading[i]), np.sin(path.heading[i])
    return cos * dx + sin * dy, cos * dy - sin * dx


def drift(truth, path):
    """Drift per 100 m [m], final drift [%], final drift after alignment of all poses [%], path [m]."""
    inside = (path.stamps[0] <= truth.stamps) & (truth.stamps <= path.stamps[-1])
    truth = Path2(*(v[inside] for v in (truth.stamps, truth.x, truth.y, truth.heading)))
    path = path.at(truth.stamps)
    path_m = truth.path_m()
    # For each pose, the pose nearest to 100 m later on the path, within 10 m.
    after = np.searchsorted(path_m, path_m + 100.0)
    after = np.where(after < len(path_m), after, len(path_m) - 1)
    nearer = np.abs(path_m[after - 1] - path_m - 100.0) <= np.abs(path_m[after] - path_m - 100.0)
    after -= (nearer & (np.arange(len(path_m)) < after - 1)).astype(int)
    first = np.flatnonzero((np.abs(path_m[after] - path_m - 100.0) <= 10.0) & (np.arange(len(path_m)) < after))
    ahead, found = relative(truth, first, after[first]), relative(path, first, after[first])
    # The error is the found pose in the frame of the true pose; a rotation does not change its length.
    rpe = np.hypot(ahead[0] - found[0], ahead[1] - found[1]).mean()

    reference, estimate = trajectory(truth), trajectory(path)
    of_evo = metrics.RPE(
        metrics.PoseRelation.translation_part,
        delta=100,
        delta_unit=Unit.meters,
        all_pairs=True,
        pairs_from_reference=True,
    )
    of_evo.process_data((reference, estimate))
    theirs = of_evo.get_statistic(metrics.StatisticsType.mean)
    assert abs(rpe - theirs) < 1e-3 * theirs, f"{rpe} m here, {theirs} m by evo"

    def final(align):
        aligned = copy.deepcopy(estimate)
        align(aligned)
        off = aligned.positions_xyz[-1] - reference.positions_xyz[-1]
        return 100 * np.linalg.norm(off) / path_m[-1]

    ahead, found = (relative(p, 0, len(path_m) - 1) for p in (truth, path))
    ours = 100 * np.hypot(ahead[0] - found[0], ahead[1] - found[1]) / path_m[-1]
    theirs = final(lambda e: e.align_origin(reference))
    assert abs(ours - theirs) < 1e-6 + 1e-3 * theirs, f"{ours} % here, {theirs} % by evo"
    return rpe, ours, final(lambda e: e.align(reference)), path_m[-1]


def trajectory(path):
    zero = np.zeros_like(path.x)
    turned = np.vstack([np.cos(path.heading / 2), zero, zero, np.sin(path.heading / 2)]).T
    return PoseTrajectory3D(np.vstack([path.x, path.y, zero]).T, turned, path.stamps * 1e-9)


def by_program(program, log, folder):
    pipeline = folder / f"{log.stem}.toml"
    pipeline.write_text(
        f'[ingest]\nlogs = ["{log.resolve()}"]\nlidar.topic = "/velodyne_packets"\n'
        f'[ingest.pose]\nwheels = "/wheel_states"\nimu = "/imu/data"\ntrack_m = {TRACK_M}\n'
    )
    run = [program, "ingest", pipeline, "--out", folder / "out"]
    subprocess.run(run, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    table = pq.read_table(folder / f"out/poses/{log.stem}.parquet").to_pydict()
    return Path2(*(table[name] for name in ("stamp_ns", "x_m", "y_m", "heading_rad")))


def by_example(example, wheels, imu, folder):
    files = [folder / "wheels.csv", folder / "imu.csv"]
    for file, rows in zip(files, (wheels, imu)):
        file.write_text("".join(",".join(map(repr, row)) + "\n" for row in rows))
    settings = [f"track_m={TRACK_M}", f"wheel_scale={SEGWAY_SCALE}"]
    run = subprocess.run([example, *files, *settings], check=True, capture_output=True, text=True)
    rows = [line.split(",") for line in run.stdout.splitlines()]
    return Path2([int(row[0]) for row in rows], *(([float(row[k]) for row in rows]) for k in (1, 2, 3)))


def table(program, example, logs):
    lines = [
        "| log | path | poses | drift per 100 m | final drift | final drift, aligned |",
        "|---|---|---|---|---|---|",
    ]

    def row(name, of, measured, plain=None):
        rpe, final, fitted, path_m = measured
        times = f" ({plain[0] / rpe:.1f} times lower)" if plain else ""
        lines.append(f"| {name} | {path_m:.0f} m | {of} | {rpe:.2f} m{times} | {final:.2f} % | {fitted:.2f} % |")

    wheels = lambda message: tuple(map(float, message.velocity[:2]))
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        for name in SPINNING:
            log = logs / f"{name}.mcap"
            rows = read(log, {"/wheel_states": wheels, "/ground_truth": truth})
            true = Path2(*zip(*rows["/ground_truth"]))
            plain = drift(true, plain_wheels(rows["/wheel_states"], 1.0))
            row(name, "plain wheels", plain)
            row(name, "wheels and gyroscope", drift(true, by_program(program, log, folder)), plain)
            row(name, "*true speed and heading*", drift(true, straight_ahead(true)))
        for name in SEGWAY:
            rows = read(
                logs / f"{name}.mcap",
                {
                    "/wheels": wheels,
                    "/imu": lambda m: (m.angular_velocity.z, float(yaw(m.orientation))),
                    "/ground_truth": truth,
                },
            )
            true = Path2(*zip(*rows["/ground_truth"]))
            plain = drift(true, plain_wheels(rows["/wheels"], SEGWAY_SCALE))
            row(name, "plain wheels", plain)
            rates = [row[:2] for row in rows["/imu"]]
            for of, imu in [("wheels and gyroscope", rates), ("wheels, gyroscope and heading", rows["/imu"])]:
                row(name, of, drift(true, by_example(example, rows["/wheels"], imu, folder)), plain)
    return "\n".join(lines)


def straight_ahead(true):
    """The path of a robot that measures speed and heading without error and is assumed to drive in
    the direction of its heading. Sideways motion is lost."""
    steps = np.hypot(np.diff(true.x), np.diff(true.y))
    middle = 0.5 * (true.heading[1:] + true.heading[:-1])
    x, y = (np.concatenate([[0.0], np.cumsum(steps * f(middle))]) for f in (np.cos, np.sin))
    return Path2(true.stamps, x, y, true.heading)


def main():
    program, example, logs, *more = sys.argv[1:]
    made = table(Path(program).resolve(), Path(example).resolve(), Path(logs))
    print(made)
    if more:
        option, file = more
        assert option == "--write", option
        begin, end = "<!-- drift -->\n", "<!-- end of drift -->\n"
        text = Path(file).read_text()
        before, rest = text.split(begin)
        _, after = rest.split(end)
        Path(file).write_text(f"{before}{begin}{made}\n{end}{after}")


if __name__ == "__main__":
    main()
