#!/usr/bin/env bash
# Times vocabularies beside FBoW and DBoW2: checkouts of rmsalinas/fbow and dorian3d/DBoW2, the
# build folder of the preset `bench`, and an empty folder to work in.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
fbow=$1 dbow2=$2 ours=$3 work=$4
# Both rivals at their best on this machine: FBoW counts bits in software without -march=native.
flags=(-O3 -march=native -w -std=c++17 $(pkg-config --cflags opencv4))
for file in "$fbow/src/fbow.cpp" "$dbow2"/src/*.cpp; do
  g++ "${flags[@]}" -I"$fbow/src" -I"$dbow2/include/DBoW2" -I"$dbow2/include" -c "$file" \
    -o "$work/$(basename "$(dirname "$(dirname "$file")")")_$(basename "$file" .cpp).o"
done
g++ "${flags[@]}" -I"$here" -I"$here/../../include" -I/usr/include/eigen3 -I"$fbow/src" \
  -I"$dbow2/include/DBoW2" -I"$dbow2/include" "$here/rivals.cpp" "$work"/*.o \
  "$ours"/src/loop/libdynslam_loop.* -lhwy -lz -lpthread -lopencv_core -o "$work/rivals"
uptime
taskset -c "${CPU:-0}" "$work/rivals" "$work"
uptime
