#!/bin/sh
# Run the example of the measured thrusters of a ferry by public commands, from the top folder of the repository: sh
# docs/examples/milliampere/run.sh [OUT]. SEATRIAL_DATA is the folder of the data sets. seatrial and python must be on
# the PATH.
set -eu
: "${SEATRIAL_DATA:?set it to the folder of the data sets}"
here=$(CDPATH= cd -- "$(dirname -- "$0")" && pwd)
data="$SEATRIAL_DATA/milliampere/thruster_data_test"
out=${1:-out/milliampere}
mkdir -p "$out"

for k in 3 4; do
    seatrial import "$here/thruster$k.toml" "$data/actuator_ref_$k.csv" "$data/motor_state_$k.csv" \
        -o "$out/thruster$k.mcap" --force
done
cd "$out"
seatrial ident thruster thruster3.mcap --out thruster
seatrial ident diagnose thruster/model.toml thruster3.mcap --validate thruster4.mcap --out diagnosis
python "$here/figures.py" thruster3.mcap thruster4.mcap
