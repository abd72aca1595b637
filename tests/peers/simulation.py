"""Checks a simulated log with the packages `mcap` and `mcap-ros2-support` (PyPI), and prints statistics
of its scans next to those of other logs.

usage: simulation.py LOG.mcap [OTHER.mcap ...]

For the first log the script makes the checks of `mcap doctor`: the header, every CRC, the order of
messages, that chunks, indexes and statistics agree, and that the summary repeats schemas and channels.
It also decodes every message. For each log (ROS 2 encoding) it prints statistics of laser 15.
"""

import collections
import itertools
import struct
import sys

import mcap.data_stream
import mcap.reader
import mcap.records
import mcap.stream_reader
import numpy as np
from mcap_ros2.decoder import DecoderFactory

from street import packets

METRES_PER_COUNT = 0.002


def check(path):
    """Reads a log from start to end and through its indexes, and compares both with its statistics."""
    found = collections.Counter()
    with open(path, "rb") as log:
        last = 0
        for record in mcap.stream_reader.StreamReader(log, validate_crcs=True).records:
            if isinstance(record, mcap.records.Message):
                found[record.channel_id] += 1
                assert last <= record.log_time, "messages are out of order"
                last = record.log_time
    with open(path, "rb") as log:
        header = mcap.reader.make_reader(log).get_header()
        assert header.profile in ("ros1", "ros2") and header.library, header
        log.seek(0)
        reader = mcap.reader.make_reader(log, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        statistics = summary.statistics
        assert statistics.message_count == sum(found.values())
        assert dict(statistics.channel_message_counts) == dict(found)
        assert statistics.chunk_count == len(summary.chunk_indexes)
        assert statistics.message_end_time == last
        for index in summary.chunk_indexes:
            assert index.message_index_offsets, "a chunk has no message index"
            check_chunk(log, index)
        for channel in summary.channels.values():
            assert channel.schema_id in summary.schemas, f"{channel.topic} has no schema"
        assert set(found) == set(summary.channels), "a channel without messages"
        topics = {channel.topic for channel in summary.channels.values()}
        frames, n = set(), 0
        for schema, channel, _, decoded in reader.iter_decoded_messages():
            assert schema.encoding == "ros2msg" and channel.message_encoding == "cdr"
            n += 1
            if channel.topic.startswith("/tf"):
                frames |= {(t.header.frame_id, t.child_frame_id) for t in decoded.transforms}
        assert n == statistics.message_count
    assert topics == {"/velodyne_packets", "/ground_truth", "/imu/data", "/wheel_states", "/tf", "/tf_static"}
    assert frames == {("map", "odom"), ("odom", "base_link"), ("base_link", "velodyne")}
    print(f"{path}: {n} messages in {statistics.chunk_count} chunks, no faults")


def check_chunk(log, index):
    """Compares a chunk with its index."""
    log.seek(index.chunk_start_offset + 1 + 8)
    chunk = mcap.records.Chunk.read(mcap.data_stream.ReadDataStream(log))
    assert chunk.compression == index.compression, (chunk.compression, index.compression)
    assert len(chunk.data) == index.compressed_size
    assert chunk.uncompressed_size == index.uncompressed_size
    messages = [
        record
        for record in mcap.stream_reader.breakup_chunk(chunk, validate_crc=True)
        if isinstance(record, mcap.records.Message)
    ]
    times = [message.log_time for message in messages]
    assert (min(times), max(times)) == (index.message_start_time, index.message_end_time)
    assert (chunk.message_start_time, chunk.message_end_time) == (min(times), max(times))
    assert {message.channel_id for message in messages} == set(index.message_index_offsets)


def statistics(path):
    """Statistics of a ring: name and value."""
    stamps, payloads = zip(*itertools.islice(packets(path), 20_000))
    blocks = np.concatenate([np.frombuffer(p[:1200], np.uint8).reshape(12, 100) for p in payloads])
    azimuth = blocks[:, 2].astype(int) + 256 * blocks[:, 3].astype(int)
    lows, highs = blocks[:, 4::3].astype(int), blocks[:, 5::3].astype(int)
    counts = (lows + 256 * highs)[:, :32]
    clock = np.array([struct.unpack_from("<I", p, 1200)[0] for p in payloads])
    steps = np.diff(azimuth) % 36_000
    mean_step = np.median(steps)
    range_m = counts[:, 15] * METRES_PER_COUNT
    angle = np.deg2rad(azimuth / 100)
    # A straight wall is 1/r = a cos + b sin. The deviation from it in windows of 15 returns.
    deviations = []
    for k in range(0, len(range_m) - 15, 5):
        r, t = range_m[k : k + 15], angle[k : k + 15]
        if (r <= 0).any():
            continue
        design = np.c_[np.cos(t), np.sin(t)]
        fit, *_ = np.linalg.lstsq(design, 1 / r, rcond=None)
        deviations.append((r - 1 / (design @ fit)).std(ddof=2))
    both = (range_m[:-1] > 0) & (range_m[1:] > 0)
    points = np.c_[range_m * np.cos(angle), range_m * np.sin(angle)]
    spacing = np.linalg.norm(np.diff(points, axis=0), axis=1)[both] / range_m[:-1][both]
    # Open space gives wide gaps. Single missing returns are lost on surfaces.
    is_missing = counts[:, 15] == 0
    gaps = [(miss, len(list(run))) for miss, run in itertools.groupby(is_missing)]
    wide = sum(n for miss, n in gaps if miss and 3.0 <= n * mean_step / 100) / len(is_missing)
    host_us = np.median(np.diff(stamps)) / 1000
    return [
        ("returns of laser 15", f"{(range_m > 0).mean():.3f}"),
        ("missing in gaps of 3 deg and more, in smaller ones",
         f"{wide:.3f}, {is_missing.mean() - wide:.3f}"),
        ("returns of the lasers with any returns", f"{(counts > 0)[:, (counts > 0).any(0)].mean():.3f}"),
        ("noise on a flat wall [mm], quartile and median",
         f"{1000 * np.quantile(deviations, 0.25):.1f}, {1000 * np.median(deviations):.1f}"),
        ("point spacing / range [mrad], quartile and median",
         f"{1000 * np.quantile(spacing, 0.25):.2f}, {1000 * np.median(spacing):.2f}"),
        ("azimuth step [0.01 deg], median", f"{mean_step:.0f}"),
        ("steps one less, equal, one more [%]",
         ", ".join(f"{100 * (steps == mean_step + d).mean():.0f}" for d in (-1, 0, 1))),
        ("packet period [us], host and device",
         f"{host_us:.2f}, {np.mean(np.diff(clock) % 3_600_000_000):.2f}"),
    ]


def main():
    check(sys.argv[1])
    tables = [statistics(path) for path in sys.argv[1:]]
    for rows in zip(*tables):
        print(f"{rows[0][0]:<52}" + "".join(f"{value:>18}" for _, value in rows))


if __name__ == "__main__":
    main()
