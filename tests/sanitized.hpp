// Whether a sanitizer watches this build, in which everything takes ten times as long.
#pragma once

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)  // g++
#define DYNSLAM_SANITIZED
#elif defined(__has_feature)  // clang
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define DYNSLAM_SANITIZED
#endif
#endif

namespace dynslam::testing {

#if defined(DYNSLAM_SANITIZED)
inline constexpr bool kSanitized = true;
#else
inline constexpr bool kSanitized = false;
#endif

}  // namespace dynslam::testing
