// Health of the link, of the deadlines and of this page.

import { readPalette, Surface } from "./canvas.js";
import { build, formatFixed, formatMs, write } from "./format.js";

const LATE_SILENCE = 0.1;

/** Writes pairs of a name and a text to a definition list. Builds its elements only if their number has changed. */
function writePairs(list, pairs) {
  if (list.children.length !== pairs.length) {
    list.replaceChildren(...pairs.map(([name]) => build("div", {}, build("dt", { text: name }), build("dd"))));
  }
  pairs.forEach(([, text, level], k) => {
    write(list.children[k].lastChild, text);
    list.children[k].dataset.level = level ?? "";
  });
}

export class HealthPanel {
  constructor(connection, timing) {
    this.connection = connection;
    this.timing = timing;
    this.link = document.getElementById("link");
    this.list = document.getElementById("timing");
    this.text = document.getElementById("deadline-text");
    this.surface = Surface.of(document.getElementById("deadlines"));
    this.draws = { count: 0, at: 0, rate: NaN, spent: 0, share: NaN };
  }

  showStatus(status) {
    const link = status.link ?? {};
    writePairs(this.link, [
      ["down", `${formatMs(link.down, 1)} ms`],
      ["up", `${formatMs(link.up, 1)} ms`],
      ["round trip", `${formatMs(link.round_trip, 1)} ms`],
      ["lost", `${formatFixed(100 * link.loss, 1)} %`, link.loss > 0.05 ? "warning" : ""],
      ["samples", `${formatFixed(link.rate, 1)} /s`],
      ["no data for", `${formatMs(link.silence)} ms`, link.silence > LATE_SILENCE ? "warning" : ""],
      ["stick latency", status.stick_latency === null ? "–" : `${formatMs(status.stick_latency, 1)} ms`],
      ["overruns", String(status.overruns ?? "–"), status.overruns ? "warning" : ""],
      ["armed", status.armed ? "yes" : "no"],
      ["open pages", `${status.clients ?? "–"}`],
    ]);
    this.drawDeadlines(status.deadlines);
  }

  /** Draws a histogram of lateness and work. On its logarithmic scale, one late period in a thousand is visible. */
  drawDeadlines(deadlines) {
    const context = this.surface.start();
    if (!context || !deadlines) return;
    const { late, work, edges, period } = deadlines;
    const colours = readPalette();
    const { width, height } = this.surface;
    const base = height - 18;
    const finite = edges.filter(Number.isFinite);
    const [low, high] = [Math.min(...finite), Math.max(...finite, period ?? 0)];
    const place = (edge) => 8 + ((Math.min(high, Math.max(low, edge ?? high)) - low) / (high - low)) * (width - 16);
    const most = Math.log1p(Math.max(1, ...late, ...work));
    [[work, colours.series[0], 0], [late, colours.series[1], 0.5]].forEach(([counts, colour, shift]) => {
      context.fillStyle = colour;
      counts.forEach((count, k) => {
        const [left, right] = [place(edges[k]), place(edges[k + 1])];
        const tall = (Math.log1p(count) / most) * (base - 22);
        context.fillRect(left + shift * (right - left), base - tall, Math.max(1, (right - left) / 2 - 1), tall);
      });
    });
    context.strokeStyle = colours.soft;
    context.beginPath();
    context.moveTo(8, base + 0.5);
    context.lineTo(width - 8, base + 0.5);
    context.stroke();
    context.font = "12px system-ui, sans-serif";
    context.fillStyle = colours.soft;
    context.textAlign = "left";
    context.fillText(`${formatMs(low)} ms`, 8, height - 4);
    context.textAlign = "right";
    context.fillText(`${formatMs(high)} ms`, width - 8, height - 4);
    context.fillStyle = colours.series[0];
    context.fillText("■ work", width - 72, 12);
    context.fillStyle = colours.series[1];
    context.fillText("■ late", width - 8, 12);
    write(this.text, `counts on a logarithmic scale; a period is ${formatMs(period, 1)} ms`);
  }

  showTiming(plots) {
    const { timing, draws } = this;
    const now = performance.now();
    if (now - draws.at > 1000) {
      Object.assign(draws, { rate: (1000 * (plots.draws - draws.count)) / (now - draws.at), share: (plots.spent - draws.spent) / (now - draws.at) });
      Object.assign(draws, { count: plots.draws, spent: plots.spent, at: now });
    }
    const { clock } = this.connection;
    writePairs(this.list, [
      ["display delay, median", `${formatMs(timing.median, 1)} ms`],
      ["display delay, 99 % below", `${formatMs(timing.p99, 1)} ms`],
      ["rows", `${formatFixed(timing.rows_per_second, 1)} /s`],
      ["frames", `${formatFixed(timing.frames_per_second, 1)} /s`],
      ["plots drawn", `${formatFixed(draws.rate, 1)} /s`],
      ["time for plots", `${formatFixed(100 * draws.share, 1)} %`],
      ["clock uncertainty", `± ${formatMs(clock.round_trip / 2, 1)} ms`],
      ["round trip to server", `${formatMs(clock.round_trip, 1)} ms`],
    ]);
  }
}
