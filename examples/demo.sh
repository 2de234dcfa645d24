#!/usr/bin/env bash
# The main job of dynslam on the rendered default scene: a room with people walking through it,
# tracked once as if nothing moved and once with what moves masked out.
#
#   bash examples/demo.sh [FRAMES]      default 300
#
# Installs what is missing, builds, renders, runs, and ends with a table and the path of the report.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

frames=${1:-300}
build=${DYNSLAM_BUILD_ROOT:-build}/release
out=${DYNSLAM_BUILD_ROOT:-build}/demo
jobs=${JOBS:-$(nproc)}

[[ ${DYNSLAM_SKIP_INSTALL:-0} == 1 ]] || bash cmake/install_dependencies.sh
mkdir -p "$out"
echo "building (log: $out/build.log)"
if ! { cmake --preset release -B "$build" && cmake --build "$build" --target dynslam -j "$jobs"; } \
    >"$out/build.log" 2>&1; then
  tail -n 40 "$out/build.log"
  echo "demo: the build failed" >&2
  exit 1
fi

dynslam=$build/examples/cli/dynslam
"$dynslam" scene room_walking --frames "$frames" --out "$out/scene" --overwrite
"$dynslam" run --tum "$out/scene" --system p-yolo --segmenter "recorded:$out/scene/mask" \
  --compare baseline --out "$out/run"
