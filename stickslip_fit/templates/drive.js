// The page of a drive: shows its state, and says at each change, and every heartbeat, all that is held.
// Messages are numbered; one that is overtaken by a later one is ignored by the program.

import { $, erase, follow, path, round, shape, write } from "./live.js";

const AXES = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowDown: [1, -1], ArrowUp: [1, 1], PageDown: [2, -1], PageUp: [2, 1] };
const HEARTBEAT = Number(document.body.dataset.heartbeat);
const STALE = Number(document.body.dataset.stale);
const TRAIL_SECONDS = 20, TRAIL_INTERVAL = 0.1;

const held = new Map(); // from key or pointer to axis and sign
let home = null, press = 0, number = 0, client = "", controls = false, waiting = 0, complaint = "";

const active = () => held.size > 0 || home !== null;

function direction() {
  const sum = [0, 0, 0];
  for (const [axis, sign] of held.values()) sum[axis] += sign;
  return sum.map(Math.sign);
}

async function send(more = {}, keepalive = false) {
  const message = { client, number: ++number, sent: performance.now() / 1000, press, direction: direction(), speed: Number($("speed").value) / 1e6, home, ...more };
  waiting += 1;
  try {
    const answer = await fetch("messages", { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(message), keepalive });
    if (!answer.ok) forget(await answer.text());
  } catch {
    forget("The program cannot be reached.");
  } finally {
    waiting -= 1;
  }
}

/** Nothing is held any more, and the program need not be told. */
function forget(why) {
  held.clear();
  home = null;
  complaint = why;
  mark();
}

function mark() {
  const values = [...held.values()].map(([axis, sign]) => `${axis},${sign}`);
  document.querySelectorAll("[data-axis]").forEach((each) => each.classList.toggle("held", values.includes(`${each.dataset.axis},${each.dataset.sign}`)));
  document.querySelectorAll("[data-home]").forEach((each) => each.classList.toggle("held", Number(each.dataset.home) === home));
}

function releaseAll(why = "") {
  if (!active()) return;
  forget(why);
  send({}, true);
}

function hold(from, axis, sign) {
  if (!controls || connection.stale || held.has(from)) return;
  if (home !== null) return releaseAll("Stopped: a key was pressed while a joint went home.");
  if (!active()) { press += 1; complaint = ""; }
  held.set(from, [axis, sign]);
  mark();
  send();
}

function release(from) {
  if (held.delete(from)) { mark(); send(); }
}

function stop() {
  forget("");
  send({ stop: true });
}

function takeHome(joint) {
  if (!controls || connection.stale || active()) return releaseAll();
  press += 1;
  complaint = "";
  home = joint;
  mark();
  send();
}

setInterval(() => {
  if (!active()) return;
  if (!document.hasFocus() || document.hidden) releaseAll("Stopped: the page has lost the focus.");
  else if (connection.stale) releaseAll("Stopped: nothing comes from the program.");
  else if (waiting < 2) send();
}, HEARTBEAT);

addEventListener("blur", () => releaseAll("Stopped: the page has lost the focus."));
addEventListener("pagehide", () => releaseAll());
document.addEventListener("visibilitychange", () => { if (document.hidden) releaseAll("Stopped: the page was hidden."); });
document.addEventListener("freeze", () => releaseAll());
document.documentElement.addEventListener("pointerleave", () => { for (const from of [...held.keys()]) if (from.startsWith("pointer")) release(from); });

// A menu, and whatever is dragged, would take the release of a key.
addEventListener("contextmenu", (event) => { if (!event.defaultPrevented) releaseAll("Stopped: a menu was opened."); });
addEventListener("dragstart", (event) => event.preventDefault());

addEventListener("keydown", (event) => {
  const button = event.target.closest?.("button"), slider = event.target.id === "speed";
  const known = AXES[event.key], from = `key ${event.code}`;
  if (event.key === "Enter" && button?.id === "stop") return; // a click
  if (event.ctrlKey || event.metaKey || event.altKey) return releaseAll("Stopped: another key was pressed.");
  if (known && (!slider || held.has(from))) {
    event.preventDefault(); // would scroll, or change the speed by a key that was held before the slider had the focus
    if (!event.repeat) hold(from, ...known);
  } else if (event.key === "Escape" || event.key === " ") {
    event.preventDefault(); // Space would press the button that has the focus, and it has to stop wherever that is
    if (!event.repeat) stop();
  } else if (event.key === "Enter" && button?.dataset.axis) {
    event.preventDefault(); // would click
    if (!event.repeat) hold("button", Number(button.dataset.axis), Number(button.dataset.sign));
  } else {
    if (event.key === "Enter" && (active() || event.repeat)) event.preventDefault(); // a click would send a joint home anew
    if (!event.repeat && !(known && slider && home === null)) releaseAll("Stopped: another key was pressed.");
  }
});
addEventListener("keyup", (event) => {
  release(`key ${event.code}`);
  if (event.key === "Enter") release("button");
  if (event.key === " ") event.preventDefault(); // some browsers press the button now
});

for (const button of document.querySelectorAll("[data-axis]")) {
  const from = (event) => `pointer ${event.pointerId}`;
  button.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    button.releasePointerCapture(event.pointerId); // a finger would keep it beyond the button's edge
    hold(from(event), Number(button.dataset.axis), Number(button.dataset.sign));
  });
  for (const kind of ["pointerup", "pointerleave", "pointercancel"]) button.addEventListener(kind, (event) => release(from(event)));
  button.addEventListener("blur", () => release("button"));
  button.addEventListener("contextmenu", (event) => event.preventDefault());
}
for (const button of document.querySelectorAll("[data-home]")) button.addEventListener("click", () => takeHome(Number(button.dataset.home)));
$("stop").addEventListener("pointerdown", stop); // at once, not when the button is released
$("stop").addEventListener("click", stop);
$("end").addEventListener("click", () => { forget(""); send({ ends: true }); });

function showSpeed() {
  write("pace", `${$("speed").value} µm/s`);
  if (active()) send();
}
$("speed").addEventListener("input", showSpeed);
$("speed").addEventListener("pointerup", () => $("speed").blur()); // so that arrows move the tip again
showSpeed();

function tell(words, kind) {
  document.body.classList.toggle("old", kind !== "good");
  write("control", words);
  if (kind === "lost" || kind === "over") { controls = false; forget(""); allow(false); }
}

function allow(yes) {
  document.querySelectorAll("[data-axis], [data-home], #end").forEach((each) => { each.disabled = !yes; });
}

function show(content) {
  if (content.client !== client) { client = content.client; forget(""); }
  controls = content.controls && Boolean(content.drive);
  allow(controls);
  if (!content.drive) return tell("The drive has not begun yet.", "old");
  if (content.broken >= press && active()) forget("");
  if (connection.stale) return;
  tell(controls ? "This page is in control." : "Another page is in control; this one shows the same, and can stop it.", "good");
  showNumbers(content);
  followTip(content.drive);
  content.drive.views.forEach((view, n) => {
    const name = ["above", "plane"][n];
    drawArm($(name), view);
    drawTip($(`${name}-tip`), view, content.drive);
  });
}

function showNumbers(content) {
  const drive = content.drive;
  write("status", drive.status);
  write("message", complaint || drive.message || (content.reason && content.broken >= press ? `${content.reason[0].toUpperCase()}${content.reason.slice(1)}.` : ""));
  write("advice", drive.advice);
  if ($("limits").textContent !== drive.limits.join("")) {
    $("limits").replaceChildren(...drive.limits.map((text) => Object.assign(document.createElement("li"), { textContent: text })));
  }
  drive.joints.forEach((joint, n) => { write(`position${n + 1}`, joint.position); write(`steps${n + 1}`, joint.steps); });
  write("place", drive.tip.join(", "));
  write("wanted", drive.wanted);
  write("velocity", drive.velocity);
  write("radius", drive.radius.text);
  write("tolerance", drive.tolerance.text);
  const share = Math.min(100, 100 * drive.radius.um / drive.tolerance.um) || 0;
  $("bar").setAttribute("aria-valuenow", share.toFixed(0));
  const exceeded = drive.radius.um > drive.tolerance.um;
  write("exceeded", exceeded ? ": exceeded" : "");
  $("bar").classList.toggle("exceeded", exceeded);
  $("bar").querySelector("rect").setAttribute("width", share.toFixed(1));
}

let trail = [];

function followTip(drive) {
  const now = performance.now() / 1000;
  trail = trail.filter((each) => now - each.time < TRAIL_SECONDS);
  if (drive.tip_mm.includes(null)) return;
  if (!trail.length || now - trail.at(-1).time > TRAIL_INTERVAL) trail.push({ time: now, tip: drive.tip_mm });
}

const SIZE = 62; // half of a view's side, in its own units

function frame(svg, axes, [x, y]) {
  svg.setAttribute("viewBox", `${-SIZE} ${-SIZE} ${2 * SIZE} ${2 * SIZE}`);
  shape(svg, "path", "axes", { class: "grid", d: `M${-SIZE},${y}H${SIZE}M${x},${SIZE}V${-SIZE}` });
  shape(svg, "text", "right", { x: SIZE - 3, y: y - 2, class: "end" }, axes[0]);
  shape(svg, "text", "up", { x: x + 2, y: 7 - SIZE }, axes[1]);
}

function drawBar(svg, length, label) {
  const [x, y] = [4 - SIZE, SIZE - 5];
  shape(svg, "path", "bar", { class: "axis", d: `M${x},${y - 2}v4m0,-2h${length}m0,-2v4` });
  shape(svg, "text", "bar-length", { x: x + length + 2, y: y + 1.5 }, label);
}

/** The arm; y points up, and SVG's down. */
function drawArm(svg, view) {
  const [[left, right], [low, high]] = view.extent;
  const scale = 0.9 * 2 * SIZE / Math.max(right - left, high - low);
  const at = ([x, y]) => [scale * (x - (left + right) / 2), scale * ((low + high) / 2 - y)];
  const [base, elbow, tip, near, far] = ["base", "elbow", "tip", "near", "far"].map((name) => at(view[name]));
  frame(svg, view.axes, base);
  drawBar(svg, 20 * scale, "20 mm");
  const length = Math.hypot(far[0] - near[0], far[1] - near[1]) || 1;
  const [tx, ty] = [4 * (near[1] - far[1]) / length, 4 * (far[0] - near[0]) / length];
  const ticks = [near, far].map(([x, y]) => `M${x - tx},${y - ty}L${x + tx},${y + ty}`).join("");
  shape(svg, "path", "travel", { class: "range", d: `${path([near, far])}${ticks}` });
  shape(svg, "path", "arm", { class: "arm", d: path([base, elbow, tip]) });
  shape(svg, "rect", "base", { class: "base", x: base[0] - 2.5, y: base[1] - 2.5, width: 5, height: 5 });
  shape(svg, "circle", "elbow", { class: "elbow", cx: elbow[0], cy: elbow[1], r: 2 });
  shape(svg, "circle", "tip", { class: "tip", cx: tip[0], cy: tip[1], r: 2.4 });
}

/** The tip's errors, and its way, about its place. */
function drawTip(svg, view, drive) {
  const ellipse = view.ellipse, tolerance = drive.tolerance.um || 0;
  const half = round(1.15 * Math.max(tolerance, ellipse?.longer || 0) || 1, true), scale = SIZE / half;
  frame(svg, view.axes, [0, 0]);
  shape(svg, "circle", "tolerance", { class: "tolerance", r: tolerance * scale });
  const project = (tip) => view.projection.map((row) => row.reduce((sum, factor, k) => sum + factor * (tip[k] - drive.tip_mm[k]), 0) * 1000 * scale);
  const way = [...trail.map((each) => project(each.tip)), [0, 0]].map(([x, y]) => [x, -y]);
  shape(svg, "path", "trail", { class: "trail", d: path(way) });
  if (ellipse) {
    shape(svg, "ellipse", "ellipse", { class: "ellipse", rx: ellipse.longer * scale, ry: ellipse.shorter * scale, transform: `rotate(${-ellipse.angle})` });
  } else erase(svg, "ellipse");
  shape(svg, "path", "tip", { class: "cross", d: "M-2.5,0h5M0,-2.5v5" });
  const bar = round(0.5 * half, false);
  drawBar(svg, bar * scale, `${bar} µm`);
}

const connection = follow(STALE, show, tell);
