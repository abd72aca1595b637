"""Compares the errors of trajectories in a run folder with those of evo.

usage: trajectories.py RUN_FOLDER

Reads `evaluation/trajectories/*/*.tum` and `evaluation/summary.json`. For each drive with ground truth
and each source of poses: the absolute error after alignment (`evo_ape tum truth.tum X.tum --align`) and
the relative errors over 1 to 50 m (`evo_rpe ... --delta_unit m --all_pairs --pairs_from_reference`).
"""

import json
import pathlib
import sys

import numpy as np
from evo.core import metrics, sync
from evo.core.units import Unit
from evo.tools import file_interface

# A stamp in seconds since 1970 has a resolution of 2.4e-7 s as a float. Scans are 1e-3 s apart or more.
SAME_STAMP_SECS = 1e-5
# The files have 9 decimals [m], and 12 of the quaternion.
MOST_M, MOST_DEG = 1e-6, 1e-6

folder = pathlib.Path(sys.argv[1])
drives = json.load(open(folder / "evaluation/summary.json"))["detection"]


def read(drive, name):
    of_drive = f"{drive['log']}-{drive['segment']}"
    return file_interface.read_tum_trajectory_file(folder / "evaluation/trajectories" / of_drive / f"{name}.tum")


def statistics(relation, pair, **options):
    metric = (metrics.RPE if options else metrics.APE)(relation, **options)
    metric.process_data(pair)
    return metric.error


def close(found, expected, most, what):
    assert abs(found - expected) <= most, f"{what}: {found}, evo has {expected}"
    return abs(found - expected)


n, worst = 0, 0.0
for drive in drives:
    if drive["truth"] is None:
        continue
    truth = read(drive, "truth")
    for row in drive["truth"]["trajectories"]:
        what = f"{drive['log']}, segment {drive['segment']}, {row['source']}"
        reference, estimate = sync.associate_trajectories(truth, read(drive, row["source"]), max_diff=SAME_STAMP_SECS)
        assert reference.num_poses == row["n_poses"], f"{what}: {row['n_poses']} poses, evo has {reference.num_poses}"
        for drift in row["drift"]:
            options = dict(delta=drift["path_m"], delta_unit=Unit.meters, all_pairs=True, pairs_from_reference=True)
            pair = (reference, estimate)
            metres = statistics(metrics.PoseRelation.translation_part, pair, **options)
            degrees = statistics(metrics.PoseRelation.rotation_angle_deg, pair, **options)
            here = f"{what}, over {drift['path_m']} m"
            assert len(metres) == drift["n_pairs"], f"{here}: {drift['n_pairs']} pairs, evo has {len(metres)}"
            worst = max(
                worst,
                close(drift["rmse_m"], np.sqrt(np.mean(metres**2)), MOST_M, here),
                close(drift["median_m"], np.median(metres), MOST_M, here),
                close(np.degrees(drift["rmse_rad"]), np.sqrt(np.mean(degrees**2)), MOST_DEG, here),
                close(np.degrees(drift["median_rad"]), np.median(degrees), MOST_DEG, here),
            )
            n += 4
        estimate.align(reference)
        metres = statistics(metrics.PoseRelation.translation_part, (reference, estimate))
        worst = max(worst, close(row["ate_rmse_m"], np.sqrt(np.mean(metres**2)), MOST_M, f"{what}, ATE"))
        n += 1
assert n > 0, f"{folder}: no drive with ground truth"
print(f"{n} errors of trajectories agree with evo, the largest difference is {worst:.1e}")
