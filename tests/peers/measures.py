"""Compares the measures of a run folder with scikit-learn, and the intervals with an independent
bootstrap in numpy.

usage: measures.py RUN_FOLDER
"""

import json
import sys

import numpy as np
import pandas as pd
from sklearn.metrics import average_precision_score, precision_recall_curve, roc_curve

folder = sys.argv[1]
scores = pd.read_parquet(f"{folder}/scores.parquet")
summary = json.load(open(f"{folder}/evaluation/summary.json"))["summary"]
random = np.random.default_rng(0)


def measures(y, c, w=None):
    """Error at threshold 0, average precision, recall at 0 % and 1 % false alarm, maximum F1."""
    false_alarm, recall, _ = roc_curve(y, c, drop_intermediate=False, sample_weight=w)
    p, r, _ = precision_recall_curve(y, c, sample_weight=w)
    with np.errstate(invalid="ignore"):
        f1 = np.nanmax(2 * p * r / (p + r))
    return {
        "error": np.average((c >= 0) != (y > 0), weights=w),
        "average_precision": average_precision_score(y, c, sample_weight=w),
        "recall_at_full_precision": recall[false_alarm <= 0].max(),
        "detection_at_1_percent": recall[false_alarm <= 0.01].max(),
        "max_f1": f1,
    }


worst, offsets = 0.0, []
for row in summary:
    rows = scores[(scores.learner == row["learner"]) & (scores.grouping == row["grouping"])]
    y, c = rows.label.to_numpy(), np.array([c[-1] for c in rows.confidences])
    for name, value in measures(y, c).items():
        worst = max(worst, abs(value - row[name]["value"]))
        assert abs(value - row[name]["value"]) < 1e-12, (row["learner"], row["grouping"], name, value)
    if row["error"]["interval"] is None:
        continue
    groups, ends = np.unique(rows[["query_group", "reference_group"]].to_numpy(), return_inverse=True)
    a, b = ends.reshape(-1, 2).T
    drawn = random.multinomial(len(groups), np.full(len(groups), 1 / len(groups)), size=400)
    weights = np.where(a == b, drawn[:, a], drawn[:, a] * drawn[:, b])
    expected = pd.DataFrame([measures(y, c, w) for w in weights])
    for name in ["error", "average_precision", "max_f1"]:
        low, high = np.quantile(expected[name], [0.025, 0.975])
        width = high - low
        found = row[name]["interval"]
        # 400 and 1000 resamples determine a bound to about a tenth of the width.
        offsets += [abs(found[0] - low) / width, abs(found[1] - high) / width]
        assert max(offsets[-2:]) < 0.35, (row["learner"], row["grouping"], name, found, low, high)
print(f"{len(summary)} combinations of learner and grouping: measures differ by at most {worst:.1e}, "
      f"bounds by {100 * np.mean(offsets):.0f} % of the interval's width on average, {100 * max(offsets):.0f} % at most")
