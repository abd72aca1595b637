#!/bin/bash
# Two Ray workers on this machine do the tasks of eight logs, while one of them is killed. The tables are those of
# `loopboost run`.
#
# usage: tests/fleet/ray.sh LOOPBOOST PYTHON
#
# LOOPBOOST is the program, PYTHON has the package `ray`.
set -euo pipefail
program=$(realpath "$1")
python=$(realpath -s "$2")
root=$(realpath "$(dirname "$0")/../..")
dir=$(mktemp -d)
export RAY_TMPDIR=$dir/ray RAY_ADDRESS=127.0.0.1:6399 RAY_USAGE_STATS_ENABLED=0
export RAY_health_check_period_ms=1000 RAY_health_check_failure_threshold=3
mkdir -p "$dir/ray" "$dir/bin"
ray=$(dirname "$python")/ray
cleanup() {
    "$ray" stop --force > /dev/null 2>&1 || true
    rm -rf "$dir"
}
trap cleanup EXIT
fail() {
    echo "FAILED: $*" >&2
    tail -n 40 "$dir"/*.log >&2
    exit 1
}

names=$(seq -f '"log-%g"' -s ', ' 1 8)
cat > "$dir/simulate.toml" <<T
seed = 7
[simulate]
logs = [$names]
length_m = 15.0
people = 0
T
cat > "$dir/fleet.toml" <<T
[ingest]
logs = ["made/logs"]
pose.topic = "/ground_truth"
T
"$program" simulate "$dir/simulate.toml" --out "$dir/made" > "$dir/whole.log" 2>&1 || fail simulate
for stage in ingest subsample featurize; do
    "$program" $stage "$dir/fleet.toml" --out "$dir/whole" >> "$dir/whole.log" 2>&1 || fail $stage
done

# The first attempt at one of the tasks does not end, and says which process it is.
cat > "$dir/bin/loopboost" <<P
#!/bin/bash
if [ "\$1" = task ] && [ "\${*: -1}" = 3 ] && mkdir "$dir/hung" 2> /dev/null; then
    echo \$\$ > "$dir/hangs.new" && mv "$dir/hangs.new" "$dir/hangs"
    exec sleep 1000
fi
exec "$program" "\$@"
P
chmod +x "$dir/bin/loopboost"
export PATH="$dir/bin:$PATH"

"$ray" start --head --node-ip-address=127.0.0.1 --port=6399 --num-cpus=2 --include-dashboard=false --disable-usage-stats > "$dir/head.log" 2>&1 ||
    fail "ray start"
"$python" "$root/deploy/ray/ingest.py" "$dir/fleet.toml" "$dir/spread" > "$dir/ingest.log" 2>&1 &
ingest=$!
for _ in $(seq 600); do [ -f "$dir/hangs" ] && break; sleep 0.1; done
[ -f "$dir/hangs" ] || fail "no task hangs"
# The worker that waits for the hanging task. Its task is done by another worker.
worker=$(ps -o ppid= -p "$(cat "$dir/hangs")" | tr -d ' ')
kill -9 "$worker" "$(cat "$dir/hangs")"
wait $ingest || fail "deploy/ray/ingest.py"
grep -q 'retries remaining' "$dir/ingest.log" || fail "no task was tried again"
for kind in scans poses keyframes features; do
    diff -rq "$dir/whole/$kind" "$dir/spread/$kind" || fail "$kind differs"
done
echo "ray: 8 logs, one worker of two killed: the same tables as those of one process"
