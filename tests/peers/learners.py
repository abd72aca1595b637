"""Fits the boosting learners in numpy and scikit-learn, and compares them with the rounds of a run.

usage: learners.py RUN_FOLDER                          compares rounds.parquet, fitted on all pairs
       learners.py --time-train N_PAIRS N_FEATURES     prints the seconds to fit AdaBoostClassifier, T = 50
       learners.py --time-score N_PAIRS N_FEATURES     prints the seconds of its decision_function

Discrete AdaBoost is scikit-learn's AdaBoostClassifier (SAMME) over stumps with the least weighted error.
(scikit-learn's own trees use another rule: they split by Gini impurity.) The other learners are
implemented here from the papers.
"""

import sys
import time

import numpy as np
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.ensemble import AdaBoostClassifier
from sklearn.tree import DecisionTreeClassifier

TIE = 1e-12


def cuts(x):
    """The order that sorts the values, and the places where two neighbours differ."""
    order = np.argsort(x, kind="stable")
    return order, np.flatnonzero(np.diff(x[order]) > 0)


class ErrorStump(ClassifierMixin, BaseEstimator):
    """The stump with the least weighted error. Ties: lower feature, lower threshold, positive below."""

    def fit(self, X, y, sample_weight):
        self.classes_ = np.array([-1, 1])
        w = sample_weight / sample_weight.sum()
        best = np.inf
        for f in range(X.shape[1]):
            order, at = cuts(X[:, f])
            gain = np.cumsum((w * y)[order])[at]
            below = w[y > 0].sum() - gain  # the error if positives are below
            error = np.minimum(below, 1 - below)
            if len(error) and error.min() < best - TIE:
                k = np.flatnonzero(error <= error.min() + TIE)[0]
                best, self.feature = error.min(), f
                lower, upper = X[order[at[k]], f], X[order[at[k] + 1], f]
                self.threshold = lower + (upper - lower) / 2
                self.polarity = 1 if below[k] <= 1 - below[k] + TIE else -1
        return self

    def predict(self, X):
        below = X[:, self.feature] < self.threshold if self.polarity > 0 else X[:, self.feature] > self.threshold
        return np.where(below, 1, -1)


def discrete(X, y, n_rounds):
    fitted = AdaBoostClassifier(ErrorStump(), n_estimators=n_rounds, learning_rate=1.0).fit(X, y)
    pairs = zip(fitted.estimators_, fitted.estimator_errors_)
    return [[(0, stump.feature, stump.threshold, error)] for stump, error in pairs]


def gentle(X, y, n_rounds, is_line):
    F, rounds = np.zeros(len(y)), []
    sorted_cuts = [cuts(x) for x in X.T]
    for _ in range(n_rounds):
        w = np.exp(-y * F + (y * F).min())
        w /= w.sum()
        best = -np.inf
        for f, x in enumerate(X.T):
            if is_line:
                mx, my = w @ x, w @ y
                slope = (w * (x - mx)) @ (y - my) / (w @ (x - mx) ** 2)
                explained, threshold = my**2 + slope * ((w * (x - mx)) @ (y - my)), np.nan
                fit = slope * x + my - slope * mx
            else:
                order, at = sorted_cuts[f]
                W, S = np.cumsum(w[order])[at], np.cumsum((w * y)[order])[at]
                V, U = 1 - W, w @ y - S
                with np.errstate(all="ignore"):
                    gain = np.where((W > 0) & (V > 0), S**2 / W + U**2 / V, -np.inf)
                k = int(np.argmax(gain))
                explained = gain[k]
                threshold = (x[order[at[k]]] + x[order[at[k] + 1]]) / 2
                fit = np.where(x < threshold, S[k] / W[k], U[k] / V[k])
            if explained > best + TIE:
                best, chosen, step = explained, (0, f, threshold, 1 - explained), fit
        rounds.append([chosen])
        F += step
    return rounds


def bins(x, most=256):
    """Thresholds between bins with about the same number of values, and the bin of each value."""
    order, at = cuts(x)
    ranks = at + 1
    if len(ranks) >= most:
        kept, due = [], 1
        for rank in ranks:
            if due * len(x) <= rank * most and len(kept) < most - 1:
                kept.append(rank)
                due = rank * most // len(x) + 1
        ranks = np.array(kept)
    v = x[order]
    thresholds = v[ranks - 1] + (v[ranks] - v[ranks - 1]) / 2
    return thresholds, np.searchsorted(thresholds, x, side="right")


def logit_trees(X, y, n_rounds, depth=3, shrinkage=0.1, min_leaf=20, regular=1.0):
    n = len(y)
    v = np.where(y > 0, n / (2 * (y > 0).sum()), n / (2 * (y < 0).sum()))
    binned = [bins(x) for x in X.T]
    F, rounds = np.zeros(n), []
    for _ in range(n_rounds):
        p = 1 / (1 + np.exp(-F))
        g, h = v * ((y > 0) - p), v * p * (1 - p)
        place, splits = np.zeros(n, int), []
        for level in range(depth):
            side = np.zeros(n, int)
            for k in range(2**level):
                rows = np.flatnonzero(place == k)
                G, H, best, chosen = g[rows].sum(), h[rows].sum(), 0.0, None
                for f, (thresholds, bin_of) in enumerate(binned):
                    m = len(thresholds)
                    b = bin_of[rows]
                    N = np.cumsum(np.bincount(b, minlength=m + 1))[:m]
                    A = np.cumsum(np.bincount(b, g[rows], m + 1))[:m]
                    B = np.cumsum(np.bincount(b, h[rows], m + 1))[:m]
                    gain = A**2 / (B + regular) + (G - A) ** 2 / (H - B + regular) - G**2 / (H + regular)
                    gain = np.where((N >= min_leaf) & (len(rows) - N >= min_leaf), gain, -np.inf)
                    if m and gain.max() > best + TIE:
                        best, chosen = gain.max(), (f, int(np.argmax(gain)))
                if chosen:
                    f, k_bin = chosen
                    splits.append((2**level - 1 + k, f, binned[f][0][k_bin]))
                    side[rows] = binned[f][1][rows] > k_bin
            place = 2 * place + side
        leaf = np.bincount(place, g, 2**depth) / (np.bincount(place, h, 2**depth) + regular)
        step = shrinkage * leaf[place]
        left = 1 - (step * (2 * g - step * h)).sum() / (g * g / h).sum()
        rounds.append([(*split, left) for split in splits])
        F += step
    return rounds


LEARNERS = {
    "discrete": discrete,
    "gentle_line": lambda X, y, n: gentle(X, y, n, True),
    "gentle_stump": lambda X, y, n: gentle(X, y, n, False),
    "logit_trees": logit_trees,
}


def compare(folder, most=50):
    import pandas as pd

    features = pd.read_parquet(f"{folder}/features").set_index(["log", "scan"])
    pairs = pd.read_parquet(f"{folder}/pairs.parquet")
    of = lambda side: features.loc[list(zip(pairs[f"{side}_log"], pairs[f"{side}_scan"]))].to_numpy()
    X, y, names = np.abs(of("query") - of("reference")), pairs.label.to_numpy(), list(features.columns)
    rounds = pd.read_parquet(f"{folder}/rounds.parquet")
    rounds = rounds[rounds.grouping.isna()]
    for learner, theirs in LEARNERS.items():
        ours = rounds[(rounds.learner == learner) & (rounds["round"] <= most)]
        if not len(ours):
            continue
        n_rounds = int(ours["round"].max())
        flat = [(t, *split) for t, round in enumerate(theirs(X, y, n_rounds), 1) for split in round]
        theirs = pd.DataFrame(flat, columns=["round", "node", "feature", "threshold", "error"])
        assert list(ours["round"]) == list(theirs["round"]), learner
        assert list(ours.node.fillna(0)) == list(theirs.node), learner
        assert list(ours.feature) == [names[f] for f in theirs.feature], learner
        if learner != "gentle_line":
            np.testing.assert_allclose(ours.threshold, theirs.threshold, rtol=1e-12, err_msg=learner)
        np.testing.assert_allclose(ours.weighted_error, theirs.error, atol=1e-9, err_msg=learner)
        print(f"{learner}: {n_rounds} rounds, {len(ours)} splits: the same features and thresholds")


def random_pairs(n_pairs, n_features, seed=7):
    """Weakly informative differences: those of negatives are twice as large as those of positives."""
    rng = np.random.default_rng(seed)
    y = np.where(np.arange(n_pairs) % 2 == 0, 1, -1)
    return np.abs(rng.normal(size=(n_pairs, n_features))) * np.where(y > 0, 1.0, 2.0)[:, None], y


if __name__ == "__main__":
    if sys.argv[1].startswith("--time"):
        X, y = random_pairs(int(sys.argv[2]), int(sys.argv[3]))
        model = AdaBoostClassifier(DecisionTreeClassifier(max_depth=1), n_estimators=50)
        n_train = len(X) if sys.argv[1] == "--time-train" else 2000
        start = time.perf_counter()
        model.fit(X[:n_train], y[:n_train])
        if sys.argv[1] == "--time-score":
            start = time.perf_counter()
            model.decision_function(X)
        print(time.perf_counter() - start)
    else:
        compare(sys.argv[1])
