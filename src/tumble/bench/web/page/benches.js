// The list of the benches: what each says, how far it is, and which wants the operator next.

import { about, clock, details, made, Tones } from "./parts.js";

const of = (id) => document.getElementById(id);
const tones = new Tones();
const WANTS = ["fault", "turn", "done"];
let next = 0;
let heard = {};
const rows = new Map();

function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** The elements of a bench; they stay, so that a link keeps the focus. */
function row(number) {
  if (!rows.has(number)) {
    const item = made("li");
    const link = made("a", "", "bench");
    link.href = `${number}/`;
    const name = made("span", "", "name");
    const said = made("span", "", "said");
    const bar = made("span", "", "bar");
    bar.setAttribute("role", "progressbar");
    bar.setAttribute("aria-label", `Bench ${number}: positions`);
    bar.append(made("i"));
    item.append(link, bar, made("dl", "", "details"));
    link.append(name, said);
    rows.set(number, item);
    of("benches").append(item);
  }
  return rows.get(number);
}

function show(bench) {
  const item = row(bench.number);
  const { number: at, of: every, left = null } = bench.rest || { number: 0, of: null };
  const [link, bar, list] = item.children;
  item.className = bench.result ? "done" : bench.screen;
  say(link.children[0], `${bench.number}  ${bench.unit.serial}${bench.unit.model ? ` · ${bench.unit.model}` : ""}`);
  const result = bench.result ? `Calibrated: ${bench.result.accepted ? "accepted" : "not accepted"}` : "";
  say(link.children[1], result || (bench.fault ? bench.fault.said : bench.headline));
  bar.hidden = !every;
  if (every) {
    bar.setAttribute("aria-valuemin", "0");
    bar.setAttribute("aria-valuemax", String(every));
    bar.setAttribute("aria-valuenow", String(at));
    bar.firstChild.style.width = `${(100 * at) / every}%`;
  }
  details(list, [
    ["position", at ? `${at}${every ? ` of ${every}` : ""}` : "–"],
    ["this rest", left === null ? "" : clock(left)],
    ["to go", bench.to_go === null ? "" : about(bench.to_go)],
    ["session", bench.session],
    ["source", bench.received.source],
    ["trouble", bench.received.trouble.join(" · ")],
  ]);
}

function headline({ number, unit, screen, headline: said, rest, result }) {
  const left = rest && rest.left !== undefined ? rest.left : null;
  const name = `bench ${number}, ${unit.serial}`;
  if (result) return `Next unit at ${name}`;
  if (WANTS.includes(screen)) return `Go to ${name}: ${said}`;
  return left === null ? "No bench wants you" : `No bench wants you: ${name} in ${clock(left)}`;
}

function update(state) {
  next = state.next;
  state.benches.forEach(show);
  say(of("count"), `${state.benches.length} benches`);
  say(of("next"), headline(state.benches[next - 1]));
  of("next").className = state.benches[next - 1].screen;
  of("trouble").hidden = true;
  of("trouble").className = "trouble";
  delete document.body.dataset.dead;
  const screens = Object.fromEntries(state.benches.map((bench) => [bench.number, `${bench.screen} ${bench.headline}`]));
  const wanting = state.benches.find((bench) => heard[bench.number] !== screens[bench.number] && WANTS.includes(bench.screen));
  if (wanting) tones.play(wanting.screen);
  heard = screens;
  document.body.dataset.screen = "list";
}

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  const number = event.key === "Enter" && event.target === document.body ? next : Number(event.key);
  if (rows.has(number)) rows.get(number).firstChild.click();
});

of("sound").addEventListener("click", () => of("sound").setAttribute("aria-pressed", String(tones.toggle())));

const events = new EventSource("events");
events.onmessage = (event) => update(JSON.parse(event.data));
events.onerror = () => {
  say(of("trouble"), "The server does not answer. What is below is old. The page goes on when it answers.");
  of("trouble").className = "trouble dead";
  of("trouble").hidden = false;
  document.body.dataset.dead = "yes";
};
