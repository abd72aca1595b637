"""Compares a scans table with `velodyne-decoder` (PyPI), return by return.

usage: street.py LOG.mcap SCANS.parquet

The table must contain exactly the returns of ring 23 (laser 15 in firing order) that velodyne-decoder
gives for each revolution, in the same order. Ranges must agree within 5 mm and azimuths within 0.02
deg.
"""

import struct
import sys

import mcap.reader
import numpy as np
import pyarrow.parquet as pq
import velodyne_decoder as vd

RANGE_MIN_M, RANGE_MAX_M = 0.9, 70.0  # the defaults of [ingest.lidar]


def packet_starts(data):
    """Where each packet starts in a VelodyneScan in CDR: its stamp, and 8 bytes later its data."""
    (frame_id,) = struct.unpack_from("<I", data, 12)
    at = 4 + (12 + frame_id + 3) // 4 * 4
    (count,) = struct.unpack_from("<I", data, at)
    return range(at + 4, at + 4 + count * 1216, 1216)


def packets(path):
    """Stamp [ns] and bytes of each packet of a log with VelodyneScan messages in CDR."""
    with open(path, "rb") as log:
        reader = mcap.reader.make_reader(log)
        for _, _, message in reader.iter_messages(topics=["/velodyne_packets"]):
            data = message.data
            for start in packet_starts(data):
                sec, nanosec = struct.unpack_from("<iI", data, start)
                yield sec * 1_000_000_000 + nanosec, data[start + 8 : start + 8 + 1206]


def reference(log):
    """Firing times [ns], azimuths [deg], and the returns: firing, azimuth [deg], range [m]."""
    decoder = vd.ScanDecoder(vd.Config(min_range=0.0, max_range=1e9))
    times, azimuths, firing, azimuth, range_m = [], [], [], [], []
    for n, (stamp, data) in enumerate(packets(log)):
        one = vd.PacketVector()
        one.append(vd.VelodynePacket(stamp / 1e9, list(data)))
        points = np.asarray(decoder.decode(one)[1], float)
        ring = points[points[:, 6] == 23]
        firing.append(12 * n + ring[:, 5].astype(int))  # this column is the block
        azimuth.append(np.rad2deg(np.arctan2(-ring[:, 1], ring[:, 0])) % 360)
        range_m.append(np.linalg.norm(ring[:, :3], axis=1))
        azimuths += [struct.unpack_from("<H", data, 100 * block + 2)[0] for block in range(12)]
        times += [stamp - 552_960 + 46_080 * block + 17_280 for block in range(12)]
    raw = np.array(azimuths)
    steps = np.append(np.diff(raw) % 36000, 0)
    at_laser = (raw + 15 / 40 * steps) % 36000 / 100
    return np.array(times), at_laser, *map(np.concatenate, (firing, azimuth, range_m))


def main():
    times, at_laser, firing, azimuth, range_m = reference(sys.argv[1])
    counts = np.round(range_m / 0.002)
    keep = (counts >= RANGE_MIN_M / 0.002) & (counts <= RANGE_MAX_M / 0.002)
    cuts = np.nonzero(np.diff(at_laser) < -180)[0] + 1
    scans = pq.read_table(sys.argv[2]).to_pylist()
    assert len(scans) == len(cuts) - 1, f"{len(scans)} scans, {len(cuts)} cuts"
    for scan, first, end in zip(scans, cuts, cuts[1:]):
        assert scan["stamp_ns"] == times[first], (scan["stamp_ns"], times[first])
        of_revolution = keep & (firing >= first) & (firing < end)
        x, y = np.array(scan["x_m"]), np.array(scan["y_m"])
        assert len(x) == of_revolution.sum(), (len(x), of_revolution.sum())
        azimuth_error = np.rad2deg(np.arctan2(-y, x)) - azimuth[of_revolution]
        azimuth_error = np.abs((azimuth_error + 180) % 360 - 180).max()
        range_error = np.abs(np.hypot(x, y) - range_m[of_revolution]).max()
        print(f"scan {scan['scan']}: {len(x)} returns, {azimuth_error:.4f} deg, {range_error * 1000:.4f} mm")
        assert azimuth_error <= 0.02 and range_error <= 0.005


if __name__ == "__main__":
    main()
