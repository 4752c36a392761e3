// The page of a capture: shows how far it is, and sends nothing.

import { $, erase, follow, path, shape, write } from "./live.js";

const LATEST = 8;

function tell(words, kind) {
  document.body.classList.toggle("old", kind !== "good");
  write("control", words);
}

function show(content) {
  tell("", "good");
  write("session", content.session ? `Session ${content.session}` : "");
  write("question", content.question ? `At the terminal: ${content.question}` : "");
  fill("messages", content.messages.map((text) => element("li", text)));
  const drive = content.drive;
  if (drive) {
    write("title", drive.title);
    write("count", drive.count);
    write("about", drive.about);
    drawBar($("bar"), drive);
  }
  drawLevels($("levels"), content.levels);
  drawResiduals($("errors"), content.residuals);
  fill("latest", content.residuals.slice(-LATEST).reverse().map(row));
}

const element = (tag, text) => Object.assign(document.createElement(tag), { textContent: text });

/** New children, where their text is new. */
function fill(id, children) {
  const text = children.map((each) => each.textContent).join("\n");
  if ($(id).dataset.text !== text) $(id).replaceChildren(...children);
  $(id).dataset.text = text;
}

const signed = (value, digits) => `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(digits)}`;

function row(point) {
  const tr = document.createElement("tr");
  const head = element("th", `${point.joint}${point.direction === "-" ? "−" : "+"}`);
  head.scope = "row";
  const half = point.high === null ? "" : ` ± ${(50 * (point.high - point.low)).toFixed(2)}`;
  const residual = point.residual === null ? "–" : `${signed(100 * point.residual, 2)}${half} %`;
  const remark = [point.doubtful && "doubtful", !point.kept && "left out"].filter(Boolean).join(", ");
  tr.append(head, element("td", point.text), element("td", remark ? `${residual} (${remark})` : residual));
  return tr;
}

/** Sizes of a chart in pixels of the screen, so that letters are as large as elsewhere. */
function frame(svg) {
  const box = svg.getBoundingClientRect(), width = box.width - 2, height = box.height - 2; // inside the border
  const size = `${width} ${height}`;
  if (svg.dataset.size !== size) { erase(svg, ""); svg.dataset.size = size; svg.setAttribute("viewBox", `0 0 ${width} ${height}`); }
  return [width, height];
}

function drawBar(svg, drive) {
  const [width, height] = frame(svg);
  const end = 1.15 * Math.max(drive.high ?? drive.expected ?? 0, drive.steps, 1), at = (steps) => (width - 2) * steps / end + 1;
  if (drive.low !== null && drive.high !== null) {
    shape(svg, "rect", "interval", { class: "interval", x: at(drive.low), y: 0, width: Math.max(at(drive.high) - at(drive.low), 2), height });
  } else erase(svg, "interval");
  shape(svg, "rect", "count", { class: "fill", x: 0, y: height / 4, width: at(drive.steps), height: height / 2 });
  if (drive.expected !== null) shape(svg, "path", "expected", { class: "expected", d: `M${at(drive.expected)},0V${height}` });
  else erase(svg, "expected");
}

/** Axes of a chart; the functions from its values to its pixels. */
function axes(svg, [low, high], [first, last], ticks, label) {
  const [width, height] = frame(svg), left = 44, bottom = 22, top = 8;
  const x = (value) => left + (width - left - 10) * (value - first) / (last - first || 1);
  const y = (value) => height - bottom - (height - bottom - top) * (value - low) / (high - low);
  const rows = [];
  for (let value = Math.ceil(low / ticks) * ticks; value <= high; value += ticks) rows.push(value);
  shape(svg, "path", "grid", { class: "grid", d: rows.map((value) => `M${left},${y(value)}H${width - 10}`).join("") });
  shape(svg, "path", "zero", { class: "zero", d: `M${left},${y(0)}H${width - 10}` });
  erase(svg, "tick");
  const digits = ticks < 0.1 ? 2 : ticks < 1 ? 1 : 0;
  rows.forEach((value, n) => shape(svg, "text", `tick${n}`, { class: "end", x: left - 6, y: y(value) + 4 }, value ? signed(value, digits) : "0"));
  shape(svg, "text", "label", { class: "end", x: width - 10, y: height - 5 }, label);
  return { x, y, left, bottom: height - bottom };
}

/** A step of the axis that makes some four of a range. */
function step(range) {
  const decade = 10 ** Math.floor(Math.log10(range / 4));
  return [1, 2, 5, 10].map((digit) => digit * decade).find((each) => range / each <= 5);
}

function drawLevels(svg, levels) {
  const heard = levels.filter(([, level]) => level !== null);
  const low = Math.min(-10, ...heard.map(([, level]) => level)), high = Math.max(25, ...heard.map(([, level]) => level));
  const last = levels.at(-1)?.[0] ?? 30, first = levels[0]?.[0] ?? 0;
  const { x, y, bottom, left } = axes(svg, [low, high], [first, last], step(high - low), "s");
  shape(svg, "text", "first", { x: left, y: bottom + 16 }, first.toFixed(0));
  shape(svg, "text", "last", { class: "middle", x: x(last) - 30, y: bottom + 16 }, last.toFixed(0));
  shape(svg, "path", "level", { class: "level", d: path(heard.map(([time, level]) => [x(time), y(level)])) });
  const begins = levels.filter(([, , stop], n) => n && levels[n - 1][2] && !stop).map(([time]) => time);
  shape(svg, "path", "begins", { class: "begins", d: begins.map((time) => `M${x(time)},${bottom}V8`).join("") });
  const stops = heard.filter(([, , stop]) => stop).map(([time, level]) => `M${x(time)},${y(level)}h0`);
  shape(svg, "path", "stops", { class: "stops", d: stops.join("") });
}

function drawResiduals(svg, points) {
  const shown = points.map((point, n) => ({ ...point, n: n + 1 })).filter((point) => point.residual !== null);
  const ends = shown.flatMap((point) => [point.residual, point.low, point.high]).filter((value) => value !== null).map((value) => 100 * Math.abs(value));
  const most = 1.15 * Math.max(1, ...ends);
  const { x, y, bottom } = axes(svg, [-most, most], [0, Math.max(points.length + 1, 10)], step(2 * most), "reading");
  const last = points.length;
  if (last) shape(svg, "text", "last", { class: "middle", x: x(last), y: bottom + 16 }, `${last}`);
  for (const sign of ["+", "-"]) {
    const name = sign === "+" ? "plus" : "minus", of = shown.filter((point) => point.direction === sign);
    const bars = of.filter((point) => point.high !== null).map((point) => `M${x(point.n)},${y(100 * point.low)}V${y(100 * point.high)}`);
    shape(svg, "path", `bars ${name}`, { class: `error ${name}`, d: bars.join("") });
    const dots = (some) => some.map((point) => `M${x(point.n)},${y(100 * point.residual)}h0`).join("");
    shape(svg, "path", `dots ${name}`, { class: `dots ${name}`, d: dots(of) });
    const doubted = of.filter((point) => point.doubtful || !point.kept);
    shape(svg, "path", `doubted ${name}`, { class: "doubted", d: doubted.map((point) => `M${x(point.n)},${y(100 * point.residual)}m-7,0a7,7 0 1 0 14,0a7,7 0 1 0 -14,0`).join("") });
  }
}

follow(Number(document.body.dataset.stale), show, tell);
