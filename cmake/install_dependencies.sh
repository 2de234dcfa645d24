#!/usr/bin/env bash
# Installs what building and testing dynslam takes on Debian 12. See --help.
set -euo pipefail

packages=(
  # tools
  g++ clang libclang-rt-14-dev clang-format-14 clang-tidy-14 cmake ninja-build ccache git
  # what the library stands on: all of it for all rooms, Eigen alone for core
  libeigen3-dev libopencv-dev libopencv-contrib-dev libceres-dev libsuitesparse-dev libhwy-dev zlib1g-dev
  # tests, benchmarks, the command line program, reports
  libgtest-dev libbenchmark-dev libcli11-dev nlohmann-json3-dev gnuplot-nox
)

# ONNX Runtime is not in Debian 12. This npm package carries its shared library for Linux and,
# for iOS, its headers, both of one release.
onnxruntime_package=com.github.asus4.onnxruntime
onnxruntime_version=0.4.9
onnxruntime_sha512=064cf176e499f4891e0cfe90f25cf64c553689eee1492bd2ed921fccca28131a2ad02373267bae19a509ec8b288c182a3b8a2e0f58d76a1f0e63225b08ddbd16

usage() {
  cat <<'HELP'
usage: cmake/install_dependencies.sh [--dry-run] [--onnxruntime [--prefix DIR]]

Installs the Debian packages that dynslam is built and tested with, those that are missing
only, with apt-get (as root, or through sudo).

  --dry-run      say what would be done and do nothing
  --onnxruntime  also get ONNX Runtime, through npm, into a prefix of its own
  --prefix DIR   that prefix; default ${XDG_CACHE_HOME:-~/.cache}/dynslam/onnxruntime, where
                 CMake looks by itself; for another one pass -DDYNSLAM_ONNXRUNTIME_DIR=DIR
  --help         this text
HELP
}

die() {
  echo "install_dependencies: $*" >&2
  exit 1
}

dry_run=false
with_onnxruntime=false
prefix=""
while (($# > 0)); do
  case "$1" in
    --dry-run) dry_run=true ;;
    --onnxruntime) with_onnxruntime=true ;;
    --prefix)
      (($# > 1)) || die "--prefix needs a directory"
      prefix=$2
      shift
      ;;
    --help | -h)
      usage
      exit 0
      ;;
    *) die "unknown option \"$1\"; see --help" ;;
  esac
  shift
done
if [[ -n $prefix ]] && ! $with_onnxruntime; then
  die "--prefix goes with --onnxruntime"
fi
if [[ -z $prefix ]]; then
  prefix=${XDG_CACHE_HOME:-${HOME:?}/.cache}/dynslam/onnxruntime
fi

is_installed() {
  [[ $(dpkg-query -W -f='${db:Status-Status}' "$1" 2>/dev/null) == installed ]]
}

install_packages() {
  local missing=() package as_root=()
  for package in "$@"; do
    is_installed "$package" || missing+=("$package")
  done
  if ((${#missing[@]} == 0)); then
    echo "All $# Debian packages are installed."
    return
  fi
  echo "Missing Debian packages: ${missing[*]}"
  if ((EUID != 0)); then
    as_root=(sudo)
  fi
  local install=("${as_root[@]}" env DEBIAN_FRONTEND=noninteractive
    apt-get install -y --no-install-recommends "${missing[@]}")
  if $dry_run; then
    echo "Would run: ${as_root[*]} apt-get update"
    echo "Would run: ${install[*]}"
    return
  fi
  if ((EUID != 0)) && ! command -v sudo >/dev/null; then
    die "not root and no sudo; as root run: apt-get install ${missing[*]}"
  fi
  "${as_root[@]}" apt-get update </dev/null
  "${install[@]}" </dev/null
}

install_onnxruntime() {
  [[ $(uname -s)-$(uname -m) == Linux-x86_64 ]] ||
    die "the ONNX Runtime package has a library for Linux on x86-64 only"
  local stamp=$prefix/PACKAGE wanted="$onnxruntime_package $onnxruntime_version"
  if [[ -f $stamp && $(<"$stamp") == "$wanted" ]]; then
    echo "ONNX Runtime is in $prefix."
    return
  fi
  if $dry_run; then
    echo "Would get $onnxruntime_package@$onnxruntime_version through npm (150 MB)" \
      "and put its headers and library into $prefix"
    return
  fi

  local work
  work=$(mktemp -d)
  # shellcheck disable=SC2064  # the name is to be expanded now
  trap "rm -rf '$work'" EXIT
  echo "Getting $onnxruntime_package@$onnxruntime_version"
  (cd "$work" && npm pack --silent "$onnxruntime_package@$onnxruntime_version" </dev/null)
  local archive=$work/$onnxruntime_package-$onnxruntime_version.tgz
  [[ -f $archive ]] || die "npm did not deliver $(basename "$archive")"
  echo "$onnxruntime_sha512  $archive" | sha512sum --check --quiet ||
    die "the ONNX Runtime package is not the one this script was written for"

  local frameworks='package/Plugins/iOS~/onnxruntime.xcframework'
  local headers="$frameworks/ios-arm64/onnxruntime.framework/Headers"
  local libraries='package/Plugins/Linux/x64'
  tar -xzf "$archive" -C "$work" "$headers" "$libraries" package/LICENSE
  mkdir -p "$prefix/include" "$prefix/lib"
  cp "$work/$headers"/*.h "$prefix/include/"
  cp "$work/$libraries"/*.so "$prefix/lib/"
  ln -sf libonnxruntime.so "$prefix/lib/libonnxruntime.so.1" # the name programs load it by
  cp "$work/package/LICENSE" "$prefix/LICENSE"
  echo "$wanted" >"$stamp"
  echo "ONNX Runtime is in $prefix."
}

command -v dpkg-query >/dev/null ||
  die "this is not a Debian system; install what corresponds to: ${packages[*]}"
if $with_onnxruntime && ! command -v npm >/dev/null; then
  packages+=(npm)
fi
install_packages "${packages[@]}"
if $with_onnxruntime; then
  install_onnxruntime
fi
