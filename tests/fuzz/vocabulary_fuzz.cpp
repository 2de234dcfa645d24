// Whatever the bytes, a reader of vocabularies gives a vocabulary that can be used, or an IoError.
// The format is chosen by a macro.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include <sys/mman.h>
#include <unistd.h>

#include "dynslam/core/errors.hpp"
#include "dynslam/loop/vocabulary_io.hpp"
#include "dynslam/loop/vocabulary_tree.hpp"

#include "loop/formats.hpp"
#include "loop/tree_problem.hpp"
#include "loop/vocabulary_block.hpp"

namespace {

using dynslam::loop::Vocabulary;
namespace detail = dynslam::loop::detail;

/// A file without a disk.
class MemoryFile {
 public:
  MemoryFile(const std::uint8_t* bytes, std::size_t size) : file_(memfd_create("fuzz", 0)) {
    if (file_ < 0 || ::write(file_, bytes, size) != static_cast<ssize_t>(size)) std::abort();
  }
  ~MemoryFile() { ::close(file_); }
  std::string path() const { return "/proc/self/fd/" + std::to_string(file_); }

 private:
  int file_;
};

#if defined(FUZZ_DYNVOC)
Vocabulary read(const std::uint8_t* bytes, std::size_t size) {
  // Sums that match, or nothing behind them would ever be looked at.
  std::vector<std::uint8_t> sealed(bytes, bytes + size);
  if (size >= sizeof(detail::BlockHeader)) {
    detail::BlockHeader header;
    std::memcpy(&header, bytes, sizeof(header));
    detail::seal(header, {bytes + sizeof(header), size - sizeof(header)});
    std::memcpy(sealed.data(), &header, sizeof(header));
  }
  const MemoryFile file(sealed.data(), sealed.size());
  return dynslam::loop::open_vocabulary(file.path());
}
#elif defined(FUZZ_YAML_GZ)
Vocabulary read(const std::uint8_t* bytes, std::size_t size) {
  const MemoryFile file(bytes, size);
  detail::FileSource source(file.path(), detail::FileSource::Unpack::kGzip);
  const auto tree = detail::read_yaml(source);
  if (const auto problem = detail::problem_of_tree(tree)) throw dynslam::IoError(*problem);
  return Vocabulary(detail::block_of_tree(tree));
}
#else
Vocabulary read(const std::uint8_t* bytes, std::size_t size) {
  detail::MemorySource source("fuzz", {bytes, size});
#if defined(FUZZ_TEXT)
  const auto tree = detail::read_text(source);
#elif defined(FUZZ_YAML)
  const auto tree = detail::read_yaml(source);
#elif defined(FUZZ_DBOW3)
  const auto tree = detail::read_dbow3(source);
#else
  const auto tree = detail::read_fbow(source);
#endif
  if (const auto problem = detail::problem_of_tree(tree)) throw dynslam::IoError(*problem);
  return Vocabulary(detail::block_of_tree(tree));
}
#endif

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  try {
    const Vocabulary vocabulary = read(bytes, size);
    const std::vector<std::uint8_t> descriptors(
        4 * static_cast<std::size_t>(vocabulary.descriptor_bytes()), 0x5A);
    dynslam::loop::BowVector bow;
    dynslam::loop::FeatureVector direct;
    vocabulary.transform({{descriptors.data(), vocabulary.descriptor_bytes(), 4}}, 1, bow, direct);
    // What was accepted is consistent enough to be taken apart and put together again.
    const auto again = make_vocabulary(tree_of(vocabulary));
    if (again.nodes() != vocabulary.nodes() || again.words() > vocabulary.words()) std::abort();
  } catch (const dynslam::IoError&) {
  }
  return 0;
}
