#!/bin/sh
# Run the example of the measured Kingfisher by public commands, from the top folder of the repository:
# sh docs/examples/kingfisher/run.sh [OUT]. SEATRIAL_DATA is the folder of the data sets. seatrial and python must be on
# the PATH. The example takes about half a minute of CPU time.
set -eu
: "${SEATRIAL_DATA:?set it to the folder of the data sets}"
here=$(CDPATH= cd -- "$(dirname -- "$0")" && pwd)
out=${1:-out/kingfisher}
data=$(CDPATH= cd -- "$SEATRIAL_DATA/kingfisher" && pwd)
mkdir -p "$out"
cd "$out"

seatrial import "$here/bollard.toml" "$data/bollard_loadcell_raw_20files.csv" --out-dir logs --force
seatrial import "$here/surge_steps.toml" "$data"/surge_*.csv --out-dir logs --force
seatrial import "$here/surge_rest.toml" "$data"/surge_*.csv --out-dir logs --force
seatrial ident thruster logs/bollard_loadcell_raw_20files.mcap --settle 0 --out thruster

unseen=""
for log in logs/surge_rest_*.mcap; do unseen="$unseen --validate $log"; done
curve="--thruster thruster/model.toml --test-homogeneity m_u"
# The shell must split the lists into words.
# shellcheck disable=SC2086
for name in immediate delayed lagged loss cubic both shifted; do
    seatrial ident vehicle logs/surge_steps_*.mcap --model "$here/surge_model.py:$name" $curve $unseen --out $name
done
# shellcheck disable=SC2086
seatrial ident vehicle logs/surge_*.mcap --model "$here/surge_model.py:both" $curve --out all
python "$here/figures.py" . .
