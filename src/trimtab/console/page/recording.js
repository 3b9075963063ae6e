// Player of recordings. A recording is loaded as a whole. The user can play it at a chosen speed, move to any time, and
// jump to an event.

import { build, formatFixed, write } from "./format.js";
import { readRecording } from "./rows.js";

const SPEEDS = [0.25, 0.5, 1, 2, 4, 8];
const LONGEST_FRAME = 0.25;

async function fetchOk(address) {
  const answer = await fetch(address);
  if (!answer.ok) throw new Error(`the server answers ${answer.status} to ${address}`);
  return answer;
}

/** Loads a flight: {title, rows, events}. `flight`: entry of the flight in the hello message, with its number. */
export async function loadFlight(flight) {
  const [rows, events] = await Promise.all([
    fetchOk(`flights/${flight.number}/rows`).then((answer) => answer.arrayBuffer()),
    fetchOk(`flights/${flight.number}/events`).then((answer) => answer.json()),
  ]);
  return { title: flight.title, rows: readRecording(rows, flight.signals), events };
}

/** Returns the entry of a flight. A repeated run of a campaign is not in the hello message, so it is fetched. */
export async function findFlight(hello, number) {
  if (hello.flights?.[number]) return { ...hello.flights[number], number };
  return { ...(await (await fetchOk(`flights/${number}`)).json()), number };
}

export class Player {
  /** Plays a source. `flights`: one or two loaded flights; time and event marks are those of the first. */
  constructor(source, flights, alarms) {
    this.source = source;
    this.playing = false;
    this.advanced_at = null;
    this.section = document.getElementById("player");
    this.section.hidden = false;
    this.build(flights);
    alarms.clearEvents();
    alarms.goTo = (time) => this.goTo(time);
    const all = flights.flatMap((flight, k) => flight.events.map((event) => ({ ...event, text: flights.length > 1 ? `${flight.title}: ${event.text}` : event.text, k })));
    for (const event of all.sort((a, b) => a.t - b.t)) alarms.addEvent(event);
    this.goTo(source.start);
  }

  build(flights) {
    const { start, end } = this.source;
    this.button = build("button", { type: "button", class: "play", text: "▶ Play" });
    this.button.addEventListener("click", () => this.toggle());
    this.scrub = build("input", { type: "range", min: start, max: end, step: 0.01, "aria-label": "Time" });
    this.scrub.addEventListener("input", () => this.goTo(Number(this.scrub.value)));
    this.time = build("output", { text: "–" });
    this.speed = build("select", { "aria-label": "Speed" }, ...SPEEDS.map((speed) => build("option", { value: speed, text: `${speed} ×` })));
    this.speed.value = "1";
    const ticks = build("div", { class: "ticks" }, ...this.buildTicks(flights[0].events));
    this.names = build("div", { class: "names small", text: flights.map(({ title }, k) => (k ? `dashed: ${title}` : title)).join(" · ") });
    const track = build("div", { class: "track" }, ticks, this.scrub, this.names);
    this.section.replaceChildren(this.button, this.speed, track, this.time);
  }

  /** Lets the user choose one of several flights, and a second flight for comparison. Calls back with the choice. */
  offer(shown, flights, chosen) {
    if (flights.length < 2) return;
    const options = () => flights.map((flight, k) => build("option", { value: k, text: flight.title }));
    const first = build("select", { "aria-label": "Flight" }, ...options());
    const second = build("select", { "aria-label": "Second flight" }, build("option", { value: "", text: "none" }), ...options());
    const placeOf = (flight) => (flight ? String(flights.findIndex(({ number }) => number === flight.number)) : "");
    first.value = placeOf(shown[0]);
    second.value = placeOf(shown[1]);
    const choose = () => chosen([first, second].filter(({ value }) => value !== "").map(({ value }) => flights[Number(value)]));
    for (const select of [first, second]) select.addEventListener("change", choose);
    this.names.replaceChildren(first, build("span", { text: "dashed:" }), second);
  }

  buildTicks(events) {
    const { start, end } = this.source;
    return events.map(({ t, text, level }) => {
      const tick = build("button", { type: "button", class: `tick level-${level}`, title: `${formatFixed(t, 2)} s: ${text}`, "aria-label": `Go to ${text}` });
      tick.style.left = `${(100 * (t - start)) / (end - start || 1)}%`;
      tick.addEventListener("click", () => this.goTo(t));
      return tick;
    });
  }

  toggle() {
    if (!this.playing && this.source.time >= this.source.end) this.goTo(this.source.start);
    this.playing = !this.playing;
    this.advanced_at = null;
    write(this.button, this.playing ? "Ⅱ Pause" : "▶ Play");
  }

  stop() {
    if (this.playing) this.toggle();
  }

  goTo(time) {
    this.source.goTo(time);
    this.show();
  }

  /** Goes forward or back by a number of rows. */
  step(rows) {
    this.stop();
    const { times, count } = this.source.rows;
    this.goTo(times[Math.min(count - 1, Math.max(0, this.source.row + rows))]);
  }

  /** Advances the playback by the time since the last frame, times the speed. `now`: time (ms). */
  advance(now) {
    if (!this.playing) return;
    const seconds = this.advanced_at === null ? 0 : Math.min(LONGEST_FRAME, (now - this.advanced_at) / 1000);
    this.advanced_at = now;
    this.goTo(this.source.time + seconds * Number(this.speed.value));
    if (this.source.time >= this.source.end) this.toggle();
  }

  show() {
    this.scrub.value = String(this.source.time);
    write(this.time, `${formatFixed(this.source.time, 2)} of ${formatFixed(this.source.end, 1)} s`);
  }
}
