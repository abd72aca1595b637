"""Compares the cross-validated confidences of the baselines in a run folder with scikit-learn.

usage: baselines.py RUN_FOLDER

k-NN uses 5 neighbours and features scaled on the training folds. The SVM uses the squared hinge loss,
C = 1 and a regularised bias. The folds are those of scores.parquet for the grouping `pair`, in which
each pair is in one fold.
"""

import sys

import numpy as np
import pandas as pd
from sklearn.neighbors import KNeighborsClassifier
from sklearn.preprocessing import StandardScaler
from sklearn.svm import LinearSVC

folder = sys.argv[1]
features = pd.read_parquet(f"{folder}/features").set_index(["log", "scan"])
scores = pd.read_parquet(f"{folder}/scores.parquet")
for learner, tolerance in [("knn", 1e-9), ("svm", 1e-4)]:
    rows = scores[(scores.learner == learner) & (scores.grouping == "pair")]
    of = lambda side: features.loc[list(zip(rows[f"{side}_log"], rows[f"{side}_scan"]))].to_numpy()
    F, y, folds = np.abs(of("query") - of("reference")), rows.label.to_numpy(), rows.query_fold.to_numpy()
    ours = np.array([c[-1] for c in rows.confidences])
    theirs = np.empty(len(rows))
    for fold in np.unique(folds):
        test = folds == fold
        scaler = StandardScaler().fit(F[~test])
        X, Z = scaler.transform(F[~test]), scaler.transform(F[test])
        if learner == "knn":
            model = KNeighborsClassifier(5, algorithm="brute").fit(X, y[~test])
            theirs[test] = 2 * model.predict_proba(Z)[:, 1] - 1
        else:
            model = LinearSVC(tol=1e-10, max_iter=1_000_000, dual=False).fit(X, y[~test])
            theirs[test] = model.decision_function(Z)
    error = np.abs(ours - theirs)
    print(f"{learner}: {len(rows)} pairs, {(error > tolerance).sum()} differ by more than {tolerance}, largest difference {error.max():.2e}")
    # If two neighbours are equally far away, the two programs may choose different ones.
    assert (error > tolerance).sum() <= (2 if learner == "knn" else 0)
