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
port=$("$python" -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])')
export RAY_TMPDIR=$dir/ray RAY_ADDRESS=127.0.0.1:$port RAY_USAGE_STATS_ENABLED=0
mkdir -p "$dir/ray" "$dir/bin"
ray=$(dirname "$python")/ray
# Ends the cluster of this test only.
cleanup() {
    for pid in ${ingest:-} $(cat "$dir/hangs" 2> /dev/null); do kill -9 "$pid" 2> /dev/null || true; done
    [ -z "${head:-}" ] || { kill -TERM "$head" && timeout 20 tail --pid="$head" -f /dev/null; } 2> /dev/null || true
    # All processes of the cluster have its folder in their command line.
    pkill -KILL -f "$dir/ray" || true
    rm -rf "$dir"
}
trap cleanup EXIT
. "$root/tests/fleet/logs.sh"
fail() {
    echo "FAILED: $*" >&2
    tail -n 40 "$dir"/*.log >&2
    exit 1
}

make_logs "$program" "$dir" 8 "$dir/whole.log"

# The first attempt at one of the tasks does not end, and says which process it is. The one at another task ends with 75.
cat > "$dir/bin/loopboost" <<P
#!/bin/bash
if [ "\$1" = task ] && [ "\${*: -1}" = 3 ] && mkdir "$dir/hung" 2> /dev/null; then
    echo \$\$ > "$dir/hangs.new" && mv "$dir/hangs.new" "$dir/hangs"
    exec sleep 1000
fi
if [ "\$1" = task ] && [ "\${*: -1}" = 5 ] && mkdir "$dir/troubled" 2> /dev/null; then exit 75; fi
exec "$program" "\$@"
P
chmod +x "$dir/bin/loopboost"
export PATH="$dir/bin:$PATH"

"$ray" start --head --block --node-ip-address=127.0.0.1 --port="$port" --num-cpus=2 --include-dashboard=false \
    --disable-usage-stats > "$dir/head.log" 2>&1 &
head=$!
for _ in $(seq 300); do grep -q 'Ray runtime started' "$dir/head.log" && break; sleep 0.1; done
"$python" "$root/deploy/ray/ingest.py" "$dir/fleet.toml" "$dir/spread" > "$dir/ingest.log" 2>&1 &
ingest=$!
for _ in $(seq 600); do [ -f "$dir/hangs" ] && break; sleep 0.1; done
[ -f "$dir/hangs" ] || fail "no task hangs"
# The worker that waits for the hanging task. Its task is done by another worker.
worker=$(ps -o ppid= -p "$(cat "$dir/hangs")" | tr -d ' ')
kill -9 "$worker" "$(cat "$dir/hangs")"
wait $ingest || fail "deploy/ray/ingest.py"
grep -q 'retries remaining' "$dir/ingest.log" || fail "no worker died"
[ -d "$dir/troubled" ] || fail "no task ended with 75"
check_tables "$dir" "$dir/spread" 8
echo "ray: 8 logs, one worker of two killed: the same tables as those of one process"
