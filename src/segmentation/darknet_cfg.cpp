#include "segmentation/darknet_cfg.hpp"

#include <algorithm>
#include <cstring>
#include <map>
#include <sstream>
#include <vector>

#include "dynslam/core/errors.hpp"

namespace dynslam::segmentation {
namespace {

std::string trimmed(const std::string& text) {
  const auto first = text.find_first_not_of(" \t\r");
  if (first == std::string::npos) return "";
  return text.substr(first, text.find_last_not_of(" \t\r") - first + 1);
}

// A number from 0 to a million, -1 for anything else.
int number_of(const std::string& text) {
  int value = 0;
  for (const char c : text) {
    if (c < '0' || c > '9') return -1;
    value = std::min(value * 10 + (c - '0'), 1000000);
  }
  return text.empty() ? -1 : value;
}

struct Section {
  std::string name;
  std::map<std::string, std::string> values;

  int number(const std::string& key, int otherwise) const {
    const auto found = values.find(key);
    return found == values.end() ? otherwise : number_of(found->second);
  }
};

std::vector<Section> sections_of(const std::string& text) {
  std::vector<Section> sections;
  std::istringstream stream(text);
  std::string line;
  while (std::getline(stream, line)) {
    line = trimmed(line.substr(0, line.find('#')));
    if (!line.empty() && line.front() == '[') sections.push_back({line, {}});
    const std::size_t equals = line.find('=');
    if (equals == std::string::npos || sections.empty()) continue;
    sections.back().values[trimmed(line.substr(0, equals))] = trimmed(line.substr(equals + 1));
  }
  return sections;
}

// Follows the number of channels through the layers.
class WeightCounter {
 public:
  // False if the layer is not known.
  bool add(const Section& layer) {
    const std::uint64_t before = channels_.empty() ? input_ : channels_.back();
    std::uint64_t after = before;
    if (layer.name == "[convolutional]") {
      if (!convolution(layer, before, after)) return false;
    } else if (layer.name == "[route]") {
      if (!route(layer, after)) return false;
    } else if (layer.name != "[shortcut]" && layer.name != "[maxpool]" &&
               layer.name != "[upsample]" && layer.name != "[yolo]" && layer.name != "[region]" &&
               layer.name != "[dropout]" && layer.name != "[avgpool]") {
      return false;
    }
    channels_.push_back(after);
    return true;
  }
  void set_input(int channels) { input_ = static_cast<std::uint64_t>(std::max(channels, 1)); }
  std::uint64_t total() const { return total_; }

 private:
  bool convolution(const Section& layer, std::uint64_t before, std::uint64_t& after) {
    const int filters = layer.number("filters", 1);
    const int size = layer.number("size", 1);
    const int groups = layer.number("groups", 1);
    if (filters < 1 || size < 1 || size > 1000 || groups < 1) return false;
    after = static_cast<std::uint64_t>(filters);
    const std::uint64_t kernel = after * (before / static_cast<std::uint64_t>(groups)) *
                                 static_cast<std::uint64_t>(size) *
                                 static_cast<std::uint64_t>(size);
    // Bias; with normalization also scale, mean and variance.
    total_ += kernel + after * (layer.number("batch_normalize", 0) == 1 ? 4U : 1U);
    return true;
  }
  bool route(const Section& layer, std::uint64_t& after) const {
    const auto found = layer.values.find("layers");
    if (found == layer.values.end()) return false;
    after = 0;
    std::istringstream list(found->second);
    std::string item;
    while (std::getline(list, item, ',')) {
      item = trimmed(item);
      const bool back = !item.empty() && item.front() == '-';
      const int number = number_of(back ? item.substr(1) : item);
      const auto here = static_cast<int>(channels_.size());
      const int index = back ? here - number : number;
      if (number < 0 || index < 0 || index >= here) return false;
      after += channels_[static_cast<std::size_t>(index)];
    }
    const int groups = layer.number("groups", 1);
    if (groups < 1) return false;
    after /= static_cast<std::uint64_t>(groups);
    return true;
  }

  std::uint64_t input_ = 3;
  std::vector<std::uint64_t> channels_;
  std::uint64_t total_ = 0;
};

}  // namespace

DarknetCfg read_darknet_cfg(const std::string& path, const std::string& text) {
  DarknetCfg cfg;
  WeightCounter counter;
  bool known = true;
  for (const Section& section : sections_of(text)) {
    if (section.name == "[net]" || section.name == "[network]") {
      cfg.width = section.number("width", 0);
      cfg.height = section.number("height", 0);
      counter.set_input(section.number("channels", 3));
      continue;
    }
    if (section.name == "[yolo]" || section.name == "[region]") {
      cfg.classes = section.number("classes", 0);
    }
    known = known && counter.add(section);
  }
  if (cfg.width < 1 || cfg.height < 1 || cfg.width > 8192 || cfg.height > 8192) {
    throw_io_error(path,
                   "is not a Darknet network: expected a [net] section with width and height");
  }
  if (cfg.classes < 1) {
    throw_io_error(path, "is not a detector: expected a [yolo] section with classes");
  }
  if (known) cfg.weights = counter.total();
  return cfg;
}

void require_whole_weights(const std::string& path, const std::string& bytes,
                           const DarknetCfg& cfg) {
  constexpr std::size_t kVersion = 3 * sizeof(std::int32_t);
  if (bytes.size() < kVersion + sizeof(std::int32_t)) {
    throw_io_error(path, "is cut short: it has no header of a Darknet weights file");
  }
  if (!cfg.weights) return;
  std::int32_t version[3];
  std::memcpy(version, bytes.data(), kVersion);
  // The count of images seen has 8 bytes from version 0.2 on.
  const std::size_t header = kVersion + (version[0] * 10 + version[1] >= 2 ? 8U : 4U);
  const std::uint64_t expected = header + *cfg.weights * sizeof(float);
  if (bytes.size() < expected) {
    throw_io_error(path, "is cut short or belongs to another network: it has " +
                             std::to_string(bytes.size()) + " bytes; expected " +
                             std::to_string(expected));
  }
}

}  // namespace dynslam::segmentation
