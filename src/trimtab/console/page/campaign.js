// Campaign: scatter plot of the runs, with the outcome as colour and shape. A click on a run repeats it and shows it
// beside the nominal run.

import { label, readPalette, roundStep, Surface } from "./canvas.js";
import { build, formatBound, formatNumber, write } from "./format.js";
import { findFlight } from "./recording.js";

const REACH = 14;
const MOST_OUTCOMES = 12;
const EDGE = { left: 62, right: 16, top: 16, bottom: 44 };
const SHAPES = ["circle", "triangle", "square", "diamond", "cross", "plus"];
const SIGNS = ["●", "▲", "■", "◆", "✕", "+"];

function drawShape(context, shape, x, y, size) {
  context.beginPath();
  if (shape === "circle") context.arc(x, y, size, 0, 2 * Math.PI);
  else if (shape === "square") context.rect(x - size, y - size, 2 * size, 2 * size);
  else if (shape === "triangle") for (const [dx, dy] of [[0, -1.2], [1.1, 0.9], [-1.1, 0.9], [0, -1.2]]) context.lineTo(x + dx * size, y + dy * size);
  else if (shape === "diamond") for (const [dx, dy] of [[0, -1.3], [1.3, 0], [0, 1.3], [-1.3, 0], [0, -1.3]]) context.lineTo(x + dx * size, y + dy * size);
  else {
    const strokes = shape === "cross" ? [[-1, -1, 1, 1], [-1, 1, 1, -1]] : [[-1.2, 0, 1.2, 0], [0, -1.2, 0, 1.2]];
    for (const [ax, ay, bx, by] of strokes) {
      context.moveTo(x + ax * size, y + ay * size);
      context.lineTo(x + bx * size, y + by * size);
    }
  }
  context.stroke();
}

class Scatter {
  constructor(hello, numbers, showFlights) {
    this.hello = hello;
    this.columns = hello.columns;
    this.numbers = numbers;
    this.count = Math.floor(numbers.length / this.columns.length);
    this.showFlights = showFlights;
    this.chosen = null;
    this.hovered = null;
    this.flying = false;
    this.number = this.columns.findIndex((column) => column.role === "run");
    this.outcome = this.columns.findIndex((column) => column.role === "outcome");
    this.outcomes = this.findOutcomes();
    if (this.outcomes.length > MOST_OUTCOMES) {
      this.outcome = -1;
      this.outcomes = this.findOutcomes();
    }
    this.build();
    this.surface = Surface.of(this.canvas);
    const frame = () => {
      requestAnimationFrame(frame);
      const theme = document.documentElement.dataset.theme;
      if (this.surface.changed || this.theme !== theme) this.draw();
      this.theme = theme;
    };
    frame();
  }

  findOutcomes() {
    return [...new Set(Array.from({ length: this.count }, (_, run) => this.read(run, this.outcome)))].sort((a, b) => a - b);
  }

  read(run, column) {
    return column < 0 ? NaN : this.numbers[run * this.columns.length + column];
  }

  /** Returns the row of a run with this number; -1 if the store does not contain the run. */
  row(number) {
    for (let row = 0; row < this.count; row++) if (this.read(row, this.number) === number) return row;
    return -1;
  }

  nameOutcome(value) {
    if (this.outcome < 0) return "run";
    return this.columns[this.outcome].modes?.[value] ?? formatNumber(value, 3);
  }

  build() {
    const section = document.getElementById("campaign");
    section.hidden = false;
    const choose = (name, chosen) => {
      const select = build("select", { "aria-label": name }, ...this.columns.map(({ path, unit }, k) => build("option", { value: k, text: shownAxis(path, unit) })));
      select.value = String(chosen);
      select.addEventListener("change", () => (this.surface.changed = true));
      return select;
    };
    const first = (role) => Math.max(0, this.columns.findIndex((column) => column.role === role));
    this.x = choose("Horizontal", first("drawn"));
    this.y = choose("Vertical", first("metric"));
    this.run = build("input", { type: "number", min: 0, value: this.read(0, this.number), "aria-label": "Run" });
    const fly = build("button", { type: "button", text: "Repeat this run" });
    fly.addEventListener("click", () => this.fly(this.row(Number(this.run.value))));
    this.canvas = build("canvas", { id: "scatter", role: "img", "aria-label": "Runs of the campaign" });
    this.canvas.addEventListener("pointermove", (event) => this.hover(event));
    this.canvas.addEventListener("click", (event) => this.click(event));
    this.text = build("p", { class: "small", role: "status", text: `${this.count} runs: click one to repeat it` });
    this.command = build("code", { text: "" });
    const copy = build("button", { type: "button", text: "Copy" });
    copy.addEventListener("click", () => this.copy(copy));
    this.rerun = build("div", { class: "toolbar rerun", hidden: true }, this.command, copy);
    this.legend = build("ul", { class: "legend" });
    const choices = build("div", { class: "toolbar choices" }, build("label", { text: "horizontal " }, this.x), build("label", { text: "vertical " }, this.y), build("span", { class: "push" }), build("label", { text: "run " }, this.run), fly);
    section.replaceChildren(choices, this.legend, this.canvas, this.text, this.rerun);
    this.buildLegend();
    this.buildSwitch();
  }

  buildLegend() {
    const colours = readPalette().series;
    this.legend.replaceChildren(
      ...this.outcomes.map((value, k) => {
        const count = Array.from({ length: this.count }, (_, run) => this.read(run, this.outcome)).filter((other) => Object.is(other, value)).length;
        const sign = build("i", { text: SIGNS[k % SIGNS.length] });
        sign.style.color = colours[k % colours.length];
        return build("li", {}, sign, build("span", { text: `${this.nameOutcome(value)} ${count}` }));
      }),
    );
  }

  /** Builds two buttons above the column, which switch between the runs and the repeated flight. */
  buildSwitch() {
    this.buttons = ["runs", "flight"].map((show) => {
      const button = build("button", { type: "button", text: show === "runs" ? "Runs" : "Flight", disabled: show === "flight" });
      button.addEventListener("click", () => this.show(show));
      return button;
    });
    document.getElementById("view").prepend(build("div", { class: "toolbar switch" }, ...this.buttons));
    this.show("runs");
  }

  show(show) {
    document.body.dataset.show = show;
    this.buttons.forEach((button, k) => button.setAttribute("aria-pressed", String((show === "flight") === (k === 1))));
  }

  /** Returns the position of a run on the canvas; null if one of its two values is missing. */
  place(run) {
    const [x, y] = [this.read(run, Number(this.x.value)), this.read(run, Number(this.y.value))];
    if (!Number.isFinite(x) || !Number.isFinite(y)) return null;
    const { width, height } = this.surface;
    const across = (x - this.limits.x[0]) / (this.limits.x[1] - this.limits.x[0]);
    const up = (y - this.limits.y[0]) / (this.limits.y[1] - this.limits.y[0]);
    return [EDGE.left + across * (width - EDGE.left - EDGE.right), height - EDGE.bottom - up * (height - EDGE.top - EDGE.bottom)];
  }

  findLimits(column) {
    let [low, high] = [Infinity, -Infinity];
    for (let run = 0; run < this.count; run++) {
      const value = this.read(run, column);
      if (!Number.isFinite(value)) continue;
      low = Math.min(low, value);
      high = Math.max(high, value);
    }
    if (!(low <= high)) return [0, 1];
    const room = 0.05 * (high - low || Math.abs(high) || 1);
    return [low - room, high + room];
  }

  draw() {
    const context = this.surface.start();
    if (!context) return;
    const colours = readPalette();
    if (this.theme !== document.documentElement.dataset.theme) this.buildLegend();
    this.limits = { x: this.findLimits(Number(this.x.value)), y: this.findLimits(Number(this.y.value)) };
    this.drawAxes(context, colours);
    let missing = 0;
    for (let run = 0; run < this.count; run++) {
      const place = this.place(run);
      if (!place) {
        missing += 1;
        continue;
      }
      const k = this.outcomes.findIndex((value) => Object.is(value, this.read(run, this.outcome)));
      context.strokeStyle = colours.series[k % colours.series.length];
      context.lineWidth = 1.8;
      drawShape(context, SHAPES[k % SHAPES.length], ...place, 4.5);
    }
    for (const [run, colour] of [[this.hovered, colours.soft], [this.chosen, colours.ink]]) {
      const place = run === null ? null : this.place(run);
      if (!place) continue;
      context.strokeStyle = colour;
      context.lineWidth = 2.5;
      drawShape(context, "circle", ...place, 11);
      context.font = "600 14px system-ui, sans-serif";
      context.textAlign = place[0] > this.surface.width / 2 ? "right" : "left";
      label(context, `run ${this.read(run, this.number)}`, place[0] + (place[0] > this.surface.width / 2 ? -15 : 15), place[1] - 9, colours.ink, colours.panel);
    }
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "right";
    if (missing) label(context, `${missing} runs have no value here`, this.surface.width - EDGE.right, EDGE.top, colours.soft, colours.panel);
  }

  drawAxes(context, colours) {
    const { width, height } = this.surface;
    context.font = "12px system-ui, sans-serif";
    context.strokeStyle = colours.line;
    context.fillStyle = colours.soft;
    context.lineWidth = 1;
    const name = (k) => shownAxis(this.columns[k].path, this.columns[k].unit);
    for (const axis of ["x", "y"]) {
      const [low, high] = this.limits[axis];
      const step = roundStep(high - low, 6);
      for (let k = Math.ceil(low / step); k * step <= high; k++) {
        const share = (k * step - low) / (high - low);
        const x = EDGE.left + share * (width - EDGE.left - EDGE.right);
        const y = height - EDGE.bottom - share * (height - EDGE.top - EDGE.bottom);
        context.beginPath();
        context.moveTo(axis === "x" ? x : EDGE.left, axis === "x" ? EDGE.top : y);
        context.lineTo(axis === "x" ? x : width - EDGE.right, axis === "x" ? height - EDGE.bottom : y);
        context.stroke();
        context.textAlign = axis === "x" ? "center" : "right";
        context.fillText(formatBound(Number((k * step).toPrecision(6))), axis === "x" ? x : EDGE.left - 6, axis === "x" ? height - EDGE.bottom + 16 : y + 4);
      }
    }
    context.font = "13px system-ui, sans-serif";
    context.fillStyle = colours.ink;
    context.textAlign = "center";
    context.fillText(name(Number(this.x.value)), (width + EDGE.left) / 2, height - 8);
    context.save();
    context.translate(14, (height - EDGE.bottom) / 2);
    context.rotate(-Math.PI / 2);
    context.fillText(name(Number(this.y.value)), 0, 0);
    context.restore();
  }

  /** Returns the run nearest to the pointer, if it is near enough. */
  find(event) {
    let [nearest, least] = [null, REACH];
    for (let run = 0; run < this.count && this.limits; run++) {
      const place = this.place(run);
      const away = place ? Math.hypot(place[0] - event.offsetX, place[1] - event.offsetY) : Infinity;
      if (away < least) [nearest, least] = [run, away];
    }
    return nearest;
  }

  hover(event) {
    const run = this.find(event);
    this.canvas.classList.toggle("pointing", run !== null);
    if (run !== this.hovered) this.surface.changed = true;
    this.hovered = run;
  }

  click(event) {
    const run = this.find(event);
    if (run !== null) this.fly(run);
  }

  async fly(row) {
    if (this.flying) return;
    if (row < 0) {
      write(this.text, `run ${this.run.value} is not in this campaign`);
      return;
    }
    this.flying = true;
    this.chosen = row;
    const run = this.read(row, this.number);
    this.run.value = String(run);
    this.surface.changed = true;
    write(this.text, `repeating run ${run} …`);
    try {
      const answer = await fetch("campaign/fly", { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify({ run }) });
      if (!answer.ok) throw new Error((await answer.text()) || `the server answers ${answer.status}`);
      const { flight, nominal, command, outcome } = await answer.json();
      write(this.text, `run ${run}: ${outcome}`);
      write(this.command, command);
      this.rerun.hidden = false;
      this.buttons[1].disabled = false;
      this.show("flight");
      const flights = [await findFlight(this.hello, flight), await findFlight(this.hello, nominal)];
      this.showFlights([{ ...flights[0], title: `run ${run}` }, { ...flights[1], title: "nominal" }]);
    } catch (error) {
      write(this.text, `run ${run} cannot be repeated: ${error.message}`);
    } finally {
      this.flying = false;
    }
  }

  async copy(button) {
    try {
      await navigator.clipboard.writeText(this.command.textContent);
      write(button, "Copied");
    } catch {
      getSelection().selectAllChildren(this.command);
      write(button, "Press Ctrl+C");
    }
    setTimeout(() => write(button, "Copy"), 2000);
  }
}

function shownAxis(path, unit) {
  return unit && unit !== "1" ? `${path}, ${unit}` : path;
}

/** Shows the runs of a campaign. Calls `showFlights` with the flight of a repeated run and the nominal flight. */
export async function showCampaign(hello, showFlights) {
  document.getElementById("mode-name").textContent = "campaign";
  document.getElementById("mode-cause").textContent = "";
  const answer = await fetch("campaign/rows");
  return new Scatter(hello, new Float64Array(await answer.arrayBuffer()), showFlights);
}
