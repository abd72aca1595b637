#!/bin/bash
# The work on single logs as a Slurm job array, then the merge.
#
#   sbatch deploy/slurm/ingest.sh PIPELINE.toml RUN     (or the same without sbatch, on a login node)
#
# PIPELINE.toml, RUN and the logs must be on storage that all nodes see, and `loopboost` must be in PATH on all nodes.
# Partition, account, time and memory are options of sbatch: give them to this command, and they are used for the
# array, too, if they are set in SBATCH_PARTITION, SBATCH_ACCOUNT and SBATCH_TIMELIMIT.
#
# LOOPBOOST_PLAN_ARGS   more options of `loopboost plan`, such as --model MODEL.json
# LOOPBOOST_JOBS        most jobs of the array (default 1000; Slurm's own limit is MaxArraySize)
# LOOPBOOST_RETRIES     how often a task that ends with 75 is tried again (default 5)
#
# A killed job, or one on a node that went down, is requeued by Slurm and starts its tasks again; those that are done take no time.
#SBATCH --job-name=loopboost
#SBATCH --cpus-per-task=1
#SBATCH --requeue
set -u

usage() {
    echo "usage: [sbatch] $0 PIPELINE.toml RUN" >&2
    exit 2
}

# One job of the array: the tasks I, I + N, I + 2N, ...
array_job() {
    local run=$1 plan=$2 n_jobs=$3 attempt code
    for ((attempt = 0; attempt <= ${LOOPBOOST_RETRIES:-5}; attempt++)); do
        ((attempt == 0)) || sleep $((2 ** attempt))
        RAYON_NUM_THREADS=${SLURM_CPUS_PER_TASK:-1} loopboost task "$run" --plan "$plan" --of "$n_jobs"
        code=$?
        # Only trouble with storage or inputs can go away.
        [ $code -eq 75 ] || exit $code
    done
    exit 75
}

# Plans, submits the array, and submits the merge for when all of its jobs are done.
submit() {
    local pipeline=$1 run=$2 plan n_tasks n_jobs array said
    said=$(mktemp)
    # shellcheck disable=SC2086  # Several words are several options.
    plan=$(loopboost plan "$pipeline" --out "$run" ${LOOPBOOST_PLAN_ARGS:-} 2> "$said") || {
        cat "$said" >&2
        exit 2
    }
    cat "$said" >&2
    n_tasks=$(sed -n 's/.*: \([0-9][0-9]*\) tasks\{0,1\}$/\1/p' "$said" | head -n 1)
    rm "$said"
    [ "${n_tasks:-0}" -gt 0 ] || { echo "the plan has no tasks" >&2; exit 2; }
    n_jobs=$((n_tasks < ${LOOPBOOST_JOBS:-1000} ? n_tasks : ${LOOPBOOST_JOBS:-1000}))
    array=$(sbatch --parsable --array="0-$((n_jobs - 1))" "$0" --array-job "$run" "$plan" "$n_jobs") || exit 75
    array=${array%%;*}
    # afterany: the merge lists what is missing if a task failed.
    sbatch --parsable --dependency="afterany:$array" --job-name=loopboost-merge --cpus-per-task=1 \
        "$0" --merge-job "$run" "$plan" > /dev/null || exit 75
    echo "$plan"
}

case ${1:-} in
    --array-job) [ $# -eq 4 ] || usage; array_job "$2" "$3" "$4" ;;
    --merge-job) [ $# -eq 3 ] || usage; exec loopboost merge "$2" --plan "$3" ;;
    -*) usage ;;
    *) [ $# -eq 2 ] || usage; submit "$1" "$2" ;;
esac
