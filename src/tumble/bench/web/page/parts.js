// Parts of the page: each puts text and shapes for some data into an element. Data are never markup.

const SVG = "http://www.w3.org/2000/svg";

/** Create an HTML element with text. */
export function made(tag, text = "", className = "") {
  const element = document.createElement(tag);
  element.textContent = text;
  if (className) element.className = className;
  return element;
}

function shape(tag, attributes) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
}

/** Format a number to three digits, or a dash. */
export function number(value, digits = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  return Math.abs(value) >= 10 ** digits ? value.toFixed(0) : String(Number(value.toPrecision(digits)));
}

/** Format a time as minutes and seconds, with hours if necessary. */
export function clock(seconds) {
  const whole = Math.max(0, Math.round(seconds));
  const two = (value) => String(value).padStart(2, "0");
  const minutes = Math.floor(whole / 60);
  return whole < 3600 ? `${minutes}:${two(whole % 60)}` : `${Math.floor(minutes / 60)}:${two(minutes % 60)}:${two(whole % 60)}`;
}

/** Format an approximate time in minutes. */
export function about(seconds) {
  const minutes = Math.round(seconds / 60);
  return minutes < 1 ? "less than a minute" : minutes < 90 ? `about ${minutes} min` : `about ${(minutes / 60).toFixed(1)} h`;
}

/** Show terms and their values. */
export function details(list, pairs) {
  const wanted = pairs.filter(([, value]) => value !== "");
  list.replaceChildren(...wanted.flatMap(([term, value]) => [made("dt", term), made("dd", value)]));
}

const TOWARDS = { N: "north", S: "south", E: "east", W: "west", U: "up", D: "down" };

/** Show a position by its name and the directions of the body axes. */
export function points(box, position) {
  const words = position ? [position.label, ...Object.entries(position.points).map(([axis, to]) => `${axis} ${TOWARDS[to] || to}`)] : [];
  if (words.join() === [...box.children].map((each) => each.textContent).join()) return;
  box.replaceChildren(...words.map((text, i) => made("span", text, i ? "" : "name")));
}

/** Show a bar for every group: the middle is the wanted u, each half a factor of 100. */
export function groups(box, list) {
  box.replaceChildren(...list.map((group) => {
    const row = made("div", "", `group ${!group.determined ? "unknown" : group.enough ? "enough" : ""}`);
    const name = made("div", "", "name");
    const found = group.determined ? `${number(group.u)} ${group.unit}` : "not yet";
    const limit = `${number(group.wanted)} ${group.unit}`;
    const wanted = group.determined ? ` of ${limit}` : ` (${limit})`;
    name.append(made("span", group.group), made("span", found + wanted));
    row.append(name, bar(group, found));
    return row;
  }));
}

function bar(group, found) {
  const ratio = group.determined ? Math.log10(group.u / group.wanted) : -2;
  const width = Math.min(100, Math.max(2, 50 + 25 * ratio));
  const box = made("div", "", "bar");
  box.setAttribute("role", "meter");
  box.setAttribute("aria-label", `${group.group}: uncertainty over what is wanted`);
  box.setAttribute("aria-valuemin", "0");
  box.setAttribute("aria-valuemax", "100");
  box.setAttribute("aria-valuenow", String(Math.round(width)));
  box.setAttribute("aria-valuetext", found);
  const fill = made("i");
  fill.style.width = `${width}%`;
  box.append(fill, made("b"));
  return box;
}

/** Return whether the wanted u of a parameter is reached, as a word; empty without a wanted u. */
function reached({ group, u_si: u }, wanted) {
  return !(group in wanted) || u === null ? "" : u <= wanted[group] ? "reached" : "not reached";
}

/** Return the groups of a calibration whose wanted u is not reached. */
export function missed(rows, wanted) {
  return [...new Set(rows.filter((each) => reached(each, wanted) === "not reached").map((each) => each.group))];
}

/** Show a calibration, a parameter a row: value and u as in `tumble calibrate`, and the wanted u. */
export function parameters(table, rows, wanted) {
  const head = made("tr");
  head.append(...["parameter", "value", "uncertainty", "unit", "wanted", ""].map((text) => made("th", text)));
  table.replaceChildren(made("thead"), made("tbody"));
  table.children[0].append(head);
  table.children[1].append(...rows.map((each) => {
    const wish = wanted[each.group];
    const word = reached(each, wanted);
    const row = made("tr", "", word === "not reached" ? "missed" : word);
    const cells = [each.name, each.value, each.u, each.unit, wish === undefined ? "" : number(wish / each.size), word];
    row.append(...cells.map((text, i) => made(i ? "td" : "th", text)));
    return row;
  }));
}

const GHOST = { edges: "#555555", X: "#b5301f", Y: "#1e7145", Z: "#2c5fa8" };

/** Draw the present attitude in broken lines over the picture of the wanted position. */
export function ghost(box, lines) {
  const drawn = box.querySelector("svg");
  if (!lines) { if (drawn) drawn.remove(); return; }
  const picture = shape("svg", { viewBox: "-93 -93 186 186", "aria-hidden": "true" });
  for (const [name, stroke] of Object.entries(GHOST)) {
    for (const [x1, y1, x2, y2] of lines[name]) {
      const width = name === "edges" ? 1.2 : 2.4;
      picture.append(shape("line", { x1, y1, x2, y2, stroke, "stroke-width": width, "stroke-dasharray": "4 3" }));
      if (name === "edges") continue;
      const letter = shape("text", { x: 1.12 * x2, y: 1.12 * y2 + 4, fill: stroke, "font-size": 12, "text-anchor": "middle" });
      letter.textContent = name.toLowerCase();
      picture.append(letter);
    }
  }
  if (drawn) drawn.replaceWith(picture); else box.append(picture);
}

/** Show the residuals of the rests in sigmas. */
export function residuals(box, list) {
  const items = list.map((each, i) => {
    const item = made("span", `${i + 1}: ${each.sigmas.toFixed(1)}`, each.sigmas > 5 ? "bad" : "");
    item.setAttribute("role", "listitem");
    return item;
  });
  box.replaceChildren(...items);
}

/** The sphere of directions: what is taken, what each of the 26 directions would buy (the fuller, the more), and the
 * one that would buy most. */
export function sphere(box, data) {
  const best = data.gains ? data.gains.indexOf(Math.min(...data.gains)) : -1;
  const picture = shape("svg", { viewBox: "-118 -74 236 142" });
  for (const [side, x] of [[1, -59], [-1, 59]]) {
    picture.append(shape("circle", { cx: x, cy: 4, r: 50, fill: "#eef1f6", stroke: "#5b6470" }));
    const label = shape("text", { x, y: -61, "text-anchor": "middle", "font-size": 11, fill: "currentColor" });
    label.textContent = side > 0 ? "Z up" : "Z down";
    picture.append(label);
    let k = 0;
    for (let i = -1; i < 2; i++) for (let j = -1; j < 2; j++) for (let l = -1; l < 2; l++) {
      if (!i && !j && !l) continue;
      const gain = data.gains ? 1 - data.gains[k] : 0;
      const length = Math.hypot(i, j, l);
      const [fill, stroke] = k === best ? ["#7d3c98", "#7d3c98"] : ["none", "#5b6470"];
      mark(picture, [i / length, j / length, l / length], side, x, 2 + 14 * Math.sqrt(Math.max(0, gain)), fill, stroke);
      k += 1;
    }
    for (const direction of data.taken) mark(picture, direction, side, x, 4.5, "#17692f", "#17692f");
  }
  const words = best < 0 ? "green: taken; rings: directions still open" : "green: taken; rings: the larger, the more a rest there gains; violet: the most";
  box.replaceChildren(picture, made("p", words, "legend"));
}

function mark(picture, [dx, dy, dz], side, x, radius, fill, stroke) {
  if (dz * side < -1e-9) return;
  const scale = 50 / Math.sqrt(1 + Math.abs(dz));
  picture.append(shape("circle", { cx: x + scale * dx, cy: 4 - scale * dy, r: radius, fill, stroke, "stroke-width": 1.5 }));
}

/** Plot the last minute of three channels. */
export class Trace {
  constructor(box, title, unit) {
    this.box = box;
    const stroke = () => getComputedStyle(box).color;
    const grid = { stroke: "#88888855" };
    const colours = ["--trace-x", "--trace-y", "--trace-z"].map((name) => () => getComputedStyle(box).getPropertyValue(name));
    const series = [{}, ...["x", "y", "z"].map((name, i) => ({ label: name, stroke: colours[i], width: 1.5 }))];
    const axes = [{ stroke, grid, values: (_, marks) => marks.map((mark) => `${mark} s`) }, { label: unit, size: 64, stroke, grid }];
    this.data = [[], [], [], []];
    this.plot = new window.uPlot(
      { title, width: this.width(), height: 170, series, axes, scales: { x: { time: false } }, cursor: { show: false }, legend: { live: false } },
      this.data, box);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.plot.redraw());
    new ResizeObserver(() => this.plot.setSize({ width: this.width(), height: 170 })).observe(box);
  }

  width() { return Math.max(200, this.box.clientWidth); }

  add(time, channels, anew) {
    if (anew) this.data = [[], [], [], []];
    if (!channels.length && !anew) return;
    if (channels.length) this.data = this.data.map((old, i) => old.concat(i ? channels[i - 1] : time).slice(-600));
    this.plot.setData(broken(this.data));
  }
}

/** Return the channels with breaks where samples are missing. */
function broken([time, ...channels]) {
  const steps = time.slice(1).map((t, i) => t - time[i]);
  const longest = Math.max(1, 5 * [...steps].sort((a, b) => a - b)[Math.floor(steps.length / 2)]);
  const gaps = steps.flatMap((step, i) => (step > longest ? [i + 1] : []));
  const split = (values, between) => gaps.reduceRight((parts, at) => parts.toSpliced(at, 0, between(at)), values);
  return [split(time, (at) => (time[at - 1] + time[at]) / 2), ...channels.map((values) => split(values, () => null))];
}

/** Play a short tone: high for good, low for bad. */
export class Tones {
  constructor() { this.context = null; }

  toggle() {
    if (this.context) { this.context.close(); this.context = null; return false; }
    this.context = new AudioContext();
    return true;
  }

  play(screen) {
    const notes = { fault: [220, 185], turn: [660, 880], rest: [520], done: [523, 659, 784] }[screen];
    if (!this.context || !notes) return;
    notes.forEach((pitch, i) => {
      const tone = this.context.createOscillator();
      const volume = this.context.createGain();
      const start = this.context.currentTime + 0.18 * i;
      tone.frequency.value = pitch;
      volume.gain.setValueAtTime(0.25, start);
      volume.gain.exponentialRampToValueAtTime(0.001, start + 0.17);
      tone.connect(volume).connect(this.context.destination);
      tone.start(start);
      tone.stop(start + 0.18);
    });
  }
}
