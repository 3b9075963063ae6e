// Plots of signals over time, each with its set-point. Visible plots are drawn a few times a second, within a budget of
// computing time.

import { readPalette } from "./canvas.js";
import { build, wrapDegrees, formatSignal, shortPaths, shownFactor, shownUnit, write } from "./format.js";
import { SignalPicker } from "./picker.js";
import { thinRows } from "./rows.js";

const DRAWS_PER_SECOND = 12;
const MOST_DRAWS_PER_SECOND = 40;
const BUDGET_MS = 9;
const MOST_POINTS = 700;
const MOST_SIGNALS = 6;
const MOST_PLOTS = 8;
const LIVE_WINDOWS = [5, 10, 20, 30, 60, 120];
const DEFAULT_WINDOW = 20;
const SHRINK_BELOW = 0.45;
const HALF_GAP = 3;

/** Returns the limits of an axis. They grow at once, and shrink only when most of the axis is empty, so that curves
 * stay in place. */
function holdLimits(held, low, high) {
  const span = Math.max(high - low, 1e-6, 1e-4 * Math.abs(high));
  if (held && low >= held[0] && high <= held[1] && span > SHRINK_BELOW * (held[1] - held[0])) return held;
  return [(low + high) / 2 - 0.62 * span, (low + high) / 2 + 0.62 * span];
}

/** Wraps angles to (-180, 180] degrees, with a gap where the wrapped angle jumps. */
function wrapAngles(angles) {
  const shown = angles.map((angle) => (angle === null ? null : wrapDegrees(angle)));
  const jumps = [];
  for (let k = 1; k < shown.length; k++) {
    if (shown[k] !== null && shown[k - 1] !== null && Math.abs(shown[k] - shown[k - 1]) > 180) jumps.push(k);
  }
  for (const k of jumps) shown.fill(null, Math.max(0, k - HALF_GAP), k + HALF_GAP);
  return shown;
}

/** Returns the values of the second flight at the times of the first flight. */
function readBeside(second, path, times) {
  const column = second.rows.column(path);
  if (!column) return times.map(() => null);
  return times.map((t) => {
    const row = second.rows.rowAt(t);
    const value = row < 0 || t > second.end ? NaN : column[row];
    return Number.isNaN(value) ? null : value;
  });
}

class Plot {
  constructor(panel, paths) {
    this.panel = panel;
    this.paths = paths;
    this.held = null;
    this.visible = true;
    this.chips = [];
    this.head = build("div", { class: "plot-head" });
    this.body = build("div", { class: "plot-body" });
    this.cursor = build("i", { class: "plot-cursor" });
    this.element = build("article", { class: "plot", "aria-label": "Plot" }, this.head, this.body);
    new ResizeObserver(() => (this.fits = false)).observe(this.body);
    new IntersectionObserver((entries) => (this.visible = entries.at(-1).isIntersecting)).observe(this.element);
    this.body.addEventListener("click", (event) => this.click(event));
    this.rebuild();
  }

  get unit() {
    const first = this.panel.source.rows.signal(this.paths[0]);
    return first ? first.unit : null;
  }

  rebuild() {
    this.chart?.destroy();
    this.chart = null;
    this.held = null;
    this.fits = false;
    this.buildHead();
  }

  buildHead() {
    const colours = readPalette().series;
    const names = shortPaths(this.paths);
    this.chips = this.paths.map((path, k) => {
      const signal = this.panel.source.rows.signal(path);
      const value = build("output", { text: "–", class: "live" });
      const chip = build("button", { type: "button", class: "chip", title: `${path}: ${signal.meaning} Click to remove.` });
      chip.append(build("i"), build("span", { text: names[k] }), value);
      chip.querySelector("i").style.background = colours[k];
      chip.addEventListener("click", () => this.remove(path));
      return { chip, value, signal, size: 0 };
    });
    const add = build("button", { type: "button", class: "quiet", "aria-label": "Add a signal to this plot", text: "+", disabled: this.paths.length >= MOST_SIGNALS });
    add.addEventListener("click", () => this.panel.chooseFor(this));
    const close = build("button", { type: "button", class: "quiet", "aria-label": "Remove this plot", text: "×" });
    close.addEventListener("click", () => this.panel.remove(this));
    this.head.replaceChildren(build("div", { class: "chips" }, ...this.chips.map(({ chip }) => chip)), build("small", { text: shownUnit(this.unit) }), add, close);
  }

  remove(path) {
    this.paths = this.paths.filter((other) => other !== path);
    if (this.paths.length) this.rebuild();
    else this.panel.remove(this);
    this.panel.remember();
  }

  /** Fits the chart to the size of its element. */
  fit() {
    const { clientWidth: width, clientHeight: height } = this.body;
    if (!width || !height) return;
    if (this.chart) this.chart.setSize({ width, height });
    else this.buildChart(width, height);
    this.fits = true;
    this.drawn = -1;
  }

  buildChart(width, height) {
    const colours = readPalette();
    const modes = this.panel.source.rows.signal(this.paths[0])?.modes;
    const axis = { stroke: colours.soft, font: "12px system-ui, sans-serif", grid: { stroke: colours.line, width: 1 }, ticks: { show: false } };
    const series = [{}];
    this.paths.forEach((path, k) => {
      const stroke = colours.series[k];
      const stepped = this.panel.source.rows.signal(path).kind === "mode" || this.panel.source.rows.signal(path).kind === "flag";
      const paths = stepped ? uPlot.paths.stepped({ align: 1 }) : undefined;
      series.push({ stroke, width: 2, points: { show: false }, paths });
      series.push({ stroke, width: 1.5, dash: [3, 4], points: { show: false } });
      series.push({ stroke, width: 1.5, dash: [9, 5], points: { show: false }, paths });
    });
    const named = modes ? { values: (_, splits) => splits.map((split) => modes[split] ?? ""), size: 66, incrs: [1] } : { size: 54 };
    this.chart = new uPlot(
      {
        width,
        height,
        padding: [6, 12, 0, 0],
        legend: { show: false },
        cursor: { drag: { x: false, y: false }, points: { show: false }, y: false },
        scales: { x: { time: false }, y: { range: (_, low, high) => this.limit(low, high) } },
        axes: [{ ...axis, size: 20, gap: 2, space: 60 }, { ...axis, ...named, space: 22 }],
        series,
      },
      [[0], ...series.slice(1).map(() => [null])],
      this.body,
    );
    this.chart.over.append(this.cursor);
  }

  limit(low, high) {
    if (low === null || high === null) return this.held ?? [0, 1];
    this.held = holdLimits(this.held, low, high);
    return this.held;
  }

  click(event) {
    if (this.panel.source.live || !this.chart) return;
    const left = event.clientX - this.chart.over.getBoundingClientRect().left;
    this.panel.goTo(this.chart.posToVal(left, "x"));
  }

  /** Draws the rows between two times. */
  draw(from, to) {
    if (!this.chart) return;
    const { source } = this.panel;
    const { rows } = source;
    const first = Math.max(0, rows.rowAt(from));
    const last = Math.max(first, rows.rowAt(to) + 1);
    const { x, ys } = thinRows(rows, this.paths.map((path) => rows.column(path)), first, last, MOST_POINTS);
    const data = [x];
    this.paths.forEach((path, k) => {
      const { unit, kind } = rows.signal(path);
      const factor = shownFactor(unit);
      const scale = (y) => (kind === "angle" ? wrapAngles(y) : factor === 1 ? y : y.map((value) => (value === null ? null : factor * value)));
      const goal = this.panel.setPoints.history(path);
      data.push(scale(ys[k]), goal ? scale(x.map(goal)) : x.map(() => null));
      data.push(source.second ? scale(readBeside(source.second, path, x)) : x.map(() => null));
    });
    this.chart.setData(data, false);
    this.chart.setScale("x", { min: from, max: to });
  }

  /** Shows the values of a row, and moves the vertical line that marks the time of the row. */
  writeValues(row) {
    const { source } = this.panel;
    for (const chip of this.chips) {
      const number = source.rows.value(chip.signal.path, row);
      if (Number.isFinite(number)) chip.size = Math.max(chip.size, Math.abs(number));
      write(chip.value, formatSignal(chip.signal, number, chip.size));
    }
    if (!source.live && this.chart) {
      this.cursor.style.transform = `translateX(${Math.round(this.chart.valToPos(source.time, "x"))}px)`;
    }
  }
}

export class PlotPanel {
  constructor(source, setPoints, title, life) {
    this.source = source;
    this.setPoints = setPoints;
    this.place = `trimtab plots ${title}`;
    this.list = document.getElementById("plot-list");
    this.goTo = () => {};
    this.plots = [];
    this.next = 0;
    this.drawn_at = 0;
    this.frozen = null;
    this.spent = 0;
    this.draws = 0;
    this.picker = new SignalPicker(source.rows.signals, life);
    this.addButton = document.getElementById("plot-add");
    this.addButton.addEventListener("click", () => this.chooseFor(null), { signal: life });
    this.freezeButton = document.getElementById("plot-pause");
    this.freezeButton.addEventListener("click", () => this.freeze(), { signal: life });
    this.select = document.getElementById("plot-window");
    this.select.addEventListener("change", () => this.remember(), { signal: life });
    this.fillWindows();
    this.list.replaceChildren();
    const kept = this.recall();
    for (const paths of kept ?? this.guessPlots()) this.add(paths);
  }

  fillWindows() {
    const windows = LIVE_WINDOWS.map((seconds) => build("option", { value: seconds, text: `${seconds} s` }));
    if (!this.source.live) windows.push(build("option", { value: "all", text: "all" }));
    this.select.replaceChildren(...windows);
    this.select.value = this.source.live ? String(DEFAULT_WINDOW) : "all";
  }

  recall() {
    try {
      const kept = JSON.parse(localStorage.getItem(this.place));
      if (this.source.live && LIVE_WINDOWS.includes(Number(kept.window))) this.select.value = kept.window;
      const plots = kept.plots.map((paths) => paths.filter((path) => this.source.rows.has(path))).filter((paths) => paths.length);
      return plots.length ? plots : null;
    } catch {
      return null;
    }
  }

  remember() {
    this.redraw();
    localStorage.setItem(this.place, JSON.stringify({ window: this.select.value, plots: this.plots.map((plot) => plot.paths) }));
  }

  /** Chooses the first plots: signals with set-points, then derived signals (flight.…), then others in row order. */
  guessPlots() {
    const wanted = this.source.rows.signals.filter((signal) => this.setPoints.has(signal.path));
    const rest = this.source.rows.signals.filter((signal) => signal.kind === "real" || signal.kind === "angle");
    const flight = rest.filter((signal) => signal.path.startsWith("flight."));
    const groups = new Map();
    for (const signal of [...wanted, ...flight, ...rest]) {
      const group = groups.get(signal.unit) ?? [];
      if (group.length < 2 && !group.includes(signal.path)) groups.set(signal.unit, [...group, signal.path]);
    }
    return [...groups.values()].slice(0, 3);
  }

  chooseFor(plot) {
    this.picker.open(plot ? plot.unit : null, plot ? plot.paths : [], (path) => {
      if (!plot) plot = this.add([path]);
      else if (plot.paths.length < MOST_SIGNALS) {
        plot.paths.push(path);
        plot.rebuild();
      }
      this.remember();
    });
  }

  add(paths) {
    const plot = new Plot(this, paths.slice(0, MOST_SIGNALS));
    this.plots.push(plot);
    this.list.append(plot.element);
    this.addButton.disabled = this.plots.length >= MOST_PLOTS;
    return plot;
  }

  remove(plot) {
    plot.chart?.destroy();
    plot.element.remove();
    this.plots = this.plots.filter((other) => other !== plot);
    this.addButton.disabled = false;
    this.remember();
  }

  /** Draws all plots again after a change of colours or data. */
  rebuild() {
    for (const plot of this.plots) plot.rebuild();
    this.redraw();
  }

  redraw() {
    for (const plot of this.plots) plot.drawn = -1;
  }

  freeze() {
    this.frozen = this.frozen === null ? this.source.time : null;
    this.freezeButton.setAttribute("aria-pressed", String(this.frozen !== null));
    this.freezeButton.textContent = this.frozen === null ? "Freeze" : "Frozen";
  }

  /** Returns the start and the end of the time interval to draw. */
  readWindow() {
    const { source } = this;
    if (this.select.value === "all") return [source.start, source.end];
    const seconds = Number(this.select.value);
    const to = source.live ? this.frozen ?? source.time : Math.min(source.end, source.time + seconds / 2);
    return [to - seconds, to];
  }

  /** Draws the plots that are due, at a limited rate and within the budget of computing time. */
  tick(now) {
    const [from, to] = this.readWindow();
    if (!Number.isFinite(to) || now - this.drawn_at < 1000 / (this.next ? MOST_DRAWS_PER_SECOND : DRAWS_PER_SECOND)) return;
    this.drawn_at = now;
    const start = performance.now();
    while (this.next < this.plots.length) {
      const plot = this.plots[this.next++];
      if (!plot.visible) continue;
      if (!plot.fits) plot.fit();
      if (plot.drawn !== to) plot.draw(from, to);
      plot.drawn = to;
      plot.writeValues(this.frozen === null ? this.source.row : this.source.rows.rowAt(this.frozen));
      this.draws += 1;
      if (performance.now() - start > BUDGET_MS) break;
    }
    if (this.next >= this.plots.length) this.next = 0;
    this.spent += performance.now() - start;
  }
}
