// Version of the library; the build system reads it from here.
#pragma once

#define DYNSLAM_VERSION_MAJOR 0
#define DYNSLAM_VERSION_MINOR 1
#define DYNSLAM_VERSION_PATCH 0

#define DYNSLAM_STRINGIZE_IMPL(x) #x
#define DYNSLAM_STRINGIZE(x) DYNSLAM_STRINGIZE_IMPL(x)
#define DYNSLAM_VERSION_STRING             \
  DYNSLAM_STRINGIZE(DYNSLAM_VERSION_MAJOR) \
  "." DYNSLAM_STRINGIZE(DYNSLAM_VERSION_MINOR) "." DYNSLAM_STRINGIZE(DYNSLAM_VERSION_PATCH)

namespace dynslam {

/// Version of the headers this translation unit was compiled with,
/// "major.minor.patch".
inline constexpr const char* kVersion = DYNSLAM_VERSION_STRING;

}  // namespace dynslam
