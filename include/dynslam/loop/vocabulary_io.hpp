// Files of vocabularies: ours, and those of DBoW2, DBoW3, FBoW and ORB-SLAM.
#pragma once

#include <string>

#include "dynslam/loop/vocabulary.hpp"

namespace dynslam::loop {

enum class VocabularyFormat : std::uint8_t {
  kDynvoc,           ///< .dynvoc: ours, mapped into memory and ready at once
  kText,             ///< .txt: ORBvoc.txt, DBoW2's tree as text with ORB-SLAM's header
  kYaml,             ///< .yml, .yaml: DBoW2 and DBoW3 through OpenCV
  kYamlGz,           ///< .yml.gz, .yaml.gz: the same, compressed
  kDbow3,            ///< .dbow3: DBoW3, binary
  kDbow3Compressed,  ///< DBoW3, binary, in QuickLZ chunks
  kFbow,             ///< .fbow: FBoW
};

/// Maps a .dynvoc file.
///
/// The file is checked in full before anything of it is used: magic number, version, byte order,
/// checksums, sizes, every link of the tree, every weight. Its pages are shared with other
/// processes and are no copy; the file must not be changed in place while the vocabulary is used
/// (save_vocabulary replaces files and may be used).
///
/// Throws IoError, naming the file and what is wrong where. O(bytes): a pass at the speed of
/// memory, no allocation that grows with the descriptors.
Vocabulary open_vocabulary(const std::string& path);

/// Reads a vocabulary of any format above; which one, its first bytes tell, not its name.
///
/// Takes nothing on trust: every count is compared with what the file can hold before memory is
/// taken for it, indices are within their ranges, the tree is connected and free of cycles, weights
/// lie within 0 .. kMaxWordWeight, compressed files may not grow beyond what a vocabulary can
/// compress to. A .dynvoc file is mapped.
///
/// Node and word numbers are those of the file; in ORBvoc.txt the line (the header is line 0), in
/// files of FBoW, which number no nodes, the order of the blocks. FBoW's own files hold neither
/// weighting nor scoring: they are read as kTfIdf, kL2 and single precision, which is what FBoW
/// does. Ours say more, where FBoW does not look.
///
/// Throws IoError, naming the file and what is wrong where; what is missing, longer than it says or
/// followed by something else is wrong.
Vocabulary load_vocabulary(const std::string& path);

/// Format that a name stands for by its ending. Throws InvalidArgument if it does not tell.
VocabularyFormat format_of_name(const std::string& path);

/// Writes a vocabulary. The file appears under its name when it is complete, or not at all.
///
/// What a format cannot hold and results depend on is an InvalidArgument, not a silent loss:
/// - kText: k <= 20 and levels <= 10, as its readers want;
/// - kYaml, kYamlGz, kDbow3: numbers of words without gaps, every leaf its own (renumber_words);
/// - kText: the same, and an order of the nodes in which words ascend. If they do not in the order
///   of the nodes, nodes are renumbered; words never are;
/// - kFbow: FBoW sees weights as floats. Ours that are none are kept besides, for our own reader.
///
/// Reading what was written gives the same results, bit for bit; kText may renumber nodes.
/// Throws IoError if the file cannot be written. O(bytes).
void save_vocabulary(const Vocabulary& vocabulary, const std::string& path,
                     VocabularyFormat format);
void save_vocabulary(const Vocabulary& vocabulary, const std::string& path);

}  // namespace dynslam::loop
