#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <deque>
#include <filesystem>
#include <iostream>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/files.hpp"
#include "dynslam/core/opencv.hpp"
#include "dynslam/dataset/readers.hpp"
#include "dynslam/evaluation/metrics.hpp"
#include "dynslam/segmentation/mask_policy.hpp"
#include "dynslam/segmentation/mask_propagation.hpp"
#include "dynslam/segmentation/segmenter_factory.hpp"

#include "commands.hpp"
#include "progress.hpp"

namespace dynslam::cli {
namespace {

namespace fs = std::filesystem;
namespace seg = dynslam::segmentation;
using evaluation::quantile;
using nlohmann::json;

// Truth that covers less of the image than this says little about a mask.
constexpr double kMinTruthShare = 0.02;

struct SegmentOptions {
  std::string segmenter;
  std::vector<std::string> images;
  std::string tum;
  std::string out;
  std::vector<std::string> classes;
  std::vector<std::string> touched;
  std::string truth_masks;
  int truth_value = 0;  // 0 = every value but 0
  std::string backend = "opencv";
  float score = seg::NetworkOptions().score_threshold;
  int threads = 0;
  int age = 0;  // frames that the masks are old and carried to the present
  bool plain = false;
  bool json = false;
};

struct Image {
  std::string name;
  cv::Mat pixels;
  cv::Mat depth;
};

// What goes through the segmenter, one by one: named files, or a recording.
class Source {
 public:
  explicit Source(const SegmentOptions& options) : files_(options.images) {
    if (!options.tum.empty()) sequence_ = dataset::open_tum(options.tum);
  }
  std::size_t size() const { return sequence_ ? sequence_->size() : files_.size(); }
  // A bad frame of a recording may be skipped; a bad file that was named is an error.
  bool skips_bad_frames() const { return sequence_ != nullptr; }
  double timestamp(std::size_t i) const { return sequence_ ? sequence_->timestamp(i) : 0.0; }

  Image read(std::size_t i) const {
    if (sequence_) {
      const dataset::Frame frame = sequence_->read(i);
      return {frame.name, frame.color, frame.depth};
    }
    cv::Mat pixels = cv::imread(files_[i], cv::IMREAD_COLOR);
    if (pixels.empty()) throw_io_error(files_[i], "cannot be read as an image");
    return {fs::path(files_[i]).filename().string(), pixels, {}};
  }

 private:
  std::vector<std::string> files_;
  std::unique_ptr<dataset::Sequence> sequence_;
};

// Intersection over union of the mask with the truth, where the truth says enough.
class MaskScore {
 public:
  MaskScore(std::string folder, int value) : folder_(std::move(folder)), value_(value) {}

  // `fresh`: the mask of the frame itself where `mask` was carried to it, else the same.
  void add(const std::string& stem, const cv::Mat& mask, const cv::Mat& fresh) {
    if (folder_.empty()) return;
    const std::string path = (fs::path(folder_) / (stem + ".png")).string();
    if (!fs::exists(path)) return;
    const cv::Mat labels = cv::imread(path, cv::IMREAD_UNCHANGED);
    if (labels.empty() || labels.channels() != 1) {
      throw_io_error(path, "is not a label image with one channel");
    }
    if (labels.size() != mask.size()) throw_io_error(path, "has another size than its image");
    ++found_;
    const cv::Mat truth = value_ == 0 ? labels != 0 : labels == value_;
    if (cv::countNonZero(truth) < kMinTruthShare * static_cast<double>(truth.total())) return;
    sum_ += iou(truth, mask);
    fresh_sum_ += iou(truth, fresh);
    ++scored_;
  }
  int frames_scored() const { return scored_; }
  json mean() const { return scored_ == 0 ? json(nullptr) : json(sum_ / scored_); }
  json fresh_mean() const { return scored_ == 0 ? json(nullptr) : json(fresh_sum_ / scored_); }

  void require_some_truth() const {
    if (!folder_.empty() && found_ == 0) {
      throw_io_error(folder_, "holds no mask for any of the images (NAME.png)");
    }
  }

 private:
  static double iou(const cv::Mat& a, const cv::Mat& b) {
    return static_cast<double>(cv::countNonZero(a & b)) / cv::countNonZero(a | b);
  }

  std::string folder_;
  int value_;
  int found_ = 0;
  int scored_ = 0;
  double sum_ = 0.0;
  double fresh_sum_ = 0.0;
};

// Masks as a system has them whose network is late by some frames: carried to the present.
class LateMasks {
 public:
  explicit LateMasks(int age) : age_(static_cast<std::size_t>(age)) {
    seg::PropagationOptions options;
    options.history = std::max(options.history, age + 1);
    options.max_age = std::max(options.max_age, age);
    propagator_ = seg::MaskPropagator(options);
  }

  // What is known of the frame when its own segmentation is `age` frames away; nothing before the
  // first one has come.
  std::optional<seg::Segmentation> carried(const cv::Mat& pixels, const seg::FrameInfo& frame,
                                           const seg::Segmentation& own) {
    waiting_.emplace_back(frame.index, own);
    const auto start = std::chrono::steady_clock::now();
    propagator_.add_frame(pixels, frame);
    std::optional<seg::Segmentation> result;
    if (waiting_.size() > age_) {
      propagator_.set_segmentation(waiting_.front().first, std::move(waiting_.front().second));
      waiting_.pop_front();
      if (auto now = propagator_.current()) result = std::move(now->segmentation);
    }
    using Milliseconds = std::chrono::duration<double, std::milli>;
    times_.push_back(Milliseconds(std::chrono::steady_clock::now() - start).count());
    return result;
  }
  const std::vector<double>& times() const { return times_; }

 private:
  std::size_t age_;
  seg::MaskPropagator propagator_;
  std::deque<std::pair<std::uint64_t, seg::Segmentation>> waiting_;
  std::vector<double> times_;
};

void make_folder(const fs::path& path) {
  std::error_code error;
  fs::create_directories(path, error);
  if (error) throw_io_error(path.string(), "cannot be made: " + error.message());
}

void save_image(const fs::path& path, const cv::Mat& image) {
  bool written = false;
  try {
    written = cv::imwrite(path.string(), image);
  } catch (const cv::Exception&) {
    written = false;
  }
  if (!written) throw_io_error(path.string(), "cannot be written");
}

std::string class_name(const seg::Instance& instance, const std::vector<std::string>& names) {
  const auto id = static_cast<std::size_t>(instance.class_id);
  return id < names.size() ? names[id] : "class " + std::to_string(instance.class_id);
}

// The image with its instances: dynamic ones red, others green, outlines and names on top.
cv::Mat overlay(const cv::Mat& pixels, const seg::Segmentation& found,
                const seg::MaskPolicy& policy, const std::vector<std::string>& names) {
  cv::Mat picture;
  if (pixels.channels() == 1) {
    cv::cvtColor(pixels, picture, cv::COLOR_GRAY2BGR);
  } else {
    picture = pixels.clone();
  }
  for (const seg::Instance& instance : found.instances) {
    const cv::Scalar colour =
        policy.is_dynamic(instance, names) ? cv::Scalar(0, 0, 255) : cv::Scalar(0, 200, 0);
    cv::Mat window = picture(instance.box);
    cv::Mat tinted;
    cv::addWeighted(window, 0.55, cv::Mat(window.size(), window.type(), colour), 0.45, 0, tinted);
    tinted.copyTo(window, instance.mask);
    std::vector<std::vector<cv::Point>> outlines;
    cv::findContours(instance.mask.clone(), outlines, cv::RETR_EXTERNAL, cv::CHAIN_APPROX_NONE);
    cv::drawContours(window, outlines, -1, colour, 1);
    cv::rectangle(picture, instance.box, colour, 1);
    char label[64];
    std::snprintf(label, sizeof label, "%s %.2f", class_name(instance, names).c_str(),
                  static_cast<double>(instance.score));
    const cv::Point at(instance.box.x + 3, std::max(instance.box.y + 14, 14));
    cv::putText(picture, label, at, cv::FONT_HERSHEY_SIMPLEX, 0.45, cv::Scalar(0, 0, 0), 3);
    cv::putText(picture, label, at, cv::FONT_HERSHEY_SIMPLEX, 0.45, cv::Scalar(255, 255, 255), 1);
  }
  return picture;
}

json tensors_json(const std::vector<seg::TensorInfo>& tensors) {
  json list = json::array();
  for (const seg::TensorInfo& tensor : tensors) {
    list.push_back({{"name", tensor.name}, {"shape", tensor.shape}});
  }
  return list;
}

json segmenter_json(const seg::SegmenterInfo& info) {
  return {{"kind", info.kind},
          {"source", info.source},
          {"sha256", info.sha256},
          {"inputs", tensors_json(info.inputs)},
          {"outputs", tensors_json(info.outputs)}};
}

json spread_json(const std::vector<double>& values) {
  return {{"median", quantile(values, 0.5)}, {"p95", quantile(values, 0.95)}};
}

json instances_json(const seg::Segmentation& found, const std::vector<std::string>& names) {
  json list = json::array();
  for (const seg::Instance& instance : found.instances) {
    const cv::Rect& box = instance.box;
    list.push_back({{"class", class_name(instance, names)},
                    {"score", instance.score},
                    {"box", {box.x, box.y, box.width, box.height}},
                    {"mask_pixels", cv::countNonZero(instance.mask)}});
  }
  return list;
}

// The work of the subcommand, an image at a time.
class SegmentRun {
 public:
  explicit SegmentRun(const SegmentOptions& options)
      : options_(options),
        segmenter_(make_segmenter(options)),
        policy_(make_policy(options)),
        source_(options),
        score_(options.truth_masks, options.truth_value) {
    if (options.age > 0) late_.emplace(options.age);
    if (options.out.empty()) return;
    make_folder(fs::path(options.out) / "overlay");
    make_folder(fs::path(options.out) / "mask");
  }

  int operator()() {
    segment_all();
    score_.require_some_truth();
    if (images_.empty()) throw_io_error(options_.tum, "has no readable image: " + first_problem_);
    finish();
    return 0;
  }

 private:
  void segment_all() {
    Progress progress("segment", source_.size());
    for (std::size_t i = 0; i < source_.size(); ++i) {
      progress.update(i);
      Image image;
      try {
        image = source_.read(i);
      } catch (const IoError& error) {
        if (!source_.skips_bad_frames()) throw;
        if (skipped_++ == 0) first_problem_ = error.what();
        continue;
      }
      one(i, image);
    }
  }

  static std::unique_ptr<seg::Segmenter> make_segmenter(const SegmentOptions& options) {
    seg::SegmenterFactoryOptions factory;
    factory.network.backend = seg::backend_from_name(options.backend);
    factory.network.score_threshold = options.score;
    factory.network.threads = options.threads;
    factory.refine = !options.plain;
    // Named images need not be of one camera, or in its order.
    factory.refinement.bridge = !options.tum.empty();
    return seg::make_segmenter(options.segmenter, factory);
  }
  static seg::MaskPolicy make_policy(const SegmentOptions& options) {
    seg::MaskPolicyOptions policy;
    policy.dilation_px = 0;
    policy.min_score = 0.0F;
    if (!options.classes.empty()) policy.classes = options.classes;
    policy.touched_classes = options.touched;
    return seg::MaskPolicy(policy);
  }

  void one(std::size_t index, const Image& image) {
    seg::FrameInfo frame;
    frame.index = index;
    frame.timestamp = source_.timestamp(index);
    frame.name = image.name;
    frame.depth = as_view<const float>(image.depth);
    seg::Segmentation found = segmenter_->segment(image.pixels, frame);
    times_.push_back(found.total_ms);
    network_times_.push_back(found.network_ms);
    const auto& names = segmenter_->class_names();
    cv::Mat mask = policy_.mask(found, names);
    const cv::Mat fresh = mask;
    bool known = true;
    if (late_) {
      std::optional<seg::Segmentation> carried = late_->carried(image.pixels, frame, found);
      known = carried.has_value();
      found.instances.clear();
      if (known) found.instances = std::move(carried->instances);
      mask = policy_.mask(found, names);
    }
    const std::string stem = seg::frame_stem(image.name);
    if (known) score_.add(stem, mask, fresh);
    save(stem, image, mask, found);
    images_.push_back({{"name", image.name},
                       {"instances", instances_json(found, names)},
                       {"ms", found.total_ms},
                       {"network_ms", found.network_ms}});
  }

  void save(const std::string& stem, const Image& image, const cv::Mat& mask,
            const seg::Segmentation& found) const {
    if (options_.out.empty()) return;
    const fs::path out(options_.out);
    save_image(out / "mask" / (stem + ".png"), mask);
    save_image(out / "overlay" / (stem + ".jpg"),
               overlay(image.pixels, found, policy_, segmenter_->class_names()));
  }

  void finish() const {
    const seg::SegmenterInfo info = segmenter_->info();
    json report = {{"images", images_},
                   {"mean_iou", score_.mean()},
                   {"frames_scored", score_.frames_scored()},
                   {"frames_skipped", skipped_},
                   {"ms", spread_json(times_)},
                   {"network_ms", spread_json(network_times_)},
                   {"backend", info.backend},
                   {"segmenter", segmenter_json(info)}};
    if (late_) {
      report["age"] = options_.age;
      report["mean_iou_fresh"] = score_.fresh_mean();
      report["carry_ms"] = spread_json(late_->times());
    }
    if (!options_.out.empty()) {
      const fs::path path = fs::path(options_.out) / "segment.json";
      write_file_atomically(path.string(), report.dump(2) + "\n");
    }
    if (options_.json) {
      std::cout << report.dump() << '\n';
    } else {
      print();
    }
  }

  void print() const {
    std::printf("%zu images, %zu skipped, median %.1f ms, p95 %.1f ms, network %.1f ms\n",
                images_.size(), skipped_, quantile(times_, 0.5), quantile(times_, 0.95),
                quantile(network_times_, 0.5));
    if (score_.frames_scored() > 0) {
      std::printf("mean IoU %.4f over %d images\n", score_.mean().get<double>(),
                  score_.frames_scored());
    }
    if (score_.frames_scored() > 0 && late_) {
      std::printf("of masks %d frames old; of the frames' own masks it is %.4f\n", options_.age,
                  score_.fresh_mean().get<double>());
    }
    if (!options_.out.empty()) {
      std::printf("overlays, masks and segment.json are in %s\n", options_.out.c_str());
    }
  }

  SegmentOptions options_;
  std::unique_ptr<seg::Segmenter> segmenter_;
  seg::MaskPolicy policy_;
  Source source_;
  MaskScore score_;
  std::optional<LateMasks> late_;
  std::size_t skipped_ = 0;
  std::string first_problem_;  // of those skipped
  json images_ = json::array();
  std::vector<double> times_;
  std::vector<double> network_times_;
};

}  // namespace

CLI::App* add_segment_command(CLI::App& app, std::function<int()>& run) {
  auto options = std::make_shared<SegmentOptions>();
  CLI::App* command = app.add_subcommand("segment", "run a segmenter over images");
  command->footer(
      "Example: dynslam segment yolo-seg:yolov5n-seg.onnx --tum DIR --truth-masks DIR/mask "
      "--truth-value 1 --out OUT");
  command
      ->add_option(
          "SEGMENTER", options->segmenter,
          "none | yolo-seg:M.onnx | yolo:M.onnx | yolox:M.onnx | darknet:M.cfg,M.weights | "
          "mask-rcnn:M.onnx | mask-rcnn:M.pb,M.pbtxt | semantic:M.onnx | recorded:DIR")
      ->required();
  CLI::Option* images = command->add_option("IMAGE", options->images, "image files");
  CLI::Option* tum = command->add_option("--tum", options->tum, "recording in TUM RGB-D layout");
  images->excludes(tum);
  command->add_option("--out", options->out,
                      "folder for overlays, masks and segment.json; without it only the report");
  command
      ->add_option("--classes", options->classes,
                   "dynamic classes; default: people, vehicles, animals")
      ->delimiter(',');
  command
      ->add_option("--touched", options->touched,
                   "classes that are dynamic where a dynamic one touches them; default: none")
      ->delimiter(',');
  CLI::Option* truth =
      command->add_option("--truth-masks", options->truth_masks, "folder of true masks, NAME.png");
  command
      ->add_option("--truth-value", options->truth_value,
                   "value of the true masks that counts; default 0: all but 0")
      ->check(CLI::Range(0, 65535))
      ->needs(truth);
  command->add_option("--backend", options->backend, "what runs the network")
      ->check(CLI::IsMember({"opencv", "onnxruntime"}))
      ->capture_default_str();
  command->add_option("--score", options->score, "least score of an instance")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  command->add_option("--threads", options->threads, "of ONNX Runtime; default 0: its own choice")
      ->check(CLI::Range(0, 1024));
  command
      ->add_option(
          "--age", options->age,
          "give each frame the masks of one so many frames before, carried to it; default 0")
      ->check(CLI::Range(0, 100))
      ->needs(tum);
  command->add_flag("--plain", options->plain,
                    "the network's own answers, without depth and memory");
  command->add_flag("--json", options->json, "print one JSON object and nothing else");
  command->callback([options, &run] {
    if (options->images.empty() && options->tum.empty()) {
      throw CLI::ValidationError("segment", "give IMAGE files or --tum DIR");
    }
    run = [options] { return SegmentRun(*options)(); };
  });
  return command;
}

}  // namespace dynslam::cli
