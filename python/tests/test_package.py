"""Tests of an installed package.

usage: test_package.py ROOT FOLDER

ROOT is the repository, and FOLDER a folder to write to. It needs polars, pyarrow, pandas and duckdb.
"""

import ast
import inspect
import json
import multiprocessing
import operator
import os
import pickle
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import duckdb
import numpy as np
import pandas
import polars
import pyarrow
import pyarrow.dataset

import loopboost

ROOT, FOLDER = Path(sys.argv[1]), Path(sys.argv[2])
QUICKSTART = ROOT / "pipelines/quickstart.toml"


def raises(kind, words, call, *arguments, **options):
    """The error of a call that must fail, and must name `words`."""
    try:
        call(*arguments, **options)
    except kind as error:
        assert words in str(error), f"{error} does not contain {words!r}"
        assert isinstance(error, loopboost.LoopboostError)
        return error
    raise AssertionError(f"{call.__name__}{arguments} did not fail")


def quickstart():
    """The run that the other tests read."""
    lines = []
    run = loopboost.run(QUICKSTART, FOLDER / "quickstart", progress=lines.append)
    assert any(line.startswith("evaluate") for line in lines), lines
    assert run.logs == ["monday", "tuesday"] and run.report.is_file()
    assert "report" in run._repr_html_() and "keyframes" in run._repr_html_()
    again = loopboost.run(str(QUICKSTART), FOLDER / "quickstart")
    assert again.info["format_version"] == run.info["format_version"]
    return run


def tables_open_everywhere(run):
    keyframes = run.keyframes
    n = len(keyframes)
    assert n == sum(len(run.table("keyframes", log)) for log in run.logs) and 1000 < n
    # A stream can be taken more than once.
    for _ in range(2):
        assert polars.DataFrame(keyframes).height == n
    arrow = pyarrow.table(keyframes)
    assert arrow.num_rows == n and arrow.column_names == keyframes.column_names
    assert arrow.equals(pyarrow.dataset.dataset(run.folder / "keyframes").to_table())
    assert len(arrow.to_pandas()) == n and isinstance(arrow.to_pandas(), pandas.DataFrame)
    assert duckdb.sql("SELECT count(*) FROM keyframes").fetchall() == [(n,)]
    assert "loopboost.kind" in next(iter(run.pairs.metadata().values()))
    raises(loopboost.ArgumentError, "expected one of", run.table, "closure")
    raises(loopboost.InputError, "monday, tuesday", run.table, "scans", "friday")
    raises(loopboost.InputError, "does not exist", lambda: run.closures)
    raises(loopboost.InputError, "run.json", loopboost.Run, FOLDER)

    damaged = FOLDER / "damaged"
    shutil.copytree(run.folder, damaged)
    (damaged / "pairs.parquet").write_bytes(b"PAR1 but no table PAR1")
    raises(loopboost.InputError, "pairs.parquet", lambda: loopboost.Run(damaged).pairs)
    # The Parquet reader panics for some damaged files. That is an error, and not the end of the process.
    whole = run.pairs.files[0].read_bytes()
    # The file ends with its metadata, their length and a magic number.
    end = len(whole) - 8
    for place in range(end - int.from_bytes(whole[end : end + 4], "little"), end):
        changed = bytearray(whole)
        changed[place] ^= 0xFF
        (damaged / "pairs.parquet").write_bytes(changed)
        try:
            pyarrow.table(loopboost.Run(damaged).pairs)
        except (loopboost.InputError, pyarrow.ArrowException) as error:
            assert str(error)
    # A file that is damaged after it was opened is an error of the library that reads it.
    opened = loopboost.Run(damaged).keyframes
    opened.files[0].write_bytes(b"")
    try:
        pyarrow.table(opened)
    except pyarrow.ArrowException as error:
        assert opened.files[0].name in str(error), error
    else:
        raise AssertionError("a damaged table was read")


def logs_are_read_as_by_the_program(run):
    log, topic, poses = run.folder / "logs/monday.mcap", "/velodyne_packets", "/ground_truth"
    reported = []
    scans = loopboost.read_scans(log, topic, poses, progress=lambda *n_bytes: reported.append(n_bytes))
    assert reported[-1] == (log.stat().st_size,) * 2 and reported == sorted(reported), reported
    arrow = pyarrow.table(scans)
    assert arrow.equals(pyarrow.table(run.scans("monday"))) and arrow.num_rows == len(scans) and 1000 < len(scans)
    assert polars.DataFrame(scans).columns == scans.column_names and "Rows" in repr(scans)
    assert any(line.startswith("info[deskewed]: ") for line in scans.messages), scans.messages
    found = loopboost.read_poses([log], topic, {"topic": np.str_(poses)})
    assert pyarrow.table(found).equals(pyarrow.table(run.table("poses", "monday"))), found
    tum = FOLDER / "poses.tum"
    assert loopboost.to_tum(found, tum) == len(found)
    poses_of_tum = polars.DataFrame(found).sort("stamp_ns")
    stamp_s, x_m, y_m, *_, sin, cos = np.loadtxt(tum).T
    assert np.abs(stamp_s - poses_of_tum["stamp_ns"].to_numpy() / 1e9).max() < 1e-6 and np.abs(x_m - poses_of_tum["x_m"].to_numpy()).max() < 1e-8
    assert np.abs(np.exp(2j * np.arctan2(sin, cos)) - np.exp(1j * poses_of_tum["heading_rad"].to_numpy())).max() < 1e-9
    of_duckdb = duckdb.sql("SELECT make_timestamp_ns(stamp_ns) AS stamp_ns, x_m, y_m, heading_rad FROM found LIMIT 7")
    assert loopboost.to_tum(of_duckdb, tum) == 7
    raises(loopboost.ArgumentError, "no column `heading_rad`", loopboost.to_tum, poses_of_tum.drop("heading_rad"), tum)
    raises(loopboost.ArgumentError, "row 0: a stamp or a pose", loopboost.to_tum, poses_of_tum.with_columns(x_m=float("nan")), tum)
    raises(loopboost.InputError, "File exists", loopboost.to_tum, found, tum / "below_a_file.tum")
    raises(loopboost.ArgumentError, "monday, tuesday", loopboost.to_tum, run.keyframes, tum)
    raises(loopboost.ArgumentError, "single column", loopboost.to_tum, poses_of_tum["x_m"], tum)
    raises(loopboost.ArgumentError, "no column `x_m`", loopboost.to_tum, pyarrow.table({"stamp_ns": [1]}).schema.empty_table(), tum)
    raw = loopboost.read_scans(str(log), topic, range_max_m=np.float32(5))
    near = polars.DataFrame(raw).select(polars.col("x_m").explode().pow(2) + polars.col("y_m").explode().pow(2)).max().item()
    assert 24 < near <= 25.001 and not any("[deskewed]" in line for line in raw.messages), raw.messages

    raises(loopboost.InputError, "/scan", loopboost.read_scans, log, "/scan")
    raises(loopboost.InputError, "missing.mcap", loopboost.read_scans, FOLDER / "missing.mcap", topic)
    raises(loopboost.InputError, "/odom", loopboost.read_poses, log, topic, "/odom")
    raises(loopboost.ArgumentError, "range_max_m", loopboost.read_scans, log, topic, range_max=5)
    raises(loopboost.ArgumentError, "range_max_m", loopboost.read_scans, log, topic, range_max_m=-1)
    raises(loopboost.ArgumentError, "loopboost.Run", loopboost.read_scans, log, topic, {"run": run.folder})
    raises(loopboost.ArgumentError, "no files", loopboost.read_scans, [], topic)
    raises(loopboost.ArgumentError, "options", loopboost.read_scans, log, topic, ring=object())

    def fail(*_):
        raise KeyError("progress")

    try:
        loopboost.read_scans(log, topic, progress=fail)
    except KeyError:
        pass
    else:
        raise AssertionError("an exception in `progress` was lost")
    # In processes that Python forked.
    with multiprocessing.get_context("fork").Pool(2) as pool:
        assert pool.starmap(n_scans, [(log, topic)] * 2) == [len(scans)] * 2


def n_scans(log, topic):
    return len(loopboost.read_scans(log, topic))


def features_equal_the_table(run):
    scans = polars.DataFrame(run.scans("monday"))
    features = polars.DataFrame(run.table("features", "monday"))
    names = loopboost.feature_names("paper16")
    assert set(names) <= set(features.columns)
    by_scan = {row["scan"]: row for row in features.iter_rows(named=True)}
    n_compared = 0
    for row in scans.iter_rows(named=True):
        if row["scan"] not in by_scan:
            continue
        expected = np.array([by_scan[row["scan"]][name] for name in names])
        for kind in (np.float32, np.float64):
            x_m, y_m = np.array(row["x_m"], kind), np.array(row["y_m"], kind)
            found = loopboost.featurize(x_m, y_m, row["coverage_deg"], set="paper16")
            assert found.dtype == np.float64 and found.tobytes() == expected.tobytes()
        n_compared += 1
    assert n_compared == features.height
    # A whole table, also as other libraries make it: with long lists, and numbers of 64 bits.
    whole = scans.head(200).with_columns(polars.lit(360).alias("coverage_deg"))
    assert loopboost.featurize_table(whole).messages == []
    wide = scans.with_columns(polars.col("x_m", "y_m").cast(polars.List(polars.Float64)), polars.col("coverage_deg").cast(float))
    for table in (run.scans("monday"), scans, wide, scans.to_arrow()):
        found = loopboost.featurize_table(table, set="paper16")
        assert found.column_names == [name for name in scans.columns if name not in ("x_m", "y_m")] + names
        of_all = polars.DataFrame(found)
        of_keyframes = of_all.join(features.select("log", "scan"), on=["log", "scan"], how="semi").sort("scan")
        assert of_keyframes.select(names).equals(features.sort("scan").select(names)) and of_all.height == scans.height
    few = scans.head(3).with_columns(*(polars.Series(name, [[1.0, 2.0]] * 3, polars.List(polars.Float32)) for name in ("x_m", "y_m")))
    mixed = polars.concat([few, scans.head(2)])
    of_mixed = loopboost.featurize_table(mixed)
    assert of_mixed.messages == ["3 of 5 scans have no features: fewer than 3 returns"], of_mixed.messages
    first = polars.DataFrame(of_mixed)[loopboost.feature_names("campus")[0]]
    assert first.is_null().to_list() == [True] * 3 + [False] * 2, first
    raises(loopboost.ArgumentError, "no column `x_m`", loopboost.featurize_table, run.pairs)
    raises(loopboost.ArgumentError, "Float64, expected lists", loopboost.featurize_table, run.keyframes)
    raises(loopboost.ArgumentError, "single column", loopboost.featurize_table, scans["x_m"])
    raises(loopboost.ArgumentError, "list, expected a table", loopboost.featurize_table, [x_m, y_m])
    raises(loopboost.ArgumentError, "column `" + names[0], loopboost.featurize_table, scans.with_columns(polars.lit(1).alias(names[0])), set="paper16")
    uneven = scans.with_columns(polars.when(polars.col("scan") == 5).then(polars.lit([1.0], polars.List(polars.Float32))).otherwise("x_m").alias("x_m"))
    raises(loopboost.ArgumentError, "row 5: 1 numbers in `x_m`", loopboost.featurize_table, uneven)
    hole = scans.with_columns(polars.when(polars.col("scan") != 7).then("y_m").alias("y_m"))
    raises(loopboost.ArgumentError, "row 7: a null in `y_m`", loopboost.featurize_table, hole)
    chunks = pyarrow.concat_tables([scans.to_arrow(), hole.to_arrow()])
    raises(loopboost.ArgumentError, f"row {scans.height + 7}: a null", loopboost.featurize_table, chunks)
    fixed = polars.DataFrame({name: [[1.0, 2.0, 0.5]] for name in ("x_m", "y_m")}).with_columns(coverage_deg=360, y_m=polars.Series([[1.0, 0.0, 3.0]]))
    in_lists = loopboost.featurize_table(fixed)
    in_arrays = loopboost.featurize_table(fixed.with_columns(polars.col("x_m", "y_m").list.to_array(3)))
    assert polars.DataFrame(in_arrays).equals(polars.DataFrame(in_lists)) and not in_lists.messages
    # Every second value of an array that is not contiguous.
    strided = loopboost.featurize(np.repeat(x_m, 2)[::2], np.repeat(y_m, 2)[::2], row["coverage_deg"], set="paper16")
    assert strided.tobytes() == loopboost.featurize(x_m, y_m, row["coverage_deg"], set="paper16").tobytes()
    raises(loopboost.ArgumentError, "same number", loopboost.featurize, x_m, y_m[1:])
    raises(loopboost.ArgumentError, "shape", loopboost.featurize, [x_m, x_m], [y_m, y_m])
    raises(loopboost.ArgumentError, "`paper16` or `campus`", loopboost.featurize, x_m, y_m, set="paper17")
    raises(loopboost.ArgumentError, "gate_m", loopboost.featurize, x_m, y_m, set="paper16", gate_m=-1)
    raises(loopboost.InputError, "fewer than 3", loopboost.featurize, [1, 2], [1, 2])
    raises(loopboost.InputError, "not finite", loopboost.featurize, [1, 2, np.nan], [1, 2, 3.5])


def models_score_as_the_program(run):
    name = "quickstart-discrete"
    model = run.model(name)
    assert model.name == name and model.version == "1.0.0" and name in repr(model) and not model.has_detector
    assert model.feature_names == loopboost.feature_names("paper16") and model.scans["is_ring"] is True
    assert {"threshold", "precision"} <= set(model.operating_points[0]) and "error" in model.measured[0]
    assert name in model.card() and name in model._repr_html_()
    folder = loopboost.Model.load(model.path.parent)
    assert folder.path == model.path

    features = polars.DataFrame(run.features).sort("log", "scan")
    matrix = features.select(model.feature_names).to_numpy()
    random = np.random.default_rng(3)
    pairs = random.integers(0, len(matrix), (40_000, 2))
    found = model.score_pairs(matrix, pairs)
    assert found.tobytes() == model.score_pairs(np.asfortranarray(matrix), pairs.astype(np.uint32)).tobytes()
    assert model.score(matrix[3], matrix[4]) == model.score_pairs(matrix, [[3, 4]])[0]
    assert model.score_pairs(matrix, []).shape == (0,)
    scan = polars.DataFrame(run.scans("monday")).row(0, named=True)
    assert model.featurize(scan["x_m"], scan["y_m"]).shape == (16,)

    # The same pairs by the program.
    sample = range(0, len(pairs), 400)
    ids = features.select("log", "scan").rows()
    file = FOLDER / "pairs.csv"
    rows = [f"{ids[a][0]},{ids[a][1]},{ids[b][0]},{ids[b][1]}" for a, b in (pairs[k] for k in sample)]
    file.write_text("\n".join(["query_log,query_scan,reference_log,reference_scan", *rows]))
    command = ["loopboost", "score", model.path, "--run", run.folder, "--pairs", file, "--out", FOLDER / "scores.parquet"]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    scores = polars.read_parquet(FOLDER / "scores.parquet")["confidence"].to_numpy()
    assert len(scores) == len(rows) and scores.tobytes() == found[list(sample)].tobytes()

    raises(loopboost.ArgumentError, "(n_scans, 16)", model.score_pairs, matrix[:, :3], pairs)
    raises(loopboost.ArgumentError, "row numbers", model.score_pairs, matrix, [[0, len(matrix)]])
    raises(loopboost.ArgumentError, "row numbers", model.score_pairs, matrix, [[0, -1]])
    raises(loopboost.ArgumentError, "not finite", model.score_pairs, np.full((2, 16), np.nan), [[0, 1]])
    raises(loopboost.InputError, "full circle", model.featurize, scan["x_m"], scan["y_m"], 180.0)
    raises(loopboost.InputError, "No such file", loopboost.Model, FOLDER / "missing.json")
    raises(loopboost.ArgumentError, "expected the same", model.score, matrix[0], matrix[0][:3])
    # In processes that Python forked.
    with multiprocessing.get_context("fork").Pool(2) as pool:
        for scores in pool.starmap(type(model).score_pairs, [(model, matrix, pairs)] * 2):
            assert scores.tobytes() == found.tobytes()
    raises(loopboost.InputError, "name one of them", loopboost.Model, run.folder)
    raises(loopboost.InputError, "only: quickstart-", run.model, "other")


def commands_report_errors(run):
    error = raises(loopboost.CommandError, "nothing.mcap", loopboost.inspect, FOLDER / "nothing.mcap")
    assert error.exit_code == 1
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.exit_code, again.log) == (str(error), 1, error.log)
    survey = loopboost.inspect(run.folder / "logs/monday.mcap")
    assert isinstance(survey.problems, list) and "[ingest]" in survey.pipeline and "suggested pipeline" in survey._repr_html_()
    wrong = {"label.positive_radius": 2}
    raises(loopboost.ArgumentError, "positive_radius_m", loopboost.run, QUICKSTART, FOLDER / "wrong", overrides=wrong)
    raises(loopboost.ArgumentError, "missing.toml", loopboost.run, FOLDER / "missing.toml", FOLDER / "wrong")
    raises(loopboost.CommandError, "detector", loopboost.detect, QUICKSTART, run.model("quickstart-discrete"), FOLDER / "wrong")
    raises(loopboost.CommandError, "detector", run.model("quickstart-discrete").detect, QUICKSTART, FOLDER / "wrong", strict=True)
    values = {"label.positive_radius_m": np.float64(1.25), "train.learners": ["discrete"], "evaluate.grid.positive_radius_m": np.array([1.0, 2.0])}
    values |= {"label.pairs_per_class": np.int64(200)}
    changed = FOLDER / "changed"
    shutil.copytree(run.folder, changed)
    done = loopboost.run(QUICKSTART, changed, overrides=values, force="label")
    assert list(done.models) == list(run.models) and len(done.pairs) == 400
    options = json.loads(next(iter(done.pairs.metadata().values()))["loopboost.options"])
    assert options["positive_radius_m"] == 1.25 and options["pairs_per_class"] == 200, options


def a_run_can_be_stopped():
    out = FOLDER / "stopped"

    def fail(line):
        raise KeyError(line)

    try:
        loopboost.run(QUICKSTART, out, progress=fail)
    except KeyError:
        pass
    else:
        raise AssertionError("an exception in `progress` was lost")

    # Only this process gets the signal, as in a notebook. A shell ignores it for commands in the background.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    started = threading.Event()
    stopped_at = []

    def interrupt():
        started.wait(60)
        stopped_at.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt).start()
    try:
        loopboost.run(QUICKSTART, out, progress=lambda _: started.set(), force=["ingest"])
    except KeyboardInterrupt:
        print(f"Ctrl-C: stopped after {time.monotonic() - stopped_at[0]:.3f} s")
    else:
        raise AssertionError("Ctrl-C did not stop the run")
    # The stopped process has released the folder.
    assert loopboost.run(QUICKSTART, out).report.is_file()


def the_program_is_part_of_the_package(run):
    version = subprocess.run(["loopboost", "--version"], capture_output=True, text=True, check=True).stdout
    assert version.split() == ["loopboost", loopboost.__version__]
    listed = subprocess.run([sys.executable, "-m", "loopboost", "model", "list", run.folder], capture_output=True, text=True, check=True)
    assert "quickstart-discrete" in listed.stdout
    usage = subprocess.run(["loopboost", "rnu"], capture_output=True, text=True)
    assert usage.returncode == 2 and "unrecognized subcommand 'rnu'" in usage.stderr
    with open("/dev/full", "w") as full:
        full_disk = subprocess.run(["loopboost", "model", "list", run.folder], stdout=full, stderr=subprocess.PIPE, text=True)
    assert full_disk.returncode == 1 and "cannot write to stdout" in full_disk.stderr, full_disk
    reader = subprocess.Popen(["loopboost", "schema", "pipeline"], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    reader.stdout.close()
    assert reader.wait() == -signal.SIGPIPE and not reader.stderr.read()


def documented(body, name=""):
    """The docstrings of a stub, by the name of the class or function."""
    for node in body:
        if isinstance(node, (ast.ClassDef, ast.FunctionDef)):
            if ast.get_docstring(node):
                yield name + node.name, ast.get_docstring(node)
            yield from documented(node.body, f"{name}{node.name}.")


def the_stub_has_the_docstrings_of_the_compiled_module(_):
    from loopboost import _loopboost

    stub = ast.parse(Path(_loopboost.__file__).with_name("_loopboost.pyi").read_text(encoding="utf-8"))
    docstrings = dict(documented(stub.body))
    assert {"Rows", "Table", "feature_names"} <= set(docstrings)
    for name, text in docstrings.items():
        compiled = inspect.getdoc(operator.attrgetter(name)(_loopboost))
        assert compiled == text, f"{name}: {compiled!r} in the module, {text!r} in the stub"


def main():
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    FOLDER.mkdir(parents=True, exist_ok=True)
    run = quickstart()
    tests = (tables_open_everywhere, logs_are_read_as_by_the_program, features_equal_the_table, models_score_as_the_program)
    program = (commands_report_errors, the_program_is_part_of_the_package, the_stub_has_the_docstrings_of_the_compiled_module)
    for test in (*tests, *program):
        test(run)
        print(f"{test.__name__}: ok")
    a_run_can_be_stopped()
    print("a_run_can_be_stopped: ok")


if __name__ == "__main__":
    main()
