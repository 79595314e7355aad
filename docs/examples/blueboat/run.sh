#!/bin/sh
# Run the example of the measured BlueBoat by public commands, from the top folder of the repository: sh
# docs/examples/blueboat/run.sh [OUT]. SEATRIAL_DATA is the folder of the data sets. seatrial and python must be on the
# PATH. The example takes about twelve minutes of CPU time.
set -eu
: "${SEATRIAL_DATA:?set it to the folder of the data sets}"
here=$(CDPATH= cd -- "$(dirname -- "$0")" && pwd)
out=${1:-out/blueboat}
mkdir -p "$out"

seatrial import "$here/blueboat.toml" "$SEATRIAL_DATA"/blueboat/*.csv --out-dir "$out/logs" --force
cd "$out"

fitted=""
for run in 218 220 222 224 230 233; do fitted="$fitted logs/fixed_00000$run.mcap"; done
unused=""
for run in 221 223 226 228 232; do unused="$unused --validate logs/fixed_00000$run.mcap"; done
boat="--model horizontal:force --initial m_u=15 --initial m_v=20 --initial m_r=1.7 --fix y_left=0.285 --fix y_right=-0.285"
noise="--fix e_uv=0.05 --fix e_r=0.02 --fix e_psi=0.03 --fix e_xy=0.3"

# The shell must split the lists into words.
# shellcheck disable=SC2086
{
    seatrial ident vehicle $fitted $unused $boat --out trusting
    seatrial ident vehicle $fitted $unused $boat $noise --out vehicle
    seatrial ident diagnose vehicle/model.toml $fitted $unused --out diagnosis
    # the inputs are the commands as shaft speeds, not the authors' force
    few="" && for run in 218 221 224 232 233; do few="$few logs/fixed_00000$run.mcap"; done
    other="--validate logs/fixed_00000220.mcap --validate logs/fixed_00000230.mcap"
    start="--fix y_left=0.15 --fix y_right=-0.15 --fix c1=41.4 --fix c2=13.8 --initial m_u=15 --initial m_v=20 --prior m_r=3:2"
    seatrial ident vehicle $few $other --model horizontal:shaft:no-current $start $noise --out shaft
    seatrial ident diagnose shaft/model.toml $few $other --max-effects 1 --out compass
}
for kind in trusting vehicle diagnosis; do python "$here/fit.py" $kind/result.json; done
python "$here/leave_one_out.py" logs/*.mcap --out leave_one_out.json
for e in 0.4 0.2 0.1 0.05; do # dependence of sway on the weight of the heading in the fit
    echo "e_drift $e"
    python "$here/leave_one_out.py" logs/*.mcap --model boat --fix e_drift=$e | grep "boat, left out"
done
python "$here/figures.py" leave_one_out.json .
python "$here/leave_one_out.py" logs/*.mcap --nested --out nested.json # expected errors; half of the time
