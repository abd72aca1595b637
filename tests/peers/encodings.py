"""Writes the same measurements in every encoding, with other libraries, and compares what the program
reads with what was written.

usage: encodings.py write DATA FOLDER
       encodings.py compare FOLDER GROUP RUN_FOLDER [RING]

`write` writes FOLDER/<group>/<name>.mcap. The groups `packets` and `lossy` contain the real HDL-32E
capture of DATA. `clouds` contains the point clouds that velodyne-decoder makes from it. `planar` and
`bare` (without schemas) contain real SICK scans and poses. `compare` reads the tables that the program
wrote for the logs of a group, and FOLDER/reference.parquet, the scans of the original capture.
"""

import itertools
import os
import pickle
import shutil
import sys

import numpy as np
import pyarrow.parquet as pq
import velodyne_decoder as vd
from encode import foxglove, header, read, stamp_ns, time, write
from mcap.writer import CompressionType, IndexType

RANGE_MIN_M, RANGE_MAX_M = 0.9, 70.0  # the defaults of [ingest.lidar]
N_COMPLETE = 2  # complete revolutions of the street capture, between two partial ones
PACKETS, CLOUDS, SCANS, POSES = "/velodyne_packets", "/velodyne_points", "/scan", "/pose"
ROS, BIG, OTHERS = ["ros1", "cdr"], "cdr-big-endian", ["protobuf", "json"]  # encodings
SCHEMAS = ["none", "empty", "partial"]  # other than "full"

# Packets ----------------------------------------------------------------------------------------


def street(data):
    """Stamp [ns] and bytes of each packet of the real capture."""
    log = f"{data}/logs/hdl32e-street.ros2.mcap"
    for scan in read(log, PACKETS, "velodyne_msgs/msg/VelodyneScan"):
        yield from ((stamp_ns(packet.stamp), packet.data.tobytes()) for packet in scan.packets)


def velodyne_scans(packets, encoding, n):
    """Messages of `n` packets each. If n is 0, messages of one packet without a header."""
    for group in (packets[k : k + max(n, 1)] for k in range(0, len(packets), max(n, 1))):
        values = [{"stamp": time(ns), "data": np.frombuffer(data, np.uint8)} for ns, data in group]
        ns = group[-1][0]
        if n == 0:
            yield PACKETS, "velodyne_msgs/msg/VelodynePacket", encoding, ns, values[0]
        else:
            values = {"header": header(ns), "packets": values}
            yield PACKETS, "velodyne_msgs/msg/VelodyneScan", encoding, ns, values


NO_SUMMARY = {
    "index_types": IndexType.NONE,
    "repeat_channels": False,
    "repeat_schemas": False,
    "use_statistics": False,
    "use_summary_offsets": False,
}
CONTAINERS = {
    "zstd": {},
    "lz4": {"compression": CompressionType.LZ4},
    "uncompressed": {"compression": CompressionType.NONE},
    "a-chunk-a-message": {"chunk_size": 1},
    "no-chunks": {"use_chunking": False},
    "no-index": {"index_types": IndexType.NONE},
    "no-crc": {"enable_crcs": False, "enable_data_crcs": False},
    "no-summary": NO_SUMMARY,
    "no-chunks-no-summary": {"use_chunking": False} | NO_SUMMARY,
}


def shuffled(packets, random):
    """The packets in the order of arrival if each one is up to 100 ms late."""
    order = np.argsort([ns + random.integers(0, 10**8) for ns, _ in packets])
    return [packets[k] for k in order]


def twice(packets):
    """Repeats every seventh packet two packets later. 500 packets then contain 72 duplicates."""
    return [p for k, p in enumerate(packets) for p in [p] + [packets[k - 2]] * (k % 7 == 2)]


def with_positions(packets):
    """Adds a position packet after every 50th packet, padded to 1206 bytes."""
    sentence = b"$GPRMC,143408,A,3713.4490,N,12159.2900,W,000.0,000.0,280911,014.8,E,A*00\r\n"
    position = (bytes(206) + sentence).ljust(1206, b"\0")
    mixed = []
    for k, (ns, data) in enumerate(packets):
        mixed += [(ns, data)] + [(ns, position)] * (k % 50 == 49)
    return mixed


def write_packets(data, folder):
    packets = list(street(data))
    random = np.random.default_rng(2436)
    os.makedirs(f"{folder}/packets")
    shutil.copy(f"{data}/logs/hdl32e-street.ros2.mcap", f"{folder}/packets/reference.mcap")
    # Group, name, packets, packets per message, schema.
    rows = [("packets", "plain", packets, n, "full") for n in [0, 1, 77, 500]]
    rows += [("packets", "plain", packets, n, of) for n in [0, 77] for of in SCHEMAS]
    for n in [0, 40]:
        rows += [
            ("packets", "shuffled", shuffled(packets, random), n, "full"),
            ("lossy", "twice", twice(packets), n, "full"),
            ("lossy", "positions", with_positions(packets), n, "full"),
            ("lossy", "all", shuffled(twice(with_positions(packets)), random), n, "full"),
        ]
    for (group, name, stream, n, schema), encoding in itertools.product(rows, [*ROS, BIG]):
        log = f"{folder}/{group}/{name}-{n}-{encoding}-schema-{schema}.mcap"
        write(log, velodyne_scans(stream, encoding, n), schema)
    for name, options in CONTAINERS.items():
        write(f"{folder}/packets/{name}.mcap", velodyne_scans(packets, "cdr", 40), **options)
    return packets


# Clouds -----------------------------------------------------------------------------------------


def revolutions(packets):
    """The points of velodyne-decoder for each revolution of ring 23, in firing order: ring, column, x,
    y, z, intensity and time [ns]."""
    decoder = vd.ScanDecoder(vd.Config(min_range=0.0, max_range=1e9))
    azimuths, points = [], []
    for n, (ns, data) in enumerate(packets):
        one = vd.PacketVector()
        one.append(vd.VelodynePacket(ns / 1e9, list(data)))
        of = np.asarray(decoder.decode(one)[1])
        block, ring = of[:, 5].astype(int), of[:, 6].astype(int)
        laser = np.where(ring < 16, 2 * ring, 2 * ring - 31)
        t = ns - 552_960 + 46_080 * block + 1_152 * laser
        points += zip(ring, 12 * n + block, *of[:, :4].T, t)
        azimuths += np.frombuffer(data[:1200], "<u2").reshape(12, 50)[:, 1].tolist()
    kinds = "i4 i4 f4 f4 f4 f4 i8".split()
    points = np.array(points, list(zip("ring column x y z intensity ns".split(), kinds)))
    steps = np.append(np.diff(azimuths) % 36000, 0)
    cuts = np.nonzero(np.diff((azimuths + 15 / 40 * steps) % 36000) < -18000)[0] + 1
    revolution = np.searchsorted(cuts, points["column"], "right")
    return [points[revolution == k] for k in range(len(cuts) + 1)]


def layout(spec):
    """The type of a point, from a text such as "x:f4@0 ... =32". Without offsets and size, the fields
    are packed."""
    *fields, size = (spec if "=" in spec else spec + " =0").split()
    names, formats, offsets, at = [], [], [], 0
    for field in fields:
        name, kind = field.split(":")
        kind, _, offset = kind.partition("@")
        at = int(offset) if offset else at
        names, formats, offsets = names + [name], formats + [kind], offsets + [at]
        at += np.dtype(kind).itemsize
    size = int(size[1:]) or at
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})


# The layout, and the resolution of its times [ns]: up to 0.12 s, or since 1970. None: no times.
LAYOUTS = {
    "velodyne": ("x:f4 y:f4 z:f4 intensity:f4 ring:u2 time:f4", 8),
    "padded": ("x:f4 y:f4 z:f4 intensity:f4@16 ring:u2@20 time:f4@24 =32", 8),
    "nuscenes": ("x:f4 y:f4 z:f4 intensity:f4 ring:f4", None),
    "other-order": ("ring:u2 time:f4 z:f4 intensity:f4 y:f4 x:f4", 8),
    "big-endian": ("x:>f4 y:>f4 z:>f4 intensity:>f4 ring:>u2 time:>f4", 8),
    "ouster": ("x:f4 y:f4 z:f4 intensity:f4@16 t:u4@20 reflectivity:u2@24 ring:u1@26 =48", 0),
    "hesai": ("x:f4 y:f4 z:f4 intensity:f4@16 timestamp:f8@24 ring:u2@32 =48", 256),
    "doubles": ("x:f8 y:f8 z:f8 ring:i4 time:f8", 1),
}


def cloud(revolution, dtype, start_ns):
    """The points in a layout."""
    points = np.zeros(revolution.shape, dtype)
    after_ns = revolution["ns"] - start_ns
    times = {"time": after_ns * 1e-9, "t": after_ns, "timestamp": revolution["ns"] * 1e-9}
    for name in set(dtype.names) - {"reflectivity"}:
        points[name] = times[name] if name in times else revolution[name]
    return points


LASER = np.array([2 * ring if ring < 16 else 2 * ring - 31 for ring in range(32)])  # by ring


def organised(revolution):
    """A grid of rings and firings (32, columns), NaN where there is no return."""
    column = revolution["column"] - revolution["column"].min()
    grid = np.zeros((32, column.max() + 1), revolution.dtype)
    for name in "xyz":
        grid[name] = np.nan
    grid["ring"] = np.arange(32)[:, None]
    first_ns = revolution["ns"][0] - 1_152 * LASER[revolution["ring"][0]]
    grid["ns"] = first_ns + 46_080 * np.arange(grid.shape[1]) + 1_152 * LASER[:, None]
    grid[revolution["ring"], column] = revolution
    return grid


KINDS = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}  # PointField
NUMERIC = {"u1": 1, "i1": 2, "u2": 3, "i2": 4, "u4": 5, "i4": 6, "f4": 7, "f8": 8}  # Foxglove's


def cloud_message(points, start_ns, encoding):
    dtype, step = points.dtype, points.dtype.itemsize
    fields = [(name, *dtype.fields[name][:2]) for name in dtype.names]
    if encoding in ["protobuf", "json"]:
        values = {
            "point_stride": step,
            "fields": [
                {"name": name, "offset": offset, "type": NUMERIC[kind.str[1:]]}
                for name, kind, offset in fields
            ],
            "data": points.tobytes(),
        }
        return CLOUDS, "foxglove.PointCloud", encoding, start_ns, foxglove(start_ns) | values
    height, width = points.shape if points.ndim == 2 else (1, len(points))
    values = {
        "header": header(start_ns),
        "height": height,
        "width": width,
        "fields": [
            {"name": name, "offset": offset, "datatype": KINDS[kind.str[1:]], "count": 1}
            for name, kind, offset in fields
        ],
        "is_bigendian": any(kind.str[0] == ">" for _, kind, _ in fields),
        "point_step": step,
        "row_step": step * width,
        "data": np.frombuffer(points.tobytes(), np.uint8),
        "is_dense": points.ndim == 1,
    }
    return CLOUDS, "sensor_msgs/msg/PointCloud2", encoding, start_ns, values


def scan_of(revolution, ring):
    """The scan of a ring: the stamp of its first point [ns], x and y [m]."""
    of_ring = revolution.reshape(-1)[revolution.reshape(-1)["ring"] == ring]
    x, y, z = (of_ring[name].astype(float) for name in "xyz")
    range_m = np.sqrt(x * x + y * y + z * z).astype("f4")
    keep = (range_m >= np.float32(RANGE_MIN_M)) & (range_m <= np.float32(RANGE_MAX_M))
    return {"ns": of_ring["ns"][0], "x": of_ring["x"][keep], "y": of_ring["y"][keep]}


def write_clouds(packets, folder, expected):
    parts = revolutions(packets)
    rows = [(of, "", encoding, "full") for of in LAYOUTS for encoding in ROS]
    rows += [(of, "", encoding, "full") for of in ["velodyne", "nuscenes"] for encoding in OTHERS]
    rows += [("velodyne", "", encoding, "none") for encoding in OTHERS]
    for encoding in ROS:
        rows += [("velodyne", "-stamped-at-end", encoding, "full")]
        rows += [("padded", order, encoding, "full") for order in ["-by-ring", "-by-firing"]]
        rows += [("velodyne", "", encoding, schema) for schema in SCHEMAS]
    for of, order, encoding, schema in rows:
        spec, error_ns = LAYOUTS[of]
        messages, scans = [], {16: [], 23: []}
        for revolution in parts:
            if order == "-by-ring":
                revolution = organised(revolution)
            elif order == "-by-firing":
                revolution = organised(revolution)[np.argsort(LASER)].T
            stamps = revolution["ns"]
            start_ns = int(stamps.max() if order == "-stamped-at-end" else stamps.min())
            points = cloud(revolution, layout(spec), start_ns)
            messages.append(cloud_message(points, start_ns, encoding))
            for ring, of_ring in scans.items():
                scan = scan_of(revolution, ring)
                ns = start_ns if error_ns is None else scan["ns"]
                of_ring.append(scan | {"ns": ns, "error_ns": error_ns or 0})
        log = f"{of}{order}-{encoding}-schema-{schema}"
        write(f"{folder}/clouds/{log}.mcap", messages, schema)
        expected[log] = scans


# Planar scans and poses -------------------------------------------------------------------------


def sick(data):
    """Forty real scans each of 180, 361 and 181 beams (every other beam of 361), with every reading
    that is not a return: stamp, angle_min, angle_increment, range_min, range_max, ranges."""
    random = np.random.default_rng(2436)
    scans = []
    for name, every in [("mit-killian", 1), ("mit-csail", 1), ("mit-csail", 2)]:
        log = read(f"{data}/logs/{name}.mcap", SCANS, "sensor_msgs/msg/LaserScan")
        for scan, _ in zip(log, range(40)):
            low, high = np.float32(scan.range_min), np.float32(scan.range_max)
            odd = [np.nan, np.inf, -np.inf, 0.0, high, np.nextafter(high, low), low, 0.01]
            ranges = scan.ranges[::every].copy()
            ranges[random.choice(len(ranges), len(odd), replace=False)] = odd
            angle, increment = scan.angle_min, scan.angle_increment * every
            ns = 10**18 + 10**8 * len(scans)
            scans.append((ns, np.float32(angle), np.float32(increment), low, high, ranges))
    return scans


def scan_message(scan, encoding):
    ns, angle_min, increment, low, high, ranges = scan
    n_steps = len(ranges) - 1
    if encoding in OTHERS:
        # The message has no range limits: readings outside the scanner's limits become NaN.
        is_reading = np.isinf(ranges) | (ranges == 0) | (low <= ranges) & (ranges < high)
        values = {
            "start_angle": float(angle_min),
            "end_angle": float(angle_min) + float(increment) * n_steps,
            "ranges": np.where(is_reading, ranges.astype(float), np.nan).tolist(),
        }
        return SCANS, "foxglove.LaserScan", encoding, ns, foxglove(ns) | values
    values = {
        "header": header(ns),
        "angle_min": angle_min,
        "angle_max": angle_min + increment * np.float32(n_steps),
        "angle_increment": increment,
        "range_min": low,
        "range_max": high,
        "ranges": ranges,
        "intensities": [],
    }
    return SCANS, "sensor_msgs/msg/LaserScan", encoding, ns, values


def planar_scan(scan):
    """The scan by the definition of sensor_msgs/LaserScan. A reading at the maximum is not a return."""
    ns, angle_min, increment, low, high, ranges = scan
    angles = float(angle_min) + float(increment) * np.arange(len(ranges))
    keep = (ranges >= max(low, np.float32(RANGE_MIN_M))) & (ranges < high) & (ranges <= RANGE_MAX_M)
    x, y = (ranges[keep].astype(float) * of(angles[keep]) for of in (np.cos, np.sin))
    swept_deg = np.degrees(float(increment) * (len(ranges) - 1))
    return {"ns": ns, "x": x.astype("f4"), "y": y.astype("f4"), "coverage_deg": swept_deg}


def real_poses(data, scans):
    """Real positions and headings, with pitch and roll of up to 15 deg: stamp, position, quaternion,
    heading."""
    random = np.random.default_rng(1)
    log = read(f"{data}/logs/mit-killian.mcap", POSES, "geometry_msgs/msg/PoseStamped")
    poses = []
    for (ns, *_), message in zip(scans, log):
        p, q = message.pose.position, message.pose.orientation
        yaw = 2 * np.arctan2(q.z, q.w)
        angles = np.array([yaw, *random.uniform(-0.26, 0.26, 2)]) / 2
        (cy, cp, cr), (sy, sp, sr) = np.cos(angles), np.sin(angles)
        x, y = sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy
        z, w = cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy
        poses.append((ns + 5, (p.x, p.y, p.z), (x, y, z, w), yaw))
    return poses


def pose_message(pose, name, encoding):
    ns, position, quaternion, _ = pose
    position, quaternion = (dict(zip("xyzw", map(float, of))) for of in (position, quaternion))
    pose = {"position": position, "orientation": quaternion}
    if name == "foxglove.PoseInFrame":
        return POSES, name, encoding, ns, foxglove(ns, pose)
    if not name.endswith("/PoseStamped"):
        pose = {"pose": pose, "covariance": [0.01] * 36}
    return POSES, name, encoding, ns, {"header": header(ns), "child_frame_id": "base", "pose": pose}


def write_planar(data, folder, expected):
    scans = sick(data)
    poses = real_poses(data, scans)
    stamped = "geometry_msgs/msg/PoseStamped"
    of_ros = [stamped, "geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/Odometry"]
    rows = [("planar", encoding, name, "full") for encoding in [*ROS, BIG] for name in of_ros]
    for encoding in OTHERS:
        rows += [("planar", encoding, "foxglove.PoseInFrame", "full")]
        rows += [("bare", encoding, "foxglove.PoseInFrame", "none")]
    for encoding in ROS:
        rows += [("planar", encoding, stamped, schema) for schema in ["empty", "partial"]]
        rows += [("bare", encoding, name, "none") for name in of_ros]
    for group, encoding, name, schema in rows:
        messages = [scan_message(scan, encoding) for scan in scans]
        messages += [pose_message(pose, name, encoding) for pose in poses]
        messages.sort(key=lambda message: message[3])
        log = f"{name.split('/')[-1]}-{encoding}-schema-{schema}"
        write(f"{folder}/{group}/{log}.mcap", messages, schema)
        expected[log] = {"scans": [planar_scan(scan) for scan in scans], "poses": poses}


# Comparison -------------------------------------------------------------------------------------


def rows_of(table):
    rows = pq.read_table(table).to_pylist()
    return [{key: value for key, value in row.items() if key != "log"} for row in rows]


def difference_m(row, scan):
    """Largest difference of a coordinate [m]."""
    assert len(row["x_m"]) == len(scan["x"]), (len(row["x_m"]), len(scan["x"]))
    found = np.array([row["x_m"], row["y_m"]])
    return np.abs(found - [scan["x"], scan["y"]]).max()


def compare_clouds(log, rows, scans):
    """The points of the ring must be exactly those written, in order. The capture starts at 222.5 deg."""
    assert len(rows) == N_COMPLETE + 2, log
    for k, (row, scan) in enumerate(zip(rows, scans)):
        late_ns = row["stamp_ns"] - scan["ns"]
        assert abs(late_ns) <= scan["error_ns"], (log, k, late_ns)
        is_complete = 0 < k <= N_COMPLETE
        assert (row["coverage_deg"] > 355) == is_complete, (log, k, row["coverage_deg"])
        assert difference_m(row, scan) == 0, (log, k)
    assert abs(rows[0]["coverage_deg"] - 137.5) < 1, (log, rows[0]["coverage_deg"])


def compare_planar(log, rows, expected):
    """Coordinates must agree with the definition within the last bit of an f32."""
    assert len(rows) == len(expected), log
    for row, scan in zip(rows, expected):
        assert row["stamp_ns"] == scan["ns"], log
        assert abs(row["coverage_deg"] - scan["coverage_deg"]) < 1e-4, log
    worst = max(difference_m(row, scan) for row, scan in zip(rows, expected))
    assert worst < 4e-6, (log, worst)
    return worst


def compare_poses(log, rows, poses):
    assert len(rows) == len(poses), log
    for row, (ns, (x, y, _), _, yaw) in zip(rows, poses):
        assert (row["stamp_ns"], row["x_m"], row["y_m"]) == (ns, x, y), (log, row, x, y)
        error_rad = (row["heading_rad"] - yaw + np.pi) % (2 * np.pi) - np.pi
        assert abs(error_rad) < 1e-12, (log, error_rad)


def compare(folder, group, run, ring=23):
    with open(f"{folder}/expected.pickle", "rb") as file:
        expected = pickle.load(file)
    reference = rows_of(f"{folder}/reference.parquet")
    logs = sorted(name.removesuffix(".mcap") for name in os.listdir(f"{folder}/{group}"))
    worst = 0.0
    for log in logs:
        rows = rows_of(f"{run}/scans/{log}.parquet")
        if group in ["packets", "lossy"]:
            assert rows == reference and len(rows) == N_COMPLETE, log
        elif group == "clouds":
            compare_clouds(log, rows, expected[log][int(ring)])
        else:
            worst = max(worst, compare_planar(log, rows, expected[log]["scans"]))
            compare_poses(log, rows_of(f"{run}/poses/{log}.parquet"), expected[log]["poses"])
    if group == "clouds" and int(ring) == 23:
        # velodyne-decoder rounds azimuths to 0.01 deg: at 70 m, half of that is 6.1 mm.
        clouds = expected["velodyne-cdr-schema-full"][23][1 : 1 + N_COMPLETE]
        largest_m = max(difference_m(row, scan) for row, scan in zip(reference, clouds))
        print(f"scans of packets and of velodyne-decoder differ by up to {largest_m * 1000:.2f} mm")
        assert largest_m < 0.01
    print(f"{group}: {len(logs)} logs agree, coordinates to {worst * 1e6:.3f} um")


def main():
    if sys.argv[1] != "write":
        return compare(*sys.argv[2:])
    data, folder = sys.argv[2:]
    expected = {}
    packets = write_packets(data, folder)
    write_clouds(packets, folder, expected)
    write_planar(data, folder, expected)
    with open(f"{folder}/expected.pickle", "wb") as file:
        pickle.dump(expected, file)


main()
