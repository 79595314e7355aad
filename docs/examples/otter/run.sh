#!/bin/sh
# Run the example of the simulated Otter by public commands, from the top folder of the repository:
# sh docs/examples/otter/run.sh [OUT]. SEATRIAL_DATA is the folder of the data sets. seatrial and python must be on the
# PATH. The example takes about six minutes of CPU time.
set -eu
: "${SEATRIAL_DATA:?set it to the folder of the data sets}"
here=$(CDPATH= cd -- "$(dirname -- "$0")" && pwd)
out=${1:-out/otter}
data=$(CDPATH= cd -- "$SEATRIAL_DATA/otter" && pwd)
mkdir -p "$out"
cd "$out"

thrust="--fix c1=94.649 --fix c2=25.0328 --fix y_left=-0.395 --fix y_right=0.395" # values that a bench test would give

# FOLDER OUT RATE LIMIT [OPTION...]: fit the standard model, its search for effects, and with OPTION the structure of
# the simulator
compare() {
    folder=$1 to=$2 rate=$3 most=$4 && shift 4
    seatrial import "$here/otter.toml" "$data/$folder"/*.csv --out-dir "$folder" --force
    logs="$folder/run1.mcap $folder/run2.mcap --validate $folder/run3.mcap --rate $rate"
    # The shell must split the lists into words.
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
