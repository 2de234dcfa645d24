# Finding what dynslam stands on: every package is looked for once, its targets are visible to
# every room, and a missing one is reported by the name of the Debian package that holds it.

include_guard(DIRECTORY)

set(dynslam_debian_package_OpenCV libopencv-dev)
set(dynslam_debian_package_Ceres libceres-dev)
set(dynslam_debian_package_Eigen3 libeigen3-dev)
set(dynslam_debian_package_hwy libhwy-dev)
set(dynslam_debian_package_CLI11 libcli11-dev)
set(dynslam_debian_package_nlohmann_json nlohmann-json3-dev)
set(dynslam_debian_package_GTest libgtest-dev)
set(dynslam_debian_package_benchmark libbenchmark-dev)
set(dynslam_debian_package_ZLIB zlib1g-dev)
set(dynslam_debian_package_Threads libc6-dev)

# dynslam_find_package("<name> [arguments of find_package]" [FOR <whom>] [RESULT <variable>])
#
# Finds a package once for the whole build. Without RESULT a missing package stops the
# configuration; with RESULT the variable says whether it was found. <name>_VERSION and the
# like are not returned: rooms use targets.
function(dynslam_find_package spec)
  cmake_parse_arguments(PARSE_ARGV 1 arg "" "FOR;RESULT" "")
  separate_arguments(find_arguments UNIX_COMMAND "${spec}")
  list(POP_FRONT find_arguments name)
  string(MAKE_C_IDENTIFIER "DYNSLAM_PACKAGE_${spec}" key)

  get_property(found GLOBAL PROPERTY ${key})
  if("${found}" STREQUAL "")
    get_property(known_before DIRECTORY PROPERTY IMPORTED_TARGETS)
    find_package(${name} ${find_arguments} QUIET)
    # Imported targets belong to the directory that found them. A room's users live elsewhere
    # (tests, examples, the project that added dynslam as a subdirectory), so they go global.
    get_property(known_now DIRECTORY PROPERTY IMPORTED_TARGETS)
    list(REMOVE_ITEM known_now ${known_before})
    foreach(target IN LISTS known_now)
      set_target_properties(${target} PROPERTIES IMPORTED_GLOBAL TRUE)
    endforeach()
    if(${name}_FOUND)
      set(found TRUE)
      message(STATUS "dynslam: ${name} ${${name}_VERSION} found")
    else()
      set(found FALSE)
    endif()
    set_property(GLOBAL PROPERTY ${key} ${found})
  endif()

  if(DEFINED arg_RESULT)
    set(${arg_RESULT} ${found} PARENT_SCOPE)
  elseif(NOT found)
    set(whom "dynslam")
    if(arg_FOR)
      set(whom "${arg_FOR}")
    endif()
    if(name STREQUAL "DynslamOnnxRuntime")
      set(remedy "run  cmake/install_dependencies.sh --onnxruntime")
    elseif(DEFINED dynslam_debian_package_${name})
      set(remedy "on Debian:  apt-get install ${dynslam_debian_package_${name}}")
    else()
      set(remedy "install it or set ${name}_DIR")
    endif()
    message(FATAL_ERROR "${whom} needs the package \"${spec}\", which was not found "
      "(or lacks a part that is asked for).\n  Get it:  ${remedy}\n"
      "  Do without:  name only the rooms you want, -DDYNSLAM_COMPONENTS=\"core;...\"")
  endif()
endfunction()

# dynslam_adapter_package(<file> <variable>)
#
# Which package a file adapts dynslam to, told from its name: opencv.hpp, ceres_factors.hpp,
# opencv_views_test.cpp, 02_core_opencv.cpp. Such files are left out when the package is
# missing. The variable is empty for every other file.
function(dynslam_adapter_package file result)
  get_filename_component(name "${file}" NAME_WE)
  set(${result} "" PARENT_SCOPE)
  if(name MATCHES "(^|_)opencv(_|$)")
    set(${result} OpenCV PARENT_SCOPE)
  elseif(name MATCHES "(^|_)ceres(_|$)")
    set(${result} Ceres PARENT_SCOPE)
  elseif(name MATCHES "(^|_)g2o(_|$)")
    set(${result} g2o PARENT_SCOPE)
  elseif(name MATCHES "(^|_)gtsam(_|$)")
    set(${result} GTSAM PARENT_SCOPE)
  endif()
endfunction()

# What to link for a package that dynslam_adapter_package named.
set(dynslam_adapter_targets_OpenCV opencv_core)
set(dynslam_adapter_targets_Ceres Ceres::ceres)
set(dynslam_adapter_targets_g2o g2o::types_sba g2o::solver_eigen g2o::core)
set(dynslam_adapter_targets_GTSAM gtsam)
