#include "dynslam/loop/vocabulary_io.hpp"

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cstring>
#include <optional>
#include <string_view>

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "dynslam/core/errors.hpp"
#include "dynslam/loop/vocabulary_tree.hpp"

#include "loop/formats.hpp"
#include "loop/tree_problem.hpp"
#include "loop/vocabulary_block.hpp"

namespace dynslam::loop {
namespace {

/// A file in memory, read-only, for as long as someone holds it.
struct Mapping {
  std::shared_ptr<const std::uint8_t> memory;
  std::size_t size = 0;
};

Mapping map_file(const std::string& path) {
  const int file = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (file < 0) throw_io_error(path, std::strerror(errno));
  struct stat info {};
  const bool is_file = ::fstat(file, &info) == 0 && S_ISREG(info.st_mode);
  const auto size = static_cast<std::size_t>(info.st_size);
  void* at = MAP_FAILED;
  int error = EINVAL;
  if (is_file && size > 0) {
    // All pages at once: asking for them one by one takes longer than to read them.
    at = ::mmap(nullptr, size, PROT_READ, MAP_SHARED | MAP_POPULATE, file, 0);
    error = errno;
  }
  ::close(file);
  if (!is_file) throw_io_error(path, "is not a file");
  if (size == 0) throw_io_error(path, "is empty");
  if (at == MAP_FAILED)
    throw_io_error(path, std::string("cannot be mapped: ") + std::strerror(error));
  return {{static_cast<const std::uint8_t*>(at),
           [size](const std::uint8_t* p) { ::munmap(const_cast<std::uint8_t*>(p), size); }},
          size};
}

bool starts_with(Span<const std::uint8_t> bytes, const void* with, std::size_t size) {
  return bytes.size() >= size && std::memcmp(bytes.data(), with, size) == 0;
}

VocabularyFormat format_of_file(const std::string& path) {
  detail::FileSource source(path, detail::FileSource::Unpack::kNo);
  std::uint8_t buffer[64];
  const Span<const std::uint8_t> bytes(buffer, source.read(buffer, sizeof(buffer)));
  if (bytes.empty()) throw_io_error(path, "is empty");
  constexpr std::uint8_t kGzip[] = {0x1F, 0x8B};
  if (starts_with(bytes, detail::kBlockMagic, sizeof(detail::kBlockMagic)))
    return VocabularyFormat::kDynvoc;
  if (starts_with(bytes, &detail::kDbow3Magic, 8)) return VocabularyFormat::kDbow3;
  if (starts_with(bytes, &detail::kFbowMagic, 8)) return VocabularyFormat::kFbow;
  if (starts_with(bytes, kGzip, sizeof(kGzip))) return VocabularyFormat::kYamlGz;
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  const std::size_t begin = text.find_first_not_of(" \t\r\n");
  if (begin != std::string_view::npos && std::isdigit(static_cast<unsigned char>(text[begin])) != 0)
    return VocabularyFormat::kText;
  if (text.substr(0, 5) == "%YAML" || text.find("vocabulary") != std::string_view::npos)
    return VocabularyFormat::kYaml;
  throw_io_error(path, "is no vocabulary of a known format (its first bytes are not)");
}

VocabularyTree read_tree(const std::string& path, VocabularyFormat format) {
  using detail::FileSource;
  FileSource source(path, format == VocabularyFormat::kYamlGz ? FileSource::Unpack::kGzip
                                                              : FileSource::Unpack::kNo);
  switch (format) {
    case VocabularyFormat::kText:
      return detail::read_text(source);
    case VocabularyFormat::kDbow3:
      return detail::read_dbow3(source);
    case VocabularyFormat::kFbow:
      return detail::read_fbow(source);
    default:
      return detail::read_yaml(source);
  }
}

void write_dynvoc(const Vocabulary& vocabulary, detail::FileSink& sink) {
  const detail::VocabularyBlock& block = vocabulary.block();
  detail::BlockHeader header = block.header;  // `with` changes only the copy
  const Span<const std::uint8_t> body(block.memory.get() + sizeof(header),
                                      header.file_bytes - sizeof(header));
  detail::seal(header, body);
  sink.write(&header, sizeof(header));
  sink.write(body.data(), body.size());
}

}  // namespace

Vocabulary open_vocabulary(const std::string& path) {
  const Mapping mapping = map_file(path);
  if (const auto problem = detail::problem_of({mapping.memory.get(), mapping.size})) {
    throw_io_error(path, *problem);
  }
  auto block = std::make_shared<detail::VocabularyBlock>();
  std::memcpy(&block->header, mapping.memory.get(), sizeof(block->header));
  block->memory = mapping.memory;
  return Vocabulary(std::move(block));
}

Vocabulary load_vocabulary(const std::string& path) {
  const VocabularyFormat format = format_of_file(path);
  if (format == VocabularyFormat::kDynvoc) return open_vocabulary(path);
  const VocabularyTree tree = read_tree(path, format);
  if (const auto problem = detail::problem_of_tree(tree)) throw_io_error(path, *problem);
  return Vocabulary(detail::block_of_tree(tree));
}

VocabularyFormat format_of_name(const std::string& path) {
  std::string name = path;
  std::transform(name.begin(), name.end(), name.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  const auto ends_with = [&name](std::string_view end) {
    return name.size() > end.size() && name.compare(name.size() - end.size(), end.size(), end) == 0;
  };
  if (ends_with(".dynvoc")) return VocabularyFormat::kDynvoc;
  if (ends_with(".txt")) return VocabularyFormat::kText;
  if (ends_with(".yml") || ends_with(".yaml")) return VocabularyFormat::kYaml;
  if (ends_with(".yml.gz") || ends_with(".yaml.gz")) return VocabularyFormat::kYamlGz;
  if (ends_with(".dbow3")) return VocabularyFormat::kDbow3;
  if (ends_with(".fbow")) return VocabularyFormat::kFbow;
  throw_invalid_argument("format_of_name", "path", path,
                         "a name in .dynvoc, .txt, .yml, .yml.gz, .dbow3 or .fbow");
}

void save_vocabulary(const Vocabulary& vocabulary, const std::string& path,
                     VocabularyFormat format) {
  vocabulary.block();  // throws if there is none
  detail::FileSink sink(path, format == VocabularyFormat::kYamlGz ? detail::FileSink::Pack::kGzip
                                                                  : detail::FileSink::Pack::kNo);
  switch (format) {
    case VocabularyFormat::kDynvoc:
      write_dynvoc(vocabulary, sink);
      break;
    case VocabularyFormat::kText:
      detail::write_text(tree_of(vocabulary), sink);
      break;
    case VocabularyFormat::kYaml:
    case VocabularyFormat::kYamlGz:
      detail::write_yaml(tree_of(vocabulary), sink);
      break;
    case VocabularyFormat::kDbow3:
    case VocabularyFormat::kDbow3Compressed:
      detail::write_dbow3(tree_of(vocabulary), format == VocabularyFormat::kDbow3Compressed, sink);
      break;
    case VocabularyFormat::kFbow:
      detail::write_fbow(tree_of(vocabulary), sink);
      break;
  }
  sink.commit();
}

void save_vocabulary(const Vocabulary& vocabulary, const std::string& path) {
  save_vocabulary(vocabulary, path, format_of_name(path));
}

}  // namespace dynslam::loop
