// Inverted index: which stored images share words with a query, and how much.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "dynslam/core/span.hpp"
#include "dynslam/loop/bow_vector.hpp"

namespace dynslam::loop {

/// A stored image that shares words with a query.
struct QueryResult {
  std::uint64_t id = 0;  ///< as given to Database::add
  double score = 0.0;    ///< the database's scoring; see higher_is_better
};

/// What a query returns.
struct QueryOptions {
  /// Most results; 0: all that share a word. A small number also makes the query faster.
  std::size_t max_results = 10;
  /// Results with a worse score are left out; nothing: none is. Not NaN.
  std::optional<double> worst_score;
  /// Images never returned: the query's own neighbours. Ids that are not stored are allowed.
  Span<const std::uint64_t> excluded;
};

/// Inverted index over bag-of-words vectors.
///
/// A word's images form one list of bytes: 14 bits of weight, the distance to the image before in
/// one to four bytes, restarted every 512 bytes so that parts can be skipped; lists of 64
/// neighbouring words share a page. A weight is kept relative to the image's largest one with 11
/// significant bits, so scores differ from `score(scoring, a, b)` by less than 0.05 %; weights
/// below 1/16384 of the image's largest are taken for that.
///
/// Thread-safety: any number of threads may call const functions while one thread at a time calls
/// the others; both sides lock inside. `add` and `remove` keep readers out for less than a
/// millisecond, `compact` for its duration. Moving, assigning and destroying need the object to
/// oneself.
///
/// Source: Nister & Stewenius, CVPR 2006; Galvez-Lopez & Tardos, T-RO 2012. Byte layout and the
/// early termination (after the idea of Turtle & Flood's MaxScore, 1995): engineering.
class Database {
 public:
  /// For the vocabulary's `words` and scoring. Throws InvalidArgument unless 1 <= words < 2^32.
  explicit Database(std::size_t words, Scoring scoring = Scoring::kL1);
  ~Database();
  Database(Database&&) noexcept;
  Database& operator=(Database&&) noexcept;
  Database(const Database&) = delete;
  Database& operator=(const Database&) = delete;

  /// Stores an image, normalized as norm_of(scoring) wants (Vocabulary::transform does that).
  ///
  /// Words of weight 0 are left out; an image without words is stored and never found. Throws
  /// InvalidArgument if the id is stored already, a word is not below words(), or a weight is
  /// negative or above 3e38; nothing is stored then. O(words of the image x bytes of their pages).
  void add(std::uint64_t id, const BowVector& bow);

  /// Takes an image out; false if it was not stored. Its bytes come back by and by: when a third of
  /// the stored images has been removed the lists are compacted. Amortized O(words of the image).
  bool remove(std::uint64_t id);

  /// Forgets all images.
  void clear();

  /// Writes the lists anew without removed images. O(bytes()).
  void compact();

  bool contains(std::uint64_t id) const;
  /// Images stored.
  std::size_t size() const;
  bool empty() const { return size() == 0; }
  /// Ids in the order in which they were added. O(size).
  std::vector<std::uint64_t> ids() const;
  std::size_t words() const;
  Scoring scoring() const;
  /// Memory that the database takes, without the workspaces of queries.
  std::size_t bytes() const;

  /// Replaces `results` by the best images that share a word with `bow`, best first, of equal ones
  /// the one added earlier.
  ///
  /// Exactly the best are returned whatever `max_results`: lists are visited in the order of what
  /// they can add to a score; as soon as the rest cannot lift a new image among the best, only the
  /// images that still may be are followed, through the parts of the lists that hold them.
  ///
  /// An empty vector gives no results. Throws InvalidArgument if a word is not below words(), a
  /// weight is negative or above 3e38, or worst_score is NaN; `results` is then untouched.
  /// O(postings of the words + images); allocates only to grow `results` and a workspace that
  /// queries share (one for each thread that queries at the same time).
  void query(const BowVector& bow, const QueryOptions& options,
             std::vector<QueryResult>& results) const;
  std::vector<QueryResult> query(const BowVector& bow, const QueryOptions& options = {}) const;

  /// scores[i] = score of `bow` against image ids[i]: what two vectors without a common word score
  /// if they share none, NaN if the image is not stored. Throws InvalidArgument as `query` does, or
  /// if the sizes differ. Cost as `query` with all results.
  void scores(const BowVector& bow, Span<const std::uint64_t> ids, Span<double> scores) const;

  /// Writes the database, little endian, with a checksum. Throws IoError if that fails; a file that
  /// was there is replaced only by a complete one. O(bytes()).
  void save(const std::string& path) const;

  /// Reads what `save` wrote.
  ///
  /// Checks everything before use: magic, version, sizes against the length of the file, checksum,
  /// that ids are unique and scales finite, that every list is sorted and within bounds. Throws
  /// IoError naming file and place otherwise. Needs at most twice the file's length in memory
  /// besides 8 bytes for 64 words of the vocabulary.
  static Database load(const std::string& path);

  /// The bytes that `save` writes, and the database that is read from them; `name` stands for the
  /// file in errors.
  std::vector<std::uint8_t> serialize() const;
  static Database deserialize(Span<const std::uint8_t> bytes, const std::string& name = "bytes");

 private:
  struct State;
  explicit Database(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace dynslam::loop
