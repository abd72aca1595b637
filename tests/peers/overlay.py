"""Reads overlays back with Foxglove's schemas, and compares them with the tables of the run.

usage: overlay.py RUN_FOLDER VIEW_FOLDER

VIEW_FOLDER is the output of `loopboost view RUN_FOLDER`. Every message must parse as the message of its
schema in `foxglove-schemas-protobuf`, without unknown fields. Each row of `closures.parquet` must be one
line, on the topic of accepted or rejected closures of the overlay of its query's log, between the optimized
poses in `trajectory.parquet`, with its evidence and its reason. A rejected closure between two maps, which have
different frames, must have none. There must be no other lines, and one
transform for each scan in `trajectory/LOG.parquet`.
"""

import importlib
import json
import sys
from pathlib import Path

import pyarrow.parquet as pq
from google.protobuf import json_format
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.reader import make_reader

TOPICS = {
    "/loopboost/closures/accepted": "foxglove.SceneUpdate",
    "/loopboost/closures/rejected": "foxglove.SceneUpdate",
    "/loopboost/covariances": "foxglove.SceneUpdate",
    "/loopboost/trajectory/odometry": "foxglove.PosesInFrame",
    "/loopboost/trajectory/scan_matching": "foxglove.PosesInFrame",
    "/loopboost/trajectory/optimized": "foxglove.PosesInFrame",
    "/loopboost/submaps": "foxglove.PointCloud",
    "/loopboost/tf": "foxglove.FrameTransform",
}
NUMBERS = ["confidence", "overlap", "known_overlap", "n_known", "conflict", "margin", "weakness"]
SECOND_NS = 1_000_000_000


def with_times(value, descriptor):
    """The JSON value with times as protobuf writes them: Foxglove's JSON has seconds and nanoseconds."""
    if descriptor.full_name in ("google.protobuf.Timestamp", "google.protobuf.Duration"):
        assert set(value) == {"sec", "nsec"} and 0 <= value["nsec"] < SECOND_NS, value
        if descriptor.name == "Duration":
            return f"{value['sec']}.{value['nsec']:09}s"
        return Timestamp(seconds=value["sec"], nanos=value["nsec"]).ToJsonString()
    converted = {}
    for name, inner in value.items():
        field = descriptor.fields_by_name.get(name)
        if field is None or field.message_type is None:
            converted[name] = inner
        elif isinstance(inner, list):
            converted[name] = [with_times(item, field.message_type) for item in inner]
        else:
            converted[name] = with_times(inner, field.message_type)
    return converted


def parsed(schema, data):
    """A message as an object of Foxglove's schema. An unknown field or a wrong type is an error."""
    name = schema.name.removeprefix("foxglove.")
    message = getattr(importlib.import_module(f"foxglove_schemas_protobuf.{name}_pb2"), name)()
    json_format.ParseDict(with_times(json.loads(data), message.DESCRIPTOR), message)
    return message


def nanoseconds(time):
    return time.seconds * SECOND_NS + time.nanos


def read(path):
    """The messages of each topic with their log times."""
    messages = {topic: [] for topic in TOPICS}
    with open(path, "rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            assert schema.name == TOPICS[channel.topic], (channel.topic, schema.name)
            messages[channel.topic].append((message.log_time, parsed(schema, message.data)))
    return messages


def entities(messages, frames):
    """The entities of a topic by their ids."""
    found = {}
    for log_time, scene in messages:
        for entity in scene.entities:
            assert nanoseconds(entity.timestamp) == log_time, entity.id
            assert entity.frame_id in frames, (entity.id, entity.frame_id)
            assert entity.id not in found, f"two entities {entity.id}"
            found[entity.id] = entity
    return found


def expected_metadata(row):
    name = lambda of: f"{row[f'{of}_log']}, scan {row[f'{of}_scan']}"
    metadata = {"query": name("query"), "reference": name("reference")}
    metadata |= {key: row[key] for key in NUMBERS}
    metadata["degenerate"] = str(row["degenerate"]).lower()
    metadata |= {key: row[key] for key in ("classifier", "reason") if row[key] is not None}
    return metadata


def check_closure(entity, row, poses):
    """Compares a line with a row of `closures.parquet`."""
    [line] = entity.lines
    assert line.type == line.LINE_STRIP, entity.id
    ends = [poses[row[f"{of}_log"], row[f"{of}_scan"]] for of in ("query", "reference")]
    found = [(point.x, point.y, point.z) for point in line.points]
    assert found == [(end["x_m"], end["y_m"], 0.0) for end in ends], f"{entity.id}: {found}, expected {ends}"
    assert {entity.frame_id} == {f"loopboost_map_{end['map']}" for end in ends}, entity.id
    is_green = line.color.r < line.color.g and line.color.b < line.color.g
    assert is_green == row["accepted"] and 0 < line.color.a, f"{entity.id}: {line.color}"
    expected = expected_metadata(row)
    found = {pair.key: pair.value for pair in entity.metadata}
    numeric = {key: float(value) if key in NUMBERS + ["classifier"] else value for key, value in found.items()}
    assert len(found) == len(entity.metadata) and numeric == expected, f"{entity.id}: {found}, expected {expected}"


def is_between_maps(row, poses):
    maps = {poses[row[f"{of}_log"], row[f"{of}_scan"]]["map"] for of in ("query", "reference")}
    return not row["accepted"] and len(maps) == 2


def check(run, path, log, closures, poses):
    messages = read(path)
    frames = {f"loopboost_map_{pose['map']}" for (of_log, _), pose in poses.items() if of_log == log}
    lines = {
        accepted: entities(messages[f"/loopboost/closures/{'accepted' if accepted else 'rejected'}"], frames)
        for accepted in (True, False)
    }
    n = 0
    for number, row in enumerate(closures):
        if row["query_log"] == log and not is_between_maps(row, poses):
            n += 1
            entity = lines[row["accepted"]].pop(f"closure {number}", None)
            assert entity is not None, f"{path}: no line for row {number} of closures.parquet: {row}"
            check_closure(entity, row, poses)
    for of_topic in lines.values():
        assert not of_topic, f"{path}: lines that are not in closures.parquet: {sorted(of_topic)}"
    transforms = [(nanoseconds(t.timestamp), t.translation.x, t.translation.y) for _, t in messages["/loopboost/tf"]]
    scans = pq.read_table(run / "trajectory" / f"{log}.parquet").to_pylist()
    # A segment without a keyframe is in no map.
    segments = {pose["segment"] for (of_log, _), pose in poses.items() if of_log == log}
    scans = [scan for scan in scans if scan.get("segment", 0) in segments]
    expected = [(scan["stamp_ns"], scan["x_m"], scan["y_m"]) for scan in scans]
    assert transforms == expected, f"{path}: {len(transforms)} transforms, expected {len(expected)}"
    return n


def main():
    run, view = map(Path, sys.argv[1:])
    closures = pq.read_table(run / "closures.parquet").to_pylist()
    keyframes = pq.read_table(run / "trajectory.parquet").to_pylist()
    poses = {(row["log"], row["scan"]): row for row in keyframes}
    overlays = {path.parent.name: path for path in view.glob("*/overlay.mcap")}
    logs = {row["log"] for row in keyframes}
    assert set(overlays) == logs, f"overlays of {sorted(overlays)}, expected {sorted(logs)}"
    n = sum(check(run, path, log, closures, poses) for log, path in sorted(overlays.items()))
    n_between = sum(is_between_maps(row, poses) for row in closures)
    assert n + n_between == len(closures), f"{n} lines, expected {len(closures) - n_between}"
    n_accepted = sum(row["accepted"] for row in closures)
    print(f"{len(logs)} overlays show {n_accepted} accepted and {n - n_accepted} rejected closures as in closures.parquet")


if __name__ == "__main__":
    main()
