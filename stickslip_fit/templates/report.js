// Makes the traverses of a report answer: point at one to read it, click it to follow its session. Saves tables as CSV
// and figures as SVG; opens all that is folded. The page says the same without this; all text from the log is set as text.
"use strict";
(() => {
  const MARGIN = { left: 64, right: 14, top: 10, bottom: 40 }, EDGE = 12; // pixels
  const NEAR = 22; // pixels within which a point counts as pointed at
  const FEW = 40; // places of x that leave room to draw sessions side by side
  const ASIDE = { sign: 5, session: 3 }; // pixels
  const QUANTILE = 0.98, ZOOM = 1.6, SURE = 1.96;
  const MINUS = "\u2212", SPACE = "\u00a0";

  const find = (id) => document.getElementById(id);
  const data = JSON.parse(find("traverses").textContent);
  const box = find("explore"), said = find("said"), tip = find("tip");
  const state = { joint: data.joints[0], sign: "", quantity: 0, session: -1, at: -1 };
  const places = new Map(); // from a traverse's number in the log to its joint and place there
  for (const joint of data.joints) joint.row.forEach((row, k) => places.set(row, { joint, k }));

  // ---- what is told of a traverse
  const counted = (value) => value.toLocaleString("en");
  const decimals = (value, digits) => value.toFixed(digits).replace("-", MINUS);
  const departure = (joint, k) => joint.law[k] === null ? null : 100 * (joint.seen[k] / joint.law[k] - 1);
  const moment = (joint, k) => joint.time[k] === null ? "" : ", " +
    new Date(1000 * (data.begun + joint.time[k])).toISOString().slice(0, 19).replace("T", " ");

  function told(joint, k) {
    const digits = Math.round(Math.log10(joint.per)) - 1;
    const size = (value) => `${decimals(value / joint.per, digits)}${SPACE}${joint.unit}`;
    const off = departure(joint, k), note = joint.notes[joint.row[k]];
    const law = off === null ? "the law is not known" : `law ${size(joint.law[k])}`;
    const less = off === null ? "" : `, residual ${off > 0 ? "+" : ""}${decimals(off, 2)}${SPACE}%`;
    return [
      `Session ${data.sessions[joint.session[k]]}${moment(joint, k)}`,
      `${joint.name}, direction ${joint.sign[k]}; ${joint.configurations[joint.configuration[k]]}`,
      `${counted(joint.steps[k])} steps, step size ${size(joint.seen[k])}; ${law}${less}`,
      ...(note ? [`Note: ${note}`] : []),
    ];
  }

  function show(joint, k, x, y) {
    const lines = told(joint, k);
    said.textContent = `${lines.join(". ")}.`;
    const paragraph = (textContent) => Object.assign(document.createElement("p"), { textContent });
    tip.replaceChildren(...lines.map(paragraph));
    tip.hidden = false;
    const wide = document.documentElement.clientWidth - tip.offsetWidth - 8;
    tip.style.left = `${Math.max(8, Math.min(x + 14, wide)) + window.scrollX}px`;
    tip.style.top = `${(y > tip.offsetHeight + 20 ? y - tip.offsetHeight - 14 : y + 18) + window.scrollY}px`;
    if (joint === state.joint) state.at = k;
    for (const chart of charts) chart.mark();
  }

  const hide = () => { tip.hidden = true; };

  // ---- charts drawn here

  const make = (name, attributes, text) => {
    const element = document.createElementNS(box.querySelector("svg").namespaceURI, name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    if (text !== undefined) element.textContent = text;
    return element;
  };

  const scale = ([low, high], [from, to]) => (value) =>
    from + (Math.min(Math.max(value, low), high) - low) / (high - low || 1) * (to - from);

  const aside = (joint, k) =>
    ASIDE.sign * (joint.sign[k] === MINUS ? 1 : -1) + ASIDE.session * (joint.session[k] % 3 - 1);

  function ticks([low, high], most, isAngle = false) {
    const rough = (high - low) / most || 1;
    const power = 10 ** Math.floor(Math.log10(rough));
    const angles = [10, 15, 30, 45, 60, 90, 180];
    const steps = isAngle && rough > 5 ? angles : [1, 2, 5, 10].map((each) => each * power);
    const step = steps.find((each) => each >= rough) || steps.at(-1);
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    const found = [];
    for (let n = Math.ceil(low / step - 1e-9); n * step <= high + 1e-9 * step; n++)
      found.push([n * step, decimals(n * step + 0, digits)]);
    return found;
  }

  class Chart {
    constructor(svg, what) {
      Object.assign(this, { svg, what });
      svg.addEventListener("pointermove", (event) => this.pointed(event));
      svg.addEventListener("pointerleave", hide);
      svg.addEventListener("click", (event) => this.pointed(event, true));
      svg.addEventListener("keydown", (event) => this.key(event));
      svg.addEventListener("focus", () => this.go(this.order.includes(state.at) ? state.at : this.order[0]));
      svg.addEventListener("blur", hide);
    }

    draw() {
      const { joint } = state;
      const [x, y] = [this.what.x(joint), this.what.y(joint)];
      const wanted = (k) => x[k] !== null && y[k] !== null && (!state.sign || joint.sign[k] === state.sign);
      this.order = joint.row.map((_, k) => k).filter(wanted).sort((a, b) => x[a] - x[b] || a - b);
      const title = `${this.what.yLabel(joint)} against ${this.what.xLabel()}`;
      this.svg.setAttribute("aria-label", `${title}. Arrow keys: next traverse. Enter: follow its session.`);
      this.wide = this.svg.clientWidth || 600;
      this.tall = this.svg.clientHeight || 240;
      this.svg.setAttribute("viewBox", `0 0 ${this.wide} ${this.tall}`);
      if (!this.order.length) {
        const none = make("text", { x: MARGIN.left, y: this.tall / 2 }, "Nothing is known of that.");
        return this.svg.replaceChildren(none);
      }
      const ends = [x[this.order[0]], x[this.order.at(-1)]];
      const reach = this.what.range(this.order.map((k) => y[k]));
      const across = scale(ends, [MARGIN.left + EDGE, this.wide - MARGIN.right - EDGE]);
      const up = scale(reach, [this.tall - MARGIN.bottom, MARGIN.top]);
      const isRoomy = new Set(this.order.map((k) => x[k])).size <= FEW;
      const left = (k) => across(x[k]) + (isRoomy ? aside(joint, k) : 0);
      this.spots = new Map(this.order.map((k) => [k, [left(k), up(y[k])]]));
      const ring = make("circle", { class: "ring", r: 6 });
      this.svg.replaceChildren(...this.axes(across, up, ends, reach), ...this.points(), ring);
      this.mark();
    }

    axes(across, up, ends, reach) {
      const floor = this.tall - MARGIN.bottom, right = this.wide - MARGIN.right, label = this.what.xLabel();
      const level = (at, kind) => make("path", { class: kind, d: `M${MARGIN.left} ${up(at)}H${right}` });
      const text = (x, y, kind, what) => make("text", { x, y, class: kind }, what);
      const inReach = ([value]) => value >= reach[0] && value <= reach[1];
      const name = make("text", { transform: `translate(14 ${floor / 2}) rotate(-90)`, class: "middle" });
      name.textContent = this.what.yLabel(state.joint);
      return [
        ...ticks(reach, this.tall / 40).flatMap(([value, what]) =>
          [level(value, "grid"), text(MARGIN.left - 6, up(value) + 4, "end", what)]),
        ...ticks(ends, this.wide / 90, label.includes("°)")).map(([value, what]) =>
          text(across(value), floor + 16, "middle", what)),
        ...this.what.lines(state.joint).filter(inReach).map(([value, kind]) => level(value, kind)),
        make("path", { class: "axis", d: `M${MARGIN.left} ${MARGIN.top}V${floor}H${right}` }),
        text((MARGIN.left + right) / 2, this.tall - 6, "middle", label),
        name,
      ];
    }

    points() {
      const { joint, session } = state;
      const others = make("g", session < 0 ? {} : { class: "dim" }), chosen = make("g", { class: "chosen" });
      const dot = (k) => `M${this.spots.get(k).map((value) => value.toFixed(1)).join(" ")}h0`;
      for (const [sign, kind] of [["+", "plus"], [MINUS, "minus"]])
        for (const group of [others, chosen]) {
          const mine = (k) => joint.sign[k] === sign && (joint.session[k] === session) === (group === chosen);
          group.append(make("path", { class: kind, d: this.order.filter(mine).map(dot).join("") }));
        }
      return [others, chosen];
    }

    mark() {
      const ring = this.svg.querySelector(".ring"), spot = this.spots?.get(state.at);
      ring?.classList.toggle("on", Boolean(spot));
      if (ring && spot) ["cx", "cy"].forEach((name, k) => ring.setAttribute(name, spot[k]));
    }

    pointed(event, clicked = false) {
      const edge = this.svg.getBoundingClientRect();
      const [x, y] = [Math.floor(event.clientX) - edge.left, Math.floor(event.clientY) - edge.top];
      const k = nearest(this.order.map((each) => [each, ...this.spots.get(each)]), x, y, NEAR);
      if (k === undefined) return hide();
      show(state.joint, k, event.clientX, event.clientY);
      if (clicked) follow(state.joint.session[k]);
    }

    go(k) {
      if (k === undefined) return;
      const edge = this.svg.getBoundingClientRect(), [x, y] = this.spots.get(k);
      show(state.joint, k, edge.left + x, edge.top + y);
    }

    key(event) {
      const now = this.order.indexOf(state.at), last = this.order.length - 1;
      const [next, before] = [Math.min(now + 1, last), Math.max(now - 1, 0)];
      const right = { ArrowRight: next, ArrowUp: next, End: last };
      const moves = { ...right, ArrowLeft: before, ArrowDown: before, Home: 0 };
      if (event.key in moves) this.go(this.order[moves[event.key]]);
      else if (["Enter", " "].includes(event.key) && now >= 0) follow(state.joint.session[state.at]);
      else if (event.key === "Escape") follow(-1);
      else return;
      event.preventDefault();
    }
  }

  function nearest(spots, x, y, within) {
    let best, least = within ** 2;
    for (const [what, left, top] of spots) {
      const square = (left - x) ** 2 + (top - y) ** 2;
      if (square <= least) [best, least] = [what, square];
    }
    return best;
  }

  // ---- a session followed through charts, figures and tables

  function follow(session) {
    state.session = session === state.session ? -1 : session;
    find("session").value = state.session;
    for (const chart of charts) chart.draw();
    const name = data.sessions[state.session];
    document.body.classList.toggle("following", state.session >= 0);
    for (const [point, where] of figures.flatMap((figure) => figure.points))
      point.classList.toggle("chosen", where?.joint.session[where.k] === state.session);
    for (const [row, session] of rows) row.classList.toggle("chosen", session === name);
  }

  const rows = [...document.querySelectorAll("table")].flatMap((table) => {
    const heads = [...table.querySelectorAll("thead tr:last-child > *")].map((head) => head.textContent);
    const place = heads.indexOf("session");
    return place < 0 ? [] : [...table.tBodies[0].rows].map((row) => [row, row.cells[place].textContent]);
  });

  const figures = [...document.querySelectorAll(".card svg")].map((svg) => ({ svg, points: pointsOf(svg) }));

  function pointsOf(svg) {
    return [...svg.querySelectorAll("[data-traverses]")].flatMap((group) => {
      const named = group.dataset.traverses.split("."), drawn = [...group.querySelectorAll("use")];
      return named.length === drawn.length ? drawn.map((each, k) => [each, places.get(+named[k])]) : [];
    });
  }

  for (const { svg, points } of figures) {
    const spots = points.filter(([, where]) => where)
      .map(([point, where]) => [where, Number(point.getAttribute("x")), Number(point.getAttribute("y"))]);
    const at = (event) => {
      // Whole pixels, as a click has them: it must not choose another point than the one that was told.
      const onScreen = new DOMPoint(Math.floor(event.clientX), Math.floor(event.clientY));
      const { x, y } = onScreen.matrixTransform(svg.getScreenCTM().inverse());
      return nearest(spots, x, y, 9);
    };
    svg.addEventListener("pointermove", (event) => {
      const where = at(event);
      where ? show(where.joint, where.k, event.clientX, event.clientY) : hide();
    });
    svg.addEventListener("pointerleave", hide);
    svg.addEventListener("click", (event) => {
      const where = at(event);
      if (where) follow(where.joint.session[where.k]);
    });
  }

  // ---- files: tables as CSV, figures as SVG

  const THOUSANDS = /^[-+]?\d{1,3}(,\d{3})+(\.\d+)?$/, NUMBER = /^[-+]?\d+(\.\d+)?$/, FORMULA = /^[=+\-@\t\r]/;

  // Numbers as programs read them; a text that a spreadsheet would take for a formula begins with an apostrophe.
  function cellText(cell) {
    const shown = cell.innerText.replaceAll(SPACE, " ").replace(/\s*\n\s*/g, " ").trim();
    const plain = shown.replaceAll(MINUS, "-");
    const text = THOUSANDS.test(plain) ? plain.replaceAll(",", "") : NUMBER.test(plain) ? plain : shown;
    const safe = FORMULA.test(text) && !NUMBER.test(text) ? `'${text}` : text;
    return /[",\n]/.test(safe) ? `"${safe.replaceAll('"', '""')}"` : safe;
  }

  function tableText(table) {
    const upper = table.tHead.rows.length > 1
      ? [...table.tHead.rows[0].cells].flatMap((cell) => Array(cell.colSpan).fill(cell.innerText.trim())) : [];
    const heads = [...table.tHead.rows[table.tHead.rows.length - 1].cells].map((cell, k) => {
      const both = [upper[k], cell.innerText.replace(/\s*\n\s*/g, " ").trim()].filter(Boolean).join(": ");
      return /[",]/.test(both) ? `"${both.replaceAll('"', '""')}"` : both;
    });
    const body = [...table.tBodies[0].rows].map((row) => [...row.cells].map(cellText));
    return [heads, ...body].map((cells) => `${cells.join(",")}\r\n`).join("");
  }

  function save(text, type, name) {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type }));
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }

  const fileName = (text, ending) => `${text.replace(/[^\p{L}\p{N}]+/gu, "-").replace(/^-+|-+$/g, "").slice(0, 80)}${ending}`;

  function addButton(place, kind, name, made) {
    const button = Object.assign(document.createElement("button"), { type: "button", className: "save", textContent: kind });
    button.setAttribute("aria-label", `Save as ${kind}: ${name}`);
    button.addEventListener("click", made);
    place.append(button);
  }

  for (const table of document.querySelectorAll("table")) {
    const name = table.caption.textContent, folded = table.caption.classList.contains("spoken");
    const place = folded ? table.closest(".scroll").querySelector(".note") ?? table.closest(".scroll") : table.caption;
    addButton(place, "CSV", name, () => save(`\ufeff${tableText(table)}`, "text/csv", fileName(name, ".csv")));
  }
  for (const figure of document.querySelectorAll("figure")) {
    const head = figure.querySelector("h3, h4"), name = head.textContent;
    addButton(head, "SVG", name, () => {
      const drawing = new XMLSerializer().serializeToString(figure.querySelector("svg"));
      save(drawing, "image/svg+xml", fileName(name, ".svg"));
    });
  }

  // ---- what is folded

  const folds = [...document.querySelectorAll("details")];
  const opener = Object.assign(document.createElement("button"), { type: "button", className: "save all" });
  const name = () => { opener.textContent = folds.some((each) => !each.open) ? "Open all tables (also for print)" : "Fold all tables"; };
  opener.addEventListener("click", () => {
    const open = folds.some((each) => !each.open);
    for (const each of folds) each.open = open;
    name();
  });
  const last = document.createElement("li");
  last.append(opener);
  if (folds.length) document.querySelector("nav ul").append(last);
  if (location.hash === "#all") opener.click();
  name();

  // ---- controls
  const within = (values) => {
    const sizes = values.map(Math.abs).sort((a, b) => a - b);
    const limit = 1.05 * Math.min(sizes.at(-1), ZOOM * sizes[Math.floor(QUANTILE * (sizes.length - 1))]) || 1;
    return [-limit, limit];
  };
  const quantity = () => state.joint.quantities[state.quantity];
  const label = () => quantity().label;
  const byQuantity = () => quantity().values.map((value) => value === null ? null : value / quantity().per);
  const offs = (joint) => joint.row.map((_, k) => departure(joint, k));
  const sizes = (joint) => joint.seen.map((value) => value / joint.per);
  const levels = (joint) => {
    const noise = joint.repeatability[state.sign === MINUS ? 1 : 0];
    const ends = noise === null ? [] : [-100 * SURE * noise, 100 * SURE * noise];
    return [[0, "zero"], ...ends.map((end) => [end, "noise"])];
  };
  const left = { y: offs, yLabel: () => "residual (%)", range: within, lines: levels };
  const whole = (values) => [Math.min(...values), Math.max(...values)];
  const size = { y: sizes, yLabel: (joint) => `step size (${joint.unit})`, range: whole, lines: () => [] };
  const numbers = (joint) => joint.row.map((row) => row + 1);
  const charts = [
    new Chart(find("departures"), { ...left, x: byQuantity, xLabel: label }),
    new Chart(find("sizes"), { ...size, x: byQuantity, xLabel: label }),
    new Chart(find("order"), { ...left, x: numbers, xLabel: () => "traverse, in the order of the log" }),
  ];

  const option = (value, textContent) =>
    Object.assign(document.createElement("option"), { value, textContent });

  function redraw() {
    const before = find("quantity").selectedOptions[0]?.textContent;
    const labels = state.joint.quantities.map((each) => each.label);
    state.quantity = Math.max(0, labels.indexOf(before));
    find("quantity").replaceChildren(...labels.map((label, k) => option(k, label)));
    find("quantity").value = state.quantity;
    state.at = -1;
    const { row, all, name } = state.joint;
    const lot = "those that the figures draw, the furthest from the law, and others by lot";
    find("shown").textContent = row.length === all ? `${name}: all ${counted(all)} usable traverses.`
      : `${name}: ${counted(row.length)} of ${counted(all)} usable traverses: ${lot}.`;
    for (const chart of charts) chart.draw();
  }

  for (const part of document.querySelectorAll("[data-script]")) part.hidden = false;
  find("session").replaceChildren(option(-1, "none"), ...data.sessions.map((name, k) => option(k, name)));
  box.addEventListener("change", ({ target }) => {
    if (target.name === "joint") state.joint = data.joints.find(({ joint }) => joint === +target.value);
    if (target.name === "sign") state.sign = target.value;
    if (target.id === "session") return follow(Number(target.value));
    if (target.id !== "quantity") return redraw();
    state.quantity = Number(target.value);
    for (const chart of charts) chart.draw();
  });
  document.addEventListener("keydown", (event) => { if (event.key === "Escape") hide(); });
  redraw();
  new ResizeObserver(() => {
    if (charts[0].wide !== charts[0].svg.clientWidth) charts.forEach((chart) => chart.draw());
  }).observe(box);
})();
