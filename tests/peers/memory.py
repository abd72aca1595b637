"""Measures the memory that `ingest` and `inspect` need for a large log. The log is temporary.

usage: memory.py LOOPBOOST GIGABYTES [SCRATCH_FOLDER]

The log contains packets of an HDL-32E at 10 Hz in front of a wavy wall, and poses at 20 Hz. It has
uncompressed chunks of 1 MB. The result is the peak resident set size, including the mapped file.
"""

import os
import struct
import subprocess
import sys
import tempfile

import numpy as np
from mcap.writer import CompressionType, Writer

PACKETS, BLOCK_NS, LIMIT_MB = 181, 46_080, 300


def revolution(k):
    """A VelodyneScan (CDR) with the k-th group of 181 packets."""
    n = PACKETS * 12
    block = np.arange(n) + k * n
    azimuth = block * 16589 // 1000 % 36000
    packets = np.zeros(PACKETS, [("sec", "<i4"), ("ns", "<u4"), ("data", "u1", 1206), ("pad", "u1", 2)])
    blocks = np.zeros((PACKETS, 12), [("flag", "<u2"), ("azimuth", "<u2"), ("laser", [("d", "<u2"), ("i", "u1")], 32)])
    blocks["flag"], blocks["azimuth"] = 0xEEFF, azimuth.reshape(PACKETS, 12)
    blocks["laser"]["d"] = (2000 + 500 * np.sin(azimuth / 900)).astype("<u2").reshape(PACKETS, 12, 1)
    packets["data"][:, :1200] = blocks.view("u1").reshape(PACKETS, 1200)
    end_ns = (np.arange(PACKETS) + 1 + k * PACKETS) * (12 * BLOCK_NS)
    clock = np.zeros(PACKETS, [("us", "<u4"), ("mode", "u1"), ("product", "u1")])
    clock["us"], clock["mode"], clock["product"] = end_ns // 1000 % 3_600_000_000, 0x37, 0x21
    packets["data"][:, 1200:] = clock.view("u1").reshape(PACKETS, 6)
    packets["sec"], packets["ns"] = end_ns // 10**9, end_ns % 10**9
    head = b"\0\1\0\0" + struct.pack("<iII", end_ns[-1] // 10**9, end_ns[-1] % 10**9, 2) + b"v\0\0\0"
    return int(end_ns[-1]), head + struct.pack("<I", PACKETS) + packets.tobytes()[:-2]


def pose(ns):
    head = b"\0\1\0\0" + struct.pack("<iII", ns // 10**9, ns % 10**9, 4) + b"map\0"
    return head + struct.pack("<7d", ns * 1e-9, 0, 0, 0, 0, 0, 1)


def write(path, n_bytes):
    with open(path, "wb") as out:
        writer = Writer(out, chunk_size=1 << 20, compression=CompressionType.NONE)
        writer.start("ros2", "memory.py")
        channels = []
        for topic, name in [("/velodyne_packets", "velodyne_msgs/msg/VelodyneScan"), ("/pose", "geometry_msgs/msg/PoseStamped")]:
            schema = writer.register_schema(name, "ros2msg", b"")
            channels.append(writer.register_channel(topic, "cdr", schema))
        k = 0
        while out.tell() < n_bytes:
            ns, data = revolution(k)
            writer.add_message(channels[0], ns, data, ns)
            for at in range(ns // 50_000_000 * 50_000_000, ns + 50_000_000, 50_000_000):
                writer.add_message(channels[1], at, pose(at), at)
            k += 1
        writer.finish()
    return k


def peak_mb(command):
    """Runs a command and returns its peak resident set size [MB]."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    # The poses of two revolutions overlap: the program drops the duplicates and exits with 3.
    assert os.waitstatus_to_exitcode(status) in (0, 3), command
    return usage.ru_maxrss / 1024


def main():
    program, gigabytes = os.path.abspath(sys.argv[1]), float(sys.argv[2])
    with tempfile.TemporaryDirectory(dir=sys.argv[3] if len(sys.argv) > 3 else None) as folder:
        log, pipeline = f"{folder}/large.mcap", f"{folder}/large.toml"
        n_messages = write(log, gigabytes * 1e9)
        with open(pipeline, "w") as out:
            out.write('[ingest]\nlogs = ["large.mcap"]\npose.topic = "/pose"\n')
        print(f"{os.path.getsize(log) / 1e9:.2f} GB, {n_messages} messages with packets")
        for what, command in [
            ("ingest", [program, "ingest", pipeline, "--out", f"{folder}/run"]),
            ("inspect", [program, "inspect", log]),
        ]:
            peak = peak_mb(command)
            print(f"{what}: peak {peak:.0f} MB")
            assert peak < LIMIT_MB, f"expected less than {LIMIT_MB} MB"


main()
