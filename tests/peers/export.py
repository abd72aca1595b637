"""Scores pairs with an exported model in onnxruntime and compares with the model's own rule.

usage: export.py MODEL.onnx MODEL.json [PAIRS]

The script evaluates the rule of model.json in numpy for 10,000 random pairs. Half of the pairs have a
feature exactly at a threshold. Confidences must agree within 1e-5. Labels must agree if the confidence
differs from the threshold by more than that.
"""

import json
import sys

import numpy as np
import onnx
import onnxruntime

model = json.load(open(sys.argv[2]))
names = model["features"]["names"]
n = int(sys.argv[3]) if len(sys.argv) > 3 else 10_000
rng = np.random.default_rng(model["seed"])

# Differences at the scale of the thresholds of each feature.
splits = [s for r in model["rounds"] for s in r.get("nodes", [r]) if s is not None]
scales = {name: 1.0 for name in names}
for s in splits:
    scales[s["feature"]] = max(scales[s["feature"]], abs(s.get("threshold", 1.0)))
F = np.abs(rng.normal(size=(n, len(names)))) * np.array([scales[name] for name in names])
for k, s in enumerate(splits):
    if "threshold" in s:
        F[k :: 2 * len(splits), names.index(s["feature"])] = s["threshold"]


def leaves(r, rows, node=0):
    """The value of the leaf of each row, below a node. The children of k are 2 k + 1 and 2 k + 2."""
    if len(r["nodes"]) <= node:
        return np.full(len(rows), r["leaves"][node - len(r["nodes"])])
    left, right = leaves(r, rows, 2 * node + 1), leaves(r, rows, 2 * node + 2)
    s = r["nodes"][node]
    return left if s is None else np.where(rows[:, names.index(s["feature"])] < s["threshold"], left, right)


expected = np.zeros(n)
for r in model["rounds"]:
    if r["kind"] == "tree":
        expected += leaves(r, F)
        continue
    f = F[:, names.index(r["feature"])]
    if r["kind"] == "vote":
        expected += np.where(r["polarity"] * f < r["polarity"] * r["threshold"], r["alpha"], -r["alpha"])
    elif r["kind"] == "line":
        expected += r["slope"] * f + r["intercept"]
    else:
        expected += np.where(f < r["threshold"], r["below"], r["above"])

onnx.checker.check_model(onnx.load(sys.argv[1]), full_check=True)
session = onnxruntime.InferenceSession(sys.argv[1])
confidence, label = session.run(["confidence", "label"], {"F": F})
error = np.abs(confidence - expected).max()
clear = np.abs(expected) > 1e-5
wrong = (label[clear] != np.where(expected[clear] >= 0, 1, -1)).sum()
print(f"{model['name']}: {n} pairs, confidence within {error:.2e}, {wrong} labels differ")
assert confidence.shape == (n,) and label.shape == (n,)
assert error <= 1e-5 and wrong == 0
