#!/bin/bash
# Builds the wheel of the Python package, installs it where no Rust is, and tests it there.
#
# usage: tests/python.sh BIN
#
# BIN is the folder with the programs maturin and python-zig of the packages `maturin` and `ziglang`.
set -euo pipefail
root=$(realpath "$(dirname "$0")/..")
PATH=$(realpath -s "$1"):$PATH
cd "$root"

cargo clippy -q --release --locked --manifest-path python/Cargo.toml --target-dir target -- -D warnings

rm -rf target/wheels target/fresh target/python-test
# Zig's C compiler links with the symbols of an old glibc, so that the wheel also works on older systems.
maturin build -q --release --locked --zig --compatibility manylinux_2_17 --manifest-path python/Cargo.toml \
    --target-dir target --out target/wheels
python3 -m venv target/fresh
target/fresh/bin/pip install -q target/wheels/*manylinux*.whl 'polars>=1' 'pyarrow>=18' 'pandas>=2' 'duckdb>=1.3' 'mypy>=1.18'

# Not from the repository, which contains a folder `python/loopboost` without the compiled part.
mkdir target/python-test
cd target/python-test
../fresh/bin/python -m mypy.stubtest loopboost._loopboost
../fresh/bin/python -m mypy --strict --no-warn-return-any -p loopboost
env -i HOME="$HOME" PATH=/usr/bin:/bin ../fresh/bin/python "$root/python/tests/test_package.py" "$root" "$PWD/runs"
