# Tests, benchmarks, examples and header checks. All of them are found by their file names; a
# room writes a CMakeLists.txt beside them only to link more than its own target.

include_guard(DIRECTORY)

# Leaves out the files whose name says that they need a package that is not there, and names
# what the others need.
function(dynslam_keep_usable_files files_variable link_variable)
  set(kept "")
  set(links "")
  foreach(file IN LISTS ${files_variable})
    dynslam_adapter_package("${file}" package)
    if(package)
      dynslam_find_package("${package}" RESULT found)
      if(NOT found)
        message(STATUS "dynslam: ${package} was not found, leaving out ${file}")
        continue()
      endif()
      list(APPEND links ${dynslam_adapter_targets_${package}})
    endif()
    list(APPEND kept "${file}")
  endforeach()
  list(REMOVE_DUPLICATES links)
  set(${files_variable} "${kept}" PARENT_SCOPE)
  set(${link_variable} "${links}" PARENT_SCOPE)
endfunction()

# dynslam_add_tests(<room> [LINK <target>...] [PACKAGES "<name> ..."...]
#                   [DEFINITIONS <definition>...] [PRECOMPILE <header>...]
#                   [SEPARATE] [OPTIMIZE] [COUNT_ALLOCATIONS])
#
# Every tests/<room>/*_test.cpp goes into one executable, <room>_tests, which is the test <room>
# of ctest. Called without further arguments for a room that has no tests/<room>/CMakeLists.txt.
#
# With DYNSLAM_JOIN_SOURCES the files are compiled joined, in a third of the time; SEPARATE
# are those of a room whose files use the same names for different things: they share what
# PRECOMPILE names instead.
#
# Under sanitizers the tests are not optimized, which takes half the time to compile. OPTIMIZE is
# for a room whose tests wait for templates, the room's own or Eigen's: those of the library are
# linked once, and that may be as the tests compiled them.
#
# COUNT_ALLOCATIONS is for a room whose tests include allocation_counter.hpp.
#
# The tests know DYNSLAM_TEST_DATA_DIR, their own small files in tests/<room>/data, and
# DYNSLAM_DEFAULT_DATA_DIR, where data sets lie unless the environment's DYNSLAM_DATA says
# otherwise. They run in a scratch directory of their own room.
function(dynslam_add_tests room)
  cmake_parse_arguments(PARSE_ARGV 1 arg "SEPARATE;OPTIMIZE;COUNT_ALLOCATIONS" ""
    "LINK;PACKAGES;DEFINITIONS;PRECOMPILE")
  set(directory "${PROJECT_SOURCE_DIR}/tests/${room}")
  file(GLOB sources CONFIGURE_DEPENDS "${directory}/*_test.cpp")
  dynslam_keep_usable_files(sources adapter_links)
  foreach(spec IN LISTS arg_PACKAGES)
    dynslam_find_package("${spec}" FOR "Testing the component ${room} of dynslam")
  endforeach()
  set(target ${room}_tests)
  set(scratch "${PROJECT_BINARY_DIR}/tests/scratch/${room}")
  file(MAKE_DIRECTORY "${scratch}")
  if(arg_COUNT_ALLOCATIONS)
    list(APPEND sources "${PROJECT_SOURCE_DIR}/tests/allocation_counter.cpp")
  endif()
  if(DYNSLAM_SANITIZE MATCHES "thread" AND TARGET opencv_core)
    list(APPEND sources "${PROJECT_SOURCE_DIR}/tests/opencv_alone.cpp")
    list(APPEND adapter_links opencv_core)
  endif()
  add_executable(${target} ${sources})
  dynslam_apply_build_flags(${target})
  if(DYNSLAM_SANITIZE AND NOT arg_OPTIMIZE)
    target_compile_options(${target} PRIVATE -O0)
  endif()
  if(NOT arg_SEPARATE)
    if(DYNSLAM_JOIN_SOURCES)
      dynslam_join_sources(${target})
    endif()
  elseif(DYNSLAM_JOIN_SOURCES)
    target_precompile_headers(${target} PRIVATE ${arg_PRECOMPILE})
  endif()
  set_target_properties(${target} PROPERTIES
    RUNTIME_OUTPUT_DIRECTORY "${PROJECT_BINARY_DIR}/tests")
  target_include_directories(${target} PRIVATE "${PROJECT_SOURCE_DIR}/tests")
  target_compile_definitions(${target} PRIVATE
    DYNSLAM_TEST_DATA_DIR="${directory}/data"
    DYNSLAM_DEFAULT_DATA_DIR="${DYNSLAM_DATA_DIR}"
    ${arg_DEFINITIONS})
  target_link_libraries(${target} PRIVATE
    dynslam::${room} ${arg_LINK} ${adapter_links} GTest::gtest_main)
  # One process for a room: frames that its tests render or files that they write once are there
  # for all of them, and under a sanitizer every start of a process costs more than a test.
  set(results "${PROJECT_BINARY_DIR}/tests/results")
  add_test(NAME ${room} WORKING_DIRECTORY "${scratch}"
    COMMAND ${target} --gtest_brief=1 "--gtest_output=xml:${results}/${room}.xml")
  set_tests_properties(${room} PROPERTIES LABELS ${room} TIMEOUT 1800)
endfunction()

function(dynslam_configure_tests)
  dynslam_find_package(GTest FOR "Testing dynslam")
  add_test(NAME docs COMMAND bash "${PROJECT_SOURCE_DIR}/tests/docs_test.sh")
  set_tests_properties(docs PROPERTIES LABELS docs)
  dynslam_enabled_rooms(rooms)
  foreach(room IN LISTS rooms)
    if(EXISTS "${PROJECT_SOURCE_DIR}/tests/${room}/CMakeLists.txt")
      add_subdirectory("${PROJECT_SOURCE_DIR}/tests/${room}"
                       "${PROJECT_BINARY_DIR}/tests/${room}")
      if(NOT TARGET ${room}_tests)
        message(FATAL_ERROR
          "tests/${room}/CMakeLists.txt does not call dynslam_add_tests(${room} ...)")
      endif()
    else()
      dynslam_add_tests(${room})
    endif()
  endforeach()
endfunction()

# dynslam_add_benchmarks(<room> [LINK <target>...] [PACKAGES "<name> ..."...])
#
# Every benchmarks/<room>/<name>_bench.cpp becomes the executable <room>_<name>_bench.
function(dynslam_add_benchmarks room)
  cmake_parse_arguments(PARSE_ARGV 1 arg "" "" "LINK;PACKAGES")
  file(GLOB sources CONFIGURE_DEPENDS "${PROJECT_SOURCE_DIR}/benchmarks/${room}/*_bench.cpp")
  foreach(spec IN LISTS arg_PACKAGES)
    dynslam_find_package("${spec}" FOR "Timing the component ${room} of dynslam")
  endforeach()
  foreach(source IN LISTS sources)
    set(usable "${source}")
    dynslam_keep_usable_files(usable adapter_links)
    if(usable)
      get_filename_component(name "${source}" NAME_WE)
      set(target ${room}_${name})
      add_executable(${target} "${source}")
      dynslam_apply_build_flags(${target})
      set_target_properties(${target} PROPERTIES
        RUNTIME_OUTPUT_DIRECTORY "${PROJECT_BINARY_DIR}/benchmarks")
      target_compile_definitions(${target} PRIVATE
        DYNSLAM_TEST_DATA_DIR="${PROJECT_SOURCE_DIR}/tests/${room}/data"
        DYNSLAM_DEFAULT_DATA_DIR="${DYNSLAM_DATA_DIR}")
      target_link_libraries(${target} PRIVATE
        dynslam::${room} ${arg_LINK} ${adapter_links} benchmark::benchmark_main)
    endif()
  endforeach()
endfunction()

function(dynslam_configure_benchmarks)
  dynslam_find_package(benchmark FOR "Timing dynslam")
  dynslam_enabled_rooms(rooms)
  foreach(room IN LISTS rooms)
    if(EXISTS "${PROJECT_SOURCE_DIR}/benchmarks/${room}/CMakeLists.txt")
      add_subdirectory("${PROJECT_SOURCE_DIR}/benchmarks/${room}"
                       "${PROJECT_BINARY_DIR}/benchmarks/${room}")
    else()
      dynslam_add_benchmarks(${room})
    endif()
  endforeach()
endfunction()

# Every examples/NN_<room>_<topic>.cpp becomes the target example_NN_<room>_<topic> and the
# test example.NN_<room>_<topic>: examples run to the end without data and without arguments.
# examples/CMakeLists.txt, read afterwards, may link more to these targets; examples/cli is the
# command line program.
function(dynslam_configure_examples)
  dynslam_enabled_rooms(rooms)
  file(GLOB sources CONFIGURE_DEPENDS "${PROJECT_SOURCE_DIR}/examples/[0-9]*.cpp")
  foreach(source IN LISTS sources)
    get_filename_component(name "${source}" NAME_WE)
    if(NOT name MATCHES "^[0-9]+_([a-z]+)(_|$)" OR NOT CMAKE_MATCH_1 IN_LIST dynslam_all_rooms)
      message(FATAL_ERROR "examples/${name}.cpp: an example is called NN_<room>_<topic>.cpp")
    endif()
    set(room "${CMAKE_MATCH_1}")
    if(NOT room IN_LIST rooms)
      continue()
    endif()
    set(usable "${source}")
    dynslam_keep_usable_files(usable adapter_links)
    if(usable)
      set(target example_${name})
      add_executable(${target} "${source}")
      dynslam_apply_build_flags(${target})
      set_target_properties(${target} PROPERTIES OUTPUT_NAME "${name}"
        RUNTIME_OUTPUT_DIRECTORY "${PROJECT_BINARY_DIR}/examples")
      target_link_libraries(${target} PRIVATE dynslam::${room} ${adapter_links})
      if(DYNSLAM_BUILD_TESTS)
        set(scratch "${PROJECT_BINARY_DIR}/examples/scratch")
        file(MAKE_DIRECTORY "${scratch}")
        add_test(NAME example.${name} COMMAND ${target} WORKING_DIRECTORY "${scratch}")
        set_tests_properties(example.${name} PROPERTIES LABELS example TIMEOUT 600)
      endif()
    endif()
  endforeach()
  if(EXISTS "${PROJECT_SOURCE_DIR}/examples/CMakeLists.txt")
    add_subdirectory("${PROJECT_SOURCE_DIR}/examples" "${PROJECT_BINARY_DIR}/examples")
  endif()
  if(EXISTS "${PROJECT_SOURCE_DIR}/examples/cli/CMakeLists.txt")
    set(absent dataset evaluation features loop matching segmentation slam)
    list(REMOVE_ITEM absent ${rooms})
    if(NOT absent)
      add_subdirectory("${PROJECT_SOURCE_DIR}/examples/cli" "${PROJECT_BINARY_DIR}/examples/cli")
    endif()
  endif()
endfunction()

# The target header_checks: every public header of every enabled room compiles alone, and twice
# in a row, in every standard of DYNSLAM_HEADER_CHECK_STANDARDS without a warning. With
# DYNSLAM_PRECOMPILE_HEADERS, after what the room's sources read first: that hides a header that
# forgot one of these, and takes half the time. Headers in detail/ are checked as C++20 only.
function(dynslam_configure_header_checks)
  add_custom_target(header_checks)
  dynslam_enabled_rooms(rooms)
  foreach(room IN LISTS rooms)
    set(base "${PROJECT_SOURCE_DIR}/include/dynslam/${room}")
    file(GLOB_RECURSE headers CONFIGURE_DEPENDS RELATIVE "${base}" "${base}/*.hpp")
    get_property(excluded GLOBAL PROPERTY DYNSLAM_${room}_HEADER_CHECK_EXCLUDE)
    get_property(extra_links GLOBAL PROPERTY DYNSLAM_${room}_HEADER_CHECK_LINK)
    get_property(precompiled GLOBAL PROPERTY DYNSLAM_${room}_PRECOMPILE)
    if(excluded)
      list(REMOVE_ITEM headers ${excluded})
    endif()
    set(plain_sources "")
    set(OpenCV_sources "")
    set(Ceres_sources "")
    foreach(header IN LISTS headers)
      set(source "${PROJECT_BINARY_DIR}/header_checks/${room}/${header}.cpp")
      file(CONFIGURE OUTPUT "${source}" @ONLY CONTENT
        "#include \"dynslam/${room}/${header}\"\n#include \"dynslam/${room}/${header}\"\n")
      set(usable "${header}")
      dynslam_keep_usable_files(usable adapter_links)
      dynslam_adapter_package("${header}" package)
      if(usable AND package)
        list(APPEND ${package}_sources "${source}")
      elseif(usable)
        list(APPEND plain_sources "${source}")
      endif()
    endforeach()
    foreach(group IN ITEMS plain OpenCV Ceres)
      if(NOT ${group}_sources)
        continue()
      endif()
      foreach(standard IN LISTS DYNSLAM_HEADER_CHECK_STANDARDS)
        set(target header_checks_${room}_${group}_cxx${standard})
        set(checked ${${group}_sources})
        if(standard LESS 20)
          list(FILTER checked EXCLUDE REGEX "/detail/")
        endif()
        add_library(${target} OBJECT EXCLUDE_FROM_ALL ${checked})
        set_target_properties(${target} PROPERTIES
          CXX_STANDARD ${standard} CXX_STANDARD_REQUIRED ON CXX_EXTENSIONS OFF)
        # Nothing of these is ever run: no time is spent on code or debug information.
        target_compile_options(${target} PRIVATE -Wall -Wextra -Werror -O0 -g0)
        target_link_libraries(${target} PRIVATE
          dynslam::${room} ${extra_links} ${dynslam_adapter_targets_${group}})
        if(group STREQUAL "plain")  # of the others there are too few
          dynslam_precompile_headers(${target} ${precompiled})
        endif()
        add_dependencies(header_checks ${target})
      endforeach()
    endforeach()
  endforeach()
endfunction()
