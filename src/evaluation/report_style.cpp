#include "evaluation/report_parts.hpp"

namespace dynslam::evaluation {

std::string style_sheet() {
  return R"css(
:root { --ink: #1d242b; --soft: #5b6670; --line: #e1e5e9; --page: #f4f6f8; --card: #fff;
  --blue: #0072b2; --warn: #fff4dd; --warn-line: #e6b450; }
* { box-sizing: border-box; }
body { margin: 0; background: var(--page); color: var(--ink);
  font: 15px/1.5 system-ui, -apple-system, "Segoe UI", "Helvetica Neue", Arial, sans-serif; }
main { max-width: 1200px; margin: 0 auto; padding: 28px 24px 48px; }
header { margin-bottom: 20px; }
h1 { font-size: 26px; line-height: 1.25; margin: 0; font-weight: 650; overflow-wrap: anywhere; }
header p { margin: 4px 0 0; color: var(--soft); overflow-wrap: anywhere; }
h2 { font-size: 17px; margin: 34px 0 12px; font-weight: 650; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(170px, 1fr)); gap: 12px; }
.tile, .card, figure { background: var(--card); border: 1px solid var(--line);
  border-radius: 8px; }
.tile { padding: 12px 16px; }
.tile b { display: block; font-size: 25px; font-weight: 650; line-height: 1.3;
  font-variant-numeric: tabular-nums; }
.tile b small { font-size: 15px; font-weight: 500; color: var(--soft); }
.tile span { color: var(--soft); font-size: 13px; }
.tile em { display: block; font-style: normal; font-size: 13px; color: var(--soft); }
.notice { background: var(--warn); border: 1px solid var(--warn-line); border-radius: 8px;
  padding: 10px 16px; margin: 14px 0 0; overflow-wrap: anywhere; }
.card { padding: 6px 16px; overflow-x: auto; }
.pair { display: grid; grid-template-columns: 1fr 1fr; gap: 12px; align-items: start; }
.pair > * { min-width: 0; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { padding: 7px 10px; text-align: right; border-bottom: 1px solid var(--line);
  white-space: nowrap; }
tr:last-child > * { border-bottom: 0; }
th { font-weight: 550; color: var(--soft); font-size: 13px; }
tbody th { color: var(--ink); font-size: inherit; }
th:first-child, td:first-child { text-align: left; }
th:first-child { white-space: normal; overflow-wrap: break-word; min-width: 130px; }
.times th:last-child { text-align: left; }
td.best { font-weight: 700; }
td small, th small { color: var(--soft); font-weight: 400; font-size: 13px; }
tr.subject > * { background: #eef6fb; }
td.bar { width: 26%; text-align: left; }
.bar i { display: inline-block; height: 10px; border-radius: 3px; background: var(--blue);
  vertical-align: middle; margin-right: 8px; }
dl { display: grid; grid-template-columns: repeat(auto-fit, minmax(270px, 1fr)); gap: 0 28px;
  margin: 0; padding: 6px 0; }
dl div { display: flex; justify-content: space-between; gap: 16px; padding: 6px 0;
  border-bottom: 1px solid var(--line); }
dt { color: var(--soft); white-space: nowrap; } dd { margin: 0; text-align: right;
  overflow-wrap: anywhere; font-variant-numeric: tabular-nums; }
.figures { display: grid; grid-template-columns: 1fr 1fr; gap: 12px; }
figure { margin: 0; padding: 12px 14px 10px; grid-column: 1 / -1; min-width: 0; }
figure.half { grid-column: auto; }
figure h3 { margin: 0 0 4px; font-size: 14.5px; font-weight: 600; overflow-wrap: anywhere; }
figcaption { color: var(--soft); font-size: 13px; margin-top: 4px; }
svg { display: block; width: 100%; height: auto; }
svg text { font-family: system-ui, -apple-system, "Segoe UI", "Helvetica Neue", Arial, sans-serif; }
.strip svg { height: 22px; border-radius: 4px; }
.strip { padding: 12px 16px; }
.strip p { display: flex; flex-wrap: wrap; gap: 4px 18px; margin: 8px 0 0; font-size: 13px;
  color: var(--soft); }
.strip p span::before { content: ""; display: inline-block; width: 11px; height: 11px;
  border-radius: 3px; background: var(--c); margin-right: 6px; vertical-align: -1px; }
.strip p span:last-child { margin-left: auto; }
.strip p span:last-child::before { display: none; }
footer { margin-top: 32px; color: var(--soft); font-size: 13px; }
@media (max-width: 800px) { .figures, .pair { grid-template-columns: 1fr; } }
@media print { @page { margin: 12mm; }
  body { background: #fff; font-size: 11px; print-color-adjust: exact;
    -webkit-print-color-adjust: exact; }
  main { max-width: none; padding: 0; } h1 { font-size: 20px; } .tile b { font-size: 17px; }
  h2 { font-size: 14px; margin-top: 18px; break-after: avoid; }
  th, td { padding: 4px 5px; white-space: normal; }
  th, th small, td small, figcaption, .tile span, .tile em, .tile b small, .strip p, footer {
    font-size: 9.5px; }
  tbody th { font-size: inherit; } th:first-child { min-width: 90px; }
  .tiles { grid-template-columns: repeat(auto-fit, minmax(100px, 1fr)); }
  figure h3 { font-size: 11.5px; } .card { overflow: visible; }
  figure, .tile, .card, tr { break-inside: avoid; }
  .figures, .pair { grid-template-columns: 1fr 1fr; } }
)css";
}

}  // namespace dynslam::evaluation
