#include <opencv2/core.hpp>
#include <opencv2/dnn.hpp>

#include "dynslam/core/errors.hpp"

#include "segmentation/network.hpp"

namespace dynslam::segmentation {
namespace {

class OpenCvNetwork final : public Network {
 public:
  OpenCvNetwork(const OnnxFile& file, InputSize size) : path_(file.path), size_(size) {
    try {
      net_ = cv::dnn::readNetFromONNX(file.bytes.data(), file.bytes.size());
      net_.setPreferableBackend(cv::dnn::DNN_BACKEND_OPENCV);
      net_.setPreferableTarget(cv::dnn::DNN_TARGET_CPU);
      names_ = net_.getUnconnectedOutLayersNames();
    } catch (const cv::Exception& error) {
      throw_io_error(path_, "OpenCV cannot load this network: " + opencv_error_text(error.what()));
    }
  }

  const std::vector<NetworkOutput>& run(const float* input) override {
    const int shape[4] = {1, 3, size_.height, size_.width};
    const cv::Mat blob(4, shape, CV_32F, const_cast<float*>(input));
    try {
      net_.setInput(blob);
      net_.forward(mats_, names_);
    } catch (const cv::Exception& error) {
      throw_io_error(path_, "OpenCV cannot run this network: " + opencv_error_text(error.what()));
    }
    outputs_.resize(mats_.size());
    for (std::size_t i = 0; i < mats_.size(); ++i) {
      if (mats_[i].type() != CV_32F || !mats_[i].isContinuous()) {
        mats_[i].convertTo(mats_[i], CV_32F);
      }
      outputs_[i].name = names_[i];
      outputs_[i].shape.assign(mats_[i].size.p, mats_[i].size.p + mats_[i].dims);
      outputs_[i].data = mats_[i].ptr<float>();
    }
    return outputs_;
  }
  const char* backend() const override { return "opencv"; }

 private:
  std::string path_;
  InputSize size_;
  cv::dnn::Net net_;
  std::vector<std::string> names_;
  std::vector<cv::Mat> mats_;
  std::vector<NetworkOutput> outputs_;
};

}  // namespace

std::string opencv_error_text(const std::string& what) {
  // "OpenCV(4.6.0) ./modules/x.cpp:123: error: (-215:Assertion failed) text in function 'f'\n"
  std::string text = what.substr(0, what.find('\n'));
  const std::size_t error = text.find("error: ");
  if (error != std::string::npos) text = text.substr(error + 7);
  const std::size_t function = text.rfind(" in function '");
  if (function != std::string::npos) text.resize(function);
  return text;
}

std::unique_ptr<Network> make_opencv_network(const OnnxFile& file, InputSize size) {
  return std::make_unique<OpenCvNetwork>(file, size);
}

}  // namespace dynslam::segmentation
