#!/usr/bin/env bash
# Makes the golden files of this folder with the programs that they are to agree with. Give the
# checkouts of dorian3d/DBoW2, rmsalinas/DBow3 and rmsalinas/fbow and an empty folder to build in.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
dbow2=$1 dbow3=$2 fbow=$3 build=$4
flags=(-O2 -w -std=c++17 -I"$here" $(pkg-config --cflags opencv4))
libraries=(-lopencv_core -lopencv_features2d -lopencv_imgproc)

g++ "${flags[@]}" -DWITH_DBOW2 -I"$dbow2/include/DBoW2" -I"$dbow2/include" "$here/make_golden.cpp" \
  "$dbow2"/src/*.cpp "${libraries[@]}" -o "$build/golden_dbow2"
gcc -O2 -w -c "$dbow3/src/quicklz.c" -o "$build/quicklz.o"
g++ "${flags[@]}" -fpermissive -DWITH_DBOW3 -I"$dbow3/src" "$here/make_golden.cpp" \
  "$dbow3"/src/*.cpp "$build/quicklz.o" "${libraries[@]}" -o "$build/golden_dbow3"
g++ "${flags[@]}" -mavx -I"$fbow/src" "$here/make_golden.cpp" "$fbow/src/fbow.cpp" \
  "$fbow/src/vocabulary_creator.cpp" "${libraries[@]}" -lpthread -o "$build/golden_fbow"

cd "$build"
./golden_dbow2 train dbow2.yml.gz > /dev/null
./golden_dbow2 vectors dbow2.yml.gz | gzip -9n > dbow2_vectors.txt.gz
gunzip -kf dbow2.yml.gz
./golden_dbow3 repack dbow2.yml dbow3 > /dev/null
./golden_dbow3 vectors dbow3_packed.dbow3 | gzip -9n > dbow3_vectors.txt.gz
gzip -9nf dbow3.yml
./golden_fbow train fbow.fbow
./golden_fbow vectors fbow.fbow > fbow_vectors.txt
cp dbow2.yml.gz dbow2_vectors.txt.gz dbow3.yml.gz dbow3.dbow3 dbow3_packed.dbow3 \
  dbow3_vectors.txt.gz fbow.fbow fbow_vectors.txt "$here"
