"""Scans and poses of logs, without run folders."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Mapping
from os import PathLike
from typing import Any

from loopboost import _loopboost
from loopboost._errors import ArgumentError
from loopboost._loopboost import Rows
from loopboost._streams import stream_of


def read_scans(
    log: str | PathLike[str] | Iterable[str | PathLike[str]],
    topic: str,
    poses: str | Mapping[str, Any] | None = None,
    deskew: bool = True,
    progress: Callable[[int, int], None] | None = None,
    **lidar: Any,
) -> Rows:
    """The planar scans of a log: one row per scan, with the columns of `Run.scans`.

    log: an MCAP file, or all files of a split drive. The first one gives the drive its name. A file that cannot be read is an
    error. topic: the topic of the lidar.
    poses: the topic of the poses, or a dict with options of `[ingest.pose]`, such as
    `{"wheels": "/wheel_states", "imu": "/imu/data", "track_m": 0.5}`. Only `deskew` needs them: it moves each return to where it
    would be seen from at the time of the scan. Without poses, scans stay as they are.
    progress: called with about how many bytes were read, and those of all files. An exception in it ends the reading.
    lidar: other options of `[ingest.lidar]`, such as `ring=16` or `range_max_m=30.0`.

    `Rows.messages` has the losses and notes, with their codes. docs/tables.md in the repository explains the columns:
    `stamp_ns` [ns since 1970], `x_m` and `y_m` (returns in the frame of the lidar [m]), `coverage_deg` [deg], and others.
    """
    options = _options({"topic": topic, "deskew": deskew, **lidar}, poses)
    return _loopboost.read_scans(_files(log), options, progress)


def read_poses(
    log: str | PathLike[str] | Iterable[str | PathLike[str]],
    topic: str,
    poses: str | Mapping[str, Any],
    **lidar: Any,
) -> Rows:
    """The poses of the lidar: one row per pose, with the columns of `Run.table("poses")`.

    The arguments are those of `read_scans`. A lidar that is not at the origin of the robot needs its `mount`.
    The columns are `stamp_ns` [ns since 1970], `x_m`, `y_m` [m], `heading_rad` [rad], a covariance, and others.
    """
    return _loopboost.read_poses(_files(log), _options({"topic": topic, **lidar}, poses))


def _files(log: str | PathLike[str] | Iterable[str | PathLike[str]]) -> list[str]:
    files = [os.fspath(log)] if isinstance(log, (str, PathLike)) else [os.fspath(file) for file in log]
    if not files:
        raise ArgumentError("`log` has no files")
    return files


def _options(lidar: Mapping[str, Any], poses: str | Mapping[str, Any] | None) -> str:
    pose = {"topic": poses} if isinstance(poses, str) else poses
    try:
        return json.dumps({"lidar": lidar, "pose": None if pose is None else dict(pose)}, default=_plain)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"cannot write the options: {error}") from None


def _plain(value: Any) -> Any:
    """A number or an array of numpy, or a path."""
    return value.tolist() if hasattr(value, "tolist") else os.fspath(value)


def to_tum(poses: Any, file: str | PathLike[str]) -> int:
    """Writes poses as a TUM file, which evo reads: `stamp x y z qx qy qz qw` [s, m]. Returns the number of poses.

    poses: a table of one log with the columns `stamp_ns`, `x_m`, `y_m` and `heading_rad` (64 bit numbers), as from `read_poses`,
    or `Run.table("trajectory", log)`; any object that gives an Arrow stream. Its order is kept. An existing file is replaced, and
    missing folders are made.

    `Run.tum` has the file of the optimized poses of a log.
    """
    return _loopboost.to_tum(stream_of("poses", poses), file)
