#include "bench_names.hpp"

#include <regex>
#include <vector>

namespace dynslam::cli {
namespace {

// The first form that fits a name says what it is; $1, $2 are what its brackets hold.
struct Form {
  const char* room;
  const char* pattern;
  const char* what;
  const char* target;  // empty: a rival
  const char* rival;   // empty: ours
};

constexpr Form kForms[] = {
    {"features", "orb_target/(\\w+)", "orb/texture_640x480/1000", "$1", ""},
    {"features", "(\\w+)/cv_orb", "spread/$1", "", "cv::ORB"},
    {"features", "(\\w+)/spread_(\\d+)", "spread/$1", "spread $2 %", ""},
    {"features", "BM_BruteForceOn/(\\w+)/(.*)", "BruteForce/$2", "$1", ""},
    {"features", "BM_OpenCvBFMatcherTwoNearest/(.*)", "BruteForceRatio/$1", "", "cv::BFMatcher"},
    {"features", "BM_OpenCvBFMatcher(\\w*)/(.*)", "BruteForce$1/$2", "", "cv::BFMatcher"},
    {"features", "BM_WindowedWithoutGrid/(.*)", "Windowed/$1", "", "without grid"},
    {"features", "BM_OpenCvNorm/(.*)", "Distances/$1", "", "cv::norm"},
    {"matching", "matching/rival/(\\w+)/(\\d+)", "default/$2", "", "$1"},
    {"matching", "matching/(.*)", "$1", "best", ""},
    {"factors", "BM_CeresAutodiffHuber/(.*)", "pose/$1", "", "Ceres autodiff"},
    {"factors", "BM_CeresAutodiff/(\\w+)/(.*)", "bundle/$2", "", "Ceres autodiff $1"},
    {"factors", "BM_Own/(Ceres\\w+|Schur\\w*)/(.*)", "bundle/$2", "$1", ""},
    {"factors", "BM_Own/(\\w+)/(.*)", "pose/$2", "$1", ""},
    {"evaluation", "(\\w+?)_ours(.*)", "$1$2", "best", ""},
    {"evaluation", "(\\w+?)_(istream|strtod|EigenUmeyama)", "$1", "", "$2"},
    {"dataset", "BM_(\\w+)_rival_(\\w+)", "$1", "", "$2"},
    {"dataset", "BM_(\\w+)_ReadAhead", "$1", "best", ""},
    {"segmentation", "rival_all_prototypes", "decode_and_masks", "", "all prototypes"},
    {"segmentation", "rival_dilation_of_opencv/(.*)", "policy_with_dilation/$1", "", "cv::dilate"},
    {"segmentation", "network/(\\w+)_(opencv|onnxruntime)", "network/$1", "$2", ""},
    {"attention", "run_network/(\\w+)_(unfused|own_blocks)", "network/$1", "", "$2"},
    {"attention", "run_network/(\\w+)_fused", "network/$1", "best", ""},
    {"attention", "(.*)/dynslam", "$1", "best", ""},
    {"attention", "(.*)/memory_floor", "$1", "", "floor"},
    {"attention", "(.*)/(\\w+)", "$1", "", "$2"},
    {"", "BM_(.*)", "$1", "best", ""},
    {"", "(.*)", "$1", "best", ""},
};

}  // namespace

BenchName bench_name(const std::string& room, const std::string& name) {
  static const std::regex kHow(
      "/(real_time|manual_time|process_time|(min_time|iterations):[0-9.]+)");
  const std::string bare = std::regex_replace(name, kHow, "");
  for (const Form& form : kForms) {
    std::smatch match;
    if (form.room[0] != '\0' && room != form.room) continue;
    if (!std::regex_match(bare, match, std::regex(form.pattern))) continue;
    return {match.format(form.what), match.format(form.target), match.format(form.rival)};
  }
  return {bare, "best", ""};
}

}  // namespace dynslam::cli
