// Searchable list of signals, from which the user chooses a signal for a plot.

import { build, matches, shownUnit } from "./format.js";

const MOST_SHOWN = 200;

export class SignalPicker {
  constructor(signals, life) {
    this.signals = signals;
    this.dialog = document.getElementById("picker");
    this.search = document.getElementById("picker-search");
    this.text = document.getElementById("picker-text");
    this.list = document.getElementById("picker-list");
    this.search.addEventListener("input", () => this.show(), { signal: life });
    document.getElementById("picker-close").addEventListener("click", () => this.close(), { signal: life });
    window.addEventListener("keydown", (event) => event.code === "Escape" && this.dialog.open && this.close(), { signal: life });
    this.list.addEventListener("click", (event) => this.click(event), { signal: life });
  }

  /** Opens the list of signals with a given unit, or of all signals. Calls back with the path of each chosen signal. */
  open(unit, shown, chosen) {
    Object.assign(this, { unit, shown: new Set(shown), chosen, opener: document.activeElement });
    this.search.value = "";
    this.show();
    this.dialog.show();
    this.search.focus();
  }

  close() {
    this.dialog.close();
    this.opener?.focus();
  }

  click(event) {
    const path = event.target.closest("button")?.dataset.path;
    if (!path) return;
    this.unit = this.signals.find((signal) => signal.path === path).unit;
    this.shown.add(path);
    this.chosen(path);
    this.show();
    this.search.focus();
  }

  show() {
    const fits = this.signals.filter((signal) => this.unit === null || signal.unit === this.unit);
    const found = fits.filter((signal) => matches(this.search.value, `${signal.path} ${signal.meaning} ${signal.unit}`));
    const only = this.unit === null ? "" : ` in ${shownUnit(this.unit) || "no unit"}, as a plot has one unit`;
    this.text.textContent = `${found.length} of ${fits.length} signals${only}`;
    this.list.replaceChildren(
      ...found.slice(0, MOST_SHOWN).map((signal) => {
        const has = this.shown.has(signal.path);
        const button = build("button", { type: "button", "data-path": signal.path, disabled: has });
        button.append(build("b", { text: signal.path }), build("i", { text: has ? "shown" : shownUnit(signal.unit) }), build("small", { text: signal.meaning }));
        return build("li", {}, button);
      }),
    );
  }
}
