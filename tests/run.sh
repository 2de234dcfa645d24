#!/usr/bin/env bash
# The whole test of dynslam on Debian 12, from the compilers to the installed package.
#
#   tests/run.sh
#
# Environment:
#   JOBS                parallel jobs; default: every processor
#   DYNSLAM_BUILD_ROOT  where builds go; default: build
#   DYNSLAM_DATA        data sets for the tests that use them
#   DYNSLAM_SKIP_INSTALL=1  do not look for missing Debian packages
#
# Stops at the first failure. The last line says how many checks passed: every test and every step
# that does not run tests counts one.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
exec </dev/null

source_dir=$PWD
jobs=${JOBS:-$(nproc)}
mkdir -p "${DYNSLAM_BUILD_ROOT:-build}"
build_root=$(cd "${DYNSLAM_BUILD_ROOT:-build}" && pwd)
logs=$build_root/logs
mkdir -p "$logs"

passed=0
skipped=0
step=""
step_started=0

# --- reporting -------------------------------------------------------------------------------
begin() {
  step=$1
  step_started=$SECONDS
  printf '\n=== %s\n' "$step"
}

end() { # [what]
  printf '    %s(%d s)\n' "${1:+$1 }" $((SECONDS - step_started))
}

pass() {
  passed=$((passed + 1))
  end "ok"
}

skip() {
  printf '    skipped: %s\n' "$1"
}

fail() { # message [log]
  if [[ -n ${2:-} && -f ${2:-} ]]; then
    grep -nE 'error|Error|FAILED|\*\*\*Failed' "$2" | head -n 20 || true
    printf -- '--- the end of %s\n' "$2"
    tail -n 60 "$2"
  fi
  printf '\nFAILED: %s: %s\n' "$step" "$1"
  printf '%d passed, 1 failed\n' "$passed"
  trap - EXIT
  exit 1
}

on_exit() {
  local status=$?
  if ((status != 0)); then
    printf '\nFAILED: %s: exit status %d\n%d passed, 1 failed\n' \
      "${step:-start}" "$status" "$passed"
  fi
  exit "$status"
}
trap on_exit EXIT

# Runs a command into a log; shows the log if the command fails.
quietly() { # log command...
  local log=$1
  shift
  "$@" >"$log" 2>&1 || fail "$(printf '%q ' "$@")" "$log"
}

present() { # room: has it landed in this tree?
  [[ -f src/$1/CMakeLists.txt ]]
}

# --- what the steps are made of --------------------------------------------------------------
check_format() {
  begin "clang-format"
  local clang_format files offenders=()
  clang_format=$(command -v clang-format-14 || command -v clang-format) ||
    fail "clang-format is missing"
  [[ $("$clang_format" --version) == *"version 14."* ]] ||
    fail "clang-format 14 is needed, this is $("$clang_format" --version)"
  if git rev-parse --is-inside-work-tree >/dev/null 2>&1; then
    mapfile -t files < <(git ls-files '*.hpp' '*.cpp')
  else
    mapfile -t files < <(find benchmarks examples include src tests -name '*.[hc]pp' 2>/dev/null)
  fi
  mapfile -t offenders < <(printf '%s\0' "${files[@]}" |
    xargs -0 -n 20 -P "$jobs" "$clang_format" --dry-run 2>&1 |
    sed -nE 's/^([^:]+):[0-9]+:[0-9]+: warning: code should be clang-formatted.*/\1/p' | sort -u)
  if ((${#offenders[@]} > 0)); then
    printf '    not formatted: %s\n' "${offenders[@]}"
    fail "${#offenders[@]} of ${#files[@]} files; run: clang-format-14 -i <file>"
  fi
  echo "    ${#files[@]} files"
  pass
}

build_preset() { # preset header_standard cmake_arguments...
  local preset=$1 standard=$2
  shift 2
  begin "configure $preset"
  quietly "$logs/$preset-configure.log" cmake --preset "$preset" -B "$build_root/$preset" \
    -DDYNSLAM_HEADER_CHECK_STANDARDS="$standard" -DDYNSLAM_JOIN_SOURCES=ON "$@"
  grep -E '^-- (dynslam|The CXX)' "$logs/$preset-configure.log" | sed 's/^-- /    /'
  pass
  begin "build $preset"
  quietly "$logs/$preset-build.log" \
    cmake --build "$build_root/$preset" --parallel "$jobs" --target all header_checks
  pass
}

test_preset() { # preset options_of_ctest...
  begin "ctest $1"
  local log=$logs/$1-test.log report=$logs/$1-test.xml rooms=$build_root/$1/tests/results
  rm -rf "$report" "$rooms"
  ctest --test-dir "$build_root/$1" --output-on-failure --parallel "$jobs" \
    --no-tests=error --output-junit "$report" "${@:2}" >"$log" 2>&1 || fail "$log says what" "$log"
  # A room is one test of ctest and lists its own in a file: those count, and every other test.
  count() { # attribute files...
    { grep -h "<testcase .*$1" "${@:2}" || true; } | wc -l
  }
  local total not_run
  total=$(($(count 'status="run"' "$report" "$rooms"/*.xml) - $(ls "$rooms" | wc -l)))
  not_run=$(count 'result="skipped"' "$rooms"/*.xml)
  passed=$((passed + total - not_run))
  skipped=$((skipped + not_run))
  sed -nE 's/.*<skipped message="([^"]*)&#x0A;([^"]*)".*/    \1: \2/p' "$rooms"/*.xml
  end "$((total - not_run)) tests passed, $not_run did not run"
}

# A project in tests/package that uses dynslam: configure, build, run.
consumer() { # directory name cmake_arguments...
  local directory=$1 name=$2
  shift 2
  begin "consumer $name"
  local build=$build_root/consumers/$name log=$logs/consumer-$name.log
  rm -rf "$build"
  quietly "$log" cmake -S "tests/package/$directory" -B "$build" -G Ninja \
    -DCMAKE_BUILD_TYPE=Release "$@"
  quietly "$log" cmake --build "$build" --parallel "$jobs"
  quietly "$log" env -C "$build" ./consumer
  pass
}

# A configuration that has to stop with a certain message.
refused() { # name message cmake_arguments...
  local name=$1 message=$2
  shift 2
  begin "refused: $name"
  local build=$build_root/consumers/refused log=$logs/refused.log
  rm -rf "$build"
  if cmake -B "$build" -G Ninja "$@" >"$log" 2>&1; then
    fail "was configured without complaint" "$log"
  fi
  # CMake wraps long messages.
  tr -s '[:space:]' ' ' <"$log" | grep -qE "$message" ||
    fail "stopped, but not with \"$message\"" "$log"
  pass
}

# Sources that a compiler has to reject, for the reason given in their first line.
must_not_compile() { # compiler
  begin "must not compile: $1"
  local file expected log=$logs/must-not-compile.log number=0
  for file in tests/package/must_not_compile/*.cpp; do
    expected=$(sed -n '1s,^// EXPECT: ,,p' "$file")
    [[ -n $expected ]] || fail "$file has no // EXPECT: line"
    if "$1" -std=c++17 -fsyntax-only -Iinclude -isystem /usr/include/eigen3 \
      "$file" >"$log" 2>&1; then
      fail "$file compiles"
    fi
    grep -qE "$expected" "$log" ||
      fail "$file is rejected, but not with \"$expected\"" "$log"
    number=$((number + 1))
    passed=$((passed + 1))
  done
  end "$number sources rejected"
}

# --- the steps -------------------------------------------------------------------------------
begin "dependencies"
if [[ ${DYNSLAM_SKIP_INSTALL:-0} == 1 ]]; then
  skip "DYNSLAM_SKIP_INSTALL=1"
else
  cmake/install_dependencies.sh
  pass
fi

check_format

# Headers are checked in both standards and by both compilers, each compiler in one of them: all
# four pairs would take minutes more. `header_checks` of a plain build has both standards.
# In `release` the libraries are compiled file by file and without precompiled headers, as users do;
# under sanitizers their files are compiled joined, those of the tests and of the program in both.
export CXX=g++
build_preset release 17
test_preset release

build_preset asan 20 -DDYNSLAM_JOIN_LIBRARIES=ON -DDYNSLAM_PRECOMPILE_HEADERS=ON
ASAN_OPTIONS=detect_stack_use_after_return=1:strict_string_checks=1 \
  LSAN_OPTIONS="suppressions=$source_dir/tests/lsan.supp:print_suppressions=0" \
  UBSAN_OPTIONS=print_stacktrace=1 test_preset asan

must_not_compile g++
must_not_compile clang++

begin "install"
staging=$build_root/staging prefix=$build_root/prefix
rm -rf "$staging" "$prefix"
quietly "$logs/install.log" cmake --install "$build_root/release" --prefix "$staging"
mv "$staging" "$prefix" # the package has to work wherever it is moved
pass

without_packages=(-DCMAKE_DISABLE_FIND_PACKAGE_OpenCV=ON -DCMAKE_DISABLE_FIND_PACKAGE_Ceres=ON
  -DCMAKE_DISABLE_FIND_PACKAGE_hwy=ON)
lone_rooms=core
if present evaluation; then
  lone_rooms="core;evaluation"
fi

consumer find_package_core find_package_core -DCMAKE_PREFIX_PATH="$prefix" \
  "${without_packages[@]}"
if present evaluation; then
  consumer find_package_core_evaluation find_package_core_evaluation \
    -DCMAKE_PREFIX_PATH="$prefix" "${without_packages[@]}"
else
  begin "consumer find_package_core_evaluation"
  skip "this tree has no evaluation yet"
fi
consumer add_subdirectory add_subdirectory -DDYNSLAM_TREE="$source_dir" "${without_packages[@]}"

# Both of these only show what is there without a package: not optimized, with the compiler that is
# then faster, and without what no package changes (header checks, examples).
without_optimization=(-G Ninja -DCMAKE_CXX_COMPILER=clang++ -DCMAKE_BUILD_TYPE=Debug
  -DCMAKE_CXX_FLAGS_DEBUG=-O0 -DDYNSLAM_BUILD_EXAMPLES=OFF -DDYNSLAM_WARNINGS_AS_ERRORS=ON
  -DDYNSLAM_JOIN_SOURCES=ON -DDYNSLAM_JOIN_LIBRARIES=ON -DDYNSLAM_PRECOMPILE_HEADERS=ON)

begin "from source: $lone_rooms without OpenCV, Ceres and Highway"
quietly "$logs/lone-rooms.log" cmake -S . -B "$build_root/lone_rooms" "${without_optimization[@]}" \
  -DDYNSLAM_COMPONENTS="$lone_rooms" "${without_packages[@]}" -DDYNSLAM_BUILD_TESTS=OFF
quietly "$logs/lone-rooms.log" cmake --build "$build_root/lone_rooms" --parallel "$jobs"
pass

if present factors; then
  begin "from source: factors without Ceres"
  quietly "$logs/without-ceres-build.log" cmake -S . -B "$build_root/without_ceres" \
    "${without_optimization[@]}" -DDYNSLAM_COMPONENTS="factors" \
    -DCMAKE_DISABLE_FIND_PACKAGE_Ceres=ON
  quietly "$logs/without-ceres-build.log" \
    cmake --build "$build_root/without_ceres" --parallel "$jobs" --target factors_tests
  pass
  test_preset without_ceres --label-regex factors
fi

refused "a component that does not exist, from source" \
  'dynslam has no component "kitchen"' -S . -DDYNSLAM_COMPONENTS=kitchen
refused "a component that does not exist, installed" \
  'dynslam has no component "kitchen"' \
  -S tests/package/refused -DCMAKE_PREFIX_PATH="$prefix" -DCOMPONENTS=kitchen
refused "a missing package" \
  'the package Eigen3 was not found .on Debian: libeigen3-dev' \
  -S tests/package/refused -DCMAKE_PREFIX_PATH="$prefix" -DCOMPONENTS=core \
  -DCMAKE_DISABLE_FIND_PACKAGE_Eigen3=ON
refused "another version" \
  'compatible with requested version "0.2"' \
  -S tests/package/refused -DCMAKE_PREFIX_PATH="$prefix" -DCOMPONENTS=core -DVERSION=0.2

if ((skipped > 0)); then
  printf '\n%d tests did not run (see above); %d s in all\n' "$skipped" "$SECONDS"
else
  printf '\n%d s in all\n' "$SECONDS"
fi
trap - EXIT
printf '%d passed, 0 failed\n' "$passed"
