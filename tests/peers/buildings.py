"""Drives through simulated buildings with repeated structure, as LaserScan logs with odometry that drifts.

`/scan` has the scans, `/odom` the odometry, and `/pose` the true pose at each scan. Walls are segments
(x1, y1, x2, y2) in metres. A wall of a corridor has rooms behind it, of random widths and depths, with open
doors. The functions with the name of a building return its walls and the corners of a path.
"""

import numpy as np
from detection import drifted
from encode import header, pose_values, write

CORRIDOR_M = 2.4
DOOR_M = 1.0
RANGE_NOISE_M = 0.01
RANGE_MAX_M = 30.0
STEP_M, STEP_RAD = 0.1, np.radians(4.0)
SCAN_NS = 200_000_000
START_NS = 1_000_000_000_000_000_000
# Beams: number, first angle, and the angle between two beams.
SCANNERS = {"half": (181, -np.pi / 2, np.radians(1.0)), "full": (720, -np.pi, np.radians(0.5))}


def rooms(start, end, random, depth_m=(2.0, 5.0)):
    """A wall from start to end. Its rooms are on the right."""
    start, end = np.array(start, float), np.array(end, float)
    length_m = np.hypot(*(end - start))
    along = (end - start) / length_m
    away = np.array([along[1], -along[0]])
    corners, at = [start], 0.0
    while True:
        width_m, depth = random.uniform(2.5, 5.0), random.uniform(*depth_m)
        if length_m < at + width_m + 0.2:
            break
        door = at + random.uniform(0.3, width_m - DOOR_M - 0.3)
        # Along the wall to the door, around the room, and back to the other side of the door.
        outline = [(door, 0), (door, 0.15), (at, 0.15), (at, depth), (at + width_m, depth)]
        outline += [(at + width_m, 0.15), (door + DOOR_M, 0.15), (door + DOOR_M, 0)]
        corners += [start + s * along + d * away for s, d in outline]
        at += width_m + 0.2
    return polyline([*corners, end])


def polyline(corners):
    """The walls between successive corners."""
    corners = np.array(corners, float)
    return np.hstack([corners[:-1], corners[1:]])


def symmetric_ring(path_m):
    """A ring of 40 x 24 m that equals itself turned by 180 deg. One lap is 128 m."""
    random = np.random.default_rng(2436)
    outer_x, outer_y = 20 + CORRIDOR_M / 2, 12 + CORRIDOR_M / 2
    inner_x, inner_y = 20 - CORRIDOR_M / 2, 12 - CORRIDOR_M / 2
    # Rooms inside stay away from the corners, so that those of two sides do not overlap.
    room_x, room_y = inner_x - 5.5, inner_y - 5.5
    half = [
        rooms((-outer_x, -outer_y), (outer_x, -outer_y), random),
        rooms((outer_x, -outer_y), (outer_x, outer_y), random),
        rooms((room_x, -inner_y), (-room_x, -inner_y), random),
        rooms((inner_x, room_y), (inner_x, -room_y), random),
        polyline([(room_x, -inner_y), (inner_x, -inner_y), (inner_x, -room_y)]),
        polyline([(inner_x, room_y), (inner_x, inner_y), (room_x, inner_y)]),
    ]
    half = np.vstack(half)
    lap = [(20, -12), (20, 12), (-20, 12), (-20, -12), (0, -12)]
    return np.vstack([half, -half]), shortened([(0, -12), *lap, *lap], path_m)


def shortened(corners, length_m):
    """The first metres of a path."""
    kept = [np.array(corners[0], float)]
    for corner in corners[1:]:
        step = np.array(corner) - kept[-1]
        step_m = np.hypot(*step)
        if length_m <= step_m:
            return [*kept, kept[-1] + step * length_m / step_m]
        kept.append(kept[-1] + step)
        length_m -= step_m
    return kept


def wing(random, length_m, depth_m=(2.0, 5.0)):
    """A corridor along x, from 0, with rooms on both sides."""
    side = CORRIDOR_M / 2
    right = rooms((0, -side), (length_m, -side), random, depth_m)
    return np.vstack([right, rooms((length_m, side), (0, side), random, depth_m)])


def wings_in_line():
    """One corridor of 84 m. The last 24 m equal the first ones; those between have other rooms."""
    random = np.random.default_rng(2436)
    copy, between = wing(random, 24.0), wing(random, 36.0)
    side = CORRIDOR_M / 2
    ends = np.array([[0, -side, 0, side], [84, -side, 84, side]], float)
    walls = [copy, between + [24, 0, 24, 0], copy + [60, 0, 60, 0], ends]
    return np.vstack(walls), [(1.5, 0), (82.5, 0)]


def wings_side_by_side():
    """Two equal wings of 24 m, 10 m apart, on the same side of a corridor. The drive visits one after the
    other, and returns from the first one the way it came."""
    random = np.random.default_rng(2436)
    side = CORRIDOR_M / 2
    along_x = wing(random, 24.0, (2.0, 3.3))
    # Turned by 90 deg: (x, y) -> (-y, x).
    copy = np.column_stack([-along_x[:, 1], along_x[:, 0], -along_x[:, 3], along_x[:, 2]]) + [0, side, 0, side]
    copy = np.vstack([copy, [[-side, 24 + side, side, 24 + side]]])
    corridor = [
        rooms((-8, -side), (18, -side), random),
        polyline([(-side, side), (-8, side), (-8, -side)]),
        polyline([(side, side), (10 - side, side)]),
        polyline([(10 + side, side), (18, side), (18, -side)]),
    ]
    path = [(-6, 0), (0, 0), (0, 22), (0, 0), (10, 0), (10, 22)]
    return np.vstack([copy, copy + [10, 0, 10, 0], *corridor]), path


def drive(corners):
    """Poses along a path: straight on, and turning on the spot at its corners."""
    corners = np.array(corners, float)
    legs = np.diff(corners, axis=0)
    headings = np.arctan2(legs[:, 1], legs[:, 0])
    poses = []
    for k, (start, leg, heading) in enumerate(zip(corners, legs, headings)):
        if k:
            turn = (heading - headings[k - 1] + np.pi) % (2 * np.pi) - np.pi
            n = int(np.ceil(abs(turn) / STEP_RAD))
            poses += [(*start, headings[k - 1] + turn * step / n) for step in range(1, n)]
        n = int(np.ceil(np.hypot(*leg) / STEP_M))
        poses += [(*(start + leg * step / n), heading) for step in range(n)]
    return np.array(poses)


def ranges(walls, pose, angles):
    """Distance to the nearest wall along each beam; infinite without one."""
    x, y, heading = pose
    beam_x, beam_y = np.cos(heading + angles)[:, None], np.sin(heading + angles)[:, None]
    to_x, to_y = walls[:, 0] - x, walls[:, 1] - y
    wall_x, wall_y = walls[:, 2] - walls[:, 0], walls[:, 3] - walls[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        cross = beam_x * wall_y - beam_y * wall_x
        distance = (to_x * wall_y - to_y * wall_x) / cross
        share = (to_x * beam_y - to_y * beam_x) / cross
        hit = (distance > 0) & (share >= 0) & (share <= 1)
    return np.where(hit, distance, np.inf).min(axis=1)


def write_drive(path, building, scanner, seed=2436):
    """Writes the log of a drive through a building. The seed is that of the noise of the ranges."""
    walls, corners = building
    n_beams, first_rad, step_rad = SCANNERS[scanner]
    angles = first_rad + step_rad * np.arange(n_beams)
    random = np.random.default_rng(seed)
    poses = drive(corners)
    messages = []
    for k, (pose, odometry) in enumerate(zip(poses, np.column_stack(drifted(*poses.T)))):
        ns = START_NS + k * SCAN_NS
        measured = ranges(walls, pose, angles) + RANGE_NOISE_M * random.standard_normal(n_beams)
        scan = {
            "header": header(ns),
            "angle_min": first_rad,
            "angle_max": angles[-1],
            "angle_increment": step_rad,
            "range_min": 0.05,
            "range_max": RANGE_MAX_M,
            "ranges": measured,
        }
        odom = {"header": header(ns), "pose": {"pose": pose_values(*odometry)}, "child_frame_id": "base_link"}
        truth = {"header": header(ns), "pose": pose_values(*pose)}
        messages += [
            ("/odom", "nav_msgs/msg/Odometry", "cdr", ns, odom),
            ("/scan", "sensor_msgs/msg/LaserScan", "cdr", ns, scan),
            ("/pose", "geometry_msgs/msg/PoseStamped", "cdr", ns, truth),
        ]
    write(path, messages)
