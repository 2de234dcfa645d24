// Tests under ThreadSanitizer: OpenCV keeps to the thread that calls it. It shares work by TBB,
// which is built without the sanitizer, so that all that is shared would pass for a race.
#include <opencv2/core/utility.hpp>

namespace {
[[maybe_unused]] const bool alone = (cv::setNumThreads(1), true);
}
