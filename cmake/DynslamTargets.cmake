# How dynslam's own translation units are compiled. Nothing here reaches a user's target.

include_guard(DIRECTORY)

# dynslam_precompile_headers(<target> <header>...)
#
# With DYNSLAM_PRECOMPILE_HEADERS: reading Eigen takes longer than reading most files that use it.
# Only for builds beside one that does without, as users do: a file that forgot to include one of
# these headers is not found out with them.
function(dynslam_precompile_headers target)
  if(DYNSLAM_PRECOMPILE_HEADERS AND ARGN)
    target_precompile_headers(${target} PRIVATE ${ARGN})
  endif()
endfunction()

# dynslam_join_sources(<target>)
#
# Compiles its files eight at a time, so that what they instantiate is compiled once. Left out
# are those that go on their own: kernels, which include themselves once for every instruction set,
# and what replaces operator new, because compilers look through it where they see it.
function(dynslam_join_sources target)
  set_target_properties(${target} PROPERTIES UNITY_BUILD ON)
  get_target_property(sources ${target} SOURCES)
  foreach(source IN LISTS sources)
    file(STRINGS "${source}" own REGEX "HWY_TARGET_INCLUDE|operator new" LIMIT_COUNT 1)
    if(own)
      set_source_files_properties("${source}" PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
    endif()
  endforeach()
endfunction()

# dynslam_apply_build_flags(<target>)
#
# Warnings, sanitizers and reproducible floating point. There is no -march here and there must
# not be one: it changes the layout of Eigen's types between a library and its user.
function(dynslam_apply_build_flags target)
  set_target_properties(${target} PROPERTIES CXX_EXTENSIONS OFF POSITION_INDEPENDENT_CODE ON)
  target_compile_features(${target} PRIVATE cxx_std_17)
  if(NOT CMAKE_CXX_COMPILER_ID MATCHES "GNU|Clang")
    return()
  endif()
  target_compile_options(${target} PRIVATE
    -Wall -Wextra -Wpedantic -Wshadow -Wnon-virtual-dtor -Woverloaded-virtual
    # a*b+c is rounded twice on every machine, so that results do not depend on the machine.
    -ffp-contract=off)
  if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
    # At -O1, the preset dev, g++ 12 takes Eigen's temporaries for uninitialized.
    target_compile_options(${target} PRIVATE
      $<$<CONFIG:RelWithDebInfo,Debug>:-Wno-maybe-uninitialized>)
  endif()
  if(DYNSLAM_WARNINGS_AS_ERRORS)
    target_compile_options(${target} PRIVATE -Werror)
  endif()
  if(DYNSLAM_SANITIZE)
    string(REPLACE ";" "," sanitizers "${DYNSLAM_SANITIZE}")
    target_compile_options(${target} PRIVATE
      -fsanitize=${sanitizers} -fno-sanitize-recover=all -fno-omit-frame-pointer)
    target_link_options(${target} PRIVATE -fsanitize=${sanitizers})
    if(CMAKE_CXX_COMPILER_ID MATCHES "Clang")
      target_compile_options(${target} PRIVATE
        "-fsanitize-ignorelist=${PROJECT_SOURCE_DIR}/cmake/sanitizer_ignorelist.txt")
    endif()
    # Kernels take longest to compile under sanitizers. Three targets find what five would: plain
    # loops, vectors that take masks, vectors that do not. (SVE: see the rooms' simd.hpp.)
    target_compile_definitions(${target} PRIVATE
      "HWY_DISABLED_TARGETS=(HWY_SSSE3|HWY_SSE4|HWY_SVE|HWY_SVE_256|HWY_SVE2|HWY_SVE2_128|HWY_RVV)")
  endif()
endfunction()
