// Set-points and gains. The user can search them, change them by number or step, undo the changes one by one, and write
// them to the file.

import { build, formatBound, formatNumber, matches, write } from "./format.js";

const MOST_SHOWN = 80;
const STEP_SHARE = 0.05;

/** Returns a round step for changing a value: about a twentieth of its range, or of the value itself. */
function chooseStep({ value, low, high }) {
  const span = Number.isFinite(low) && Number.isFinite(high) && low !== null && high !== null ? high - low : Math.abs(value) || 1;
  const power = 10 ** Math.floor(Math.log10(span * STEP_SHARE));
  return power * (span * STEP_SHARE >= 5 * power ? 5 : 1);
}

/** Rounds a number to the precision of float32. */
function roundNumber(value) {
  return Number(Number(value).toPrecision(6));
}

function describeBounds({ low, high, above, unit }) {
  const words = [];
  const known = (value) => value !== null && value !== undefined && Number.isFinite(value);
  if (known(above)) words.push(`> ${formatBound(above)}`);
  if (known(low)) words.push(`≥ ${formatBound(low)}`);
  if (known(high)) words.push(`≤ ${formatBound(high)}`);
  if (unit === "rad" || unit === "rad/s") words.push("in radians");
  return words.join(", ");
}

export class ParameterPanel {
  constructor(connection, hello) {
    this.connection = connection;
    this.watches = hello.role === "observer";
    this.undone = [];
    this.asked = new Map();
    this.rows = new Map();
    this.list = document.getElementById("parameters");
    this.search = document.getElementById("parameter-search");
    this.answer = document.getElementById("tune-answer");
    this.undoButton = document.getElementById("undo");
    this.saveButton = document.getElementById("save");
    this.parameters = (hello.parameters ?? []).map((parameter) => ({ ...parameter, key: this.keyOf(parameter.path, parameter.slot), start: parameter.value }));
    this.vectors = new Set(this.parameters.filter(({ slot }) => slot).map(({ path }) => path));
    const goals = new Set(Object.values(hello.set_points ?? {}));
    this.parameters.sort((a, b) => Number(goals.has(b.path)) - Number(goals.has(a.path)));
    this.search.addEventListener("input", () => this.show());
    this.undoButton.addEventListener("click", () => this.undo());
    this.saveButton.addEventListener("click", () => this.save());
    this.saveButton.disabled = this.watches;
    this.show();
  }

  keyOf(path, slot) {
    return `${path} ${slot ?? 0}`;
  }

  nameOf({ path, slot }) {
    return this.vectors.has(path) ? `${path}.${slot}` : path;
  }

  show() {
    const found = this.parameters.filter((parameter) => matches(this.search.value, `${parameter.path} ${parameter.meaning} ${parameter.unit}`));
    this.rows.clear();
    const rows = found.slice(0, MOST_SHOWN).map((parameter) => this.buildRow(parameter));
    if (found.length > MOST_SHOWN) rows.push(build("p", { class: "small", text: `${found.length - MOST_SHOWN} more; use the search` }));
    if (!found.length) rows.push(build("p", { class: "small", text: "no parameter found" }));
    this.list.replaceChildren(...rows);
  }

  buildRow(parameter) {
    const name = this.nameOf(parameter);
    const field = parameter.modes ? build("select", { "aria-label": name }) : build("input", { type: "number", step: "any", "aria-label": name });
    parameter.modes?.forEach((mode, k) => field.append(build("option", { value: k, text: mode })));
    field.disabled = this.watches;
    const shown = { field, typing: false };
    field.addEventListener("change", () => {
      shown.typing = false;
      this.set(parameter, Number(field.value), field.value === "");
    });
    const step = chooseStep(parameter);
    const stepBy = (sign) => this.set(parameter, roundNumber((this.asked.get(parameter.key) ?? parameter.value) + sign * step));
    field.addEventListener("keydown", (event) => {
      const sign = parameter.modes ? 0 : { ArrowUp: 1, ArrowDown: -1 }[event.code];
      if (sign) {
        event.preventDefault();
        stepBy(sign);
      } else if (event.code === "Enter") field.blur();
      else if (event.code === "Escape") {
        shown.typing = false;
        this.showValue(parameter);
        field.blur();
      }
    });
    field.addEventListener("input", () => (shown.typing = true));
    const stepper = (sign, text) => {
      const button = build("button", { type: "button", text, "aria-label": `${name} ${sign < 0 ? "less" : "more"} by ${formatBound(step)}`, disabled: this.watches });
      button.addEventListener("click", () => stepBy(sign));
      return button;
    };
    const buttons = parameter.modes ? [field] : [stepper(-1, "−"), field, stepper(1, "+")];
    const note = build("small", { class: "note" });
    const unit = parameter.unit === "1" ? "" : parameter.unit;
    const row = build("div", { class: "parameter" }, build("label", { text: name, title: parameter.meaning }), build("div", { class: "stepper" }, ...buttons, build("span", { class: "unit", text: unit })), build("small", { text: parameter.meaning }), note);
    this.rows.set(parameter.key, Object.assign(shown, { row, note }));
    this.showValue(parameter);
    return row;
  }

  /** Shows the value in use. A value that is requested, but not yet in use, is marked. */
  showValue(parameter, refusal = "") {
    const shown = this.rows.get(parameter.key);
    if (!shown) return;
    const { row, field, note, typing } = shown;
    const asked = this.asked.get(parameter.key);
    const value = String(roundNumber(asked ?? parameter.value));
    if (!typing && field.value !== value) field.value = value;
    row.classList.toggle("asked", asked !== undefined);
    row.classList.toggle("refused", refusal !== "");
    row.classList.toggle("changed", parameter.value !== parameter.start);
    const changed = parameter.value === parameter.start ? "" : `, was ${formatNumber(parameter.start)}`;
    write(note, refusal || (asked !== undefined ? `requested; ${formatNumber(parameter.value)} is still in use` : describeBounds(parameter) + changed));
  }

  async set(parameter, value, isEmpty = false) {
    if (isEmpty || !Number.isFinite(value)) {
      this.showValue(parameter, "not a number");
      return false;
    }
    const before = this.asked.get(parameter.key) ?? parameter.value;
    this.asked.set(parameter.key, value);
    this.showValue(parameter);
    const { ok, text } = await this.connection.ask({ type: "set", path: parameter.path, slot: parameter.slot, value });
    if (ok) this.remember(parameter, before, value);
    else this.asked.delete(parameter.key);
    this.showValue(parameter, ok ? "" : `refused: ${text}`);
    write(this.answer, ok ? "" : `${this.nameOf(parameter)}: ${text}`);
    return ok;
  }

  remember(parameter, before, value) {
    if (!this.undoing) this.undone.push({ parameter, before, value });
    this.showUndo();
  }

  showUndo() {
    const last = this.undone.at(-1);
    this.undoButton.disabled = !last || this.watches;
    this.undoButton.title = last ? `${this.nameOf(last.parameter)} back to ${formatNumber(last.before)}` : "";
    write(this.undoButton, this.undone.length ? `Undo ${this.undone.length}` : "Undo");
  }

  async undo() {
    const last = this.undone.at(-1);
    if (!last || this.undoing) return;
    this.undoing = true;
    if (await this.set(last.parameter, last.before)) {
      this.undone.pop();
      write(this.answer, `${this.nameOf(last.parameter)} is back at ${formatNumber(last.before)}`);
    }
    this.undoing = false;
    this.showUndo();
  }

  async save() {
    write(this.answer, "writing …");
    const { ok, text } = await this.connection.ask({ type: "save" });
    write(this.answer, ok ? text || "written" : `not written: ${text}`);
  }

  /** Stores and shows a value that the flight now uses. */
  applied(path, slot, value) {
    const key = this.keyOf(path, slot);
    const parameter = this.parameters.find((other) => other.key === key);
    if (!parameter) return;
    parameter.value = value;
    this.asked.delete(key);
    this.showValue(parameter);
  }
}
