// What is compiled with Ceres where it is found, and refuses by name where it is not.
#pragma once

#include "dynslam/factors/bundle_adjustment.hpp"

namespace dynslam::factors {

// The contract of optimize_bundle, checked already.
BundleSummary optimize_bundle_with_ceres(const BundleProblem& problem,
                                         const BundleOptions& options);

}  // namespace dynslam::factors
