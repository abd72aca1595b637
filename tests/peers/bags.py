"""Writes the messages of an MCAP log as ROS bags, with the library `rosbags`.

    bags.py LOG.mcap OUT_DIR

A ROS 1 log becomes OUT_DIR/*.bag, one file per compression. A ROS 2 log becomes folders of bags with SQLite storage:
versions 8 (Iron) and 9 (Jazzy) of the description, not packed, packed as a file, and with packed messages.
"""

import sys
from pathlib import Path

import mcap.reader
from rosbags import rosbag1, rosbag2


def reader(log):
    log.seek(0)
    return mcap.reader.make_reader(log)


def connections(log):
    """Topic, type and definition of each channel, by its number."""
    summary = reader(log).get_summary()
    schemas = {number: summary.schemas[channel.schema_id] for number, channel in summary.channels.items()}
    return {
        number: (channel.topic, schemas[number].name, schemas[number].data.decode())
        for number, channel in summary.channels.items()
    }


def fill(bag, log, add):
    """Writes all messages. `add` adds a connection."""
    bag.open()
    known = {number: add(*connection) for number, connection in connections(log).items()}
    for _, channel, message in reader(log).iter_messages():
        bag.write(known[channel.id], message.log_time, message.data)
    bag.close()


def ros1(log, out):
    for compression in [None, *rosbag1.Writer.CompressionFormat]:
        bag = rosbag1.Writer(out / f"{compression.name.lower() if compression else 'none'}.bag")
        if compression:
            bag.set_compression(compression)

        def add(topic, kind, text, bag=bag):
            return bag.add_connection(topic, kind.replace("/", "/msg/"), msgdef=text, md5sum="0" * 32)

        fill(bag, log, add)


def ros2(log, out):
    mode = rosbag2.CompressionMode
    for version, packed in [(8, mode.NONE), (9, mode.NONE), (9, mode.FILE), (9, mode.MESSAGE)]:
        bag = rosbag2.Writer(out / f"{version}-{packed.name.lower()}", version=version)
        if packed != mode.NONE:
            bag.set_compression(packed, rosbag2.CompressionFormat.ZSTD)

        def add(topic, kind, text, bag=bag):
            return bag.add_connection(topic, kind, msgdef=text, rihs01="RIHS01_" + "0" * 64)

        fill(bag, log, add)


if __name__ == "__main__":
    path, out = map(Path, sys.argv[1:])
    out.mkdir(exist_ok=True)
    with path.open("rb") as log:
        is_ros1 = reader(log).get_header().profile == "ros1"
        (ros1 if is_ros1 else ros2)(log, out)
