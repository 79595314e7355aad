#!/bin/sh
# The Otter of an independent simulator through public commands: sh docs/examples/otter/run.sh [OUT], from the
# repository's top. SEATRIAL_DATA says where the data sets are; seatrial and python are those on the PATH. About six
# minutes of CPU time.
set -eu
: "${SEATRIAL_DATA:?says where the data sets are}"
here=$(CDPATH= cd -- "$(dirname -- "$0")" && pwd)
out=${1:-out/otter}
data=$(CDPATH= cd -- "$SEATRIAL_DATA/otter" && pwd)
mkdir -p "$out"
cd "$out"

thrust="--fix c1=94.649 --fix c2=25.0328 --fix y_left=-0.395 --fix y_right=0.395" # as a bench would give them

# FOLDER OUT RATE LIMIT [OPTION...]: the standard model, what it lacks, and the simulator's structure (with OPTION)
compare() {
    folder=$1 to=$2 rate=$3 most=$4 && shift 4
    seatrial import "$here/otter.toml" "$data/$folder"/*.csv --out-dir "$folder" --force
    logs="$folder/run1.mcap $folder/run2.mcap --validate $folder/run3.mcap --rate $rate"
    # The lists are meant to be split into words.
    # shellcheck disable=SC2086
    {
        seatrial ident vehicle $logs $thrust --out "$to/vehicle"
        seatrial ident diagnose "$to/vehicle/model.toml" $logs $most --out "$to/diagnosis"
        seatrial ident vehicle $logs $thrust --model "$here/hull.py:otter" "$@" --out "$to/truth"
    }
    python "$here/compare.py" "$to/diagnosis/result.json" "$to/truth/result.json"
}

compare none_pos none 10 ""
compare none_pos none_5 5 ""
compare advance_pos advance 10 "--max-effects 6" --effect advance-ratio
compare gps_latency_pos gps_latency 10 "--max-effects 6" --effect gnss-latency
