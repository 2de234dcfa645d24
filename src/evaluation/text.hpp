// Text of unknown origin made fit for a page or a script.
#pragma once

#include <string>
#include <string_view>

namespace dynslam::evaluation {

/// Valid UTF-8 without control characters: what is neither becomes '?', line ends a blank.
std::string clean_text(std::string_view text);

/// `clean_text` with & < > " ' as HTML entities.
std::string escape_html(std::string_view text);

/// A number with `decimals` digits after the point, "–" when it is not finite.
std::string number(double value, int decimals);

/// Decimals that show `digits` significant digits of `value`, 0..6.
int decimals_for(double value, int digits);

/// A number with about `digits` significant digits and no exponent, "–" when it is not finite.
std::string short_number(double value, int digits = 4);

/// The same without zeros at the end: "1", "0.5".
std::string trimmed_number(double value, int digits = 4);

}  // namespace dynslam::evaluation
