// The page shows the states that the server sends, and sends the operator's commands.

import { about, clock, details, ghost, groups, made, missed, number, parameters, points, residuals, sphere, Tones, Trace } from "./parts.js";

const of = (id) => document.getElementById(id);
const tones = new Tones();
const accel = new Trace(of("accel"), "Accelerometers", "m/s²");
const gyro = new Trace(of("gyro"), "Gyros", "°/s");
let state = {};
let screen = "";
let noted = { text: "", until: 0 };

function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

function show(element, wanted) {
  element.hidden = !wanted;
}

// -------------------- display --------------------

function header() {
  const { unit, received, rest, session } = state;
  say(of("serial"), unit.serial);
  const parts = [rest && `position ${rest.number}${rest.of ? ` of ${rest.of}` : ""}`, state.to_go && `${about(state.to_go)} to go`, session];
  say(of("count"), parts.filter(Boolean).join(" · "));
  const faults = [[received.lost, "lost"], [received.refused, "refused"]];
  const said = faults.filter(([count]) => count).map(([count, what]) => `${count} ${what}`).join(", ");
  const rate = received.rate ? `${number(received.rate)} Hz` : "–";
  say(of("received"), `${received.source} · ${clock(state.seconds || 0)} · ${rate} · ${received.samples} samples · ${said || "none lost"}`);
  of("trouble").className = "trouble";
  const trouble = received.trouble.concat(received.ended ? ["the source has ended"] : []);
  if (!state.may_command) trouble.push("this page may look, not command: open the link with the token");
  say(of("trouble"), trouble.join(" · "));
  show(of("trouble"), trouble.length > 0);
}

function now() {
  const { fault, position } = state;
  const { result } = state;
  const ended = verdict();
  const stopped = hasStopped();
  say(of("headline"), ended || (state.calibrating ? "Calibrating …" : stopped ? "Recording has stopped" : state.headline));
  of("headline").classList.toggle("long", of("headline").textContent.length > 45);
  const wrong = fault && !ended && !stopped && !state.calibrating;
  say(of("fault"), wrong ? fault.said : "");
  show(of("fault"), Boolean(wrong));
  const less = result ? missed(result.parameters, state.wanted).length : state.screen === "done" && state.missed && state.missed.length;
  of("now").className = `now ${result && !result.accepted ? "fault" : !result && (stopped || state.received.silent) ? "stopped" : less ? "missed" : result ? "done" : state.screen}`;
  show(of("target"), Boolean(position) && !result);
  ghost(of("target"), position && state.screen !== "rest" ? position.ghost : null);
  if (position && of("picture").getAttribute("src") !== position.picture) {
    of("picture").src = position.picture;
    of("picture").alt = `Position ${position.number}: ${position.label}${position.move && `; ${position.move}`}`;
  }
  show(of("sphere"), Boolean(state.sphere) && !position && state.screen !== "done" && !result);
  if (state.sphere && !position) sphere(of("sphere"), state.sphere);
  points(of("points"), result ? null : position);
  figures();
}

/** Return true if recording has stopped and can be resumed. */
function hasStopped() {
  return state.can_record && !state.listening && !state.received.ended;
}

/** The verdict of the calibration and the wanted uncertainties that it misses; empty before there is one. */
function verdict() {
  const { result, wanted } = state;
  if (!result) return "";
  const left = result.accepted ? missed(result.parameters, wanted) : [];
  return `Calibrated: ${result.accepted ? "accepted" : "not accepted"}${left.length ? `; not reached: ${left.join(", ")}` : ""}`;
}

/** Legend of the dotted lines in the picture. */
function dotted() {
  return ["dotted", state.position && state.position.ghost ? "as it lies now" : ""];
}

/** Show the main number and its meaning. */
function big(text, what = "") {
  say(of("big"), text);
  of("big").dataset.what = what;
}

function figures() {
  const { rest, turn, scatter } = state;
  const degrees = state.temperature === null || state.temperature === undefined ? "" : `${state.temperature.toFixed(2)} °C`;
  const over = state.result || hasStopped() || state.received.ended;
  if (over || state.screen === "done") {
    const left = over || !state.estimate ? [] : state.estimate.groups.filter((group) => !group.enough);
    big("");
    details(of("details"), left.map((group) => [group.group, group.determined ? `${number(group.u)} of ${number(group.wanted)} ${group.unit}` : "not determined"]));
  } else if (state.screen === "rest") {
    big(rest.nothing_more ? "enough" : rest.left === null ? "…" : clock(rest.left), rest.left === null ? "" : "to hold still");
    details(of("details"), [
      ["accelerometers ±", rest.u === null ? "…" : `${number(rest.u)} of ${number(rest.wanted)} µg`],
      ["gyros ±", rest.gyro_u === null ? "" : `${number(rest.gyro_u)} of ${number(rest.gyro_wanted)} °/h`],
      ["drift", `${number(rest.drift)} µg${rest.settling ? ": still settling" : ""}`],
      ["temperature", degrees],
      ["at rest", clock(rest.seconds)],
      ["", rest.left === null && rest.seconds > 20 ? "the uncertainty falls too slowly to say when: still settling, or noisier than its grade" : ""],
      ["", rest.nothing_more ? "longer gives nothing" : ""],
    ]);
  } else if (state.screen === "turn") {
    big(turn.done === null ? "" : `${turn.done.toFixed(0)}°`.replace("-", "−"), turn.done === null ? "" : "turned so far");
    const scale = turn.full_scale === null ? "" : ` of ${number(turn.full_scale)} °/s`;
    details(of("details"), [
      ["move", state.position ? state.position.move : "any way you like"],
      dotted(),
      ["rate", turn.rate === null ? "" : `${turn.rate.toFixed(1)} °/s${scale}`],
      ["best", !state.position && state.estimate ? state.estimate.next : ""],
      ["note", state.early],
    ]);
  } else {
    big("");
    details(of("details"), state.fault && state.position ? [["move", state.position.move], dotted()] : scatter ? [["scatter now", `${number(scatter.now)} m/s²`], ["of a rest below", `${number(scatter.limit)} m/s²`], ["temperature", degrees]] : []);
  }
}

/** Show the estimate so far; after a calibration, whose table has the numbers, only its rests. */
function estimate() {
  const { estimate: found, result } = state;
  const busy = state.estimating ? " …" : "";
  say(of("estimated"), result ? "Rests" : (found ? `Estimate from ${found.rests} rests${found.enough ? ": all that is wanted is reached" : ""}` : "No estimate yet") + busy);
  const { groups: bars, residuals: left, next, cause } = found || { groups: [], residuals: [], next: "", cause: "" };
  groups(of("groups"), bars);
  residuals(of("residuals"), left);
  show(of("rests"), left.length > 0);
  show(of("groups"), !result);
  say(of("next"), next && !result && !state.position ? `Best next: ${next}` : "");
  say(of("cause"), cause);
  show(of("cause"), Boolean(cause));
}

function finish() {
  const { result } = state;
  show(of("finish"), Boolean(result));
  show(of("numbers"), Boolean(result) && result.parameters.length > 0);
  if (!result) return;
  for (const element of document.querySelectorAll("#finish .accepted")) show(element, result.accepted);
  of("changes").replaceChildren(...result.before_and_after.map((line) => made("li", line)));
  say(of("registered"), result.registered);
  const wished = result.parameters.filter((each) => each.group in state.wanted);
  const further = result.parameters.filter((each) => !(each.group in state.wanted));
  const wanted = result.accepted ? state.wanted : {}; // nothing is reached by values that must not be used
  parameters(of("parameters"), wished, wanted);
  parameters(of("further").querySelector("table"), further, wanted);
  say(of("further").querySelector("summary"), `${further.length} further parameters, of which nothing is wanted`);
  show(of("further"), further.length > 0);
  of("reasons").replaceChildren(...result.reasons.map((reason) => made("li", reason)));
  const formats = of("export-to");
  if (!formats.children.length) formats.replaceChildren(...result.formats.map((name) => made("option", name)));
  of("files").replaceChildren(...result.files.map((name) => {
    const link = made("a", name);
    link.href = `files/${encodeURIComponent(name)}`;
    link.download = name;
    return link;
  }));
}

/** Show the possible answers with their effects, the usual one first. */
function buttons() {
  const box = of("buttons");
  const given = new Map(state.answers.map((each) => [each.do, each]));
  for (const button of box.children) {
    const answer = given.get(button.dataset.do);
    show(button, answer);
    if (!answer) continue;
    const text = `${answer.label} ${button.dataset.key.toUpperCase()} ${answer.says}`;
    if (button.dataset.text !== text) {
      button.replaceChildren(made("b", answer.label), " ", made("kbd", button.dataset.key.toUpperCase()), made("small", answer.says));
      button.dataset.text = text;
    }
    button.className = answer.primary ? "primary" : "";
    if (answer.primary && box.firstElementChild !== button) box.prepend(button);
  }
  for (const button of document.querySelectorAll("main button")) button.disabled = !state.may_command;
  show(of("leave"), Boolean(state.estimate) || state.excluded > 0);
}

function update(next) {
  state = next;
  alive();
  header();
  now();
  estimate();
  finish();
  buttons();
  const repeated = state.result && verdict().toLowerCase().startsWith(state.message); // as in the headline
  say(of("message"), Date.now() < noted.until ? noted.text : repeated ? "" : state.message);
  accel.add(state.trace.t, state.trace.a, state.trace.anew);
  gyro.add(state.trace.t, state.trace.g, state.trace.anew);
  const heard = `${state.screen} ${state.headline}`;
  if (heard !== screen) tones.play(state.screen);
  screen = heard;
  document.body.dataset.screen = state.screen;
}

// -------------------- answers --------------------

async function command(name, value = "") {
  try {
    const answer = await fetch("command", {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify({ do: name, value }),
    });
    if (answer.ok) say(of("message"), (await answer.json()).said);
    else note(await answer.text());
  } catch {
    note("the server does not answer");
  }
}

const SCAN_MS = 60; // between the keys of a scanner, at most
let typed = "";
let pause = 0;

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey || event.target.matches("input, select")) return;
  if (event.key === "Enter" && typed.length > 2) { event.preventDefault(); scanned(typed); typed = ""; return; }
  if (event.key.length !== 1 || event.repeat) return;
  typed += event.key;
  clearTimeout(pause);
  pause = setTimeout(() => { if (typed.length === 1) pressed(typed.toLowerCase()); typed = ""; }, SCAN_MS);
});

/** Handle a key. */
function pressed(key) {
  const button = document.querySelector(`button[data-key="${CSS.escape(key)}"]`);
  if (button && button.offsetParent && !button.disabled) button.click();
}

/** Handle the serial number of the next unit, typed by a scanner and ended by Enter. */
function scanned(text) {
  if (state.result && state.may_command) command("next_unit", text);
  else note(`scanned ${text}: this unit is not calibrated yet`);
}

/** Show a message for a while. */
function note(text) {
  noted = { text, until: Date.now() + 5000 };
  say(of("message"), text);
}

document.addEventListener("click", (event) => {
  const button = event.target.closest("button");
  if (!button) return;
  if (button.dataset.do === "anew") command("next_unit", state.unit.serial);
  else if (button.dataset.do) command(button.dataset.do);
});

function onSubmit(id, name, input) {
  of(id).addEventListener("submit", (event) => {
    event.preventDefault();
    command(name, of(input).value);
    if (of(input).matches("input")) of(input).value = "";
  });
}

onSubmit("leave", "leave_out", "leave-number");
onSubmit("export", "export", "export-to");
onSubmit("unit", "next_unit", "unit-serial");
of("sound").addEventListener("click", () => of("sound").setAttribute("aria-pressed", String(tones.toggle())));

// -------------------- loss of the server --------------------

const SILENT_MS = 3000; // the server sends a state or an empty event at least once a second
let heardAt = new Date();
let silence = 0;

/** Handle any event of the server. */
function alive() {
  heardAt = new Date();
  if (document.body.dataset.dead) {
    delete document.body.dataset.dead;
    header();
    buttons();
  }
  clearTimeout(silence);
  silence = setTimeout(dead, SILENT_MS);
}

/** Mark the page as out of date. */
function dead() {
  const since = heardAt.toLocaleTimeString();
  say(of("trouble"), `The server does not answer. What is below is from ${since}; whether it is recording is not known. The page goes on when it answers.`);
  show(of("trouble"), true);
  of("trouble").className = "trouble dead";
  document.body.dataset.dead = "yes";
  for (const button of document.querySelectorAll("main button")) button.disabled = true;
}

const events = new EventSource("events");
events.onmessage = (event) => update(JSON.parse(event.data));
events.addEventListener("here", alive);
events.onerror = dead;
