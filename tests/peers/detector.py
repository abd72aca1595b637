"""Fits the detector of a run folder a second time, with numpy and scipy, and compares.

usage: detector.py RUN_FOLDER

The folder is that of `loopboost run` with `[detect]` and `evaluate.truth`. The script judges the
candidates by the ground truth, fits the verifier without the classifier by L-BFGS-B with bounds on the
signs, and the error of closures by the simplex method. The ground truth must be dense: its poses are
interpolated.
"""

import json
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from scipy.optimize import minimize
from scipy.stats import chi2

PENALTY = 1e-3
# The values that candidates are found with, from `Detector::starting_values`.
START_STD = np.array([0.12, 0.12, np.radians(2.0)])
MAX_GAP_NS = 250_000_000


def wrap(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


def pose_at(table, stamp):
    """Interpolated pose, segment and frame, or None."""
    stamps = table["stamp_ns"]
    after = np.searchsorted(stamps, stamp)
    if after == len(stamps):
        return None
    if stamps[after] == stamp:
        return table["pose"][after], table["frame"][after]
    if after == 0 or MAX_GAP_NS < stamps[after] - stamps[after - 1]:
        return None
    if table["segment"][after] != table["segment"][after - 1]:
        return None
    share = (stamp - stamps[after - 1]) / (stamps[after] - stamps[after - 1])
    a, b = table["pose"][after - 1], table["pose"][after]
    step = b - a
    step[2] = wrap(step[2])
    return a + share * step, table["frame"][after]


def relative(a, b):
    dx, dy = b[0] - a[0], b[1] - a[1]
    cos, sin = np.cos(a[2]), np.sin(a[2])
    return np.array([cos * dx + sin * dy, cos * dy - sin * dx, wrap(b[2] - a[2])])


def read_truth(path):
    table = pq.read_table(path)
    column = lambda name: table[name].to_numpy()
    zeros = np.zeros(table.num_rows, int)
    optional = lambda name: column(name) if name in table.column_names else zeros
    return {
        "stamp_ns": column("stamp_ns"),
        "pose": np.stack([column(name) for name in ("x_m", "y_m", "heading_rad")], 1),
        "segment": optional("segment"),
        "frame": optional("frame"),
    }


def judged(run):
    """Evidence, error, covariance of the alignment, whether right, and log of each judged candidate."""
    truths, stamps = {}, {}
    for path in sorted((run / "registered").glob("*.parquet")):
        table = pq.read_table(path)
        truths[path.stem] = read_truth(run / "truth" / path.name)
        stamps[path.stem] = dict(zip(table["scan"].to_pylist(), table["stamp_ns"].to_pylist()))
    rows = []
    for row in pq.read_table(run / "candidates.parquet").to_pylist():
        log = row["query_log"]
        # Candidates between logs are not used: the ground truth of two logs can be in different frames.
        if row["reference_log"] != log:
            continue
        ends = [pose_at(truths[log], stamps[log][row[f"{of}_scan"]]) for of in ("query", "reference")]
        if None in ends or ends[0][1] != ends[1][1]:
            continue
        found = np.array([row["dx_m"], row["dy_m"], row["dheading_rad"]])
        error = found - relative(ends[1][0], ends[0][0])
        error[2] = wrap(error[2])
        error_m, error_deg = np.hypot(*error[:2]), np.degrees(abs(error[2]))
        is_right = error_m < 0.5 and error_deg < 5.0
        if not is_right and not (1.0 < error_m or 8.0 < error_deg):
            continue
        xx, xy, xh, yy, yh, hh = (row[f"cov_{name}"] for name in ("xx", "xy", "xh", "yy", "yh", "hh"))
        covariance = np.array([[xx, xy, xh], [xy, yy, yh], [xh, yh, hh]]) - np.diag(START_STD**2)
        rows.append((row, error, covariance, is_right, log))
    return rows


def fit_verifier(rows, weights):
    """Intercept and the weights of overlap, known overlap, minus conflict and margin."""
    x = np.array([[r["overlap"], r["known_overlap"], -r["conflict"], r["margin"]] for r, *_ in rows])
    y = np.array([1.0 if right else -1.0 for *_, right, _ in rows])
    weights = weights / weights.sum()
    mean = weights @ x
    std = np.sqrt(weights @ (x - mean) ** 2)
    scaled = (x - mean) / std

    def loss(b):
        z = y * (b[0] + scaled @ b[1:])
        slope = -weights * y / (1 + np.exp(z))
        gradient = np.concatenate([[slope.sum()], slope @ scaled + PENALTY * b[1:]])
        return weights @ np.logaddexp(0, -z) + 0.5 * PENALTY * b[1:] @ b[1:], gradient

    bounds = [(None, None)] + [(0, None)] * 4
    found = minimize(loss, np.zeros(5), jac=True, method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-15, "gtol": 1e-9, "maxiter": 10_000})
    scaled_weights = found.x[1:] / std
    intercept = found.x[0] - scaled_weights @ mean
    log_loss = weights @ np.logaddexp(0, -y * (intercept + x @ scaled_weights))
    return np.array([intercept, *scaled_weights]), log_loss


def fit_closure(rows, weights):
    errors = np.array([error for _, error, *_ in rows])
    covariances = np.array([covariance for _, _, covariance, *_ in rows])

    def normalized(factor, std_m, std_rad):
        total = factor * covariances + np.diag([std_m**2, std_m**2, std_rad**2])
        return np.einsum("ni,ni->n", errors, np.linalg.solve(total, errors[..., None])[..., 0]), np.linalg.slogdet(total)[1]

    def loss(logarithms):
        nees, log_determinants = normalized(*np.exp(logarithms))
        return weights @ (0.5 * log_determinants + 3.5 * np.log1p(nees / 4))

    limits = np.log([[0.1, 1000], [0.008, 0.25], [np.radians(0.05), 0.04]])
    found = minimize(loss, np.log([1, 0.03, 0.01]), method="Nelder-Mead", bounds=limits, options={"xatol": 1e-5, "fatol": 1e-10, "maxiter": 5000})
    nees, _ = normalized(*np.exp(found.x))
    order = np.argsort(nees)
    share = np.cumsum(weights[order]) / weights.sum()
    scale = nees[order][np.searchsorted(share, 0.5 * (1 - 1e-12))] / chi2.ppf(0.5, 3)
    factor, std_m, std_rad = np.exp(found.x)
    values = np.array([factor * scale, std_m * np.sqrt(scale), std_rad * np.sqrt(scale)])
    return np.clip(values, *np.exp(limits.T)), loss


def main():
    run = Path(sys.argv[1])
    rows = judged(run)
    counts = {}
    for *_, right, log in rows:
        counts.setdefault(log, [0, 0])[0 if right else 1] += 1
    models = sorted(run.glob("models/*/*/model.json"))
    assert models, f"{run} has no models"
    for path in models:
        detector = json.loads(path.read_text())["detector"]
        theirs = {log["log"]: [log["n_right"], log["n_wrong"]] for log in detector["logs"]}
        assert theirs == {log: counts.get(log, [0, 0]) for log in theirs}, f"{path}: {theirs}, here {counts}"
        not_fitted = detector.get("not_fitted", [])
        if "verifier" not in not_fitted:
            weights = np.array([1 / sum(counts[log]) for *_, log in rows])
            here, log_loss = fit_verifier(rows, weights)
            of = detector["verifier_without_classifier"]
            there = np.array([of["intercept"], of["overlap"], of["known_overlap"], -of["conflict"], of["margin"]])
            assert np.allclose(here, there, rtol=2e-3, atol=2e-3), f"{path}: verifier {there}, here {here}"
            print(f"{path}: verifier {np.round(there, 3)}, log loss {log_loss:.4f}")
        if "closure" not in not_fitted:
            used = [row for row in rows if row[3] and 0.1 <= row[0]["weakness"]]
            per_log = {log: sum(row[4] == log for row in used) for log in counts}
            weights = np.array([1 / per_log[row[4]] for row in used])
            here, loss = fit_closure(used, weights)
            of = detector["closure"]
            there = np.array([of["covariance_factor"], of["std_m"], of["std_rad"]])
            # The likelihood is flat along factor and std, so likelihoods are compared.
            worse = (loss(np.log(there)) - loss(np.log(here))) / weights.sum()
            assert abs(worse) < 0.02, f"{path}: error of closures {there}, here {here}: {worse}"
            print(f"{path}: covariance factor {there[0]:.3f}, std {there[1]:.4f} m, {np.degrees(there[2]):.3f} deg")


if __name__ == "__main__":
    main()
