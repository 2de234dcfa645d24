#!/usr/bin/env bash
# Runs every fuzz target for some seconds (default 60) from its corpus. New inputs stay in the build
# folder; a crash is left there and fails.
#
#   tests/fuzz/run.sh [SECONDS] [TARGET...]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
seconds=${1:-60}
shift || true
build=${DYNSLAM_FUZZ_BUILD:-build/fuzz}/fuzz
targets=("$@")
((${#targets[@]})) || targets=("$build"/*_fuzz)
for target in "${targets[@]}"; do
  name=$(basename "$target")
  found=$build/found/$name
  mkdir -p "$found"
  "$build/$name" -max_total_time="$seconds" -rss_limit_mb=512 -malloc_limit_mb=64 -timeout=10 \
    -max_len=4096 -print_final_stats=1 -artifact_prefix="$found/crash-" \
    "$found" "tests/fuzz/corpus/$name" 2>&1 | grep -E 'ERROR|SUMMARY|stat::number_of|cov:.*pulse|DONE' |
    tail -n 5
  echo "$name: ${seconds} s without a finding"
done
