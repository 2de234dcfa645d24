// What a segmenter is: an image in, instances (class, score, box, mask) out.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <opencv2/core/mat.hpp>
#include <opencv2/core/types.hpp>

#include "dynslam/core/image_view.hpp"

namespace dynslam::segmentation {

/// Depth image of a frame: metres along the optical axis; 0, negative, NaN and
/// infinity mean "no measurement".
using DepthView = ImageView<const float>;

/// What is known of a frame beside its image. Every member may stay at its
/// default; a segmenter that needs one says so.
struct FrameInfo {
  std::uint64_t index = 0;  ///< running number of the frame in its sequence
  double timestamp = 0.0;   ///< seconds
  std::string name;         ///< file name of the image, with or without folder and extension
  DepthView depth;          ///< empty, or of the image's size; only read during the call
};

/// One thing found in an image.
struct Instance {
  int class_id = 0;    ///< index into `Segmenter::class_names()`
  float score = 0.0F;  ///< 0..1
  cv::Rect box;        ///< image pixels, never empty, inside the image
  cv::Mat mask;        ///< 8UC1, 0 or 255, of the size of `box`: pixel (0, 0) is
                       ///< `box.tl()`
  int label = 0;       ///< value in a recorded mask, number of a track; 0 = none
};

/// What a segmenter found in one image.
struct Segmentation {
  int width = 0;                    ///< pixels of the image that was segmented
  int height = 0;                   ///< pixels of the image that was segmented
  std::vector<Instance> instances;  ///< best score first
  double network_ms = 0.0;          ///< wall time of the network itself, 0 if there is none
  double total_ms = 0.0;            ///< wall time of the whole call
};

/// One input or output of a network; -1 is a dimension that the file leaves
/// open.
struct TensorInfo {
  std::string name;
  std::vector<std::int64_t> shape;
};

/// Where a segmenter's answers come from, for reports.
struct SegmenterInfo {
  std::string kind;                 ///< "none", "recorded", "yolov5-seg", ...
  std::string source;               ///< path of the model or folder, empty if there is none
  std::string sha256;               ///< of the model file, lower-case hexadecimal, or empty
  std::string backend;              ///< "opencv", "onnxruntime", or empty
  std::vector<TensorInfo> inputs;   ///< of the network
  std::vector<TensorInfo> outputs;  ///< of the network
};

/// Turns images into instances. The one virtual seam of the room: the choice of
/// segmenter is made at run time.
///
/// Thread-safety: `segment` may change the object (networks have scratch,
/// decorators have history), so one call at a time; different objects are
/// independent.
class Segmenter {
 public:
  virtual ~Segmenter() = default;

  /// Finds the instances of one image.
  ///
  /// `image`: 8UC3 (BGR, as OpenCV reads it), 8UC1 (grey) or 8UC4 (BGRA), any
  /// size above zero. It is read during the call only. Throws InvalidArgument
  /// for any other image (an empty one included) and for a depth view that has
  /// another size than the image; IoError if a file that belongs to the frame
  /// cannot be read. Finding nothing is an empty list.
  virtual Segmentation segment(const cv::Mat& image, const FrameInfo& frame) = 0;

  /// Names of the classes; `Instance::class_id` indexes it. Constant over the
  /// object's life.
  virtual const std::vector<std::string>& class_names() const = 0;

  /// What this segmenter is; computed at construction, cheap.
  virtual SegmenterInfo info() const = 0;

 protected:
  Segmenter() = default;
  Segmenter(const Segmenter&) = default;
  Segmenter& operator=(const Segmenter&) = default;
};

/// Throws InvalidArgument in the name of `function` unless `image` and
/// `frame.depth` are what `Segmenter::segment` asks for. For those who write a
/// segmenter of their own.
void require_segmentable(const char* function, const cv::Mat& image, const FrameInfo& frame);

/// Throws InvalidArgument in the name of `function` unless `depth` is CV_32FC1 in two dimensions or
/// empty.
void require_depth_image(const char* function, const cv::Mat& depth);

/// Throws InvalidArgument in the name of `function` unless `segmentation` is what
/// `Segmenter::segment` promises for an image of size `image`: of that size, every box inside it
/// and every mask 8UC1 of its box's size. For those who take the word of a segmenter that somebody
/// else wrote. O(instances).
void require_sound(const char* function, const Segmentation& segmentation, cv::Size image);

/// The file name of a frame without folder and without an image file's
/// extension (png, jpg, jpeg, bmp, pgm, ppm, tif, tiff): "rgb/1000.066667.jpg"
/// and "1000.066667" both give "1000.066667".
std::string frame_stem(const std::string& name);

}  // namespace dynslam::segmentation
