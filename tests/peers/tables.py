"""Runs the queries of docs/tables.md in a run folder and compares the results with the document.

usage: tables.py DOCS.md RUN_FOLDER [--write]

Also opens every table with Polars and pandas. `--write` updates the document instead.
"""

import glob
import os
import re
import sys

import duckdb
import pandas
import polars

document, folder = sys.argv[1:3]
text = open(document).read()
document = os.path.abspath(document)
os.chdir(folder)


def table(sql):
    result = duckdb.sql(sql)
    rows = [result.columns, ["---"] * len(result.columns), *result.fetchall()]
    return "".join("| " + " | ".join(map(str, row)) + " |\n" for row in rows)


def with_output(match):
    return f"```sql\n{match[1]}```\n\n{table(match[1])}"


queried, n = re.subn(r"```sql\n(.*?)```\n\n?(?:(?:\|[^\n]*\n)*)", with_output, text, flags=re.S)
queried = re.sub(r"\|\n+(#|$)", r"|\n\n\1", queried).rstrip() + "\n"
for path in glob.glob("**/*.parquet", recursive=True):
    rows = len(pandas.read_parquet(path))
    assert polars.read_parquet(path).height == rows and rows > 0, path
if "--write" in sys.argv:
    open(document, "w").write(queried)
assert queried == text or "--write" in sys.argv, f"{document} differs from the results of its queries (update it with --write):\n{queried}"
print(f"{n} queries agree with the document")
