#include "checks.hpp"

#include <charconv>
#include <cmath>
#include <cstdint>
#include <string>
#include <system_error>

namespace dynslam::cli {
namespace {

template <typename Number>
bool holds(const std::string& text) {
  Number number{};
  const char* const end = text.data() + text.size();
  const char* const begin = text.data() + (text.rfind('+', 0) == 0 ? 1 : 0);
  const auto [rest, error] = std::from_chars(begin, end, number);
  return error == std::errc() && rest == end && std::isfinite(static_cast<double>(number));
}

template <typename Number>
void take_only(const std::string& expected, CLI::Option& option) {
  option.check([expected](const std::string& text) {
    return holds<Number>(text) ? std::string() : "got '" + text + "', expected " + expected;
  });
}

}  // namespace

void refuse_odd_values(CLI::App& app) {
  for (CLI::Option* const option : app.get_options()) {
    option->check([](const std::string& text) {
      return text.empty() ? std::string("got nothing, expected a value") : std::string();
    });
    // "UINT", or with a range "UINT:INT in [1 - 9]".
    const std::string type = option->get_type_name();
    const auto is = [&](const char* name) { return type.rfind(name, 0) == 0; };
    if (is("UINT")) take_only<std::uint64_t>("a whole number that is not negative", *option);
    if (is("INT")) take_only<std::int64_t>("a whole number", *option);
    if (is("FLOAT")) take_only<double>("a finite number", *option);
  }
  for (CLI::App* const subcommand : app.get_subcommands({})) refuse_odd_values(*subcommand);
}

}  // namespace dynslam::cli
