// What the pages of a drive and of a capture share: the stream of the program's content, and drawing.

export const $ = (id) => document.getElementById(id);

/** Text of an element; nothing is touched, and nothing announced, where it is the same. */
export function write(id, text) {
  const element = $(id);
  if (element.textContent !== text) element.textContent = text;
}

/** A shape in an SVG by a name of its own, made where there is none, with attributes set. */
export function shape(svg, tag, name, attributes, text = "") {
  let element = svg.querySelector(`[data-name="${name}"]`);
  if (!element) {
    element = document.createElementNS("http://www.w3.org/2000/svg", tag);
    element.dataset.name = name;
    svg.append(element);
  }
  for (const [key, value] of Object.entries(attributes)) {
    if (element.getAttribute(key) !== `${value}`) element.setAttribute(key, value);
  }
  if (element.textContent !== text) element.textContent = text;
  return element;
}

/** Take away shapes whose names begin so. */
export function erase(svg, name) {
  svg.querySelectorAll(`[data-name^="${name}"]`).forEach((each) => each.remove());
}

export const path = (points) => points.map(([x, y], n) => `${n ? "L" : "M"}${x.toFixed(2)},${y.toFixed(2)}`).join("");

/** The next number of 1, 2, 5, 10, ... at or above (`up`) or at or below another. */
export function round(value, up) {
  const decade = 10 ** Math.floor(Math.log10(value));
  const series = [1, 2, 5, 10].map((digit) => digit * decade);
  const found = up ? series.find((each) => each >= value * (1 - 1e-9)) : series.findLast((each) => each <= value * (1 + 1e-9));
  return found ?? decade;
}

/**
 * Follow the program: `show` gets each content. `tell(words, kind)` says how the connection is: "good", "old"
 * where nothing has come for so many ms, "lost", "over".
 */
export function follow(staleAfter, show, tell) {
  const source = new EventSource("events");
  const connection = { last: 0, over: false, get stale() { return performance.now() - this.last > staleAfter; } };
  source.onmessage = (event) => {
    const content = JSON.parse(event.data);
    if (!(content.age * 1000 > staleAfter)) connection.last = performance.now();
    show(content);
    if (!content.ended) return;
    connection.over = true;
    source.close();
    tell("It has ended. What is shown is the last state.", "over");
  };
  source.onerror = () => {
    if (connection.over) return;
    connection.last = -Infinity;
    const advice = source.readyState === EventSource.CLOSED ? " Load the page again." : ""; // else the browser tries again
    tell(`The connection to the program is lost.${advice}`, "lost");
  };
  setInterval(() => {
    if (connection.over || connection.last === -Infinity) return;
    const seconds = (performance.now() - connection.last) / 1000;
    if (connection.stale) tell(`Nothing has come from the program for ${seconds.toFixed(0)} s: what is shown is old.`, "old");
  }, 250);
  return connection;
}
