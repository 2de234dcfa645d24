#include "dynslam/loop/database.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>
#include <fstream>
#include <limits>
#include <map>
#include <random>
#include <thread>

#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"

#include "loop_testing.hpp"

namespace dynslam::loop {
namespace {

constexpr Scoring kAllScorings[] = {Scoring::kL1,
                                    Scoring::kL2,
                                    Scoring::kChiSquare,
                                    Scoring::kKullbackLeibler,
                                    Scoring::kBhattacharyya,
                                    Scoring::kDotProduct};

// Images with words drawn unevenly, so that some lists are long and some are empty.
struct Images {
  explicit Images(std::size_t count, Scoring scoring = Scoring::kL1, std::size_t words = 5000) {
    for (std::size_t i = 0; i < count; ++i)
      bows.push_back(random_bow(i + 1, 120, words, norm_of(scoring)));
  }
  void add_to(Database& database) const {
    for (std::size_t i = 0; i < bows.size(); ++i) database.add(1000 + i, bows[i]);
  }
  std::vector<BowVector> bows;
};

bool shares_word(const BowVector& a, const BowVector& b) {
  for (const WordId word : a.words()) {
    if (b.weight_of(word) > 0.0) return true;
  }
  return false;
}

TEST(Database, ScoresLikeThePairwiseScoreForEveryScoring) {
  for (const Scoring scoring : kAllScorings) {
    SCOPED_TRACE(static_cast<int>(scoring));
    const Images images(200, scoring);
    Database database(5000, scoring);
    images.add_to(database);
    const BowVector query = random_bow(77, 100, 5000, norm_of(scoring));
    QueryOptions options;
    options.max_results = 0;
    const std::vector<QueryResult> results = database.query(query, options);
    std::size_t expected = 0;
    for (const BowVector& bow : images.bows) expected += shares_word(query, bow) ? 1U : 0U;
    EXPECT_EQ(results.size(), expected);
    for (const QueryResult& result : results) {
      const double exact = score(scoring, query, images.bows[result.id - 1000]);
      EXPECT_NEAR(result.score, exact, 1e-6 + 5e-4 * std::abs(exact)) << result.id;
    }
    for (std::size_t i = 1; i < results.size(); ++i) {
      if (higher_is_better(scoring)) {
        EXPECT_GE(results[i - 1].score, results[i].score);
      } else {
        EXPECT_LE(results[i - 1].score, results[i].score);
      }
    }
  }
}

TEST(Database, ReturnsExactlyTheBestHoweverFewAreAskedFor) {
  for (const Scoring scoring : kAllScorings) {
    SCOPED_TRACE(static_cast<int>(scoring));
    // Few words and many images: lists of several blocks, where a query may stop and skip.
    const std::size_t words = 150;
    Database database(words, scoring);
    std::vector<BowVector> bows;
    for (std::size_t i = 0; i < 3000; ++i) {
      bows.push_back(random_bow(i + 1, 40, words, norm_of(scoring)));
      database.add(i, bows.back());
    }
    QueryOptions all;
    all.max_results = 0;
    for (std::size_t q = 0; q < 20; ++q) {
      const BowVector& query = bows[q * 131];
      const std::vector<QueryResult> every = database.query(query, all);
      for (const std::size_t k : {1U, 2U, 10U, 100U}) {
        QueryOptions few;
        few.max_results = k;
        const std::vector<QueryResult> best = database.query(query, few);
        ASSERT_EQ(best.size(), k);
        for (std::size_t i = 0; i < k; ++i) {
          EXPECT_EQ(best[i].id, every[i].id);
          EXPECT_EQ(best[i].score, every[i].score);
        }
      }
    }
  }
}

TEST(Database, KeepsTheOrderOfAdditionAmongEqualImages) {
  Database database(10);
  BowVector bow;
  bow.push_back(3, 1.0);
  for (const std::uint64_t id : {9U, 2U, 7U}) database.add(id, bow);
  const std::vector<QueryResult> results = database.query(bow);
  ASSERT_EQ(results.size(), 3u);
  EXPECT_EQ(results[0].id, 9u);
  EXPECT_EQ(results[1].id, 2u);
  EXPECT_EQ(results[2].id, 7u);
  EXPECT_DOUBLE_EQ(results[0].score, 1.0);
  EXPECT_EQ(database.ids(), (std::vector<std::uint64_t>{9, 2, 7}));
}

TEST(Database, LeavesOutExcludedImages) {
  const Images images(50);
  Database database(5000);
  images.add_to(database);
  const std::vector<std::uint64_t> excluded = {1004, 1005, 31337};
  QueryOptions options;
  options.max_results = 0;
  const std::size_t before = database.query(images.bows[4], options).size();
  EXPECT_EQ(database.query(images.bows[4], options)[0].id, 1004u);
  options.excluded = excluded;
  const std::vector<QueryResult> results = database.query(images.bows[4], options);
  for (const QueryResult& result : results) {
    EXPECT_NE(result.id, 1004u);
    EXPECT_NE(result.id, 1005u);
  }
  EXPECT_GE(results.size() + 2, before);
}

TEST(Database, LeavesOutResultsWorseThanTheWorstScore) {
  for (const Scoring scoring : kAllScorings) {
    const Images images(300, scoring, 200);
    Database database(200, scoring);
    images.add_to(database);
    QueryOptions options;
    options.max_results = 0;
    const std::vector<QueryResult> all = database.query(images.bows[0], options);
    options.worst_score = all[all.size() / 3].score;
    const std::vector<QueryResult> some = database.query(images.bows[0], options);
    ASSERT_GT(some.size(), all.size() / 3);
    ASSERT_LT(some.size(), all.size() / 2);
    for (std::size_t i = 0; i < some.size(); ++i) EXPECT_EQ(some[i].id, all[i].id);
  }
}

TEST(Database, ForgetsARemovedImageAtOnceAndItsBytesInTime) {
  const Images images(400);
  Database database(5000), fresh(5000);
  images.add_to(database);
  const std::size_t full = database.bytes();
  for (std::size_t i = 0; i < 400; ++i) {
    if (i % 4 != 1) {
      EXPECT_TRUE(database.remove(1000 + i));
      EXPECT_FALSE(database.contains(1000 + i));
      EXPECT_FALSE(database.remove(1000 + i));
    } else {
      fresh.add(1000 + i, images.bows[i]);
    }
  }
  EXPECT_EQ(database.size(), 100u);
  EXPECT_LT(database.bytes(), 3 * full / 4);
  EXPECT_EQ(database.ids(), fresh.ids());
  for (const std::size_t q : {1U, 5U, 101U, 102U}) {
    const auto a = database.query(images.bows[q]), b = fresh.query(images.bows[q]);
    ASSERT_EQ(a.size(), b.size());
    for (std::size_t i = 0; i < a.size(); ++i) {
      EXPECT_EQ(a[i].id, b[i].id);
      EXPECT_EQ(a[i].score, b[i].score);
    }
  }
  database.compact();
  EXPECT_EQ(database.serialize(), fresh.serialize());
}

TEST(Database, TakesARemovedIdAgain) {
  Database database(10);
  BowVector a, b;
  a.push_back(1, 1.0);
  b.push_back(2, 1.0);
  database.add(5, a);
  EXPECT_TRUE(database.remove(5));
  database.add(5, b);
  EXPECT_TRUE(database.query(a).empty());
  ASSERT_EQ(database.query(b).size(), 1u);
  EXPECT_EQ(database.query(b)[0].id, 5u);
}

TEST(Database, StoresImagesWithoutWordsAndNeverFindsThem) {
  Database database(10);
  BowVector zero;
  zero.push_back(4, 0.0);
  database.add(1, {});
  database.add(2, zero);
  EXPECT_EQ(database.size(), 2u);
  EXPECT_TRUE(database.query(zero).empty());
  EXPECT_TRUE(database.query({}).empty());
}

TEST(Database, HoldsDistancesOfEveryLength) {
  // 70,000 images, of which word 0 is in a few far apart and word 1 in all.
  Database database(2);
  for (std::uint64_t i = 0; i < 70000; ++i) {
    BowVector bow;
    if (i == 3 || i == 250 || i == 600 || i == 69999) bow.push_back(0, 0.5);
    bow.push_back(1, 0.5);
    database.add(i, bow);
  }
  BowVector query;
  query.push_back(0, 1.0);
  QueryOptions all;
  all.max_results = 0;
  std::vector<std::uint64_t> ids;
  for (const QueryResult& result : database.query(query, all)) ids.push_back(result.id);
  EXPECT_EQ(ids, (std::vector<std::uint64_t>{3, 250, 600, 69999}));
  BowVector everywhere;
  everywhere.push_back(1, 1.0);
  EXPECT_EQ(database.query(everywhere, all).size(), 70000u);
  EXPECT_LT(database.bytes(), 70000u * 80u);
}

TEST(Database, ScoresNamedImagesAndSaysNaNForUnknownOnes) {
  const Images images(20);
  Database database(5000);
  images.add_to(database);
  const std::vector<std::uint64_t> ids = {1003, 7, 1011};
  std::vector<double> scores(3);
  database.scores(images.bows[3], ids, scores);
  EXPECT_NEAR(scores[0], 1.0, 5e-4);
  EXPECT_TRUE(std::isnan(scores[1]));
  EXPECT_NEAR(scores[2], l1_score(images.bows[3], images.bows[11]), 1e-4);
}

TEST(Database, ClearForgetsEverything) {
  const Images images(20);
  Database database(5000);
  images.add_to(database);
  database.clear();
  EXPECT_TRUE(database.empty());
  EXPECT_TRUE(database.query(images.bows[3]).empty());
  images.add_to(database);
  EXPECT_EQ(database.query(images.bows[3])[0].id, 1003u);
}

TEST(Database, RefusesWhatItCannotStoreAndStaysAsItWas) {
  Database database(10);
  BowVector good, beyond, negative, huge;
  good.push_back(9, 1.0);
  beyond.push_back(10, 1.0);
  negative.push_back(1, -0.5);
  huge.push_back(1, 1e300);
  database.add(1, good);
  EXPECT_THROW(database.add(1, good), InvalidArgument);
  EXPECT_THROW(database.add(2, beyond), InvalidArgument);
  EXPECT_THROW(database.add(2, negative), InvalidArgument);
  EXPECT_THROW(database.add(2, huge), InvalidArgument);
  EXPECT_EQ(database.size(), 1u);
  EXPECT_THROW(Database(0), InvalidArgument);
  EXPECT_THROW(Database(std::size_t{1} << 32), InvalidArgument);
}

TEST(Database, RefusesQueriesThatMeanNothing) {
  Database database(10);
  BowVector good, beyond, negative;
  good.push_back(9, 1.0);
  beyond.push_back(10, 1.0);
  negative.push_back(1, -0.5);
  database.add(1, good);
  std::vector<QueryResult> results = {{99, 0.5}};
  EXPECT_THROW(database.query(beyond, {}, results), InvalidArgument);
  EXPECT_THROW(database.query(negative, {}, results), InvalidArgument);
  QueryOptions options;
  options.worst_score = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(database.query(good, options, results), InvalidArgument);
  ASSERT_EQ(results.size(), 1u);
  EXPECT_EQ(results[0].id, 99u);
  const std::vector<std::uint64_t> ids = {1, 2};
  std::vector<double> scores(1);
  EXPECT_THROW(database.scores(good, ids, scores), InvalidArgument);
  scores.resize(2);
  EXPECT_THROW(database.scores(beyond, ids, scores), InvalidArgument);
}

TEST(Database, AnswersReadersBesideOneWriter) {
  const Images images(300);
  Database database(5000);
  for (std::size_t i = 0; i < 50; ++i) database.add(1000 + i, images.bows[i]);
  std::atomic<bool> done{false};
  std::atomic<std::size_t> wrong{0}, asked{0};
  std::vector<std::thread> readers;
  for (std::size_t r = 0; r < 3; ++r) {
    readers.emplace_back([&, r] {
      for (std::size_t i = r; !done || i < r + 3; i += 3) {
        // The first 20 images stay all the time.
        const std::size_t q = i % 20;
        const std::vector<QueryResult> found = database.query(images.bows[q]);
        if (found.empty() || found[0].id != 1000 + q) ++wrong;
        if (database.size() < 20 || !database.contains(1000 + q)) ++wrong;
        ++asked;
      }
    });
  }
  for (std::size_t i = 50; i < 300; ++i) {
    database.add(1000 + i, images.bows[i]);
    if (i % 2 == 0) database.remove(1000 + i - 25);
  }
  database.compact();
  done = true;
  for (std::thread& reader : readers) reader.join();
  EXPECT_EQ(wrong, 0u);
  EXPECT_GT(asked, 0u);
}

}  // namespace
}  // namespace dynslam::loop
