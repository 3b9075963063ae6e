// Mode of the supervisor with its cause, possible requests, checks, and ages of the data.

import { build, formatBeside, formatBound, formatFixed, write } from "./format.js";

const SIGNS = { standby: "○", flying: "▶", hold: "Ⅱ", lost: "?", fault: "✕", ended: "■" };
/** Modes that have no effect on a vehicle that is not armed. */
const MOVING = new Set(["flying", "hold"]);
/** Requests without a supervisor: arm the vehicle, end the flight. */
const REQUESTS_OF_NONE = ["arm", "end"];
const WARN_SHARE = 0.7;
const ANSWER_SHOWN_MS = 5000;
const REQUEST_TEXTS = { arm: "start the flight", hold: "stay still", resume: "continue the flight", end: "end the flight", clear: "back to standby" };

export class FlightPanel {
  constructor(connection, hello, source) {
    this.connection = connection;
    this.hello = hello;
    this.supervisor = hello.supervisor;
    this.watches = hello.role === "observer";
    this.answers = new Map();
    this.mode = document.getElementById("mode");
    this.sign = document.getElementById("mode-sign");
    this.name = document.getElementById("mode-name");
    this.cause = document.getElementById("mode-cause");
    this.checks = document.querySelector("#checks tbody");
    this.buildRequests();
    this.buildAges((hello.ages ?? []).filter((age) => source.rows.has(age.path)));
    if (!this.supervisor) {
      write(this.sign, "●");
      write(this.name, { flight: "not armed", campaign: "campaign" }[hello.kind] ?? "replay");
      write(this.cause, hello.kind === "flight" ? "no supervisor" : "");
    }
  }

  buildRequests() {
    const strip = document.getElementById("requests");
    this.buttons = new Map();
    if (this.hello.kind !== "flight") return;
    for (const request of this.supervisor?.requests ?? REQUESTS_OF_NONE) {
      if (request === "none") continue;
      const why = build("small");
      const button = build("button", { type: "button", disabled: true, "data-request": request }, build("b", { text: request }), why);
      button.addEventListener("click", () => this.ask(request));
      this.buttons.set(request, { button, why });
    }
    strip.replaceChildren(...[...this.buttons.values()].map(({ button }) => button));
    this.showRequests({});
    this.connection.on("lost", () => this.showRequests({}));
  }

  async ask(request) {
    this.answers.set(request, "requested …");
    this.showRequests(this.requests);
    const { ok, text } = await this.connection.ask({ type: "request", request });
    this.answers.set(request, ok ? text || "accepted" : text || "refused");
    this.showRequests(this.requests);
    setTimeout(() => this.answers.delete(request), ANSWER_SHOWN_MS);
  }

  /** Shows the allowed requests, and the reason for each request that is not allowed. */
  showRequests(requests) {
    this.requests = requests;
    for (const [name, { button, why }] of this.buttons) {
      const { allowed = false, why: reason = "" } = requests[name] ?? {};
      const text = this.watches ? "observers only watch" : this.answers.get(name) ?? (allowed ? REQUEST_TEXTS[name] ?? "" : reason || (this.connection.connected ? "not now" : "no connection"));
      button.disabled = this.watches || !allowed;
      write(why, text);
      button.title = `${name}: ${text}`;
    }
  }

  buildAges(ages) {
    this.ages = ages.map(({ path, label, limit }) => {
      const bar = build("i");
      const number = build("output", { text: "–" });
      const row = build("div", { class: "age" }, build("span", { text: label, title: path }), build("div", { class: "meter" }, bar), number, build("small", { text: `of ${formatBound(limit)} s` }));
      return { path, limit, bar, number, row };
    });
    document.getElementById("ages").replaceChildren(...this.ages.map(({ row }) => row));
  }

  showRow(source) {
    for (const { path, limit, bar, number, row } of this.ages) {
      const age = source.rows.value(path, source.row);
      const share = Number.isNaN(age) ? 1 : age / limit;
      bar.style.transform = `scaleX(${Math.min(1, Math.max(0, share))})`;
      row.dataset.level = share >= 1 ? "alarm" : share >= WARN_SHARE ? "warning" : "good";
      write(number, `${formatFixed(age, age < 10 ? 2 : age < 100 ? 1 : 0)} s`);
    }
    if (!this.supervisor) {
      if (this.hello.kind === "flight") this.showArmed(source.rows.value("vehicle.armed", source.row) === 1);
      return;
    }
    const mode = this.supervisor.modes[source.rows.value(this.supervisor.mode, source.row)] ?? "–";
    const cause = this.supervisor.causes[source.rows.value(this.supervisor.cause, source.row)] ?? "–";
    const idle = MOVING.has(mode) && source.rows.value("vehicle.armed", source.row) === 0;
    this.mode.dataset.mode = idle ? "standby" : mode;
    write(this.sign, idle ? SIGNS.standby : SIGNS[mode] ?? "●");
    write(this.name, idle ? "not armed" : mode);
    write(this.cause, idle ? `autopilot: ${mode}` : cause);
  }

  showArmed(armed) {
    this.mode.dataset.mode = armed ? "flying" : "standby";
    write(this.sign, armed ? SIGNS.flying : SIGNS.standby);
    write(this.name, armed ? "flying" : "not armed");
  }

  showStatus(status) {
    this.showRequests(status.requests ?? {});
    const checks = status.checks ?? [];
    const none = document.getElementById("checks-none");
    none.hidden = checks.length > 0;
    write(none, status.armed ? "Armed. These checks run only before arming." : "None yet.");
    if (this.checks.children.length !== checks.length) {
      this.checks.replaceChildren(...checks.map(() => build("tr", {}, build("td"), build("td", {}, build("span"), build("small")), build("td", { class: "number" }), build("td", { class: "number" }))));
    }
    checks.forEach((check, k) => {
      const row = this.checks.children[k];
      const [sign, name, value, limit] = row.children;
      row.dataset.level = check.ok ? "good" : "alarm";
      write(sign, check.ok ? "✓" : "✕");
      write(name.firstChild, check.name);
      write(name.lastChild, check.ok ? "" : check.reason);
      write(value, formatBeside(check.value ?? NaN, Math.abs(check.limit) || Math.abs(check.value)));
      write(limit, formatBound(check.limit));
    });
  }
}
