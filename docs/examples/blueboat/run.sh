#!/bin/sh
# The measured BlueBoat through public commands: sh docs/examples/blueboat/run.sh [OUT], from the repository's top.
# SEATRIAL_DATA says where the data sets are; seatrial and python are those on the PATH. About a minute of CPU time.
set -eu
: "${SEATRIAL_DATA:?says where the measured data sets are}"
here=$(CDPATH= cd -- "$(dirname -- "$0")" && pwd)
out=${1:-out/blueboat}
mkdir -p "$out"

seatrial import csv "$here/blueboat.toml" "$SEATRIAL_DATA"/blueboat/*.csv --out-dir "$out/logs" --force
cd "$out"

fitted=""
for run in 218 220 222 224 230 233; do fitted="$fitted logs/fixed_00000$run.mcap"; done
unused=""
for run in 221 223 226 228 232; do unused="$unused --validate logs/fixed_00000$run.mcap"; done
boat="--start m_u=15 --start m_v=20 --start m_r=1.7 --fix y_left=-0.285 --fix y_right=0.285"
noise="--fix e_uv=0.05 --fix e_r=0.02 --fix e_psi=0.03 --fix e_xy=0.3"

# The lists are meant to be split into words.
# shellcheck disable=SC2086
{
    seatrial ident vehicle $fitted $unused $boat --out trusting
    seatrial ident vehicle $fitted $unused $boat $noise --out vehicle
    seatrial ident diagnose vehicle/model.toml $fitted $unused --out diagnosis
}
for kind in trusting vehicle diagnosis; do python "$here/fit.py" $kind/result.json; done
