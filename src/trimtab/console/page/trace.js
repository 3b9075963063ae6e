// History of one signal over the last minute, in a box with the present value.

import { formatNumber, shownFactor, shownUnit } from "./format.js";
import { thinRows } from "./rows.js";

const SECONDS = 60;
const POINTS = 300;

/** Draws the history into a box {left, top, width, height}. `setPoint`: function that returns a signal's set-point, or
 * NaN if it has none. */
export function drawTrace(context, colours, source, path, name, { left, top, width, height }, setPoint) {
  const { rows, row } = source;
  const signal = path && rows.signal(path);
  if (!signal) return;
  context.font = "13px system-ui, sans-serif";
  context.textAlign = "left";
  context.textBaseline = "alphabetic";
  context.fillStyle = colours.soft;
  context.fillText(`${name}, ${shownUnit(signal.unit)} · last ${SECONDS} s`, left, top + 14);
  context.font = "600 20px system-ui, sans-serif";
  context.fillStyle = colours.ink;
  context.fillText(formatNumber(shownFactor(signal.unit) * rows.value(path, row), 5), left, top + 36);
  const box = { x: left, y: top + 44, width, height: height - 48 };
  context.strokeStyle = colours.line;
  context.lineWidth = 1;
  context.strokeRect(box.x + 0.5, box.y + 0.5, box.width - 1, box.height - 1);
  if (row < 1) return;
  const from = rows.times[row] - SECONDS;
  const lines = [[source, colours.craft, []]];
  if (source.second) lines.unshift([source.second, colours.ghost, [6, 5]]);
  const curves = lines.map(([one, colour, dash]) => {
    const { x, ys } = thinRows(one.rows, [one.rows.column(path)], Math.max(0, one.rows.rowAt(from)), one.row + 1, POINTS);
    return { x, y: ys[0], colour, dash };
  });
  const wanted = setPoint(path);
  const known = curves.flatMap(({ y }) => y.filter((value) => value !== null));
  if (Number.isFinite(wanted)) known.push(wanted);
  let [low, high] = [Math.min(...known), Math.max(...known)];
  const room = Math.max((high - low) * 0.1, Math.abs(high) * 1e-4, 1e-6);
  [low, high] = [low - room, high + room];
  const place = (t, value) => [box.x + ((t - from) / SECONDS) * box.width, box.y + ((high - value) / (high - low)) * box.height];
  if (Number.isFinite(wanted)) drawLine(context, [place(from, wanted), place(from + SECONDS, wanted)], colours.warning, [4, 4]);
  for (const { x, y, colour, dash } of curves) {
    drawLine(context, x.flatMap((t, k) => (y[k] === null ? [] : [place(t, y[k])])), colour, dash);
  }
}

function drawLine(context, points, colour, dash) {
  context.strokeStyle = colour;
  context.lineWidth = 2;
  context.setLineDash(dash);
  context.beginPath();
  for (const [x, y] of points) context.lineTo(x, y);
  context.stroke();
  context.setLineDash([]);
}
