// The database: adding, asking for ten and for all, memory, file.
#include <cstdint>
#include <map>
#include <memory>
#include <stdexcept>
#include <vector>

#include <benchmark/benchmark.h>

#include "dynslam/loop/database.hpp"

#include "database_images.hpp"

namespace {

using namespace dynslam::loop;
using benchmark_data::kDatabaseWords;
using benchmark_data::walk_image;

/// Databases are expensive to fill: one for each size.
const Database& database_of(std::size_t images) {
  static std::map<std::size_t, std::unique_ptr<Database>> databases;
  auto& database = databases[images];
  if (database == nullptr) {
    database = std::make_unique<Database>(kDatabaseWords);
    for (std::size_t i = 0; i < images; ++i) database->add(i, walk_image(i));
  }
  return *database;
}

void query(benchmark::State& state) {
  const auto images = static_cast<std::size_t>(state.range(0));
  const Database& database = database_of(images);
  std::vector<BowVector> queries;
  for (std::size_t q = 0; q < 32; ++q) queries.push_back(walk_image((q * 7919) % images));
  QueryOptions options;
  options.max_results = static_cast<std::size_t>(state.range(1));
  std::vector<QueryResult> results;
  for (std::size_t q = 0; q < 32; ++q) {  // each image finds itself first
    database.query(queries[q], options, results);
    if (results.empty() || results[0].id != (q * 7919) % images)
      throw std::logic_error("the database returns wrong images");
  }
  std::size_t q = 0;
  for (auto _ : state) {
    database.query(queries[q++ % 32], options, results);
    benchmark::DoNotOptimize(results.data());
  }
  state.counters["MB"] = 1e-6 * static_cast<double>(database.bytes());
}
BENCHMARK(query)->ArgNames({"images", "results"})->ArgsProduct({{1000, 10000}, {10, 0}});

void add(benchmark::State& state) {
  std::vector<BowVector> images;
  for (std::size_t i = 0; i < 200; ++i) images.push_back(walk_image(i));
  Database database(kDatabaseWords);
  std::uint64_t id = 0;
  for (auto _ : state) {
    database.add(id, images[id % 200]);
    ++id;
  }
}
BENCHMARK(add)->Iterations(2000);

void read_file(benchmark::State& state) {
  const std::vector<std::uint8_t> bytes = database_of(1000).serialize();
  if (Database::deserialize(bytes).size() != 1000)
    throw std::logic_error("the database's file is not read");
  for (auto _ : state) benchmark::DoNotOptimize(Database::deserialize(bytes).words());
  state.SetBytesProcessed(static_cast<std::int64_t>(state.iterations() * bytes.size()));
}
BENCHMARK(read_file);

}  // namespace
