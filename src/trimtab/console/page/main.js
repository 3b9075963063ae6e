// Assembles the page: socket messages, drawing of each frame, and keys.

import { AlarmBanner } from "./alarms.js";
import { showCampaign } from "./campaign.js";
import { forgetPalette } from "./canvas.js";
import { build, formatFixed, formatMs, write } from "./format.js";
import { listenToKeys, prepareHelp } from "./keys.js";
import { HealthPanel } from "./health.js";
import { FramesTiming } from "./latency.js";
import { FlightPanel } from "./mode_and_checks.js";
import { ParameterPanel } from "./parameters.js";
import { Pilot } from "./pilot.js";
import { PlotPanel } from "./plots.js";
import { loadFlight, Player } from "./recording.js";
import { LiveSource, readRow, RecordedSource } from "./rows.js";
import { SetPoints } from "./set_points.js";
import { Connection, readClock } from "./socket.js";
import { noteMode, stopping } from "./stop.js";
import { prepareTabs, prepareTheme } from "./tabs.js";
import { LongitudinalView } from "./view_longitudinal.js";
import { PlanarView } from "./view_planar.js";
import { SpatialView } from "./view_spatial.js";

const KEPT_SECONDS = 150;
const TEXTS_PER_SECOND = 10;
const OLD_AFTER = 0.5;
const FIRST_SECONDS = 1.5;

const byId = (id) => document.getElementById(id);
const address = new URL("live", location.href);
address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
address.search = "";
const connection = new Connection(address.href);
const timing = new FramesTiming(connection.clock);
const session = { hello: null, source: null, status: null, view: null, plots: null, row_at: -Infinity, ended: null, failures: new Set() };
const alarms = new AlarmBanner(connection);
const pilot = new Pilot(connection);
const health = new HealthPanel(connection, timing);
let flight = null;
let parameters = null;
let player = null;

/** Calls a function that draws one part of the page. An exception is reported once, and the other parts continue. */
function guard(name, action) {
  try {
    action();
  } catch (error) {
    if (session.failures.has(name)) return;
    console.error(name, error);
    session.failures.add(name);
    alarms.addEvent({ t: session.source?.time ?? 0, text: `this page cannot draw its ${name}: ${error.message}`, level: "warning" });
  }
}

function buildView(view, setPoint, life) {
  const [canvas, tape] = [byId("craft"), byId("tape")];
  if (view?.kind === "planar") return new PlanarView(canvas, tape, view, setPoint, life);
  if (view?.kind === "spatial") return new SpatialView({ attitude: byId("attitude"), craft: canvas, tape }, view, setPoint, life);
  if (view?.kind === "longitudinal") return new LongitudinalView(canvas, tape, view, setPoint);
  return null;
}

/** Shows rows of the live flight or of a recording. */
function showSource(hello, source) {
  session.life?.abort();
  session.life = new AbortController();
  const life = session.life.signal;
  session.source = source;
  const setPoints = new SetPoints(hello.set_points, hello.parameters, source);
  session.setPoints = setPoints;
  session.view = null;
  guard("view", () => (session.view = buildView(hello.view, (path) => setPoints.now(path), life)));
  document.body.dataset.view = hello.view?.kind ?? "plain";
  flight = new FlightPanel(connection, hello, source);
  session.plots = null;
  guard("plots", () => (session.plots = new PlotPanel(source, setPoints, hello.title, life)));
}

/** Shows the role of this page, and the calibration of the flight. */
function describeRole({ kind, role }, calibration) {
  const own = { recording: "recording", campaign: "campaign" }[kind] ?? role;
  return calibration ? `${own}, calibration ${calibration}` : own;
}

function start(hello) {
  document.body.dataset.kind = hello.kind;
  document.body.dataset.role = hello.role;
  write(byId("scenario"), hello.title);
  write(byId("role"), describeRole(hello, hello.calibration));
  if (hello.kind === "flight") {
    showSource(hello, new LiveSource(hello.signals, Math.ceil((2 * KEPT_SECONDS) / (hello.row_period || 0.02))));
    parameters = new ParameterPanel(connection, hello);
    pilot.start(hello);
  } else if (hello.kind === "campaign") showCampaign(hello, showFlights).catch((error) => alarms.showOwn(`the campaign cannot be shown: ${error.message}`));
  else {
    const flights = hello.flights.map((flight, number) => ({ ...flight, number }));
    showFlights(flights.slice(0, 2), flights);
  }
  if (hello.kind !== "flight") byId("tab-events").click();
}

/** Loads one flight, or two flights for comparison, and plays them. */
async function showFlights(flights, others = []) {
  byId("notice").hidden = false;
  write(byId("notice"), "Loading the recording …");
  try {
    const [first, second] = await Promise.all(flights.map(loadFlight));
    const source = new RecordedSource(first.rows, second?.rows ?? null);
    showSource({ ...session.hello, view: flights[0].view ?? session.hello.view }, source);
    write(byId("role"), describeRole(session.hello, flights[0].calibration));
    player?.stop();
    player = new Player(source, [first, second].filter(Boolean), alarms);
    player.offer(flights, others, (chosen) => showFlights(chosen, others));
    if (session.plots) session.plots.goTo = (time) => player.goTo(time);
    byId("notice").hidden = true;
  } catch (error) {
    write(byId("notice"), `The recording cannot be shown: ${error.message}`);
  }
}

function identify({ kind, title, role, signals }) {
  return JSON.stringify([kind, title, role, signals]);
}

connection.on("hello", (hello) => {
  const same = session.hello && identify(session.hello) === identify(hello);
  if (session.hello && !same) {
    location.reload();
    return;
  }
  session.hello = hello;
  byId("notice").hidden = true;
  alarms.showOwn("");
  document.body.classList.remove("stale", "lost");
  if (!same) start(hello);
  else for (const parameter of hello.parameters ?? []) connection.tell("value", parameter);
});

connection.on("row", (buffer) => {
  if (!session.source?.live) return;
  const row = readRow(buffer, session.source.rows.signals);
  if (!row) return;
  session.row_at = readClock();
  session.ended = null;
  session.source.rows.push(row.time, row.values);
  timing.noteRow(row.clock);
  const supervisor = session.hello.supervisor;
  if (supervisor) noteMode(supervisor.modes[session.source.rows.value(supervisor.mode, session.source.row)]);
});

connection.on("status", (status) => {
  session.status = status;
  flight?.showStatus(status);
  health.showStatus(status);
  alarms.showStatus(status);
  pilot.showStatus(status);
});
connection.on("event", (event) => alarms.addEvent(event));
connection.on("end", (message) => (session.ended = message.text));
connection.on("value", ({ path, slot, value }) => {
  parameters?.applied(path, slot, value);
  session.setPoints?.note(path, slot, value);
});

/** Marks old data of a live flight, so that they never look live. Data of a recording are never marked. */
function showFreshness() {
  if (session.hello && session.hello.kind !== "flight") return;
  const age = readClock() - session.row_at;
  const old = (age > OLD_AFTER && !session.ended) || !connection.connected;
  document.body.classList.toggle("stale", old);
  document.body.classList.toggle("lost", !connection.connected);
  const text = describeAge(age, old);
  const notice = byId("notice");
  notice.hidden = text === "";
  notice.classList.toggle("calm", Boolean(session.ended));
  write(notice, text);
  const lost = connection.connected ? "no data from the flight" : "no connection to the server";
  alarms.showOwn(old && !session.ended && readClock() > FIRST_SECONDS ? lost : "");
}

function describeBattery(battery) {
  if (!battery) return "–";
  const voltage = `${formatFixed(battery.voltage, 1)} V`;
  return battery.remaining === null ? voltage : `${voltage} ${formatFixed(100 * battery.remaining, 0)} %`;
}

function describeAge(age, old) {
  if (session.ended) return `The flight is over: ${session.ended}`;
  const seconds = Number.isFinite(age) ? `The data shown is ${formatFixed(age, 1)} s old.` : "";
  if (connection.connected) return old ? `No data from the flight. ${seconds}` : "";
  const wait = Math.max(0, connection.retry_at - readClock());
  return `No connection to the server. ${seconds} Trying again in ${formatFixed(wait, 1)} s. If this persists, open the printed address again.`;
}

function showTexts() {
  const { source, status, hello } = session;
  if (!source) return;
  write(byId("gauge-time"), formatFixed(source.time, 1));
  write(byId("gauge-link"), `${formatMs(status?.link?.down ?? null)} / ${formatMs(status?.link?.up ?? null)}`);
  write(byId("gauge-battery"), describeBattery(status?.battery));
  write(byId("gauge-pixels"), formatMs(timing.median));
  flight?.showRow(source);
  const pairs = session.view?.read(source) ?? [];
  const list = byId("readouts");
  if (list.children.length !== pairs.length) {
    list.replaceChildren(...pairs.map(([name]) => build("div", {}, build("dt", { text: name }), build("dd", { class: "live", text: "–" }))));
  }
  pairs.forEach(([, text], k) => write(list.children[k].lastChild, text));
  if (hello.kind === "flight" && session.plots) health.showTiming(session.plots);
}

let drawn_row = -1;
let texts_at = 0;
function drawFrame(now) {
  requestAnimationFrame(drawFrame);
  const { source, view } = session;
  if (now - texts_at > 1000 / TEXTS_PER_SECOND) {
    texts_at = now;
    guard("numbers", showTexts);
  }
  if (!source) return;
  guard("player", () => player?.advance(now));
  const row = source.live ? source.rows.base + source.row : source.time;
  const is_new = row !== drawn_row;
  if (view && source.rows.count && (is_new || view.changed)) guard("view", () => view.draw(source));
  drawn_row = row;
  if (source.rows.count && session.plots) guard("plots", () => session.plots.tick(now));
  timing.noteFrame(is_new && source.live);
}

for (const [id, factor] of [["zoom-in", 1.3], ["zoom-out", 1 / 1.3]]) byId(id).addEventListener("click", () => session.view?.zoom(factor));
byId("fit").addEventListener("click", () => follow(false, true));
byId("follow").addEventListener("click", () => follow(!session.view?.following, false));

function follow(yes, fit) {
  session.view?.follow(yes);
  if (fit) session.view?.fit();
}
setInterval(() => byId("follow").setAttribute("aria-pressed", String(session.view?.following ?? true)), 200);

listenToKeys({
  KeyT: () => pilot.toggle(),
  KeyM: () => pilot.nextMode(),
  KeyF: () => follow(!session.view?.following, false),
  KeyK: () => alarms.acknowledge(),
  Equal: () => session.view?.zoom(1.3),
  NumpadAdd: () => session.view?.zoom(1.3),
  BracketRight: () => session.view?.zoom(1.3),
  Minus: () => session.view?.zoom(1 / 1.3),
  NumpadSubtract: () => session.view?.zoom(1 / 1.3),
  Space: () => player?.toggle(),
  Comma: () => player?.step(-1),
  Period: () => player?.step(1),
});
prepareHelp();
prepareTabs();
prepareTheme(() => {
  forgetPalette();
  session.plots?.rebuild();
  for (const canvas of [session.view?.surface, session.view?.tape.surface, session.view?.plan?.surface]) if (canvas) canvas.changed = true;
});
setInterval(() => guard("freshness", showFreshness), 1000 / TEXTS_PER_SECOND);
connection.open();
requestAnimationFrame(drawFrame);

/** State for browser tests; not used by the page. */
window.trimtab = {
  latency: timing,
  stopping,
  get source() {
    return session.source;
  },
  get state() {
    return {
      hello: session.hello,
      status: session.status,
      connected: connection.connected,
      stale: document.body.classList.contains("stale"),
      ended: session.ended,
      stick: pilot.state,
      plots: session.plots?.plots.map((plot) => plot.paths) ?? [],
      failures: [...session.failures],
    };
  },
};
