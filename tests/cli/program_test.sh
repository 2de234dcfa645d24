#!/usr/bin/env bash
# The program `dynslam` as a user meets it: what it prints, what it leaves behind, how it fails.
#
#   program_test.sh PATH_TO_DYNSLAM SCRATCH_FOLDER
set -uo pipefail
dynslam=$1
work=$2
rm -rf "$work"
mkdir -p "$work"
cd "$work" || exit 1
failures=0

complain() {
  echo "FAILED: $1"
  failures=$((failures + 1))
}

# expect_failure CODE PATTERN ARGUMENTS...: fails with that code and one line that matches.
expect_failure() {
  local code=$1 pattern=$2 status
  shift 2
  "$dynslam" "$@" >stdout 2>stderr
  status=$?
  [[ $status == "$code" ]] || complain "dynslam $* gave $status, not $code: $(cat stderr)"
  grep -qE -- "$pattern" stderr || complain "dynslam $*: no '$pattern' in: $(cat stderr)"
  if [[ $code == 1 ]]; then
    [[ $(wc -l <stderr) == 1 && $(grep -c '^dynslam:' stderr) == 1 ]] || complain "dynslam $*: not one line: $(cat stderr)"
    [[ ! -s stdout ]] || complain "dynslam $*: printed although it failed"
  fi
}

expect_file() {
  [[ -s $1 ]] || complain "$1 is missing or empty"
}

# --- a small recording -------------------------------------------------------------------------
"$dynslam" scene room_walking --frames 12 --out scene >stdout || complain "scene"
expect_file scene/associations.txt
expect_file scene/groundtruth.txt
expect_file scene/camera.txt
[[ $(find scene/mask -name '*.png' | wc -l) == 12 ]] || complain "12 masks"

# --- run ---------------------------------------------------------------------------------------
"$dynslam" run --tum scene --system p-yolo --segmenter recorded:scene/mask --out out --json \
  >summary.json 2>stderr || complain "run: $(cat stderr)"
[[ ! -s stderr ]] || complain "run printed: $(cat stderr)"
for key in frames tracked lost keyframes map_points loops relocalizations system ate rpe time_ms \
  peak_memory_mb version; do
  grep -q "\"$key\"" summary.json || complain "summary has no $key"
done
cmp -s summary.json out/summary.json || complain "--json prints something else than summary.json"
grep -q '"tracked": 12' summary.json || complain "not all frames tracked"
for file in trajectory.txt keyframes.txt map.ply map.dynslam frames.csv summary.json report.html; do
  expect_file "out/$file"
done
[[ $(grep -vc '^#' out/trajectory.txt) == 12 ]] || complain "12 poses"
[[ $(wc -l <out/frames.csv) == 13 ]] || complain "12 rows and a header"
[[ -z $(find out -name '*.tmp*' -o -name '.dynslam*') ]] || complain "temporary files left"

# The trajectory that was written is judged the same by `eval`.
"$dynslam" eval ate scene/groundtruth.txt out/trajectory.txt --json >ate.json || complain "eval"
rmse() { sed -n 's/.*"rmse": *\([0-9.e-]*\).*/\1/p' "$1" | head -n 1; }
awk -v a="$(rmse ate.json)" -v b="$(rmse out/summary.json)" \
  'BEGIN { d = a - b; exit !(d < 1e-6 && d > -1e-6) }' || complain "eval and run disagree"

# What the system is worth without each of its parts.
"$dynslam" run --tum scene --segmenter truth --sequential --ablation --out out-parts >table \
  2>stderr || complain "run --ablation: $(cat stderr)"
for part in mask geometry weights loops; do
  grep -q "p-static without $part  *12" table || complain "no row without $part: $(cat table)"
done
grep -q 'p-static without mask' out-parts/report.html || complain "no ablation in the report"
head -n 1 out/frames.csv | grep -q 'state,features,inliers,.*mask_age,moving_features,.*rejected' ||
  complain "frames.csv lacks columns"

# A film of the run, in both formats; and what is in the way of one.
for film in film.avi film.mp4; do
  "$dynslam" run --tum scene --system p-static --segmenter truth --video "$film" --out out-film \
    >stdout 2>stderr || complain "run --video $film: $(cat stderr)"
  [[ $(stat -c %s "$film") -gt 10000 ]] || complain "$film is no film"
done
expect_failure 1 'film.gif' run --tum scene --video film.gif --out x
expect_failure 1 'folder' run --tum scene --video nowhere/film.mp4 --out x
DISPLAY='' WAYLAND_DISPLAY='' expect_failure 1 'display|window' run --tum scene --show --out x

# The map that was written is found again, left as it is, and refused where it does not suit.
"$dynslam" run --tum scene --system p-yolo --segmenter recorded:scene/mask --load out/map.dynslam \
  --localize-only --out out-found --json >summary.json 2>stderr || complain "load: $(cat stderr)"
grep -q '"localized_after_frames": [1-5],' summary.json || complain "not found within 5 frames"
cmp -s out/map.dynslam out-found/map.dynslam || complain "--localize-only changed the map"
"$dynslam" run --tum scene --system baseline --load out/map.dynslam --out out-further --json \
  >summary.json 2>stderr || complain "load and map: $(cat stderr)"
grep -q '"localized_after_frames": [1-5],' summary.json || complain "not found within 5 frames"
head -c 5000 out/map.dynslam >cut.dynslam
expect_failure 1 'cut.dynslam: no sound map' run --tum scene --load cut.dynslam --out x
expect_failure 1 'nomap' run --tum scene --load nomap --out x
expect_failure 1 'camera' run --tum scene --camera 500,500,160,120 --load out/map.dynslam --out x
expect_failure 2 'load' run --tum scene --localize-only --out x

# A truncated image is counted and skipped.
cp -r scene broken
victim=$(find broken/rgb -name '*.png' | sort | sed -n 6p)
head -c 1000 "$victim" >cut && mv cut "$victim"
"$dynslam" run --tum broken --system baseline --out out-broken --json >summary.json 2>stderr ||
  complain "run on a broken frame"
grep -q '"unreadable": 1' summary.json || complain "the broken frame is not counted"
grep -q "frame skipped: .*$(basename "$victim")" stderr || complain "the broken frame is not named"

# A segmenter that fails, at one frame or at all of them, costs masks and not the run.
cp -r scene/mask cutmask
victim=$(find cutmask -name '*.png' | sort | sed -n 6p)
head -c 100 "$victim" >cut && mv cut "$victim"
"$dynslam" run --tum scene --system p-yolo --segmenter recorded:cutmask --out out-cutmask --json \
  >summary.json 2>stderr || complain "run with a broken mask: $(cat stderr)"
grep -q '"unsegmented": 1' summary.json || complain "the broken mask is not counted"
grep -q "failed at 1 frames: .*$(basename "$victim")" stderr || complain "it is not named"
for mask in cutmask/*.png; do head -c 100 "$mask" >cut && mv cut "$mask"; done
for mode in --sequential --async; do
  "$dynslam" run --tum scene --system p-yolo --segmenter recorded:cutmask $mode --out out-cutmask \
    --json >summary.json 2>stderr || complain "run $mode without a sound mask: $(cat stderr)"
  [[ $(grep -c 'segmenter failed' stderr) == 1 ]] || complain "$mode tells of it not once"
  grep -qE '"unsegmented": [1-9]' summary.json || complain "$mode does not count broken masks"
done

# Time that runs backwards is left out and said.
cp -r scene backwards
sed -i '5{h;d};6{G}' backwards/associations.txt
"$dynslam" run --tum backwards --system baseline --out out-backwards --json >summary.json \
  2>stderr || complain "run on disordered time: $(cat stderr)"
grep -q '1 frames left out' stderr || complain "disorder is not said: $(cat stderr)"
"$dynslam" movers --tum backwards >stdout 2>stderr || complain "movers on disordered time"
grep -q '1 frames left out' stderr || complain "movers hides disorder: $(cat stderr)"

# Grey images are images, too; these show nothing.
cp -r scene grey
for image in grey/rgb/*.png; do cp "scene/mask/$(basename "$image")" "$image"; done
for command in movers 'run --system baseline --out out-grey' 'segment none'; do
  # shellcheck disable=SC2086
  "$dynslam" $command --tum grey >stdout 2>stderr || complain "$command on grey images: $(cat stderr)"
done

expect_failure 1 'loops: .*no features' loops --tum grey
expect_failure 1 'vocab train: .*no features' vocab train grey --out x.dynvoc

# Without truth there is no error, but everything else.
cp -r scene untold
rm untold/groundtruth.txt
"$dynslam" run --tum untold --system baseline --out out-untold --json >summary.json ||
  complain "run without truth"
grep -q '"ate"' summary.json && complain "an error without truth"
expect_file out-untold/report.html

# Movers are scored against the scene's own masks.
"$dynslam" movers --scene room_walking --frames 0:20 --json >movers.json || complain "movers"
grep -q '"false_positive_rate"' movers.json || complain "movers reports no rates"
"$dynslam" run --tum scene --system p-static --without geometry,weights --out out-without --json \
  >summary.json 2>stderr || complain "run without geometry"
[[ ! -s stderr ]] || complain "run without geometry printed: $(cat stderr)"
"$dynslam" run --tum scene --system baseline --without geometry --out out-without --json \
  >summary.json 2>stderr || complain "run without what is not there"
grep -q 'baseline has no geometry' stderr || complain "nothing said of a part that is not there"

mkdir nothing
expect_failure 1 'nothing/.*mask' movers --tum scene --truth-masks nothing

# Ctrl-C ends a run early and leaves what there is, as if the sequence ended there. In the
# foreground, since otherwise `timeout` signals twice, and the second Ctrl-C ends the program.
timeout --foreground --preserve-status -s INT 3 "$dynslam" run --tum scene --system baseline --runs 1000 \
  --out out-stopped >stdout 2>stderr
status=$?
[[ $status == 1 ]] || complain "an interrupted run gave $status: $(cat stderr)"
[[ $(cat stderr) == *interrupted*out-stopped* && $(wc -l <stderr) == 1 && ! -s stdout ]] ||
  complain "an interrupted run says: $(cat stderr stdout)"
for file in trajectory.txt map.dynslam frames.csv report.html; do expect_file "out-stopped/$file"; done
grep -q '"interrupted": true' out-stopped/summary.json || complain "the summary hides a Ctrl-C"

# --- ablate ------------------------------------------------------------------------------------
ablate=(ablate --tum scene --frames 0:6 --segmenter truth --systems p-yolo,p-mixed --runs 1
  --sequential --out ablation)
"$dynslam" "${ablate[@]}" >table 2>stderr || complain "ablate: $(cat stderr)"
for row in 'p-yolo  *100' 'p-mixed  *100' 'without mask' 'without rejection'; do
  grep -q "$row" table || complain "no '$row' in the ablation: $(cat table)"
done
for file in ablation.json ablation.csv ablation.html; do expect_file "ablation/$file"; done
[[ $(wc -l <ablation/ablation.csv) -ge 6 ]] || complain "a row for each cell"
# Going on after a stop: what is kept is not run again, what is missing is.
cells=$(find ablation/cells -name '*.json' | wc -l)
touch -d '2000-01-01' ablation/cells/*
rm ablation/cells/0-scene-p-mixed.json
"$dynslam" "${ablate[@]}" --json >ablation.json 2>stderr || complain "ablate again: $(cat stderr)"
cmp -s ablation.json ablation/ablation.json || complain "ablate --json prints something else"
[[ $(find ablation/cells -newermt '2001-01-01' | grep -c json) == 1 ]] || complain "kept runs ran again"
[[ $(find ablation/cells -name '*.json' | wc -l) == "$cells" ]] || complain "a cell is missing"
# Other settings are another experiment.
"$dynslam" "${ablate[@]}" --features 300 >table || complain "ablate with other features"
[[ $(find ablation/cells -newermt '2001-01-01' | grep -c json) == "$cells" ]] ||
  complain "runs of other settings were taken for these"
expect_failure 2 'tum' ablate --out x
expect_failure 1 'nowhere' ablate --tum nowhere --out x
expect_failure 1 'nomasks' ablate --tum scene --segmenter recorded:nomasks --out x

# --- loops -------------------------------------------------------------------------------------
"$dynslam" loops --tum scene --detections loops.txt --json >loops.json 2>stderr ||
  complain "loops: $(cat stderr)"
for key in queries loops_true detected precision recall recall_at_100p ms median refused; do
  grep -q "\"$key\"" loops.json || complain "loops has no $key"
done
[[ $(grep -vc '^#' loops.txt) == 12 ]] || complain "a line for each query"
expect_failure 2 'IMAGES' loops --json
expect_failure 2 'truth' loops scene/rgb
expect_failure 2 'IMAGES' loops scene/rgb --tum scene --vocabulary x
expect_failure 1 'nowhere' loops --tum nowhere
expect_failure 1 'nomatrix' loops scene/rgb --truth nomatrix.bmp
expect_failure 1 'mask.*12 images' loops scene/rgb --truth "$(find scene/mask -name '*.png' | head -n 1)"
printf 'no vocabulary' >words.txt
expect_failure 1 'words.txt' loops --tum scene --vocabulary words.txt

# --- segment -----------------------------------------------------------------------------------
# The masks that were recorded are right; three frames old and carried they still mostly are.
"$dynslam" segment recorded:scene/mask --tum scene --truth-masks scene/mask --out seg --json \
  >segment.json 2>stderr || complain "segment: $(cat stderr)"
grep -q '"mean_iou":1.0' segment.json || complain "recorded masks are not themselves"
for key in images frames_scored ms network_ms backend segmenter sha256 inputs outputs; do
  grep -q "\"$key\"" segment.json || complain "segment reports no $key"
done
[[ $(find seg/mask -name '*.png' | wc -l) == 12 ]] || complain "12 masks written"
[[ $(find seg/overlay -name '*.jpg' | wc -l) == 12 ]] || complain "12 overlays written"
"$dynslam" segment recorded:scene/mask --tum scene --truth-masks scene/mask --age 3 --json \
  >segment.json 2>stderr || complain "segment --age: $(cat stderr)"
grep -q '"age":3' segment.json || complain "segment does not say the masks' age"
grep -q '"mean_iou_fresh":1.0' segment.json || complain "no score of the frames' own masks"
awk -v iou="$(sed -n 's/.*"mean_iou":\([0-9.]*\).*/\1/p' segment.json)" 'BEGIN { exit !(iou > 0.7) }' ||
  complain "carried masks miss: $(sed -n 's/.*\("mean_iou":[^,]*\).*/\1/p' segment.json)"

# --- bench -------------------------------------------------------------------------------------
# A program that answers as a benchmark does.
mkdir programs
cat >programs/features_fake_bench <<'END'
#!/bin/sh
case "$*" in
*list_tests*) printf 'BM_%s\n' BruteForce/500/32 BruteForceOn/AVX2/500/32 OpenCvBFMatcher/500/32; exit 0 ;;
esac
cat <<'JSON'
{"context": {"num_cpus": 2, "mhz_per_cpu": 2600, "load_avg": [0.5]}, "benchmarks": [
 {"name": "BM_BruteForce/500/32", "run_type": "iteration", "real_time": 9, "cpu_time": 8, "time_unit": "us"},
 {"name": "BM_BruteForceOn/AVX2/500/32", "run_type": "iteration", "real_time": 9, "cpu_time": 10, "time_unit": "us"},
 {"name": "BM_OpenCvBFMatcher/500/32", "run_type": "iteration", "real_time": 9, "cpu_time": 0.5, "time_unit": "ms"},
 {"name": "BM_Data", "run_type": "iteration", "error_occurred": true, "error_message": "no data"}]}
JSON
END
chmod +x programs/features_fake_bench
"$dynslam" bench --programs programs --json >bench.json 2>stderr || complain "bench: $(cat stderr)"
tr -d ' \n' <bench.json >flat.json
grep -qF '"room":"features","name":"BruteForce/500/32","unit":"us","ours":{"best":8.0,"AVX2":10.0},"rivals":{"cv::BFMatcher":500.0},"floor":null' \
  flat.json || complain "bench pairs wrongly: $(cat bench.json)"
grep -qF '"problems":["features/BM_Data:nodata"]' flat.json || complain "bench hides a failure"
"$dynslam" bench features --programs programs >table 2>stderr || complain "bench features"
grep -q 'cv::BFMatcher 500' table || complain "no rival in the table: $(cat table)"
"$dynslam" bench features/BruteForce --programs programs >table || complain "bench features/BruteForce"
grep -q 'cv::BFMatcher 500' table || complain "a filter drops the rivals: $(cat table)"
expect_failure 1 'FILTER' bench Nothing --programs programs
expect_failure 1 'cmake --preset bench' bench --programs empty-programs
printf '#!/bin/sh\nexit 3\n' >programs/features_fake_bench
expect_failure 1 'ended with code 3' bench --programs programs

# --- bad input ---------------------------------------------------------------------------------
mkdir empty
expect_failure 2 'system' run --tum scene --system nonsense --out x
expect_failure 2 'out' run --tum scene
expect_failure 2 'tum' run --out x
expect_failure 2 'age' segment none --tum scene --age -1
expect_failure 2 'IMAGE' segment none
expect_failure 1 'stderr' segment none stderr
expect_failure 1 'kind|yolo-seg' segment magic:beans --tum scene
expect_failure 2 'subcommand' notacommand
expect_failure 1 'nowhere' run --tum nowhere --out x
expect_failure 1 'empty' run --tum empty --out x
expect_failure 2 'frames' run --tum scene --frames 5 --out x
expect_failure 2 'frames' run --tum scene --frames 9:4 --out x
expect_failure 1 '--frames: .*50:60.* 12,' run --tum scene --frames 50:60 --out x
expect_failure 2 'camera' run --tum scene --camera 1,2 --out x
expect_failure 1 'camera' run --scene room_still --camera 1,2,3,4 --out x
expect_failure 2 'camera.*positive' run --tum scene --camera nan,2,3,4 --out x
expect_failure 2 'camera.*positive' run --tum scene --camera 0,2,3,4 --out x
expect_failure 2 'depth-scale: Value 0 .{,60}$' run --tum scene --depth-scale 0 --out x
expect_failure 1 'room_walking' run --scene atlantis --out x
expect_failure 1 'segmenter|kind|recorded' run --tum scene --segmenter magic:beans --out x
expect_failure 1 'nomasks' run --tum scene --segmenter recorded:nomasks --out x
printf 'not a network' >model.onnx
expect_failure 1 'model.onnx' run --tum scene --segmenter yolo-seg:model.onnx --out x
: >file
expect_failure 1 'file' run --tum scene --out file/x
if [[ -c /dev/full ]]; then
  mkdir full && ln -s /dev/full full/.dynslam-probe
  expect_failure 1 'full' run --tum scene --out full
fi
cp -r scene flat
for image in flat/depth/*.png; do cp "scene/mask/$(basename "$image")" "$image"; done
expect_failure 1 'depth.*16' run --tum flat --system baseline --out x
printf '1 0 0 0 0 0 0 nan\n' >nan.txt
expect_failure 1 'nan.txt:1' eval ate scene/groundtruth.txt nan.txt
expect_failure 1 'scene' scene room_walking --frames 3 --out scene

# Numbers that wrap around, are none or are not there, and values that are not there.
for seed in -1 99999999999999999999 1.5 abc ''; do
  expect_failure 2 "^--seed: got ('$seed'|nothing), expected" run --scene room_still --seed "$seed" --out never
done
expect_failure 2 'seed.*not negative' vocab train scene --seed -1 --out x.dynvoc
expect_failure 2 'seed.*not negative' scene --seed -1 --out never
expect_failure 2 'exclude-recent.*not negative' loops --tum scene --exclude-recent -1
expect_failure 2 'frames.*not in range 1' scene --frames 0 --out never
expect_failure 2 'threads.*not in range 1' scene --threads 0 --out never
expect_failure 2 'score.*finite' segment none --tum scene --score nan
expect_failure 2 'depth-scale.*finite' run --tum scene --depth-scale nan --out never
expect_failure 2 'max-dt' eval ate scene/groundtruth.txt scene/groundtruth.txt --max-dt ''
expect_failure 2 'out.*nothing' run --tum scene --out ''
expect_failure 2 'frames.*nothing' run --tum scene --frames '' --out never
expect_failure 2 "^--rule: got 'beans'|^--rule: got beans" match --tum scene --rule beans
"$dynslam" run --tum scene --frames 0:2 --threads 1000 --system baseline --out out-threads >stdout \
  2>stderr || complain "run --threads 1000"
[[ ! -s stderr ]] || complain "more threads than processors: $(cat stderr)"
[[ ! -e never ]] || complain "what failed has left its folder"

# Nothing that was asked for is lost in silence.
if [[ -c /dev/full ]]; then
  for command in 'eval ate scene/groundtruth.txt scene/groundtruth.txt' \
    'match --tum scene --gap 2 --json' 'run --tum scene --frames 0:2 --json --out out-full'; do
    # shellcheck disable=SC2086
    "$dynslam" $command >/dev/full 2>stderr && complain "$command: lost what it printed"
    [[ $(cat stderr) == 'dynslam: the output cannot be written' ]] || complain "$command: $(cat stderr)"
  done
  expect_failure 1 '/dev/full: cannot be written' loops --tum scene --detections /dev/full
fi

# --- vocab -------------------------------------------------------------------------------------
"$dynslam" vocab train scene --k 5 --levels 3 --features 300 --out small.dynvoc --json >voc.json \
  2>stderr || complain "vocab train: $(cat stderr)"
for key in words nodes k levels descriptor_bytes weighting scoring bytes words_missing descriptors; do
  grep -q "\"$key\"" voc.json || complain "vocab train says no $key"
done
grep -q '"images":12' voc.json || complain "vocab train took masks or depth for pictures: $(cat voc.json)"
for ending in txt yml yml.gz dbow3 fbow; do
  "$dynslam" vocab convert small.dynvoc "small.$ending" >stdout || complain "vocab convert to $ending"
  "$dynslam" vocab convert "small.$ending" back.dynvoc >stdout || complain "vocab convert from $ending"
  cmp -s small.dynvoc back.dynvoc || complain "$ending and back is another vocabulary"
done
"$dynslam" vocab convert small.dynvoc packed.dbow3 --compress >stdout || complain "vocab --compress"
"$dynslam" vocab info packed.dbow3 --json >voc.json || complain "vocab info"
grep -q '"load_ms"' voc.json || complain "vocab info says no load_ms"
expect_failure 2 'subcommand' vocab
expect_failure 2 'k' vocab train scene --k 1 --out x.dynvoc
expect_failure 2 'x.bin.*dynvoc' vocab train scene --out x.bin
expect_failure 2 'x.bin.*dynvoc' vocab convert small.dynvoc x.bin
expect_failure 1 'nowhere' vocab train nowhere --out x.dynvoc
expect_failure 1 'holds neither' vocab train empty --out x.dynvoc
expect_failure 1 'nowhere' vocab info nowhere
expect_failure 1 'voc.json' vocab info voc.json
head -c 500 small.dynvoc >cut.dynvoc
expect_failure 1 'cut.dynvoc' vocab info cut.dynvoc
expect_failure 1 'compress' vocab convert small.dynvoc x.txt --compress

for subcommand in run ablate bench fuse eval segment match movers loops scene "vocab train" "vocab convert" "vocab info"; do
  # shellcheck disable=SC2086
  "$dynslam" $subcommand --help >stdout || complain "$subcommand --help"
  grep -q 'Example' stdout || complain "$subcommand --help shows no example"
done

"$dynslam" --help | grep -q 'Exit codes: 0 .* 1 .* 2 ' || complain "--help does not say what exit codes mean"

((failures == 0)) && echo "all good"
exit $((failures > 0))
