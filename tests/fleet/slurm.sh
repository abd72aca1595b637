#!/bin/bash
# A Slurm cluster of three nodes on this machine does the tasks of 24 logs, while one node is killed and the daemon of
# another one is killed while its job hangs. The tables are those of `loopboost run`.
#
# usage: tests/fleet/slurm.sh LOOPBOOST
#
# LOOPBOOST is the program. Needs root, and installs Slurm and munge on Debian if they are missing. About three minutes, in
# most of which Slurm waits before it starts the jobs of a lost node again.
set -euo pipefail
program=$(realpath "$1")
root=$(realpath "$(dirname "$0")/../..")
dir=$(mktemp -d)
if ! command -v slurmctld > /dev/null; then
    apt-get update -qq
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
        slurmctld slurmd slurm-client munge > /dev/null
fi
pids=()
cleanup() {
    for pid in "${pids[@]}"; do kill -9 "$pid" 2> /dev/null || true; done
    if [ -f "$dir/run/munged.pid" ]; then kill "$(cat "$dir/run/munged.pid")" 2> /dev/null || true; fi
    rm -rf "$dir"
}
trap cleanup EXIT
. "$root/tests/fleet/logs.sh"
fail() {
    echo "FAILED: $*" >&2
    tail -n 30 "$dir"/log/*.log "$dir"/slurm-*.out >&2 2> /dev/null || true
    exit 1
}

# Twenty-four short logs. `loopboost` is found by the jobs, and hangs where a file says so.
mkdir -p "$dir"/{bin,run,log,state,munge,drives}
make_logs "$program" "$dir/drives" 24 "$dir/log/whole.log"
cat > "$dir/bin/loopboost" <<P
#!/bin/bash
# The first attempts at two of the tasks do not end.
if [ "\$1" = task ] && mkdir "$dir/hung-\${SLURM_ARRAY_TASK_ID:-none}" 2> /dev/null; then
    case \$SLURM_ARRAY_TASK_ID in 4 | 9) echo "\$SLURMD_NODENAME \$\$" > "$dir/hangs-\$SLURM_ARRAY_TASK_ID"; exec sleep 1000 ;; esac
fi
exec "$program" "\$@"
P
chmod +x "$dir/bin/loopboost"
export PATH="$dir/bin:$PATH"

# The cluster.
host=$(hostname -s)
cat > "$dir/slurm.conf" <<C
ClusterName=fleet
SlurmctldHost=$host(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket=$dir/munge/munge.socket
StateSaveLocation=$dir/state
SlurmdSpoolDir=$dir/spool-%n
SlurmctldPidFile=$dir/run/slurmctld.pid
SlurmdPidFile=$dir/run/slurmd-%n.pid
SlurmctldLogFile=$dir/log/slurmctld.log
SlurmdLogFile=$dir/log/slurmd-%n.log
SlurmctldPort=16817
ProctrackType=proctrack/pgid
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
ReturnToService=2
SlurmdTimeout=10
InactiveLimit=0
KillWait=2
MinJobAge=3600
SchedulerType=sched/builtin
SchedulerParameters=batch_sched_delay=0,sched_interval=1
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
JobRequeue=1
NodeName=n1 NodeHostname=$host NodeAddr=127.0.0.1 Port=17001 CPUs=1 RealMemory=100 State=UNKNOWN
NodeName=n2 NodeHostname=$host NodeAddr=127.0.0.1 Port=17002 CPUs=1 RealMemory=100 State=UNKNOWN
NodeName=n3 NodeHostname=$host NodeAddr=127.0.0.1 Port=17003 CPUs=1 RealMemory=100 State=UNKNOWN
PartitionName=p Nodes=n1,n2,n3 Default=YES MaxTime=INFINITE State=UP
C
export SLURM_CONF="$dir/slurm.conf"
head -c 1024 /dev/urandom > "$dir/munge/key"
chmod 755 "$dir"
chown -R munge "$dir/munge"
chmod 400 "$dir/munge/key"
chmod 755 "$dir/munge"
mkdir "$dir/run/munge" && chown munge "$dir/run/munge"
runuser -u munge -- munged --key-file="$dir/munge/key" --socket="$dir/munge/munge.socket" \
    --pid-file="$dir/run/munge/munged.pid" --log-file="$dir/munge/munged.log" --seed-file="$dir/munge/seed" -f
pids+=("$(cat "$dir/run/munge/munged.pid")")
slurmctld -f "$SLURM_CONF" -c -D > "$dir/log/ctld.out" 2>&1 &
pids+=($!)
declare -A slurmd
for node in n1 n2 n3; do
    slurmd -N $node -f "$SLURM_CONF" -D > "$dir/log/$node.out" 2>&1 &
    slurmd[$node]=$!
    pids+=($!)
done
for _ in $(seq 60); do
    [ "$(sinfo -h -N -t idle -o %N 2> /dev/null | sort -u | wc -l)" = 3 ] && break
    sleep 1
done
[ "$(sinfo -h -N -t idle -o %N | sort -u | wc -l)" = 3 ] || fail "the cluster did not start"

# The tasks.
cd "$dir"
start=$SECONDS
sbatch "$root/deploy/slurm/ingest.sh" "$dir/drives/fleet.toml" "$dir/drives/out"
wait_for() {
    for _ in $(seq "$1"); do
        if eval "$2"; then return; fi
        sleep 1
    done
    fail "$3"
}
# A node is killed with its job: the daemon, the script and what it runs.
wait_for 120 '[ -s "$dir/hangs-4" ]' "task 4 did not start"
read -r node pid < "$dir/hangs-4"
steps=$(pgrep -f "slurmstepd: \[[0-9]*\.batch\]" || true)
echo "killing node $node"
kill -9 "${slurmd[$node]}"
for step in $steps; do
    # The step daemon of that job is an ancestor of the hanging process.
    ancestor=$pid
    while [ "${ancestor:-1}" -gt 1 ]; do
        [ "$ancestor" = "$step" ] && kill -9 "$step"
        ancestor=$(ps -o ppid= -p "$ancestor" 2> /dev/null | tr -d ' ')
    done
done
kill -9 "$pid"
first=$node
# The daemon of another node is killed while its job hangs and goes on hanging.
wait_for 120 '[ -s "$dir/hangs-9" ]' "task 9 did not start"
read -r node pid < "$dir/hangs-9"
pids+=("$pid")
echo "killing the daemon of node $node"
kill -9 "${slurmd[$node]}"
# Both nodes are declared down, and their jobs are started again. The hanging process stays: two attempts at once.
wait_for 120 '[ "$(sinfo -h -N -t down -o %N | sort -u | wc -l)" = 2 ]' "the nodes are not down: $(sinfo)"
kill -0 "$pid" || fail "the hanging job ended"
for lost in "$first" "$node"; do
    slurmd -N "$lost" -f "$SLURM_CONF" -D > "$dir/log/$lost-2.out" 2>&1 &
    pids+=($!)
done
wait_for 300 '[ -z "$(squeue -h)" ]' "jobs are left: $(squeue)"
echo "$((SECONDS - start)) s"
check_tables "$dir/drives" "$dir/drives/out" 24
echo "24 logs, two nodes lost: the same bytes as in one process"
