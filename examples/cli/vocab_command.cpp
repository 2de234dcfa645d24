#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <nlohmann/json.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/loop/vocabulary_io.hpp"
#include "dynslam/loop/vocabulary_training.hpp"
#include "dynslam/loop/vocabulary_tree.hpp"

#include "checks.hpp"
#include "commands.hpp"
#include "descriptor_files.hpp"
#include "progress.hpp"

namespace dynslam::cli {
namespace {

using json = nlohmann::json;
using Clock = std::chrono::steady_clock;

const std::vector<std::string> kWeightings = {"tf-idf", "tf", "idf", "binary"};
const std::vector<std::string> kScorings = {"l1", "l2", "chi-square", "kl", "bhattacharyya", "dot"};

double since(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

int index_of(const std::vector<std::string>& names, const std::string& name) {
  return static_cast<int>(std::find(names.begin(), names.end(), name) - names.begin());
}

json describe(const loop::Vocabulary& v) {
  return {{"words", v.words()},
          {"nodes", v.nodes()},
          {"k", v.k()},
          {"levels", v.levels()},
          {"descriptor_bytes", v.descriptor_bytes()},
          {"weighting", kWeightings[static_cast<std::size_t>(v.weighting())]},
          {"scoring", kScorings[static_cast<std::size_t>(v.scoring())]},
          {"single_precision", v.single_precision()},
          {"bytes", v.bytes()}};
}

void print(const json& report, bool as_json) {
  if (as_json) {
    std::cout << report.dump() << '\n';
    return;
  }
  for (const auto& [key, value] : report.items()) {
    const std::string text = value.is_string() ? value.get<std::string>() : value.dump();
    std::printf("%-20s %s\n", key.c_str(), text.c_str());
  }
}

struct TrainOptions {
  std::vector<std::string> inputs;
  std::string out;
  std::string weighting = "tf-idf";
  std::string scoring = "l1";
  int features = 1000;
  std::size_t every = 1;
  bool json = false;
  loop::TrainingOptions training;
};

int train(const TrainOptions& given) {
  TrainOptions options = given;
  const loop::VocabularyFormat format = loop::format_of_name(options.out);
  loop::TrainingOptions& training = options.training;
  training.weighting = static_cast<loop::Weighting>(index_of(kWeightings, options.weighting));
  training.scoring = static_cast<loop::Scoring>(index_of(kScorings, options.scoring));
  training.validate();
  const auto start = Clock::now();
  const TrainingSet set =
      read_training_set(options.inputs, options.features, options.every, training.threads);
  if (set.rows() == 0) throw InvalidArgument("vocab train: the pictures show no features");
  const double read_ms = since(start);
  // With one image alone no word is rarer than another: all weigh 1.
  const bool counts_images = set.image_ends.size() > 1;
  const auto trained_from = Clock::now();
  std::unique_ptr<Progress> progress;
  training.progress = [&progress](std::size_t done, std::size_t total) {
    if (!progress) progress = std::make_unique<Progress>("training", total);
    progress->update(done);
  };
  const loop::Vocabulary vocabulary = loop::train_vocabulary(
      set.view(),
      counts_images ? Span<const std::size_t>(set.image_ends) : Span<const std::size_t>(),
      training);
  progress.reset();
  const double train_ms = since(trained_from);
  loop::save_vocabulary(vocabulary, options.out, format);

  json report = describe(vocabulary);
  const double full = std::pow(static_cast<double>(training.k), training.levels);
  report["words_of_full_tree"] = full;
  report["words_missing"] = full - static_cast<double>(vocabulary.words());
  report["descriptors"] = set.rows();
  report["images"] = set.images;
  report["descriptor_files"] = set.files;
  report["idf"] = counts_images;
  report["read_ms"] = read_ms;
  report["train_ms"] = train_ms;
  report["out"] = options.out;
  print(report, options.json);
  return 0;
}

struct ConvertOptions {
  std::string in;
  std::string out;
  bool compress = false;
  bool renumber = false;
  bool json = false;
};

int convert(const ConvertOptions& options) {
  loop::VocabularyFormat format = loop::format_of_name(options.out);
  if (options.compress) {
    if (format != loop::VocabularyFormat::kDbow3)
      throw InvalidArgument("vocab convert: --compress is for .dbow3; name a .yml.gz as such");
    format = loop::VocabularyFormat::kDbow3Compressed;
  }
  loop::Vocabulary vocabulary = loop::load_vocabulary(options.in);
  if (options.renumber) {
    loop::VocabularyTree tree = loop::tree_of(vocabulary);
    loop::renumber_words(tree);
    vocabulary = loop::make_vocabulary(tree);
  }
  loop::save_vocabulary(vocabulary, options.out, format);
  json report = describe(vocabulary);
  report["out"] = options.out;
  report["file_bytes"] = std::filesystem::file_size(options.out);
  print(report, options.json);
  return 0;
}

int info(const std::string& path, bool as_json) {
  const auto start = Clock::now();
  const loop::Vocabulary vocabulary = loop::load_vocabulary(path);
  const double load_ms = since(start);
  json report = describe(vocabulary);
  report["load_ms"] = load_ms;
  report["file_bytes"] = std::filesystem::file_size(path);
  std::size_t stopped = 0;
  for (loop::WordId word = 0; word < vocabulary.words(); ++word)
    stopped += vocabulary.word_weight(word) > 0.0 ? 0 : 1;
  report["stopped_words"] = stopped;
  print(report, as_json);
  return 0;
}

void add_train(CLI::App& vocab, std::function<int()>& run) {
  auto o = std::make_shared<TrainOptions>();
  o->training.threads = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  CLI::App* command = vocab.add_subcommand("train", "train on pictures or descriptors");
  command->footer(
      "Example: dynslam vocab train recordings/ --k 10 --levels 6 --out orb.dynvoc\n"
      "Pictures give ORB descriptors; .npy files hold uint8 matrices, a descriptor a row, and "
      "count "
      "as one image each.");
  command->add_option("inputs", o->inputs, "pictures, .npy files, or folders of them")->required();
  command->add_option("--out", o->out, "F.dynvoc, .txt, .yml[.gz], .dbow3 or .fbow")
      ->check(readable_by(loop::format_of_name))
      ->required();
  command->add_option("--k", o->training.k, "children of a node")
      ->check(CLI::Range(2, 255))
      ->capture_default_str();
  command->add_option("--levels", o->training.levels, "levels below the root")
      ->check(CLI::Range(1, 20))
      ->capture_default_str();
  command->add_option("--weighting", o->weighting, "what a word counts")
      ->check(CLI::IsMember(kWeightings))
      ->capture_default_str();
  command->add_option("--scoring", o->scoring, "how vectors are compared")
      ->check(CLI::IsMember(kScorings))
      ->capture_default_str();
  command->add_option("--features", o->features, "ORB features of a picture")
      ->check(CLI::Range(10, 100000))
      ->capture_default_str();
  command->add_option("--every", o->every, "every n-th file of a folder")
      ->check(CLI::Range(1, 1000000))
      ->capture_default_str();
  command->add_option("--rounds", o->training.max_rounds, "rounds of clustering a node")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  command->add_option("--min-split", o->training.min_split, "descriptors of a node that splits")
      ->check(CLI::Range(2, 1000000))
      ->capture_default_str();
  command->add_option("--threads", o->training.threads, "threads; the result is the same")
      ->check(CLI::Range(1, 1024))
      ->capture_default_str();
  command->add_option("--seed", o->training.seed, "start of the random numbers")
      ->capture_default_str();
  command->add_flag("--json", o->json, "print one JSON object and nothing else");
  command->callback([o, &run] { run = [o] { return train(*o); }; });
}

void add_convert(CLI::App& vocab, std::function<int()>& run) {
  auto o = std::make_shared<ConvertOptions>();
  CLI::App* command = vocab.add_subcommand("convert", "write a vocabulary in another format");
  command->footer(
      "Example: dynslam vocab convert ORBvoc.txt ORBvoc.dynvoc\n"
      "The content of IN tells its format, the name of OUT the other one: .dynvoc, .txt (ORBvoc), "
      ".yml[.gz] (DBoW2, DBoW3), .dbow3, .fbow.");
  command->add_option("in", o->in, "vocabulary of any format")->required();
  command->add_option("out", o->out, "what to write")
      ->check(readable_by(loop::format_of_name))
      ->required();
  command->add_flag("--compress", o->compress, ".dbow3 in QuickLZ chunks");
  command->add_flag("--renumber", o->renumber, "number words anew, without gaps");
  command->add_flag("--json", o->json, "print one JSON object and nothing else");
  command->callback([o, &run] { run = [o] { return convert(*o); }; });
}

void add_info(CLI::App& vocab, std::function<int()>& run) {
  struct InfoOptions {
    std::string path;
    bool json = false;
  };
  auto o = std::make_shared<InfoOptions>();
  CLI::App* command = vocab.add_subcommand("info", "say what is in a vocabulary");
  command->footer("Example: dynslam vocab info orb.dynvoc --json");
  command->add_option("file", o->path, "vocabulary of any format")->required();
  command->add_flag("--json", o->json, "print one JSON object and nothing else");
  command->callback([o, &run] { run = [o] { return info(o->path, o->json); }; });
}

}  // namespace

CLI::App* add_vocab_command(CLI::App& app, std::function<int()>& run) {
  CLI::App* command = app.add_subcommand("vocab", "train, convert and describe vocabularies");
  command->require_subcommand(1);
  command->footer("Example: dynslam vocab info orb.dynvoc");
  add_train(*command, run);
  add_convert(*command, run);
  add_info(*command, run);
  return command;
}

}  // namespace dynslam::cli
