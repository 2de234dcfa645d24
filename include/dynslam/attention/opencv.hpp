// The layers inside OpenCV's networks.
#pragma once

namespace dynslam::attention {

/// Makes cv::dnn::readNetFromONNX and friends understand the operators of the domain `dynslam`
/// that `fuse_onnx` writes: GhostC3, GhostBottleneck, GhostModule, Dfc and Cbam. Networks loaded
/// before do not change. May be called again, from any thread; the registration is global to the
/// process, as OpenCV's list of layers is. The layers run in OpenCV's own threads
/// (cv::parallel_for_), as many as cv::getNumThreads() says.
void register_opencv_layers();

}  // namespace dynslam::attention
