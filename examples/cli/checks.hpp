// What the command line takes for a value.
#pragma once

#include <string>

#include <CLI/CLI.hpp>

#include "dynslam/core/errors.hpp"

namespace dynslam::cli {

/// Lets no option of `app` and of its subcommands be empty, and numeric ones be nothing but decimal
/// numbers that their types can hold. CLI11 by itself turns -1 into the largest unsigned number and
/// nothing into 0, and lets NaN through every range. Called after all options have been added.
void refuse_odd_values(CLI::App& app);

/// What `parse` refuses by InvalidArgument is bad usage.
template <typename Parse>
CLI::Validator readable_by(const Parse& parse) {
  return {[parse](const std::string& text) -> std::string {
            try {
              parse(text);
              return {};
            } catch (const InvalidArgument& error) {
              const std::string what = error.what();  // "function: parameter: got .."
              const std::size_t got = what.find("got ");
              return got == std::string::npos ? what : what.substr(got);
            }
          },
          ""};
}

}  // namespace dynslam::cli
