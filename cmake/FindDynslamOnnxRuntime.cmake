# Finds ONNX Runtime, its C++ header and its shared library, in this order:
#
#   DYNSLAM_ONNXRUNTIME_DIR, a prefix with include/ and lib/ (CMake variable, then environment);
#   the prefix that  cmake/install_dependencies.sh --onnxruntime  fills;
#   the system.
#
# Defines the target DynslamOnnxRuntime::onnxruntime, DynslamOnnxRuntime_FOUND and
# DynslamOnnxRuntime_VERSION.

if(DEFINED ENV{XDG_CACHE_HOME} AND NOT "$ENV{XDG_CACHE_HOME}" STREQUAL "")
  set(_dynslam_ort_cache "$ENV{XDG_CACHE_HOME}/dynslam/onnxruntime")
else()
  set(_dynslam_ort_cache "$ENV{HOME}/.cache/dynslam/onnxruntime")
endif()
set(_dynslam_ort_prefixes
    ${DYNSLAM_ONNXRUNTIME_DIR} $ENV{DYNSLAM_ONNXRUNTIME_DIR} "${_dynslam_ort_cache}")
set(_dynslam_ort_header_dirs
    include include/onnxruntime include/onnxruntime/core/session include/core/session)

find_path(DynslamOnnxRuntime_INCLUDE_DIR onnxruntime_cxx_api.h
  HINTS ${_dynslam_ort_prefixes}
  PATH_SUFFIXES ${_dynslam_ort_header_dirs} onnxruntime onnxruntime/core/session)
# The library must come from where the header came from, not from another release.
get_filename_component(_dynslam_ort_home "${DynslamOnnxRuntime_INCLUDE_DIR}/.." ABSOLUTE)
find_library(DynslamOnnxRuntime_LIBRARY NAMES onnxruntime libonnxruntime.so.1
  HINTS "${_dynslam_ort_home}" ${_dynslam_ort_prefixes} PATH_SUFFIXES lib lib64)
mark_as_advanced(DynslamOnnxRuntime_INCLUDE_DIR DynslamOnnxRuntime_LIBRARY)

set(DynslamOnnxRuntime_VERSION "")
if(EXISTS "${DynslamOnnxRuntime_INCLUDE_DIR}/onnxruntime_c_api.h")
  file(STRINGS "${DynslamOnnxRuntime_INCLUDE_DIR}/onnxruntime_c_api.h" _dynslam_ort_api
       REGEX "^#define ORT_API_VERSION [0-9]+")
  if(_dynslam_ort_api MATCHES "ORT_API_VERSION ([0-9]+)")
    set(DynslamOnnxRuntime_VERSION "1.${CMAKE_MATCH_1}")
  endif()
endif()

include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(DynslamOnnxRuntime
  REQUIRED_VARS DynslamOnnxRuntime_LIBRARY DynslamOnnxRuntime_INCLUDE_DIR
  VERSION_VAR DynslamOnnxRuntime_VERSION
  REASON_FAILURE_MESSAGE
    "Run cmake/install_dependencies.sh --onnxruntime or set DYNSLAM_ONNXRUNTIME_DIR.")

if(DynslamOnnxRuntime_FOUND AND NOT TARGET DynslamOnnxRuntime::onnxruntime)
  add_library(DynslamOnnxRuntime::onnxruntime SHARED IMPORTED)
  set_target_properties(DynslamOnnxRuntime::onnxruntime PROPERTIES
    IMPORTED_LOCATION "${DynslamOnnxRuntime_LIBRARY}"
    INTERFACE_INCLUDE_DIRECTORIES "${DynslamOnnxRuntime_INCLUDE_DIR}")
endif()
