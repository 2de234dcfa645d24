#!/usr/bin/env bash
# What the pages of the documentation show is there: links lead somewhere, and examples are quoted
# from programs that are compiled.
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.." || exit 1
failures=0

complain() {
  echo "FAILED: $1"
  failures=$((failures + 1))
}

# Links of a page to files, those in code left out.
links() { # page
  sed '/^```/,/^```/d; s/`[^`]*`//g' "$1" | grep -oE '\]\([^)#]+' | sed 's/^](//' |
    grep -vE '^(https?|mailto):'
}

# The first block of C++ after a line that matches, without white space.
quoted() { # page pattern
  awk -v pattern="$2" '
    !seen { seen = $0 ~ pattern; next }
    /^```cpp/ { inside = 1; next }
    /^```/ { if (inside) exit }
    inside' "$1" | tr -d '[:space:]'
}

quotes_from() { # page pattern program
  local text source
  text=$(quoted "$1" "$2")
  source=$(tr -d '[:space:]' <"$3")
  [[ -n $text && $source == *"$text"* ]] || complain "$1 shows what is not in $3"
}

for page in ./*.md docs/*.md docs/*/*.md benchmarks/*/BENCHMARK.md; do
  while read -r link; do
    [[ -e $(dirname "$page")/$link ]] || complain "$page: a link to $link, which is not there"
  done < <(links "$page")
done

for page in docs/components/*.md; do
  programs=$(grep -oE 'from \[`examples/[^`]+' -i "$page" | sed 's/.*`//')
  [[ -n $programs ]] || complain "$page quotes no example"
  for program in $programs; do quotes_from "$page" "rom ..$program" "$program"; done
done
quotes_from README.md '^## Ten lines' tests/package/find_package_core_evaluation/main.cpp

((failures == 0)) && echo "all good"
exit $((failures > 0))
