# Sourced by the tests of batch systems.

# Makes short logs in FOLDER/made, the pipeline FOLDER/fleet.toml, and its tables by one process in FOLDER/whole. Messages go
# to LOG. `fail` is a function of the caller.
#
# make_logs PROGRAM FOLDER N_LOGS LOG
make_logs() {
    local program=$1 folder=$2 log=$4 names stage
    names=$(seq -f '"log-%02.0f"' -s ', ' 1 "$3")
    cat > "$folder/simulate.toml" <<T
seed = 7
[simulate]
logs = [$names]
length_m = 15.0
people = 0
T
    cat > "$folder/fleet.toml" <<T
[ingest]
logs = ["made/logs"]
pose.topic = "/ground_truth"
T
    "$program" simulate "$folder/simulate.toml" --out "$folder/made" > "$log" 2>&1 || fail simulate
    for stage in ingest subsample featurize; do
        "$program" $stage "$folder/fleet.toml" --out "$folder/whole" >> "$log" 2>&1 || fail $stage
    done
}

# Whether OUT has the bytes of FOLDER/whole, and tables of N_LOGS logs.
#
# check_tables FOLDER OUT N_LOGS
check_tables() {
    local name
    for name in "$1"/whole/{scans,poses,keyframes,features}/*.parquet; do
        cmp "$name" "$2/${name#"$1/whole/"}" || fail "other bytes"
    done
    [ "$(ls "$2/features" | wc -l)" = "$3" ] || fail "$3 logs were expected"
}
