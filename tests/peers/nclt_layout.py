"""Made sessions in the published layout of the NCLT data set, imported and run with a pipeline.

usage: nclt_layout.py LOOPBOOST PIPELINE OUT_DIR [--partial] [--break NAME]

LOOPBOOST is the program, and PIPELINE is pipelines/nclt.toml. Everything is written into OUT_DIR. The script needs
numpy and pyarrow. It exits with 1 if a check fails. With `--partial`, the sessions start in the middle of a revolution
and have a pause of one second, so that three clouds have only a part of a revolution. `--break` damages the ground
truth, to show that the checks find it.

Two sessions are made: two laps around boxes between walls, and one lap in the opposite direction on another day. The
layout is that of the scripts of the data set (`read_vel_hits.py`, `read_ground_truth.py`, `read_odom.py`,
`read_ms25.py`, `read_gps.py`) and of its paper (Carlevaris-Bianco, Ushani and Eustice, IJRR 35(9), 2016): the archives
`velodyne_data/DATE_vel.tar.gz` and `sensor_data/DATE_sen.tar.gz` with a folder DATE, and
`ground_truth/groundtruth_DATE.csv`. The map has x north, y east, z down, and the body x forward, y right, z down.

The lidar has two beams of an HDL-32E at every firing, the horizontal one and one that sees the ground, and three more
beams at every fourth firing.
"""

import argparse
import json
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

# By day: number of laps, direction, and start [us since the epoch].
SESSIONS = {"2012-01-08": (2.2, 1, 1_326_030_975_726_043), "2012-01-15": (1.2, -1, 1_326_652_407_112_345)}
PAIRS_PER_CLASS = 300

# Pose of the lidar on the body (paper, table 4): x, y, z [m], roll, pitch, heading [deg].
LIDAR_ON_BODY = (0.002, -0.004, -0.957, 0.807, 0.166, -90.703)
AXLE_HEIGHT_M, WALL_HEIGHT_M, RANGE_MAX_M, RANGE_NOISE_M = 0.24, 8.0, 70.0, 0.01
# Elevation of a laser of an upright HDL-32E, in firing order (manual, "Laser angles") [deg].
ELEVATION_DEG = [-92 / 3 + 4 / 3 * (n // 2) if n % 2 == 0 else -28 / 3 + 4 / 3 * (n // 2) for n in range(32)]
BEAMS, SPARSE_BEAMS = (15, 29), (3, 10, 20)
FIRINGS, PER_PACKET, REVOLUTION_S = 180, 12, 0.1
# Without packets in `--partial`: before the start, and during the pause [s].
LATE_START_S, PAUSE_S = 0.063, (50.033, 51.073)

# The loop is a rectangle with round corners: half its size to the north and to the east, and the radius [m].
CENTRE, HALF_NORTH_M, HALF_EAST_M, RADIUS_M = np.array([-120.0, -300.0]), 15.0, 30.0, 6.0
# Boxes: centre to the north and to the east, and half sizes [m]. The first one is the wall around everything.
BOXES = [(2, -1, 29, 47), (1, -17, 7, 5), (-3, 4, 6, 8), (4, 20, 3, 5), (24, 12, 3, 9), (-23, -20, 2, 6),
         (22, -26, 4, 3), (-22, 16, 3, 4), (3, 39, 9, 2), (-6, -40, 5, 2), (26, -8, 1, 4)]


def box(north, east, half_north, half_east):
    """The walls (n1, e1, n2, e2) of a box."""
    corners = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)]) * (half_north, half_east) + (north, east) + CENTRE
    return np.hstack([corners, np.roll(corners, -1, axis=0)])


WALLS = np.vstack([box(*sizes) for sizes in BOXES])


def rotation(roll, pitch, heading):
    """Rz(heading) Ry(pitch) Rx(roll), of angles or arrays of angles [rad]."""
    roll, pitch, heading = np.broadcast_arrays(roll, pitch, heading)
    (cr, sr), (cp, sp), (ch, sh) = [(np.cos(angle), np.sin(angle)) for angle in (roll, pitch, heading)]
    rows = [[ch * cp, ch * sp * sr - sh * cr, ch * sp * cr + sh * sr],
            [sh * cp, sh * sp * sr + ch * cr, sh * sp * cr - ch * sr],
            [-sp, cp * sr, cp * cr]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def angles(matrices):
    """Roll, pitch and heading of rotations [rad]."""
    roll = np.arctan2(matrices[..., 2, 1], matrices[..., 2, 2])
    heading = np.arctan2(matrices[..., 1, 0], matrices[..., 0, 0])
    return np.stack([roll, -np.arcsin(matrices[..., 2, 0]), heading], axis=-1)


class Drive:
    """A drive along the loop, with the slow pitch and roll of a robot that balances on two wheels."""

    def __init__(self, laps, direction):
        turns = np.linspace(0, np.pi / 2, 30)
        corners = [(1, 1, 0), (-1, 1, 1), (-1, -1, 2), (1, -1, 3)]
        inner = np.array([HALF_NORTH_M - RADIUS_M, HALF_EAST_M - RADIUS_M])
        points = [np.array([north, east]) * inner + RADIUS_M * np.array([np.cos(turn), np.sin(turn)])
                  for north, east, quarter in corners for turn in turns + quarter * np.pi / 2]
        points = np.vstack([*points, points[0]])[::direction] + CENTRE
        steps = np.hypot(*np.diff(points, axis=0).T)
        self.points, self.path_m = points, np.concatenate([[0], np.cumsum(steps)])
        times = np.arange(0, 1e4, 0.01)
        distance_m = np.cumsum(1.4 + 0.15 * np.sin(times / 5)) * 0.01
        self.times, self.distance_m = times, distance_m
        self.seconds = times[np.searchsorted(distance_m, laps * self.path_m[-1])]

    def travelled_m(self, seconds):
        return np.interp(seconds, self.times, self.distance_m)

    def position(self, seconds):
        """North and east [m]."""
        at = self.travelled_m(seconds) % self.path_m[-1]
        return np.stack([np.interp(at, self.path_m, self.points[:, k]) for k in (0, 1)], axis=-1)

    def pose(self, seconds):
        """Position (north, east, down) and roll, pitch, heading."""
        ahead, behind = self.position(seconds + 0.05), self.position(seconds - 0.05)
        heading = np.arctan2(*(ahead - behind).T[::-1])
        level = np.hypot(*(ahead - behind).T)
        assert np.all(0 < level)
        roll, pitch = np.radians(0.4) * np.sin(seconds / 0.9), np.radians(1.0) * np.sin(seconds / 0.6)
        down = -3.0 + 0.3 * np.sin(self.travelled_m(seconds) / 27)
        position = np.column_stack([self.position(seconds), down])
        return position, np.column_stack([roll, pitch, heading])


def cast(origins, directions):
    """The distance to the first wall or to the ground along each ray [m]; infinite without a return."""
    first = np.full(len(origins), np.inf)
    ground = origins[:, 2] + AXLE_HEIGHT_M - LIDAR_ON_BODY[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        down = (ground - origins[:, 2]) / directions[:, 2]
        first = np.where(0 < down, down, first)
        for wall in WALLS:
            edge, to_wall = wall[2:] - wall[:2], wall[:2] - origins[:, :2]
            cross = directions[:, 0] * edge[1] - directions[:, 1] * edge[0]
            along = (to_wall[:, 0] * edge[1] - to_wall[:, 1] * edge[0]) / cross
            share = (to_wall[:, 0] * directions[:, 1] - to_wall[:, 1] * directions[:, 0]) / cross
            height = ground - origins[:, 2] - along * directions[:, 2]
            is_hit = (0 <= share) & (share <= 1) & (0.1 < along) & (height <= WALL_HEIGHT_M)
            first = np.where(is_hit & (along < first), along, first)
    return np.where(first < RANGE_MAX_M, first, np.inf)


def beams():
    """Firing, laser and direction in the frame of the lidar of each hit of a revolution. The lidar hangs upside down:
    its x axis points left, y forward and z down. It turns clockwise about its own z axis."""
    fired = [(firing, laser) for firing in range(FIRINGS)
             for laser in sorted(BEAMS + (SPARSE_BEAMS if firing % 4 == 0 else ()))]
    firings, lasers = np.array(fired).T
    azimuth, elevation = np.radians((firings + 0.5) * 360 / FIRINGS), np.radians(np.array(ELEVATION_DEG)[lasers])
    level = np.cos(elevation)
    return firings, lasers, np.column_stack([level * np.sin(azimuth), level * np.cos(azimuth), np.sin(elevation)])


def is_recorded(seconds, partial):
    return not partial or (LATE_START_S <= seconds and not PAUSE_S[0] < seconds < PAUSE_S[1])


def hits_file(drive, start_us, random, partial):
    """The bytes of velodyne_hits.bin, and the number of whole and partial revolutions."""
    firings, lasers, directions = beams()
    packets_per_revolution = FIRINGS // PER_PACKET
    lidar_on_body = rotation(*np.radians(LIDAR_ON_BODY[3:]))
    n_revolutions, out = 0, []
    for revolution in range(int(drive.seconds / REVOLUTION_S)):
        of_packet = (np.arange(packets_per_revolution) / packets_per_revolution + revolution) * REVOLUTION_S
        positions, attitudes = drive.pose(of_packet)
        bodies, packet = rotation(*attitudes.T), firings // PER_PACKET
        origins = (positions + bodies @ LIDAR_ON_BODY[:3])[packet]
        ranges = cast(origins, np.einsum("nij,nj->ni", (bodies @ lidar_on_body)[packet], directions))
        ranges += random.normal(0, RANGE_NOISE_M, len(ranges))
        # The paper: a hit without a return is at the origin of the lidar.
        points = np.where(np.isfinite(ranges), ranges, 0)[:, None] * directions
        hits = np.zeros(len(points), [("position", "<u2", 3), ("intensity", "u1"), ("laser", "u1")])
        hits["position"] = np.round((points + 100) / 0.005)
        hits["intensity"], hits["laser"] = 40, lasers
        recorded = [k for k, seconds in enumerate(of_packet) if is_recorded(seconds, partial)]
        n_revolutions += bool(recorded)
        for k in recorded:
            header = np.zeros(1, [("magic", "<u2", 4), ("n", "<u4"), ("utime", "<u8"), ("padding", "u1", 4)])
            header["magic"], header["n"] = 44444, np.sum(packet == k)
            header["utime"] = start_us + round(of_packet[k] * 1e6)
            out += [header.tobytes(), hits[packet == k].tobytes()]
    return b"".join(out), n_revolutions


def table(seconds, start_us, *columns):
    """The text of a CSV file whose first column is a time in microseconds."""
    utimes = start_us + np.round(seconds * 1e6).astype(np.int64)
    rows = np.column_stack(columns)
    return "".join(f"{utime},{','.join(f'{value:.9g}' for value in row)}\n" for utime, row in zip(utimes, rows))


def relative(from_pose, to_pose):
    """Poses `to` in the frames of the poses `from`."""
    (positions, attitudes), (others, other_attitudes) = from_pose, to_pose
    inverse = np.swapaxes(rotation(*attitudes.T), -1, -2)
    moved = np.einsum("nij,nj->ni", inverse, others - positions)
    return np.column_stack([moved, angles(inverse @ rotation(*other_attitudes.T))])


def sensor_files(drive, start_us):
    """The files of sensor_data/DATE_sen.tar.gz, and the number of rows of the odometry at 100 Hz."""
    rate = lambda hz: np.arange(0, drive.seconds, 1 / hz)
    files = {"README.txt": "wheels.csv: utime, left, right [m/s]\n"}
    # The odometry at 100 Hz is relative to the start of the session, and drifts.
    seconds = rate(100)
    positions, attitudes = drive.pose(seconds)
    start = (positions[:1].repeat(len(seconds), 0), attitudes[:1].repeat(len(seconds), 0))
    drifting = relative(start, (positions, attitudes)) * (1.02, 1.02, 1, 1, 1, 1)
    files["odometry_mu_100hz.csv"] = table(seconds, start_us, drifting)
    n_odometry = len(seconds)
    # The other odometry is relative to the previous image.
    images = rate(5)
    files["odometry_mu.csv"] = table(images[1:], start_us, relative(drive.pose(images[:-1]), drive.pose(images[1:])))
    for name, of in (("odometry_cov_100hz.csv", seconds), ("odometry_cov.csv", images)):
        files[name] = table(of[::500], start_us, np.full((len(of[::500]), 21), 1e-4))

    seconds = rate(47)
    _, attitudes = drive.pose(seconds)
    yaw_rate = np.gradient(np.unwrap(attitudes[:, 2]), seconds)
    level = np.zeros(len(seconds))
    up = -9.81 * np.swapaxes(rotation(*attitudes.T), -1, -2)[:, :, 2]
    magnetic = np.full((len(seconds), 3), (0.2, 0.0, 0.5))
    files["ms25.csv"] = table(seconds, start_us, magnetic, up, level, level, yaw_rate)
    files["ms25_euler.csv"] = table(seconds, start_us, attitudes)

    seconds = rate(95)
    heading = np.unwrap(drive.pose(seconds)[1][:, 2])
    files["kvh.csv"] = table(seconds, start_us, (heading - heading[0]) % (2 * np.pi))
    seconds = rate(45)
    speed = np.gradient(drive.travelled_m(seconds), seconds)
    turn = np.gradient(np.unwrap(drive.pose(seconds)[1][:, 2]), seconds) * 0.25
    files["wheels.csv"] = table(seconds, start_us, speed + turn, speed - turn)

    # Two sentences per fix; the first one has no altitude. Angles are in radians.
    seconds = rate(5)
    north, east = drive.position(seconds).T
    latitude = np.radians(42.293227) + north / 6_350_000
    longitude = np.radians(-83.709657) + east / (6_378_000 * np.cos(np.radians(42.293227)))
    mode = 2 + np.arange(len(seconds)) % 2
    altitude = np.where(mode == 3, 273.0, np.nan)
    fixes = (mode, level[: len(seconds)], latitude, longitude, altitude, level[: len(seconds)], level[: len(seconds)])
    files["gps.csv"] = files["gps_rtk.csv"] = table(seconds, start_us, *fixes)
    files["gps_rtk_err.csv"] = table(seconds, start_us, np.full(len(seconds), 0.1))
    return files, n_odometry


def swap_x_and_y(rows):
    rows[:, [0, 1]] = rows[:, [1, 0]]


def turn_headings(rows):
    rows[:, 5] *= -1


def move_a_lap(rows):
    """The second half of the drive is 3 m beside the path that it repeats."""
    rows[len(rows) // 2 :, 0] += 3.0


BREAKS = {"swap-x-y": swap_x_and_y, "turn-headings": turn_headings, "move-a-lap": move_a_lap}


def ground_truth(drive, start_us, damage):
    """The text of groundtruth_DATE.csv, and the number of its poses. Published files start with a row of NaN."""
    seconds = np.arange(0, drive.seconds, 0.01)
    rows = np.column_stack(drive.pose(seconds))
    if damage:
        BREAKS[damage](rows)
    rows[0] = np.nan
    return table(seconds, start_us, rows), len(rows) - 1


def publish(folder, date, partial, damage):
    """Writes the archives of a session. Returns the drive and the numbers of messages that its files have."""
    laps, direction, start_us = SESSIONS[date]
    drive = Drive(laps, direction)
    session = folder / date
    (session / "velodyne_sync").mkdir(parents=True)
    hits, n_revolutions = hits_file(drive, start_us, np.random.default_rng(start_us), partial)
    (session / "velodyne_hits.bin").write_bytes(hits)
    (session / "velodyne_sync" / f"{start_us}.bin").write_bytes(bytes(80))
    sensors, n_odometry = sensor_files(drive, start_us)
    for name, text in sensors.items():
        (session / name).write_text(text)
    for kind in ("velodyne_data", "sensor_data", "ground_truth"):
        (folder / kind).mkdir(exist_ok=True)
    with tarfile.open(folder / f"velodyne_data/{date}_vel.tar.gz", "w:gz", compresslevel=1) as archive:
        for name in ("velodyne_hits.bin", "velodyne_sync"):
            archive.add(session / name, f"{date}/{name}")
    with tarfile.open(folder / f"sensor_data/{date}_sen.tar.gz", "w:gz", compresslevel=1) as archive:
        for name in sensors:
            archive.add(session / name, f"{date}/{name}")
    truth, n_poses = ground_truth(drive, start_us, damage)
    (folder / f"ground_truth/groundtruth_{date}.csv").write_text(truth)
    shutil.rmtree(session)
    return drive, {"/velodyne_points": n_revolutions, "/ground_truth": n_poses, "/odom": n_odometry}


FAULTS = []


def check(is_right, text):
    print(f"{'ok' if is_right else 'FAILED'}: {text}")
    if not is_right:
        FAULTS.append(text)


def run(*command):
    """Runs a command. Returns its exit code, what it prints, and the codes of its warnings and errors."""
    result = subprocess.run([str(word) for word in command], capture_output=True, text=True)
    codes = [line.split("[")[1].split("]")[0] for line in result.stderr.splitlines()
             if line.startswith(("warning[", "error["))]
    if result.returncode not in (0, 3):
        sys.exit(f"{' '.join(str(word) for word in command)}: exit code {result.returncode}\n{result.stderr}")
    return result.returncode, result.stdout, codes


def import_session(program, published, data, date, expected):
    """Unpacks a session as docs/nclt.md describes, and imports it."""
    data.mkdir(parents=True, exist_ok=True)
    for kind, name in (("velodyne_data", f"{date}_vel"), ("sensor_data", f"{date}_sen")):
        with tarfile.open(published / kind / f"{name}.tar.gz") as archive:
            archive.extractall(data, filter="data")
    shutil.copy(published / f"ground_truth/groundtruth_{date}.csv", data / date)
    code, printed, codes = run(program, "import", data / date, "--out", data / f"{date}.mcap", "--json")
    # The first row of the ground truth is NaN.
    check((code, codes) == (3, ["rows_with_nan"]), f"{date}: exit code {code} and warnings {codes} of import")
    found = {topic["topic"]: topic["n_messages"] for topic in json.loads(printed)["topics"]}
    for topic, n in expected.items():
        check(abs(found.get(topic, 0) - n) <= 1, f"{date}: {found.get(topic)} messages on {topic}, of {n}")


def distance_to_walls(points):
    """The distance of each point (north, east) to the nearest wall [m]."""
    nearest = np.full(len(points), np.inf)
    for wall in WALLS:
        edge = wall[2:] - wall[:2]
        share = np.clip((points - wall[:2]) @ edge / (edge @ edge), 0, 1)
        nearest = np.minimum(nearest, np.hypot(*(points - wall[:2] - share[:, None] * edge).T))
    return nearest


def check_keyframes(out, date, drive):
    """Compares the keyframes of a log with the drive. Returns the true positions (north, east) by scan."""
    start_us = SESSIONS[date][2]
    keyframes = pq.read_table(out / f"keyframes/{date}.parquet").to_pydict()
    seconds = (np.array(keyframes["stamp_ns"]) - start_us * 1000) * 1e-9
    (north, east, _), (_, _, heading) = (columns.T for columns in drive.pose(seconds))
    path_m = drive.travelled_m(drive.seconds)
    # A scan every 0.1 s: the next keyframe is at 0.5 m or up to one scan later.
    step_m = 1.55 * REVOLUTION_S
    least, most = path_m / (0.5 + step_m) - 2, path_m / 0.5 + 1
    check(least <= len(seconds) <= most, f"{date}: {len(seconds)} keyframes on {path_m:.0f} m")
    x_m, y_m, heading_rad = (np.array(keyframes[name]) for name in ("x_m", "y_m", "heading_rad"))
    off_m = np.hypot(x_m - east, y_m - north).max()
    check(off_m < 0.03, f"{date}: keyframes at most {off_m:.3f} m from the drive")
    # Headings are counter-clockwise from east. The lidar is turned by 0.703 deg on the body.
    turned = heading_rad - (np.pi / 2 - heading + np.radians(0.703))
    off_deg = np.degrees(np.abs((turned + np.pi) % (2 * np.pi) - np.pi)).max()
    check(off_deg < 0.5, f"{date}: headings at most {off_deg:.2f} deg from the drive")
    check_scans(out, date, dict(zip(keyframes["scan"], zip(x_m, y_m, heading_rad))))
    return dict(zip(keyframes["scan"], np.column_stack([north, east])))


def check_scans(out, date, poses):
    """The points of the kept scans are on the walls."""
    scans = pq.read_table(out / f"scans/{date}.parquet", columns=["scan", "x_m", "y_m"]).to_pydict()
    off = []
    for scan, x_m, y_m in zip(scans["scan"], scans["x_m"], scans["y_m"]):
        if scan in poses:
            x, y, heading = poses[scan]
            cos, sin = np.cos(heading), np.sin(heading)
            x_m, y_m = np.array(x_m), np.array(y_m)
            off.append(distance_to_walls(np.column_stack([y + sin * x_m + cos * y_m, x + cos * x_m - sin * y_m])))
    off = np.concatenate(off)
    median, high = np.quantile(off, [0.5, 0.95])
    check(median < 0.03 and high < 0.15, f"{date}: points of scans {median:.3f} m (95 %: {high:.3f} m) from the walls")


def check_pairs(out, truth):
    """Compares the labels with the true distances."""
    pairs = pq.read_table(out / "pairs.parquet").to_pydict()
    ends = [np.array([truth[log][scan] for log, scan in zip(pairs[f"{end}_log"], pairs[f"{end}_scan"])])
            for end in ("query", "reference")]
    apart_m = np.hypot(*(ends[0] - ends[1]).T)
    positive = np.array(pairs["label"]) == 1
    counts = positive.sum(), (~positive).sum()
    check(counts == (PAIRS_PER_CLASS, PAIRS_PER_CLASS), f"{counts[0]} positives and {counts[1]} negatives")
    farthest, nearest = apart_m[positive].max(), apart_m[~positive].min()
    check(farthest <= 1.51, f"positives at most {farthest:.2f} m apart")
    check(49.99 < nearest, f"negatives at least {nearest:.2f} m apart")
    between = np.array([a != b for a, b in zip(pairs["query_log"], pairs["reference_log"])])
    check(0 < (between & positive).sum(), f"{(between & positive).sum()} positives between the two days")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("loopboost", type=Path)
    parser.add_argument("pipeline", type=Path)
    parser.add_argument("out_dir", type=Path)
    parser.add_argument("--partial", action="store_true")
    parser.add_argument("--break", dest="damage", choices=sorted(BREAKS))
    options = parser.parse_args()
    published, data, out = (options.out_dir.resolve() / name for name in ("published", "data", "run"))
    for folder in (published, data, out):
        shutil.rmtree(folder, ignore_errors=True)
    drives = {}
    for date in SESSIONS:
        drives[date], expected = publish(published, date, options.partial, options.damage)
        import_session(options.loopboost, published, data, date, expected)
    code, _, codes = run(options.loopboost, "run", options.pipeline, "--out", out,
                         "--set", f'ingest.logs=["{data}/*.mcap"]', "--set", f"label.pairs_per_class={PAIRS_PER_CLASS}")
    # The first pose is a few milliseconds after the first scan.
    expected = [] if options.partial else ["scans_before_poses"]
    check((code, codes) == (3 if expected else 0, expected), f"exit code {code} and warnings {codes} of run")
    truth = {date: check_keyframes(out, date, drive) for date, drive in drives.items()}
    check_pairs(out, truth)
    sys.exit(f"{len(FAULTS)} checks failed" if FAULTS else 0)


if __name__ == "__main__":
    main()
