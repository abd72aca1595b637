"""Computes the features of scans with numpy, from the formulas in docs/features.md.

usage: features.py RUN_FOLDER                      compares the features of a run
       features.py --time SET N_SCANS N_RETURNS    prints the seconds per scan

A scan is x and y in firing order and the covered angle [deg]. The script shares no code with the
program.
"""

import sys
import time

import numpy as np

GATE_M = 2.5
SQRT2 = [2 ** (k / 2 - 0.5) for k in range(13)]
FACING_M = [0.5, 1, 1.4, 1.7, 2, 2.3, 2.6, 3, 3.5, 4.2, 5, 6.5, 8.5, 11, 15, 20, 30]
COPLANAR_M = [0, 0.1, 0.25, 0.5, 0.8, 1.2, 1.8, 2.5, 4, 7, 12]
CROSS_M = [1, 1.4, 1.7, 2, 2.3, 2.7, 3.2, 4, 5, 7, 10, 15]
GAP_M = [0.6, 1, 1.6, 2.5, 4, 7, 15]
RUN_M = [0.2, 0.5, 1, 2, 4, 8, 16, 32]
STEP = [0.01, 0.03, 0.1, 0.3, 1, 3]
WIDTH_P = [0, 5, 10, 25, 40, 50, 60, 75, 90, 95, 100]
QUARTER_P = [0, 10, 25, 50, 75, 90, 100]


def paper16(x, y, coverage_deg):
    ring = coverage_deg >= 355
    p = np.column_stack([x, y])
    n = len(p)
    q = np.roll(p, -1, axis=0)
    if not ring:
        a, b = p[:-1], p[1:]
    else:
        a, b = p, q
    d = np.linalg.norm(b - a, axis=1)
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    angle = np.arctan2(np.abs(cross), (a * b).sum(axis=1))
    close = d <= GATE_M
    mu = p.mean(axis=0)
    u, v = (p - mu).T
    A = np.array([[u @ u, u @ v], [u @ v, v @ v]])
    s = u * u + v * v
    c = np.linalg.solve(A, [0.5 * (u @ s), 0.5 * (v @ s)])
    radius = np.sqrt(c @ c + s.sum() / n)
    residual = ((radius - np.hypot(u - c[0], v - c[1])) ** 2).sum()
    median = np.median(angle)
    k = np.zeros(0)
    if median > 0:
        stride = max(1, int(np.floor(np.radians(1) / median + 0.5)))
        if ring:
            before, after = np.roll(p, stride, axis=0), np.roll(p, -stride, axis=0)
            middle = p
        else:
            before, middle, after = p[: -2 * stride], p[stride:-stride], p[2 * stride :]
        sides = [np.linalg.norm(middle - before, axis=1), np.linalg.norm(after - middle, axis=1)]
        sides.append(np.linalg.norm(before - after, axis=1))
        ok = np.all([(0 < side) & (side <= GATE_M) for side in sides], axis=0)
        e, f = middle - before, after - before
        area = np.abs(e[:, 0] * f[:, 1] - f[:, 0] * e[:, 1])
        k = 2 * area[ok] / (sides[0] * sides[1] * sides[2])[ok]
    breaks = (~close).sum()
    groups = max(1, breaks) if ring else 1 + breaks
    rho, r = np.hypot(u, v), np.hypot(x, y)
    std = lambda values: np.std(values, ddof=1) if len(values) > 1 else 0.0
    return np.array(
        [
            np.hypot(*mu), 0.5 * np.abs(cross[close]).sum(), d[close].sum(), radius, residual,
            k.mean() if len(k) else 0.0, std(k), d.sum(), groups, n / groups, angle.mean(),
            np.sqrt(s.sum() / (n - 1)), std(d), n, std(rho), std(r),
        ]
    )  # fmt: skip


def soft(values, weights, centres):
    """Distributes weights to the two nearest centres, or to the end if values are beyond it."""
    t = np.interp(values, centres, np.arange(len(centres)))
    k = np.minimum(t.astype(int), len(centres) - 2)
    n = len(centres)
    return np.bincount(k, weights * (1 - (t - k)), n) + np.bincount(k + 1, weights * (t - k), n)


def signature(x, y, coverage_deg):
    """Mean ln r of each azimuth bin, with empty bins interpolated; the azimuths of the bins; the share of
    5 deg sectors with returns."""
    ln_r = np.log(np.hypot(x, y))
    if coverage_deg >= 355:
        n, width = 360, 1.0
        place = (np.degrees(np.arctan2(y, x)) % 360) / width
        first = 0.0
    else:
        r = np.exp(ln_r)
        mx, my = (x / r).sum(), (y / r).sum()
        rel = np.degrees(np.arctan2(mx * y - my * x, mx * x + my * y))
        lo, hi = rel.min(), rel.max()
        span = min(360.0, max(coverage_deg, hi - lo, 8.0))
        n = int(np.floor(span + 0.5))
        width = span / n
        n += 1
        first = (lo + hi) / 2 - span / 2 - 0.3 * width
        place = (rel - first) / width
    bins = np.clip(np.floor(place).astype(int), 0, n - 1)
    count = np.bincount(bins, minlength=n)
    full = count > 0
    mean = np.bincount(bins, ln_r, n)[full] / count[full]
    m = np.interp(np.arange(n), np.flatnonzero(full), mean, period=n if coverage_deg >= 355 else None)
    sectors = np.add.reduceat(full, np.arange(0, n, 5)) > 0
    return m, np.radians(first + (np.arange(n) + 0.5) * width), sectors.mean()


def campus(x, y, coverage_deg):
    ring = coverage_deg >= 355
    m, azimuth, seen = signature(x, y, coverage_deg)
    n, r = len(m), np.exp(m)
    p = np.column_stack([r * np.cos(azimuth), r * np.sin(azimuth)])
    out = [soft(m, np.full(n, 1 / n), np.log(SQRT2))]
    if ring:
        half = n // 2
        chord = np.log(r[:half] + r[half:])
        odd = np.abs(m[:half] - m[half:])
        out += [np.percentile(chord, WIDTH_P), [odd.mean(), np.log(odd.std() + 1e-3)]]
        quarter = r + np.roll(r, -90)
    else:
        out += [np.zeros(len(WIDTH_P)), np.zeros(2)]
        quarter = r[:-90] + r[90:] if n > 90 else np.ones(1)
    out.append(np.percentile(np.log(quarter), QUARTER_P))
    out.append(np.log([np.minimum(r, limit).std() + 0.01 for limit in (2, 4, 8, 16)]))
    out.append([seen])

    a, b = (p, np.roll(p, -1, axis=0)) if ring else (p[:-1], p[1:])
    d, middle = b - a, (a + b) / 2
    length = np.hypot(d[:, 0], d[:, 1])
    limit = np.maximum(0.5, 0.12 * np.hypot(middle[:, 0], middle[:, 1]))
    w = length / (1 + (length / limit) ** 4) + 1e-9
    dm = np.abs(np.diff(np.r_[m, m[:1]] if ring else m))
    out.append(soft(np.log(dm + 1e-4), np.full(len(dm), 1 / len(dm)), np.log(STEP)))

    is_gap = length > limit
    gaps = np.flatnonzero(is_gap)
    out.append(np.log1p(soft(np.log(length[gaps]), np.ones(len(gaps)), np.log(GAP_M))))
    along = np.r_[0, np.cumsum(np.where(is_gap, 0, length))]
    runs = np.diff(np.r_[0, along[gaps], along[-1]])
    if ring and len(gaps):
        runs = np.r_[runs[0] + runs[-1], runs[1:-1]]
    out.append(np.log1p(soft(np.log(runs + 1e-3), runs, np.log(RUN_M))))

    # Pieces of wall. On a ring, each has two steps.
    s = 2 if ring else 1
    piece = lambda v: v[: len(v) // s * s].reshape(-1, s, *v.shape[1:]).sum(axis=1)
    weight = piece(w)
    at = piece(middle * w[:, None]) / weight[:, None]
    t = piece(d)
    t = t / (np.hypot(t[:, 0], t[:, 1])[:, None] + 1e-9)
    normal = np.column_stack([-t[:, 1], t[:, 0]])
    i, j = np.triu_indices(len(weight), 1)
    ww = weight[i] * weight[j]
    ww = ww / ww.sum()
    apart = at[i] - at[j]
    cos = (t[i] * t[j]).sum(axis=1)
    off = 0.5 * (np.abs((apart * normal[i]).sum(axis=1)) + np.abs((apart * normal[j]).sum(axis=1)))
    lengthwise = 0.5 * (np.abs((apart * t[i]).sum(axis=1)) + np.abs((apart * t[j]).sum(axis=1)))
    parallel = np.where(np.abs(cos) >= 0.7, ww * cos**16, 0)
    facing = np.where(cos < 0, parallel, 0)
    h = soft(off, facing, FACING_M)
    out += [np.sqrt(h), [np.sqrt(facing.sum())]]
    h = soft(off, np.where(cos > 0, parallel, 0), COPLANAR_M)
    out.append(h / max(h.sum(), 1e-9))
    h = soft(off, facing * np.maximum(0, 1 - (lengthwise / 3) ** 2) ** 2, CROSS_M)
    out.append(h / max(h.sum(), 1e-9))
    out.append([np.sqrt((ww * (1 - np.minimum(cos**2, 1)) ** 8).sum())])

    if ring:
        heading = np.arctan2(d[:, 1], d[:, 0])
        axis = np.angle((w * np.exp(4j * heading)).sum()) / 4
        near = lambda turn: (w * np.cos(heading - axis - turn) ** 16).sum()
        if near(np.pi / 2) > near(0):
            axis += np.pi / 2
        k = int(np.floor(np.degrees(axis))) % 180
        window = lambda k: chord[np.arange(k - 4, k + 5) % 180]
        median = lambda k: np.median(window(k))
        out += [[window(k).max(), median(k), window(k + 90).max(), median(k + 90)]]
        out += [np.sort([median(k + 45), median(k + 135)]), np.sort([median(k), median(k + 90)])]
    else:
        out.append(np.zeros(8))
    return np.concatenate(out)


SETS = {"paper16": paper16, "campus": campus}


def compare(folder):
    import pyarrow.parquet as pq

    table = pq.read_table(f"{folder}/features")
    names = table.column_names[2:]
    features = SETS["paper16" if len(names) == 16 else "campus"]
    ours = np.column_stack([table[name].to_numpy() for name in names])
    logs, scans = table["log"].to_pylist(), table["scan"].to_pylist()
    theirs = np.empty_like(ours)
    rows = {}
    for row, key in enumerate(zip(logs, scans)):
        rows.setdefault(key[0], {})[key[1]] = row
    for log, wanted in rows.items():
        table = pq.read_table(f"{folder}/scans/{log}.parquet").to_pydict()
        for scan, x, y, deg in zip(table["scan"], table["x_m"], table["y_m"], table["coverage_deg"]):
            if scan in wanted:
                theirs[wanted[scan]] = features(np.array(x, float), np.array(y, float), deg)
    # A return or an axis may be within a rounding error of the border of a bin.
    off = np.abs(ours - theirs) > 1e-6 * (1 + np.abs(theirs))
    worst = names[int(off.sum(axis=0).argmax())]
    n_off = int(off.any(axis=1).sum())
    print(f"{features.__name__}: {len(ours)} scans x {len(names)} features, {n_off} scans differ, most in {worst}")
    assert theirs.shape == ours.shape and n_off <= 0.002 * len(ours)


def random_rooms(n_scans, n_returns, seed=7):
    """Rooms of six walls with range noise."""
    rng = np.random.default_rng(seed)
    azimuth = np.linspace(0, 2 * np.pi, n_returns, endpoint=False)
    for _ in range(n_scans):
        walls, axis = rng.uniform(1, 20, 6), rng.uniform(0, np.pi)
        normals = axis + np.arange(6) * np.pi / 2 + np.repeat([0, 0.3], [4, 2])
        with np.errstate(divide="ignore"):
            r = walls / np.maximum(np.cos(azimuth[:, None] - normals), 1e-9)
        r = np.minimum(r.min(axis=1), 60) + rng.normal(0, 0.02, n_returns)
        yield r * np.cos(azimuth), r * np.sin(azimuth)


if __name__ == "__main__":
    if sys.argv[1] == "--time":
        features, n_scans, n_returns = SETS[sys.argv[2]], int(sys.argv[3]), int(sys.argv[4])
        scans = list(random_rooms(n_scans, n_returns))
        start = time.perf_counter()
        values = [features(x, y, 360.0) for x, y in scans]
        print((time.perf_counter() - start) / n_scans)
        assert np.isfinite(values).all()
    else:
        compare(sys.argv[1])
