// The pilot's stick. Its position is sent 50 times a second while the pilot has the stick. It is not sent while nobody
// can be flying. The dead-man switch then acts on the missing data: it holds the craft, then stops it.

import { build, formatFixed, formatMs, write } from "./format.js";
import { StickInputs } from "./pilot_inputs.js";
import { readClock } from "./socket.js";
import { stopFlight } from "./stop.js";

const PERIOD_MS = 20;
const LONGEST_STEP = 0.1;
const GRANT_SECONDS = 0.6;
const AXES = ["forward", "turn"];

export class Pilot {
  constructor(connection) {
    this.connection = connection;
    this.section = document.getElementById("stick");
    this.pad = document.getElementById("pad");
    this.knob = document.getElementById("knob");
    this.button = document.getElementById("take");
    this.text = document.getElementById("stick-text");
    this.numbers = document.getElementById("stick-numbers");
    this.modes = document.getElementById("stick-mode");
    this.state = { has: false, lost: "", mode: 0, forward: 0, turn: 0, sent: 0, device: "keys" };
    this.available = false;
    this.answer = "";
    this.granted_at = -Infinity;
    this.latency = null;
    this.inputs = new StickInputs(this.pad, () => this.flies, (name) => this.press(name));
    this.read_at = readClock();
    connection.on("lost", () => this.noteLost());
  }

  /** True while the keys move the craft. */
  get flies() {
    return this.state.has && !this.state.lost;
  }

  start(hello) {
    this.available = Boolean(hello.pilot) && hello.role === "pilot";
    this.section.hidden = !hello.pilot;
    if (!hello.pilot) return;
    this.modes.replaceChildren(...hello.pilot.modes.map((mode, k) => build("option", { value: k, text: mode })));
    this.modes.addEventListener("change", () => {
      this.state.mode = Number(this.modes.value);
      this.modes.blur();
    });
    this.button.addEventListener("click", () => this.toggle());
    this.button.disabled = this.modes.disabled = !this.available;
    const meaning = (axis) => hello.pilot[axis]?.meaning ?? axis;
    this.pad.title = AXES.map((axis) => `${axis}: ${meaning(axis)}`).join(" ");
    document.addEventListener("visibilitychange", () => this.watch());
    setInterval(() => this.step(), PERIOD_MS);
    this.show();
  }

  press(name) {
    if (name === "stop") stopFlight();
    else if (name === "mode") this.nextMode();
    else if (!this.flies) this.toggle();
  }

  nextMode() {
    if (!this.available) return;
    this.state.mode = (this.state.mode + 1) % this.modes.options.length;
    this.modes.value = String(this.state.mode);
  }

  /** Takes the stick, or releases it if this page has it. A lost stick is taken again. */
  async toggle() {
    if (!this.available) return;
    this.answer = "";
    const gives = this.flies;
    if (gives) this.state.has = false;
    const { ok, text } = await this.connection.ask({ type: gives ? "release" : "take" });
    if (!ok) this.answer = text;
    if (ok && !gives) {
      this.inputs.centre();
      Object.assign(this.state, { has: true, lost: "" });
      this.granted_at = readClock();
    }
    this.show();
  }

  showStatus(status) {
    this.holder = status.pilot;
    this.latency = status.stick_latency;
    const granted = readClock() - this.granted_at < GRANT_SECONDS;
    if (status.pilot !== "you" && !granted && this.state.has) Object.assign(this.state, { has: false, lost: "" });
    this.show();
  }

  noteLost() {
    if (this.state.has) this.answer = "connection lost: the craft holds, then stops";
    Object.assign(this.state, { has: false, lost: "" });
    this.holder = null;
    this.show();
  }

  /** Detects that nobody can be flying: the page is hidden or has no focus, or the gamepad is disconnected. */
  watch() {
    if (!this.flies) return;
    let reason = "";
    if (document.visibilityState !== "visible") reason = "the page was hidden";
    else if (!document.hasFocus()) reason = "the page lost focus";
    else if (!this.inputs.present) reason = "the gamepad was disconnected";
    if (!reason) return;
    this.state.lost = reason;
    this.show();
  }

  step() {
    const now = readClock();
    const axes = this.inputs.read(Math.min(LONGEST_STEP, now - this.read_at));
    this.read_at = now;
    this.watch();
    const { state } = this;
    Object.assign(state, { device: this.inputs.device, ...(this.flies ? axes : { forward: 0, turn: 0 }) });
    if (this.flies && this.connection.send({ type: "stick", forward: state.forward, turn: state.turn, mode: state.mode })) state.sent += 1;
    this.showStick();
  }

  showStick() {
    const { forward, turn, device } = this.state;
    const key = `${forward.toFixed(3)} ${turn.toFixed(3)} ${device} ${this.latency}`;
    if (key === this.shown) return;
    this.shown = key;
    const reach = 0.42 * this.pad.clientWidth;
    this.knob.style.transform = `translate(${(turn * reach).toFixed(1)}px, ${(-forward * reach).toFixed(1)}px)`;
    const latency = this.latency === null || this.latency === undefined ? "" : ` · ${formatMs(this.latency)} ms`;
    write(this.numbers, `forward ${formatFixed(forward, 2)} · turn ${formatFixed(turn, 2)} · ${device}${latency}`);
  }

  show() {
    const { has, lost } = this.state;
    this.section.dataset.state = lost ? "lost" : has ? "mine" : this.holder === "other" ? "other" : "free";
    const name = lost ? "Take again" : has ? "Give back" : "Take the stick";
    if (this.button.firstChild.textContent.trim() !== name) this.button.firstChild.textContent = `${name} `;
    let text = this.holder === "other" ? "another pilot has the stick" : "nobody has the stick";
    if (!this.available) text = this.holder === "nobody" ? "observers cannot fly" : "a pilot has the stick";
    if (has) text = "you have the stick";
    if (lost) text = `stick lost, ${lost}: holds, then stops`;
    write(this.text, this.answer && !has ? this.answer : text);
  }
}
