#!/usr/bin/env bash
# Times the database beside DBoW2's: a checkout of dorian3d/DBoW2, the build folder of the preset
# `bench`, and an empty folder to work in.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
dbow2=$1 ours=$2 work=$3
flags=(-O3 -march=native -w -std=c++17 $(pkg-config --cflags opencv4))
for file in "$dbow2"/src/{BowVector,FORB,FeatureVector,QueryResults,ScoringObject}.cpp; do
  g++ "${flags[@]}" -I"$dbow2/include/DBoW2" -I"$dbow2/include" -c "$file" \
    -o "$work/$(basename "$file" .cpp).o"
done
g++ "${flags[@]}" -I"$here" -I"$here/../../include" -I/usr/include/eigen3 \
  -I"$dbow2/include/DBoW2" -I"$dbow2/include" "$here/rivals_database.cpp" "$work"/*.o \
  "$ours"/src/loop/libdynslam_loop.* -lhwy -lz -lpthread -lopencv_core -o "$work/rivals_database"
uptime
taskset -c "${CPU:-0}" "$work/rivals_database"
uptime
