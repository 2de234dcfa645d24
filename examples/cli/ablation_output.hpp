// An ablation for reading: table, JSON, CSV, and a page with bars.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "ablation.hpp"

namespace dynslam::cli {

/// `ablation.json`: the cells with their runs and medians.
nlohmann::ordered_json ablation_json(const AblationPlan& plan, const std::vector<Cell>& cells);

/// A table a sequence, a row a cell.
std::string ablation_table(const std::vector<Cell>& cells);

/// Writes ablation.json, ablation.csv and ablation.html. Throws IoError.
void write_ablation(const std::filesystem::path& folder, const AblationPlan& plan,
                    const std::vector<Cell>& cells);

}  // namespace dynslam::cli
